"""Simulated pedestrians and cyclists: figures in their boxes, moods by rate, frames of their own, and like KITTI's."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from fl3d.config.compose import compose_config
from fl3d.config.rules import RULES
from fl3d.config.settings import read_settings
from fl3d.data.kitti import KittiFolder
from fl3d.simulator import MOST_PEOPLE, figures
from fl3d.simulator.crowds import MOODS, PEOPLED, QUIET, draw_mood, street_of
from fl3d.simulator.generate import Settings, write_folder
from fl3d.simulator.hdl64 import CAMERA_VIEW, ELEVATIONS, ORIGINS
from fl3d.simulator.lidar import scan
from fl3d.simulator.materials import STONE
from fl3d.simulator.scene import random_scene
from fl3d.simulator.site import Site
from fl3d.simulator.solids import Parts, Solids, box
from fl3d.simulator.terrain import Ground, Road
from tests.data.test_simulator import files

GROUND = Ground(-1.73)


@pytest.fixture(scope="module")
def streets(tmp_path_factory: pytest.TempPathFactory) -> KittiFolder:
    """200 simulated frames with people."""
    folder = tmp_path_factory.mktemp("streets")
    write_folder(folder, Settings(200, 0, seed=11, people=3.0), workers=1)
    return KittiFolder(folder)


def test_frames_with_people_are_the_same_whatever_the_workers(tmp_path: Path) -> None:
    settings = Settings(30, 10, seed=3, people=2.0)
    write_folder(tmp_path / "one", settings, workers=1)
    write_folder(tmp_path / "two", settings, workers=2)
    assert files(tmp_path / "two") == files(tmp_path / "one")


def test_frames_with_people_have_a_folder_of_their_own_and_the_others_keep_theirs() -> None:
    assert Settings(8, 2).name == "v2-8-2-seed0"
    assert Settings(8, 2, people=3.0).name == "v2-8-2-seed0-people3"
    assert Settings(8, 2, people=0.5).name == "v2-8-2-seed0-people0.5"


def test_the_config_asks_for_them_up_to_the_rate_that_there_is() -> None:
    config = compose_config(["data=simulated_people", "profile=tiny"])
    data = read_settings(config).data
    assert data.people == MOST_PEOPLE
    assert data.name == "simulated_people"
    assert read_settings(compose_config(["profile=tiny"])).data.people is None
    assert RULES["data.people"].fits(MOST_PEOPLE)
    assert not RULES["data.people"].fits(MOST_PEOPLE + 0.01)


def test_a_knee_bends_ahead_and_an_elbow_back() -> None:
    """Bones of 0.5 m over 0.6 m: the joint lies 0.4 m beside the middle."""
    assert figures.bend((0.0, 0.6), (0.0, 0.0), 0.5, 0.5, 1.0) == pytest.approx((0.4, 0.3))
    assert figures.bend((0.0, 0.6), (0.0, 0.0), 0.5, 0.5, -1.0) == pytest.approx((-0.4, 0.3))
    assert figures.bend((0.0, 1.0), (0.0, 0.0), 0.5, 0.5, 1.0) == pytest.approx((0.0, 0.5))


def test_a_limb_is_a_slat_between_its_ends() -> None:
    """From (0, 0) to (0, 1), 0.2 m across and to either side: inside at its middle, outside beyond it."""
    part = figures.limb((0.0, 0.0), (0.0, 1.0), 0.2, 0.1, figures.FABRIC)
    solid = _solids(part[None])
    n, d = solid.planes[0, :, :3], solid.planes[0, :, 3]
    for point, inside in (
        ((0.09, 0.09, 0.99), True),
        ((0.11, 0.0, 0.5), False),
        ((0.0, 0.11, 0.5), False),
        ((0.0, 0.0, 1.01), False),
    ):
        assert bool((n @ np.array(point) <= d + 1e-12).all()) == inside


def _solids(parts: Parts) -> Solids:
    return Solids(parts, np.zeros((len(parts), 6)), np.zeros(len(parts), dtype=np.int64))


@pytest.mark.parametrize("kind", ["Pedestrian", "Cyclist", "Person_sitting"])
def test_a_figure_fills_its_box(kind: str) -> None:
    """It reaches the box's ends and top, and stays within them by a hand."""
    rng = np.random.default_rng(0)
    for _ in range(40):
        size = PEOPLED[kind].draw(rng)
        corners = _solids(PEOPLED[kind].make(size, rng)).corners
        low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
        assert (high[:2] <= np.array(size[:2]) / 2 + 0.15).all()
        assert (low[:2] >= -np.array(size[:2]) / 2 - 0.15).all()
        assert high[0] - low[0] > 0.75 * size[0]
        assert high[2] == pytest.approx(size[2], abs=0.08)
        assert low[2] == pytest.approx(0.0, abs=0.06)


def test_a_stride_is_as_long_as_its_box() -> None:
    """Shoes of 27 cm: in a box of 1.1 m their ends lie 55 cm from the middle, in one of 30 cm the legs are together."""
    for length in (1.1, 0.3):
        parts = figures.pedestrian((length, 0.6, 1.75), np.random.default_rng(1))
        corners = _solids(parts).corners
        low = corners[corners[..., 2].max(axis=1) < 0.2]  # the shoes: whole parts near the ground
        assert low[..., 0].max() == pytest.approx(length / 2, abs=0.03)
        assert low[..., 0].min() == pytest.approx(-length / 2, abs=0.03)


def test_people_are_so_many_times_as_frequent_as_the_rate_says() -> None:
    shares = sum(mood.share for mood in MOODS.values())
    for rate in (0.5, 1.0, MOST_PEOPLE):
        rng = np.random.default_rng(0)
        quiet = np.mean([draw_mood(rate, rng) is QUIET for _ in range(4000)])
        assert quiet == pytest.approx(1 - rate * shares, abs=0.025)
    assert MOST_PEOPLE * shares <= 1
    for mood in (*MOODS.values(), QUIET):
        assert street_of(mood, np.random.default_rng(0)).lane[0] > 2


def test_boxes_of_people_begin_three_centimetres_above_the_ground_and_end_at_their_heads() -> None:
    gaps, tops = [], []
    for seed in range(12):
        site = Site(np.random.default_rng(seed), GROUND, 0.0, 0.0, CAMERA_VIEW, PEOPLED)
        assert site.add("Pedestrian", 8.0, 0.0, 1.0)
        thing = site.things[0]
        gaps.append(thing.position[2] + 1.73)
        tops.append(thing.position[2] + thing.size[2] - site.solids().corners[..., 2].max())
    assert np.mean(gaps) == pytest.approx(0.03, abs=0.015)
    assert np.mean(tops) == pytest.approx(0.0, abs=0.03)


def test_someone_near_has_as_many_points_as_on_kitti() -> None:
    """337 at 10 m on wholly visible pedestrians, 391 on cyclists: medians of the real clouds."""
    for kind, expected in (("Pedestrian", 337), ("Cyclist", 391)):
        counts = []
        for seed in range(30):
            site = Site(np.random.default_rng(seed), GROUND, 0.0, 0.0, CAMERA_VIEW, PEOPLED)
            assert site.add(kind, 10.0, 0.0, seed * 0.7)
            returns = scan(site.solids(), 1, GROUND, np.random.default_rng(0))
            counts.append(int(returns.counts[0]))
        assert float(np.median(counts)) == pytest.approx(expected, rel=0.2)


def test_behind_us_walk_people_too() -> None:
    """And what the camera sees is the same with and without the whole turn."""
    behind = 0
    for seed in range(6):
        front, around = (
            random_scene(np.random.default_rng(seed), view, 3.0) for view in (CAMERA_VIEW, 180.0)
        )
        assert around.things[: len(front.things)] == front.things
        added = around.things[len(front.things) :]
        behind += sum(thing.kind in ("Pedestrian", "Cyclist") for thing in added)
    assert behind > 3


def people(folder: KittiFolder, ids: Sequence[str], kind: str) -> tuple[np.ndarray, float]:
    """(N, 7) h, w, l, distance, whether 25 pixels high, visible, and beside another; and objects a frame."""
    rows = []
    for frame_id in ids:
        labels = folder.read_labels(frame_id)
        labels = labels.select(labels.types == kind)
        places = labels.boxes_cam[:, [0, 2]]
        apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 99 * np.eye(len(places))
        height = labels.boxes_image[:, 3] - labels.boxes_image[:, 1]
        rows.append(
            np.column_stack(
                [
                    labels.boxes_cam[:, 3:6],
                    np.hypot(*places.T),
                    height >= 25,
                    labels.occluded == 0,
                    apart.min(axis=1, initial=99) < 1.6,
                ]
            )
        )
    whole = np.concatenate(rows)
    return whole, len(whole) / len(ids)


@pytest.mark.parametrize("kind", ["Pedestrian", "Cyclist"])
def test_people_are_as_many_as_large_as_far_and_as_hidden_as_kittis(
    streets: KittiFolder, kitti_sample: Path, kind: str
) -> None:
    real = KittiFolder(kitti_sample)
    theirs, per_real = people(real, real.split("train"), kind)
    ours, per_frame = people(streets, streets.split("train"), kind)
    assert per_frame / 3 == pytest.approx(per_real, rel=0.2)
    np.testing.assert_allclose(ours[:, :3].mean(axis=0), theirs[:, :3].mean(axis=0), atol=0.05)
    np.testing.assert_allclose(ours[:, :3].std(axis=0), theirs[:, :3].std(axis=0), atol=0.04)
    quartiles = [np.quantile(rows[:, 3], [0.25, 0.5, 0.75]) for rows in (ours, theirs)]
    np.testing.assert_allclose(*quartiles, atol=2.5)
    np.testing.assert_allclose(ours[:, 4:].mean(axis=0), theirs[:, 4:].mean(axis=0), atol=0.1)


def test_rays_meet_uneven_ground_as_one_surface() -> None:
    """Points lie on the surface that things stand on, and still on the cones of the lasers; none beyond 80 m."""
    ground = Ground(-1.73, road=Road(rise=0.15, rough=0.1, origin_x=5.0, field=1.0))
    even = Ground(-1.73)
    far_away = np.array([[0.0, 90.0, 0.0, 0.0, 0.0, 0.0]])
    scene = Solids(box((1.0, 1.0, 1.0), STONE)[None], far_away, np.array([-1]))
    points = scan(scene, 0, ground, np.random.default_rng(0)).points_velo.astype(np.float64)
    near = points[np.hypot(points[:, 0], points[:, 1]) < 20]
    surface = np.array([ground.at(x, y)[0] for x, y in near[:, :2]])
    assert np.quantile(np.abs(near[:, 2] - surface), 0.9) < 0.01
    assert np.abs(near[:, 2] - even.height).max() > 0.1  # it is not even
    reach = np.hypot(near[:, 0], near[:, 1])
    miss = np.abs(near[:, 2:3] - ORIGINS - reach[:, None] * np.tan(np.deg2rad(ELEVATIONS)))
    assert miss.min(axis=1).max() < 0.005
    assert (
        np.linalg.norm(points[:, :3], axis=1).max() < 80.3
    )  # from the lasers, not from the origin, 80
