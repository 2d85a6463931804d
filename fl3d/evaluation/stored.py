"""What all stored detections of a checkpoint offer, whoever made it: what a protocol sees, and their boxes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from fl3d.data.calibration import Calibration
from fl3d.data.label_table import LabelTable, table_from_labels
from fl3d.data.labels import Labels
from fl3d.evaluation.protocol import Protocol


class StoredDetections(ABC):
    """Detections of several frames. Two kinds: boxes before cut and suppression, and result files of a program.

    Attributes:
        frame_ids: every frame that was looked at, with or without detections.
    """

    frame_ids: tuple[str, ...]

    @abstractmethod
    def labels_of(
        self,
        index: int,
        calibration: Calibration,
        image_size: tuple[int, int],
        protocol: Protocol,
    ) -> Labels:
        """What was detected in one frame, as a protocol looks at it, best first."""

    @abstractmethod
    def boxes_of(self, index: int, name: str, calibration: Calibration) -> NDArray[np.float64]:
        """All boxes of a class in one frame, whatever their score: (N, 7) ``boxes_velo``."""

    def table(
        self,
        calibrations: Sequence[Calibration],
        image_sizes: Sequence[tuple[int, int]],
        protocol: Protocol,
    ) -> LabelTable:
        """What a protocol's evaluator compares with the labels, of all frames."""
        frames = enumerate(zip(calibrations, image_sizes, strict=True))
        return table_from_labels([self.labels_of(i, *place, protocol) for i, place in frames])
