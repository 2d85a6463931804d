"""The simulator beside real KITTI: the shares that decide how hard a dataset is, and the stand-in for a 2D detector."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from fl3d.data.kitti import IMAGE_SIZE, KittiFolder
from fl3d.data.labels import Labels
from fl3d.simulator.generate import Settings, generate
from fl3d.simulator.image_detector import NUMBERS, detect_in_image

Found = Mapping[str, Sequence[tuple[str, float, np.ndarray]]]  # by frame: class, score, box


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> KittiFolder:
    """300 simulated frames."""
    return KittiFolder(generate(tmp_path_factory.mktemp("many"), Settings(300, 0, seed=11)))


def cars(folder: KittiFolder, ids: Sequence[str]) -> Labels:
    """All cars of some frames, as if of one."""
    rows = [folder.read_labels(i) for i in ids]
    keep = [labels.select(labels.types == "Car") for labels in rows]
    return Labels(
        *(
            np.concatenate([getattr(labels, name) for labels in keep])
            for name in ("types", "truncated", "occluded", "alpha", "boxes_image", "boxes_cam")
        )
    )


def levels(labels: Labels) -> np.ndarray:
    """Shares that reach easy, moderate and hard."""
    height = labels.boxes_image[:, 3] - labels.boxes_image[:, 1]
    limits = ((40, 0, 0.15), (25, 1, 0.3), (25, 2, 0.5))
    return np.array(
        [
            ((height >= h) & (labels.occluded <= o) & (labels.truncated <= t)).mean()
            for h, o, t in limits
        ]
    )


def test_cars_are_as_hard_as_kittis(many: KittiFolder, kitti_sample: Path) -> None:
    real = KittiFolder(kitti_sample)
    theirs, ours = cars(real, real.split("train")), cars(many, many.split("train"))
    np.testing.assert_allclose(levels(ours), levels(theirs), atol=0.09)
    for column in (3, 4, 5):  # h, w, l
        sizes = [labels.boxes_cam[:, column] for labels in (ours, theirs)]
        np.testing.assert_allclose(
            *[np.quantile(size, [0.1, 0.5, 0.9]) for size in sizes], atol=0.12
        )
    per_frame = [
        len(labels) / len(ids)
        for labels, ids in ((ours, many.split("train")), (theirs, real.split("train")))
    ]
    assert 0.8 < per_frame[0] / per_frame[1] < 1.5


def test_clouds_have_as_many_points_and_as_much_ground(
    many: KittiFolder, kitti_sample: Path
) -> None:
    real = KittiFolder(kitti_sample)

    def measured(folder: KittiFolder, ids: Sequence[str]) -> tuple[float, float, float]:
        clouds = [folder.frame(i).points_velo for i in ids]
        flat = [np.mean(np.abs(c[:, 2] + 1.72 - 0.008 * c[:, 0]) < 0.2) for c in clouds]
        strength = [np.mean(c[:, 3]) for c in clouds]
        return (
            float(np.mean([len(c) for c in clouds])),
            float(np.mean(flat)),
            float(np.mean(strength)),
        )

    theirs, ours = measured(real, real.split("sample")), measured(many, many.split("train")[:60])
    assert ours[0] == pytest.approx(theirs[0], rel=0.08)
    assert ours[1] == pytest.approx(theirs[1], abs=0.08)
    assert ours[2] == pytest.approx(theirs[2], abs=0.06)


def recalls_and_false(folder: KittiFolder, found: Found, kind: str, score: float) -> np.ndarray:
    """Recall of the easy, moderate and hard at overlap 0.5, and boxes a frame that meet nothing."""
    hits, total, false = np.zeros(3), np.zeros(3), 0
    for frame_id, boxes in found.items():
        labels = folder.read_labels(frame_id)
        own = labels.select(labels.types == kind)
        chosen = np.array([box for k, s, box in boxes if k == kind and s >= score]).reshape(-1, 4)
        overlap = overlaps(chosen, labels.boxes_image)
        false += int((overlap.max(axis=1, initial=0) < 0.1).sum())
        found_here = overlaps(own.boxes_image, chosen).max(axis=1, initial=0) >= 0.5
        height = own.boxes_image[:, 3] - own.boxes_image[:, 1]
        for level, (h, o, t) in enumerate(((40, 0, 0.15), (25, 1, 0.3), (25, 2, 0.5))):
            counted = (height >= h) & (own.occluded <= o) & (own.truncated <= t)
            hits[level] += found_here[counted].sum()
            total[level] += counted.sum()
    return np.array([*hits / total, false / len(found)])


def overlaps(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    low, high = (
        np.maximum(a[:, None, :2], b[None, :, :2]),
        np.minimum(a[:, None, 2:], b[None, :, 2:]),
    )
    inner = np.clip(high - low, 0, None).prod(axis=2)
    areas = [(x[:, 2] - x[:, 0]) * (x[:, 3] - x[:, 1]) for x in (a, b)]
    return np.asarray(inner / (areas[0][:, None] + areas[1][None] - inner))


@pytest.mark.parametrize("kind", ["Car", "Pedestrian", "Cyclist"])
def test_simulated_2d_detections_find_what_the_real_ones_find(
    kitti_sample: Path, kind: str
) -> None:
    folder = KittiFolder(kitti_sample)
    ids = folder.split("val")[::3]
    names = {number: name for name, number in NUMBERS.items()}
    real: dict[str, list[tuple[str, float, np.ndarray]]] = {frame_id: [] for frame_id in ids}
    for line in (
        (kitti_sample / "rgb_detections" / "rgb_detection_val.txt").read_text().splitlines()
    ):
        path, number, score, *edges = line.split()
        if Path(path).stem in real:
            real[Path(path).stem].append(
                (names[int(number)], float(score), np.array(edges, dtype=float))
            )
    ours: dict[str, list[tuple[str, float, np.ndarray]]] = {}
    for frame_id in ids:
        rng = np.random.default_rng([0, int(frame_id)])
        made = detect_in_image(folder.read_labels(frame_id), IMAGE_SIZE, rng)
        ours[frame_id] = list(zip(made.kinds, made.scores, made.boxes, strict=True))
    for score in (0.1, 0.9):
        theirs, mine = (recalls_and_false(folder, found, kind, score) for found in (real, ours))
        np.testing.assert_allclose(mine[:3], theirs[:3], atol=0.1)
        assert abs(mine[3] - theirs[3]) < 0.12, (mine, theirs)


def test_2d_detections_are_whole_pixels_above_the_lowest_score(many: KittiFolder) -> None:
    rows = [
        line.split()
        for line in (many.root / "rgb_detections" / "rgb_detection_train.txt")
        .read_text()
        .splitlines()
    ]
    assert len(rows) > 1000
    assert {row[1] for row in rows} == {"1", "2", "3"}
    assert all(0.01 <= float(row[2]) <= 1 for row in rows)
    assert all(edge.lstrip("-").isdigit() for row in rows for edge in row[3:])
    assert all(Path(row[0]).stem.isdigit() for row in rows)
