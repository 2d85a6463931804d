"""What of a store can be deleted, and what never is."""

import json
import os
import time
from pathlib import Path

import pytest

from fl3d.core.errors import StoreError
from fl3d.core.files import OLD_SECONDS
from fl3d.core.leases import leased
from fl3d.core.records import Stage, Trial
from fl3d.evaluation.protocol import Protocol
from fl3d.runs.cleaning import clean
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.plans import FrozenPlan, freeze, write_plan
from fl3d.runs.spec import Machine, Spec, write_done, write_spec

PROTOCOL = Protocol(
    name="any",
    variant="A",
    overlaps={"Car": (0.7, 0.7, 0.7)},
    score_threshold=0.0,
    nms_iou=0.1,
    nms_kind="rotated",
    max_detections=50,
)
EPOCHS = 5


def stored_stage(layout: StoreFolder, key: str) -> RunFolder:
    """As if a stage had been trained, one step an epoch, and all its weights were still there."""
    stage = Stage(
        key=key,
        name="focal",
        config={},
        parent=None,
        start_epoch=0,
        start_step=0,
        epochs=EPOCHS,
        epoch_steps=1,
    )
    machine = Machine(data_root=Path("data"), train_ids=(), val_ids=(), protocol=PROTOCOL)
    run = layout.run(key)
    write_spec(run, Spec(stage, machine))
    run.weights(1).parent.mkdir()
    for step in range(1, EPOCHS + 1):
        run.marker(step).write_text("{}")
        run.weights(step).write_bytes(b"x" * 1000)
    write_done(run, {})
    return run


def named_in_a_plan(layout: StoreFolder, name: str, *keys: str) -> Path:
    """As if a sweep had been planned with a trial for each of some stages."""
    trials = [
        Trial(
            key=key,
            overrides=(),
            values={},
            config={},
            stages=(key,),
            first_own_step=0,
            detector="VoxelNet",
            group="VoxelNet",
            level=str(number),
            seed=0,
        )
        for number, key in enumerate(keys)
    ]
    frozen = tuple(freeze(trial, {}) for trial in trials)
    path = layout.plan(name)
    write_plan(path, FrozenPlan(factor=(), baseline="0", trials=frozen))
    return path


@pytest.fixture
def layout(tmp_path: Path) -> StoreFolder:
    """A store with one stage that a plan names, and an orphan."""
    layout = StoreFolder(tmp_path)
    stored_stage(layout, "mine")
    stored_stage(layout, "orphan")
    named_in_a_plan(layout, "gamma", "mine")
    return layout


def kept_weights(layout: StoreFolder, key: str) -> list[int]:
    """Steps of a stage whose weights are there."""
    run = layout.run(key)
    return [step for step in run.steps() if run.weights(step).exists()]


def test_clean_shows_before_it_deletes(layout: StoreFolder) -> None:
    stray = layout.stages / ".weights.pt.123.tmp"
    stray.write_bytes(b"x" * 1000)
    old = time.time() - 2 * OLD_SECONDS
    os.utime(stray, (old, old))
    said: list[str] = []
    before = sorted(layout.root.rglob("*"))
    clean(layout.root, None, delete=False, orphans=False, say=said.append)
    text = "\n".join(said)
    assert "8 weights of checkpoints that are neither last, best nor every k-th" in text
    assert "... and 3 more" in text
    assert "1 temporary files of processes that were killed" in text
    assert "1 stages that no sweep's plan names (kept; --orphans takes them too)" in text
    assert "9.00kB can be deleted. Nothing was deleted" in text
    assert sorted(layout.root.rglob("*")) == before
    clean(layout.root, None, delete=True, orphans=False, say=said.append)
    assert said[-1] == "9.00kB deleted"
    assert not stray.exists()
    assert kept_weights(layout, "mine") == [EPOCHS]
    assert layout.run("orphan").is_done
    clean(layout.root, None, delete=True, orphans=True, say=said.append)
    assert not layout.run("orphan").path.exists()
    assert layout.run("mine").is_done
    clean(layout.root, None, delete=True, orphans=True, say=said.append)
    assert said[-1].endswith("there is nothing to delete")


def test_a_copy_that_mlflow_was_making_is_a_temporary_file(layout: StoreFolder) -> None:
    """In the artifacts of a run, where a kill has left it."""
    stray = layout.root / "artifacts" / "gamma" / ".artifact.uploading.cpvi8n2y"
    stray.parent.mkdir(parents=True)
    stray.touch()
    clean(layout.root, None, delete=True, orphans=False, say=lambda line: None)
    assert stray.exists()  # it may be in the making
    os.utime(stray, (0, 0))
    clean(layout.root, None, delete=True, orphans=False, say=lambda line: None)
    assert not stray.exists()


def test_every_kth_epoch_keeps_its_weights(layout: StoreFolder) -> None:
    clean(layout.root, 2, delete=True, orphans=False, say=lambda line: None)
    assert kept_weights(layout, "mine") == [2, 4, 5]


def test_a_file_that_is_being_written_stays(layout: StoreFolder) -> None:
    fresh = layout.stages / ".weights.pt.123.tmp"
    fresh.touch()
    clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert fresh.exists()


def test_a_stage_in_training_is_left_alone(layout: StoreFolder) -> None:
    with leased(layout.run("orphan").lease):
        clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
        assert kept_weights(layout, "orphan") == [1, 2, 3, 4, 5]


def test_nothing_is_deleted_while_a_sweep_runs(layout: StoreFolder) -> None:
    with (
        leased(layout.lease("gamma")),
        pytest.raises(StoreError, match=r"gamma is being run by process"),
    ):
        clean(layout.root, None, delete=True, orphans=False, say=lambda line: None)
    assert kept_weights(layout, "mine") == [1, 2, 3, 4, 5]


@pytest.mark.parametrize("content", ['{"version": 1, "trials": []}', "{torn"])
def test_a_plan_that_cannot_be_read_makes_no_orphans(layout: StoreFolder, content: str) -> None:
    """Whoever wrote it may still want the stages that it names."""
    layout.plan("older").write_text(content)
    said: list[str] = []
    clean(layout.root, None, delete=True, orphans=False, say=said.append)
    assert "Stages that no sweep's plan names are not looked for: " in said[0]
    assert "older.json" in said[0]
    for delete in (False, True):
        with pytest.raises(StoreError, match=r"--orphans: nobody can tell .*older\.json"):
            clean(layout.root, None, delete=delete, orphans=True, say=said.append)
    assert layout.run("orphan").is_done
    assert kept_weights(layout, "mine") == [EPOCHS]


def test_a_stage_of_another_version_keeps_its_weights_and_can_be_an_orphan(
    layout: StoreFolder,
) -> None:
    orphan = layout.run("orphan")
    orphan.spec.write_text('{"stage": {"wings": 2}, "machine": {}}')
    said: list[str] = []
    clean(layout.root, None, delete=True, orphans=False, say=said.append)
    assert any(line.startswith("All its weights are kept: ") for line in said)
    assert kept_weights(layout, "orphan") == [1, 2, 3, 4, 5]
    clean(layout.root, None, delete=True, orphans=True, say=said.append)
    assert not orphan.path.exists()


def test_half_written_results_of_a_program_go_when_its_stage_is_done(tmp_path: Path) -> None:
    layout = StoreFolder(tmp_path)
    for key in ("done", "begun"):
        aside = stored_stage(layout, key).work / "epoch_1.unfinished-1700000000"
        aside.mkdir(parents=True)
        (aside / "000001.txt").write_text("")
    layout.run("begun").done.unlink()
    named_in_a_plan(layout, "gamma", "done", "begun")
    clean(tmp_path, None, delete=True, orphans=False, say=lambda _: None)
    assert not list(layout.run("done").work.iterdir())
    assert list(layout.run("begun").work.iterdir())


def test_a_folder_without_a_store_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"there is no store; give store\.root=FOLDER"):
        clean(tmp_path, None, delete=False, orphans=False)


@pytest.mark.parametrize("name", ["alice/gamma", "alice/of/2024/gamma", ".hidden", "../beside"])
def test_a_plan_however_deep_keeps_the_stages_that_it_names(layout: StoreFolder, name: str) -> None:
    """Such names were possible once: ``alice/gamma`` lay in a folder, ``../beside`` in the root."""
    assert layout.root in named_in_a_plan(layout, name, "orphan").resolve().parents
    said: list[str] = []
    clean(layout.root, None, delete=True, orphans=True, say=said.append)
    assert not any("no sweep's plan names" in line for line in said)
    assert layout.run("orphan").is_done
    assert layout.run("mine").is_done


def test_a_plan_behind_a_link_counts(
    layout: StoreFolder, tmp_path_factory: pytest.TempPathFactory
) -> None:
    elsewhere = tmp_path_factory.mktemp("elsewhere")
    (layout.plans / "alice").symlink_to(elsewhere)
    (layout.plans / "round").symlink_to(layout.plans)  # a circle ends nobody's patience
    named_in_a_plan(layout, "alice/gamma", "orphan")
    clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert layout.run("orphan").is_done


def test_a_torn_plan_deep_below_keeps_all(layout: StoreFolder) -> None:
    whole = named_in_a_plan(layout, "alice/gamma", "orphan")
    beside = named_in_a_plan(layout, "../beside", "orphan")
    for path in (whole, beside):
        text = path.read_text()
        path.write_text(text[: len(text) // 2])
        with pytest.raises(StoreError, match=rf"--orphans: nobody can tell .*{path.name}"):
            clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
        path.unlink()
    assert layout.run("orphan").is_done


def test_other_files_of_a_store_are_not_taken_for_plans(layout: StoreFolder) -> None:
    """A config says ``"name": "trials"``, and a program's own files may be torn."""
    for path in (
        layout.root / "artifacts" / "a" / "config.json",
        layout.run("mine").work / "x.json",
    ):
        path.parent.mkdir(parents=True)
        path.write_text('{"sweep": {"name": "trials"')
    clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert not layout.run("orphan").path.exists()
    assert layout.run("mine").is_done


def test_a_folder_of_plans_that_cannot_be_read_keeps_all(
    layout: StoreFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    named_in_a_plan(layout, "alice/gamma", "orphan")
    scandir = os.scandir

    def refusing(path: str) -> object:
        if Path(path).name == "alice":
            raise PermissionError(13, "Permission denied", str(path))
        return scandir(path)

    monkeypatch.setattr(os, "scandir", refusing)
    with pytest.raises(StoreError, match=r"alice: cannot be read \(Permission"):
        clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert layout.run("orphan").is_done


def test_a_sweep_that_runs_in_a_folder_of_plans_stops_clean(layout: StoreFolder) -> None:
    with (
        leased(layout.lease("alice/gamma")),
        pytest.raises(StoreError, match=r"alice/gamma is being run by process"),
    ):
        clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert layout.run("orphan").is_done


def test_what_a_users_program_wrote_is_its_own(layout: StoreFolder) -> None:
    theirs = layout.run("mine").work / ".cache.tmp"
    theirs.parent.mkdir()
    theirs.touch()
    old = time.time() - 2 * OLD_SECONDS
    os.utime(theirs, (old, old))
    clean(layout.root, None, delete=True, orphans=True, say=lambda line: None)
    assert theirs.exists()


def test_a_lease_that_a_killed_process_left_at_a_stage_that_is_done_goes(tmp_path: Path) -> None:
    layout = StoreFolder(tmp_path)
    run = stored_stage(layout, "done")
    named_in_a_plan(layout, "gamma", "done")
    with leased(run.lease):
        holder = json.loads(run.lease.read_text())
    run.lease.write_text(json.dumps({**holder, "pid": 2**22 + 1}))  # above the largest there can be
    clean(tmp_path, None, delete=True, orphans=False, say=lambda _: None)
    assert not run.lease.exists()
    assert run.done.exists()
