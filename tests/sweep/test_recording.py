"""Recording in the background: nothing waits for the store, nothing is lost, and errors are told."""

import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

import pytest

from fl3d.core.records import Trial
from fl3d.sweep.recording import Recording
from fl3d.sweep.sweepers.base import Standing, TrialState


def standing(key: str, state: TrialState = TrialState.RUNNING) -> Standing:
    trial = Trial(
        key=key,
        overrides=(),
        values={},
        config={},
        stages=(key,),
        first_own_step=0,
        detector="D",
        group="D",
        level=key,
        seed=0,
    )
    return Standing(trial, state, {}, 1)


class FakeRecorder:
    """Remembers what it was asked to record."""

    def __init__(self, act: Callable[[str], bool] = lambda key: True) -> None:
        self.act = act
        self.done: list[tuple[str, TrialState]] = []
        self.is_waiting = False
        self.was_interrupted = False
        self.said: list[str] = []
        self.say = self.said.append

    def sync(self, standings: Mapping[str, Standing]) -> bool:
        ((key, one),) = standings.items()
        if not self.act(key):
            self.is_waiting = True
            return False
        self.done.append((key, one.state))
        return True

    def interrupt(self) -> None:
        self.was_interrupted = True


@contextmanager
def recording(recorder: FakeRecorder) -> Iterator[Recording]:
    made = Recording(recorder)  # type: ignore[arg-type]
    try:
        yield made
    finally:
        made.interrupt()


def test_a_store_that_hangs_delays_nothing_and_gets_everything_in_the_end() -> None:
    let_go = threading.Event()

    def hang(key: str) -> bool:
        return let_go.wait(10)

    recorder = FakeRecorder(hang)
    with recording(recorder) as background:
        background.offer({"a": standing("a")})
        background.offer({"b": standing("b"), "c": standing("c")})
        background.offer({"b": standing("b", TrialState.DONE)})
        assert not background.is_idle
        assert recorder.done == []
        let_go.set()
        background.finish()
        assert background.is_idle
    # The newest standing of b is what is recorded, in the place where b was offered first.
    assert recorder.done == [
        ("a", TrialState.RUNNING),
        ("b", TrialState.DONE),
        ("c", TrialState.RUNNING),
    ]


def test_a_store_that_was_down_gets_the_newest_of_what_waited(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("fl3d.sweep.recording.ASK_SECONDS", 0.01)
    monkeypatch.setattr("fl3d.sweep.recording.SAY_SECONDS", 0.0)
    answers = iter([False, False, False])
    recorder = FakeRecorder(lambda key: next(answers, True))
    with recording(recorder) as background:
        background.offer({"a": standing("a"), "b": standing("b")})
        background.offer({"a": standing("a", TrialState.DONE)})
        background.finish()
    assert dict(recorder.done) == {"a": TrialState.DONE, "b": TrialState.RUNNING}
    assert recorder.said[0].startswith("All is trained. Waiting for the store")


def test_what_the_recorder_ends_with_ends_the_sweep() -> None:
    def broken(key: str) -> bool:
        raise ValueError("no such column")

    with recording(FakeRecorder(broken)) as background:
        background.offer({"a": standing("a")})
        with pytest.raises(ValueError, match="no such column"):
            background.finish()
        with pytest.raises(ValueError, match="no such column"):
            background.offer({"b": standing("b")})


def test_an_interrupt_ends_after_the_call_that_runs() -> None:
    started, let_go = threading.Event(), threading.Event()

    def hang(key: str) -> bool:
        started.set()
        return let_go.wait(10)

    recorder = FakeRecorder(hang)
    background = Recording(recorder)  # type: ignore[arg-type]
    background.offer({"a": standing("a"), "b": standing("b")})
    started.wait(10)
    threading.Timer(0.05, let_go.set).start()
    background.interrupt()
    assert [key for key, _ in recorder.done] == ["a"]
    assert recorder.was_interrupted


def test_a_call_that_does_not_end_is_left_behind(monkeypatch: pytest.MonkeyPatch) -> None:
    """The runs stay open in the store; the next start takes them up."""
    monkeypatch.setattr("fl3d.sweep.recording.END_SECONDS", 0.01)
    started, let_go = threading.Event(), threading.Event()

    def hang(key: str) -> bool:
        started.set()
        return let_go.wait(10)

    recorder = FakeRecorder(hang)
    background = Recording(recorder)  # type: ignore[arg-type]
    background.offer({"a": standing("a")})
    started.wait(10)
    began = time.monotonic()
    background.interrupt()
    assert time.monotonic() - began < 5
    assert not recorder.was_interrupted
    let_go.set()
