"""Stored detections: what was written is read back, and 2D boxes of a detector's own are the result's."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from fl3d.core.errors import DataError
from fl3d.data.calibration import MEAN
from fl3d.data.projection import project_boxes
from fl3d.evaluation.detections import Detections, read_detections, to_labels, write_detections
from fl3d.evaluation.protocol import Protocol

SIZE = (1242, 375)
PROTOCOL = Protocol("test", "A", {"Car": (0.7, 0.5, 0.5)}, 0.3, 0.1, "rotated", 20)
BOXES = np.array(
    [
        [20.0, 0, -1.7, 1.5, 1.6, 4, 0],
        [10.0, 3, -1.7, 1.5, 1.6, 4, 0.1],
        [30.0, -5, -1.7, 1.5, 1.6, 4, 0],
    ]
)
SCORES = np.array([0.9, 0.8, 0.2])
IMAGES = np.array([[600.0, 170, 680, 240], [400.0, 150, 520, 260], [1.0, 2, 3, 4]])


@pytest.mark.parametrize("images", [None, IMAGES])
def test_detections_come_back(tmp_path: Path, images: np.ndarray | None) -> None:
    written = Detections(("000001", "000002"), np.array([0, 1, 1]), BOXES, SCORES, images)
    write_detections(tmp_path / "found.parquet", written)
    found = read_detections(tmp_path / "found.parquet")
    assert found.frame_ids == written.frame_ids
    boxes, scores, own, types = found.of(1)
    assert types is None  # cars, as in every file that names no class
    np.testing.assert_array_equal(boxes, BOXES[1:])
    np.testing.assert_array_equal(scores, SCORES[1:])
    if images is None:
        assert own is None
    else:
        np.testing.assert_array_equal(own, IMAGES[1:])


def test_a_file_of_something_else_is_named(tmp_path: Path) -> None:
    (tmp_path / "x.parquet").write_bytes(b"nothing")
    with pytest.raises(DataError, match=r"x\.parquet"):
        read_detections(tmp_path / "x.parquet")


def test_2d_boxes_are_projected_unless_they_are_brought() -> None:
    """The third box is below the score cut; the two others keep the boxes that belong to them."""
    labels = to_labels(BOXES[::-1], SCORES[::-1], IMAGES[::-1], MEAN, SIZE, PROTOCOL)
    np.testing.assert_array_equal(labels.boxes_image, IMAGES[:2])
    np.testing.assert_allclose(labels.scores, [0.9, 0.8])
    projected = to_labels(BOXES, SCORES, None, MEAN, SIZE, PROTOCOL)
    np.testing.assert_allclose(projected.boxes_image, project_boxes(BOXES[:2], MEAN, SIZE)[1])
    whole = to_labels(BOXES, SCORES, None, MEAN, SIZE, replace(PROTOCOL, image_box="unclipped"))
    np.testing.assert_array_equal(whole.boxes_image, np.trunc(whole.boxes_image))


def test_suppression_in_3d_looks_at_heights() -> None:
    stacked = np.stack([BOXES[0], BOXES[0] + [0, 0, 1.4, 0, 0, 0, 0]])
    for kind, kept in (("standup", 1), ("rotated", 1), ("3d", 2)):
        labels = to_labels(stacked, SCORES[:2], None, MEAN, SIZE, replace(PROTOCOL, nms_kind=kind))
        assert len(labels) == kept
