"""Numbers of things in words."""

from fl3d.core.plurals import several


def test_one_thing_is_no_several() -> None:
    assert several(1, "run") == "1 run"
    assert several(0, "run") == "0 runs"
    assert several(3, "more seed") == "3 more seeds"
