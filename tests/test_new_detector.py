"""docs/new_detector.md, done: a fifth detector is one file and one YAML."""

import re
import shutil
from pathlib import Path

import pytest

from fl3d.config import CONF, compose_config
from fl3d.pipeline import Sweep
from fl3d.records import StagePaths
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.sweepers.base import Point
from fl3d.sweep.sweepers.grid import Listed
from tests.support import SMALL

DOCUMENT = Path(__file__).parent.parent / "docs" / "new_detector.md"


def test_the_documents_detector_trains_scores_and_tabulates(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    found = re.search(r"```yaml\n(.*?)```", DOCUMENT.read_text(), re.DOTALL)
    assert found is not None
    conf = tmp_path / "conf"
    shutil.copytree(CONF, conf)
    text = found[1].replace("fl3d.detectors.height_map.HeightMap", "tests.example_detector.HeightMap")
    (conf / "detector" / "height_map.yaml").write_text(text)
    monkeypatch.setattr("fl3d.config.CONF", conf)

    places = [f"data.root={simulated}", f"store.root={tmp_path / 'runs'}", f"results={tmp_path / 'results'}"]
    shared = [*SMALL, *places, "detector=height_map", "+sweep=gamma", "schedule.epochs.warmup=2"]
    points = [Point((f"loss.gamma={g}",), compose_config([*shared, f"loss.gamma={g}"])) for g in (0, 2)]
    said: list[str] = []
    sweep = Sweep(Listed(points), say=said.append)
    sweep.run(InlineLauncher())
    assert len(sweep.plan.stages) == 3  # the warm-up is shared
    for key in sweep.plan.stages:
        assert StagePaths(sweep.stages_root / key).done.exists()
    assert any("HeightMap" in line and "| 2 |" in line for line in said)
    scores = (tmp_path / "results" / "simulated-tiny" / "scores" / "gamma.csv").read_text()
    assert scores.count("HeightMap") == 2 * 4  # of two epochs each, warm-up and focal


def test_every_part_of_the_contract_is_in_the_document() -> None:
    from fl3d.detectors.base import Detector

    text = DOCUMENT.read_text()
    for name in sorted(Detector.__abstractmethods__):
        assert f"`{name}(" in text
