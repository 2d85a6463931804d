"""A trained detector on points that Python holds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray

from fl3d.core.errors import DataError
from fl3d.data.calibration import AXES, MEAN, Calibration
from fl3d.data.kitti import Frame
from fl3d.data.labels import Labels, labels_from_columns
from fl3d.data.pictures import size_without_picture
from fl3d.inference.devices import check_device
from fl3d.inference.load import load
from fl3d.inference.predict import detect_labels, find_checkpoint
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec

SCORE = 0.5  # posterior from which on a box is told, as `fl3d predict` has it


@dataclass(frozen=True)
class Boxes:
    """What a detector has found in one cloud, best first.

    Args:
        boxes_velo: (M, 7) x, y, z of the bottom's centre, height, width, length in metres, yaw in radians; LiDAR frame,
            see ``geometry.boxes``.
        scores: (M,) posteriors.
        types: (M,) classes.
        labels: the same as a result file says it, in the camera's frame.
    """

    boxes_velo: NDArray[np.float64]
    scores: NDArray[np.float64]
    types: NDArray[np.str_]
    labels: Labels

    def __len__(self) -> int:
        return len(self.scores)

    @property
    def table(self) -> pd.DataFrame:
        """A row a box: ``class``, ``score``, ``x``, ``y``, ``z``, ``height``, ``width``, ``length``, ``yaw``."""
        columns = ("x", "y", "z", "height", "width", "length", "yaw")
        values = dict(zip(columns, self.boxes_velo.T, strict=True))
        return pd.DataFrame({"class": self.types, "score": self.scores, **values})


class TrainedDetector:
    """A checkpoint that detects in points.

    Args:
        folder: of its stage.
        step: of the checkpoint.
        device: torch's name of it.
    """

    def __init__(self, folder: RunFolder, step: int, device: str = "cpu") -> None:
        self.step = step
        self.device = device
        self.key = folder.key
        self._spec = read_spec(folder)
        self.network = load(folder, step, device)

    def __repr__(self) -> str:
        return f"<{self.name} of {self.key}, step {self.step}, for {', '.join(self.classes)}>"

    @property
    def name(self) -> str:
        """As the papers write it."""
        return self.network.NAME

    @property
    def classes(self) -> tuple[str, ...]:
        """That it detects."""
        return self._spec.settings.classes

    def detect(
        self,
        points: ArrayLike,
        *,
        score: float = SCORE,
        calibration: Calibration | None = None,
        image_size: tuple[int, int] | None = None,
        image_boxes: ArrayLike | None = None,
        image_types: ArrayLike | None = None,
    ) -> Boxes:
        """Detect objects in one cloud, as ``fl3d predict`` does.

        Args:
            points: (N, 4) x, y, z in metres and reflectance from 0 to 1; LiDAR frame, x ahead.
            score: posterior from which on a box is told.
            calibration: of the camera; None: KITTI's mean, or, of a detector that was trained without one, none.
            image_size: width and height of its picture; None: as in training, or as the calibration has it.
            image_boxes: (K, 5) x1, y1, x2, y2 in pixels and score of a 2D detector, which Frustum ConvNet needs.
            image_types: (K,) classes of these; None: all are cars.

        Raises:
            DataError: points of another form, or a detector that needs 2D boxes and has none.
        """
        settings = self._spec.settings
        used = calibration or (AXES if settings.calibration == "axes" else MEAN)
        size = image_size or settings.image_size or size_without_picture(used, Path("points"))
        cloud = _points(points)
        if settings.crop == "image":
            cloud = cloud[used.in_image(cloud, size)]
        frame = Frame(
            "points", cloud, used, labels_from_columns([], np.zeros((0, 14)), False), size
        )
        if image_boxes is not None:
            boxes = np.asarray(image_boxes, dtype=np.float64).reshape(-1, 5)
            types = None if image_types is None else np.asarray(image_types, dtype=np.str_)
            frame = replace(frame, image_boxes=boxes, image_types=types)
        protocol = replace(self._spec.machine.protocol, score_threshold=score, image_box="clipped")
        found = detect_labels(self.network, frame, protocol, settings, device=self.device)
        assert found.scores is not None
        return Boxes(used.boxes_to_velo(found.boxes_cam), found.scores, found.types, found)


def load_detector(checkpoint: Path | str, *, device: str = "cpu") -> TrainedDetector:
    """Open a trained detector.

    Args:
        checkpoint: a stage's folder, ``runs/stages/NAME`` (its last checkpoint), or one of its ``.pt`` files.
        device: ``cpu``, ``cuda`` or ``cuda:N``.

    Raises:
        CheckpointError: no checkpoint there, or one of a version whose network this one does not build.
        ConfigError: a device that is not there.
    """
    folder, step = find_checkpoint(Path(checkpoint))
    check_device(device, "device=")
    return TrainedDetector(folder, step, device)


def _points(points: ArrayLike) -> NDArray[np.float32]:
    """As networks take them; what is not finite is left out, as of files.

    Raises:
        DataError: they are not (N, 4).
    """
    cloud = np.asarray(points, dtype=np.float32)
    if cloud.ndim != 2 or cloud.shape[1] != 4:
        form = " x ".join(map(str, cloud.shape)) or "one number"
        raise DataError(f"{form}, but (N, 4): x, y, z in metres and reflectance", "points")
    return cloud[np.isfinite(cloud).all(axis=1)]
