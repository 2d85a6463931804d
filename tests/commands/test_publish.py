"""What is published stays as it is until all of the new is there. Nothing is trained: a stand-in writes the results."""

import json
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from fl3d.api import publishing
from fl3d.commands import publish
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.leases import leased
from fl3d.papers.folder import make_small
from fl3d.runs.layout import StoreFolder
from fl3d.store.memory import MemoryStore

CLEAN = {"fl3d.commit": "abc", "fl3d.dirty": "false"}
OLD_STAMP = {
    **dict.fromkeys(("commit", "trained_by", "machine", "packages"), "old"),
    "data": {},
    "versions": {"keys": 2, "simulator": 2, "trainer": 1, "detectors": {}},
    "sweeps": {"gamma": {"trials": 2, "protocol": "paper"}},
}
Make = Callable[..., None]


@pytest.fixture
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of results with one that was published before."""
    folder = tmp_path / "results" / "simulated-tiny"
    for name in ("scores/gamma.csv", "tables/table_V.md", "figures/forest_gamma.png", "stamp.json"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(f"old {name}")
    (folder / "stamp.json").write_text(json.dumps(OLD_STAMP))
    monkeypatch.setattr(publishing, "PUBLISHED", tmp_path / "results")
    monkeypatch.setattr(publishing, "is_checkout", lambda: True)
    monkeypatch.setattr(publishing, "provenance", lambda: CLEAN)
    monkeypatch.setattr(publishing, "open_store", lambda root, _: MemoryStore(root))
    return tmp_path / "results"


def words(published: Path, *only: str) -> list[str]:
    return ["profile=tiny", f"store.root={published.parent / 'runs'}", "--only", *only]


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def writes(name: str) -> Make:
    """Stands for a sweep that writes a table, and the stamp."""

    def make(folders: Sequence[Path], *_: object) -> None:
        for folder in folders:
            (folder / "tables").mkdir(parents=True)
            (folder / "tables" / name).write_text("new")
            (folder / "stamp.json").write_text("new")

    return make


def test_what_is_new_takes_the_place_of_all_that_was_there(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(publishing, "make", writes("table_IV.md"))
    publish.run(words(published, "gamma", "gamma_pedestrian"))
    assert contents(published) == {
        "README.md": (published / "README.md").read_bytes(),
        "simulated-tiny/stamp.json": b"new",
        "simulated-tiny/tables/table_IV.md": b"new",
        "simulated_people-tiny/stamp.json": b"new",
        "simulated_people-tiny/tables/table_IV.md": b"new",
    }


@pytest.mark.parametrize("error", [StoreError("no"), OSError("no"), KeyboardInterrupt()])
def test_a_failure_in_the_middle_leaves_what_was_published_to_the_byte(
    error: BaseException, published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(published)
    write = writes("table_IV.md")

    def make(*given: object) -> None:
        write(*given)
        raise error

    monkeypatch.setattr(publishing, "make", make)
    with pytest.raises(type(error)):
        publish.run(words(published, "gamma", "gamma_pedestrian"))
    assert contents(published) == before
    assert not (published / publishing.MAKING).exists()


def test_a_sweep_that_ends_before_its_last_trial_is_not_published(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(published)

    def half(asked: object, *_: object) -> None:
        raise StoreError("the disk is full")

    monkeypatch.setattr(publishing, "train_sweep", half)
    with pytest.raises(StoreError, match="the disk is full"):
        publish.run(words(published, "gamma"))
    assert contents(published) == before


def never(*_: object) -> None:
    pytest.fail("work was begun")


def test_a_sweep_that_is_being_run_is_found_before_any_work(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(published)
    monkeypatch.setattr(publishing, "make", never)
    store = StoreFolder(published.parent / "runs")
    with (
        leased(store.lease("loss_form-simulated-tiny")),
        pytest.raises(StoreError, match="loss_form-simulated-tiny: is being run by process"),
    ):
        publish.run(words(published, "gamma", "loss_form"))
    assert contents(published) == before


def test_a_winner_that_is_nowhere_is_missed_before_any_work(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not taken from what is published, which may be of other code."""
    monkeypatch.setattr(publishing, "make", never)
    with pytest.raises(StoreError, match="no scores of pointrcnn_batch-simulated-tiny"):
        publish.run(words(published, "gamma", "pointrcnn_alpha"))


def test_a_winner_is_asked_for_before_it_is_kept_in_whatever_order_it_was_typed(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shutil.rmtree(published / "simulated-tiny")
    asked: list[str] = []

    def make(folders: dict[Path, dict[str, object]], *_: object) -> None:
        [own] = folders.values()
        asked.extend(own)
        writes("table.md")(folders)

    monkeypatch.setattr(publishing, "make", make)
    publish.run(words(published, "pointrcnn_alpha", "pointrcnn_batch"))
    assert asked == ["pointrcnn_batch", "pointrcnn_alpha"]


def test_uncommitted_changes_are_refused(published: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing, "make", never)
    monkeypatch.setattr(publishing, "provenance", lambda: CLEAN | {"fl3d.dirty": "true"})
    with pytest.raises(ConfigError, match="uncommitted changes"):
        publish.run(words(published, "gamma"))


def test_what_is_committed_is_made_small(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    pixels = rng.integers(0, 256, (64, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(tmp_path / "street.png")
    drawn = Image.new("RGB", (64, 64), "white")
    drawn.paste("#1f77b4", (8, 8, 24, 24))
    drawn.save(tmp_path / "curve.png")
    (tmp_path / "curve.pdf").touch()
    before = (tmp_path / "street.png").stat().st_size
    make_small(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["curve.png", "street.png"]
    with Image.open(tmp_path / "curve.png") as picture:  # of few colours: as it was
        assert (np.asarray(picture.convert("RGB")) == np.asarray(drawn)).all()
    assert (tmp_path / "street.png").stat().st_size < before / 2


def test_words_behind_only_are_words_and_not_sweeps(
    published: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[list[str], list[str]]] = []
    monkeypatch.setattr(
        publishing, "publish", lambda names, words: asked.append((names, words)) or [published]
    )
    publish.run(["--only", "gamma", "profile=tiny", "loss_form", "store.root=runs"])
    publish.run(["profile=tiny", "store.root=runs", "--only", "gamma", "loss_form"])
    assert asked == [(["gamma", "loss_form"], ["profile=tiny", "store.root=runs"])] * 2
    with pytest.raises(ConfigError, match="--only: names no sweep; it can be gamma, "):
        publish.run(["--only", "profile=tiny"])


def test_a_sweep_that_is_published_says_nothing_of_the_folder_that_will_have_moved(
    capsys: pytest.CaptureFixture[str],
) -> None:
    publishing._say("Written to .making/simulated-quick: tables")
    publishing._say("Verdicts on VoxelNet")
    assert capsys.readouterr().out == "Verdicts on VoxelNet\n"
