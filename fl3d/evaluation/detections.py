"""Everything a checkpoint predicts on the validation frames, before score cut and suppression: store and read back."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
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
from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import LabelTable, table_from_labels
from fl3d.data.labels import Labels
from fl3d.data.projection import project_boxes
from fl3d.evaluation.average_precision import Comparison, Curve, compare, evaluate
from fl3d.evaluation.protocol import Protocol, of_class
from fl3d.evaluation.recall import OVERLAPS, best_overlaps
from fl3d.evaluation.results import from_parquet, is_results
from fl3d.evaluation.stored import StoredDetections
from fl3d.geometry.boxes import count_points_inside, rectangles_velo, spans_velo
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


@dataclass(frozen=True)
class Validation:
    """What detections are held against.

    Args:
        ids: frames.
        labels: of each.
        calibrations: of each.
        image_sizes: of each, (width, height).
        folder: that they were read from; None where there are no clouds.
    """

    ids: tuple[str, ...]
    labels: tuple[Labels, ...]
    calibrations: tuple[Calibration, ...]
    image_sizes: tuple[tuple[int, int], ...]
    folder: KittiFolder | None = None

    @cached_property
    def points(self) -> NDArray[np.int64] | None:
        """Points of the LiDAR on each label, frame by frame (G,); reads every cloud once. None without clouds.

        Raises:
            DataError: a cloud cannot be read.
        """
        if self.folder is None:
            return None
        counts = [np.zeros(0, dtype=np.int64)]
        for index, labels in enumerate(self.labels):
            points = self.folder.read_cloud(self.ids[index]).points_velo  # not cropped
            boxes = self.calibrations[index].boxes_to_velo(labels.boxes_cam)
            counts.append(count_points_inside(points, boxes))
        return np.concatenate(counts)

    @cached_property
    def table(self) -> LabelTable:
        """All labels."""
        return table_from_labels(self.labels)

    @cached_property
    def places_velo(self) -> NDArray[np.float64]:
        """Where each label stands, frame by frame: (G, 3)."""
        places = [np.zeros((0, 3))]
        for labels, calibration in zip(self.labels, self.calibrations, strict=True):
            places.append(calibration.points_to_velo(labels.boxes_cam[:, :3]))
        return np.concatenate(places)

    def beyond(self, protocol: Protocol) -> NDArray[np.bool_]:
        """Which labels lie outside the protocol's area, frame by frame: (G,)."""
        x, y = self.places_velo[:, 0], self.places_velo[:, 1]
        if protocol.ignore_beyond is None:
            return np.zeros(len(x), dtype=bool)
        x0, y0, x1, y1 = protocol.ignore_beyond
        return ~((x >= x0) & (x < x1) & (y >= y0) & (y < y1))

    @cached_property
    def digest(self) -> str:
        """Identity of all that detections are held against, points on the labels aside."""
        found = hashlib.sha256(json.dumps([self.ids, self.image_sizes]).encode())
        for labels, calibration in zip(self.labels, self.calibrations, strict=True):
            for part in (*vars(labels).values(), *vars(calibration).values()):
                if part is not None:
                    found.update(f"{part.shape} {part.dtype} ".encode() + part.tobytes())
        return found.hexdigest()


def read_validation(folder: KittiFolder, ids: Sequence[str]) -> Validation:
    """Labels and calibrations of frames; no clouds are read before their points are asked for."""
    return Validation(
        tuple(ids),
        tuple(folder.read_labels(i) for i in ids),
        tuple(folder.read_calibration(i) for i in ids),
        tuple(folder.image_size(i) for i in ids),
        folder,
    )


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


def compare_stored(
    detections: StoredDetections, validation: Validation, protocol: Protocol
) -> Comparison:
    """A checkpoint's detections, as the protocol sees them, held against the labels.

    Args:
        detections: as stored.
        validation: the same frames.
        protocol: what the AP stands for.

    Raises:
        DataError: the frames differ.
    """
    if detections.frame_ids != validation.ids:
        raise DataError("detections are of other frames than the validation split", "detections")
    det = detections.table(validation.calibrations, validation.image_sizes, protocol)
    gt, beyond, points = ground_truths(validation, protocol)
    return compare(gt, det, protocol, beyond, points)


def ground_truths(
    validation: Validation, protocol: Protocol
) -> tuple[LabelTable, NDArray[np.bool_], NDArray[np.int64] | None]:
    """What ``compare`` takes of the validation frames, and ``count_labels(gt, protocol, classes, beyond, points)``.

    Returns:
        the labels, which of them lie outside the protocol's area (G,), and the points on each (G,), which are None
        unless the protocol goes by them.

    Raises:
        DataError: a cloud cannot be read.
    """
    points = validation.points if protocol.difficulty == "points" else None
    return validation.table, validation.beyond(protocol), points


def score(
    detections: StoredDetections, validation: Validation, protocol: Protocol
) -> dict[str, float]:
    """AP of a checkpoint's detections, and recall of all its boxes; arguments and errors as ``compare_stored``.

    Returns:
        ``{"ap_3d/moderate": ..., "ap_3d_r40/moderate": ..., ...}`` for image, bev and 3d in percent; and
        ``{"recall_3d/0.5": ...}``, the share of objects that any stored box of their class overlaps by more, before
        cut and suppression, with ``recall_3d/mean_iou``, their mean best overlap. Of several classes these are the
        means over classes, and each class has its own: ``ap_3d/moderate/Pedestrian``.
    """
    curves = evaluate(compare_stored(detections, validation, protocol), protocol.classes)
    by_class = {}
    for name, own in curves.items():
        best = best_overlaps(_objects_and_boxes(detections, validation, protocol, name))
        by_class[name] = _aps(own) | _recalls(best)
    if len(by_class) == 1:
        return by_class[protocol.classes[0]]
    keys = by_class[protocol.classes[0]]
    scores = {key: float(np.mean([one[key] for one in by_class.values()])) for key in keys}
    for name, own_scores in by_class.items():
        scores |= {of_class(key, name): value for key, value in own_scores.items()}
    return scores


def _aps(curves: Mapping[str, Mapping[str, Curve]]) -> dict[str, float]:
    """APs of one class by their names."""
    found = {}
    for metric, levels in curves.items():
        for difficulty, curve in levels.items():
            found[f"ap_{metric}/{difficulty}"] = curve.ap_r11
            found[f"ap_{metric}_r40/{difficulty}"] = curve.ap_r40
    return found


def _recalls(best: Float) -> dict[str, float]:
    """Recalls of one class by their names, from each object's best overlap."""
    found = {f"recall_3d/{t:g}": float((best > t).mean()) if len(best) else 0.0 for t in OVERLAPS}
    return found | {"recall_3d/mean_iou": float(best.mean()) if len(best) else 0.0}


def _objects_and_boxes(
    detections: StoredDetections, validation: Validation, protocol: Protocol, name: str
) -> list[tuple[Float, Float]]:
    """Of each frame all objects of a class within the protocol's area, of any difficulty, and all stored boxes."""
    found = []
    beyond = np.split(validation.beyond(protocol), validation.table.offsets[1:-1])
    for index, (labels, calibration) in enumerate(
        zip(validation.labels, validation.calibrations, strict=True)
    ):
        own = (labels.types == name) & ~beyond[index]
        objects = calibration.boxes_to_velo(labels.boxes_cam[own])
        found.append((objects, detections.boxes_of(index, name, calibration)))
    return found
