"""``tables``: make tables again from what is stored."""

from __future__ import annotations

from fl3d.commands.words import HELP, PUBLISHED, names_sweep, open_words, parser, read_words
from fl3d.core.errors import ConfigError, StoreError
from fl3d.papers.results import judge_or_say, write_still_tables, write_sweep, write_views
from fl3d.papers.stored import feeding, place_words, stored_sweeps
from fl3d.runs.finished import FinishedSweep


def run(arguments: list[str]) -> None:
    """Make tables again, beside the published ones and with intervals, without training anything.

    Without a sweep among the words: of every sweep file that was run on the data and profile.
    """
    arguments_of = parser("tables", run.__doc__)
    arguments_of.add_argument("overrides", nargs="*", help=HELP)
    words = arguments_of.parse_intermixed_args(arguments).overrides
    for sweep in sweeps_of(words):
        tables, _ = write_sweep(sweep, feeding(sweep, words, PUBLISHED), print)
        write_views(sweep, tables, judge_or_say(sweep, print), print)
        write_still_tables(sweep)


def sweeps_of(words: list[str]) -> list[FinishedSweep]:
    """The sweep that words name, or every one that was run on their data and profile.

    Raises:
        StoreError: there is none.
    """
    if names_sweep(words):
        return [open_words(read_words(words))]
    others = [word for word in words if word not in place_words(words)]
    if others:
        raise ConfigError(
            f"{' '.join(others)}: without a sweep among the words, such as +sweep=gamma, every sweep is shown as it "
            "was run last; words may only say where: data=, profile=, store., results="
        )
    found = stored_sweeps(words, PUBLISHED)
    if not found:
        settings = read_words(place_words(words)).settings
        raise StoreError(
            f"{settings.store.root}: no sweep of {settings.folder_name} was run here, and there are no scores of one; "
            "make sweep-gamma, or give the words of a sweep of your own (sweep.name=...)"
        )
    return found
