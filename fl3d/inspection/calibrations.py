"""What may be odd about calibrations and pictures."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator

import numpy as np

from fl3d.data.calibration import Calibration
from fl3d.inspection.facts import Facts
from fl3d.inspection.finding import Finding, warning

UPRIGHT = 0.85  # cosine; a camera that is tilted by more than 30 degrees
AHEAD = 0.5  # cosine; a camera that looks more than 60 degrees away from the LiDAR's x
FARTHEST = 10.0  # metres between the sensors of one car
OFF_CENTRE = 0.25  # of the picture: how far its middle may be from the camera's


def of_calibrations(facts: Facts) -> Iterator[Finding]:
    """Everything that looks odd in calibrations, by what is odd, with the first of the files."""
    if facts.kitti.calibration != "frame":
        return
    found: dict[str, list[str]] = {}
    advices: dict[str, tuple[str, str]] = {}
    for frame_id, beside in facts.beside.items():
        if beside.calibration is None:
            continue
        for kind, message, advice in _oddities(
            beside.calibration, beside.image_size, beside.picture
        ):
            found.setdefault(kind, []).append(frame_id)
            advices.setdefault(kind, (message, advice))
    for kind, ids in found.items():
        message, advice = advices[kind]
        yield warning(message, advice, facts.kitti.path("calib", ids[0]), len(ids))


def _oddities(
    calibration: Calibration, size: tuple[int, int] | None, picture: str | None
) -> Iterator[tuple[str, str, str]]:
    """Kind, message and advice of what is odd in one calibration."""
    turn, shift = calibration.velo_to_rect[:, :3], calibration.velo_to_rect[:, 3]
    down, ahead = float(-turn[1, 2]), float(turn[2, 0])
    if down < UPRIGHT:
        axes = ", ".join(f"{name} is {_axis(row)}" for name, row in zip("xyz", turn, strict=True))
        yield (
            "axes",
            f"the camera's axes are not x right, y down, z forward: in the LiDAR's frame {axes}.",
            "They are right the other way round: is Tr_velo_to_cam its inverse, camera to LiDAR, or transposed?"
            if -turn[2, 1] >= UPRIGHT and turn[0, 2] >= AHEAD
            else "KITTI's Tr_velo_to_cam turns the axes; without a camera give data.calibration=axes data.crop=none.",
        )
    elif ahead < AHEAD:
        yield (
            "ahead",
            f"the camera does not look along the LiDAR's x axis, but along {_axis(turn[2])}.",
            "The detectors look along x; data.crop=image keeps what this camera sees.",
        )
    if np.linalg.norm(shift) > FARTHEST:
        yield (
            "shift",
            f"the camera is {np.linalg.norm(shift):.4g} m from the LiDAR.",
            "Is Tr_velo_to_cam in millimetres, or from another frame?",
        )
    fx, fy = calibration.P2[0, 0], calibration.P2[1, 1]
    if not 0.5 < fx / fy < 2:
        yield ("focal", f"P2's focal lengths are {fx:g} and {fy:g} pixels.", "")
    if size is not None and picture is not None:
        middle = np.array([calibration.P2[0, 2], calibration.P2[1, 2]]) / size
        if (np.abs(middle - 0.5) > OFF_CENTRE).any():
            at = f"{calibration.P2[0, 2]:.0f}, {calibration.P2[1, 2]:.0f}"
            yield (
                "middle",
                f"the picture has {size[0]} x {size[1]} pixels, but P2's middle is at {at}.",
                "Were the pictures scaled or cropped? P2 must be changed with them.",
            )


def _axis(row: np.ndarray) -> str:
    """A direction of the LiDAR's frame in words: ``-y``, or its numbers."""
    k = int(np.abs(row).argmax())
    if abs(row[k]) < 0.9:
        return f"({', '.join(f'{value:.2f}' for value in row)})"
    return f"{'-' if row[k] < 0 else '+'}{'xyz'[k]}"


def _unread(facts: Facts) -> Iterator[Finding]:
    """Pictures of a kind that is not read, of frames that have no other."""
    folder = facts.kitti.root / "training" / "image_2"
    names = {path.stem: path.name for path in folder.glob("*")} if folder.is_dir() else {}
    found = [names[i] for i, one in facts.beside.items() if one.picture is None and i in names]
    if found:
        yield warning(
            "is not read: pictures are .png, .jpg or .jpeg, and no links to nothing.",
            "The frame's size is taken from the calibration, or data.image_size.",
            folder / found[0],
            len(found),
        )


def of_pictures(facts: Facts) -> Iterator[Finding]:
    """Frames with and without pictures, and several sizes without any."""
    endings = Counter(one.picture for one in facts.beside.values())
    n_without = endings.pop(None, 0)
    if n_without:
        yield from _unread(facts)
    if n_without and endings:
        first = next(i for i, one in facts.beside.items() if one.picture is None)
        yield warning(
            f"no picture, while {sum(endings.values())} frames have one.",
            "A frame without one takes its size from the calibration, or data.image_size.",
            facts.kitti.path("image_2", first),
            n_without,
        )
