"""What is drawn again to see how sure an AP is: frames, or the drives that they were recorded on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.data.drives import has_mapping, read_drives
from fl3d.runs.finished import FinishedSweep

# Of three drives, intervals that are widened for so few still hold the truth in 95 to 97 %, frames in 39 to 47 %
# (benchmarks/README.md, intervals); two say nothing of how much drives differ.
FEWEST_DRIVES = 3


@dataclass(frozen=True)
class Units:
    """The units of a sweep's validation frames.

    Args:
        name: ``frames`` or ``drives``.
        of_frames: (F,) the unit of each frame.
        note: what a reader must know of them, as one sentence.
    """

    name: str
    of_frames: NDArray[np.int64]
    note: str

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.of_frames.max()) + 1 if len(self.of_frames) else 0


def units_of(sweep: FinishedSweep) -> Units:
    """Drives where KITTI's mapping of frames to drives is at hand, else frames.

    Args:
        sweep: its run folders must be at hand.

    Raises:
        DataError: the mapping cannot be read, or does not know a frame.
    """
    ids = sweep.validation.ids
    data = sweep.settings.data
    frames = np.arange(len(ids))
    if data.generate:
        return Units(
            "frames", frames, f"Resampled: {len(ids)} simulated frames, each of its own street."
        )
    folder = data.mapping or sweep.kitti().root / "mapping"
    return units_of_frames(ids, folder, "data.mapping")


def units_of_frames(ids: Sequence[str], mapping: Path, option: str) -> Units:
    """Drives where a folder holds KITTI's mapping, else frames.

    Args:
        ids: of the frames.
        mapping: a folder that may hold the mapping.
        option: by which a user names that folder.

    Raises:
        DataError: the mapping cannot be read, or does not know a frame.
    """
    frames = np.arange(len(ids))
    if not has_mapping(mapping):
        why = f"their drives are not known ({option} names KITTI's mapping)"
        return Units(
            "frames", frames, f"Resampled: {len(ids)} frames, taken as independent: {why}."
        )
    names, drives = np.unique(read_drives(mapping, ids), return_inverse=True)
    if len(names) < FEWEST_DRIVES:
        why = f"{len(names)} drives are too few to be resampled (at least {FEWEST_DRIVES})"
        return Units(
            "frames", frames, f"Resampled: {len(ids)} frames, taken as independent: {why}."
        )
    return Units("drives", drives, f"Resampled: {len(names)} drives with their {len(ids)} frames.")
