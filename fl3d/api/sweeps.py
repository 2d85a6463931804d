"""Sweeps from Python: run one, open one, and what it has found as data frames and figures."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from functools import cached_property
from pathlib import Path

import pandas as pd
from matplotlib.figure import Figure

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged, judge_sweep
from fl3d.api.training import train, train_sweep
from fl3d.api.words import open_words, read_words
from fl3d.config.compose import compose_config, multirun
from fl3d.config.detector_names import spell_out_detectors
from fl3d.config.objects import build
from fl3d.config.overrides import parse
from fl3d.config.places import own_folders, search_also
from fl3d.config.seeds import spell_out_seeds
from fl3d.core.errors import CheckpointError, ConfigError, DataError, StoreError
from fl3d.papers.drawings import curve_figures, score_figures, verdict_figures
from fl3d.runs import opening
from fl3d.runs.drawn import ToDraw
from fl3d.runs.finished import FinishedSweep
from fl3d.sweep.by_hand import name_trial
from fl3d.sweep.sweepers.grid import Listed, point_of

WITHOUT_DETECTIONS = (CheckpointError, DataError, StoreError)


class Sweep:
    """A sweep that was run, as data frames and figures; everything is made when it is first asked for.

    Args:
        opened: the sweep as the commands read it; ``finished`` keeps it.
    """

    def __init__(self, opened: FinishedSweep) -> None:
        self.finished = opened

    def __repr__(self) -> str:
        one = self.finished
        return (
            f"<fl3d.Sweep {one.name}: {', '.join(one.factor)} at {len(one.levels)} levels in "
            f"{len(one.groups)} groups, {len(one.trials)} of {len(one.plan.trials)} trials done>"
        )

    @property
    def name(self) -> str:
        """Of the sweep."""
        return self.finished.name

    @property
    def levels(self) -> list[str]:
        """Labels of what is compared, the baseline among them."""
        return self.finished.levels

    @property
    def baseline(self) -> str:
        """The level that the others are held against."""
        return self.finished.baseline

    @cached_property
    def trials(self) -> pd.DataFrame:
        """A row a planned trial: ``trial``, ``detector``, ``group``, ``level``, ``seed``, ``done``, and its values."""
        done = {trial.key for trial in self.finished.trials}
        rows = [
            {
                "trial": trial.key,
                "detector": trial.detector,
                "group": trial.group,
                "level": trial.level,
                "seed": trial.seed,
                "done": trial.key in done,
                **trial.values,
            }
            for trial in self.finished.plan.trials
            if self.finished.is_asked(trial)
        ]
        return pd.DataFrame(rows)

    @property
    def scores(self) -> pd.DataFrame:
        """A row a trial and step: ``trial``, ``group``, ``level``, ``seed``, ``step``, and every AP in percent."""
        return self.finished.scores

    @cached_property
    def _made(self) -> Contributions:
        return Contributions(self.finished)

    @cached_property
    def _judged(self) -> Judged:
        return judge_sweep(self.finished, contributions=self._made)

    @property
    def gains(self) -> pd.DataFrame:
        """A row a group, level, metric, difficulty and average: AP and gain over the baseline, with 95 % intervals.

        Raises:
            StoreError: only its scores are here: intervals need stored detections.
            DataError: detections or labels cannot be read.
        """
        return self._judged.gains

    @property
    def verdicts(self) -> pd.DataFrame:
        """A row a group and level: ``verdict`` on the primary metric, its gain and interval, and seeds still needed.

        Raises:
            StoreError: only its scores are here: verdicts need stored detections.
            DataError: detections or labels cannot be read.
        """
        return self._judged.verdicts

    @cached_property
    def figures(self) -> Mapping[str, Figure]:
        """Figures by name: ``forest``, ``ap_over_level``, ``ap_over_steps``, ``ap_over_cut``, ``precision_recall``.

        Without stored detections only what scores alone can show. A notebook shows one where it is a cell's value.
        """
        made = {name: figure() for name, figure in self._figures().items()}
        return {name: one.figure for name, one in made.items() if one is not None}

    def _figures(self) -> dict[str, ToDraw]:
        try:
            judged = verdict_figures(self.finished, self._judged)
            return judged | curve_figures(self.finished, self._made)
        except (ConfigError, *WITHOUT_DETECTIONS) as error:
            warnings.warn(f"only the figures that need no detections: {error}", stacklevel=4)
            return score_figures(self.finished)


def open_sweep(*words: str, config_dir: Path | str | None = None) -> Sweep:
    """Open a sweep that was run before, or whose scores fl3d publishes.

    Args:
        words: those that it was started with, such as ``"+sweep=gamma", "seeds=3"``; of a sweep typed by hand some of
            them; values among them pick its trials. ``"store.root=FOLDER"`` says where it lies.
        config_dir: folder of your own YAMLs and modules, as ``--config-dir``; a process has one, from then on.

    Raises:
        ConfigError: a group, option, key or value that does not exist.
        StoreError: no trial of it is done here.
    """
    _search(config_dir)
    return Sweep(open_words(read_words(_spelled(words))))


def run(
    *words: str, say: Callable[[str], None] = print, config_dir: Path | str | None = None
) -> Sweep:
    """Train, score and tabulate a sweep or a single trial: ``fl3d -m WORDS``; what is done is reused.

    Args:
        words: as typed behind ``fl3d -m``: a sweep file (``"+sweep=gamma"``), or values
            (``"detector=voxelnet", "loss.gamma=0,1", "seeds=3"``). Without a key that has several values: one trial.
        say: prints a line for the user.
        config_dir: see ``open_sweep``.

    Returns:
        the sweep, opened.

    Raises:
        ConfigError: words that do not fit.
        StageFailed: a stage failed; all others are trained and scored.
    """
    _search(config_dir)
    spelled = _spelled(words)
    asked = multirun(spelled)
    if _is_sweep(spelled):
        settings = train_sweep(asked, build(asked.sweeper, "hydra.sweeper"), say)
        return Sweep(opening.open_sweep(settings))
    config = compose_config(spelled)
    name_trial(config)
    listed = Listed([point_of(spelled, config)])
    return Sweep(opening.open_sweep(train(listed, asked.launcher, spelled, say)))


def _search(config_dir: Path | str | None) -> None:
    """Look in the user's own folder too.

    Raises:
        ConfigError: there is no such folder, a file in it has the place of one of fl3d's, or there is another one.
    """
    if config_dir is None:
        return
    folder = Path(config_dir)
    others = [str(own) for own in own_folders() if own != folder.resolve()]
    if others:
        raise ConfigError(f"config_dir {folder}: this process has one already, {others[0]}")
    search_also(folder)


def _is_sweep(words: list[str]) -> bool:
    """Whether words name a sweep file, a sweeper, or a key with several values."""
    files = ("+sweep=", "sweep=", "hydra/sweeper=")
    return any(word.startswith(files) or parse(word).is_sweep_override() for word in words)


def _spelled(words: tuple[str, ...]) -> list[str]:
    """Words with ``seeds=5``, and detectors as tables write them, spelled out."""
    return list(spell_out_detectors(spell_out_seeds(words)))
