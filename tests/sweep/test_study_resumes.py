"""What interrupted starts, other sweeps and changed settings leave in a study. No network is trained."""

import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import optuna
import pytest

from fl3d.core.errors import ConfigError
from fl3d.core.leases import leased
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.sweepers.base import Evidence, Point
from fl3d.sweep.sweepers.space import parse_space
from fl3d.sweep.sweepers.study import ROOT, SWEEP, Study
from fl3d.sweep.sweepers.study_report import KEY
from fl3d.sweep.sweepers.study_storage import open_storage
from tests.sweep.studies import GAMMA, NAME, RANDOM, World, base, key, make, states

BRUTE = {"_target_": "optuna.samplers.BruteForceSampler", "seed": 0}
SIX = {"a": "range(0,3)", "b": "choice(0,1)"}


def optunas(root: Path) -> optuna.Study:
    """The study as anybody else's program opens it."""
    return optuna.load_study(study_name=NAME, storage=open_storage(None, root, None, NAME))


class Killed(BaseException):
    """Stands for a signal between two lines of the journal."""


def killed_at(study: Study, line: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a study ask until it is killed before it writes a line: nothing of it is written any more."""
    backend = study.study._storage._backend  # type: ignore[attr-defined]
    write, written = backend.append_logs, [0]

    def append(logs: list[dict[str, Any]]) -> None:
        if written[0] >= line:
            raise Killed
        written[0] += 1
        write(logs)

    monkeypatch.setattr(backend, "append_logs", append)
    try:
        World(study, slots=1, epochs=1).run(4)
    except Killed:
        return
    pytest.fail("it was not killed")


@pytest.mark.parametrize("line", range(13))
@pytest.mark.parametrize(("sampler", "params"), [(RANDOM, GAMMA), (BRUTE, SIX)])
def test_killed_before_any_line_of_the_journal_three_asked_are_three_done(
    tmp_path: Path,
    line: int,
    sampler: dict[str, Any],
    params: dict[str, object],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    settings = {"sampler": sampler, "n_trials": 3}
    killed_at(make(tmp_path, params, **settings), line, monkeypatch)
    study = make(tmp_path, params, **settings)
    world = World(study, slots=2, epochs=1).run(30)
    assert states(study).count("COMPLETE") == 3
    assert set(states(study)) <= {"COMPLETE", "FAIL"}
    assert len(world.standings) == 3


@pytest.mark.parametrize("error", [ConfigError("no"), ValueError("no"), KeyboardInterrupt()])
def test_an_error_between_asking_and_identity_leaves_nothing_that_counts(
    tmp_path: Path, error: BaseException
) -> None:
    study = make(tmp_path, n_trials=3)

    def identify(_: Point) -> str:
        raise error

    identified, study._identify = study._identify, identify
    with pytest.raises(type(error)):
        study.advise({}, 1)
    assert states(study) == ["FAIL"]
    study._identify = identified
    World(study, slots=1, epochs=1).run(30)
    assert sorted(states(study)) == ["COMPLETE"] * 3 + ["FAIL"]


def test_a_trial_without_the_stores_attributes_is_taken_for_dead(tmp_path: Path) -> None:
    """As earlier versions left them: with its point, with a part of it, and without."""
    params = {"a": "interval(0,1)", "b": "interval(0,1)"}
    make(tmp_path, params, n_trials=3)
    axes = parse_space(params, []).axes
    for asked in (axes, {"a": axes["a"]}, {}):
        optunas(tmp_path).ask(asked)  # type: ignore[arg-type]
    study = make(tmp_path, params, n_trials=3)
    World(study, slots=2, epochs=1).run(30)
    assert states(study).count("COMPLETE") == 3
    assert "RUNNING" not in states(study)


def test_what_was_left_is_said(tmp_path: Path) -> None:
    World(make(tmp_path), slots=2).run(2)
    study = make(tmp_path)
    said: list[str] = []

    class Listening(Evidence):
        say = staticmethod(said.append)  # type: ignore[assignment]
        verdicts = work = None  # type: ignore[assignment]

    study.consult(Listening())
    assert said == [
        f"The study '{NAME}' had 2 trials that an interrupted start left running: asked for again."
    ]


def other(root: Path, **settings: Any) -> Study:
    """Another sweep that asks the same study."""
    study = Study(
        base(root, "sweep.name=other"),
        parse_space(GAMMA, []),
        lambda overrides: {"overrides": list(overrides)},
        **{"sampler": RANDOM | {"seed": 5}, "study_name": NAME, **settings},
    )
    study.open(key)
    return study


def test_two_sweeps_of_one_study_leave_each_others_trials_alone(tmp_path: Path) -> None:
    lease = StoreFolder(tmp_path).lease(NAME)  # as ``run_sweep`` holds it
    with leased(lease):
        first = World(make(tmp_path, n_trials=6), slots=2, epochs=3)
        first.run(2)
        second = World(other(tmp_path, n_trials=6), slots=2, epochs=3)
        assert states(second.study) == ["RUNNING"] * 2
        for _ in range(30):
            first.tick()
            second.tick()
        assert states(second.study) == ["COMPLETE"] * 6
        assert len(first.trained) + len(second.trained) == 6 * 3


def test_trials_of_a_sweep_that_died_are_asked_again_by_another(tmp_path: Path) -> None:
    World(make(tmp_path, n_trials=4), slots=2).run(2)
    study = other(tmp_path, n_trials=4)
    World(study, slots=2).run(40)
    assert sorted(states(study)) == ["COMPLETE"] * 4 + ["FAIL"] * 2


def test_trials_of_another_store_are_left_alone(tmp_path: Path) -> None:
    url = f"sqlite:///{tmp_path}/shared.db"
    first = make(tmp_path / "one", n_trials=5, storage=url)
    World(first, slots=2).run(2)
    second = make(tmp_path / "two", n_trials=5, storage=url)
    World(second, slots=1).run(40)
    assert sorted(states(second)) == ["COMPLETE"] * 3 + ["RUNNING"] * 2
    again = make(tmp_path / "one", n_trials=5, storage=url)
    World(again, slots=2).run(40)
    assert sorted(states(again)) == ["COMPLETE"] * 5 + ["FAIL"] * 2


def test_two_that_ask_at_one_moment_do_not_ask_too_many(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Both have seen that one more is wanted."""
    with leased(StoreFolder(tmp_path).lease(NAME)):
        first, second = make(tmp_path, n_trials=1), other(tmp_path, n_trials=1)
        may, answers = second._may_ask, iter([True])
        monkeypatch.setattr(second, "_may_ask", lambda: next(answers, may()))
        assert len(first.advise({}, 1).points) == 1
        assert list(second.advise({}, 1).points) == []
    assert states(first) == ["RUNNING", "FAIL"]


def test_a_trial_that_somebody_else_told_keeps_that(tmp_path: Path) -> None:
    """As by optuna-dashboard, or a notebook."""
    study = make(tmp_path, n_trials=2)
    world = World(study, slots=1, epochs=2).run(2)
    optunas(tmp_path).tell(0, 12.0)
    for _ in range(20):
        world.tick()
    assert study.study.get_trials()[0].values == [12.0]
    assert states(study) == ["COMPLETE"] * 2


@pytest.mark.parametrize(
    ("before", "now", "says"),
    [
        ("choice(0,1)", "choice(0,1,2)", "x was choice(0,1) and is choice(0,1,2)"),
        ("choice(0,1)", "choice(1,0)", "x was choice(0,1) and is choice(1,0)"),
        ("interval(1,5)", "tag(log,interval(1,5))", "x was interval(1,5) and is tag(log"),
        ("interval(1,5)", "int(interval(1,5))", "is int(interval(1,5))"),
        ("interval(1,5)", "choice(1,5)", "is choice(1,5)"),
        ("int(interval(1,5))", "range(0.5,2.5,0.5)", "is range(0.5,2.5,0.5)"),
    ],
)
def test_a_changed_space_is_refused_by_what_was_and_what_is(
    tmp_path: Path, before: str, now: str, says: str
) -> None:
    World(make(tmp_path, {"x": before}, n_trials=1), slots=1, epochs=1).run(5)
    settings = {"n_trials": 3}
    with pytest.raises(ConfigError, match=rf"another space: .*{re.escape(says)}.*study_name"):
        make(tmp_path, {"x": now}, **settings)
    assert [trial.state.name for trial in optunas(tmp_path).trials] == ["COMPLETE"]
    study = make(tmp_path, {"x": now}, study_name="anew", **settings)
    World(study, slots=1, epochs=1).run(30)
    assert states(study) == ["COMPLETE"] * 3
    study = make(tmp_path, {"x": before}, **settings)  # nothing was lost
    World(study, slots=1, epochs=1).run(30)
    assert states(study) == ["COMPLETE"] * 3


def test_other_keys_are_refused_by_name(tmp_path: Path) -> None:
    World(make(tmp_path, n_trials=1), slots=1, epochs=1).run(5)
    with pytest.raises(
        ConfigError, match=r"another space: it searched loss\.gamma, and this one loss\.gamma, seed"
    ):
        make(tmp_path, {**GAMMA, "seed": "choice(0,1)"})


@pytest.mark.parametrize(
    ("name", "before", "now"),
    [
        ("TPESampler", "interval(0,5)", "interval(0,2)"),
        ("TPESampler", "range(0,6,2)", "range(0,9)"),
        ("GPSampler", "interval(0,5)", "interval(0,2)"),
        ("NSGAIISampler", "interval(0,2)", "interval(-1,9)"),
        ("QMCSampler", "tag(log,interval(1,5))", "tag(log,interval(0.1,50))"),
    ],
)
def test_bounds_and_steps_may_change(tmp_path: Path, before: str, now: str, name: str) -> None:
    sampler = {"_target_": f"optuna.samplers.{name}", "seed": 0}
    if name in ("TPESampler", "GPSampler"):
        sampler["n_startup_trials"] = 2
    World(make(tmp_path, {"x": before}, sampler=sampler, n_trials=3), slots=1, epochs=1).run(8)
    study = make(tmp_path, {"x": now}, sampler=sampler, n_trials=6)
    World(study, slots=2, epochs=1).run(30)
    assert states(study) == ["COMPLETE"] * 6
    axis = parse_space({"x": now}, []).axes["x"]
    last = [trial.params["x"] for trial in study.study.get_trials()[3:]]
    assert all(axis.low <= value <= axis.high for value in last)  # type: ignore[attr-defined]


def test_bounds_of_a_space_that_is_gone_through_may_not(tmp_path: Path) -> None:
    World(make(tmp_path, SIX, sampler=BRUTE, n_trials=2), slots=1, epochs=1).run(8)
    with pytest.raises(
        ConfigError, match=r"a was int\(interval\(0,2\)\) and is int\(interval\(0,3\)\)"
    ):
        make(tmp_path, {**SIX, "a": "range(0,4)"}, sampler=BRUTE)


def test_axes_in_another_order_are_the_same_space(tmp_path: Path) -> None:
    World(make(tmp_path, SIX, sampler=BRUTE), slots=1, epochs=1).run(3)
    study = make(tmp_path, dict(reversed(SIX.items())), sampler=BRUTE)
    world = World(study, slots=2, epochs=1).run(30)
    assert len(world.standings) == 6


def test_a_waiting_point_outside_of_the_space_is_left_out_and_said(tmp_path: Path) -> None:
    make(tmp_path, {"x": "choice(0,1)"})
    optunas(tmp_path).enqueue_trial({"x": 7})
    study = make(tmp_path, {"x": "choice(0,1)"}, n_trials=2)
    World(study, slots=1, epochs=1).run(8)
    assert sorted(states(study)) == ["COMPLETE", "COMPLETE", "FAIL"]
    assert any("x=7, which is outside of choice(0,1)" in note for note in study._notes)


def test_a_value_that_would_be_refused_is_refused_before_the_study_is_made(tmp_path: Path) -> None:
    def identify(point: Point) -> str:
        value = point.values["schedule.batch_size"]
        if not isinstance(value, int):
            raise ConfigError(f"schedule.batch_size: {value} is not a whole number of at least 1")
        return key(point)

    def begin(written: str) -> Study:
        study = Study(
            base(tmp_path),
            parse_space({"schedule.batch_size": written}, []),
            lambda overrides: {},
            sampler=RANDOM,
            n_trials=2,
        )
        study.open(identify)
        return study

    with pytest.raises(ConfigError, match=r"give 'schedule\.batch_size=int\(interval\(1,4\)\)'"):
        begin("interval(1,4)")
    assert not (tmp_path / "studies").exists()
    with pytest.raises(ConfigError, match="abc is not a whole number"):
        begin("choice(1,2,abc)")
    study = begin("int(interval(1,4))")  # as it was advised
    assert isinstance(study.advise({}, 1).points[0].values["schedule.batch_size"], int)


CHILD = """
import sys
from pathlib import Path
from fl3d.core.leases import leased
from fl3d.runs.layout import StoreFolder
from tests.sweep.studies import RANDOM, World, make
number, root = int(sys.argv[1]), Path(sys.argv[2])
with leased(StoreFolder(root).lease(f"child{number}-made-up-tiny")):
    study = make(
        root, words=[f"sweep.name=child{number}"], study_name="shared", n_trials=12,
        sampler=RANDOM | {"seed": number}, enqueue=[{"loss.gamma": 0}],
    )
    World(study, slots=1, epochs=1).run(60)
"""


@pytest.mark.slow
def test_eight_processes_begin_one_study_in_an_empty_folder(tmp_path: Path) -> None:
    """Each for a sweep of its own; a baseline is asked once, and no trial too many."""
    command = [sys.executable, "-c", CHILD]
    children = [
        subprocess.Popen([*command, str(number), str(tmp_path)], stderr=subprocess.PIPE, text=True)
        for number in range(8)
    ]
    for child in children:
        _, errors = child.communicate(timeout=300)
        assert child.returncode == 0, errors
    storage = open_storage(None, tmp_path, None, "shared")
    trials = optuna.load_study(study_name="shared", storage=storage).trials
    done = [trial for trial in trials if trial.state.name == "COMPLETE"]
    assert len(done) == 12
    assert {trial.state.name for trial in trials} <= {"COMPLETE", "FAIL"}
    assert sum(trial.params["loss.gamma"] == 0 for trial in done) == 1
    assert all(set(trial.user_attrs) >= {ROOT, SWEEP, KEY} for trial in done)
