"""``tables``: make tables again from what is stored."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from fl3d.api.words import names_sweep, open_words, read_words
from fl3d.commands.parsing import HELP, parser
from fl3d.config.overrides import values_by_key
from fl3d.config.places import PUBLISHED
from fl3d.core.errors import StoreError
from fl3d.papers.results import write_sweep
from fl3d.papers.stored import feeding, place_words, stored_sweeps
from fl3d.papers.tables import write_still_tables
from fl3d.papers.views import judge_or_say, write_views
from fl3d.runs.asked import asked_for
from fl3d.runs.by_hand import names_by_hand
from fl3d.runs.design import SEED
from fl3d.runs.finished import FinishedSweep


def run(arguments: list[str]) -> None:
    """Make tables again, beside the published ones and with intervals, without training anything.

    Of a sweep typed by hand: by what it was started with, or some of it. Without such words: of every sweep file that
    was run on the data and profile, and of every sweep typed by hand; seeds=N leaves other seeds out.
    """
    arguments_of = parser("tables", run.__doc__)
    arguments_of.add_argument("overrides", nargs="*", help=HELP)
    words = arguments_of.parse_intermixed_args(arguments).overrides
    for sweep in sweeps_of(words):
        for one in (sweep, *sweep.each_class()):
            tables, _ = write_sweep(one, feeding(one, words, PUBLISHED), print)
            write_views(one, tables, judge_or_say(one, print), print)
        write_still_tables(sweep)


def sweeps_of(words: list[str]) -> list[FinishedSweep]:
    """The sweep that words mean, or every one that was run on their data and profile.

    Raises:
        StoreError: there is none.
    """
    places = place_words(words)
    seeds = [word for word in words if word.partition("=")[0] == SEED]
    if names_sweep(words) or len(places) + len(seeds) < len(words):
        return [open_words(read_words(words))]
    settings = read_words(words).settings
    found = stored_sweeps(places, PUBLISHED)
    for name in names_by_hand(settings):
        with suppress(StoreError):  # none of its trials is done
            found.append(open_words(read_words([*places, f"sweep.name={name}"])))
    if seeds:
        wanted = values_by_key(seeds)[SEED]
        found = [chosen for sweep in found if (chosen := _of_seeds(sweep, wanted)).trials]
    if not found:
        raise StoreError(
            f"{settings.store.root}: no sweep of {settings.folder_name} was run here"
            f"{' with any of these seeds' if seeds else ''}, and there are no scores of one; "
            "python -m fl3d -m +sweep=gamma, or give the words of a sweep of your own (sweep.name=...)"
        )
    return found


def _of_seeds(sweep: FinishedSweep, wanted: Sequence[int]) -> FinishedSweep:
    """A sweep's trials of those of some seeds that it has."""
    seeds = {trial.seed for trial in sweep.trials}.intersection(wanted)
    if not seeds:
        return replace(sweep, trials=())
    return asked_for(sweep, {SEED: sorted(seeds)})
