"""``tables``: make tables again from what is stored."""

from __future__ import annotations

from fl3d.commands.parsing import HELP, parser
from fl3d.config.places import PUBLISHED
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Make tables again, beside the published ones and with intervals, without training anything.

    Of a sweep typed by hand: by what it was started with, or some of it. Without such words: of every sweep file that
    was run on the data and profile, and of every sweep typed by hand; seeds=N leaves other seeds out.
    """
    arguments_of = parser("tables", run.__doc__, "+sweep=gamma seeds=3")
    arguments_of.add_argument("overrides", nargs="*", help=HELP)
    words = arguments_of.parse_intermixed_args(arguments).overrides
    with loading():
        from fl3d.api.words import sweeps_of
        from fl3d.papers.results import write_sweep
        from fl3d.papers.stored import feeding
        from fl3d.papers.tables import write_still_tables
        from fl3d.papers.views import judge_or_say, write_views

    for sweep in sweeps_of(words):
        for one in (sweep, *sweep.each_class()):
            tables, _ = write_sweep(one, feeding(one, words, PUBLISHED), print)
            write_views(one, tables, judge_or_say(one, print), print)
        write_still_tables(sweep)
