"""Pictures of frames: which file, its size, and its pixels."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from fl3d.core.errors import ConfigError, DataError
from fl3d.data.calibration import Calibration
from fl3d.data.text import is_there, unreadable

IMAGE_SIZE = (1242, 375)  # pixels; of KITTI, where a frame has no picture
# Where the middle of KITTI's pictures lies: 600.4 to 609.6 and 172.9 to 185.2 pixels in its 7481 calibrations.
_KITTI_MIDDLE = ((595.0, 615.0), (167.0, 191.0))
_ENDINGS = ("png", "jpg", "jpeg")

T = TypeVar("T")


def find_picture(folder: Path, name: str) -> Path | None:
    """A frame's picture: the first that is there of ``.png``, ``.jpg`` and ``.jpeg``, in small letters or capitals."""
    if not is_there(folder):
        return None
    for ending in _ENDINGS:
        for spelled in (ending, ending.upper(), ending.capitalize()):
            path = folder / f"{name}.{spelled}"
            if is_there(path):
                return path
    return None


def picture_size(path: Path) -> tuple[int, int]:
    """(width, height) in pixels.

    Raises:
        DataError: it is no picture.
    """
    return _open(path, lambda image: image.size)


def read_picture(path: Path) -> NDArray[np.uint8]:
    """Pixels (H, W, 3).

    Raises:
        DataError: it is no picture, or a broken one.
    """
    return _open(path, lambda image: np.asarray(image.convert("RGB")))


def _open(path: Path, take: Callable[[Image.Image], T]) -> T:
    try:
        with Image.open(path) as image:
            return take(image)
    except (IsADirectoryError, FileNotFoundError, PermissionError) as error:
        raise unreadable(path, error) from None
    except (OSError, SyntaxError, ValueError, EOFError, Image.DecompressionBombError) as error:
        is_unknown = isinstance(error, UnidentifiedImageError)
        why = "of no kind that is known" if is_unknown else str(error)
        raise DataError(f"is a broken picture, or none ({why})", path) from None


def size_without_picture(calibration: Calibration, file: Path) -> tuple[int, int]:
    """(width, height) in pixels of a frame that has no picture.

    KITTI's where the middle of its camera fits, else twice the middle, as lenses sit before the middle of a sensor.

    Args:
        calibration: of the frame.
        file: that it comes from, for the error.

    Raises:
        DataError: its middle is no picture's.
    """
    middle = calibration.P2[0, 2], calibration.P2[1, 2]
    if all(low <= at <= high for at, (low, high) in zip(middle, _KITTI_MIDDLE, strict=True)):
        return IMAGE_SIZE
    width, height = (round(2 * float(at)) for at in middle)
    if width < 1 or height < 1:
        raise DataError(
            f"P2's middle is at {middle[0]:g}, {middle[1]:g} pixels, so how large a frame without a picture is cannot "
            "be told: give data.image_size=[WIDTH,HEIGHT], or, without a camera, data.calibration=axes and "
            "data.crop=none",
            file,
        )
    return width, height


def checked_size(size: object) -> tuple[int, int] | None:
    """``data.image_size`` as a pair, or None.

    Raises:
        ConfigError: it is neither null nor two whole numbers above 0.
    """
    if size is None:
        return None
    numbers = list(size) if isinstance(size, list | tuple) else []
    if len(numbers) != 2 or not all(type(n) is int and n > 0 for n in numbers):
        raise ConfigError(
            f"data.image_size: {size}, but it is null, or width and height in pixels, such as [1242,375]"
        )
    return numbers[0], numbers[1]
