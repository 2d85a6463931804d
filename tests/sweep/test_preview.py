"""What ``plan`` says before anything is trained."""

import shutil
from pathlib import Path

import pytest

from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.core.errors import ConfigError, DataError
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.preview import preview
from tests.support import SMALL, train

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]


def shown(
    *words: str, spread: float | None = None, margin: float | None = None
) -> tuple[Plan, str]:
    """The plan of a sweep as it is typed, and what is printed of it."""
    asked = multirun(words)
    sweeper = build(asked.sweeper, "sweeper").proposer(asked.arguments, asked.compose)
    said: list[str] = []
    plan = preview(sweeper, InlineLauncher(), said.append, spread, margin)
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
    assert "14 trials in 16 stages, 16 to train (data: not simulated yet)" in text
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
    assert "a study of 5 trials, proposed as it goes" in text
    assert "One of them, with nothing shared, has 2 stages:" in text
    assert len(plan.trials) == 1
    assert list(tmp_path.iterdir()) == []


def test_what_is_done_of_the_trial_that_stands_in_for_a_studys_is_not_counted(
    simulated: Path, tmp_path: Path
) -> None:
    """A trial of gamma 0 was trained; which ones a study will propose nobody knows."""
    train(simulated, tmp_path, ["detector=voxelnet"])
    places = [f"data.root={simulated}", f"store.root={tmp_path / 'runs'}", "detector=voxelnet"]
    study = ["hydra/sweeper=optuna", "hydra.sweeper.n_trials=3", "loss.gamma=interval(0,5)"]
    _, text = shown(*SMALL, *places, *study)
    assert "a study of 3 trials, proposed as it goes" in text
    assert "done" not in text
    assert "4 of 4 without shared beginnings; 4 to train" in text


def test_a_baseline_that_is_no_level_is_refused_before_anything_runs(tmp_path: Path) -> None:
    places = [f"data.root={tmp_path}", f"store.root={tmp_path}"]
    with pytest.raises(ConfigError, match=r"sweep.baseline: no level '7'. Possible: 0, 2"):
        shown("loss.gamma=0,2", "sweep.baseline=7", *places)


def test_a_factor_that_does_not_vary_is_refused_before_anything_runs(tmp_path: Path) -> None:
    words = ["detector=voxelnet", "loss.gamma=0,2", "seed=0,1,2", "sweep.factor=loss.alpha"]
    message = r"^sweep\.factor: loss\.alpha has one level here \(1\).* Swept: loss\.gamma\. Name"
    with pytest.raises(ConfigError, match=message):
        shown(*words, *places(tmp_path))
    assert list(tmp_path.iterdir()) == []
    shown(*words[:1], *words[2:], *places(tmp_path))  # replicates of one level: nothing else varies


def places(root: Path) -> list[str]:
    return [f"store.root={root / 'runs'}", f"results={root / 'results'}"]


@pytest.mark.parametrize("where", [(), ("data.root=/nowhere",)], ids=["no root", "no folder"])
def test_kitti_is_planned_before_it_is_there(where: tuple[str, ...], tmp_path: Path) -> None:
    """3712 frames at batch 1 are 30 * 3712 steps a stage; as many stages as with the frames."""
    words = ["+sweep=gamma", "data=kitti", "profile=paper", *where, *places(tmp_path)]
    plan, text = shown(*words)
    assert "14 trials in 16 stages, 16 to train (data: not there yet: " in text
    assert "3712 frames to train, 3769 to validate)" in text
    assert ("data.root=FOLDER" if not where else "/nowhere: is no KITTI folder") in text
    assert {stage.steps for stage in plan.stages.values()} == {30 * 3712}
    for part in ("epochs  480 of 840", "time ", "FLOPs ", "disk "):
        assert f"  {part}" in text
    assert "done" not in text.replace("seeds that are done here", "")
    assert not any(key in text for key in plan.stages)  # they are of other data
    assert list(tmp_path.iterdir()) == []


def test_smaller_profiles_take_a_part_of_a_split(tmp_path: Path) -> None:
    words = ["detector=voxelnet", "loss.gamma=0,2", "profile=quick", *places(tmp_path)]
    _, text = shown(*words, "data=kitti")
    assert "1200 frames to train, 300 to validate" in text
    _, text = shown(*words, "data=kitti_sample")
    assert "22 frames to train, 10 to validate" in text


def test_a_detector_that_needs_2d_boxes_is_planned_without_them(tmp_path: Path) -> None:
    _, text = shown("+sweep=gamma_fconvnet", "data=kitti", "profile=paper", *places(tmp_path))
    assert "7 trials in 14 stages, 14 to train" in text


def test_a_folder_that_lacks_clouds_is_planned_by_its_lists(
    simulated: Path, tmp_path: Path
) -> None:
    """What was trained on the whole folder is not called done: nobody can tell any more."""
    root = tmp_path / "data"
    shutil.copytree(simulated, root)
    train(root, tmp_path, *POINTS)
    words = [*SMALL, *places(tmp_path), f"data.root={root}", "detector=voxelnet", "loss.gamma=0,2"]
    whole, text = shown(*words)
    assert "3 stages; 3 done, 0 to train" in text
    (root / "training" / "velodyne" / "000007.bin").unlink()
    plan, text = shown(*words)
    assert "3 stages, 3 to train (data: not there yet: " in text
    assert "000007.bin: no such file; 6 frames to train, 4 to validate)" in text
    assert not set(plan.stages) & set(whole.stages)
    (root / "ImageSets" / "val.txt").write_text("frame 7\n")
    with pytest.raises(DataError, match="is not one frame's name"):  # it is there, and wrong
        shown(*words)


def test_a_split_that_nobody_knows_needs_its_size(tmp_path: Path) -> None:
    words = ["detector=voxelnet", "loss.gamma=0,2", "data=kitti", "profile=paper"]
    words += ["data.val_split=mine", *places(tmp_path)]
    message = r"data.val_split=mine: how many frames .* give data.val_frames=N.*trainval"
    with pytest.raises(ConfigError, match=message):
        shown(*words)
    _, text = shown(*words, "data.val_frames=50")
    assert "3712 frames to train, 50 to validate" in text
    with pytest.raises(
        ConfigError, match=r"data\.val_frames: '0' is not a whole number of at least 1"
    ):
        shown(*words, "data.val_frames=0")
