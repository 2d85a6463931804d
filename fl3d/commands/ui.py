"""``ui``: look at a store in a browser."""

from __future__ import annotations

from fl3d.commands.parsing import parser
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Browse the store in MLflow's user interface, on this machine alone."""
    options = parser("ui", run.__doc__)
    options.add_argument(
        "overrides",
        nargs="*",
        help="where the store is, as of your sweeps: store.root=FOLDER (default: runs), or "
        "store.uri=postgresql://USER@HOST/NAME",
    )
    options.add_argument("--port", type=int, help="default: 5000, or the next one that is free")
    given = options.parse_intermixed_args(arguments)
    with loading():
        from fl3d.api.words import read_words
        from fl3d.store.mlflow.ui import browse

    store = read_words(given.overrides).settings.store
    browse(store.root, store.uri, given.port)
