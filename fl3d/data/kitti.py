"""Read the KITTI 3D object folder: ``training/{velodyne,label_2,calib,image_2}`` and ``ImageSets``.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from fl3d.core.errors import DataError, DataMissing, options
from fl3d.data.calibration import MEAN, Calibration, read_calibration
from fl3d.data.image_boxes import ImageBoxes, read_image_boxes
from fl3d.data.labels import Labels, read_labels
from fl3d.data.splits import read_split

IMAGE_SIZE = (1242, 375)  # pixels; where a frame has no picture
# Frames of the splits that everybody uses: train and val are those of Chen et al., 3D object proposals for accurate
# object class detection, NIPS 2015; trainval is all that have labels; sample_* are conf/data/kitti_sample.yaml's.
SPLIT_SIZES = {"train": 3712, "val": 3769, "trainval": 7481, "sample_train": 22, "sample_val": 10}
_CLOUD_SAMPLE = 4096  # bytes at either end of a cloud that enter the digest


@dataclass(frozen=True)
class Frame:
    """One frame.

    Args:
        id: its name, six digits in KITTI.
        points_velo: (N, 4) float32: x, y, z in metres, reflectance in 0..1.
        calibration: of this frame.
        labels: every object of the label file.
        image_size: (width, height) in pixels.
        image_boxes: (N, 5) cars that a 2D detector found: x1, y1, x2, y2 in pixels, score; None where none was run.
        label_file: that the labels come from, for errors; None: from none.
    """

    id: str
    points_velo: NDArray[np.float32]
    calibration: Calibration
    labels: Labels
    image_size: tuple[int, int]
    image_boxes: NDArray[np.float64] | None = None
    label_file: Path | None = None


class KittiFolder:
    """A KITTI object folder on disk.

    Args:
        root: holds ``training`` and ``ImageSets``.
        crop: ``image`` keeps the points that project into the picture, ``none`` the whole sweep.
        calibration: ``frame`` reads each frame's own; ``mean`` uses the training set's mean for all, as the
            paper's code does.
    """

    def __init__(self, root: Path, crop: str = "image", calibration: str = "frame") -> None:
        for value, possible, key in (
            (crop, ("image", "none"), "crop"),
            (calibration, ("frame", "mean"), "calibration"),
        ):
            if value not in possible:
                raise DataError(
                    f"data.{key}: no choice '{value}'. {options(value, possible)}", root
                )
        self.root = root
        self.crop = crop
        self.calibration = calibration

    def split(self, name: str) -> list[str]:
        """Frame ids of ``ImageSets/NAME.txt``, in file order.

        Raises:
            DataMissing: the file is (the message lists those present).
            DataError: a line is no frame's name, or a frame is there twice.
        """
        path = self.root / "ImageSets" / f"{name}.txt"
        if not path.exists():
            present = [p.stem for p in path.parent.glob("*.txt")]
            raise DataMissing(f"no such split. {options(name, present)}", path)
        return read_split(path)

    def path(self, kind: str, frame_id: str) -> Path:
        """Where a frame's file lies; ``kind`` is velodyne, label_2, calib or image_2."""
        ending = {"velodyne": "bin", "image_2": "png"}.get(kind, "txt")
        return self.root / "training" / kind / f"{frame_id}.{ending}"

    def frame(self, frame_id: str) -> Frame:
        """Read one frame.

        Raises:
            DataError: any of its files is missing or malformed.
        """
        calibration = self.read_calibration(frame_id)
        size = self.image_size(frame_id)
        points = read_cloud(self.path("velodyne", frame_id))
        if self.crop == "image":
            points = points[calibration.in_image(points, size)]
        found = (
            None if self.image_boxes is None else self.image_boxes.get(frame_id, np.zeros((0, 5)))
        )
        return Frame(
            frame_id,
            points,
            calibration,
            self.read_labels(frame_id),
            size,
            found,
            self.path("label_2", frame_id),
        )

    @cached_property
    def image_boxes(self) -> ImageBoxes | None:
        """What a 2D detector found, by frame, see ``image_boxes.read_image_boxes``."""
        return read_image_boxes(self.root)

    def read_labels(self, frame_id: str) -> Labels:
        """Labels of one frame, without its cloud."""
        return read_labels(self.path("label_2", frame_id))

    def read_calibration(self, frame_id: str) -> Calibration:
        """Calibration of one frame, or the mean one."""
        return (
            MEAN if self.calibration == "mean" else read_calibration(self.path("calib", frame_id))
        )

    def image_size(self, frame_id: str) -> tuple[int, int]:
        """(width, height) of the frame's picture, or KITTI's usual size where there is none."""
        path = self.path("image_2", frame_id)
        if not path.exists():
            return IMAGE_SIZE
        with Image.open(path) as image:
            return image.size

    def image_digest(self, frame_ids: Iterable[str]) -> str | None:
        """Identity of what a 2D detector found in some frames; None where none was run."""
        if self.image_boxes is None:
            return None
        digest = hashlib.sha256()
        for frame_id in frame_ids:
            digest.update(
                frame_id.encode() + self.image_boxes.get(frame_id, np.zeros((0, 5))).tobytes()
            )
        return digest.hexdigest()[:16]

    def digest(self, frame_ids: Iterable[str]) -> str:
        """Identity of the data of some frames, wherever they lie.

        Labels, calibrations and the pictures' sizes (they decide the crop) enter in full; of
        a cloud its size and both ends (a full KITTI has 14 GB of clouds), so a change in a cloud's middle that keeps
        its size goes unnoticed.
        """
        digest = hashlib.sha256()
        for frame_id in frame_ids:
            digest.update(f"{frame_id} {self.image_size(frame_id)} ".encode())
            for kind in ("label_2", "calib"):
                content = _read_bytes(self.path(kind, frame_id))
                digest.update(f"{len(content)} ".encode() + content)
            cloud = self.path("velodyne", frame_id)
            if not cloud.exists():
                raise DataMissing("no such file", cloud)
            size = cloud.stat().st_size
            digest.update(str(size).encode())
            with cloud.open("rb") as file:
                digest.update(file.read(_CLOUD_SAMPLE))
                file.seek(max(0, size - _CLOUD_SAMPLE))
                digest.update(file.read(_CLOUD_SAMPLE))
        return digest.hexdigest()[:16]


def read_cloud(path: Path) -> NDArray[np.float32]:
    """Read a velodyne file: (N, 4) float32 x, y, z, reflectance.

    Raises:
        DataError: missing, cut off within a point, or a coordinate is not finite.
    """
    raw = _read_bytes(path)
    if len(raw) % 16:
        raise DataError(
            f"{len(raw)} bytes are not a whole number of points of 16 bytes; cut off?", path
        )
    points: NDArray[np.float32] = np.frombuffer(raw, dtype="<f4").reshape(-1, 4)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise DataError(f"point {int(np.argmin(finite))} is not finite", path)
    return points


def _read_bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise DataMissing("no such file", path) from None
