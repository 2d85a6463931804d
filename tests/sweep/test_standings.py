"""How trials stand, from what has become of their stages."""

from collections.abc import Mapping

import pytest

from fl3d.core.records import Stage, Trial
from fl3d.sweep.plan import Plan
from fl3d.sweep.scheduler import Outcome
from fl3d.sweep.standings import Standings
from fl3d.sweep.sweepers.base import TrialState


def stage(key: str, parent: str | None, epochs: int) -> Stage:
    return Stage(
        key=key,
        name=key,
        config={"loss": {}},
        parent=parent,
        start_epoch=0,
        start_step=0,
        epochs=epochs,
        epoch_steps=1,
    )


def trial(*stages: str) -> Trial:
    return Trial(
        key=stages[-1],
        overrides=(),
        values={},
        config={},
        stages=stages,
        first_own_step=0,
        detector="D",
        group="D",
        level=stages[-1],
        seed=0,
    )


STAGES = (stage("warmup", None, 3), stage("a", "warmup", 2), stage("b", "warmup", 5))
PLAN = Plan("test", (trial("warmup", "a"), trial("warmup", "b")), {one.key: one for one in STAGES})


def states(outcome: Outcome) -> list[TrialState]:
    return [one.state for one in Standings().update(PLAN, outcome, ()).values()]


@pytest.mark.parametrize(
    ("outcome", "expected"),
    [
        (Outcome(), [TrialState.RUNNING, TrialState.RUNNING]),
        (Outcome(done={"warmup"}), [TrialState.RUNNING, TrialState.RUNNING]),
        (Outcome(done={"warmup", "a"}), [TrialState.DONE, TrialState.RUNNING]),
        (Outcome(stopped=["b"]), [TrialState.RUNNING, TrialState.STOPPED]),
        (Outcome(failed={"a": "why"}), [TrialState.FAILED, TrialState.RUNNING]),
        (
            Outcome(failed={"warmup": "why"}, blocked=["a", "b"]),
            [TrialState.FAILED, TrialState.FAILED],
        ),
    ],
)
def test_a_trial_stands_as_its_stages_do(outcome: Outcome, expected: list[TrialState]) -> None:
    assert states(outcome) == expected


def test_a_trial_that_is_stopped_before_a_stage_it_shares_fails_has_failed() -> None:
    outcome = Outcome(stopped=["b"], failed={"warmup": "why"}, blocked=["a"])
    assert states(outcome) == [TrialState.FAILED, TrialState.FAILED]


def test_a_trial_is_judged_by_its_last_stage() -> None:
    """By that one's curve and epochs; a warm-up's are no trial's own."""
    asked: list[str] = []

    def curve(stage: Stage) -> Mapping[int, Mapping[str, float]]:
        asked.append(stage.key)
        return {1: {"ap_3d/moderate": float(stage.epochs)}}

    standings = Standings(curve).update(PLAN, Outcome(), ())
    assert asked == ["a", "b"]
    assert standings["b"].epochs == 5
    assert standings["b"].curve == {1: {"ap_3d/moderate": 5.0}}
    assert standings["b"].trial is PLAN.trials[1]


def test_a_trial_may_be_a_stage_that_another_resumes_from() -> None:
    plan = Plan("test", (trial("warmup"), trial("warmup", "a")), PLAN.stages)
    found = Standings().update(plan, Outcome(done={"warmup"}), ())
    assert [one.state for one in found.values()] == [TrialState.DONE, TrialState.RUNNING]


def test_standings_come_in_the_plans_order() -> None:
    assert list(Standings().update(PLAN, Outcome(), ())) == ["a", "b"]


def test_only_trials_with_news_are_looked_at_again() -> None:
    """A warm-up's news are news of all that resume from it."""
    asked: list[str] = []

    def curve(stage: Stage) -> Mapping[int, Mapping[str, float]]:
        asked.append(stage.key)
        return {}

    standings = Standings(curve)
    first = Plan("test", PLAN.trials[:1], PLAN.stages)
    assert list(standings.update(first, Outcome(), ())) == ["a"]
    assert list(standings.update(PLAN, Outcome(), ())) == ["b"]
    assert list(standings.update(PLAN, Outcome(), ["elsewhere"])) == []
    changed = standings.update(PLAN, Outcome(done={"warmup", "b"}), ["b"])
    assert [one.state for one in changed.values()] == [TrialState.DONE]
    assert asked == ["a", "b", "b"]
    assert list(standings.update(PLAN, Outcome(), ["warmup"])) == ["a", "b"]
    assert {key: one.state for key, one in standings.items()} == {
        "a": TrialState.RUNNING,
        "b": TrialState.RUNNING,
    }
