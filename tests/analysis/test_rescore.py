"""Stored detections under other protocols: no network is run."""

from pathlib import Path

import pytest

from fl3d.analysis.rescore import KEYS, rescore
from fl3d.core.errors import ConfigError
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep

POINTS = [
    ["detector=voxelnet", f"loss.gamma={gamma}", f"seed={seed}"]
    for gamma in (2, 0)
    for seed in (1, 0)
]


@pytest.fixture(scope="module")
def sweep(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    root = tmp_path_factory.mktemp("rescore")
    return detected_sweep(simulated, root, POINTS, lambda trial: 0.1 + 0.2 * float(trial.level))


def test_at_the_sweeps_own_value_the_digits_are_the_sweeps(sweep: FinishedSweep) -> None:
    own = sweep.protocol.score_threshold
    found = rescore(sweep, {"score_threshold": [own, 1]})
    assert len(found) == len(POINTS) * 2
    same = found[found["protocol"] == sweep.protocol.id].set_index(["level", "seed"])
    last = sweep.select("last").set_index(["level", "seed"])
    columns = [column for column in last if column.startswith("ap_")]
    assert (same.loc[last.index, columns] == last[columns]).all(axis=None)
    nothing = found[found["score_threshold"] == "1"]
    assert (nothing[columns] == 0).all(axis=None)


def test_rows_are_by_level_and_seed_and_every_combination_is_there(sweep: FinishedSweep) -> None:
    found = rescore(sweep, {"nms_iou": [0.5, 0.1], "nms_kind": ["standup", "3d"]})
    assert list(dict.fromkeys(zip(found["level"], found["seed"], strict=True))) == [
        ("0", 0),
        ("0", 1),
        ("2", 0),
        ("2", 1),
    ]
    combinations = list(zip(found["nms_iou"], found["nms_kind"], strict=True))[:4]
    assert combinations == [("0.5", "standup"), ("0.5", "3d"), ("0.1", "standup"), ("0.1", "3d")]
    assert found["protocol"].nunique() == 4


def test_what_no_protocol_has_is_refused(sweep: FinishedSweep) -> None:
    with pytest.raises(
        ConfigError, match=r"nms_iuo: no key of a protocol\. Did you mean 'nms_iou'"
    ):
        rescore(sweep, {"nms_iuo": [0.5]})
    with pytest.raises(ConfigError, match=r"protocol\.nms_iou: '7' is not a number from 0 to 1"):
        rescore(sweep, {"nms_iou": [7]})
    assert "overlaps" not in KEYS
