"""Write a simulated KITTI folder. The same settings and seed give the same bytes."""

from __future__ import annotations

import json
import shutil
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from fl3d.data.calibration import Calibration, write_calibration
from fl3d.data.kitti import IMAGE_SIZE
from fl3d.data.labels import write_labels
from fl3d.data.simulator import VERSION
from fl3d.data.simulator.annotate import annotate
from fl3d.data.simulator.scene import random_scene
from fl3d.data.simulator.sensor import CLUTTER, scan
from fl3d.data.simulator.shapes import Shape
from fl3d.files import write_text
from fl3d.leases import leased

# A pinhole camera like KITTI's left colour camera, 27 cm in front of the LiDAR and 8 cm above its origin.
CALIBRATION = Calibration(
    P2=np.array([[721.5377, 0, 609.5593, 44.85728], [0, 721.5377, 172.854, 0.2163791], [0, 0, 1, 0.002745884]]),
    R0_rect=np.eye(3),
    Tr_velo_to_cam=np.array([[0, -1.0, 0, 0.0], [0, 0, -1.0, -0.08], [1.0, 0, 0, -0.27]]),
)


@dataclass(frozen=True)
class Settings:
    """What a simulated folder holds.

    Args:
        train: number of training frames.
        val: number of validation frames.
        seed: of all randomness.
    """

    train: int
    val: int
    seed: int = 0

    @property
    def name(self) -> str:
        """Folder name; another version of the simulator gets another one."""
        return f"v{VERSION}-{self.train}-{self.val}-seed{self.seed}"


def is_whole(root: Path, settings: Settings) -> bool:
    """Whether the folder has been written."""
    return (root / settings.name / "manifest.json").exists()


def generate(root: Path, settings: Settings) -> Path:
    """Write the folder unless it is whole already.

    Args:
        root: where simulated folders lie.
        settings: what to write.

    Returns:
        the KITTI folder ``root/<settings.name>``; its ``manifest.json`` is written last.
    """
    folder = root / settings.name
    manifest = folder / "manifest.json"
    if manifest.exists():
        return folder
    with leased(root / f".{settings.name}.lease"):
        if not manifest.exists():
            _generate(folder, settings)
    return folder


def _generate(folder: Path, settings: Settings) -> None:
    shutil.rmtree(folder, ignore_errors=True)  # a generation that was interrupted
    for part in ("velodyne", "label_2", "calib"):
        (folder / "training" / part).mkdir(parents=True, exist_ok=True)
    total = settings.train + settings.val
    print(f"simulating {total} frames into {folder}", file=sys.stderr, flush=True)
    for index in tqdm(range(total), unit="frame", disable=None):
        _write_frame(folder, index, settings.seed)
    ids = [f"{i:06d}" for i in range(total)]
    write_text(folder / "ImageSets" / "train.txt", "\n".join(ids[: settings.train]) + "\n")
    write_text(folder / "ImageSets" / "val.txt", "\n".join(ids[settings.train :]) + "\n")
    manifest = {"simulator": VERSION, **asdict(settings)}
    write_text(folder / "manifest.json", json.dumps(manifest, indent=1) + "\n")


def _write_frame(folder: Path, index: int, seed: int) -> None:
    rng = np.random.default_rng([seed, index])
    scene = random_scene(rng)
    shapes: list[Shape] = []
    owners: list[int] = []
    for number, thing in enumerate(scene.things):
        shapes += thing.shapes
        owners += [number] * len(thing.shapes)
    for thing in scene.clutter:
        shapes += thing.shapes
        owners += [CLUTTER] * len(thing.shapes)
    returns = scan(shapes, owners, len(scene.things), scene.ground, rng)
    labels = annotate(scene.things, returns, CALIBRATION, IMAGE_SIZE)
    name = f"{index:06d}"
    returns.points_velo.tofile(folder / "training" / "velodyne" / f"{name}.bin")
    write_labels(folder / "training" / "label_2" / f"{name}.txt", labels)
    write_calibration(folder / "training" / "calib" / f"{name}.txt", CALIBRATION)
