"""Every sampler of Optuna proposes, ends, and goes on where a study stopped. No network is trained."""

import sys
from pathlib import Path
from typing import Any

import optuna
import pytest

from fl3d.core.errors import ConfigError
from fl3d.sweep.sweepers.base import Standing, TrialState
from fl3d.sweep.sweepers.samplers import Samplers
from fl3d.sweep.sweepers.space import parse_space
from fl3d.sweep.sweepers.study import Study
from tests.sweep.studies import AP, EASY, World, make, states, trial_of

FLOATS = {"a": "interval(0,5)", "b": "interval(-1,1)"}
FINITE = {"a": "range(0,2)", "b": "choice(0,1)"}  # four points


def sampler(name: str, **settings: Any) -> dict[str, Any]:
    return {"_target_": f"optuna.samplers.{name}", "seed": 3, **settings}


# What each is tried with: its section, a space and the trials that are asked for.
SAMPLERS: dict[str, tuple[dict[str, Any], dict[str, object], int]] = {
    "TPESampler": (sampler("TPESampler", n_startup_trials=2), FLOATS, 6),
    "RandomSampler": (sampler("RandomSampler"), FLOATS, 6),
    "GPSampler": (sampler("GPSampler", n_startup_trials=2), FLOATS, 4),
    "CmaEsSampler": (sampler("CmaEsSampler"), FLOATS, 6),
    "QMCSampler": (sampler("QMCSampler"), FLOATS, 6),
    "NSGAIISampler": (sampler("NSGAIISampler", population_size=2), FLOATS, 6),
    "NSGAIIISampler": (sampler("NSGAIIISampler", population_size=2), FLOATS, 6),
    "GridSampler": (sampler("GridSampler"), FINITE, 4),
    "BruteForceSampler": (sampler("BruteForceSampler"), FINITE, 4),
    "PartialFixedSampler": (
        sampler("PartialFixedSampler", fixed_params={"b": 0}, base_sampler=sampler("TPESampler")),
        {"a": "interval(0,5)", "b": "interval(-1,1)"},
        6,
    ),
}
EXHAUSTIVE = ("GridSampler", "BruteForceSampler")


def distinct(study: Study) -> set[str]:
    """Points of the trials that are done: a genetic algorithm may propose one twice."""
    done = (trial for trial in study.study.get_trials() if trial.state.name == "COMPLETE")
    return {f"a={trial.params['a']} b={trial.params['b']}" for trial in done}


@pytest.fixture(params=SAMPLERS)
def name(request: pytest.FixtureRequest) -> str:
    if request.param == "CmaEsSampler":
        pytest.importorskip("cmaes")
    return str(request.param)


def test_every_sampler_of_optuna_is_tried_here() -> None:
    every = {name for name in optuna.samplers.__all__ if name.endswith("Sampler")}
    assert set(SAMPLERS) == every - {"BaseSampler", "BaseGASampler"}


@pytest.mark.parametrize("slots", [1, 2])
def test_a_sampler_proposes_as_many_points_as_are_asked_for(
    tmp_path: Path, name: str, slots: int
) -> None:
    section, params, n_trials = SAMPLERS[name]
    study = make(tmp_path, params, sampler=section, n_trials=n_trials)
    world = World(study, slots, epochs=1).run(30)
    assert states(study) == ["COMPLETE"] * n_trials
    assert set(world.standings) == distinct(study)
    assert len(world.standings) >= n_trials - 1
    assert study.report(world.standings, tmp_path / "out")
    assert (tmp_path / "out" / "tables" / "study_search.csv").exists()


def test_a_sampler_goes_on_where_the_study_was_interrupted(tmp_path: Path, name: str) -> None:
    """Two trials are in training when the sweep dies; the next start has all done, and none twice."""
    section, params, n_trials = SAMPLERS[name]
    settings = {"sampler": section, "n_trials": n_trials}
    World(make(tmp_path, params, **settings), slots=2, epochs=2).run(4)
    study = make(tmp_path, params, **settings)
    assert 2 <= sum(state in ("COMPLETE", "RUNNING", "FAIL") for state in states(study)) < 6
    world = World(study, slots=2, epochs=2).run(40)
    assert states(study).count("COMPLETE") == n_trials
    assert set(states(study)) <= {"COMPLETE", "FAIL"}
    assert set(world.standings) == distinct(study)
    assert len(world.trained) <= 2 * n_trials
    assert study.report(world.standings, tmp_path / "out")


def test_a_sampler_that_was_started_again_at_its_end_asks_for_nothing(
    tmp_path: Path, name: str
) -> None:
    section, params, n_trials = SAMPLERS[name]
    settings = {"sampler": section, "n_trials": n_trials}
    World(make(tmp_path, params, **settings), slots=2, epochs=1).run(30)
    study = make(tmp_path, params, **settings)
    world = World(study, slots=2, epochs=1)
    world.tick()
    assert set(world.standings) == distinct(study)  # they belong to the sweep
    assert world.trained == []
    assert states(study) == ["COMPLETE"] * n_trials


@pytest.mark.parametrize("name", EXHAUSTIVE)
def test_a_finite_space_ends_before_the_number_of_trials(tmp_path: Path, name: str) -> None:
    for _ in range(2):  # and again when it is started again
        study = make(tmp_path, FINITE, sampler=sampler(name), n_trials=20)
        world = World(study, slots=3, epochs=1).run(30)
        assert states(study) == ["COMPLETE"] * 4
        assert {tuple(one.split()) for one in world.standings} == {
            (f"a={a}", f"b={b}") for a in (0, 1) for b in (0, 1)
        }
        assert "All 4 points were asked for" in study.report(world.standings, tmp_path)


@pytest.mark.parametrize("name", EXHAUSTIVE)
@pytest.mark.parametrize("ticks", [1, 2, 3, 4, 5])
def test_a_finite_space_is_whole_after_an_interruption_whenever(
    tmp_path: Path, name: str, ticks: int
) -> None:
    settings = {"sampler": sampler(name), "n_trials": 20}
    World(make(tmp_path, FINITE, **settings), slots=2, epochs=2).run(ticks)
    settings["sampler"] = sampler(name) | {"seed": 8}  # another order
    study = make(tmp_path, FINITE, **settings)
    world = World(study, slots=2, epochs=2).run(40)
    assert len(world.standings) == 4
    assert set(states(study)) == {"COMPLETE"}
    assert len(states(study)) == 4


@pytest.mark.parametrize("name", EXHAUSTIVE)
def test_a_point_of_a_finite_space_that_failed_is_tried_again_at_the_next_start(
    tmp_path: Path, name: str
) -> None:
    settings = {"sampler": sampler(name), "n_trials": 20}
    study = make(tmp_path, FINITE, **settings)
    (point,) = study.advise({}, 1).points
    failed = trial_of(point)
    study.advise({failed.key: Standing(failed, TrialState.FAILED, {}, 1)}, 0)
    study = make(tmp_path, FINITE, **settings)
    world = World(study, slots=2, epochs=1).run(30)
    assert len(world.standings) == 4
    assert sorted(states(study)) == ["COMPLETE"] * 4 + ["FAIL"]


@pytest.mark.parametrize("name", EXHAUSTIVE)
def test_a_baseline_that_is_asked_first_is_no_second_point(tmp_path: Path, name: str) -> None:
    settings = {"sampler": sampler(name), "n_trials": 20, "enqueue": [{"a": 1, "b": 1}]}
    study = make(tmp_path, FINITE, **settings)
    world = World(study, slots=2, epochs=1).run(30)
    assert next(iter(world.standings)) == "a=1 b=1"
    assert len(world.standings) == 4


def test_a_grid_may_be_named_point_by_point(tmp_path: Path) -> None:
    grid = {"a": [0, 2.5], "b": [-1, 0, 1]}
    section = sampler("GridSampler", search_space=grid)
    study = make(tmp_path, FLOATS, sampler=section)
    world = World(study, slots=4, epochs=1).run(30)
    assert set(world.standings) == {f"a={a} b={b}" for a in (0.0, 2.5) for b in (-1.0, 0.0, 1.0)}


def test_brute_force_with_a_fixed_value_goes_through_the_others(tmp_path: Path) -> None:
    section = sampler(
        "PartialFixedSampler", fixed_params={"b": 1}, base_sampler=sampler("BruteForceSampler")
    )
    study = make(tmp_path, {"a": "range(0,3)", "b": "choice(0,1)"}, sampler=section)
    world = World(study, slots=2, epochs=1).run(30)
    assert set(world.standings) == {"a=0 b=1", "a=1 b=1", "a=2 b=1"}


def test_a_sampler_whose_package_is_absent_is_refused_by_name(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    monkeypatch.setattr("optuna.samplers._cmaes.cmaes", optuna._imports._LazyImport("cmaes"))
    axes = parse_space(FLOATS, []).axes
    with pytest.raises(ConfigError, match=r"CmaEsSampler needs a package.*pip install cmaes"):
        Samplers(sampler("CmaEsSampler"), axes).rehearse(["maximize"], optuna.pruners.NopPruner())


@pytest.mark.parametrize(
    ("section", "params", "says"),
    [
        ("TPESampler", FLOATS, "sampler: TPESampler names no class"),
        ({"seed": 0}, FLOATS, "names no class"),
        (sampler("NoSampler"), FLOATS, "NoSampler"),
        ({"_target_": "optuna.pruners.NopPruner"}, FLOATS, "none of Optuna's samplers"),
        (sampler("RandomSampler") | {"seed": "abc"}, FLOATS, "sampler.seed: abc"),
        (sampler("RandomSampler") | {"seed": -1}, FLOATS, "sampler.seed: -1"),
        (sampler("RandomSampler") | {"seed": 1.5}, FLOATS, "sampler.seed: 1.5"),
        (sampler("RandomSampler", colour=3), FLOATS, "colour"),
        (sampler("TPESampler", n_startup_trials=-1, gamma=3), FLOATS, "TPESampler"),
        (sampler("NSGAIISampler", population_size=1), FLOATS, "population_size"),
        (sampler("GridSampler"), FLOATS, r"a=interval\(0,5\) has no end of values"),
        (sampler("GridSampler", search_space={"a": [1]}), FLOATS, "each of a, b"),
        (sampler("GridSampler", search_space={"a": [9], "b": [0]}), FLOATS, "a=9 is outside"),
        (sampler("GridSampler", search_space={"a": 1, "b": [0]}), FLOATS, "1 is no list"),
        (sampler("BruteForceSampler"), FLOATS, "has no end of them"),
        (sampler("PartialFixedSampler", fixed_params={}), FLOATS, "base_sampler"),
        (
            sampler(
                "PartialFixedSampler", fixed_params={"c": 1}, base_sampler=sampler("TPESampler")
            ),
            FLOATS,
            "c is not searched; those are a, b",
        ),
    ],
)
def test_a_sampler_that_cannot_search_is_refused_before_the_study_is_made(
    tmp_path: Path, section: Any, params: dict[str, object], says: str
) -> None:
    with pytest.raises(ConfigError, match=says):
        make(tmp_path, params, sampler=section)
    assert not (tmp_path / "studies").exists()


def test_several_objectives_with_a_sampler_for_one_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"hydra\.sweeper\.sampler: CmaEsSampler"):
        make(tmp_path, FLOATS, sampler=sampler("CmaEsSampler"), objectives=[AP, EASY])
