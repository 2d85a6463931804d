"""plan, why, verify and clean over one small finished sweep, and what retention leaves of it."""

import json
import os
import time
from pathlib import Path

import numpy as np
import pytest

from fl3d.cleaning import clean
from fl3d.config import multirun
from fl3d.data.kitti import KittiFolder
from fl3d.errors import ConfigError, StoreError
from fl3d.evaluation.detections import Detections, read_detections, write_detections
from fl3d.evidence import verify, why
from fl3d.pipeline import Sweep
from fl3d.preview import preview
from fl3d.records import StagePaths
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.training.checkpoints import last_state
from tests.support import SMALL, small_config, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]
GAMMA = ("+sweep=gamma", "schedule.stages.warmup.epochs=3", "store.keep_every=null")


@pytest.fixture(scope="module")
def finished(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Sweep, Path]:
    root = tmp_path_factory.mktemp("evidence")
    sweep = small_sweep(simulated, root, POINTS, *GAMMA)
    sweep.run(InlineLauncher())
    return sweep, root


def config(simulated: Path, root: Path) -> dict[str, object]:
    return small_config(simulated, root, *GAMMA)


def command(simulated: Path, root: Path) -> list[str]:
    places = [f"data.root={simulated}", f"store.root={root / 'runs'}", f"results={root / 'results'}"]
    return [*SMALL, *places, "schedule.stages.warmup.epochs=3"]


def test_a_plan_shows_what_is_done_and_what_would_run(finished: tuple[Sweep, Path], simulated: Path) -> None:
    sweep, root = finished
    said: list[str] = []
    before = sorted(root.rglob("*"))
    arguments = [*command(simulated, root), "detector=voxelnet", "loss.gamma=0,2,5"]
    plan = preview(multirun(arguments), said.append)
    text = "\n".join(said)
    assert "3 trials in 4 stages; 3 done, 1 to train" in text
    assert "epochs  9 of 15 without shared beginnings; 2 to train" in text
    assert "from stages measured here" in text
    assert text.count(", done  [") == 3
    assert set(sweep.plan.stages) < set(plan.stages)  # another sweep's stages are reused
    assert sorted(root.rglob("*")) == before


def test_the_papers_sweep_is_480_of_840_epochs(tmp_path: Path) -> None:
    said: list[str] = []
    preview(multirun(["+sweep=gamma", "profile=paper", f"data.root={tmp_path}", f"store.root={tmp_path}"]), said.append)
    text = "\n".join(said)
    assert "14 trials in 16 stages; 0 done, 16 to train (data: not simulated yet)" in text
    assert "epochs  480 of 840 without shared beginnings (FCN3D 240 of 420, VoxelNet 240 of 420)" in text
    assert list(tmp_path.iterdir()) == []


def test_a_study_is_planned_by_one_of_its_trials(tmp_path: Path) -> None:
    said: list[str] = []
    preview(multirun(["+sweep=gamma_search", f"data.root={tmp_path}", f"store.root={tmp_path}"]), said.append)
    assert any("A study of 5 trials" in line for line in said)
    assert list(tmp_path.iterdir()) == []


def test_why_follows_a_cell_to_its_files(finished: tuple[Sweep, Path], simulated: Path) -> None:
    sweep, root = finished
    said: list[str] = []
    why(config(simulated, root), "III", {"gamma": "2"}, "3d/moderate", said.append)
    text = "\n".join(said)
    trial = sweep.plan.trials[1]
    for key in trial.stages:
        assert key in text
    assert "DOES NOT MATCH" not in text
    assert text.count(", matches") == 2  # weights and detections
    assert "scored now" in text
    assert "NOT THE SAME" not in text
    run = sweep.store.client.search_runs([sweep.store.experiment(sweep.names.experiment, "")])
    assert any(one.info.run_id in text for one in run)


def test_why_says_what_was_possible(finished: tuple[Sweep, Path], simulated: Path) -> None:
    own = config(simulated, finished[1])
    with pytest.raises(ConfigError, match="no table 'VI'"):
        why(own, "VI", {"gamma": "2"}, "3d/moderate")
    with pytest.raises(ConfigError, match="gamma=7: no such row"):
        why(own, "III", {"gamma": "7"}, "3d/moderate")
    with pytest.raises(ConfigError, match="Did you mean '3d/moderate'"):
        why(own, "III", {"gamma": "2"}, "3d/modrate")
    with pytest.raises(ConfigError, match="several rows fit"):
        why(own, "III", {}, "3d/moderate")


def test_every_digit_comes_out_again_from_detections_and_from_weights(
    finished: tuple[Sweep, Path], simulated: Path
) -> None:
    said: list[str] = []
    verify(config(simulated, finished[1]), True, said.append)
    assert said[0].startswith("7 checkpoints of gamma-")
    assert int(said[1].split()[0]) >= 3


def test_a_changed_detection_is_found(finished: tuple[Sweep, Path], simulated: Path) -> None:
    sweep, root = finished
    paths = StagePaths(sweep.stages_root / sweep.plan.trials[0].key)
    step = paths.steps()[-1]
    whole = paths.detections(step).read_bytes()
    found = read_detections(paths.detections(step))
    labels = KittiFolder(simulated).frame(found.frame_ids[0]).labels
    cars = KittiFolder(simulated).frame(found.frame_ids[0]).calibration.boxes_to_velo(labels.boxes_cam)
    perfect = Detections(found.frame_ids, np.zeros(len(cars), np.int64), cars, np.ones(len(cars)))
    write_detections(paths.detections(step), perfect)
    try:
        with pytest.raises(StoreError, match=f"{paths.folder.name} step {step}: ap_"):
            verify(config(simulated, root), False)
    finally:
        paths.detections(step).write_bytes(whole)


def test_retention_keeps_last_and_best_and_every_score(finished: tuple[Sweep, Path]) -> None:
    sweep, _ = finished
    for key, stage in sweep.plan.stages.items():
        paths = StagePaths(sweep.stages_root / key)
        steps = paths.steps()
        assert len(steps) == stage.epochs
        kept = [step for step in steps if paths.weights(step).exists()]
        assert steps[-1] in kept
        assert len(kept) <= 2
        assert all(paths.detections(step).exists() for step in steps)
        found = last_state(paths)
        assert found is not None
        assert found[1].step == steps[-1]


def test_clean_shows_before_it_removes(finished: tuple[Sweep, Path]) -> None:
    sweep, _ = finished
    stray = sweep.root / "stages" / ".weights.pt.123.tmp"
    stray.write_bytes(b"x" * 1000)
    os.utime(stray, (time.time() - 9999, time.time() - 9999))
    orphan = sweep.stages_root / "voxelnet-focal-0000000000"
    orphan.mkdir()
    spec = json.loads(StagePaths(sweep.stages_root / sweep.plan.trials[0].key).spec.read_text())
    StagePaths(orphan).spec.write_text(json.dumps(spec))
    said: list[str] = []
    clean(sweep.root, None, delete=False, orphans=False, say=said.append)
    text = "\n".join(said)
    assert "temporary files" in text
    assert "--orphans takes them too" in text
    assert "Nothing was removed" in text
    assert stray.exists()
    clean(sweep.root, None, delete=True, orphans=False, say=said.append)
    assert not stray.exists()
    assert orphan.exists()
    clean(sweep.root, None, delete=True, orphans=True, say=said.append)
    assert not orphan.exists()
    assert all(StagePaths(sweep.stages_root / key).done.exists() for key in sweep.plan.stages)


def test_a_parent_whose_last_checkpoint_is_torn_is_mended(simulated: Path, tmp_path: Path) -> None:
    """The parent is done, its last weights are torn: it goes on from the checkpoint before, to the same bits."""
    common = ("schedule.stages.warmup.epochs=3", "store.keep_every=1")
    small_sweep(simulated, tmp_path, POINTS[:1], *common).run(InlineLauncher())
    sweep = small_sweep(simulated, tmp_path, POINTS, *common)
    parent = StagePaths(sweep.stages_root / sweep.plan.trials[0].stages[0])
    last = parent.steps()[-1]
    whole = parent.weights(last).read_bytes()
    parent.weights(last).write_bytes(whole[: len(whole) // 2])
    outcome = sweep.run(InlineLauncher())
    assert sorted(outcome.trained) == sorted([parent.folder.name, sweep.plan.trials[1].key])
    assert parent.weights(last).read_bytes() == whole
