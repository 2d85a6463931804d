"""What Hydra composes is what is trained: order and overlap of words, beside Hydra's own composition."""

from typing import Any

import pytest
from hydra import compose, initialize_config_dir
from hydra._internal.core_plugins.basic_sweeper import BasicSweeper
from hydra.core.override_parser.overrides_parser import OverridesParser
from omegaconf import OmegaConf

from fl3d.config.compose import CONF, compose_config, multirun
from fl3d.core.errors import ConfigError
from fl3d.sweep.sweepers.base import Point
from fl3d.sweep.sweepers.grid import grid

PLACE = "+schedule.stages.focal.set.loss.alpha"


def points(words: list[str]) -> list[Point]:
    """The trials of a sweep's words, as ``plan`` and the sweep itself lay them out."""
    read = multirun(words)
    return list(grid(read.sweeper["params"], read.arguments, read.compose).first())


def hydras(*trials: list[str]) -> list[dict[str, Any]]:
    """What Hydra's compose API makes of each trial's words."""
    with initialize_config_dir(str(CONF), version_base="1.3"):
        composed = [compose("config", overrides=words) for words in trials]
    return [OmegaConf.to_container(one, resolve=True) for one in composed]  # type: ignore[misc]


def split(words: list[str]) -> list[list[str]]:
    """The trials that Hydra's basic sweeper makes of words."""
    overrides = OverridesParser.create().parse_overrides(words)
    (trials,) = BasicSweeper.split_arguments(overrides, max_batch_size=None)
    return trials


@pytest.mark.parametrize(
    "words",
    [
        ["loss.gamma=0", "++loss.gamma=1,2"],
        ["++loss.gamma=1,2", "loss.gamma=0.5", "loss.alpha=3,4"],
        ["optimizer.lr=0.5", "optimizer={lr:0.1},{lr:0.2}"],
        ["optimizer={lr:0.1},{lr:0.2}", "+optimizer.betas=[0.5,0.9]"],
        ["schedule.epochs.focal=1", "schedule.epochs={focal:3},{focal:4}"],
        ["schedule.epochs={focal:3},{warmup:4}", "schedule.epochs.focal=1"],
        ["loss.gamma=5", "loss=original,enhanced", "loss.alpha=2"],  # groups first, then keys
        ["detector.heading_fold=1", "detector=fcn3d,voxelnet", "optimizer.lr=0.5,0.25"],
        ["loss.gamma=1,2", "loss={gamma:3}"],
        ["~loss.alpha", "+loss.alpha=2,3"],
        [f"{PLACE}=1", f"{PLACE.lstrip('+')}=2,3"],
        ["loss.gamma=0,1", "~loss.sigma", "seed=3", "sweep.question='a,b'"],
    ],
    ids=" ".join,
)
def test_a_sweeps_trials_are_those_of_hydras_own_sweeper(words: list[str]) -> None:
    ours = [point.config for point in points(words)]
    theirs = [one for n, one in enumerate(hydras(*split(words))) if one not in ours[:n]]
    assert [one for n, one in enumerate(ours) if one not in ours[:n]] == theirs


@pytest.mark.parametrize(
    ("words", "gammas"),
    [
        (["loss.gamma=1,2", "loss.gamma=3"], [3]),
        (["loss.gamma=1,2", "++loss.gamma=3"], [3]),
        (["loss.gamma=3", "loss.gamma=1,2"], [1, 2]),
        (["loss.gamma=1,2", "loss.gamma=3,4"], [3, 4]),
        # Hydra's sweeper would leave the word in the place of the first; its --cfg job says 2, and so does this.
        (["loss.gamma=1", "loss={gamma:3}", "loss.gamma=2"], [2]),
        (["+sweep=gamma", "detector=fcn3d", "++loss.gamma=3"], [3]),
        (["+sweep=gamma", "detector=fcn3d", "++loss.gamma=3,4"], [3, 4]),
        (["+sweep=gamma", "detector=glob(fcn*)", "loss.gamma=range(1,3)"], [1, 2]),
        (["detector=fcn3d,voxelnet", "detector=fcn3d"], [0]),
    ],
    ids=lambda value: " ".join(value) if isinstance(value[0], str) else "",
)
def test_a_later_word_overrules_an_earlier_one(words: list[str], gammas: list[float]) -> None:
    found = points(words)
    assert [point.config["loss"]["gamma"] for point in found] == gammas
    if "loss.gamma" in found[0].values:
        assert [point.values["loss.gamma"] for point in found] == gammas


@pytest.mark.parametrize("word", ["seed=0,0", "loss.gamma=2.0,2.0", "loss.gamma=1,'1.0'"])
def test_a_value_that_is_typed_twice_is_no_slip(word: str) -> None:
    assert len(points([word])) == 2


def test_the_words_of_one_trial_are_what_hydra_shows() -> None:
    words = [
        "schedule.epochs.focal=1",
        "schedule.epochs={focal:3}",
        "loss.gamma=0",
        "++loss.gamma=2",
    ]
    (theirs,) = hydras(words)
    assert compose_config(words) == theirs
    (trial,) = points(words)
    assert trial.config == theirs


def test_a_key_that_is_swept_twice_in_parts_is_refused() -> None:
    with pytest.raises(ConfigError, match="optimizer is swept twice"):
        points(["optimizer={lr:1},{lr:2}", "optimizer={betas:[0.5,0.9]},{betas:[0.9,0.9]}"])


def test_a_group_left_out_is_the_configs_own_default() -> None:
    """``loss`` is null in the main config; Hydra itself takes no null for a group."""
    assert compose_config(["loss=null"]) == compose_config([])
    own, original = points(["loss=null,original"])
    assert own.config == compose_config([])
    assert own.values == {"loss": None}
    assert original.config["loss"]["normalize"] is False


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["detector=null"],
            "detector=null: no such file in conf/detector. Possible: command, fcn3d",
        ),
        (["~profile"], "~profile: a trial needs one. Possible: paper, quick"),
        (["loss.gamma=glob(*)"], "glob.* names files of a group, and loss.gamma is none"),
        (["loss=glob(*),null"], "glob.* stands alone; beside other values name the files"),
        (["detector=glob(z*)"], "matches no file of the group. Possible: command, fcn3d"),
        (
            ["loss.gamma=2,2.0"],
            "^loss.gamma=2,2.0: 2.0 is the same value as 2, and so the same training",
        ),
        (["optimizer.lr=1e-3,1,0.001"], "0.001 is the same value as 1e-3, and so"),
        (["loss.gamma=choice(0, 1, 1.)"], "1. is the same value as 1, and so"),
        (["loss.gamma=range(0,0)"], "holds no value; range.0,3. is 0,1,2"),
        (["loss.gamma=range(0,1,0)"], "no range of numbers"),
        (["loss.gamma=range(0,1e9)"], "more than 10000 values"),
        (["loss.gamma=range(0,999)", "seed=range(0,999)"], "998001 trials, and 100000 are"),
        (["loss.gamma=${nope}"], "Interpolation key 'nope' not found"),
        (["loss.gamma=${nope},1"], "Interpolation key 'nope' not found"),
        (["hydra.launcher.slots=${nope}"], "hydra.launcher.*'nope' not found"),
        (["hydra/launcher=basic"], "hydra/launcher=basic: no such file .* Possible: inline, local"),
        (["hydra/sweeper=basic"], "hydra/sweeper=basic: no such file .* Possible: grid, optuna"),
        (["hydra.launcher.slot=2"], "no key 'slot' in 'hydra.launcher'. Did you mean 'slots'"),
        (["hydra.launcher.slots=1,2"], "Sweeping over Hydra's configuration is not supported"),
        (["hydra.launcher=null"], "hydra.launcher: null, but it is a section"),
        (["hydra/job_logging=foo"], "Available options in 'hydra/job_logging': default, disabled"),
        (["+hydra.foo=1"], "no key 'foo' in 'hydra'"),
        (["+loss.gamma=1"], r"An item is already at 'loss.gamma'.* remove \+ prefix"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_words_that_cannot_be_are_refused_in_one_line(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message) as raised:
        points(words)
    assert "\n" not in str(raised.value)
