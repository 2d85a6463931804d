"""A picture of a simulated frame whose folder was written without pictures: rendered when it is asked for."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.simulator import VERSION
from fl3d.simulator.generate import Settings, picture_of

MANIFEST = "manifest.json"  # of what a folder was simulated by


def picture_again(folder: Path, frame_id: str) -> NDArray[np.uint8] | None:
    """The picture that the simulator would have written beside a frame.

    Args:
        folder: KITTI folder, whoever wrote it.
        frame_id: of a frame in it.

    Returns:
        (H, W, 3); None where this version of the simulator has not written the folder.
    """
    try:
        told = json.loads((folder / MANIFEST).read_text(encoding="utf-8"))
        version = told.pop("simulator")
        settings = Settings(**told)
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return None
    is_own = version == VERSION and frame_id.isdecimal()
    if not is_own or int(frame_id) >= settings.train + settings.val:
        return None
    return picture_of(settings, int(frame_id))
