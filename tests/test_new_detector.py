"""docs/new_detector.md, done: a fifth detector is one file and one YAML."""

import re
import shutil
from pathlib import Path

import pytest

from fl3d.commands.train import train
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
    monkeypatch.setattr("fl3d.config.compose.CONF", conf)

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


def test_every_part_of_the_contract_is_in_the_document() -> None:
    from fl3d.detectors.base import Detector

    text = DOCUMENT.read_text()
    for name in sorted(Detector.__abstractmethods__):
        assert f"`{name}(" in text
