"""A sweep run to its tables and verdicts: what the command line, a sweep plugin and Python all call."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import pandas as pd

from fl3d.analysis.found import sweep_verdicts
from fl3d.config.compose import Multirun
from fl3d.config.objects import build
from fl3d.config.places import PUBLISHED
from fl3d.config.settings import Settings
from fl3d.core import interrupts
from fl3d.core.errors import (
    CheckpointError,
    DataError,
    StoreDown,
    StoreError,
)
from fl3d.core.records import Config
from fl3d.inference.devices import check_device
from fl3d.papers.registry import tables_named
from fl3d.papers.results import write_sweep
from fl3d.papers.stored import feeding
from fl3d.reports.render import to_markdown
from fl3d.reports.verdicts import seeds_text, verdict_tables
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.opening import open_sweep
from fl3d.runs.units import units_of
from fl3d.store.base import Store
from fl3d.sweep.by_hand import named
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.run import Ran, run_sweep
from fl3d.sweep.setup import Prepared, prepare_sweep
from fl3d.sweep.sweepers.base import Sweeper
from fl3d.sweep.verdict_tags import tag_verdicts
from fl3d.sweep.winners import with_winners


def train(
    sweeper: Sweeper, launcher: Config, words: Sequence[str], say: Callable[[str], None] = print
) -> Settings:
    """Run a sweep to its tables; its settings, by which it can be opened.

    Args:
        sweeper: proposes its trials.
        launcher: section of the config, with its ``_target_``.
        words: of the command line.
        say: prints a line for the user.

    Raises:
        StageFailed: a stage failed; all others are trained, scored and tabulated.
    """
    interrupts.loaded()
    if hasattr(sys.stdout, "reconfigure"):
        sys.stdout.reconfigure(line_buffering=True)
    device = sweeper.base.get("device", "cpu")
    check_device(device, "device=", is_here=False)
    built: Launcher = build(launcher, "hydra.launcher")
    check_device(device, "device=", built.IS_HERE)
    built.open()  # it loads while the sweep is being planned
    prepared = prepare_sweep(sweeper, words)
    refuse_untold_rows(prepared)
    ran = run_sweep(prepared, built, say=say)
    report(prepared, ran, words, say)
    ran.outcome.check()
    return prepared.settings


class Door(Protocol):
    """What makes a sweeper of a command line; one of Hydra's plugins, see ``hydra_plugins.fl3d.sweepers``."""

    def proposer(self, arguments: list[str], compose: Any) -> Sweeper:
        """The sweeper of these words."""


def train_sweep(asked: Multirun, door: Door, say: Callable[[str], None] = print) -> Settings:
    """Run a sweep to its tables, by the words that describe it; its settings.

    Args:
        asked: as Hydra reads the words.
        door: to its sweeper.
        say: prints a line for the user.

    Raises:
        StageFailed: a stage failed; all others are trained, scored and tabulated.
    """
    multirun = named(with_winners(asked))
    sweeper = door.proposer(multirun.arguments, multirun.compose)
    return train(sweeper, multirun.launcher, multirun.arguments, say)


def refuse_untold_rows(prepared: Prepared) -> None:
    """Refuse now a sweep whose trials would share a row of a paper's table.

    Raises:
        ConfigError: naming the table, and the keys in which the trials differ.
    """
    trials = prepared.planner.frozen(prepared.plan).trials if prepared.plan.trials else ()
    for table in tables_named(prepared.settings.sweep.tables):
        table.refuse_twins(trials)


def tell_verdicts(sweep: FinishedSweep, store: Store, say: Callable[[str], None]) -> None:
    """Print what a sweep has found, and tag its runs with it; nothing of a single level, or without a baseline."""
    if len(sweep.levels) < 2:
        return
    try:
        verdicts = sweep_verdicts(sweep)
        if verdicts.empty:
            return
        _tag(sweep, verdicts, store, say)
    except (CheckpointError, DataError, StoreError) as error:
        say(f"No verdicts: {error}")  # all is trained and recorded; `gains` tries again
        return
    margin = sweep.settings.sweep.margin
    notes = (seeds_text(verdicts), units_of(sweep).note)
    for table in verdict_tables(verdicts, levels_of(sweep), margin, notes):
        say("\n" + to_markdown(table))


def _tag(
    sweep: FinishedSweep, verdicts: pd.DataFrame, store: Store, say: Callable[[str], None]
) -> None:
    """Tag the runs with verdicts, if the store can be reached."""
    try:
        tag_verdicts(sweep, verdicts, store)
    except StoreDown as error:
        say(
            f"The store is down: its runs have no tags of verdicts; the same command sets them. {error}"
        )


def report(
    prepared: Prepared, ran: Ran, words: Sequence[str], say: Callable[[str], None]
) -> list[Path]:
    """Write and print the tables of the trials that are done, and what the sweeper itself has found.

    Returns:
        every file written.
    """
    settings = prepared.settings
    done = [trial for trial in ran.plan.trials if trial.key in ran.outcome.done]
    if not done:
        return []
    if len(done) < len(ran.plan.trials):
        say(
            f"\n{len(done)} of {len(ran.plan.trials)} trials are done; the others are left out below."
        )
    sweep = open_sweep(settings)
    _, written = write_sweep(sweep, feeding(sweep, words, PUBLISHED), say)
    ran.recorder.attach([path for path in written if path.parent.name != "scores"], "results")
    if prepared.sweeper.looks or not prepared.sweeper.listens:  # a search compares nothing
        tell_verdicts(sweep, ran.recorder.store, say)
    found = prepared.sweeper.report(ran.standings, settings.results_folder)
    if found:
        say(found)
    say("\nTo browse every checkpoint: python -m fl3d ui")
    return written
