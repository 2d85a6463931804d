"""Write result files of a detector that does not exist: the labels, moved about. For trying `compare`.

python docs/made_up_results.py LABELS RUN0 RUN1 RUN2 --error 0.3
"""

import argparse
from pathlib import Path

import numpy as np

from fl3d.data.labels import Labels, read_labels, write_labels

SEES = 60.0  # metres: the share of cars that are found falls to 0 towards it
ALARMS = 0.5  # false alarms a frame, on average
SPREAD = 0.1  # no two trainings end alike: standard deviation of a run's error, as a share
CAR = (1.5, 1.6, 3.9)  # metres: height, width, length of a false alarm


def main() -> None:
    """Write a result file for each label file, in a folder for each run."""
    options = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    options.add_argument("labels", type=Path, help="folder of label files")
    options.add_argument("out", type=Path, nargs="+", help="folder of results, one for each run")
    options.add_argument("--error", type=float, default=0.3, help="of boxes at 30 m, metres")
    options.add_argument("--seed", type=int, default=0, help="of the first run")
    given = options.parse_args()
    for seed, folder in enumerate(given.out, start=given.seed):
        folder.mkdir(parents=True, exist_ok=True)
        rng = np.random.default_rng(seed)
        error = given.error * rng.normal(1.0, SPREAD)
        for path in sorted(given.labels.glob("*.txt")):
            write_labels(folder / path.name, detect(read_labels(path), error, rng))


def detect(labels: Labels, error: float, rng: np.random.Generator) -> Labels:
    """What the detector finds in a frame."""
    cars = labels.select(labels.types == "Car")
    far = np.hypot(cars.boxes_cam[:, 0], cars.boxes_cam[:, 2]) / SEES
    found = cars.select(rng.uniform(size=len(cars)) > far**2)
    far = np.hypot(found.boxes_cam[:, 0], found.boxes_cam[:, 2]) / SEES
    boxes = found.boxes_cam.copy()
    boxes[:, [0, 2]] += rng.normal(size=(len(found), 2)) * error * far[:, None] * 2
    boxes[:, 3:6] *= rng.normal(1, 0.1 * error, size=(len(found), 3))
    scores = np.clip(rng.normal(1 - far, 0.15), 0.01, 0.99)
    return joined_results(found, boxes, scores, rng)


def joined_results(
    found: Labels, boxes: np.ndarray, scores: np.ndarray, rng: np.random.Generator
) -> Labels:
    """Cars that are found, and false alarms behind them."""
    n = rng.poisson(ALARMS)
    places = np.column_stack([rng.uniform(-15, 15, n), np.full(n, 1.7), rng.uniform(8, 50, n)])
    alarms = np.column_stack([places, np.tile(CAR, (n, 1)), rng.uniform(-np.pi, np.pi, n)])
    middle, half = 620 + 720 * places[:, 0] / places[:, 2], 720 * 0.8 / places[:, 2]
    image = np.column_stack([middle - half, np.full(n, 180.0), middle + half, 180 + 2 * half])
    return Labels(
        types=np.array(["Car"] * (len(found) + n), dtype=np.str_),
        truncated=np.zeros(len(found) + n),
        occluded=np.zeros(len(found) + n, dtype=np.int64),
        alpha=np.full(len(found) + n, -10.0),
        boxes_image=np.concatenate([found.boxes_image, image]),
        boxes_cam=np.concatenate([boxes, alarms]),
        scores=np.concatenate([scores, rng.uniform(0.01, 0.6, n)]),
    )


if __name__ == "__main__":
    main()
