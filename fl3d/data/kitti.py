"""Read the KITTI 3D object folder: ``training/{velodyne,label_2,calib,image_2}`` and ``ImageSets``.

Geiger, Lenz, Urtasun: Are we ready for autonomous driving? The KITTI vision benchmark suite. CVPR 2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError, DataMissing, options
from fl3d.data.calibration import AXES, MEAN, Calibration
from fl3d.data.calibration_files import read_calibration
from fl3d.data.classes import CARS
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.clouds import Cloud, find_cloud, read_cloud
from fl3d.data.image_boxes import FoundInPictures, ImageBoxes, read_found
from fl3d.data.labels import Labels, read_labels
from fl3d.data.pictures import IMAGE_SIZE, find_picture, picture_size, size_without_picture
from fl3d.data.splits import read_split
from fl3d.data.text import is_there

__all__ = ["IMAGE_SIZE", "SPLIT_SIZES", "Frame", "KittiFolder"]
# Frames of the splits that everybody uses: train and val are those of Chen et al., 3D object proposals for accurate
# object class detection, NIPS 2015; trainval is all that have labels; sample_* are conf/data/kitti_sample.yaml's.
SPLIT_SIZES = {"train": 3712, "val": 3769, "trainval": 7481, "sample_train": 22, "sample_val": 10}
CROPS = ("image", "none")
CALIBRATIONS = ("frame", "mean", "axes")
_KINDS = ("velodyne", "label_2", "calib", "image_2")  # a frame's files


Stamp = tuple[tuple[str, int, int] | None, ...]  # of files: name, time of the last change, size


@dataclass(frozen=True)
class Frame:
    """One frame.

    Args:
        id: its name, six digits in KITTI.
        points_velo: (N, 4) float32: x, y, z in metres, reflectance in 0..1.
        calibration: of this frame.
        labels: every object of the label file.
        image_size: (width, height) in pixels.
        image_boxes: (N, 5) that a 2D detector found: x1, y1, x2, y2 in pixels, score; None where none was run.
        label_file: that the labels come from, for errors; None: from none.
        image_types: (N,) classes of ``image_boxes``; None: all are cars.
    """

    id: str
    points_velo: NDArray[np.float32]
    calibration: Calibration
    labels: Labels
    image_size: tuple[int, int]
    image_boxes: NDArray[np.float64] | None = None
    label_file: Path | None = None
    image_types: NDArray[np.str_] | None = None


class KittiFolder:
    """A KITTI object folder on disk.

    Args:
        root: holds ``training`` and ``ImageSets``.
        crop: ``image`` keeps the points that project into the picture, ``none`` the whole sweep.
        calibration: ``frame`` reads each frame's own; ``mean`` uses the training set's mean for all, as the
            paper's code does; ``axes`` needs none: the camera's axes are the LiDAR's, renamed, for clouds without a
            camera.
        cloud: how clouds are read; None: as KITTI's.
        image_size: (width, height) in pixels of frames that have no picture; None: by their calibration, see
            ``pictures.size_without_picture``.
        classes: whose boxes of a 2D detector are read.

    Raises:
        DataError: a choice that does not exist, or a crop to the picture of no camera.
    """

    def __init__(
        self,
        root: Path,
        crop: str = "image",
        calibration: str = "frame",
        cloud: CloudFormat | None = None,
        image_size: tuple[int, int] | None = None,
        classes: Sequence[str] = CARS,
    ) -> None:
        for value, possible, key in (
            (crop, CROPS, "crop"),
            (calibration, CALIBRATIONS, "calibration"),
        ):
            if value not in possible:
                raise DataError(
                    f"data.{key}: no choice '{value}'. {options(value, possible)}", root
                )
        if calibration == "axes" and crop == "image":
            raise DataError(
                "data.calibration=axes has no camera, so there is no picture to crop to: give data.crop=none",
                root,
            )
        self.root = root
        self.crop = crop
        self.calibration = calibration
        self.cloud = cloud or CloudFormat()
        self.without_picture = image_size
        self.classes = tuple(classes)

    def split(self, name: str) -> list[str]:
        """Frame ids of ``ImageSets/NAME.txt``, in file order.

        Raises:
            DataMissing: the file is (the message lists those present).
            DataError: a line is no frame's name, a frame is there twice, or it has no file at all.
        """
        path = self.split_path(name)
        if not is_there(path):
            if not is_there(path.parent):
                raise DataMissing(
                    f"there is no folder ImageSets: it needs {path.name}, a frame's name a line",
                    path,
                )
            present = [p.stem for p in path.parent.glob("*.txt")]
            raise DataMissing(f"no such split. {options(name, present)}", path)
        frame_ids = read_split(path)
        self._check_known(frame_ids, path)
        return frame_ids

    def _check_known(self, frame_ids: list[str], split: Path) -> None:
        """Refuse a frame of which there is no file: the list is wrong then, not the frame.

        Raises:
            DataError: names the list and the frame.
        """
        try:
            labels = {path.stem for path in (self.root / "training" / "label_2").iterdir()}
        except OSError:
            return  # what needs labels says that they are missing
        for frame_id in frame_ids:
            if frame_id in labels or self.path("calib", frame_id).exists():
                continue
            if not self.path("velodyne", frame_id).exists():
                raise DataError(
                    f"there is no frame {frame_id}: it has no label, calibration or cloud in training",
                    split,
                )

    def split_path(self, name: str) -> Path:
        """The file that names a split's frames."""
        return self.root / "ImageSets" / f"{name}.txt"

    def path(self, kind: str, frame_id: str) -> Path:
        """Where a frame's file lies; ``kind`` is velodyne, label_2, calib, image_2 or planes.

        A cloud and a picture may have several endings: the first that is there, or else KITTI's.
        """
        folder = self.root / "training" / kind
        if kind == "velodyne":
            return find_cloud(folder, frame_id)
        if kind == "image_2":
            return find_picture(folder, frame_id) or folder / f"{frame_id}.png"
        return folder / f"{frame_id}.txt"

    def frame(self, frame_id: str) -> Frame:
        """Read one frame.

        Raises:
            DataError: any of its files is missing or malformed.
        """
        calibration = self.read_calibration(frame_id)
        size = self.image_size(frame_id)
        points = self.read_cloud(frame_id).points_velo
        if self.crop == "image":
            points = points[calibration.in_image(points, size)]
        labels, label_file = self.read_labels(frame_id), self.path("label_2", frame_id)
        return self.with_found(
            Frame(frame_id, points, calibration, labels, size, label_file=label_file)
        )

    def with_found(self, frame: Frame) -> Frame:
        """A frame with what a 2D detector found in it of this folder's classes, or with nothing where none was run."""
        boxes, types = self._found.of(frame.id) if self._found.is_there else (None, None)
        if boxes is frame.image_boxes:
            return frame
        return replace(frame, image_boxes=boxes, image_types=types)

    @property
    def reading(self) -> tuple[object, ...]:
        """What a frame is read by, besides its files: frames of folders that are alike in it are the same."""
        return self.root, self.crop, self.calibration, self.cloud, self.without_picture

    def stamp(self, frame_id: str) -> Stamp:
        """Tells whether any of a frame's files has been changed since; None of a file that is not there."""
        return tuple(_stamp(self.path(kind, frame_id)) for kind in _KINDS)

    @property
    def image_boxes(self) -> ImageBoxes | None:
        """What a 2D detector found of the classes, by frame, see ``image_boxes.read_image_boxes``."""
        return self._found.boxes if self._found.is_there else None

    @cached_property
    def _found(self) -> FoundInPictures:
        return read_found(self.root, self.classes)

    def read_labels(self, frame_id: str) -> Labels:
        """Labels of one frame, without its cloud."""
        return read_labels(self.path("label_2", frame_id))

    def read_cloud(self, frame_id: str) -> Cloud:
        """Cloud of one frame, not cropped."""
        return read_cloud(self.path("velodyne", frame_id), self.cloud)

    def read_calibration(self, frame_id: str) -> Calibration:
        """Calibration of one frame, or that of all.

        Raises:
            DataError: it is missing or malformed.
        """
        if self.calibration == "frame":
            path = self.path("calib", frame_id)
            if not path.parent.exists():
                hint = "without a camera give data.calibration=axes data.crop=none"
                raise DataMissing(f"no such file, and no such folder; {hint}", path)
            return read_calibration(path)
        return AXES if self.calibration == "axes" else MEAN

    def image_size(self, frame_id: str) -> tuple[int, int]:
        """(width, height) of the frame's picture; where there is none, as told, or by its calibration.

        Raises:
            DataError: the picture is broken, or without one the calibration tells no size.
        """
        picture = find_picture(self.root / "training" / "image_2", frame_id)
        if picture is not None:
            return picture_size(picture)
        if self.without_picture is not None:
            return self.without_picture
        calibration = self.read_calibration(frame_id)
        return size_without_picture(calibration, self.path("calib", frame_id))


def _stamp(path: Path) -> tuple[str, int, int] | None:
    try:
        found = path.stat()
    except OSError:
        return None
    return path.name, found.st_mtime_ns, found.st_size
