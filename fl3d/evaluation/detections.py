"""Everything a checkpoint predicts on the validation frames, before score cut and suppression: store and read back."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.core.files import write_atomically
from fl3d.data.calibration import Calibration
from fl3d.data.classes import CARS
from fl3d.data.labels import Labels
from fl3d.data.projection import project_boxes
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.results import from_parquet, is_results
from fl3d.evaluation.stored import StoredDetections
from fl3d.geometry.boxes import rectangles_velo, spans_velo
from fl3d.geometry.nms import nms

BOX_COLUMNS = ("x", "y", "z", "h", "w", "l", "yaw")
IMAGE_COLUMNS = ("image_x1", "image_y1", "image_x2", "image_y2")
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Detections(StoredDetections):
    """Boxes of several frames, frame by frame, best score first.

    Args:
        frame_ids: every frame that was looked at, with or without boxes.
        frame: (N,) index into ``frame_ids``.
        boxes_velo: (N, 7).
        scores: (N,).
        boxes_image: (N, 4), where the detector goes by 2D boxes; else they are projected.
        types: (N,) class of each; None: all are cars, as in files that name no class.
    """

    frame_ids: tuple[str, ...]
    frame: NDArray[np.int64]
    boxes_velo: Float
    scores: Float
    boxes_image: Float | None = None
    types: NDArray[np.str_] | None = None

    def of(self, index: int) -> tuple[Float, Float, Float | None, NDArray[np.str_] | None]:
        """Boxes, scores, 2D boxes and classes of one frame."""
        order, starts = self._by_frame
        rows = order[starts[index] : starts[index + 1]]
        return (
            self.boxes_velo[rows],
            self.scores[rows],
            None if self.boxes_image is None else self.boxes_image[rows],
            None if self.types is None else self.types[rows],
        )

    @cached_property
    def _by_frame(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Rows frame by frame, (N,), and where those of each frame begin, (F + 1,)."""
        order = np.argsort(self.frame, kind="stable")
        return order, np.searchsorted(self.frame[order], np.arange(len(self.frame_ids) + 1))

    def labels_of(
        self,
        index: int,
        calibration: Calibration,
        image_size: tuple[int, int],
        protocol: Protocol,
    ) -> Labels:
        """See ``to_labels``."""
        boxes, scores, image, types = self.of(index)
        return to_labels(boxes, scores, image, calibration, image_size, protocol, types)

    def boxes_of(self, index: int, name: str, calibration: Calibration) -> Float:
        """See ``StoredDetections``."""
        boxes, _, _, types = self.of(index)
        if types is None:
            return boxes if name == CARS[0] else boxes[:0]
        return boxes[types == name]


def write_detections(path: Path, detections: Detections) -> None:
    """Store as Parquet: a row a box, the frames' list in the metadata; a column of classes unless all are cars."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    columns: dict[str, Any] = {
        "frame": detections.frame.astype(np.int32),
        "score": detections.scores,
    }
    columns |= {name: detections.boxes_velo[:, i] for i, name in enumerate(BOX_COLUMNS)}
    if detections.boxes_image is not None:
        columns |= {name: detections.boxes_image[:, i] for i, name in enumerate(IMAGE_COLUMNS)}
    if detections.types is not None:
        columns["type"] = pa.array(detections.types.tolist(), pa.string()).dictionary_encode()
    table = pa.table(columns).replace_schema_metadata({"frame_ids": " ".join(detections.frame_ids)})
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def read_detections(path: Path) -> StoredDetections:
    """Read what ``write_detections`` or ``results.write_results`` wrote.

    Raises:
        DataError: the file is missing or is not such a file.
    """
    import pyarrow as pa
    import pyarrow.parquet as pq

    try:
        table = pq.read_table(path)
        if is_results(table):
            return from_parquet(table)
        frame_ids = tuple(table.schema.metadata[b"frame_ids"].decode().split())
        boxes = np.column_stack([table[name].to_numpy() for name in BOX_COLUMNS])
        image = None
        if IMAGE_COLUMNS[0] in table.column_names:
            image = np.column_stack([table[name].to_numpy() for name in IMAGE_COLUMNS])
        types = None
        if "type" in table.column_names:
            types = np.array(table["type"].to_pylist(), dtype=np.str_)
        frame = table["frame"].to_numpy().astype(np.int64)
        return Detections(frame_ids, frame, boxes, table["score"].to_numpy(), image, types)
    except (OSError, KeyError, TypeError, pa.ArrowException) as error:
        raise DataError(f"is not a file of detections ({error})", path) from None


def to_labels(
    boxes_velo: Float,
    scores: Float,
    boxes_image: Float | None,
    calibration: Calibration,
    image_size: tuple[int, int],
    protocol: Protocol,
    types: NDArray[np.str_] | None = None,
) -> Labels:
    """One frame's detections as the protocol wants them: cut, suppressed, projected, best first.

    Args:
        boxes_velo: (N, 7).
        scores: (N,).
        boxes_image: (N, 4) their own 2D boxes; None: they are projected.
        calibration: of the frame.
        image_size: (width, height); boxes without any part in the picture are dropped, for KITTI labels only
            what the camera sees. A protocol that does without the picture drops none, projects none, and leaves a
            2D box that a detector has not found itself at 0 0 0 0.
        protocol: cut, suppression (of each class by itself), 2D box, and whether the picture counts.
        types: (N,) class of each; None: all are cars.
    """
    types = np.full(len(scores), CARS[0]) if types is None else types
    kept = _unsuppressed(boxes_velo, scores, types, protocol)
    boxes_velo, scores, types = boxes_velo[kept], scores[kept], types[kept]
    visible = np.ones(len(kept), dtype=bool)
    projected = np.zeros((len(kept), 4))
    if protocol.uses_picture:
        full, clipped, visible = project_boxes(boxes_velo, calibration, image_size)
        projected = clipped if protocol.image_box == "clipped" else np.trunc(full)
    boxes_cam = calibration.boxes_to_cam(boxes_velo)
    n = len(scores)
    labels = Labels(
        types=types,
        truncated=np.zeros(n),
        occluded=np.zeros(n, dtype=np.int64),
        alpha=np.full(n, -10.0),
        boxes_image=projected if boxes_image is None else boxes_image[kept],
        boxes_cam=boxes_cam,
        scores=scores,
    )
    return labels.select(visible)


def _unsuppressed(
    boxes_velo: Float, scores: Float, types: NDArray[np.str_], protocol: Protocol
) -> NDArray[np.int64]:
    """Indices of the boxes of a frame that stay, best first."""
    parts = [np.zeros(0, dtype=np.int64)]
    for name in np.unique(types):
        own = np.flatnonzero((types == name) & (scores >= protocol.score_threshold))
        kept = nms(
            rectangles_velo(boxes_velo[own]),
            scores[own],
            protocol.nms_iou,
            protocol.nms_kind,
            protocol.max_detections,
            spans_velo(boxes_velo[own]),
        )
        parts.append(own[kept])
    every = np.concatenate(parts)
    return every if len(parts) == 2 else every[np.argsort(-scores[every], kind="stable")]
