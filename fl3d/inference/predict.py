"""Run a trained detector on anybody's clouds: KITTI result files, and a picture of each cloud."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tqdm import tqdm

from fl3d.config.settings import StageSettings
from fl3d.core.errors import CheckpointError, DataError, DataMissing
from fl3d.core.files import write_atomically
from fl3d.core.plurals import several
from fl3d.data.calibration import AXES, MEAN, Calibration
from fl3d.data.calibration_files import read_calibration
from fl3d.data.clouds import ENDINGS, read_cloud
from fl3d.data.image_boxes import FoundInPictures, read_found
from fl3d.data.kitti import Frame
from fl3d.data.labels import Labels, labels_from_columns, read_labels, write_labels
from fl3d.data.pictures import find_picture, picture_size, read_picture, size_without_picture
from fl3d.data.text import is_there
from fl3d.detectors.base import Detector
from fl3d.evaluation.detections import to_labels
from fl3d.evaluation.protocol import Protocol
from fl3d.inference.detect import to_device
from fl3d.inference.devices import check_device
from fl3d.inference.load import load
from fl3d.inference.precision import multiplying
from fl3d.reports.figures.boxes import Scene, boxes_of_models
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec

# Where the clouds of a folder are looked for.
PLACES = ("velodyne", "training/velodyne", "testing/velodyne", ".")


def predict(
    checkpoint: Path,
    clouds: Path,
    out: Path,
    *,
    score: float = 0.5,
    calibration: Path | None = None,
    device: str = "cpu",
    pictures: bool = True,
    reading: Mapping[str, Any] | None = None,
    say: Callable[[str], None] = print,
) -> list[Path]:
    """Write what a checkpoint detects in clouds.

    Args:
        checkpoint: a stage's folder (its last checkpoint), or one of its ``.pt`` files.
        clouds: a file (``.bin`` of KITTI's format, ``.npy`` or ``.pcd``), a folder of them, or a
            KITTI folder. Beside a folder ``velodyne``, ``calib`` and ``image_2`` are used where
            they are, and ``label_2`` for the pictures.
        out: folder of the result files ``ID.txt``, and of pictures ``ID.png``.
        score: posterior from which on a box is written.
        calibration: of all clouds that have none of their own; None: the mean of KITTI's training
            set.
        device: torch's name of it.
        pictures: whether to draw; without, no label is read.
        reading: how clouds are read where it is not as the checkpoint's were: ``columns``,
            ``dtype`` and ``reflectance_scale``, see ``data.cloud_forms.CloudFormat``, and
            ``image_size`` of clouds without a picture.
        say: prints a line for the user.

    Returns:
        the result files.

    Raises:
        CheckpointError: no checkpoint there, or one of a version whose network this one does not
            build.
        DataError: no clouds there, or one cannot be read.
        ConfigError: a device that is not there, or a score that is no posterior.
    """
    folder, step = find_checkpoint(checkpoint)
    check_device(device, "--device ")
    files = find_clouds(clouds.resolve())
    spec = read_spec(folder)
    protocol = replace(spec.machine.protocol, score_threshold=score, image_box="clipped")
    settings = read_as(spec.settings, reading or {})
    reader = CloudReader(settings, calibration, with_labels=pictures)
    detector = load(folder, step, device)
    written: list[Path] = []
    n_without = 0
    try:
        for file in tqdm(files, unit="cloud", disable=None):
            cloud = reader.read(file)
            n_without += not cloud.is_calibrated
            found = detect_labels(detector, cloud.frame, protocol, spec.settings, device=device)
            written.append(_write(out, cloud.frame.id, found))
            if pictures:
                _draw(detector.NAME, cloud, found, protocol, out)
    finally:  # a cloud that cannot be read ends it: what was written before is there
        count = several(len(written), "cloud")
        if len(written) < len(files):
            count = f"{len(written)} of {several(len(files), 'cloud')}"
        say(f"{detector.NAME}, {folder.key}, step {step}: {count} into {out}")
    if n_without:
        used = calibration or "the mean of KITTI's training set"
        say(f"{n_without} clouds have no calibration of their own: {used} was taken for them")
    return written


def find_checkpoint(path: Path) -> tuple[RunFolder, int]:
    """The stage and the step of a checkpoint whose weights are there.

    Args:
        path: a stage's folder, for its last one, or a ``.pt`` file in it.

    Raises:
        CheckpointError: there is none; the message lists those that are there.
    """
    folder = RunFolder(path if path.is_dir() else path.parent.parent)
    if not folder.spec.exists():
        raise CheckpointError(
            f"{path}: no stage's folder, such as runs/stages/NAME, and no .pt file in one"
        )
    steps = [step for step in folder.steps() if folder.weights(step).exists()]
    named = [step for step in steps if folder.weights(step).name == path.name]
    wanted = steps[-1:] if path.is_dir() else named
    if not wanted:
        possible = ", ".join(str(folder.weights(step)) for step in steps) or "none"
        own = (
            f"; a command trained it, whose own are in {folder.work}"
            if folder.work.exists()
            else ""
        )
        raise CheckpointError(f"{path}: no weights. Possible: {possible}{own}")
    return folder, wanted[0]


def find_clouds(path: Path) -> list[Path]:
    """Files of clouds: the file itself, or those of a folder.

    Raises:
        DataError: the folder holds none.
    """
    if not is_there(path):
        raise DataMissing("no such file or folder", path)
    if path.is_file():
        return [path]
    for place in PLACES:
        files = [file for ending in ENDINGS for file in (path / place).glob(f"*.{ending}")]
        if files:
            first = {file.stem: file for file in reversed(files)}  # of one frame's several
            return [first[name] for name in sorted(first)]
    endings = ", ".join(f"*.{ending}" for ending in ENDINGS)
    raise DataError(f"no cloud ({endings}), here or in {', '.join(PLACES[:-1])}", path)


def read_as(settings: StageSettings, reading: Mapping[str, Any]) -> StageSettings:
    """A stage's settings, with clouds read in another way.

    Args:
        settings: of the stage.
        reading: see ``predict``.
    """
    size = reading.get("image_size", settings.image_size)
    form = {key: value for key, value in reading.items() if key != "image_size"}
    return replace(settings, image_size=size, cloud=replace(settings.cloud, **form))


@torch.no_grad()
def detect_labels(
    detector: Detector,
    frame: Frame,
    protocol: Protocol,
    settings: StageSettings,
    *,
    device: str = "cpu",
) -> Labels:
    """What a detector detects in one frame, as a result file says it.

    Args:
        detector: in evaluation mode, on the device.
        frame: whose labels are not used.
        protocol: cut, suppression and 2D box.
        settings: of the detector's stage.
        device: torch's name of it.
    """
    sample = detector.encode(frame, np.random.default_rng([0, 0]), training=False)
    batch = to_device(detector.collate([sample]), device)
    least = min(settings.min_score, protocol.score_threshold)
    with multiplying(settings.precision, device):
        (found,) = detector.detect(batch, settings.max_boxes, least)
    return to_labels(
        found.boxes_velo,
        found.scores,
        found.boxes_image,
        calibration=frame.calibration,
        image_size=frame.image_size,
        protocol=protocol,
        types=found.types(detector.classes),
    )


@dataclass(frozen=True)
class Cloud:
    """A cloud with what lies beside it.

    Args:
        frame: its points, and labels where there are any.
        image: (H, W, 3), or None.
        is_calibrated: whether the calibration is its own.
    """

    frame: Frame
    image: NDArray[np.uint8] | None
    is_calibrated: bool


class CloudReader:
    """Reads clouds with what lies beside them.

    Args:
        settings: of the detector's stage: its crop, and how clouds are read.
        calibration: of clouds that have none of their own; None: the mean of KITTI's training set.
        with_labels: whether labels are read where they are.

    Raises:
        DataError: the calibration cannot be read.
    """

    def __init__(
        self, settings: StageSettings, calibration: Path | None, with_labels: bool = True
    ) -> None:
        self.settings = settings
        self.calibration = MEAN if calibration is None else read_calibration(calibration)
        self.calibration_file = calibration or Path("--calib")
        self.with_labels = with_labels
        self._image_boxes: dict[Path, FoundInPictures] = {}

    def read(self, file: Path) -> Cloud:
        """Read one cloud.

        Raises:
            DataError: it, or a file beside it, cannot be read.
        """
        has_camera = self.settings.calibration != "axes"
        is_in_folder = file.parent.name == "velodyne"
        calib = _beside(file, "calib")
        is_calibrated = not has_camera or (is_in_folder and is_there(calib))
        # Without a calibration of its own, pictures and labels cannot be laid over a cloud.
        if not is_calibrated:
            size = self._size(self.calibration, self.calibration_file)
            return Cloud(self._frame(file, self.calibration, size), None, is_calibrated=False)
        calibration = read_calibration(calib) if has_camera else AXES
        picture = find_picture(file.parent.parent / "image_2", file.stem) if has_camera else None
        image = read_picture(picture) if picture and self.with_labels else None
        size = picture_size(picture) if picture else self._size(calibration, calib)
        frame = self._frame(file, calibration, size)
        labels = _beside(file, "label_2")
        if self.with_labels and is_in_folder and is_there(labels):
            frame = replace(frame, labels=read_labels(labels), label_file=labels)
        if is_in_folder:
            boxes, types = self._image_boxes_of(file)
            frame = replace(frame, image_boxes=boxes, image_types=types)
        return Cloud(frame, image, is_calibrated=True)

    def _size(self, calibration: Calibration, file: Path) -> tuple[int, int]:
        return self.settings.image_size or size_without_picture(calibration, file)

    def _frame(self, file: Path, calibration: Calibration, size: tuple[int, int]) -> Frame:
        points = read_cloud(file, self.settings.cloud).points_velo
        if self.settings.crop == "image":
            points = points[calibration.in_image(points, size)]
        no_labels = labels_from_columns([], np.zeros((0, 14)), scored=False)
        return Frame(file.stem, points, calibration, labels=no_labels, image_size=size)

    def _image_boxes_of(
        self, file: Path
    ) -> tuple[NDArray[np.float64] | None, NDArray[np.str_] | None]:
        """What a 2D detector found in the frame's picture, and of which classes; None where none was run."""
        root = file.parent.parent.parent
        if root not in self._image_boxes:
            self._image_boxes[root] = read_found(root, self.settings.classes)
        every = self._image_boxes[root]
        return every.of(file.stem) if every.is_there else (None, None)


def _beside(file: Path, kind: str) -> Path:
    return file.parent.parent / kind / f"{file.stem}.txt"


def _write(folder: Path, name: str, found: Labels) -> Path:
    path = folder / f"{name}.txt"
    write_atomically(path, lambda temporary: write_labels(temporary, found))
    return path


def _draw(detector: str, cloud: Cloud, found: Labels, protocol: Protocol, folder: Path) -> None:
    frame = cloud.frame
    scenes = {f"{detector}, {frame.id}": [Scene(frame, cloud.image, found, protocol.classes)]}
    boxes_of_models(scenes, protocol.ignore_beyond).write(folder / frame.id, endings=(".png",))
