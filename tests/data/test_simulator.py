"""The simulator: reproducible, labelled by KITTI's definitions, readable by the KITTI reader."""

from pathlib import Path

import numpy as np
import pytest

from fl3d.data.kitti import KittiFolder
from fl3d.data.labels import TYPES
from fl3d.data.simulator.generate import CALIBRATION, Settings, generate
from fl3d.data.simulator.sensor import CLUTTER, Ground, scan
from fl3d.data.simulator.shapes import box, ellipsoid, prism
from fl3d.geometry.boxes import count_points_inside

GROUND = Ground(-1.73, 0.0, 0.0)


def test_same_seed_same_bytes_other_seed_other_bytes(simulated: Path, tmp_path: Path) -> None:
    again = generate(tmp_path / "again", Settings(6, 4, seed=3))
    other = generate(tmp_path / "other", Settings(6, 4, seed=4))
    files = sorted(p.relative_to(simulated) for p in simulated.rglob("*") if p.is_file())
    assert all((again / f).read_bytes() == (simulated / f).read_bytes() for f in files)
    cloud = Path("training/velodyne/000000.bin")
    assert (other / cloud).read_bytes() != (simulated / cloud).read_bytes()


def test_an_interrupted_generation_is_made_anew(tmp_path: Path) -> None:
    folder = tmp_path / Settings(1, 1).name
    (folder / "training" / "velodyne").mkdir(parents=True)
    (folder / "training" / "velodyne" / "000000.bin").write_bytes(b"torn")
    assert len(KittiFolder(generate(tmp_path, Settings(1, 1))).frame("000000").points_velo) > 1000


def test_a_wall_is_hit_where_it_stands_and_hides_what_is_behind() -> None:
    wall = box((10.0, 0.0, -1.73), 0.0, (1.0, 20.0, 5.0))
    hidden = box((20.0, 0.0, -1.73), 0.0, (4.0, 2.0, 1.5))
    returns = scan([wall, hidden], [CLUTTER, 0], 1, GROUND, np.random.default_rng(0))
    high = returns.points_velo[returns.points_velo[:, 2] > -1.0]
    straight = high[np.abs(high[:, 1]) < 2]
    np.testing.assert_allclose(straight[:, 0], 9.5, atol=0.15)
    assert returns.alone[0] > 100
    assert returns.seen[0] == 0


def test_the_ground_lies_where_it_should() -> None:
    returns = scan([box((0.0, 90.0, 0.0), 0.0, (1.0, 1.0, 1.0))], [CLUTTER], 0, GROUND, np.random.default_rng(0))
    assert abs(float(np.median(returns.points_velo[:, 2])) + 1.73) < 0.02
    assert (returns.points_velo[:, 0] > 0).all()


def test_a_ray_through_an_ellipsoid_and_a_leaning_prism_ends_on_their_surface() -> None:
    ball = ellipsoid((10.0, 0.0, 0.0), (2.0, 2.0, 2.0))
    returns = scan([ball], [0], 1, GROUND, np.random.default_rng(0))
    distance = np.linalg.norm(returns.points_velo[:, :3] - (10, 0, 0), axis=1)
    near = (distance < 2.5) & (returns.points_velo[:, 2] > -1.5)  # not the ground below
    assert near.sum() > 200
    np.testing.assert_allclose(distance[near], 2.0, atol=0.12)
    cabin = prism((10.0, 0.0, 0.0), 0.0, (4.0, 2.0), (2.0, 2.0), 1.0)
    for x, z, inside in ((8.4, 0.2, True), (8.4, 0.9, False), (9.5, 0.9, True)):
        n, d = cabin.planes[:, :3], cabin.planes[:, 3]
        assert bool((n @ np.array([x, 0, z]) <= d).all()) == inside


def test_labels_are_kittis(simulated: Path) -> None:
    folder = KittiFolder(simulated)
    heights, types = [], set()
    for frame_id in [*folder.split("train"), *folder.split("val")]:
        frame = folder.frame(frame_id)
        labels = frame.labels
        types |= set(labels.types.tolist())
        assert (labels.truncated >= 0).all()
        assert (labels.truncated < 1).all()
        assert set(labels.occluded.tolist()) <= {0, 1, 2}
        assert (labels.boxes_image[:, 2] <= frame.image_size[0]).all()
        boxes = frame.calibration.boxes_to_velo(labels.boxes_cam)
        counts = count_points_inside(frame.points_velo, boxes)
        assert (counts[(labels.occluded == 0) & (labels.truncated < 0.1) & (boxes[:, 0] < 30)] > 5).all()
        heights.extend((boxes[:, 2] + 1.73).tolist())
    assert types <= set(TYPES)
    assert "Car" in types
    assert abs(float(np.median(heights))) < 0.5


def test_difficulties_are_mixed(tmp_path: Path) -> None:
    """Shares of cars that reach each level, within wide bounds around KITTI's 21 / 55 / 76 %."""
    folder = KittiFolder(generate(tmp_path, Settings(60, 1, seed=11)))
    rows = [folder.read_labels(i) for i in folder.split("train")]
    cars = [labels.select(labels.types == "Car") for labels in rows]
    height = np.concatenate([c.boxes_image[:, 3] - c.boxes_image[:, 1] for c in cars])
    occluded = np.concatenate([c.occluded for c in cars])
    truncated = np.concatenate([c.truncated for c in cars])
    easy = (height >= 40) & (occluded == 0) & (truncated <= 0.15)
    moderate = (height >= 25) & (occluded <= 1) & (truncated <= 0.3)
    hard = (height >= 25) & (occluded <= 2) & (truncated <= 0.5)
    assert 0.12 < easy.mean() < 0.35
    assert 0.35 < moderate.mean() < 0.65
    assert 0.55 < hard.mean() < 0.85


def test_the_camera_looks_along_x() -> None:
    pixels, depth = CALIBRATION.points_to_image(CALIBRATION.points_to_cam(np.array([[20.0, 0.0, 0.0]])))
    assert depth[0] == pytest.approx(19.73, abs=0.01)
    assert 600 < pixels[0, 0] < 620
