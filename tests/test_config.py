"""Configs: every file composes and builds; slips are answered with what there is; commands."""

import os
import pkgutil
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from omegaconf import OmegaConf

from fl3d import commands
from fl3d.cli import COMMANDS, TRAIN
from fl3d.config.compose import CONF, compose_config, multirun
from fl3d.config.objects import build, locate
from fl3d.core.errors import ConfigError
from fl3d.core.typed import check_types
from fl3d.evaluation.protocol import Protocol
from fl3d.inference.load import build_detector
from fl3d.training.build import build_optimizer
from fl3d.training.command import command_of, is_command

ROOT = CONF.parent
FILES = sorted(
    Path(folder) / name
    for folder, _, names in os.walk(CONF, followlinks=True)  # conf/sweep is a link
    for name in names
    if Path(folder) != CONF and "hydra" not in Path(folder).relative_to(CONF).parts
)


def run(*arguments: str, cwd: Path = ROOT) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "fl3d", *arguments]
    return subprocess.run(
        command, capture_output=True, text=True, cwd=cwd, check=False, timeout=120
    )


@pytest.mark.parametrize("path", FILES, ids=lambda p: str(p.relative_to(CONF)))
def test_every_file_composes_and_builds(path: Path) -> None:
    group, *rest = path.relative_to(CONF).with_suffix("").parts
    if group == "size":
        overrides = [f"detector={rest[0]}", f"profile={rest[1]}"]
    else:
        overrides = [f"{'+' if group == 'sweep' else ''}{group}={'/'.join(rest)}"]
    config = compose_config(overrides)
    if is_command(config):  # of a program that only the user has
        with pytest.raises(ConfigError, match=r"detector\.name: not given"):
            command_of(config["detector"])
        assert config["protocol"]["name"] == "kitti"
        return
    with torch.device("meta"):
        detector = build_detector(config)
    assert build_optimizer(config, detector).param_groups[0]["lr"] > 0
    assert Protocol(**config["protocol"]).id


def test_a_sweeps_trials_are_composed_as_hydra_composes_each() -> None:
    """Trials that differ in plain values share a composition; the result is Hydra's own."""
    points = [
        ["detector=fcn3d", "loss.gamma=0.5", "seed=3"],
        ["detector=fcn3d", "loss.gamma=2", "schedule.epochs.focal=4", "optimizer.lr=1e-3"],
        [
            "detector=voxelnet",
            "+schedule.stages.focal.set.loss.alpha=2",
            "protocol.ignore_beyond=null",
        ],
        [
            "schedule=from_scratch",
            "data.train_frames=7",
            "detector.heading_fold=null",
            "store.root='a b'",
        ],
    ]
    shared = multirun(["profile=quick", "hydra/launcher=inline"])
    for point in points:
        assert shared.compose(point) == compose_config(["profile=quick", *point])


def test_every_sweep_says_what_it_asks_and_which_command_runs_it() -> None:
    for path in (ROOT / "sweeps").glob("*.yaml"):
        text = path.read_text()
        config = compose_config([f"+sweep={path.stem}"])
        assert config["sweep"]["name"] == path.stem
        assert config["sweep"]["question"]
        assert f"make sweep-{path.stem}" in text
        assert "Cost:" in text


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("loss.gama=2", r"no key 'gama' in 'loss'. Did you mean 'gamma'\? Possible: .*alpha.*beta"),
        ("detector=voxlnet", r"no such file in conf/detector. Did you mean 'voxelnet'\?"),
        ("los.gamma=2", r"no key or group 'los'. Did you mean 'loss'\?"),
        ("profile=slow", "Possible: paper, quick, standard, tiny"),
        (
            "schedule.stages.focall.epochs=3",
            r"no key 'focall' in 'schedule.stages'. Did you mean 'focal'\?",
        ),
        ("loss.gamma=[", "'loss.gamma=\\[' is not KEY=VALUE"),
    ],
)
def test_misspellings_are_answered_with_what_there_is(override: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        compose_config([override])


def test_a_key_that_a_class_does_not_take_is_refused() -> None:
    config = compose_config(["+loss.gama=2"])
    with pytest.raises(ConfigError, match=r"loss: .*gama"):
        build_detector(config)


def test_a_target_that_does_not_exist_is_refused() -> None:
    with pytest.raises(ConfigError, match="nowhere"):
        build({"_target_": "fl3d.nowhere.Nothing"}, "detector")


def test_overrides_overrule_what_a_profile_sets_for_a_detector() -> None:
    config = compose_config(
        ["detector=fcn3d", "profile=quick", "detector.channels=[4,4,4,4]", "optimizer.lr=0.5"]
    )
    assert config["detector"]["channels"] == [4, 4, 4, 4]
    assert config["optimizer"]["lr"] == 0.5


@pytest.mark.parametrize(("profile", "cut"), [("paper", 0.994), ("standard", 0), ("quick", 0)])
def test_table_v_is_cut_as_the_paper_cuts_it(profile: str, cut: float) -> None:
    config = compose_config(["+sweep=loss_form", f"profile={profile}", "loss=original"])
    assert config["protocol"]["score_threshold"] == cut


def test_the_original_loss_is_the_left_side_of_the_equations() -> None:
    """Table V: no normalisation, no weights but eta = 0.1, whatever the detector's own are."""
    loss = compose_config(["detector=fcn3d", "loss=original"])["loss"]
    assert (loss["normalize"], loss["alpha"], loss["beta"], loss["eta"]) == (False, 1.0, 1.0, 0.1)
    assert loss["regression"] == "square"


def test_the_command_line_shows_a_job_and_trains_nothing(tmp_path: Path) -> None:
    done = run("detector=fcn3d", "loss.gamma=2", "--cfg", "job")
    assert done.returncode == 0
    assert "gamma: 2" in done.stdout


def test_every_command_is_a_file_and_every_file_a_command() -> None:
    files = {module.name for module in pkgutil.iter_modules(commands.__path__)}
    assert files == {*COMMANDS, TRAIN, "parsing"}  # parsing: what the commands share


def test_help_teaches() -> None:
    done = run("--help")
    assert done.returncode == 0
    assert "python -m fl3d -m +sweep=gamma" in done.stdout
    for command in COMMANDS:
        one = run(command, "--help")
        assert one.returncode == 0
        assert command in one.stdout
        if command in ("gains", "tables", "figures", "rescore"):
            assert f"example: python -m fl3d {command} " in one.stdout


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["loss.gama=2"], "Did you mean 'gamma'?"),
        (["-m", "loss.gama=2"], "Did you mean 'gamma'?"),
        (["-m", "+sweep=gamam"], "Did you mean 'gamma'?"),
        (
            ["tabels", "+sweep=gamma"],
            "'tabels' is neither KEY=VALUE nor a command. Did you mean 'tables'?",
        ),
        (["-m", "detector=fcn3d,voxelnet", "detector.x_shift=0.1"], "x_shift"),
        (["stage", "runs/stages/typo"], "no such file"),
        (["data=kitti"], "data.root=FOLDER"),
        (
            # results=: a checkout in which the sweep was run has its scores in out/
            [
                "verify",
                "+sweep=gamma",
                "--from-weights",
                "profile=tiny",
                "store.root=/nowhere",
                "results=/nowhere",
            ],
            "run the sweep first",
        ),
    ],
    ids=" ".join,
)
def test_slips_are_answered_without_a_traceback(arguments: list[str], message: str) -> None:
    done = run(*arguments)
    assert done.returncode == 2
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert "Error executing job" not in done.stderr


@pytest.mark.parametrize(
    "path", ["/a/da[ta]", "/a/x=y", "/données", "/数据", "/it's", '/a"b', "/#1", "/a{b}"]
)
def test_a_path_that_hydra_does_not_read_is_told_how_to_be_typed(path: str) -> None:
    with pytest.raises(ConfigError, match="To give it as text, quote it twice: ") as raised:
        compose_config([f"data.root={path}"])
    (word,) = shlex.split(str(raised.value).partition("quote it twice: ")[2])
    assert compose_config([word])["data"]["root"] == path


@pytest.mark.parametrize(
    "path", sorted((CONF / "hydra" / "launcher").glob("*.yaml")), ids=lambda path: path.stem
)
def test_every_launchers_own_values_fit_its_class(path: Path) -> None:
    """Also of those that need a package or a service that is not here: SLURM's empty list was refused."""
    section = OmegaConf.to_container(OmegaConf.load(path), resolve=False)
    assert isinstance(section, dict)
    kind = locate(section.pop("_target_"), "hydra.launcher._target_")
    plain = {key: value for key, value in section.items() if "${" not in str(value)}
    check_types(kind, plain, "hydra.launcher")
