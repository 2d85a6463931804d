"""``ui``: look at a store in a browser."""

from __future__ import annotations

from pathlib import Path

from fl3d.commands.words import parser
from fl3d.store.mlflow.ui import browse


def run(arguments: list[str]) -> None:
    """Browse the store in MLflow's user interface, on this machine alone."""
    options = parser("ui", run.__doc__)
    options.add_argument(
        "--root",
        type=Path,
        default=Path("runs"),
        help="folder of the store (default: runs)",
    )
    options.add_argument(
        "--uri",
        help="of another store, as store.uri of the sweep: postgresql://USER@HOST/NAME",
    )
    options.add_argument("--port", type=int, default=5000, help="default: 5000")
    given = options.parse_args(arguments)
    browse(given.root, given.uri, given.port)
