"""Identities of frames, wherever they lie: of their data, of what a network reads, of what they are scored by."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from fl3d.core.digests import digest
from fl3d.data.cloud_forms import CloudFormat
from fl3d.data.kitti import KittiFolder
from fl3d.data.pictures import find_picture
from fl3d.data.text import read_bytes, unreadable

_CLOUD_SAMPLE = 4096  # bytes at either end of a cloud that enter the digest


def data_digest(folder: KittiFolder, frame_ids: Iterable[str]) -> str:
    """Identity of the data of some frames.

    Labels, calibrations and the pictures' sizes (they decide the crop) enter in full; of
    a cloud its size and both ends (a full KITTI has 14 GB of clouds), so a change in a cloud's middle that keeps
    its size goes unnoticed. How clouds are read enters where it is not as KITTI's.

    Raises:
        DataError: a file of theirs cannot be read, or a frame's picture has no size that can be told.
    """
    hashed = hashlib.sha256()
    if folder.cloud != CloudFormat():
        hashed.update(f"{folder.cloud} ".encode())
    if folder.calibration == "axes":
        hashed.update(b"axes ")
    known: dict[bytes, tuple[int, int]] = {}
    for frame_id in frame_ids:
        hashed.update(f"{frame_id} {_size_of(folder, frame_id, known)} ".encode())
        for kind in _text_files(folder):
            content = read_bytes(folder.path(kind, frame_id))
            hashed.update(f"{len(content)} ".encode() + content)
        size, ends = _ends(folder.path("velodyne", frame_id))
        hashed.update(str(size).encode() + ends)
    return hashed.hexdigest()[:16]


def image_digest(folder: KittiFolder, frame_ids: Iterable[str]) -> str | None:
    """Identity of what a 2D detector found in some frames; None where none was run."""
    if folder.image_boxes is None:
        return None
    hashed = hashlib.sha256()
    for frame_id in frame_ids:
        boxes = folder.image_boxes.get(frame_id, np.zeros((0, 5)))
        hashed.update(frame_id.encode() + boxes.tobytes())
    return hashed.hexdigest()[:16]


def input_digest(folder: KittiFolder, frame_ids: Sequence[str]) -> str:
    """Identity of all that a network reads of some frames."""
    return digest([data_digest(folder, frame_ids), image_digest(folder, frame_ids)])


def labels_digest(folder: KittiFolder, frame_ids: Iterable[str]) -> str:
    """Identity of what some frames are scored by: their labels and calibrations.

    Raises:
        DataError: one of them cannot be read.
    """
    hashed = hashlib.sha256()
    for frame_id in frame_ids:
        for kind in _text_files(folder):
            content = read_bytes(folder.path(kind, frame_id))
            hashed.update(f"{frame_id} {len(content)} ".encode() + content)
    return hashed.hexdigest()[:16]


def _text_files(folder: KittiFolder) -> tuple[str, ...]:
    """Kinds of text files that a frame of a folder has."""
    return ("label_2",) if folder.calibration == "axes" else ("label_2", "calib")


def _size_of(
    folder: KittiFolder, frame_id: str, known: dict[bytes, tuple[int, int]]
) -> tuple[int, int]:
    """``KittiFolder.image_size``, where equal calibrations are looked at once.

    Args:
        folder: that holds the frame.
        frame_id: of the frame.
        known: sizes of frames without a picture by what their calibration's file holds; what is found is added.

    Raises:
        DataError: see ``KittiFolder.image_size``.
    """
    has_picture = find_picture(folder.root / "training" / "image_2", frame_id) is not None
    if has_picture or folder.without_picture is not None or folder.calibration != "frame":
        return folder.image_size(frame_id)
    try:
        content = folder.path("calib", frame_id).read_bytes()
    except OSError:
        return folder.image_size(frame_id)  # says what is wrong
    if content not in known:
        known[content] = folder.image_size(frame_id)
    return known[content]


def _ends(cloud: Path) -> tuple[int, bytes]:
    """A cloud's size, and its first and last bytes."""
    try:
        with cloud.open("rb") as file:
            size = cloud.stat().st_size
            first = file.read(_CLOUD_SAMPLE)
            file.seek(max(0, size - _CLOUD_SAMPLE))
            return size, first + file.read(_CLOUD_SAMPLE)
    except OSError as error:
        raise unreadable(cloud, error) from None
