"""Some sweeps of a results folder are published anew, and the others stay. Stand-ins for trainings change scores."""

import json
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from fl3d.api import publishing, standing
from fl3d.api.words import Words
from fl3d.commands import publish
from fl3d.config.places import PUBLISHED
from fl3d.config.settings import Settings
from fl3d.core.errors import StoreError
from fl3d.papers import folder as results_folder
from fl3d.papers.stamp import files_of, read_stamp
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import open_scores
from fl3d.store.memory import MemoryStore
from fl3d.sweep.prepare import PreparedData

NAME = "simulated-quick"
OLD = read_stamp(PUBLISHED / NAME)
KEPT = ("pointrcnn_batch", "pointrcnn_alpha", "frustum_batch", "frustum_alpha", "frustum_final")
DATA = PreparedData(
    root=Path(),
    train_ids=("0",) * OLD["data"]["train_frames"],
    val_ids=(),
    digest=OLD["data"]["digest"],
    image_digest=OLD["data"]["image_digest"],
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A few of the published sweeps, under a stamp that says once where all of them come from."""
    made = tmp_path / "results" / NAME
    shutil.copytree(PUBLISHED / NAME, made)
    for name in OLD["sweeps"].keys() - set(KEPT):
        for path in files_of(made, OLD, name):
            path.unlink(missing_ok=True)  # several write the tables of networks
    one = OLD["sweeps"]["frustum_alpha"]
    stamp = {
        **{key: one[key] for key in ("trained_by", "machine", "packages")},
        "commit": "old",
        "data": OLD["data"],
        "versions": OLD["versions"] | one["versions"],
        "sweeps": {
            name: {key: OLD["sweeps"][name][key] for key in ("trials", "protocol")} for name in KEPT
        },
    }
    (made / "stamp.json").write_text(json.dumps(stamp))
    monkeypatch.setattr(publishing, "PUBLISHED", made.parent)
    monkeypatch.setattr(publishing, "is_checkout", lambda: True)
    monkeypatch.setattr(publishing, "provenance", lambda: {"fl3d.commit": "new"})
    monkeypatch.setattr(publishing, "open_store", lambda root, _: MemoryStore(root))
    monkeypatch.setattr(publishing, "prepare_data", lambda _: DATA)
    monkeypatch.setattr(standing, "prepare_data", lambda _: DATA)
    monkeypatch.setattr(publishing, "trained", lambda one: trained(one, lambda ap: ap / 2))
    monkeypatch.setattr(publishing, "origin", origin)
    monkeypatch.setattr(results_folder, "draw_papers", lambda *_: [])
    return made


def trained(one: Words, change: Any) -> FinishedSweep:
    """A sweep as it was published, of other scores."""
    sweep = open_scores(one.settings, PUBLISHED)
    metrics = [name for name in sweep.scores if "/" in str(name)]
    changed = {str(name): change(sweep.scores[name]) for name in metrics}
    return replace(sweep, scores=sweep.scores.assign(**changed))


def origin(
    sweep: FinishedSweep, made_by: Mapping[str, str], files: Sequence[str]
) -> dict[str, Any]:
    own = {"trials": len(sweep.trials), "protocol": sweep.protocol.id, "files": sorted(files)}
    return {"commit": made_by["fl3d.commit"], **own}


def publish_only(folder: Path, *names: str) -> None:
    publish.run(["profile=quick", f"store.root={folder.parent.parent / 'runs'}", "--only", *names])


def contents(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes()
        for path in folder.rglob("*")
        if path.is_file()
    }


def refuse_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(publishing, "trained", lambda _: pytest.fail("work was begun"))


def rows(table: bytes) -> dict[str, list[str]]:
    """Rows of a CSV table by setting."""
    lines = [line.split(",") for line in table.decode().splitlines()]
    return {",".join(line[:2]): line[2:] for line in lines}


def test_one_sweep_is_renewed_and_the_others_stay_to_the_byte(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stale = folder / "figures" / "forest_frustum_alpha.png"
    stale.touch()
    before = contents(folder)
    publish_only(folder, "frustum_alpha")
    after = contents(folder)
    left = ", ".join(name for name in KEPT if name != "frustum_alpha")
    assert f"{folder} keeps as published: {left}" in capsys.readouterr().out
    changed = {name for name in before.keys() | after if before.get(name) != after.get(name)}
    curves = {
        f"figures/ap_over_{kind}_frustum_alpha.{ending}"
        for kind in ("level", "steps")
        for ending in ("csv", "png")
    }
    table = {f"tables/table_R6.{ending}" for ending in ("csv", "md", "tex")}
    assert changed == curves | table | {
        "scores/frustum_alpha.csv",
        "stamp.json",
        "figures/forest_frustum_alpha.png",
    }
    assert not stale.exists()


def test_a_joint_table_keeps_the_rows_of_sweeps_that_stay(folder: Path) -> None:
    for name in ("frustum_slabs", "frustum_weights"):  # those that this folder has not
        assert not (folder / "scores" / f"{name}.csv").exists()
    before = pd.read_csv(folder / "tables/table_R6.csv", dtype=str)
    publish_only(folder, "frustum_alpha")
    after = pd.read_csv(folder / "tables/table_R6.csv", dtype=str)
    setting, ap = before.columns[1], before.columns[2]
    was, now = (dict(zip(table[setting], table[ap], strict=True)) for table in (before, after))
    assert now["Batch Size = 8"] == was["Batch Size = 8"]
    assert now["Our Final Parameters"] == was["Our Final Parameters"]
    assert float(now["Alpha = 0.2"]) == pytest.approx(float(was["Alpha = 0.2"]) / 2, abs=1e-5)


def test_the_stamp_says_of_each_sweep_where_it_comes_from(folder: Path) -> None:
    publish_only(folder, "frustum_alpha")
    stamp = json.loads((folder / "stamp.json").read_text())
    assert stamp["data"] == OLD["data"]
    assert stamp["versions"] == OLD["versions"]
    assert list(stamp["sweeps"]) == [name for name in OLD["sweeps"] if name in KEPT]
    commits = {name: own["commit"] for name, own in stamp["sweeps"].items()}
    assert commits == {name: "new" if name == "frustum_alpha" else "old" for name in KEPT}
    files = stamp["sweeps"]["frustum_alpha"]["files"]
    assert {"scores/frustum_alpha.csv", "tables/table_R6.md"} <= set(files)
    assert all((folder / name).is_file() for name in files)
    assert "files" not in stamp["sweeps"]["frustum_batch"]  # nobody has kept them


def test_files_that_a_sweep_writes_no_more_go_by_the_stamps_list(folder: Path) -> None:
    publish_only(folder, "frustum_alpha")
    stamp = read_stamp(folder)
    stamp["sweeps"]["frustum_alpha"]["files"].append("tables/table_gone.md")
    (folder / "stamp.json").write_text(json.dumps(stamp))
    for name in ("table_gone.md", "table_mine.md"):
        (folder / "tables" / name).touch()
    publish_only(folder, "frustum_alpha")
    assert not (folder / "tables" / "table_gone.md").exists()
    assert (folder / "tables" / "table_mine.md").exists()


def test_a_file_that_a_sweep_feeds_that_stays_is_not_lost(folder: Path) -> None:
    publish_only(folder, "frustum_alpha", "frustum_batch")
    stamp = read_stamp(folder)
    for name in ("frustum_alpha", "frustum_batch"):
        stamp["sweeps"][name]["files"].append("figures/joint.png")
    (folder / "stamp.json").write_text(json.dumps(stamp))
    (folder / "figures" / "joint.png").touch()
    before = contents(folder)
    with pytest.raises(StoreError, match=r"frustum_batch feeds figures/joint\.png too"):
        publish_only(folder, "frustum_alpha")
    assert contents(folder) == before


def test_sweeps_that_the_code_plans_differently_are_not_left(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_work(monkeypatch)
    plan = folder / "scores" / "frustum_batch.json"
    first = json.loads(plan.read_text())["trials"][0]["key"]
    plan.write_text(plan.read_text().replace(first, f"{first}0"))
    stamp = folder / "stamp.json"
    own = json.loads(stamp.read_text())
    own["sweeps"]["frustum_final"]["protocol"] = "report-0"
    stamp.write_text(json.dumps(own))
    before = contents(folder)
    with pytest.raises(StoreError, match=r"add to --only: frustum_batch frustum_final$") as refused:
        publish_only(folder, "frustum_alpha")
    assert str(folder) in str(refused.value)
    assert contents(folder) == before


def test_sweeps_of_other_data_are_not_left(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refuse_work(monkeypatch)
    other = replace(DATA, digest="f00d")
    monkeypatch.setattr(standing, "prepare_data", lambda _: other)
    with pytest.raises(StoreError, match=rf"{NAME}: .*{DATA.digest}.*frustum_alpha .*f00d"):
        publish_only(folder, "frustum_alpha")


def test_a_figure_of_two_sweeps_is_not_left_with_a_model_of_before(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    refuse_work(monkeypatch)
    wanted = r"report_figure_6\.png: shows models of pointrcnn_rcnn and of frustum_final, .* add"
    with pytest.raises(StoreError, match=wanted):
        publish_only(folder, "pointrcnn_rcnn")


@pytest.mark.parametrize("is_same", [True, False])
def test_such_a_figure_is_drawn_from_the_store_where_that_has_just_these_scores(
    is_same: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def stored(settings: Settings) -> FinishedSweep:
        sweep = open_scores(settings, PUBLISHED)
        runs = StoreFolder(settings.store.root)
        trials = tuple(replace(one, folders=(runs.run(one.key),)) for one in sweep.trials)
        scores = sweep.scores if is_same else sweep.scores.assign(epoch=0)
        return replace(sweep, trials=trials, scores=scores)

    monkeypatch.setattr(standing, "open_sweep", stored)
    words = ["profile=quick", f"store.root={folder.parent.parent / 'runs'}"]
    asked = publishing.read_sweeps(["pointrcnn_rcnn"], words)
    if is_same:
        left = standing.find_standing(folder, asked, words)
        assert all(sweep.is_from_store for sweep in left.sweeps)
    else:
        with pytest.raises(StoreError, match=r"report_figure_6\.png: shows"):
            standing.find_standing(folder, asked, words)


def test_a_sweep_is_not_left_that_builds_on_a_value_that_wins_no_more(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    monkeypatch.setattr(publishing, "trained", lambda one: trained(one, lambda ap: -ap))
    wanted = "pointrcnn_alpha builds on other values .* pointrcnn_alpha pointrcnn_batch$"
    with pytest.raises(StoreError, match=wanted):
        publish_only(folder, "pointrcnn_batch")
    assert contents(folder) == before


def test_a_winner_may_be_that_of_a_sweep_that_stays(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Though the store knows nothing of it."""
    publish_only(folder, "pointrcnn_alpha")
    assert read_stamp(folder)["sweeps"]["pointrcnn_alpha"]["commit"] == "new"


@pytest.mark.parametrize("text", ["torn", "[]", '{"commit": "abc"}', '{"sweeps": {}}'])
def test_a_stamp_that_is_none_is_told(folder: Path, text: str) -> None:
    (folder / "stamp.json").write_text(text)
    with pytest.raises(StoreError, match=r"stamp\.json: is no stamp of a results folder"):
        publish_only(folder, "frustum_alpha")
