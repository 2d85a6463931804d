"""``predict``: a trained detector on anybody's clouds."""

from __future__ import annotations

from pathlib import Path

from fl3d.commands.words import parser
from fl3d.inference.predict import predict


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
        help="a .bin file, a folder of them, or a KITTI folder",
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
    given = options.parse_args(arguments)
    predict(
        given.checkpoint,
        given.clouds,
        given.out,
        score=given.score,
        calibration=given.calib,
        device=given.device,
        pictures=not given.no_pictures,
    )
