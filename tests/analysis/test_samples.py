"""APs of checkpoints in the same resamples, and gains over the seeds that both sides have."""

from dataclasses import replace

import numpy as np
import pytest

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import (
    CELLS,
    Comparisons,
    Resampled,
    counted,
    paired,
    resample_mean,
)
from fl3d.analysis.split_halves import halved
from fl3d.evaluation.bootstrap import resampled_aps, unit_weights, widened
from tests.analysis.making import resample_sweep
from tests.evaluation.test_bootstrap import comparison, scene

N_FRAMES = 60
MODERATE = CELLS.index(("3d", "moderate"))


def compared() -> Comparisons:
    side = {0: comparison(*scene(5, N_FRAMES)), 1: comparison(*scene(5, N_FRAMES, 0.3))}
    return {"VoxelNet": {"0": {0: side[0]}, "2": side}}


def made_up(value: float, draws: list[float]) -> Resampled:
    """One checkpoint whose cells are all alike, R40 ten above R11."""
    values = np.broadcast_to([value, value + 10], (len(CELLS), 2))
    shape = (len(draws), len(CELLS), 2)
    return Resampled(values, np.broadcast_to(np.array(draws)[:, None, None] + [0, 10], shape))


def test_cells_are_every_metric_and_difficulty() -> None:
    assert len(CELLS) == 9
    assert CELLS[0] == ("image", "easy")
    assert CELLS[-1] == ("3d", "hard")


def test_every_checkpoint_is_resampled_by_the_same_frames() -> None:
    """So each draw is the AP that ``resampled_aps`` gives under weights that all share."""
    found = resample_sweep(compared(), n_resamples=20)["VoxelNet"]
    weights = unit_weights(N_FRAMES, 20)
    for level, seed in (("0", 0), ("2", 0), ("2", 1)):
        matches = compared()["VoxelNet"][level][seed].matches("Car", "3d", "moderate")
        own = found[level][seed]
        assert own.draws.shape == (20, 9, 2)
        assert (own.draws[:, MODERATE] == resampled_aps(matches, weights)).all()
    assert (found["0"][0].draws == found["2"][0].draws).all()


def test_values_are_those_of_the_frames_as_they_are() -> None:
    found = resample_sweep(compared(), n_resamples=5)["VoxelNet"]["2"][1]
    curve = compared()["VoxelNet"]["2"][1].curve("Car", "3d", "moderate")
    assert found.values[MODERATE].tolist() == pytest.approx([curve.ap_r11, curve.ap_r40])


def test_frames_of_a_drive_are_drawn_together() -> None:
    drives = np.arange(N_FRAMES) % 4
    found = resample_sweep(compared(), drives, n_resamples=200)["VoxelNet"]["0"][0]
    matches = compared()["VoxelNet"]["0"][0].matches("Car", "3d", "moderate")
    drawn = resampled_aps(matches, unit_weights(4, 200), drives)
    assert found.draws[:, MODERATE] == pytest.approx(widened(drawn, drives))
    assert found.draws[:, MODERATE].std() > 1.5 * drawn.std()  # four drives are few
    # Four drives can be drawn in 35 ways, sixty frames in more than there are resamples.
    assert len(np.unique(found.draws[:, MODERATE, 1])) <= 35
    by_itself = resample_sweep(compared(), n_resamples=200)["VoxelNet"]["0"][0]
    assert len(np.unique(by_itself.draws[:, MODERATE, 1])) > 100


def test_a_gain_by_hand() -> None:
    """Seeds 0 and 3 are of both sides: gains 4 and -2, whose draws are averaged one by one."""
    side = {
        0: made_up(14.0, [13.0, 15.0]),
        1: made_up(99.0, [99.0, 99.0]),
        3: made_up(18.0, [18.0, 20.0]),
    }
    base = {3: made_up(20.0, [19.0, 21.0]), 0: made_up(10.0, [10.0, 10.0])}
    for average, name in enumerate(AVERAGES):
        ap, gain = paired(side, base, MODERATE, average)
        more = 10 if name == "R40" else 0
        assert ap.values.tolist() == [14.0 + more, 18.0 + more]
        assert ap.draws.tolist() == [15.5 + more, 17.5 + more]
        assert gain.values.tolist() == [4.0, -2.0]
        assert gain.draws.tolist() == [1.0, 2.0]
        assert gain.spread == pytest.approx(18**0.5)


def test_what_the_frames_do_to_all_seeds_lasts_and_pairing_takes_it_away() -> None:
    """Each AP moves by 1 with all others and by 1 for itself: of the mean of two 1 of 1.5 lasts, of gains nothing."""
    common, *own = np.random.default_rng(0).standard_normal((3, 20_000))
    base = {seed: made_up(10.0, list(10 + common)) for seed in range(2)}
    side = {seed: made_up(12.0, list(12 + common + own[seed])) for seed in range(2)}
    ap, gain = paired(side, base, MODERATE, 0)
    assert ap.lasting == pytest.approx(2 / 3, abs=0.02)
    assert gain.lasting == pytest.approx(0, abs=0.02)


def test_the_baseline_gains_nothing_over_itself() -> None:
    base = {0: made_up(10.0, [9.0, 12.0]), 1: made_up(11.0, [11.0, 13.0])}
    ap, gain = paired(base, base, MODERATE, 0)
    assert ap.values.tolist() == [10.0, 11.0]
    assert not gain.values.any()
    assert not gain.draws.any()


def test_where_no_ground_truth_counts_there_is_no_ap_and_a_mean_is_over_the_others() -> None:
    """The scene has cars alone: of pedestrians nothing is known, and the mean over both is the cars'."""
    cars_alone = comparison(*scene(5, N_FRAMES))
    overlaps = {**cars_alone.protocol.overlaps, "Pedestrian": (0.5, 0.5, 0.5)}
    one = replace(cars_alone, protocol=replace(cars_alone.protocol, overlaps=overlaps))
    cell = ("3d", "moderate")
    cars, draws = resample_mean(one, cell, None, 5, ["Car"])
    nothing, no_draws = resample_mean(one, cell, None, 5, ["Pedestrian"])
    assert np.isnan(nothing).all()
    assert np.isnan(no_draws).all()
    for classes in (["Car", "Pedestrian"], ["Pedestrian", "Car"]):
        both, of_both = resample_mean(one, cell, None, 5, classes)
        assert (both == cars).all()
        assert (of_both == draws).all()


def test_a_mean_is_over_the_classes_that_have_ground_truths_there() -> None:
    cars_alone = comparison(*scene(5, N_FRAMES))
    overlaps = dict.fromkeys(("Car", "Pedestrian", "Cyclist"), (0.5, 0.5, 0.5))
    overlaps |= cars_alone.protocol.overlaps
    one = replace(cars_alone, protocol=replace(cars_alone.protocol, overlaps=overlaps))
    assert counted(one, ("3d", "moderate"), ("Pedestrian", "Car", "Cyclist")) == ("Car",)
    assert counted(one, ("3d", "moderate"), ("Pedestrian", "Cyclist")) == ("Pedestrian",)
    assert halved([one], ["Car", "Pedestrian"]) == halved([one], ["Car"])
