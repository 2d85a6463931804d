"""What ``plan`` says before anything is trained."""

from pathlib import Path

import pytest

from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.core.errors import ConfigError
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.preview import preview
from tests.support import SMALL, train

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]


def shown(*words: str) -> tuple[Plan, str]:
    """The plan of a sweep as it is typed, and what is printed of it."""
    asked = multirun(words)
    sweeper = build(asked.sweeper, "sweeper").proposer(asked.arguments, asked.compose)
    said: list[str] = []
    plan = preview(sweeper, InlineLauncher(), said.append)
    return plan, "\n".join(said)


def test_a_plan_shows_what_is_done_and_what_would_run(simulated: Path, tmp_path: Path) -> None:
    trained, _ = train(simulated, tmp_path, *POINTS)
    before = sorted(tmp_path.rglob("*"))
    places = [f"data.root={simulated}", f"store.root={tmp_path / 'runs'}"]
    plan, text = shown(*SMALL, *places, "detector=voxelnet", "loss.gamma=0,2,5")
    assert "3 trials in 4 stages; 3 done, 1 to train" in text
    assert "epochs  8 of 12 without shared beginnings; 2 to train" in text
    assert "from stages measured here" in text
    assert text.count(", done  [") == 3
    assert set(trained.stages) < set(plan.stages)  # another sweep's stages are reused
    assert sorted(tmp_path.rglob("*")) == before


def test_the_papers_sweep_is_480_of_840_epochs(tmp_path: Path) -> None:
    places = [f"data.root={tmp_path}", f"store.root={tmp_path}"]
    _, text = shown("+sweep=gamma", "profile=paper", *places)
    assert "14 trials in 16 stages; 0 done, 16 to train (data: not simulated yet)" in text
    epochs = "480 of 840 without shared beginnings (FCN3D 240 of 420, VoxelNet 240 of 420)"
    assert f"epochs  {epochs}" in text
    assert "guessed from the layers' dense FLOPs" in text
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "words",
    [
        ("+sweep=gamma_search",),
        ("hydra/sweeper=optuna", "hydra.sweeper.n_trials=5", "loss.gamma=interval(0,5)"),
    ],
    ids=["of a file", "as typed"],
)
def test_a_study_is_planned_by_one_of_its_trials(words: tuple[str, ...], tmp_path: Path) -> None:
    plan, text = shown(*words, f"data.root={tmp_path}", f"store.root={tmp_path}")
    assert "A study of 5 trials" in text
    assert len(plan.trials) == 1
    assert list(tmp_path.iterdir()) == []


def test_a_baseline_that_is_no_level_is_refused_before_anything_runs(tmp_path: Path) -> None:
    places = [f"data.root={tmp_path}", f"store.root={tmp_path}"]
    with pytest.raises(ConfigError, match=r"sweep.baseline: no level '7'. Possible: 0, 2"):
        shown("loss.gamma=0,2", "sweep.baseline=7", *places)
