"""The networks of the paper at full size, which tables, claims and figures ask for."""

from __future__ import annotations

import copy
from functools import cache
from pathlib import Path

from fl3d.config.compose import compose_config
from fl3d.config.places import own_folders
from fl3d.core.records import Config


def full_size(detector: str) -> Config:
    """Config of a detector as large as the paper's; Hydra takes a quarter of a second, so each is composed once.

    Args:
        detector: ``fcn3d`` or ``voxelnet``.
    """
    return copy.deepcopy(_composed(detector, own_folders()))


@cache
def _composed(detector: str, _: tuple[Path, ...]) -> Config:
    return compose_config((f"detector={detector}", "profile=paper"))
