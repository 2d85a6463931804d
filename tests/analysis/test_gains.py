"""Gains over the baseline, with intervals: of whatever was swept."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.gains import R11_STEP, gains, is_one_step, recalls, without_baseline
from fl3d.analysis.samples import CELLS, Comparisons, Resampled, compare_sweep
from fl3d.core.errors import ConfigError, StoreError
from fl3d.evaluation.average_precision import Comparison
from fl3d.reports.levels import gains_tables, levels_table
from fl3d.reports.render import to_markdown
from fl3d.runs.finished import FinishedSweep, levels_of
from tests.analysis.making import detected_sweep, resample_sweep, without
from tests.evaluation.test_average_precision import EMPTY, frame, thing
from tests.evaluation.test_bootstrap import comparison, scene
from tests.papers.making import Made, aps, finished_sweep

LOSS = "schedule.stages.focal.set.loss"
# What is swept, and the levels that this gives.
SWEPT = {
    "numbers": (["loss.gamma=2", "loss.gamma=0.50", "loss.gamma=10"], ["0.5", "2", "10"], "2"),
    "alphas": (["loss.alpha=1", "loss.alpha=0.5", "loss.alpha=2"], ["0.5", "1", "2"], "1"),
    "texts": (["loss=original", "loss=enhanced"], ["original", "enhanced"], "original"),
    "several": (
        ["loss.alpha=1 loss.gamma=2", "loss.alpha=0.5 loss.gamma=0"],
        ["alpha=1, gamma=2", "alpha=0.5, gamma=0"],
        "alpha=1, gamma=2",
    ),
    "maps": (
        [f"+{LOSS}={{alpha:1.0,beta:5.0}}", f"+{LOSS}={{alpha:0.5,beta:2.0}}"],
        ["alpha=1 beta=5", "alpha=0.5 beta=2"],
        "alpha=1 beta=5",
    ),
}


def compared(noise: float) -> Comparisons:
    """Gamma = 0 and a gamma = 2 whose boxes are that noisy, on the same frames."""
    return {
        "VoxelNet": {
            "0": {0: comparison(*scene(5, 60))},
            "2": {0: comparison(*scene(5, 60, noise)), 1: comparison(*scene(5, 60, noise))},
        }
    }


def halved_scores(one: Comparison) -> Comparison:
    """The same boxes in the same order with other scores."""
    values = one.det.values.copy()
    values[:, 14] /= 2
    return replace(one, det=replace(one.det, values=values))


def found_gains(of: Comparisons, baseline: str, n_resamples: int = 10) -> pd.DataFrame:
    return gains(resample_sweep(of, n_resamples=n_resamples), baseline)


def points(swept: Sequence[str], *more: str) -> list[list[str]]:
    return [[*one.split(), *more] for one in swept]


def noise_by_level(levels: Sequence[str]) -> dict[str, float]:
    return {level: 2.0 * place for place, level in enumerate(levels)}


def test_a_clear_loss_is_seen_and_the_baseline_gains_nothing() -> None:
    table = found_gains(compared(noise=0.5), "0", n_resamples=100)
    assert len(table) == 2 * 3 * 3 * 2
    assert set(table["seeds"]) == {1}  # only those that the baseline has as well
    zero = table[table["level"] == "0"]
    assert (zero[["gain", "gain_low", "gain_high"]] == 0).all(axis=None)
    loss = table[(table["level"] == "2") & (table["metric"] == "3d") & (table["average"] == "R40")]
    assert (loss["gain_high"] < 0).all()
    assert not table["marked"].any()  # of one seed


def test_a_sweep_without_its_baseline_has_no_gain() -> None:
    with pytest.raises(ConfigError, match=r"a trial of the baseline '0'.*sweep\.baseline"):
        found_gains({"VoxelNet": {"2": compared(0.1)["VoxelNet"]["2"]}}, "0")


def test_a_group_without_the_baseline_is_left_out_and_named() -> None:
    both = compared(0.1)
    both["3D-FCN"] = {"2": both["VoxelNet"]["2"]}
    assert set(found_gains(both, "0")["group"]) == {"VoxelNet"}
    assert without_baseline(both, "0") == ["3D-FCN"]
    assert without_baseline(compared(0.1), "0") == []


def test_a_level_that_shares_no_seed_with_the_baseline_is_left_out() -> None:
    side = compared(0.3)["VoxelNet"]
    table = found_gains({"VoxelNet": {"0": side["0"], "2": {1: side["2"][1]}}}, "0")
    assert set(table["level"]) == {"0"}


def test_seeds_with_the_same_detections_are_one_seed() -> None:
    """Seeds 0 and 1 of gamma = 2 are copies; the baseline's differ, and its gain has both."""
    side = compared(0.3)["VoxelNet"]
    base = {0: side["0"][0], 1: halved_scores(side["0"][0])}
    table = found_gains({"VoxelNet": {"0": base, "2": side["2"]}}, "0")
    own = table[table["level"] == "2"]
    assert set(own["seeds"]) == {1}
    assert set(own["seeds_done"]) == {2}
    assert own["copies"].all()
    assert set(table[table["level"] == "0"]["seeds"]) == {2}
    assert not table[table["level"] == "0"]["copies"].any()


def test_of_many_seeds_two_that_are_copies_take_all_stars_away() -> None:
    levels = {"0": seeds_of(0.0, 4), "2": seeds_of(20.0, 4)}
    assert gains({"VoxelNet": levels}, "0")["marked"].any()
    copied = {seed: replace(one, detections=str(seed // 2)) for seed, one in levels["2"].items()}
    found = gains({"VoxelNet": {**levels, "2": copied}}, "0")
    assert not found["marked"].any()
    assert set(found[found["level"] == "2"]["seeds"]) == {2}


def test_seeds_are_averaged_and_those_that_the_baseline_lacks_are_left_out() -> None:
    side = compared(0.3)["VoxelNet"]
    again = halved_scores(side["0"][0])  # the same AP, and no copy
    base = {0: side["0"][0], 2: again}
    table = found_gains({"VoxelNet": {"0": base, "2": {**side["2"], 2: again}}}, "0")
    moderate = table[
        (table["metric"] == "3d")
        & (table["difficulty"] == "moderate")
        & (table["average"] == "R11")
    ]
    assert dict(zip(moderate["level"], moderate["seeds"], strict=True)) == {
        "0": 2,
        "2": 2,
    }  # 1 is none of the base's
    assert moderate["seeds_done"].tolist() == [2, 3]
    noisy, clean = (
        one.curve("Car", "3d", "moderate").ap_r11 for one in (side["2"][0], side["0"][0])
    )
    row = moderate[moderate["level"] == "2"].iloc[0]
    assert row["ap"] == pytest.approx((noisy + clean) / 2)
    assert row["gain"] == pytest.approx((noisy - clean) / 2)


def seeds_of(gain: float, n_seeds: int, spread: float = 0.1) -> dict[int, Resampled]:
    """Made-up checkpoints, 50 AP and a gain in R40 of 3D and BEV; 50 in all other cells.

    Seeds lie evenly about the mean; draws lie within 0.2 of it.
    """
    found = {}
    for seed, off in enumerate(np.linspace(-spread, spread, n_seeds) if n_seeds > 1 else [0.0]):
        values = np.full((len(CELLS), 2), 50.0)
        values[3:, 1] += gain + off
        moves = np.linspace(-0.2, 0.2, 41)[:, None, None] * np.sign(gain)
        found[seed] = Resampled(values, values + moves)
    return found


def marked_cells(
    levels: Mapping[str, Mapping[int, Resampled]], baseline: str = "0"
) -> set[tuple[str, str, str, str]]:
    table = gains({"VoxelNet": levels}, baseline)
    own = table[table["marked"]]
    columns = (own[name] for name in ("level", "metric", "difficulty", "average"))
    return set(zip(*columns, strict=True))


def test_marks_are_about_r40_in_3d_and_birds_eye_view() -> None:
    """The image's cells are in no table; R11's cells carry what R40 says."""
    found = marked_cells({"0": seeds_of(0.0, 5), "2": seeds_of(20.0, 5), "5": seeds_of(0.1, 5)})
    assert found == {
        ("2", metric, difficulty, average)
        for metric in ("bev", "3d")
        for difficulty in ("easy", "moderate", "hard")
        for average in ("R11", "R40")
    }


def test_a_gain_in_r11_alone_is_not_marked() -> None:
    side = seeds_of(0.0, 5)
    swapped = {
        seed: Resampled(one.values[:, ::-1] + [20, 0], one.draws[:, :, ::-1] + [20, 0])
        for seed, one in side.items()
    }
    assert marked_cells({"0": side, "2": swapped}) == set()


@pytest.mark.parametrize("n_seeds", [1, 2])
def test_one_and_two_seeds_have_no_marks_however_clear_the_gain(n_seeds: int) -> None:
    spread = 1e-6
    assert marked_cells({"0": seeds_of(0.0, 5), "2": seeds_of(20.0, n_seeds, spread)}) == set()
    assert marked_cells({"0": seeds_of(0.0, 5), "2": seeds_of(20.0, 3, spread)})


def test_marks_of_a_table_are_looked_at_together() -> None:
    """A gain that is clear by itself need not be so as one of six."""
    base = seeds_of(0.0, 3, spread=0.0)
    side = seeds_of(2.0, 3, spread=0.6)
    table = gains({"VoxelNet": {"0": base, "2": side}}, "0")
    own = table[(table["level"] == "2") & (table["average"] == "R40") & (table["metric"] == "3d")]
    assert (own["gain_low"] > 0).all()
    assert not own["marked"].any()


@pytest.mark.parametrize("kind", SWEPT)
def test_every_level_of_any_factor_has_a_row_and_its_ap_is_the_tables(
    kind: str, simulated: Path, tmp_path: Path
) -> None:
    swept, levels, baseline = SWEPT[kind]
    noise = noise_by_level(levels)
    sweep = detected_sweep(
        simulated,
        tmp_path,
        [["detector=voxelnet", *point] for point in points(swept)],
        lambda trial: noise[trial.level],
    )
    assert (sweep.levels, sweep.baseline, sweep.groups) == (levels, baseline, ["VoxelNet"])
    table = found_gains(compare_sweep(sweep), sweep.baseline)
    for average in ("R11", "R40"):
        own = table[
            (table["metric"] == "3d")
            & (table["difficulty"] == "moderate")
            & (table["average"] == average)
        ]
        assert sorted(own["level"]) == sorted(levels)
        (printed,) = gains_tables(table, levels_of(sweep), "3d/moderate", average)
        by_level = levels_table(sweep.select("last"), "VoxelNet", levels_of(sweep), "any", average)
        assert [cell.text for cell in printed.column("level")] == levels
        assert [cell.text for cell in by_level.column("level")] == levels
        aps_of_gains = [cell.text.partition(" ")[0] for cell in printed.column("ap")]
        assert aps_of_gains == [cell.text for cell in by_level.column("3d_moderate")]
        base = printed.rows[levels.index(baseline)]
        assert base[3].text == "baseline"
    assert float(aps_of_gains[0]) > float(aps_of_gains[-1])  # each level is a trial of its own
    text = to_markdown(printed)
    assert all(f"| {level} |" in text for level in levels)


def test_a_baseline_is_chosen_by_name(simulated: Path, tmp_path: Path) -> None:
    swept, levels, _ = SWEPT["texts"]
    sweep = detected_sweep(
        simulated,
        tmp_path,
        points(swept),
        lambda trial: 0.2,
        "detector=voxelnet",
        "sweep.baseline=enhanced",
    )
    table = found_gains(compare_sweep(sweep), sweep.baseline)
    (printed,) = gains_tables(table, levels_of(sweep), "3d/moderate", "R40")
    assert [row[0].text for row in printed.rows if row[3].text == "baseline"] == ["enhanced"]
    assert printed.columns[3].head == "gain over loss = enhanced"
    assert [row[0].text for row in printed.rows] == levels


def test_groups_and_seeds_of_a_sweep_come_apart(simulated: Path, tmp_path: Path) -> None:
    """Of 3D-FCN the baseline is not done, of VoxelNet one seed of it."""
    every = [
        [f"detector={detector}", f"loss.gamma={gamma}", f"seed={seed}"]
        for detector in ("fcn3d", "voxelnet")
        for gamma in (0, 2)
        for seed in (0, 1)
    ]
    whole = detected_sweep(simulated, tmp_path, every, lambda trial: 0.3)
    assert whole.groups == ["3D-FCN", "VoxelNet"]
    sweep = without(
        whole, lambda trial: trial.level == "0" and (trial.group == "3D-FCN" or trial.seed == 1)
    )
    found = compare_sweep(sweep)
    assert {
        group: {level: list(by_seed) for level, by_seed in own.items()}
        for group, own in found.items()
    } == {
        "3D-FCN": {"2": [0, 1]},
        "VoxelNet": {"0": [0], "2": [0, 1]},
    }
    table = found_gains(found, sweep.baseline)
    assert set(table["group"]) == {"VoxelNet"}
    assert set(table["seeds"]) == {1}
    assert without_baseline(found, sweep.baseline) == ["3D-FCN"]
    averaged = found_gains(compare_sweep(whole), whole.baseline)
    assert set(averaged["seeds"]) == {2}
    by_level = levels_table(whole.select("last"), "VoxelNet", levels_of(whole), "any", "R40")
    (_, printed) = gains_tables(averaged, levels_of(whole), "3d/hard", "R40")
    assert [cell.text for cell in printed.column("seeds")] == ["2", "2"]
    assert [cell.text.partition(" ")[0] for cell in printed.column("ap")] == [
        cell.text for cell in by_level.column("3d_hard")
    ]


def test_cell_and_interval_are_of_the_same_seeds(simulated: Path, tmp_path: Path) -> None:
    """A level has a seed more than its baseline: it is in neither the AP nor the gain."""
    every = [[f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 2) for seed in (0, 1)]
    whole = detected_sweep(
        simulated, tmp_path, every, lambda trial: 0.4 + trial.seed, "detector=voxelnet"
    )
    some = without(whole, lambda trial: (trial.level, trial.seed) == ("0", 1))
    one = without(whole, lambda trial: trial.seed == 1)
    found = found_gains(compare_sweep(some), "0")
    alike = found_gains(compare_sweep(one), "0")
    pd.testing.assert_frame_equal(*(side.drop(columns="seeds_done") for side in (found, alike)))
    assert set(found["seeds_done"]) == {1, 2}
    both = found_gains(compare_sweep(whole), "0")
    assert not both["ap"].equals(found["ap"])


def test_scores_alone_have_no_intervals() -> None:
    made = [Made(overrides=(f"loss.gamma={gamma}",), scores={1: aps(gamma)}) for gamma in (0, 2)]
    sweep: FinishedSweep = finished_sweep(("detector=voxelnet",), made)
    with pytest.raises(StoreError, match="only its scores are here"):
        compare_sweep(sweep)


def test_recall_is_given_for_every_trial_and_falls_with_the_overlap() -> None:
    table: pd.DataFrame = recalls(compared(noise=0.2))
    assert table["level"].tolist() == ["0", "2", "2"]
    assert table["seed"].tolist() == [0, 0, 1]
    columns = [column for column in table if column.startswith("recall_")]
    assert columns == ["recall_0.1", "recall_0.3", "recall_0.5", "recall_0.7", "recall_0.9"]
    assert (table[columns].diff(axis=1).iloc[:, 1:] <= 0).all(axis=None)


def test_a_gain_of_one_recall_step_is_told() -> None:
    """Of 100 cars one more is found, without a false alarm: R11 jumps at one of its samples and stands elsewhere."""
    gt = [frame(thing(0)) for _ in range(100)]

    def finding(n: int) -> Comparison:
        found = [frame(thing(0, score=0.9 - i / 1000)) if i < n else EMPTY for i in range(100)]
        return comparison(gt, found)

    flagged = []
    for n in range(12, 24):
        sweep = {"VoxelNet": {"0": {0: finding(n)}, "2": {0: finding(n + 1)}}}
        table = found_gains(sweep, "0", 20)
        own = table[(table["level"] == "2") & (table["metric"] == "3d")]
        stepped = own[own["one_r11_step"]]
        assert set(stepped["average"]) <= {"R11"}
        r11 = own[own["average"] == "R11"]["gain"].tolist()
        assert len(stepped) in (0, 3)
        assert (len(stepped) == 3) == (r11 == pytest.approx([R11_STEP] * 3))
        flagged.append(len(stepped) == 3)
    assert flagged.count(True) == 1


@pytest.mark.parametrize(
    ("r11", "r40", "is_step"),
    [
        (9.0, 0.5, True),
        (-9.0, -0.5, True),
        (9.0, 6.0, False),
        (-9.0, -6.0, False),
        (9.0, -6.0, True),
        (1.0, 0.1, False),
        (15.0, 0.5, False),
    ],
)
def test_a_step_is_about_nine_ap_that_r40_has_not(r11: float, r40: float, is_step: bool) -> None:
    assert is_one_step(r11, r40) is is_step


def test_where_no_ground_truth_counts_there_are_no_gains_and_no_error() -> None:
    unknown = Resampled(np.full((9, 2), np.nan), np.full((50, 9, 2), np.nan))
    found = gains({"VoxelNet": {"0": {0: unknown}, "2": {0: unknown}}}, "0")
    assert found.empty
    assert {"level", "gain", "marked"} <= set(found.columns)


def test_recalls_are_means_over_classes_that_have_labels() -> None:
    cars = recalls(compared(0.1))
    pd.testing.assert_frame_equal(recalls(compared(0.1), ["Car", "Pedestrian"]), cars)
