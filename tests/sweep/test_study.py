"""Studies: search spaces, asking and telling, pruning, twins, and what a dead sweep leaves.

No network is trained.
"""

import re
from pathlib import Path

import optuna
import pytest
from optuna.distributions import CategoricalDistribution, FloatDistribution, IntDistribution

from fl3d.core.errors import ConfigError, StoreError
from fl3d.sweep.sweepers.base import Standing, TrialState
from fl3d.sweep.sweepers.space import in_hydras_grammar, parse_space
from fl3d.sweep.sweepers.study import Study, study
from fl3d.sweep.sweepers.study_storage import open_storage
from tests.sweep.studies import (
    AP,
    EASY,
    GAMMA,
    RANDOM,
    World,
    base,
    key,
    make,
    states,
    trial_of,
)

ASHA = {
    "_target_": "optuna.pruners.SuccessiveHalvingPruner",
    "min_resource": 1,
    "reduction_factor": 2,
}


@pytest.mark.parametrize(
    ("written", "expected"),
    [
        ("interval(0,5)", FloatDistribution(0, 5)),
        ("tag(log,interval(0.01,1))", FloatDistribution(0.01, 1, log=True)),
        ("int(interval(1,8))", IntDistribution(1, 8)),
        ("range(0,10,2)", IntDistribution(0, 8, step=2)),
        ("range(0.0,1.0,0.25)", FloatDistribution(0, 0.75, step=0.25)),
        ("choice(a,b)", CategoricalDistribution(["a", "b"])),
        ("0.5,1,2", CategoricalDistribution([0.5, 1, 2])),
    ],
)
def test_hydras_grammar_as_optunas_distributions(written: str, expected: object) -> None:
    assert parse_space({"x": written}, []).axes == {"x": expected}


def test_the_command_line_replaces_and_fixes_axes() -> None:
    space = parse_space(
        {"a": "interval(0,1)", "b": "1,2"}, ["b=3", "c=interval(2,4)", "detector=fcn3d"]
    )
    assert list(space.axes) == ["a", "c"]
    assert space.fixed == ("b=3", "detector=fcn3d")
    with pytest.raises(ConfigError, match="nothing to search"):
        parse_space({}, ["detector=fcn3d"])


def test_values_are_told_and_the_number_of_trials_is_kept(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=6)
    world = World(study, slots=2)
    world.run()
    trials = study.study.get_trials()
    assert [trial.state.name for trial in trials] == ["COMPLETE"] * 6
    for trial in trials:
        assert trial.values == [pytest.approx(54 - trial.params["loss.gamma"])]
    assert study.study.best_trial.params["loss.gamma"] == min(
        t.params["loss.gamma"] for t in trials
    )


def test_no_more_trials_run_than_there_are_slots(tmp_path: Path) -> None:
    world = World(make(tmp_path, n_trials=9), slots=3)
    for _ in range(30):
        world.tick()
        running = [one for one in world.standings.values() if one.state is TrialState.RUNNING]
        assert len(running) <= 3


def test_the_worse_half_is_pruned_and_saves_epochs(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=12, pruner=ASHA)
    world = World(study, slots=2)
    world.run()
    pruned = [t for t in study.study.get_trials() if t.state.name == "PRUNED"]
    assert len(pruned) >= 4
    assert len(world.trained) < 12 * world.epochs * 0.75
    gammas = [trial.params["loss.gamma"] for trial in study.study.get_trials()]
    assert study.study.best_trial.params["loss.gamma"] == min(gammas)


def test_equal_points_are_trained_once_and_told_alike(tmp_path: Path) -> None:
    study = make(tmp_path, {"loss.gamma": "choice(1,2)"}, n_trials=10)
    world = World(study, slots=2)
    world.run()
    assert states(study) == ["COMPLETE"] * 10
    assert len(world.trained) == 2 * world.epochs
    told = {(trial.params["loss.gamma"], trial.values[0]) for trial in study.study.get_trials()}
    assert told == {(1, 53.0), (2, 52.0)}
    assert study.report(world.standings, tmp_path).count("\n| ") == 1 + 2


def test_enqueued_points_are_asked_first_and_once(tmp_path: Path) -> None:
    for _ in range(2):
        study = make(tmp_path, n_trials=3, enqueue=[{"loss.gamma": 0}])
        World(study, slots=1).run()
    gammas = [trial.params["loss.gamma"] for trial in study.study.get_trials()]
    assert gammas[0] == 0
    assert len(gammas) == len(set(gammas)) == 3
    with pytest.raises(ConfigError, match="does not name exactly"):
        make(tmp_path, enqueue=[{"gamma": 0}])


def test_what_a_dead_sweep_left_running_is_failed_and_asked_again(tmp_path: Path) -> None:
    first = make(tmp_path, n_trials=4)
    world = World(first, slots=2)
    for _ in range(3):
        world.tick()
    left = [dict(t.params) for t in first.study.get_trials() if t.state.name == "RUNNING"]
    assert len(left) == 2
    second = make(tmp_path, n_trials=4)
    World(second, slots=2).run()
    trials = second.study.get_trials()
    assert states(second).count("FAIL") == 2
    assert states(second).count("COMPLETE") == 4
    complete = [trial.params for trial in trials if trial.state.name == "COMPLETE"]
    assert all(params in complete for params in left)


def test_started_again_it_takes_up_what_was_told_and_trains_none_of_it(tmp_path: Path) -> None:
    World(make(tmp_path, n_trials=8, pruner=ASHA), slots=2).run()
    study = make(tmp_path, n_trials=8, pruner=ASHA)
    advice = study.advise({}, 2)
    told = {f"loss.gamma={t.params['loss.gamma']}": t.state.name for t in study.study.get_trials()}
    assert len(told) == 8
    assert {key(point) for point in advice.points} == set(told)
    assert set(advice.stop) == {name for name, state in told.items() if state == "PRUNED"}
    assert study.advise({}, 2).points == []  # once


def test_a_study_that_is_resumed_does_not_repeat_its_first_proposals(tmp_path: Path) -> None:
    World(make(tmp_path, n_trials=3), slots=1).run()
    study = make(tmp_path, n_trials=6)
    World(study, slots=1).run()
    assert len({t.params["loss.gamma"] for t in study.study.get_trials()}) == 6


def test_it_stops_asking_when_all_fail(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=20)
    standings: dict[str, Standing] = {}
    for _ in range(30):
        for point in study.advise(standings, 1).points:
            trial = trial_of(point)
            standings[trial.key] = Standing(trial, TrialState.FAILED, {}, 4)
    assert states(study) == ["FAIL"] * 3


def test_several_objectives_give_a_pareto_front(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=5, objectives=[AP, EASY])
    world = World(study, slots=2)
    world.run()
    text = study.report(world.standings, tmp_path / "results")
    assert "Pareto front by ap_3d_r40/moderate, ap_3d_r40/easy" in text
    # What one loses in the one, one gains in the other: all are on the front.
    assert text.count("\n| ") == 1 + 5
    table = tmp_path / "results" / "tables" / "study_search.csv"
    assert table.read_text().count("complete") == 5


def test_settings_that_do_not_go_together_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="prunes on one objective"):
        make(tmp_path, objectives=[AP, EASY], pruner=ASHA)
    with pytest.raises(ConfigError, match="Did you mean 'ap_3d/moderate'"):
        make(tmp_path, objectives=["ap_3d/modrate"])
    with pytest.raises(ConfigError, match="Did you mean 'last'"):
        make(tmp_path, rule="lost")
    with pytest.raises(ConfigError, match="tables are made of a grid"):
        Study(base(tmp_path, "sweep.tables=[II]"), parse_space(GAMMA, []), lambda overrides: {})


def test_a_study_of_other_objectives_or_data_is_not_continued(tmp_path: Path) -> None:
    World(make(tmp_path, n_trials=1), slots=1).run()
    with pytest.raises(
        ConfigError, match="objectives: the study 'search-made-up-tiny' was begun with"
    ):
        make(tmp_path, objectives=[EASY])
    with pytest.raises(ConfigError, match="rule: the study"):
        make(tmp_path, rule="best")
    with pytest.raises(ConfigError, match="begun with another space"):
        make(tmp_path, {"loss.gamma": "interval(0,5)", "seed": "choice(0,1)"})
    study = Study(base(tmp_path), parse_space(GAMMA, []), lambda overrides: {}, sampler=RANDOM)
    with pytest.raises(ConfigError, match="other data, versions or settings"):
        study.open(lambda point: "another identity")


def test_a_failed_trial_counts_and_is_not_told_to_its_twin(tmp_path: Path) -> None:
    """The same point, proposed again, is asked for again."""
    study = make(tmp_path, {"loss.gamma": "choice(1)"}, n_trials=2)
    (point,) = study.advise({}, 1).points
    failed = Standing(trial_of(point), TrialState.FAILED, {}, 4)
    study.advise({key(point): failed}, 1)
    assert states(study) == ["FAIL", "RUNNING"]


def test_a_trial_that_was_stopped_by_others_is_told_as_pruned(tmp_path: Path) -> None:
    study = make(tmp_path, n_trials=1)
    (point,) = study.advise({}, 1).points
    study.advise({key(point): Standing(trial_of(point), TrialState.STOPPED, {}, 4)}, 1)
    assert states(study) == ["PRUNED"]


@pytest.mark.parametrize(("rule", "value"), [("last", 40.0), ("best", 60.0)])
def test_whose_value_counts_is_as_the_rule_says(tmp_path: Path, rule: str, value: float) -> None:
    study = make(tmp_path, n_trials=1, rule=rule)
    (point,) = study.advise({}, 1).points
    curve = {1: {AP: 50.0}, 2: {AP: 60.0}, 3: {AP: 40.0}}
    study.advise({key(point): Standing(trial_of(point), TrialState.DONE, curve, 3)}, 1)
    assert study.study.best_trial.values == [value]


@pytest.mark.parametrize(
    ("written", "value"),
    [
        ("choice(2)", 2),
        ("choice(0.5)", 0.5),
        ("choice(true)", True),
        ("choice(abc)", "abc"),
        ("choice('a, b')", "a, b"),
        ("choice([1,2])", [1, 2]),
        ("choice({search:2.0,bin:0.2})", {"search": 2.0, "bin": 0.2}),
    ],
)
def test_a_point_has_the_values_that_a_grid_of_it_would_have(
    tmp_path: Path, written: str, value: object
) -> None:
    """Optuna itself keeps lists and mappings as texts."""
    study = make(tmp_path, {"+a.b": written}, n_trials=1)
    (point,) = study.advise({}, 1).points
    assert point.values == {"a.b": value}
    assert study.swept == ("a.b",)


def test_mlflows_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="is MLflow's database"):
        open_storage("postgresql://h/db", tmp_path, "postgresql+psycopg2://h/db", "name")
    with pytest.raises(StoreError, match="is MLflow's database"):
        open_storage(f"sqlite:///{tmp_path}/mlflow.db", tmp_path, None, "name")


def test_the_journal_opens_as_any_optuna_study(tmp_path: Path) -> None:
    """As optuna-dashboard and a user's own notebook open it."""
    World(make(tmp_path, n_trials=2), slots=1).run()
    storage = open_storage(None, tmp_path, None, "search-made-up-tiny")
    study = optuna.load_study(study_name="search-made-up-tiny", storage=storage)
    assert len(study.trials) == 2


def test_another_sweepers_keys_are_refused_by_name(tmp_path: Path) -> None:
    """As where a file that names its own sweeper is run with hydra/sweeper=until_decided."""
    with pytest.raises(
        ConfigError, match=r"hydra\.sweeper\.first: a study has no such key.*n_trials"
    ):
        study({}, ["loss.gamma=interval(0,1)"], lambda words: base(tmp_path), {"first": 3})


ODD = {
    "n_trials": (None, "ten", 0, -1, 1.5, True, [1]),
    "objectives": (None, "abc", [], [1], AP, ["nothing"], [AP, AP]),
    "rule": (None, "lost", 1, ["last"]),
    "sampler": ("TPESampler", 1, {}, {"a": 1}, {"_target_": 5}),
    "pruner": ("MedianPruner", 1, {}, {"_target_": "optuna.samplers.RandomSampler"}),
    "storage": ("study.db", 1, "", []),
    "study_name": ("a/b", "../x", ".x", "", "a" * 250, [], True, "a\nb"),
    "enqueue": (None, "abc", 1, {"a": 1}, [1], [{"loss.gamma": 9}], [{"loss.gamma": "abc"}]),
}


@pytest.mark.parametrize(("name", "value"), [(k, v) for k, values in ODD.items() for v in values])
def test_an_odd_value_of_any_key_is_refused_by_name(
    tmp_path: Path, name: str, value: object
) -> None:
    with pytest.raises(ConfigError, match=rf"^hydra\.sweeper\.{name}: "):
        make(tmp_path, **{name: value})
    assert not (tmp_path / "studies").exists()


def test_a_pruner_that_refuses_its_arguments_is_named(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"hydra\.sweeper\.pruner: .*min_resource"):
        make(tmp_path, pruner=ASHA | {"min_resource": 0})


def test_a_number_may_name_a_study(tmp_path: Path) -> None:
    assert make(tmp_path, study_name=7).study.study_name == "7"


@pytest.mark.parametrize(
    ("written", "says"),
    [
        ("range(0,0)", "it holds no value"),
        ("range(5,0)", "it holds no value"),
        ("range(5,0,-1)", "its step is -1"),
        ("range(0,5,0)", "its step is 0"),
        ("interval(0,inf)", "two numbers"),
        ("interval(nan,1)", "two numbers"),
        ("interval(5,0)", "low <= high"),
        ("tag(log,interval(0,1))", "low > 0"),
        ("glob(*)", "not a search space"),
    ],
)
def test_a_space_without_a_value_is_refused_by_what_was_typed(written: str, says: str) -> None:
    with pytest.raises(ConfigError, match=rf"'x={re.escape(written)}': .*{says}"):
        parse_space({"x": written}, [])


@pytest.mark.parametrize(
    "written",
    [
        "interval(0,5)",
        "interval(0.00001,0.123456789)",
        "tag(log,interval(0.01,1))",
        "int(interval(1,8))",
        "int(tag(log,interval(1,8)))",
        "range(0,10,2)",
        "range(0.0,1.0,0.25)",
        "choice(a,b)",
        "choice(0.5,1,2)",
    ],
)
def test_an_axis_is_described_as_it_can_be_typed(written: str) -> None:
    axis = parse_space({"x": written}, []).axes["x"]
    assert parse_space({"x": in_hydras_grammar(axis)}, []).axes["x"] == axis
