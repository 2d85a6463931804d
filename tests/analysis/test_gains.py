"""Gains over the baseline, with intervals: of whatever was swept."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from fl3d.analysis.gains import Comparisons, compare_sweep, gains, recalls, without_baseline
from fl3d.core.errors import ConfigError, StoreError
from fl3d.papers.results import levels_of
from fl3d.reports.levels import gains_tables, levels_table
from fl3d.reports.render import to_markdown
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep, without
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


def points(swept: Sequence[str], *more: str) -> list[list[str]]:
    return [[*one.split(), *more] for one in swept]


def noise_by_level(levels: Sequence[str]) -> dict[str, float]:
    return {level: 2.0 * place for place, level in enumerate(levels)}


def test_a_clear_loss_is_starred_and_the_baseline_gains_nothing() -> None:
    table = gains(compared(noise=0.5), "0", n_resamples=100)
    assert len(table) == 2 * 3 * 3 * 2
    assert set(table["seeds"]) == {1}  # only those that the baseline has as well
    zero = table[table["level"] == "0"]
    assert (zero[["gain", "gain_low", "gain_high"]] == 0).all(axis=None)
    loss = table[(table["level"] == "2") & (table["metric"] == "3d") & (table["average"] == "R40")]
    assert (loss["gain"] < 0).all()
    assert loss["significant"].all()


def test_a_sweep_without_its_baseline_has_no_gain() -> None:
    with pytest.raises(ConfigError, match=r"a trial of the baseline '0'.*sweep\.baseline"):
        gains({"VoxelNet": {"2": compared(0.1)["VoxelNet"]["2"]}}, "0", 10)


def test_a_group_without_the_baseline_is_left_out_and_named() -> None:
    both = compared(0.1)
    both["3D-FCN"] = {"2": both["VoxelNet"]["2"]}
    assert set(gains(both, "0", 10)["group"]) == {"VoxelNet"}
    assert without_baseline(both, "0") == ["3D-FCN"]
    assert without_baseline(compared(0.1), "0") == []


def test_seeds_are_averaged_and_those_that_the_baseline_lacks_are_left_out() -> None:
    side = compared(0.3)["VoxelNet"]
    base = {0: side["0"][0], 2: side["0"][0]}
    table = gains({"VoxelNet": {"0": base, "2": {**side["2"], 2: side["0"][0]}}}, "0", 10)
    moderate = table[
        (table["metric"] == "3d")
        & (table["difficulty"] == "moderate")
        & (table["average"] == "R11")
    ]
    assert dict(zip(moderate["level"], moderate["seeds"], strict=True)) == {
        "0": 2,
        "2": 2,
    }  # 1 is none of the base's
    noisy, clean = (
        one.curve("Car", "3d", "moderate").ap_r11 for one in (side["2"][0], side["0"][0])
    )
    row = moderate[moderate["level"] == "2"].iloc[0]
    assert row["ap"] == pytest.approx((noisy + clean) / 2)
    assert row["gain"] == pytest.approx((noisy - clean) / 2)


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
    table = gains(compare_sweep(sweep), sweep.baseline, n_resamples=20)
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
    table = gains(compare_sweep(sweep), sweep.baseline, n_resamples=10)
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
    table = gains(found, sweep.baseline, 10)
    assert set(table["group"]) == {"VoxelNet"}
    assert set(table["seeds"]) == {1}
    assert without_baseline(found, sweep.baseline) == ["3D-FCN"]
    averaged = gains(compare_sweep(whole), whole.baseline, 10)
    assert set(averaged["seeds"]) == {2}
    by_level = levels_table(whole.select("last"), "VoxelNet", levels_of(whole), "any", "R40")
    (_, printed) = gains_tables(averaged, levels_of(whole), "3d/hard", "R40")
    assert [cell.text for cell in printed.column("seeds")] == ["2", "2"]
    assert [cell.text.partition(" ")[0] for cell in printed.column("ap")] == [
        cell.text for cell in by_level.column("3d_hard")
    ]


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
