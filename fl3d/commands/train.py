"""``python -m fl3d KEY=VALUE ...``: train one trial; with -m a sweep. Hydra reads the command line."""

from __future__ import annotations

import os
import shlex
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

import pandas as pd

from fl3d.analysis.found import sweep_verdicts
from fl3d.config.checks import check_overrides
from fl3d.config.command_line import Line, read_line
from fl3d.config.compose import resolve, section, task_words
from fl3d.config.hydra_app import HYDRAS, for_hydra, hydra_says
from fl3d.config.objects import build
from fl3d.config.overrides import parse
from fl3d.config.places import CONF, MAIN, PUBLISHED, own_folders
from fl3d.core import interrupts
from fl3d.core.errors import (
    CheckpointError,
    ConfigError,
    DataError,
    Fl3dError,
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
from fl3d.runs.finished import FinishedSweep, levels_of, open_sweep
from fl3d.runs.units import units_of
from fl3d.store.base import Store
from fl3d.sweep.by_hand import name_trial
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.run import Ran, run_sweep
from fl3d.sweep.setup import Prepared, prepare_sweep
from fl3d.sweep.sweepers.base import Sweeper
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.sweep.verdict_tags import tag_verdicts

SLIP = 2  # exit code of a mistake, see ``cli``
SCRIPT = "fl3d"  # what pip installs; a shell completes its words, for it completes by a command's first word


def run(arguments: list[str]) -> None:
    """Hand a command line to Hydra, which calls back with a trial, or, under -m, through its sweeper plugins.

    Raises:
        ConfigError: an option or an override that does not fit.
        StageFailed: a stage failed; all others are trained and scored.
    """
    import hydra
    from omegaconf import DictConfig

    line = read_line(arguments)
    words = list(line.overrides)
    if not line.is_completion:
        check_overrides(words)
        _refuse_sweep_of_one(line)
        words = for_hydra(words)
    warnings.filterwarnings("ignore", message=".*hydra.*", category=DeprecationWarning)
    ended: list[BaseException] = []

    @hydra.main(config_path=str(CONF), config_name=MAIN, version_base="1.3")
    def task(config: DictConfig) -> None:
        try:
            _one_trial(config)
        except (Fl3dError, KeyboardInterrupt) as error:
            ended.append(error)  # past Hydra, which would print a message of its own

    # Hydra would print an error and a hint of its own; with the full error on, ours comes through.
    os.environ["HYDRA_FULL_ERROR"] = "1"
    own = [word for folder in own_folders() for word in ("--config-dir", str(folder))]
    sys.argv = [SCRIPT if line.is_completion else "python -m fl3d", *line.options, *words, *own]
    try:
        task()
    except HYDRAS as error:
        raise ConfigError(hydra_says(error)) from None
    except RuntimeError as error:
        if not str(error).startswith("Invalid plugin"):
            raise
        raise ConfigError(
            f"hydra.sweeper._target_, hydra.launcher._target_: {error}; choose them by hydra/sweeper=NAME and "
            "hydra/launcher=NAME"
        ) from None
    except SystemExit as error:
        # Hydra says that there is no such package, and ends as if a job had failed.
        error.code = SLIP if line.is_look and error.code == 1 else error.code
        raise
    if ended:
        raise ended[0]


def _refuse_sweep_of_one(line: Line) -> None:
    """Refuse several values where one trial is meant.

    Raises:
        ConfigError: saying how a sweep, a list and a text are typed.
    """
    is_sweep = line.is_multirun or any(word.startswith("hydra.mode=") for word in line.overrides)
    for word in line.overrides:
        if not is_sweep and parse(word).is_sweep_override():
            key, _, value = word.partition("=")
            as_text = shlex.quote(f'{key}="{value}"')
            raise ConfigError(
                f"{word}: several values are a sweep: python -m fl3d -m ...; a list is typed {key}=[...], and a text "
                f"that looks so {as_text}"
            )


def _one_trial(config: object) -> None:
    from hydra.core.hydra_config import HydraConfig

    hydra = HydraConfig.get()
    resolved = resolve(config)  # type: ignore[arg-type]
    words = task_words(hydra)
    files = [word for word in words if word.lstrip("+").startswith("sweep=")]
    if files:
        raise ConfigError(f"a sweep file is run with -m: python -m fl3d -m {files[0]}")
    name_trial(resolved)
    launcher = section(hydra, "launcher")
    train(Listed([point_of(words, resolved)]), launcher, words)


def train(
    sweeper: Sweeper, launcher: Config, words: Sequence[str], say: Callable[[str], None] = print
) -> None:
    """Run a sweep to its tables.

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
    say("\nTo browse every checkpoint: make ui")
    return written
