"""Pictures of simulated frames are rendered once, and again when what they are made of has changed."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from fl3d.data.kitti import KittiFolder
from fl3d.papers import scenes

ASKED: list[str] = []


def rendered(folder: Path, frame_id: str) -> NDArray[np.uint8] | None:
    ASKED.append(frame_id)
    return None if frame_id == "000009" else np.full((2, 3, 3), int(frame_id), np.uint8)


@pytest.fixture
def sweep(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Any:
    ASKED.clear()
    monkeypatch.setattr(scenes, "picture_again", rendered)
    (tmp_path / "data" / "training").mkdir(parents=True)
    store = SimpleNamespace(root=tmp_path / "runs")
    return SimpleNamespace(settings=SimpleNamespace(store=store))


def test_a_picture_is_rendered_once_for_each_frame_and_folder(tmp_path: Path, sweep: Any) -> None:
    kitti = KittiFolder(tmp_path / "data")
    manifest = tmp_path / "data" / "manifest.json"
    assert scenes._image(sweep, kitti, "000001") is None  # nobody has simulated it
    assert ASKED == []
    manifest.write_text("seed 0")
    for frame_id in ("000001", "000001", "000002", "000009", "000009"):
        scenes._image(sweep, kitti, frame_id)
    assert ASKED == ["000001", "000002", "000009"]
    image = scenes._image(sweep, kitti, "000002")
    assert image is not None
    assert image.tolist() == [[[2, 2, 2]] * 3] * 2
    assert scenes._image(sweep, kitti, "000009") is None
    manifest.write_text("seed 1")
    scenes._image(sweep, kitti, "000002")
    assert ASKED == ["000001", "000002", "000009", "000002"]


def test_with_other_code_it_is_rendered_again(
    tmp_path: Path, sweep: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "data" / "manifest.json").write_text("seed 0")
    kitti = KittiFolder(tmp_path / "data")
    scenes._image(sweep, kitti, "000001")
    monkeypatch.setattr(scenes, "code_digest", lambda *_: "other")
    scenes._image(sweep, kitti, "000001")
    assert ASKED == ["000001"] * 2
