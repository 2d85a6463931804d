"""Write a simulated KITTI folder. The same settings give the same bytes, whatever the number of workers."""

from __future__ import annotations

import io
import json
import os
import sys
from collections.abc import Iterable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np
from PIL import Image
from tqdm import tqdm

from fl3d.core.errors import DataError
from fl3d.core.files import TEMPORARY, write_atomically, write_text
from fl3d.core.leases import leased
from fl3d.core.processes import KILLED, cores, pool
from fl3d.data.calibration_files import write_calibration
from fl3d.data.kitti import IMAGE_SIZE
from fl3d.data.labels import read_labels, write_labels
from fl3d.simulator import VERSION
from fl3d.simulator.annotate import annotate
from fl3d.simulator.camera import CALIBRATION, OTHERS, take_picture
from fl3d.simulator.camera import Image as Pixels
from fl3d.simulator.hdl64 import CAMERA_VIEW
from fl3d.simulator.image_detector import NUMBERS, detect_in_image
from fl3d.simulator.lidar import scan
from fl3d.simulator.scene import random_scene
from fl3d.simulator.site import Site
from fl3d.simulator.solids import Solids

CHUNK = 8  # frames that a worker takes at a time
TRIES = 3  # to write all frames, where processes are killed
FEW = 32  # frames for which starting workers does not pay
PICTURE_SEED, DETECTIONS_SEED = (
    1,
    2,
)  # so that a frame's cloud is the same with or without its picture


Told = dict[str, int | float | bool]  # what a folder says of itself


@dataclass(frozen=True)
class Settings:
    """What a simulated folder holds.

    Args:
        train: number of training frames.
        val: number of validation frames.
        seed: of all randomness.
        pictures: whether ``image_2`` is rendered.
        whole_turn: whether clouds go all around; else the part that the camera sees, and a little more.
        people: how many times as often as in KITTI there are pedestrians and cyclists; None: the streets that the
            published results were made from.
    """

    train: int
    val: int
    seed: int = 0
    pictures: bool = False
    whole_turn: bool = False
    people: float | None = None

    @property
    def name(self) -> str:
        """Folder name; another version of the simulator gets another one."""
        extras = ("-pictures" if self.pictures else "") + ("-whole" if self.whole_turn else "")
        extras += "" if self.people is None else f"-people{self.people:g}"
        return f"v{VERSION}-{self.train}-{self.val}-seed{self.seed}{extras}"


def is_whole(root: Path, settings: Settings) -> bool:
    """Whether the folder has been written."""
    return (root / settings.name / "manifest.json").exists()


def generate(root: Path, settings: Settings) -> Path:
    """Write the folder below a root that holds several, unless it is whole already.

    Args:
        root: where simulated folders lie.
        settings: what to write.

    Returns:
        the KITTI folder ``root/<settings.name>``.
    """
    folder = root / settings.name
    if not is_whole(root, settings):
        with leased(root / f".{settings.name}.lease"):
            write_folder(folder, settings)
    return folder


def write_folder(folder: Path, settings: Settings, workers: int | None = None) -> None:
    """Write a KITTI folder; what is there already, from a run that was interrupted, is kept.

    Args:
        folder: to be written; its ``manifest.json`` comes last.
        settings: what to write.
        workers: processes; None: one a core. They do not change a byte.

    Raises:
        DataError: the folder holds something else.
    """
    if (folder / "manifest.json").exists() and _told(folder / "manifest.json", folder) == _tell(
        settings
    ):
        return
    _claim(folder, settings)
    total = settings.train + settings.val
    _write_frames(folder, settings, total, workers)
    ids = [f"{index:06d}" for index in range(total)]
    splits = {"train": ids[: settings.train], "val": ids[settings.train :], "trainval": ids}
    for name, own in splits.items():
        write_text(
            folder / "ImageSets" / f"{name}.txt", "".join(f"{frame_id}\n" for frame_id in own)
        )
    for name in ("train", "val"):
        lines = [
            line
            for frame_id in splits[name]
            for line in _detections(folder, settings, int(frame_id))
        ]
        write_text(folder / "rgb_detections" / f"rgb_detection_{name}.txt", "".join(lines))
    os.sync()  # once, and not for each of thousands of files
    write_text(folder / "manifest.json", json.dumps(_tell(settings), indent=1) + "\n")


def _write_frames(folder: Path, settings: Settings, total: int, workers: int | None) -> None:
    """Write the frames that are missing.

    Raises:
        DataError: the processes that write them were killed again and again.
    """
    for _ in range(TRIES):
        missing = [index for index in range(total) if not _label(folder, index).exists()]
        if missing:
            done = f", {total - len(missing)} of them are there" if len(missing) < total else ""
            print(f"simulating {total} frames into {folder}{done}", file=sys.stderr, flush=True)
        try:
            with tqdm(total=total, initial=total - len(missing), unit="frame", disable=None) as bar:
                for _ in _written(partial(_write_frame, folder, settings), missing, workers):
                    bar.update()
            return
        except KILLED:
            print("A process that simulates was killed.", file=sys.stderr, flush=True)
    raise DataError(
        f"processes that simulate were killed {TRIES} times, perhaps for want of memory; the same command goes on",
        folder,
    )


def _tell(settings: Settings) -> Told:
    told = asdict(settings)
    if settings.people is None:
        del told["people"]  # came later than folders that are kept
    return {"simulator": VERSION, **told}


def _told(path: Path, folder: Path) -> Told:
    try:
        told: Told = json.loads(path.read_text(encoding="utf-8"))
    except ValueError:
        raise DataError("is no record of the simulator; give another folder", path) from None
    return told


def _claim(folder: Path, settings: Settings) -> None:
    """Note what the folder is being filled with, or refuse to mix it with something else."""
    note = folder / "settings.json"
    if note.exists():
        if (before := _told(note, folder)) != _tell(settings):
            raise DataError(
                f"holds frames of other settings ({before}); give another folder, or remove it",
                folder,
            )
    elif (folder / "training").exists() or (folder / "manifest.json").exists():
        raise DataError("holds something that is not the simulator's; give another folder", folder)
    try:
        for part in ("velodyne", "label_2", "calib", *(("image_2",) if settings.pictures else ())):
            (folder / "training" / part).mkdir(parents=True, exist_ok=True)
        for torn in folder.rglob(TEMPORARY):
            torn.unlink()  # of a process that was killed
        write_text(note, json.dumps(_tell(settings), indent=1) + "\n")
    except OSError as error:
        raise DataError(f"cannot be written ({error.strerror})", folder) from None


def _written(write: partial[None], indices: list[int], workers: int | None) -> Iterator[None]:
    """Write frames here or in processes, as they come."""
    workers = workers or cores()
    if workers == 1 or len(indices) < FEW:
        yield from map(write, indices)
        return
    write(indices[0])  # compiles what is not yet in numba's cache, once
    yield None
    with pool(workers) as processes:
        yield from processes.map(write, indices[1:], chunksize=CHUNK)


def _label(folder: Path, index: int) -> Path:
    return folder / "training" / "label_2" / f"{index:06d}.txt"


def _write_frame(folder: Path, settings: Settings, index: int) -> None:
    """Write one frame; its label file comes last."""
    site, rng = _site(settings, index)
    solids = site.solids()
    half_view = 180.0 if settings.whole_turn else CAMERA_VIEW
    returns = scan(solids, len(site.things), site.ground, rng, half_view)
    labels = annotate(site.things, returns, CALIBRATION, IMAGE_SIZE, rng)
    training, name = folder / "training", f"{index:06d}"
    _write_bytes(training / "velodyne" / f"{name}.bin", returns.points_velo.tobytes())
    calib = training / "calib" / f"{name}.txt"
    write_atomically(
        calib, partial(write_calibration, calibration=CALIBRATION, others=OTHERS), flush=False
    )
    if settings.pictures:
        picture = _picture(site, solids, settings, index)
        encoded = io.BytesIO()
        Image.fromarray(picture).save(encoded, "PNG", compress_level=1)
        _write_bytes(training / "image_2" / f"{name}.png", encoded.getvalue())
    write_atomically(_label(folder, index), partial(write_labels, labels=labels), flush=False)


def picture_of(settings: Settings, index: int) -> Pixels:
    """The picture (H, W, 3) of a frame, whether or not the folder holds any."""
    site = _site(settings, index)[0]
    return _picture(site, site.solids(), settings, index)


def _site(settings: Settings, index: int) -> tuple[Site, np.random.Generator]:
    """A frame's scene, and the generator that made it, with which it is looked at."""
    rng = np.random.default_rng([settings.seed, index])
    half_view = 180.0 if settings.whole_turn else CAMERA_VIEW
    return random_scene(rng, half_view, settings.people), rng


def _picture(site: Site, solids: Solids, settings: Settings, index: int) -> Pixels:
    return take_picture(
        solids, site.ground, np.random.default_rng([settings.seed, index, PICTURE_SEED])
    )


def _write_bytes(path: Path, content: bytes) -> None:
    write_atomically(path, lambda temporary: temporary.write_bytes(content), flush=False)


def _detections(folder: Path, settings: Settings, index: int) -> Iterable[str]:
    """Lines of the 2D detections' file: path, class, score, box."""
    rng = np.random.default_rng([settings.seed, index, DETECTIONS_SEED])
    found = detect_in_image(read_labels(_label(folder, index)), IMAGE_SIZE, rng)
    path = f"training/image_2/{index:06d}.png"
    for kind, score, box in zip(found.kinds, found.scores, found.boxes, strict=True):
        yield f"{path} {NUMBERS[kind]} {score:.6g} {' '.join(f'{edge:.0f}' for edge in box)}\n"
