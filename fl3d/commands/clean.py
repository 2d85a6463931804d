"""``clean``: free the disk."""

from __future__ import annotations

from pathlib import Path

from fl3d.commands.words import parser
from fl3d.runs.cleaning import clean


def run(arguments: list[str]) -> None:
    """Show the files of a store that can be deleted; --yes deletes them.

    These are weights beyond the retention rule, and what killed processes left behind.
    """
    options = parser("clean", run.__doc__)
    options.add_argument(
        "--root", type=Path, default=Path("runs"), help="folder of the store (default: runs)"
    )
    options.add_argument(
        "--keep-every",
        type=int,
        default=10,
        metavar="K",
        help="keep the weights of each K-th epoch; 0: of none (default: 10)",
    )
    options.add_argument(
        "--orphans",
        action="store_true",
        help="also stages that no sweep's plan names any more; none where a plan below the root cannot be read",
    )
    options.add_argument("--yes", action="store_true", help="delete them")
    given = options.parse_args(arguments)
    clean(given.root, given.keep_every or None, delete=given.yes, orphans=given.orphans)
