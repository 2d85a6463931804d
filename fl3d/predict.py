"""Let a trained detector look at clouds: KITTI result files and pictures, for whoever wants to see it work."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from PIL import Image
from tqdm import tqdm

from fl3d.data.calibration import MEAN, read_calibration
from fl3d.data.image_boxes import read_image_boxes
from fl3d.data.kitti import IMAGE_SIZE, Frame, read_cloud
from fl3d.data.labels import Labels, labels_from_columns, read_labels, write_labels
from fl3d.detectors.base import Detector
from fl3d.errors import CheckpointError, ConfigError, DataError
from fl3d.evaluation.detections import to_labels
from fl3d.evaluation.protocol import Protocol
from fl3d.files import write_atomically
from fl3d.records import Config, Stage, StagePaths
from fl3d.reports.figures.boxes import Scene, figure_1
from fl3d.training.build import build_detector
from fl3d.training.checkpoints import load_state, read_marker
from fl3d.training.precision import multiplying
from fl3d.training.reproducibility import prepare
from fl3d.training.trainer import to_device

PLACES = ("velodyne", "training/velodyne", "testing/velodyne", ".")  # where a folder's clouds are looked for
KINDS = {"calib": "txt", "image_2": "png", "label_2": "txt"}  # what may lie beside a folder velodyne


def predict(
    checkpoint: Path,
    clouds: Path,
    out: Path,
    score: float = 0.5,
    calibration: Path | None = None,
    device: str = "cpu",
    pictures: bool = True,
    say: Callable[[str], None] = print,
) -> list[Path]:
    """Write what a checkpoint finds in clouds.

    Args:
        checkpoint: a stage's folder (its last checkpoint), or one of its ``.pt`` files.
        clouds: a ``.bin`` file of KITTI's format, a folder of them, or a KITTI folder. Beside a folder ``velodyne``,
            ``calib``, ``image_2`` and ``label_2`` are used where they are.
        out: folder of the result files ``ID.txt``, and of pictures ``ID.png``.
        score: posterior from which on a box is written.
        calibration: of all clouds that have none of their own; None: the mean of KITTI's training set.
        device: torch's name of it.
        pictures: whether to draw.
        say: prints a line for the user.

    Returns:
        the result files.

    Raises:
        CheckpointError: no checkpoint there, or one of a version whose network this one does not build.
        DataError: no clouds there, or one cannot be read.
        ConfigError: a device that is not there.
    """
    paths, step = _checkpoint(checkpoint)
    spec = json.loads(paths.spec.read_text())
    stage = Stage(**spec["stage"])
    if device != "cpu" and not (device.startswith("cuda") and torch.cuda.is_available()):
        raise ConfigError(f"--device {device}: possible here: cpu" + (", cuda" if torch.cuda.is_available() else ""))
    found = _clouds(clouds.resolve())
    protocol = Protocol(**{**spec["machine"]["protocol"], "score_threshold": score, "image_box": "clipped"})
    precision = stage.config.get("precision", "float32")
    prepare(stage.config["seed"], device, precision)
    detector = _network(stage, paths, step).to(device).eval()
    say(f"{type(detector).NAME}, {paths.folder.name}, step {step}: {len(found)} clouds into {out}")
    written, without = [], 0
    for cloud in tqdm(found, unit="cloud", disable=None):
        frame, image, is_own = _frame(cloud, calibration, stage.config["data"]["crop"])
        without += not is_own
        with multiplying(precision, device):
            labels = _look(detector, frame, stage.config, device, protocol)
        path = out / f"{frame.id}.txt"
        write_atomically(path, lambda temporary, labels=labels: write_labels(temporary, labels))  # type: ignore[misc]
        written.append(path)
        if pictures:
            title = f"{type(detector).NAME}, {frame.id}"
            figure_1({title: [Scene(frame, image, labels)]}, protocol.ignore_beyond, out / frame.id, (".png",))
    if without:
        used = calibration or "the mean of KITTI's training set"
        say(f"{without} clouds have no calibration of their own: {used} was taken for them")
    return written


def _network(stage: Stage, paths: StagePaths, step: int) -> Detector:
    try:
        detector = build_detector(stage.config)
        detector.load_state_dict(load_state(paths.weights(step))["model"])
    except (ConfigError, RuntimeError) as error:
        commit = read_marker(paths, step).made_by.get("mlflow.source.git.commit", "unknown")
        raise CheckpointError(
            f"{paths.weights(step)}: made by another version of fl3d ({commit[:10]}), whose network differs: {error}"
        ) from None
    return detector


def _checkpoint(path: Path) -> tuple[StagePaths, int]:
    folder = path if path.is_dir() else path.parent.parent
    paths = StagePaths(folder)
    if not paths.spec.exists():
        raise CheckpointError(f"{path}: no stage's folder, such as runs/stages/NAME, and no .pt file in one")
    kept = [step for step in paths.steps() if paths.weights(step).exists()]
    if path.is_dir() and kept:
        return paths, kept[-1]
    if path.is_dir() or path.stem not in {f"{step:08d}" for step in kept}:
        there = ", ".join(str(paths.weights(step)) for step in kept) or "none"
        raise CheckpointError(f"{path}: no weights. Possible: {there}")
    return paths, int(path.stem)


def _clouds(path: Path) -> list[Path]:
    if path.is_file():
        return [path]
    for place in PLACES:
        found = sorted((path / place).glob("*.bin"))
        if found:
            return found
    raise DataError(f"no cloud (*.bin), here or in {', '.join(PLACES[:-1])}", path)


def _frame(cloud: Path, calibration: Path | None, crop: str) -> tuple[Frame, np.ndarray | None, bool]:
    """A cloud with what lies beside it; its picture; and whether its calibration is its own."""
    beside = {kind: cloud.parent.parent / kind / f"{cloud.stem}.{end}" for kind, end in KINDS.items()}
    is_own = cloud.parent.name == "velodyne" and beside["calib"].exists()
    if is_own:
        own = read_calibration(beside["calib"])
    else:
        own = read_calibration(calibration) if calibration is not None else MEAN
    image, size = None, IMAGE_SIZE
    if is_own and beside["image_2"].exists():
        with Image.open(beside["image_2"]) as opened:
            image = np.asarray(opened.convert("RGB"))
        size = image.shape[1], image.shape[0]
    labels = labels_from_columns([], np.zeros((0, 14)), scored=False)
    if is_own and beside["label_2"].exists():
        labels = read_labels(beside["label_2"])
    points = read_cloud(cloud)
    if crop == "image":
        points = points[own.in_image(points, size)]
    found = read_image_boxes(cloud.parent.parent.parent) if is_own else None
    image_boxes = None if found is None else found.get(cloud.stem, np.zeros((0, 5)))
    return Frame(cloud.stem, points, own, labels, size, image_boxes), image, is_own


@torch.no_grad()
def _look(detector: Detector, frame: Frame, config: Config, device: str, protocol: Protocol) -> Labels:
    sample = detector.encode(frame, np.random.default_rng([0, 0]), training=False)
    limits = config["detections"]
    batch = to_device(detector.collate([sample]), device)
    (found,) = detector.detect(batch, limits["max_boxes"], min(limits["min_score"], protocol.score_threshold))
    return to_labels(found.boxes_velo, found.scores, found.boxes_image, frame.calibration, frame.image_size, protocol)
