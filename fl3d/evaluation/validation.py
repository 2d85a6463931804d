"""What detections are held against: labels and calibrations of the validation frames."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from fl3d.data.calibration import Calibration
from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import LabelTable, table_from_labels
from fl3d.data.labels import Labels
from fl3d.evaluation.protocol import Protocol
from fl3d.geometry.boxes import count_points_inside


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
