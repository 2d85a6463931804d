"""What seeds could tell, before they are trained: by hand arithmetic."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.commands import plan as command
from fl3d.config.compose import compose_config
from fl3d.config.settings import SweepSettings, read_settings
from fl3d.core.errors import ConfigError
from fl3d.evaluation.intervals import member_alpha
from fl3d.evaluation.verdicts import smallest_gain
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.cost import Cost
from fl3d.sweep.forecast import Forecast
from fl3d.sweep.pilot import Pilot, by_hand, find_pilots, gains_by_seed, pilot_of, with_frames
from fl3d.sweep.plan import DataInfo, Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.power import Question, power_lines, prospect
from fl3d.sweep.sweepers.grid import point_of
from tests.analysis.making import detected_sweep
from tests.papers.making import Made, aps, finished_sweep, store_scores
from tests.support import SMALL
from tests.sweep.test_preview import shown

GAMMAS = (0, 1, 2)
GRID = [
    ["detector=voxelnet", f"loss.gamma={gamma}", f"seed={seed}"]
    for gamma in GAMMAS
    for seed in (0, 1, 2)
]


def planned(*points: list[str]) -> Plan:
    laid_out = [point_of(point, compose_config(["profile=quick", *point])) for point in points]
    base = laid_out[0].config
    swept = list(laid_out[0].values)
    return Planner(base, read_settings(base), swept, DataInfo("digest", 400)).plan(laid_out)


def asked(margin: float = 1.0) -> SweepSettings:
    return read_settings(compose_config([f"sweep.margin={margin}"])).sweep


def test_levels_spreads_are_pooled_by_degrees_of_freedom() -> None:
    """Gains 1, 3 have a variance of 2 on one degree; 0, 0, 3 have one of 3 on two: (2 + 2 * 3) / 3."""
    gains = pd.DataFrame(
        {"1": [1.0, np.nan, 3.0], "2": [0.0, 0.0, 3.0], "5": [7.0, np.nan, np.nan]}
    )
    found = pilot_of(gains)
    assert found is not None
    assert found.spread == pytest.approx((8 / 3) ** 0.5)
    assert found.source == "spread between seeds 1.6 AP, of 2 levels with 2 to 3 seeds, 1.4 to 1.7"
    assert pilot_of(gains[["5"]]) is None
    copies = gains.assign(copied=[2.0, 2.0, 2.0])
    assert pilot_of(copies[["copied"]]) is None
    alone = pilot_of(copies)
    assert alone is not None
    assert alone.spread == found.spread
    assert pilot_of(pd.DataFrame()) is None


def test_gains_are_those_of_the_primary_metric_and_last_checkpoints_by_seed() -> None:
    table = {"0": (50.0, 60.0), "2": (51.0, 58.0)}
    made = [
        Made(
            overrides=("detector=voxelnet", f"loss.gamma={level}", f"seed={seed}"),
            scores={
                3: aps(99.0),
                5: {**aps(0.0), "ap_3d_r40/moderate": table[level][seed]},
            },
        )
        for level in table
        for seed in (0, 1)
    ]
    sweep = finished_sweep(["sweep.name=test", "profile=tiny"], made)
    gains = gains_by_seed(sweep, "VoxelNet", "0")
    assert gains.to_dict() == {"2": {0: 1.0, 1: -2.0}}
    assert gains_by_seed(sweep, "VoxelNet", "7").empty


def test_a_gain_of_one_spread_takes_ten_seeds() -> None:
    """Published tables of a paired t test (error 0.05, power 0.8): 1.68 spreads of 5 pairs, just below 1 of 10."""
    pilot = by_hand(2.0)
    found = prospect(pilot, n_levels=1, n_seeds=5, margin=2.0)
    assert found.smallest == pytest.approx(2 * 1.68, abs=0.01)
    assert found.needed == 10


def test_more_levels_take_more_seeds_for_their_intervals_hold_at_once() -> None:
    one = prospect(by_hand(1.0), 1, 5, 1.0)
    six = prospect(by_hand(1.0), 6, 5, 1.0)
    assert one.smallest is not None
    assert six.smallest == pytest.approx(smallest_gain(1.0, 5, 1 - 0.95 ** (1 / 6)))
    assert six.smallest > one.smallest
    assert (one.needed, six.needed) == (10, 16)


def test_fewer_than_three_seeds_tell_nothing() -> None:
    assert prospect(by_hand(0.1), 6, 2, 1.0).smallest is None
    assert prospect(by_hand(0.1), 6, 2, 1.0).needed == 3


def test_frames_are_the_floor() -> None:
    """Frames that reach 1.5 AP tell 1.5 (1 + 0.842 / 1.960) = 2.14 AP four times in five."""
    pilot = with_frames(by_hand(0.01), 1.5)
    assert prospect(pilot, 1, 5, 1.0).smallest == pytest.approx(2.14, abs=0.005)
    assert prospect(pilot, 1, 5, 1.0).floor == pytest.approx(2.14, abs=0.005)
    assert prospect(pilot, 1, 5, 2.0).needed is None
    assert prospect(pilot, 1, 5, 2.2).needed == 3


def test_what_of_the_frames_part_does_not_last_shrinks_as_seeds_are_added() -> None:
    """Of ±2 with three seeds a quarter of the variance lasts: twelve seeds leave 2 times the root of 7/16, 1.32.

    Endlessly many leave ±1, which tells 1 (1 + 0.842 / 1.960) = 1.43 AP; ±2 tells 2.86, of any number of seeds.
    """
    pilot = with_frames(by_hand(0.01), 2.0, lasting=0.25, n_seeds=3)
    assert pilot.frames_of(3) == pytest.approx(2.0)
    assert pilot.frames_of(12) == pytest.approx(2 * (7 / 16) ** 0.5)
    found = prospect(pilot, n_levels=1, n_seeds=3, margin=2.0)
    assert found.smallest == pytest.approx(2.86, abs=0.005)
    assert found.floor == pytest.approx(1.43, abs=0.005)
    # 2 / 1.43 = 1.4 is left of ±2 where 1/4 + 3/4 * 3/n = 0.49, n = 9.4.
    assert found.needed == 10
    assert prospect(pilot, 1, 3, 1.4).needed is None
    said = lines({"VoxelNet": with_frames(by_hand(0.01), 2.0, lasting=0.25, n_seeds=3)}, 2.5)
    assert "by no number of seeds" not in said
    # Of two levels ±2 tells 2 (1 + 0.842 / 2.237) = 2.75; for 2.5 the part is 0.908: 1/4 + 9/4n = 0.825, n = 3.9.
    assert "2.5 AP takes about 4 seeds" in said
    assert "interval over frames ±2 with 3 seeds, ±1 with endlessly many" in said


def test_seeds_that_are_added_until_a_verdict_comes_tell_a_little_less() -> None:
    looks = (3, 4, 5)
    once = prospect(by_hand(1.0), 2, 5, 1.0)
    often = prospect(by_hand(1.0), 2, 5, 1.0, looks)
    assert once.smallest is not None
    assert often.smallest == pytest.approx(smallest_gain(1.0, 5, member_alpha(2, 5, looks)))
    assert often.smallest > once.smallest


def forecast(plan: Plan, root: Path) -> Forecast:
    """Every stage takes a minute and keeps a megabyte; two run at once."""
    found = Forecast(plan, StoreFolder(root), n_val=10, slots=2, keep_every=None)
    minute = Cost(seconds=60, flops=0, weights_bytes=0, detection_bytes=1e6, is_measured=True)
    found.costs = dict.fromkeys(plan.stages, minute)
    return found


def test_the_price_of_more_seeds_by_hand(tmp_path: Path) -> None:
    """Three seeds of a warm-up and three levels: 12 stages, 12 minutes, 6 on two slots; six seeds: twice that."""
    found = forecast(planned(*GRID), tmp_path)
    assert found.price("VoxelNet", 3) == "06:00 on 2 at once, 12.0MB kept"
    assert found.price("VoxelNet", 6) == "12:00 on 2 at once, 24.0MB kept"


def test_the_price_leaves_out_what_is_done(tmp_path: Path) -> None:
    """Half of two of the twelve stages is behind them: a minute of 12; a further seed has nothing behind it."""
    found = forecast(planned(*GRID), tmp_path)
    for key in found.todo[:2]:
        found.left[key] = 0.5
    assert found.price("VoxelNet", 3).startswith("05:30 on 2")
    assert found.price("VoxelNet", 6).startswith("11:30 on 2")


def test_a_chain_of_stages_takes_its_time_on_any_number_of_slots(tmp_path: Path) -> None:
    found = forecast(planned(*GRID), tmp_path)
    found.slots = 1000
    assert found.price("VoxelNet", 6).startswith("02:00 on 1000")


def lines(pilots: dict[str, Pilot], margin: float | None = None) -> str:
    question = Question(asked(), "0", asked=margin)
    return "\n".join(
        power_lines(planned(*GRID), question, pilots, lambda group, n: f"<{group} {n}>")
    )


def test_what_the_seeds_tell_is_said_with_its_source() -> None:
    """Two levels: Sidak's error of each is 0.0253."""
    smallest = smallest_gain(0.9, 3, 1 - 0.95**0.5)
    said = lines({"VoxelNet": with_frames(by_hand(0.9), 0.0)})
    assert "gains   of 3d_r40/moderate, told with a chance of four in five:" in said
    assert f"VoxelNet: {smallest:.2g} AP or more by 3 seeds; 1 AP takes about 11 seeds" in said
    assert "11 seeds: <VoxelNet 11>" in said
    assert "(spread between seeds 0.9 AP, as given; frames not counted)" in said


def test_seeds_that_are_enough_are_called_so() -> None:
    said = lines({"VoxelNet": by_hand(0.9)}, margin=5.0)
    assert "5 AP takes 3, so they are enough" in said
    assert "<VoxelNet" not in said


def test_too_few_frames_are_told() -> None:
    said = lines({"VoxelNet": with_frames(by_hand(0.1), 2.5)})
    assert "3.5 AP or more by 3 seeds; 1 AP by no number of seeds" in said
    assert "more frames" in said
    assert "1 AP takes more than 1000 seeds" in lines({"VoxelNet": with_frames(by_hand(90), 0.5)})
    assert "interval over frames ±2.5" in said


def test_nothing_is_told_of_what_is_not_known() -> None:
    assert "Run a pilot, the same words with seeds=3" in lines({})
    assert "--spread S" in lines({})
    assert "AP or more" not in lines({"3D-FCN": by_hand(0.9)})
    assert "VoxelNet: not known" in lines({"3D-FCN": by_hand(0.9)})


def test_finished_trials_tell_the_spread_and_the_frames(simulated: Path, tmp_path: Path) -> None:
    points = [
        ["detector=voxelnet", f"loss.gamma={gamma}", f"seed={seed}"]
        for gamma in (0, 2)
        for seed in (0, 1)
    ]
    noise = {("2", 1): 2.0}  # of one trial alone: its gain differs from the other seed's
    sweep = detected_sweep(
        simulated,
        tmp_path,
        points,
        lambda trial: noise.get((trial.level, trial.seed), 0.0),
        "sweep.name=mine",
    )
    store_scores(sweep)
    first, second = gains_by_seed(sweep, "VoxelNet", "0")["2"]
    spread = abs(first - second) / 2**0.5
    assert spread > 0
    found = find_pilots(sweep.settings, ["VoxelNet", "3D-FCN"])
    assert set(found) == {"VoxelNet"}
    assert found["VoxelNet"].spread == pytest.approx(spread)
    assert found["VoxelNet"].frames > 0
    assert 0 <= found["VoxelNet"].lasting < 1
    assert found["VoxelNet"].n_seeds == 2
    given = find_pilots(sweep.settings, ["VoxelNet"], 0.7)["VoxelNet"]
    assert (given.spread, given.frames) == (0.7, found["VoxelNet"].frames)
    places = [f"data.root={simulated}", f"store.root={sweep.settings.store.root}"]
    common = [*SMALL, *places, "sweep.name=mine", "detector=voxelnet", "loss.gamma=0,2"]
    _, text = shown(*common, "seed=0,1,2", f"results={tmp_path}")
    assert f"(spread between seeds {spread:.2g} AP, of one level with 2 seeds; interval" in text
    _, text = shown(*common, "sweep.baseline=2", "seed=0,1,2", f"results={tmp_path}")
    assert f"(spread between seeds {spread:.2g} AP, of one level with 2 seeds; interval" in text


def test_a_plan_without_a_pilot_says_how_to_get_one(tmp_path: Path) -> None:
    places = [f"data.root={tmp_path}", f"store.root={tmp_path}", f"results={tmp_path}"]
    words = ["detector=voxelnet", "loss.gamma=0,2", "sweep.name=mine", "seed=0,1,2", *places]
    _, text = shown(*words)
    assert "gains   not known: no level has two seeds that are done here. Run a pilot" in text
    # Of a normal mean (1.96 + 0.84)^2 (0.9 / 0.5)^2 = 25.4; the spread is not known, but estimated: 1.96^2 / 2 more.
    _, text = shown(*words, spread=0.9, margin=0.5)
    assert "(spread between seeds 0.9 AP, as given; frames not counted)" in text
    assert "0.5 AP takes about 28 seeds: " in text


def test_a_plan_that_compares_nothing_does_not_speak_of_gains(tmp_path: Path) -> None:
    places = [f"data.root={tmp_path}", f"store.root={tmp_path}", f"results={tmp_path}"]
    _, text = shown("detector=voxelnet", "seed=0,1,2", "sweep.name=mine", *places)
    assert "gains" not in text


@pytest.mark.parametrize("text", ["0", "-1", "abc", "nan", "inf", "101", ""])
def test_a_spread_is_a_number_of_ap(text: str) -> None:
    with pytest.raises(ConfigError, match=r"--spread .*: a number of AP above 0"):
        command.run([f"--spread={text}"])
