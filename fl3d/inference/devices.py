"""Which devices there are; what is asked for and is not there is refused before anything is started."""

from __future__ import annotations

import re

import torch

from fl3d.core.errors import ConfigError

_NAME = re.compile(r"cpu|cuda(?::(\d+))?")


def check_device(device: object, key: str, is_here: bool = True) -> None:
    """Refuse a device that does not exist.

    Args:
        device: torch's name of it.
        key: how the user gave it, such as ``device=``.
        is_here: whether it must be one of this machine; else only its name is looked at.

    Raises:
        ConfigError: lists what is possible here.
    """
    match = _NAME.fullmatch(str(device))
    if match is None:
        raise ConfigError(f"{key}{device}: no such device. Possible: {_possible()}")
    if not is_here or device == "cpu":
        return
    cards = torch.cuda.device_count() if torch.cuda.is_available() else 0
    if int(match[1] or 0) >= cards:
        found = f"{cards} CUDA devices" if cards else "no CUDA device"
        raise ConfigError(f"{key}{device}: {found} here. Possible: {_possible()}")


def _possible() -> str:
    if not torch.cuda.is_available():
        return "cpu (and cuda, where there is one)"
    cards = torch.cuda.device_count()
    return ", ".join(["cpu", "cuda", *(f"cuda:{card}" for card in range(cards) if cards > 1)])
