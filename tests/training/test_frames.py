"""Which frames a stage is trained on, and how many steps its epochs have."""

import math
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from fl3d.config.compose import compose_config
from fl3d.core.errors import DataError
from fl3d.data.dataset import Frames, frames_with
from fl3d.data.kitti import KittiFolder
from fl3d.sweep.setup import prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training import stage
from tests.support import train_stages


@pytest.fixture
def half_empty(simulated: Path, tmp_path: Path) -> Path:
    """Six training frames, of which two hold cars, and one a van."""
    root = shutil.copytree(simulated, tmp_path / "kitti")
    ids = KittiFolder(root).split("train")
    for i in ids[2:]:
        path = root / "training" / "label_2" / f"{i}.txt"
        path.write_text(re.sub("^(Car|Van) ", "Tram ", path.read_text(), flags=re.MULTILINE))
    path = root / "training" / "label_2" / f"{ids[2]}.txt"
    path.write_text(path.read_text().replace("Tram ", "Van ", 1))
    return root


def test_frames_are_told_by_their_labels(half_empty: Path) -> None:
    folder = KittiFolder(half_empty)
    ids = folder.split("train")
    assert frames_with(folder, ids, ("Car",)) == ids[:2]
    assert frames_with(folder, ids, ("Car", "Van")) == ids[:3]
    with pytest.raises(DataError, match="no training frame holds a label of type Unicorn"):
        frames_with(folder, ids, ("Unicorn",))


@pytest.mark.parametrize(("detector", "used"), [("voxelnet", 6), ("pointrcnn", 3), ("fconvnet", 2)])
def test_a_detector_learns_from_frames_that_hold_something_where_it_says_so(
    half_empty: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, detector: str, used: int
) -> None:
    seen: list[int] = []

    class Noting(Frames):
        def __init__(self, folder: KittiFolder, ids: Sequence[str], cache: int) -> None:
            super().__init__(folder, ids, cache)
            seen.append(len(ids))

    monkeypatch.setattr(stage, "Frames", Noting)
    overrides = [
        f"data.root={half_empty}",
        f"store.root={tmp_path / 'runs'}",
        "profile=tiny",
        "data.generate=false",
        f"detector={detector}",
        "schedule.frames_per_epoch=null",
    ]
    config = compose_config(overrides)
    names = list(config["schedule"]["stages"])
    for name in names[1:]:
        config["schedule"]["stages"][name] = None
    config["schedule"]["stages"][names[0]]["epochs"] = 1
    sweep = prepare_sweep(Listed([point_of((), config)]))
    train_stages(sweep)
    assert sorted(seen) == sorted([used, 4])  # of training and validation
    (planned,) = sweep.plan.stages.values()
    # An epoch is six frames in any case.
    steps = math.ceil(6 / planned.config["schedule"]["batch_size"])
    assert sweep.layout.run(planned.key).steps() == [steps]
