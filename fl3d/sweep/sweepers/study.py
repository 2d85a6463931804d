"""Trials by Optuna's ask and tell: same plan and launchers as a grid, pruned by checkpoints."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import optuna

from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError, options
from fl3d.core.records import Config
from fl3d.runs.layout import StoreFolder
from fl3d.store.opening import open_store
from fl3d.sweep.sweepers.base import Advice, Compose, Evidence, Point, Standing, Sweeper
from fl3d.sweep.sweepers.samplers import Samplers, make_pruner
from fl3d.sweep.sweepers.space import Space, parse_space
from fl3d.sweep.sweepers.study_asker import Asker
from fl3d.sweep.sweepers.study_left import Left
from fl3d.sweep.sweepers.study_opening import check_axes, directions, open_study
from fl3d.sweep.sweepers.study_points import Points
from fl3d.sweep.sweepers.study_report import report_study
from fl3d.sweep.sweepers.study_settings import StudySettings
from fl3d.sweep.sweepers.study_storage import alone, reached
from fl3d.sweep.sweepers.study_teller import Teller
from fl3d.sweep.sweepers.study_trials import Trials


class Study(Sweeper):
    """Asks an Optuna study for trials, as many at once as there are slots, and tells it their AP.

    A point that was proposed before is not trained again: it is told the same value. A trial that
    a dead sweep left running is told as failed, and its point is asked for again: its stages resume
    from their checkpoints. One that died before it had its point gets it now. Trials of sweeps that
    live, and of other stores, are left alone.

    Args:
        base: a config of the sweep.
        space: what is searched.
        compose: makes a config of overrides.
        settings: see ``StudySettings``.

    Raises:
        ConfigError: settings that cannot be used or do not go together.
    """

    listens = True

    def __init__(self, base: Config, space: Space, compose: Compose, **settings: Any) -> None:
        self.base = base
        self.settings = read_settings(base)
        self.asked = StudySettings(**settings)
        self.asked.check_with(self.settings, space)
        self.space = space
        self.swept = tuple(key.lstrip("+") for key in space.axes)
        self.compose = compose
        self.n_trials = self.asked.n_trials
        self.objectives = list(self.asked.objectives)
        named = self.asked.study_name
        self.name = self.settings.experiment if named is None else str(named)
        default = {"_target_": "optuna.samplers.TPESampler", "seed": base["seed"]}
        self.samplers = Samplers(dict(self.asked.sampler or default), space.axes)
        self.samplers.rehearse(directions(self.asked), make_pruner(self.asked.pruner))
        self._notes: list[str] = []
        self._print: Callable[[str], None] = self._notes.append  # until the sweep can print

    def first(self) -> Sequence[Point]:
        """None: what comes first depends on the study."""
        return ()

    def open(self, identify: Callable[[Point], str]) -> None:
        """Open the study, and take up what a dead sweep left.

        Where trials run under the lease of another machine, it is watched for a minute whether that lives.

        Raises:
            ConfigError: a value that would be proposed is refused, or the study was begun with other settings.
            StoreError: where it is kept is damaged or cannot be reached.
        """
        self.points = Points(self.space, self.compose, identify)
        self.points.try_examples()
        store = self.settings.store
        root = open_store(store.root, store.uri).id
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        with reached(self.name), alone(store.root, self.name):
            self.study = open_study(self.name, self.asked, self.settings, self.samplers, self._say)
            trials = Trials(self.study, root, self.settings.experiment)
            self.left = self._take_up(trials)
            if not trials.all():
                for point in self.asked.enqueue:
                    trials.enqueue(point)
        self.teller = Teller(trials, self.asked, self.left.known)
        self.asker = Asker(self.left, self.teller, self.n_trials, self._say)

    def _take_up(self, trials: Trials) -> Left:
        check_axes(trials, self.points.axes, self.samplers)
        self.points.order_as(trials.all())
        left = Left(trials, self.points, self.samplers)
        left.take_up(StoreFolder(self.settings.store.root), self._say)
        return left

    def consult(self, evidence: Evidence) -> None:
        """Say what was found in the study."""
        self._print = evidence.say
        for note in self._notes:
            evidence.say(note)
        self._notes.clear()

    def _say(self, text: str) -> None:
        self._print(text)

    def advise(self, standings: Mapping[str, Standing], slots: int) -> Advice:
        """Tell what has ended, prune, and ask for as many trials as there are free slots.

        Raises:
            StoreError: the study cannot be read or written now.
        """
        with reached(self.name):
            points, stop = self.left.hand_over()
            stop += self.teller.hear(standings)
            while len(self.teller.expected) < slots and self.asker.may_ask():
                point = self.asker.ask(standings)
                if point is not None:
                    points.append(point)
            return Advice(points, stop)

    def report(self, standings: Mapping[str, Standing], folder: Path) -> str:
        """Best trials, or the Pareto front; all trials go to a table in the folder."""
        name = self.settings.sweep.name
        text = report_study(self.study, self.objectives, list(self.points.axes), name, folder)
        n_points = self.samplers.n_points
        if n_points is not None and n_points < self.n_trials and self.asker.is_exhausted():
            text += f"\nAll {n_points} points were asked for; there are no more for n_trials={self.n_trials}.\n"
        return text


def study(
    params: Mapping[str, object], arguments: Sequence[str], compose: Compose, settings: Config
) -> Study:
    """The study of a sweep file and the command line.

    Args:
        params: see ``space.parse_space``.
        arguments: see ``space.parse_space``.
        compose: makes a config of overrides.
        settings: further arguments of ``Study``.
    """
    space = parse_space(params, arguments)
    own = {field.name for field in fields(StudySettings)}
    unknown = sorted(set(settings) - own)
    if unknown:
        raise ConfigError(
            f"hydra.sweeper.{unknown[0]}: a study has no such key. {options(unknown[0], sorted(own))} "
            "(A sweep file that names its own sweeper cannot be run by another: hydra/sweeper=... belongs to a grid)"
        )
    return Study(compose(space.fixed), space, compose, **settings)
