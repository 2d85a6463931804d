"""docs/new_detector.md, done: a fifth detector is one file and one YAML."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fl3d.api.training import train
from fl3d.config.compose import CONF, compose_config
from fl3d.runs.plans import read_plan
from fl3d.sweep.sweepers.grid import Listed, point_of
from tests.support import SMALL

DOCUMENT = Path(__file__).parent.parent / "docs" / "new_detector.md"


def test_the_documents_detector_trains_scores_and_tabulates(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = re.search(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert found is not None
    conf = tmp_path / "conf"
    shutil.copytree(CONF, conf)
    text = found[1].replace(
        "fl3d.detectors.height_map.HeightMap", "tests.example_detector.HeightMap"
    )
    (conf / "detector" / "height_map.yaml").write_text(text)
    monkeypatch.setattr("fl3d.config.places.CONF", conf)

    places = [
        f"data.root={simulated}",
        f"store.root={tmp_path / 'runs'}",
        f"results={tmp_path / 'results'}",
    ]
    shared = [*SMALL, *places, "detector=height_map", "+sweep=gamma", "schedule.epochs.warmup=2"]
    words = [f"loss.gamma={gamma}" for gamma in (0, 2)]
    points = [point_of([word], compose_config([*shared, word])) for word in words]
    said: list[str] = []
    inline = {"_target_": "fl3d.sweep.launchers.inline.InlineLauncher"}
    train(Listed(points), inline, places, said.append)
    plan = read_plan(tmp_path / "runs" / "plans" / "gamma-simulated-tiny.json")
    assert len(plan.stages) == 3  # the warm-up is shared
    assert {trial.group for trial in plan.trials} == {"HeightMap"}
    (table,) = (line for line in said if "Last models of HeightMap" in line)
    assert "| 2 | 1 |" in table
    scores = (tmp_path / "results" / "simulated-tiny" / "scores" / "gamma.csv").read_text()
    assert scores.count(",HeightMap,HeightMap,") == 2 * 4  # of two epochs each, warm-up and focal


def test_a_detector_and_a_loss_in_a_folder_of_the_users(simulated: Path, tmp_path: Path) -> None:
    """Section 4, as a user types it: nothing of it lies in fl3d, and the loss has no gamma."""
    section = DOCUMENT.read_text().partition("## 4.")[2]
    loss, detector = (
        re.search(rf"```{kind}\n(.*?)```", section, re.DOTALL) for kind in ("python", "yaml")
    )
    assert loss is not None
    assert detector is not None
    mine = tmp_path / "mine"
    (mine / "detector").mkdir(parents=True)
    shutil.copy(Path(__file__).parent / "example_detector.py", mine / "height_map.py")
    (mine / "margin_loss.py").write_text(loss[1])
    (mine / "detector" / "height_map.yaml").write_text(detector[1])
    line = re.search(r"python -m fl3d (-m .*)", section)
    assert line is not None
    words = [*line[1].split(), *SIZE, f"data.root={simulated}"]
    done = fl3d(words, tmp_path)
    assert done.returncode == 0, done.stderr
    assert "| margin | seeds |" in done.stdout
    (why,) = re.findall(r"python -m fl3d gains", section)
    assert why
    found = fl3d(["why", "last", "loss.margin=0.5", "3d/moderate", *words[1:]], tmp_path)
    assert "scored now" in found.stdout, found.stderr
    kept = [word for word in words if "scratch" not in word]
    wrong = fl3d([*kept, "schedule=two_phase"], tmp_path)
    assert wrong.returncode == 2
    assert "schedule.stages.warmup sets loss.gamma" in wrong.stderr
    wrong = fl3d(["plan", "--config-dir", "mine", "detector=heigth_map"], tmp_path)
    assert "Did you mean 'height_map'?" in wrong.stderr


SIZE = (
    *("profile=tiny", "data.generate=false", "data.cache_frames=10", "schedule.frames_per_epoch=2"),
    *("schedule.stages.scratch.epochs=1", "hydra.launcher.slots=1"),
)


def fl3d(words: list[str], folder: Path) -> subprocess.CompletedProcess[str]:
    """Run fl3d as a user does, in a folder of theirs."""
    words = [word.replace("seeds=3", "seeds=1") for word in words]
    command = [sys.executable, "-m", "fl3d", *words]
    return subprocess.run(
        command,
        capture_output=True,
        text=True,
        cwd=folder,
        env={**os.environ, "PYTHONPATH": str(CONF.parent)},
        check=False,
        timeout=600,
    )


def test_every_part_of_the_contract_is_in_the_document() -> None:
    from fl3d.detectors.base import Detector

    text = DOCUMENT.read_text()
    for name in sorted(Detector.__abstractmethods__):
        assert f"`{name}(" in text
