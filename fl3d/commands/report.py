"""``report``: tables, figures and claims on one page."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from fl3d.commands.parsing import HELP, parser
from fl3d.config.places import PUBLISHED
from fl3d.core.errors import DataError, StoreError
from fl3d.core.loading import loading

if TYPE_CHECKING:
    from fl3d.runs.finished import FinishedSweep


def run(arguments: list[str]) -> None:
    """Make tables, figures, claims and one page of them; trains nothing.

    What a trial contributes is made on all cores and kept in the store, so that a second report reads it.

    Without a sweep among the words: of +sweep=gamma, with the tables of all other sweep files that were run on the data
    and profile below its own.
    """
    arguments_of = parser("report", run.__doc__)
    arguments_of.add_argument("overrides", nargs="*", help=HELP)
    words = arguments_of.parse_intermixed_args(arguments).overrides
    with loading():
        from fl3d.api.words import open_words, or_gamma, read_words
        from fl3d.papers.page import write_page
        from fl3d.papers.stored import place_words, stored_sweeps

    named = or_gamma(words)
    is_named = named == words
    main = open_words(read_words(named))
    if not main.is_from_store:
        raise StoreError(
            f"{main.settings.store.root}: a report needs checkpoints; run the sweep here first"
        )
    others = (
        []
        if is_named
        else [s for s in stored_sweeps(words, None) if s.name != main.name and is_usable(s)]
    )
    page, _ = write_page(
        [main, *others], place_words(words) if not is_named else words, PUBLISHED, print
    )
    attach(main, page)
    print(f"Written to {page}.")


def is_usable(sweep: FinishedSweep) -> bool:
    """Whether a sweep's run folders and data are at hand, for tables with intervals and figures."""
    if not sweep.is_from_store:
        return False
    try:
        return len(sweep.validation.ids) > 0
    except (DataError, StoreError) as error:
        print(f"No tables of {sweep.name} on the page: {error}")
        return False


def attach(sweep: FinishedSweep, page: Path) -> None:
    """Put the page beside every trial in the store, where it does not lie there yet."""
    from fl3d.store.opening import open_store

    store = open_store(sweep.settings.store.root, sweep.settings.store.uri)
    part = sweep.settings.part
    folder = f"results/{part}" if part else "results"
    runs = store.without(sweep.runs(store).values(), page, folder)
    if not runs:
        return
    store.open()
    for run in runs:
        store.log_files(run, [page], folder)
