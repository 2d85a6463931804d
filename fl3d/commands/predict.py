"""``predict``: a trained detector on anybody's clouds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from fl3d.commands.parsing import parser
from fl3d.core.errors import ConfigError
from fl3d.core.errors import options as options_of
from fl3d.core.loading import loading

KEYS = (
    "data.cloud.columns",
    "data.cloud.dtype",
    "data.cloud.reflectance_scale",
    "data.image_size",
)


def run(arguments: list[str]) -> None:
    """Run a trained detector on clouds.

    It writes KITTI result files, and a picture of each cloud with its boxes.
    """
    options = parser("predict", run.__doc__)
    options.add_argument(
        "checkpoint",
        type=Path,
        help="a stage's folder, runs/stages/NAME (its last), or its .pt file",
    )
    options.add_argument(
        "clouds",
        type=Path,
        help="a file of a cloud (.bin, .npy, .pcd), a folder of them, or a KITTI folder",
    )
    options.add_argument(
        "reading",
        nargs="*",
        metavar="KEY=VALUE",
        help=f"how clouds are read, if not as in training: {', '.join(KEYS)} (docs/data.md)",
    )
    options.add_argument(
        "--out",
        type=Path,
        default=Path("predictions"),
        help="folder (default: predictions)",
    )
    options.add_argument(
        "--score",
        type=float,
        default=0.5,
        help="boxes from this posterior on (default: 0.5)",
    )
    options.add_argument(
        "--calib",
        type=Path,
        help="of clouds that have none beside them (default: KITTI's mean)",
    )
    options.add_argument("--device", default="cpu", help="cpu or cuda (default: cpu)")
    options.add_argument("--no-pictures", action="store_true", help="write result files alone")
    given = options.parse_intermixed_args(arguments)
    with loading():
        from fl3d.inference.predict import predict

    predict(
        given.checkpoint,
        given.clouds,
        given.out,
        score=given.score,
        calibration=given.calib,
        device=given.device,
        pictures=not given.no_pictures,
        reading=_reading(given.reading),
    )


def _reading(words: Sequence[str]) -> dict[str, Any]:
    """Values of the keys that say how clouds are read.

    Raises:
        ConfigError: a word is no such key with a value.
    """
    from fl3d.config.overrides import values_by_key
    from fl3d.data.pictures import checked_size

    read: dict[str, Any] = {}
    for word in words:
        key = word.partition("=")[0]
        if key not in KEYS or "=" not in word:
            raise ConfigError(f"predict: no key '{word}'. {options_of(key, KEYS)}")
        name = key.rpartition(".")[2]
        *_, value = values_by_key([word])[key]
        read[name] = checked_size(value) if name == "image_size" else value
    return read
