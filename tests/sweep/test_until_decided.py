"""Seeds in rounds until verdicts come: who gets more, when it ends, and that a later start repeats it.

No network is trained.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fl3d.analysis.found import judge_sweep
from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config, Stage, Trial
from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.verdicts import gain_text
from fl3d.runs.opening import open_sweep
from fl3d.runs.plans import read_plan
from fl3d.store.memory import MemoryStore
from fl3d.store.opening import open_store
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.preview import preview
from fl3d.sweep.run import Ran, run_sweep
from fl3d.sweep.setup import paid_looks, prepare_sweep
from fl3d.sweep.sweepers.base import Evidence, Point, Standing, TrialState, Work
from fl3d.sweep.sweepers.params import check_params
from fl3d.sweep.sweepers.rounds import rounds_of
from fl3d.sweep.sweepers.until_decided import UntilDecided, until_decided
from fl3d.sweep.winners import with_winners
from tests.analysis.making import Finding
from tests.support import small_config, small_sweep

PARAMS = {"detector": "fcn3d,voxelnet", "loss.gamma": "0,1,2"}
ROUNDS = {"first": 3, "most": 6, "step": 1, "hours": None}


def compose(overrides: Sequence[str]) -> Config:
    values = dict(word.split("=") for word in overrides)
    return {**values, "seed": int(values.get("seed", 0))}


def make(*words: str, params: Mapping[str, object] = PARAMS, **rounds: Any) -> UntilDecided:
    return until_decided(params, words, compose, {**ROUNDS, **rounds})


class Script(Evidence):
    """Verdicts as told: ``words`` gives that of a detector's level after so many pairs."""

    factor = ("loss.gamma",)
    margin = 1.0
    looks_before: tuple[int, ...] = ()

    def __init__(self, words: Callable[[str, str, int], Verdict], hours: float = 1.0) -> None:
        self.words = words
        self.hours = hours  # of each trial
        self.said: list[str] = []
        self.judged = 0

    def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
        self.judged += 1
        done = {one.trial.label: one.trial for one in standings.values() if is_done(one)}
        places = dict.fromkeys((trial.group, trial.level) for trial in done.values())
        rows = []
        for group, level in places:
            seeds = {trial.seed for trial in done.values() if trial.group == group}
            both = [s for s in seeds if {f"{group} {n} seed {s}" for n in (0, level)} <= set(done)]
            if both:
                word = self.words(group, level, len(both)) if level != "0" else Verdict.BASELINE
                is_open = word in (Verdict.UNDECIDED, Verdict.NONE)
                row = {"group": group, "level": level, "seeds": len(both), "verdict": word}
                gain = {"gain": 0.5, "gain_low": -0.5, "gain_high": 1.5, "more_seeds": 2.0}
                rows.append({**row, **gain, "open": is_open})
        return pd.DataFrame(rows)

    def work(self, standings: Mapping[str, Standing], points: Sequence[Point], slots: int) -> Work:
        left = 3600 * self.hours * len(points)
        return Work(3600 * self.hours * len(standings), left, left / slots)

    def say(self, text: str) -> None:
        self.said.append(text)


def is_done(one: Standing) -> bool:
    return one.state is TrialState.DONE


def trial_of(point: Point) -> Trial:
    key = " ".join(point.overrides)
    return Trial(
        key=key,
        overrides=point.overrides,
        values=point.values,
        config=point.config,
        stages=(key,),
        first_own_step=0,
        detector=point.values["detector"],
        group=point.values["detector"],
        level=str(point.values["loss.gamma"]),
        seed=point.values["seed"],
    )


def run(
    sweeper: UntilDecided, evidence: Evidence, fails: Callable[[Trial], bool] = lambda trial: False
) -> list[list[str]]:
    """Trials of each round, as ``voxelnet 2 4``: detector, gamma and seed."""
    sweeper.consult(evidence)
    standings: dict[str, Standing] = {}
    rounds = []
    points = sweeper.first()
    while points:
        trials = [trial_of(point) for point in points]
        rounds.append([f"{trial.group} {trial.level} {trial.seed}" for trial in trials])
        for trial in trials:
            assert trial.key not in standings
            standings[trial.key] = Standing(trial, TrialState.RUNNING, {}, 1)
        assert sweeper.advise(standings, 2).points == ()  # while any of it runs
        for trial in trials:
            state = TrialState.FAILED if fails(trial) else TrialState.DONE
            standings[trial.key] = Standing(trial, state, {}, 1)
        points = sweeper.advise(standings, 2).points
    assert sweeper.advise(standings, 2).points == ()  # it has ended
    return rounds


def undecided(group: str, level: str, seeds: int) -> Verdict:
    return Verdict.UNDECIDED


def test_the_first_round_is_the_grid_of_the_first_seeds() -> None:
    (first, *_) = run(make(), Script(undecided))
    assert len(first) == 2 * 3 * 3
    assert {name.split()[2] for name in first} == {"0", "1", "2"}
    points = make("seed=5").first()
    assert {point.config["seed"] for point in points} == {5, 6, 7}
    assert points[0].overrides == ("detector=fcn3d", "loss.gamma=0", "seed=5")
    assert points[0].values == {"detector": "fcn3d", "loss.gamma": 0, "seed": 5}


def test_a_level_stops_when_it_has_its_verdict_and_the_baseline_goes_on_with_the_others() -> None:
    """fcn3d's levels are decided after 3 and 4 seeds; voxelnet's after 3 and never."""
    needed = {("fcn3d", "1"): 3, ("fcn3d", "2"): 4, ("voxelnet", "1"): 3, ("voxelnet", "2"): 99}

    def words(group: str, level: str, seeds: int) -> Verdict:
        return Verdict.BETTER if seeds >= needed[group, level] else Verdict.UNDECIDED

    evidence = Script(words)
    rounds = run(make(), evidence)
    assert rounds[1:] == [
        ["fcn3d 0 3", "fcn3d 2 3", "voxelnet 0 3", "voxelnet 2 3"],
        ["voxelnet 0 4", "voxelnet 2 4"],
        ["voxelnet 0 5", "voxelnet 2 5"],
    ]
    assert evidence.judged == 4  # once a round
    assert "6 seeds are the most" in evidence.said[-1]


def test_nothing_is_added_where_all_is_decided_at_once() -> None:
    evidence = Script(lambda group, level, seeds: Verdict.EQUIVALENT)
    assert len(run(make(), evidence)) == 1
    assert evidence.said[-1] == "No level is open: the sweep has ended."
    assert "4 of 4 levels have a verdict" in evidence.said[-2]
    assert "decided  fcn3d     gamma=1  3 seeds" in evidence.said[-2]


@pytest.mark.parametrize(
    ("rounds", "looks"),
    [
        ({}, (3, 4, 5, 6)),
        ({"step": 2}, (3, 5, 6)),
        ({"first": 6}, (6,)),
        ({"step": 9}, (3, 6)),
    ],
)
def test_the_looks_are_the_rounds_and_end_at_most(
    rounds: dict[str, int], looks: tuple[int, ...]
) -> None:
    sweeper = make(**rounds)
    assert sweeper.looks == looks
    sizes = [len(names) // 6 for names in run(sweeper, Script(undecided))]
    assert tuple(sum(sizes[: n + 1]) for n in range(len(sizes))) == looks
    assert sweeper.n_trials == 6 * looks[-1]


def test_a_failed_replicate_leaves_its_pair_out_and_blocks_nothing() -> None:
    """Its level needs a seed more than the others for its third pair."""

    def words(group: str, level: str, seeds: int) -> Verdict:
        return Verdict.WORSE if seeds >= 3 else Verdict.NONE

    def fails(trial: Trial) -> bool:
        return (trial.group, trial.level, trial.seed) == ("fcn3d", "2", 1)

    assert run(make(), Script(words), fails)[1:] == [["fcn3d 0 3", "fcn3d 2 3"]]


def test_a_level_of_which_all_replicates_failed_is_given_up() -> None:
    evidence = Script(lambda group, level, seeds: Verdict.WORSE)
    rounds = run(make(), evidence, lambda trial: trial.group == "fcn3d" and trial.level == "0")
    assert len(rounds) == 1
    assert evidence.said[-2].count("no replicate of it is done together with the base") == 3
    none = Script(undecided)
    assert len(run(make(), none, lambda trial: True)) == 1


def test_a_level_that_seeds_cannot_decide_is_given_up_and_said_so() -> None:
    class Hopeless(Script):
        def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
            return super().verdicts(standings).assign(open=False)

    evidence = Hopeless(undecided)
    assert len(run(make(), evidence)) == 1
    assert "  given up  fcn3d     gamma=1  3 seeds" in evidence.said[0]
    assert "the frames are too few for up to 6 seeds to tell" in evidence.said[0]


def test_a_verdict_that_is_lost_again_brings_all_seeds_that_its_level_lacks() -> None:
    """Its interval over frames hangs on the other levels', and these grow."""

    class Wavering(Script):
        def verdicts(self, standings: Mapping[str, Standing]) -> pd.DataFrame:
            found = super().verdicts(standings)
            lost = (found["level"] == "1") & (self.judged == 3)
            return found.assign(open=(found["level"] == "2") | lost)

    rounds = run(make(params={**PARAMS, "detector": "fcn3d"}), Wavering(undecided))
    assert rounds[1] == ["fcn3d 0 3", "fcn3d 2 3"]
    assert rounds[3] == ["fcn3d 0 5", "fcn3d 1 3", "fcn3d 1 4", "fcn3d 1 5", "fcn3d 2 5"]


def test_hours_end_it_before_the_round_that_would_pass_them() -> None:
    """18 trials of an hour first, then 6 a round."""
    evidence = Script(undecided)
    assert len(run(make(hours=24), evidence)) == 2
    assert evidence.said[-1].startswith(
        "Levels are open, and the next round would take 6.0 hours of work, past hours=24"
    )
    assert len(run(make(hours=23.9), Script(undecided))) == 1


def test_a_round_that_is_trained_already_costs_nothing_and_is_taken() -> None:
    class Trained(Script):
        def work(self, standings: Any, points: Any, slots: int) -> Work:
            return Work(super().work(standings, points, slots).done, 0.0, 0.0)

    evidence = Trained(undecided)
    assert len(run(make(hours=1), evidence)) == 4
    assert "Next: seed 3 of 4 levels and 2 baselines: trained already." in evidence.said


def test_after_each_round_it_says_what_the_next_one_is_and_costs() -> None:
    evidence = Script(undecided)
    run(make(step=3), evidence)
    assert "After 3 seeds and 18.0 hours of work 0 of 4 levels have a verdict." in evidence.said[0]
    assert "undecided, about 2 more seeds" in evidence.said[0]
    assert evidence.said[1] == (
        "Next: seeds 3, 4 and 5 of 4 levels and 2 baselines: 18.0 hours of work, 9.0 hours on 2 at once."
    )


def test_other_looks_of_an_earlier_start_are_said() -> None:
    evidence = Script(undecided)
    evidence.looks_before = (3, 4)
    make().consult(evidence)
    (said,) = evidence.said
    assert "after 3 and 4 seeds; this one does after 3, 4, 5 and 6" in said
    evidence.looks_before = make().looks
    make().consult(evidence)
    assert len(evidence.said) == 1


@pytest.mark.parametrize(
    ("before", "own", "n_seeds", "paid"),
    [
        ((), (), 3, ()),  # a plain grid: one look
        ((), (3, 4), 3, (3, 4)),
        ((3, 4, 5), (), 3, (3, 4, 5)),  # the same words as a plain grid
        ((3, 4, 5), (), 1, (3, 4, 5)),
        ((3, 5), (), 4, (3, 4, 5)),  # which looks where nobody has looked
        ((3, 4), (), 6, (3, 4, 6)),
        ((3, 4), (3, 5), 3, (3, 4, 5)),
    ],
)
def test_looks_once_taken_stay_paid_for(
    before: tuple[int, ...], own: tuple[int, ...], n_seeds: int, paid: tuple[int, ...]
) -> None:
    assert paid_looks(before, own, [*range(n_seeds), 0]) == paid


def test_a_grid_of_the_same_words_keeps_the_looks_and_says_so(
    sweeping: Callable[..., Ran], simulated: Path, tmp_path: Path
) -> None:
    """Its three seeds were judged before, at the error of the first of three looks."""
    sweeping(Finding(off))
    said: list[str] = []
    grid = small_sweep(simulated, tmp_path / "one", FIRST, "sweep.name=rounds")
    unseen = small_sweep(simulated, tmp_path / "two", FIRST, "sweep.name=rounds")
    told: list[list[str]] = [[], []]
    for prepared, lines in zip((grid, unseen), told, strict=True):
        preview(prepared.sweeper, InlineLauncher(), lines.append, spread=1.0)
    powers = [next(line for line in lines if "AP or more" in line) for lines in told]
    assert "or more by 5 seeds" in powers[0]  # three looks, of which the last is after five
    assert "or more by 3 seeds" in powers[1]
    run_sweep(grid, Finding(off), MemoryStore(grid.settings.store.root), said.append)
    assert read_plan(grid.layout.plan(grid.settings.experiment)).looks == (3, 4, 5)
    (line,) = [line for line in said if "stay paid for" in line]
    assert line.startswith("An earlier start judged these trials after 3, 4 and 5 seeds.")
    others = [[*point[:2], f"seed={10 + number}"] for number, point in enumerate(FIRST)]
    fresh = small_sweep(simulated, tmp_path / "one", others, "sweep.name=rounds")
    assert fresh.planner.looks == ()  # other trials, which nobody has looked at


@pytest.mark.parametrize(
    ("words", "rounds", "message"),
    [
        (["seed=0,1,2"], {}, "adds the seeds itself"),
        (["seed=range(0,5)"], {}, "adds the seeds itself"),
        (["detector=voxelnet", "loss.gamma=2"], {}, "sweep a key"),
        (["loss.gamma=interval(0,5)"], {}, "a grid needs values that can be listed"),
        ([], {"first": 2}, "a verdict needs at least 3 seeds"),
        ([], {"most": 2}, "less than the 3 seeds of the first round"),
        ([], {"step": 0}, r"step: 0 is not a whole number"),
        ([], {"hours": 0}, "hours of work above 0"),
    ],
)
def test_what_does_not_go_together_is_refused(
    words: list[str], rounds: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make(*words, **rounds)


def test_seeds_of_the_sweep_file_are_refused_too() -> None:
    with pytest.raises(ConfigError, match="adds the seeds itself"):
        make(params={**PARAMS, "seed": "0,1,2"})


def of_words(*words: str) -> UntilDecided:
    asked = multirun(["hydra/sweeper=until_decided", *words])
    sweeper = build(asked.sweeper, "sweeper").proposer(asked.arguments, asked.compose)
    assert isinstance(sweeper, UntilDecided)
    return sweeper


def test_it_goes_with_any_sweep_file_and_its_stages_are_those_of_a_grid_of_seeds(
    tmp_path: Path,
) -> None:
    places = ["+sweep=gamma", f"data.root={tmp_path}", f"store.root={tmp_path}"]
    said: list[str] = []
    sweeper = of_words(*places, "hydra.sweeper.most=5", "hydra.sweeper.hours=2")
    plan = preview(sweeper, InlineLauncher(), said.append)
    assert any("42 trials in 48 stages" in line for line in said)
    (rounds,) = [line for line in said if "This is the first round" in line]
    assert rounds.endswith("up to 5 seeds or 2 hours of work: 70 trials at most.")
    asked = multirun([*places, "seed=0,1,2"])
    grid = build(asked.sweeper, "sweeper").proposer(asked.arguments, asked.compose)
    assert set(preview(grid, InlineLauncher(), said.append).stages) == set(plan.stages)


def off(stage: Stage) -> float:
    """gamma = 1 is as good as the baseline, 2 finds nothing, 5 nothing under every second seed.

    So 1 is equivalent; 2 loses the same under all seeds, and the four frames are too few to be sure; 5 stays open.
    """
    gamma, seed = stage.config["loss"]["gamma"], stage.config["seed"]
    return 90.0 if gamma == 2 or (gamma == 5 and seed % 2) else 0.0


@pytest.fixture
def sweeping(simulated: Path, tmp_path: Path) -> Callable[..., Ran]:
    """Runs gamma = 0, 1, 2, 5 until decided, below a folder of its own or another."""

    def ran(launcher: Finding, place: str = "one", store: Any = None, **rounds: Any) -> Ran:
        def compose(overrides: Sequence[str]) -> Config:
            return small_config(simulated, tmp_path / place, *overrides)

        words = ["detector=voxelnet", "loss.gamma=0,1,2,5", "sweep.name=rounds"]
        sweeper = until_decided({}, words, compose, {**ROUNDS, "most": 5, **rounds})
        prepared = prepare_sweep(sweeper)
        store = store or MemoryStore(prepared.settings.store.root)
        found = run_sweep(prepared, launcher, store, say=lambda line: None)
        assert read_plan(prepared.layout.plan(prepared.settings.experiment)).trials
        return found

    return ran


FIRST = [  # what the first round trains of it
    ["detector=voxelnet", f"loss.gamma={gamma}", f"seed={seed}"]
    for gamma in (0, 1, 2, 5)
    for seed in range(3)
]


def names(ran: Ran) -> list[str]:
    return [f"{trial.level} {trial.seed}" for trial in ran.plan.trials]


def test_the_loop_trains_what_is_open_and_gains_says_the_same_afterwards(
    sweeping: Callable[..., Ran],
    simulated: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    config = small_config(simulated, tmp_path / "one", "sweep.name=rounds")
    store = open_store(tmp_path / "one" / "runs", None)
    ran = sweeping(Finding(off), store=store)
    first = [f"{level} {seed}" for level in (0, 1, 2, 5) for seed in (0, 1, 2)]
    assert names(ran) == [*first, "0 3", "5 3", "0 4", "5 4"]
    sweep = open_sweep(read_settings(config))
    assert sweep.plan.looks == (3, 4, 5)
    judged = judge_sweep(sweep).verdicts.set_index("level")
    assert list(judged["verdict"]) == ["baseline", "equivalent", "undecided", "undecided"]
    assert list(judged["seeds"]) == [5, 3, 3, 5]
    assert list(judged["open"]) == [False, False, False, True]
    told = capsys.readouterr().err
    assert all(gain_text(row) in told for row in judged[1:].to_dict("records"))


def test_a_sweep_that_was_killed_in_any_round_grows_in_the_same_way_again(
    sweeping: Callable[..., Ran],
) -> None:
    whole = sweeping(Finding(off), "whole")

    class Killed(Finding):
        def launch(self, folder: Path, after: Any = None) -> Any:
            if len(self.launched) == self.most:
                raise KeyboardInterrupt
            return super().launch(folder, after)

    n_stages = len(whole.plan.stages)
    trained: list[str] = []
    for most in (4, 5, 7, 99):  # in the first round, then at its end, in the second and the third
        launcher = Killed(off)
        launcher.most = most
        try:
            ran = sweeping(launcher)
        except KeyboardInterrupt:
            trained += launcher.launched
    trained += launcher.launched
    assert len(trained) == len(set(trained)) == n_stages  # nothing twice
    assert names(ran) == names(whole)
    assert [trial.key for trial in ran.plan.trials] == [trial.key for trial in whole.plan.trials]


def test_hours_count_the_work_of_earlier_starts(sweeping: Callable[..., Ran]) -> None:
    """15 stages of a minute first: three warm-ups and twelve trials; then 3 a round."""
    assert len(names(sweeping(Finding(off), hours=18.5 / 60))) == 14
    again = Finding(off)
    assert len(names(sweeping(again, hours=20.5 / 60))) == 14  # 18 are done, 21 would be too many
    assert again.launched == []
    assert len(names(sweeping(Finding(off), hours=21.5 / 60))) == 16


def test_a_later_start_that_looks_otherwise_pays_for_both(
    sweeping: Callable[..., Ran], simulated: Path, tmp_path: Path
) -> None:
    sweeping(Finding(off), most=4)
    sweeping(Finding(off), most=6, step=3)
    grid = small_sweep(simulated, tmp_path / "one", FIRST, "sweep.name=rounds")
    assert read_plan(grid.layout.plan(grid.settings.experiment)).looks == (3, 4, 6)


def test_a_larger_most_goes_on(sweeping: Callable[..., Ran]) -> None:
    sweeping(Finding(off), most=4)
    more = Finding(off)
    assert names(sweeping(more, most=5))[-2:] == ["0 4", "5 4"]
    assert len(more.launched) == 3


def test_a_stage_that_fails_leaves_its_pair_out_and_the_loop_goes_on(
    sweeping: Callable[..., Ran],
) -> None:
    def failing(stage: Stage) -> float:
        if (stage.name, stage.config["loss"]["gamma"], stage.config["seed"]) == ("focal", 2, 1):
            raise ValueError
        return off(stage)

    ran = sweeping(Finding(failing))
    assert len(ran.outcome.failed) == 1
    assert [name for name in names(ran) if name.startswith("2")] == ["2 0", "2 1", "2 2", "2 3"]


ODD = {
    "first": (None, "abc", 0, 1.5, True, 2, 50),
    "most": (None, "abc", 0, -1, 1.5, True, 2, 10**7, [1]),
    "step": (None, "abc", 0, 1.5, True),
    "hours": ("abc", 0, -1, True, float("nan"), float("inf"), [1]),
    "looks": ([3, 5],),
    "sampler": (None,),
}


@pytest.mark.parametrize(("key", "value"), [(k, v) for k, values in ODD.items() for v in values])
def test_an_odd_value_of_any_key_is_refused_by_name(key: str, value: object) -> None:
    with pytest.raises(
        ConfigError, match=r"^hydra\.sweeper\.(first|most|step|hours|looks|sampler): "
    ):
        rounds_of({key: value})


@pytest.mark.parametrize("sweeper", ["grid", "optuna", "until_decided"])
@pytest.mark.parametrize("params", ["null", "abc", "1"])
def test_params_that_are_no_mapping_are_refused_whatever_the_sweeper(
    sweeper: str, params: str
) -> None:
    words = [f"hydra/sweeper={sweeper}", f"hydra.sweeper.params={params}", "loss.gamma=0,2"]
    with pytest.raises(ConfigError, match=rf"hydra\.sweeper\.params: {params}, but it holds"):
        with_winners(multirun(words))


def test_a_swept_value_that_is_null_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"params: loss\.gamma: null says nothing"):
        check_params({"loss.gamma": None})
