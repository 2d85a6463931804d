"""Studies whose trials are trained by a formula."""

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

from fl3d.config.compose import compose_config
from fl3d.core.records import Config, Trial
from fl3d.sweep.sweepers.base import Point, Standing, TrialState
from fl3d.sweep.sweepers.space import parse_space
from fl3d.sweep.sweepers.study import Study

AP = "ap_3d_r40/moderate"
EASY = "ap_3d_r40/easy"
RANDOM = {"_target_": "optuna.samplers.RandomSampler", "seed": 0}
GAMMA = {"loss.gamma": "interval(0,5)"}
NAME = "search-made-up-tiny"


@lru_cache
def composed(*overrides: str) -> Config:
    names = ["sweep.name=search", "data.name=made-up", "profile=tiny"]
    return compose_config([*names, *overrides])


def base(root: Path, *overrides: str) -> Config:
    config = composed(*overrides)
    return {**config, "store": {**config["store"], "root": str(root)}}


def key(point: Point) -> str:
    return " ".join(point.overrides)


def make(
    root: Path, params: dict[str, object] = GAMMA, words: Sequence[str] = (), **settings: Any
) -> Study:
    """A study whose trials are keyed by their overrides; ``words`` are of its config."""

    def compose(overrides: Sequence[str]) -> Config:
        return {"overrides": list(overrides)}

    settings = {"sampler": RANDOM, **settings}
    study = Study(base(root, *words), parse_space(params, []), compose, **settings)
    study.open(key)
    return study


def trial_of(point: Point) -> Trial:
    return Trial(
        key=key(point),
        overrides=point.overrides,
        values=point.values,
        config=point.config,
        stages=(key(point),),
        first_own_step=0,
        detector="VoxelNet",
        group="VoxelNet",
        level=key(point),
        seed=0,
    )


class World:
    """Trials that learn as told: ``worth`` gives the AP of a point at an epoch."""

    def __init__(self, study: Study, slots: int, epochs: int = 4) -> None:
        self.study = study
        self.slots = slots
        self.epochs = epochs
        self.standings: dict[str, Standing] = {}
        self.trained: list[str] = []

    def worth(self, point: str, epoch: int) -> dict[str, float]:
        gamma = float(point.split()[0].partition("=")[2])
        return {AP: 50 - gamma + epoch, EASY: 50 + gamma + epoch}

    def tick(self) -> None:
        for name, one in list(self.standings.items()):
            if one.state is TrialState.RUNNING:
                self.trained.append(name)
                epoch = len(one.curve) + 1
                curve = {**one.curve, epoch: self.worth(name, epoch)}
                state = TrialState.DONE if epoch == self.epochs else TrialState.RUNNING
                self.standings[name] = Standing(one.trial, state, curve, self.epochs)
        advice = self.study.advise(self.standings, self.slots)
        for point in advice.points:
            trial = trial_of(point)
            self.standings[trial.key] = Standing(trial, TrialState.RUNNING, {}, self.epochs)
        for name in advice.stop:
            one = self.standings[name]
            self.standings[name] = Standing(one.trial, TrialState.STOPPED, one.curve, self.epochs)

    def run(self, ticks: int = 200) -> "World":
        for _ in range(ticks):
            self.tick()
        if ticks == 200:
            assert all(one.state is not TrialState.RUNNING for one in self.standings.values())
        return self


def states(study: Study) -> list[str]:
    return [trial.state.name for trial in study.study.get_trials()]
