"""``why``: from a number to the files that it comes from."""

from __future__ import annotations

from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import ConfigError
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Print the chain from a table's cell to its run, checkpoint, files and digests.

    TABLE is a table of a paper that the sweep feeds (II, III, IV, R2), or last or best for any sweep; the values that
    pick the row may be given short (gamma=2), the other words choose the sweep: one typed by hand by what it was
    started with, or some of it.
    Example: python -m fl3d why III gamma=2 3d/moderate data=simulated profile=quick
    """
    arguments_of = parser("why", run.__doc__)
    arguments_of.add_argument("table", metavar="TABLE|last|best")
    arguments_of.add_argument(
        "rest", nargs="+", metavar="KEY=VALUE|METRIC", help=f"row, metric, and words {HELP}"
    )
    given = arguments_of.parse_intermixed_args(arguments)
    metrics = [word for word in given.rest if "=" not in word]
    if len(metrics) != 1:
        raise ConfigError(
            f"why: give one metric, such as 3d/moderate, not {' '.join(metrics) or 'none'}"
        )
    with loading():
        from fl3d.api.cells import explain_words

    explain_words(given.table, [word for word in given.rest if "=" in word], metrics[0])
