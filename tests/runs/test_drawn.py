"""A figure that is kept is the one that would be drawn now, or it is drawn again."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

from fl3d.reports.figures.curves import ap_over_cut
from fl3d.reports.figures.style import Drawn
from fl3d.reports.levels import Levels
from fl3d.runs import drawn as module
from fl3d.runs.drawn import drawn, plain
from fl3d.runs.layout import StoreFolder

LEVELS = Levels("gamma", ["0", "2"], "0")
DATA = pd.DataFrame({"cut": [0.0, 0.5], "ap": [70.0, 1 / 3]})
DRAWN: list[str] = []  # titles, in the order in which they were drawn


def line(data: pd.DataFrame, title: str, width: float = 1) -> Drawn:
    """A curve, and a word of each time that it is drawn."""
    DRAWN.append(title)
    figure, axes = plt.subplots(figsize=(2, 1))
    axes.plot(data["cut"], data["ap"], lw=width)
    axes.set_title(title)
    return Drawn(figure, data)


def nothing(data: pd.DataFrame) -> None:
    """As figures are of sweeps that have none."""
    DRAWN.append("nothing")


ONE, NOTHING = partial(line, DATA, "one"), partial(nothing, DATA)


@pytest.fixture
def place(tmp_path: Path) -> Callable[[str], Path]:
    DRAWN.clear()
    return lambda name: StoreFolder(tmp_path).drawn("gamma-simulated-quick", name)


def contents(written: Sequence[Path]) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in written}


def test_a_second_time_it_is_read_and_has_the_same_bytes(
    place: Callable[[str], Path], tmp_path: Path
) -> None:
    plainly = contents(line(DATA, "one").write(tmp_path / "plain" / "curve.1"))
    first = drawn(place, tmp_path / "a" / "curve.1", partial(line, DATA, "one"))
    again = drawn(place, tmp_path / "b" / "curve.1", partial(line, DATA.copy(), title="one"))
    assert DRAWN == ["one", "one"]
    assert contents(first) == contents(again) == plainly
    assert [path.parent for path in again] == [tmp_path / "b"] * 3
    assert list(plainly) == ["curve.1.csv", "curve.1.png", "curve.1.pdf"]


def test_a_file_of_the_same_content_is_left_and_another_is_written(
    place: Callable[[str], Path], tmp_path: Path
) -> None:
    data, png, pdf = drawn(place, tmp_path / "curve", ONE)
    whole = contents([data, png, pdf])
    png.write_bytes(b"somebody's")
    pdf.unlink()
    before = data.stat().st_ino
    assert contents(drawn(place, tmp_path / "curve", ONE)) == whole
    assert data.stat().st_ino == before
    assert DRAWN == ["one"]


def test_whatever_it_shows_or_is_made_by_has_changed_it_is_drawn_again(
    place: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "curve"
    first = contents(drawn(place, path, ONE))
    last_bit = DATA.assign(ap=[70.0, np.nextafter(1 / 3, 1)])
    for other in (last_bit, DATA[::-1], DATA.assign(ap=[70, 0]), DATA.rename(index={0: "first"})):
        count = len(DRAWN)
        drawn(place, path, partial(line, other, "one"))
        assert len(DRAWN) == count + 1
    assert contents(drawn(place, path, partial(line, DATA, "two"))) != first
    assert contents(drawn(place, path, partial(line, DATA, "one", width=2))) != first
    count = len(DRAWN)
    drawn(place, path, ONE)
    with monkeypatch.context() as patched:
        patched.setattr(module, "code_digest", lambda *places: "another version")
        drawn(place, path, ONE)
    module._libraries.cache_clear()
    with monkeypatch.context() as patched, matplotlib.rc_context({"lines.linewidth": 9}):
        drawn(place, path, ONE)
    module._libraries.cache_clear()
    assert contents(drawn(place, path, ONE)) == first
    assert len(DRAWN) == count + 4


def test_a_kept_figure_that_is_damaged_is_drawn_again(
    place: Callable[[str], Path], tmp_path: Path
) -> None:
    first = contents(drawn(place, tmp_path / "curve", ONE))
    kept = place("curve")
    whole = kept.read_bytes()
    kept.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
    assert contents(drawn(place, tmp_path / "curve", ONE)) == first
    assert DRAWN == ["one", "one"]
    assert kept.read_bytes()[-1] == whole[-1]


def test_no_figure_is_kept_too_and_without_a_store_nothing_is(
    place: Callable[[str], Path], tmp_path: Path
) -> None:
    assert drawn(place, tmp_path / "none", NOTHING) == []
    assert drawn(place, tmp_path / "none", NOTHING) == []
    assert DRAWN == ["nothing"]
    drawn(lambda name: None, tmp_path / "none", NOTHING)
    assert DRAWN == ["nothing", "nothing"]


def test_two_sweeps_of_one_store_have_figures_of_their_own(tmp_path: Path) -> None:
    store = StoreFolder(tmp_path)
    name = "precision_recall_" + "s" * 64
    places = {store.drawn(one, name) for one in ("s-kitti-quick", "s-kitti-paper")}
    assert len(places) == 2
    assert all(len(place.name) < 200 for place in places)


@dataclass(frozen=True)
class Record:
    number: float
    rows: np.ndarray


def test_values_that_look_different_are_different() -> None:
    zeros = np.zeros(3)
    alike = [
        1, 1.0, True, "1", None, (1,), (1.0,), {"a": 1, "b": 2}, {"b": 2, "a": 1},
        zeros, zeros.astype(np.float32), zeros[:2], zeros.reshape(1, 3), -zeros,
        Record(1.0, zeros), Record(1.0, zeros + 1), np.array(["a", 1], dtype=object),
    ]  # fmt: skip
    found = [repr(plain(value)) for value in alike]
    assert len(set(found)) == len(found)
    assert plain(Record(1.0, zeros)) == plain(Record(1.0, zeros.copy()))
    with pytest.raises(TypeError, match="object"):
        plain({"given": object()})


def test_a_figure_of_a_report_is_kept(place: Callable[[str], Path], tmp_path: Path) -> None:
    rows = [
        {"group": "VoxelNet", "level": level, "score_threshold": cut, "ap_3d/moderate": 50.0}
        for level in LEVELS.labels
        for cut in (0.0, 0.5)
    ]
    first = contents(
        drawn(place, tmp_path / "cut", partial(ap_over_cut, pd.DataFrame(rows), LEVELS))
    )
    kept = place("cut").read_bytes()
    again = contents(
        drawn(place, tmp_path / "cut", partial(ap_over_cut, pd.DataFrame(rows), LEVELS))
    )
    assert first == again
    assert place("cut").read_bytes() == kept
