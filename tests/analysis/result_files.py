"""Labels and result files of detectors whose APs follow by hand: a car in each frame, found or not."""

from collections.abc import Callable, Sequence
from pathlib import Path

from fl3d.analysis.detectors import Detector
from fl3d.evaluation.protocol import Protocol

N = 20  # frames; with no more than 40 ground truths each hit is a recall sample
LIDAR = "lidar"
# Type, truncated, occluded, alpha, 2D box, height, width, length, x, y, z, rotation_y.
CAR = "Car 0.00 {occluded} 0.00 500.00 150.00 650.00 250.00 1.50 1.60 4.00 {x:.2f} 1.70 {z:.2f} {ry:.2f}"
FLAT = "Car 0.00 0 0.00 500.00 150.00 650.00 250.00 -1 -1 -1 -1000 -1000 -1000 -10"
BARE = "Car 0.00 0 0.00 0 0 0 0 1.50 1.60 4.00 0.00 1.70 {z:.2f} 0.00"


def car(z: float = 20.0, x: float = 0.0, ry: float = 0.0, occluded: int = 0) -> str:
    """A line of a label file: easy, ahead of the camera."""
    return CAR.format(x=x, z=z, ry=ry, occluded=occluded)


def protocol(difficulty: str = "image") -> Protocol:
    """KITTI's own for cars; or one that needs no picture."""
    overlaps = {"Car": (0.7, 0.7, 0.7), "Pedestrian": (0.5, 0.5, 0.5)}
    return Protocol("kitti", "B", overlaps, 0.0, 0.1, "standup", 1000, difficulty=difficulty)


def write_labels_of(root: Path, lines: Sequence[str] = (car(),) * N) -> Path:
    """A folder of labels, a car a frame."""
    folder = root / "training" / "label_2"
    folder.mkdir(parents=True)
    for number, line in enumerate(lines):
        (folder / f"{number:06d}.txt").write_text(f"{line}\n")
    return folder


def write_results(
    folder: Path,
    found: int | Sequence[int],
    line: Callable[[int], str] = lambda number: car(),
    shift: float = 0.0,
    n: int = N,
) -> Path:
    """A folder of results that has found the cars of some frames: those numbered, or the first so many.

    Args:
        folder: is made.
        found: numbers of frames, or how many.
        line: what is found in a frame, without its score.
        shift: added to the scores, so that runs differ.
        n: frames in all; where nothing is found a file is empty.
    """
    folder.mkdir(parents=True)
    numbers = range(found) if isinstance(found, int) else found
    for number in range(n):
        score = 0.9 - 0.01 * number + shift
        text = f"{line(number)} {score:.4f}\n" if number in numbers else ""
        (folder / f"{number:06d}.txt").write_text(text)
    return folder


def runs(root: Path, name: str, found: Sequence[int]) -> Detector:
    """A detector of several runs that have found so many cars each."""
    folders = [write_results(root / f"{name}{i}", n, shift=0.0001 * i) for i, n in enumerate(found)]
    return Detector(name, tuple(folders))
