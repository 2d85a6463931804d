"""How far a piece of work is, where no terminal looks."""

import pytest

from fl3d.core import counting


def test_lines_come_now_and_then_with_the_time_left(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Four seconds each: a line after twelve of them, and after twelve more."""
    clock = iter(range(0, 100, 4))
    monkeypatch.setattr(counting.time, "monotonic", lambda: float(next(clock)))
    with counting.counted("planning", 1000, "trial") as advance:
        for _ in range(6):
            advance(100)
    assert capsys.readouterr().err.splitlines() == [
        "planning: 300 of 1,000 trials, about 00:28 left",
        "planning: 600 of 1,000 trials, about 00:16 left",
    ]


def test_short_work_says_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with counting.counted("planning", 2, "trial") as advance:
        advance(2)
    assert not capsys.readouterr().err
