"""``clean``: free the disk."""

from __future__ import annotations

from fl3d.commands.parsing import parser
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Show the files of a store that can be deleted; --yes deletes them.

    These are weights beyond the retention rule, and what killed processes left behind.
    """
    options = parser("clean", run.__doc__)
    options.add_argument(
        "overrides",
        nargs="*",
        help="store.root=FOLDER as of your sweeps (default: runs); store.keep_every=K keeps the weights of each K-th "
        "epoch (default: 10; null: of none but the last and the best)",
    )
    options.add_argument(
        "--orphans",
        action="store_true",
        help="also stages that no sweep's plan names any more; none where a plan below the root cannot be read",
    )
    options.add_argument("--yes", action="store_true", help="delete them")
    given = options.parse_intermixed_args(arguments)
    with loading():
        from fl3d.api.words import read_words
        from fl3d.runs.cleaning import clean

    store = read_words(given.overrides).settings.store
    clean(store.root, store.keep_every, delete=given.yes, orphans=given.orphans)
