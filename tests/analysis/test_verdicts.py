"""What a sweep has found, from made-up samples and from made-up detections."""

import math
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis import AVERAGES
from fl3d.analysis.found import judge_sweep, left_out, sweep_verdicts
from fl3d.analysis.samples import CELLS, Resampled
from fl3d.analysis.verdicts import verdicts
from fl3d.config.settings import SweepSettings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.records import Trial
from fl3d.evaluation.intervals import member_alpha
from fl3d.evaluation.verdicts import Verdict
from fl3d.papers.judged_views import tables_of_verdicts
from fl3d.reports.figures.forest import forest
from fl3d.reports.levels import Levels
from fl3d.reports.render import to_markdown
from fl3d.reports.verdicts import findings, in_short, verdict_tables, verdict_text
from fl3d.runs.asked import asked_for
from fl3d.runs.finished import FinishedSweep, levels_of
from tests.analysis.making import detected_sweep, without
from tests.papers.making import Made, aps, finished_sweep

BASE = 50.0
Seeds = Mapping[int, Resampled]


def asked(primary: str = "3d_r40/moderate", margin: float = 1.0) -> SweepSettings:
    made = finished_sweep(("detector=voxelnet",), [Made(overrides=("seed=0",), scores={1: aps()})])
    return replace(made.settings.sweep, primary=primary, margin=margin)


def level_of(gains: Sequence[float], reach: float = 0.1, cell: str = "3d/moderate R40") -> Seeds:
    """Seeds 0, 1, ... that gain so much in one cell, whose draws reach so far either way (95 %)."""
    metric, average = cell.split()
    view, difficulty = metric.split("/")
    place = CELLS.index((view, difficulty)), AVERAGES.index(average)
    found = {}
    for seed, gain in enumerate(gains):
        values = np.full((len(CELLS), 2), BASE)
        values[place] += gain
        moves = np.zeros((101, len(CELLS), 2))
        moves[:, *place] = np.linspace(-reach, reach, 101) / 0.95
        found[seed] = Resampled(values, values + moves)
    return found


def base_of(n_seeds: int) -> Seeds:
    return level_of([0.0] * n_seeds, reach=0.0)


def judged(
    levels: Mapping[str, Seeds], settings: SweepSettings | None = None, looks: tuple[int, ...] = ()
) -> pd.DataFrame:
    found = verdicts({"VoxelNet": levels}, "0", settings or asked(), looks)
    return found.set_index("level")


def test_each_word_has_its_level() -> None:
    found = judged(
        {
            "0": base_of(5),
            "better": level_of([9.0, 10.0, 11.0, 10.0, 10.0]),
            "worse": level_of([-9.0, -10.0, -11.0, -10.0, -10.0]),
            "equivalent": level_of([-0.1, 0.0, 0.1, 0.0, 0.0]),
            "undecided": level_of([-4.0, 2.0, 5.0, 0.0, 1.0]),
        }
    )
    assert found["verdict"].tolist() == [
        Verdict.BASELINE,
        Verdict.BETTER,
        Verdict.WORSE,
        Verdict.EQUIVALENT,
        Verdict.UNDECIDED,
    ]
    assert set(found["seeds"]) == {5}
    assert set(found["metric"]) == {"3d_r40/moderate"}
    assert found.loc["better", "ap"] == pytest.approx(BASE + 10)
    assert found.loc["better", "spread"] == pytest.approx(0.5**0.5)


def test_the_baseline_has_its_ap_and_no_gain() -> None:
    row = judged({"0": level_of([0.0, 1.0, 2.0], reach=0.0), "2": base_of(3)}).loc["0"]
    half = 4.303 / 3**0.5
    assert (row["ap"], row["gain"], row["gain_low"], row["gain_high"]) == (BASE + 1, 0, 0, 0)
    assert (row["ap_low"], row["ap_high"]) == pytest.approx(
        (BASE + 1 - half, BASE + 1 + half),
        abs=5e-3,  # frames add a thousandth of it
    )
    assert math.isnan(row["spread"])
    assert math.isnan(row["more_seeds"])


@pytest.mark.parametrize("n_seeds", [1, 2])
def test_one_and_two_seeds_have_an_interval_and_no_verdict(n_seeds: int) -> None:
    row = judged({"0": base_of(3), "2": level_of([20.0, 20.1][:n_seeds])}).loc["2"]
    assert row["verdict"] == Verdict.NONE
    assert row["seeds"] == n_seeds
    assert row["gain_low"] > 0
    three = judged({"0": base_of(3), "2": level_of([20.0, 20.1, 20.2])}).loc["2"]
    assert three["verdict"] == Verdict.BETTER


def test_one_seeds_interval_is_its_frames() -> None:
    row = judged({"0": base_of(1), "2": level_of([3.0], reach=2.0)}).loc["2"]
    assert (row["gain_low"], row["gain_high"]) == pytest.approx((1.0, 5.0), abs=0.05)
    assert math.isnan(row["more_seeds"])


def test_intervals_of_a_group_hold_all_at_once() -> None:
    """Gains of 2 and s.d. 0.6 are clear of zero for one level, and not for one of six."""
    gains = [1.4, 2.0, 2.6]
    alone = judged({"0": base_of(3), "1": level_of(gains)}).loc["1"]
    six = judged({"0": base_of(3), **{str(n): level_of(gains) for n in range(1, 7)}}).loc["1"]
    assert (alone["verdict"], six["verdict"]) == (Verdict.BETTER, Verdict.UNDECIDED)
    assert six["gain_low"] < alone["gain_low"]
    assert six["ap_low"] == alone["ap_low"]  # an AP stands for itself


def test_levels_that_are_planned_and_not_there_keep_their_share_of_the_error() -> None:
    """One of two: t at 1 - sqrt(0.95) = 2.53 %, over three gains 6.164 standard errors instead of 4.303.

    Gains 9, 10 and 11 have a standard error of 1 / sqrt(3) = 0.577; the draws add 0.1 at most.
    """
    levels = {"VoxelNet": {"0": base_of(3), "2": level_of([9.0, 10.0, 11.0])}}
    for planned, reach in ((None, 2.484), ({"VoxelNet": 1}, 2.484), ({"VoxelNet": 2}, 3.559)):
        row = verdicts(levels, "0", asked(), planned=planned).set_index("level").loc["2"]
        assert 10 - row["gain_low"] == pytest.approx(reach, abs=0.01)


def test_groups_are_families_of_their_own() -> None:
    gains = [1.4, 2.0, 2.6]
    levels = {"0": base_of(3), "1": level_of(gains)}
    both = verdicts({"3D-FCN": levels, "VoxelNet": levels}, "0", asked())
    assert both["verdict"].tolist() == [Verdict.BASELINE, Verdict.BETTER] * 2


@pytest.mark.parametrize("cell", ["3d/moderate R40", "bev/easy R11", "image/hard R40"])
def test_the_verdict_is_about_the_primary_metric(cell: str) -> None:
    metric, average = cell.split()
    view, difficulty = metric.split("/")
    primary = f"{view}{'_r40' if average == 'R40' else ''}/{difficulty}"
    levels = {"0": base_of(3), "2": level_of([9.0, 10.0, 11.0], cell=cell)}
    found = judged(levels, asked(primary)).loc["2"]
    assert found["verdict"] == Verdict.BETTER
    assert found["metric"] == primary
    others = [name for name in ("3d/moderate R40", "bev/easy R11", "image/hard R40")]
    other = next(name for name in others if name != cell)
    levels = {"0": base_of(3), "2": level_of([9.0, 10.0, 11.0], cell=other)}
    assert judged(levels, asked(primary)).loc["2", "verdict"] == Verdict.EQUIVALENT


def test_the_margin_is_the_users() -> None:
    levels = {"0": base_of(3), "2": level_of([-1.0, 0.0, 1.0])}
    assert judged(levels, asked(margin=1.0)).loc["2", "verdict"] == Verdict.UNDECIDED
    assert judged(levels, asked(margin=3.0)).loc["2", "verdict"] == Verdict.EQUIVALENT


def test_seeds_that_would_decide_are_told_by_hand() -> None:
    """Gains 1, 2, 3: at 3 seeds half is 2.48, at 4 it is 1.59 and zero is out. One more."""
    row = judged({"0": base_of(3), "2": level_of([1.0, 2.0, 3.0])}).loc["2"]
    assert (row["verdict"], row["more_seeds"]) == (Verdict.UNDECIDED, 1)
    decided = judged({"0": base_of(3), "2": level_of([9.0, 10.0, 11.0])}).loc["2"]
    assert math.isnan(decided["more_seeds"])


def test_two_seeds_tell_how_many_more() -> None:
    row = judged({"0": base_of(2), "2": level_of([9.0, 11.0])}).loc["2"]
    assert (row["verdict"], row["more_seeds"]) == (Verdict.NONE, 1)


def test_where_frames_are_too_few_no_number_of_seeds_is_told() -> None:
    levels = {"0": base_of(3), "2": level_of([0.0, 0.1, 0.2], reach=5.0)}
    row = judged(levels).loc["2"]
    assert row["verdict"] == Verdict.UNDECIDED
    assert math.isnan(row["more_seeds"])


def test_seeds_that_the_baseline_lacks_are_left_out() -> None:
    found = judged({"0": base_of(2), "2": level_of([1.0, 2.0, 90.0]), "5": {7: base_of(1)[0]}})
    assert found.loc["2", "seeds"] == 2
    assert found.loc["2", "gain"] == pytest.approx(1.5)
    assert list(found.index) == ["0", "2"]


def test_a_verdict_that_was_waited_for_needs_more() -> None:
    """Seeds were added until there was a verdict: the error is spent over the looks."""
    levels = {"0": base_of(3), "2": level_of([3.2, 4.2, 5.2])}
    once = judged(levels).loc["2"]
    waited = judged(levels, looks=(3, 4, 5, 6)).loc["2"]
    assert waited["gain_low"] < once["gain_low"]
    assert (once["verdict"], waited["verdict"]) == (Verdict.BETTER, Verdict.UNDECIDED)
    assert member_alpha(1, 3, (3, 4, 5, 6)) < 0.05


POINTS = [[f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 2, 5) for seed in (0, 1, 2)]


@pytest.fixture(scope="module")
def detected(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    """Three seeds: of gamma 0 all cars are found, of gamma 2 likewise, of gamma 5 none."""
    noise = {"0": 0.0, "2": 0.0, "5": 30.0}
    root = tmp_path_factory.mktemp("judged")
    return detected_sweep(
        simulated, root, POINTS, lambda trial: noise[trial.level], "detector=voxelnet"
    )


def test_a_sweep_is_judged_from_its_run_folders(detected: FinishedSweep) -> None:
    """Two of its four frames have a car each: one resample in sixteen has none, and there nothing is lost.

    The standard deviation of the resamples reaches further up than they do.
    """
    found = judge_sweep(detected, n_resamples=200)
    rows = found.verdicts.set_index("level")
    assert rows["verdict"].to_dict() == {
        "0": Verdict.BASELINE,
        "2": Verdict.EQUIVALENT,
        "5": Verdict.UNDECIDED,
    }
    assert rows.loc["5", "gain"] == -rows.loc["0", "ap"]
    assert rows.loc["5", "gain_high"] > 0
    assert rows.loc[["2", "5"], "more_seeds"].isna().all()
    assert rows["seed_minutes"].tolist() == [0.0, 0.0, 0.0]
    assert (found.margin, found.units.name, found.left_out) == (1.0, "frames", ())
    assert set(found.gains["level"]) == {"0", "2", "5"}
    same = found.gains.set_index(["level", "metric", "difficulty", "average"])
    assert same.loc[("5", "3d", "moderate", "R40"), "ap"] == rows.loc["5", "ap"]


def test_verdicts_alone_are_those_of_the_whole(detected: FinishedSweep) -> None:
    alone = sweep_verdicts(detected, n_resamples=50)
    whole = judge_sweep(detected, n_resamples=50).verdicts
    pd.testing.assert_frame_equal(alone, whole)


def test_a_level_that_is_asked_for_alone_is_judged_as_one_of_all(
    simulated: Path, tmp_path: Path
) -> None:
    """Two levels are compared: words that pick one afterwards make it no family of one, whose t would be smaller."""

    def off(trial: Trial) -> float:
        return 30.0 if (trial.level, trial.seed) == ("2", 0) else 0.0

    swept = detected_sweep(simulated, tmp_path, POINTS, off, "detector=voxelnet")
    whole = judge_sweep(swept, n_resamples=50)
    alone = asked_for(swept, {"loss.gamma": [2]})
    assert alone.levels == ["0", "2"]
    found = judge_sweep(alone, n_resamples=50)
    for one, other in ((found.verdicts, whole.verdicts), (found.gains, whole.gains)):
        own = other[other["level"].isin(["0", "2"])].reset_index(drop=True)
        pd.testing.assert_frame_equal(one, own)
    pd.testing.assert_frame_equal(sweep_verdicts(alone, n_resamples=50), found.verdicts)
    assert set(found.samples["VoxelNet"]) == {"0", "2"}
    plan = replace(alone.plan, trials=tuple(trial.plan for trial in alone.trials))
    lone = judge_sweep(replace(alone, family=None, plan=plan), n_resamples=50).verdicts.iloc[1]
    # Over two gains of 0 and one of -g: of one level t(97.5 %) = 4.30 standard errors, of two t(98.73 %) = 6.16.
    assert found.verdicts.iloc[1]["gain_low"] < lone["gain_low"] - 1


def test_a_replicate_that_is_not_done_leaves_its_pair_out_and_is_named(
    detected: FinishedSweep,
) -> None:
    some = without(
        detected,
        lambda trial: (trial.level, trial.seed) in {("2", 1), ("0", 2)},
    )
    assert left_out(some) == [
        "VoxelNet 0: seed 2 left out, not done",
        "VoxelNet 2: seed 1 left out, not done",
        "VoxelNet 2: seed 2 left out, its baseline is not done",
        "VoxelNet 5: seed 2 left out, its baseline is not done",
    ]
    found = judge_sweep(some, n_resamples=50)
    assert found.left_out == tuple(left_out(some))
    seeds = dict(zip(found.verdicts["level"], found.verdicts["seeds"], strict=True))
    assert seeds == {"0": 2, "2": 1, "5": 2}
    assert set(found.verdicts["verdict"]) == {Verdict.BASELINE, Verdict.NONE}


def test_a_replicate_whose_scores_wait_for_the_store_is_named_with_the_way_out(
    detected: FinishedSweep,
) -> None:
    some = without(detected, lambda trial: (trial.level, trial.seed) == ("0", 2))
    (gone,) = {trial.key for trial in detected.trials} - {trial.key for trial in some.trials}
    why = "scores are not all in the store"
    assert left_out(replace(some, unshown={gone: why})) == [
        f"VoxelNet 0: seed 2 left out, its {why}",
        f"VoxelNet 2: seed 2 left out, its baseline's {why}",
        f"VoxelNet 5: seed 2 left out, its baseline's {why}",
    ]


def test_what_was_not_asked_for_is_not_left_out(detected: FinishedSweep) -> None:
    """Of seed 0 alone, or of one level beside the baseline."""
    one = without(detected, lambda trial: trial.seed > 0)
    assert left_out(replace(one, asked={"seed": frozenset({"0"})})) == []
    two = without(detected, lambda trial: trial.level == "5")
    assert left_out(replace(two, asked={"loss.gamma": frozenset({"2"})})) == []


def test_a_seed_of_which_nothing_is_done_is_named_all_the_same(detected: FinishedSweep) -> None:
    """As where the first stage that all its levels share has failed."""
    some = without(detected, lambda trial: trial.seed == 2)
    assert left_out(some) == [
        f"VoxelNet {level}: seed 2 left out, not done" for level in ("0", "2", "5")
    ]


def test_a_sweep_without_its_baseline_has_no_verdict(detected: FinishedSweep) -> None:
    with pytest.raises(ConfigError, match=r"a trial of the baseline '0'"):
        judge_sweep(without(detected, lambda trial: trial.level == "0"))


def test_scores_alone_have_no_verdict() -> None:
    made = [Made(overrides=(f"loss.gamma={gamma}",), scores={1: aps(gamma)}) for gamma in (0, 2)]
    with pytest.raises(StoreError, match="only its scores are here"):
        judge_sweep(finished_sweep(("detector=voxelnet",), made))


def test_seeds_with_the_same_detections_are_no_runs_of_their_own() -> None:
    """A program that ignores its seed gains 2 AP three times: what is known is one run, and its frames."""
    same = {seed: replace(one, detections="a") for seed, one in level_of([2.0] * 3).items()}
    differs = {seed: replace(one, detections=str(seed)) for seed, one in same.items()}
    base = {seed: replace(one, detections=f"b{seed}") for seed, one in base_of(3).items()}
    found = judged({"0": base, "2": same, "5": differs})
    assert found["verdict"].tolist() == [Verdict.BASELINE, Verdict.NONE, Verdict.BETTER]
    row = found.loc["2"]
    assert (row["seeds"], row["gain"], row["copies"]) == (1, 2.0, "seeds 0, 1, 2")
    assert (row["gain_low"], row["gain_high"]) == pytest.approx((1.9, 2.1), abs=0.02)
    assert not row["open"]
    assert math.isnan(row["more_seeds"])
    text = "none: seeds 0, 1, 2 have the same detections: does the program read its seed?"
    assert verdict_text(found.reset_index().to_dict("records")[1], 1.0) == text


def test_copies_of_the_baseline_leave_every_level_without_a_verdict() -> None:
    same = {seed: replace(one, detections="b") for seed, one in base_of(3).items()}
    found = judged({"0": same, "2": level_of([9.0, 10.0, 11.0])})
    row = found.loc["2"]
    assert (row["verdict"], row["seeds"], row["gain"]) == (Verdict.NONE, 1, 9.0)
    assert row["copies"] == "the baseline's seeds 0, 1, 2"
    assert found.loc["0", "seeds"] == 1


def test_two_copies_among_several_seeds_leave_no_verdict_either() -> None:
    own = level_of([9.0, 10.0, 11.0, 10.0, 10.0])
    copied = {seed: replace(one, detections=f"{min(seed, 3)}") for seed, one in own.items()}
    row = judged({"0": base_of(5), "2": copied}).loc["2"]
    assert (row["verdict"], row["seeds"], row["copies"]) == (Verdict.NONE, 4, "seeds 3, 4")


def test_runs_that_find_nothing_are_no_copies() -> None:
    """A network that has collapsed finds nothing three times: it is worse, and no copy of itself."""
    nothing = {seed: Resampled(np.zeros((9, 2)), np.zeros((50, 9, 2))) for seed in range(3)}
    base = {
        seed: Resampled(np.full((9, 2), 50.0 + seed), np.full((50, 9, 2), 50.0 + seed))
        for seed in range(3)
    }
    row = judged({"0": base, "2": nothing}).loc["2"]
    assert (row["verdict"], row["copies"]) == (Verdict.WORSE, "")


def test_a_sweep_of_a_program_that_ignores_its_seed_has_no_verdict(
    simulated: Path, tmp_path: Path
) -> None:
    sweep = detected_sweep(
        simulated, tmp_path, POINTS, lambda trial: 0.0, "detector=voxelnet", "sweep.name=copied"
    )
    first = next(one for one in sweep.trials if (one.level, one.seed) == ("2", 0))
    for trial in sweep.trials:
        if trial.level == "2" and trial.seed > 0:
            path = trial.folder.detections(trial.last_step)
            shutil.copy(first.folder.detections(first.last_step), path)
    alone = sweep_verdicts(sweep, n_resamples=50)
    found = judge_sweep(sweep, n_resamples=50)
    pd.testing.assert_frame_equal(alone, found.verdicts)
    again = judge_sweep(sweep, n_resamples=50)  # from what was kept
    pd.testing.assert_frame_equal(again.verdicts, found.verdicts)
    row = found.verdicts.set_index("level").loc["2"]
    assert (row["verdict"], row["seeds"], row["copies"]) == (Verdict.NONE, 1, "seeds 0, 1, 2")
    assert not found.gains["marked"].any()
    said = findings(found.verdicts, levels_of(sweep), 1.0)[0]
    assert "γ = 2: seeds 0, 1, 2 have the same detections" in said
    assert "without a verdict (γ = 2: seeds 0, 1, 2" in in_short(found.verdicts, levels_of(sweep))
    table = tables_of_verdicts(found, levels_of(sweep))[0]
    assert "none: seeds 0, 1, 2 have the same detections" in to_markdown(table)


def test_without_ground_truths_there_is_no_verdict_and_no_number() -> None:
    unknown = {
        seed: Resampled(np.full((9, 2), np.nan), np.full((50, 9, 2), np.nan)) for seed in range(3)
    }
    found = judged({"0": unknown, "2": unknown})
    row = found.loc["2"]
    assert (row["verdict"], row["open"]) == (Verdict.NONE, False)
    rows = found.reset_index()
    assert verdict_text(rows.to_dict("records")[1], 1.0) == "none: no ground truth counts"
    levels = Levels("gamma", ["0", "2"], "0")
    table = to_markdown(verdict_tables(rows, levels, 1.0)[0])
    assert "nan" not in table
    assert forest(rows, levels, 1.0) is None


def test_two_networks_that_find_nothing_are_not_called_equivalent() -> None:
    nothing = {seed: Resampled(np.zeros((9, 2)), np.zeros((50, 9, 2))) for seed in range(4)}
    found = judged({"0": nothing, "2": nothing})
    assert found.loc["2", "verdict"] == Verdict.NONE
    assert verdict_text(found.reset_index().to_dict("records")[1], 1.0).endswith("(AP 0)")
