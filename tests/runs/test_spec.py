"""What lies beside a stage: its spec, its progress, its end and its scores."""

from pathlib import Path

import pytest

from fl3d.core.errors import CheckpointError, StoreError
from fl3d.core.records import Checkpoint, Stage
from fl3d.evaluation.protocol import Protocol
from fl3d.runs.checkpoints import last_state, read_marker, save_state, write_marker
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.retention import superfluous_weights
from fl3d.runs.spec import (
    Machine,
    Spec,
    read_scores,
    read_spec,
    steps_done,
    write_done,
    write_progress,
    write_scores,
    write_spec,
)

PROTOCOL = Protocol(
    name="test",
    variant="A",
    overlaps={"Car": (0.7, 0.7, 0.7)},
    score_threshold=0.5,
    nms_iou=0.01,
    nms_kind="standup",
    max_detections=10,
    ignore_beyond=(0.0, -40.0, 70.0, 40.0),
)
CONFIG = {
    "seed": 3,
    "precision": "bf16",
    "compile": True,
    "schedule": {"batch_size": 2, "checkpoint_every": 1},
    "data": {"crop": "none", "calibration": "mean"},
    "detections": {"max_boxes": 300, "min_score": 0.01},
}
STAGE = Stage(
    key="voxelnet-focal-1234",
    name="focal",
    config=CONFIG,
    parent="voxelnet-warmup-1",
    start_epoch=12,
    start_step=120,
    epochs=3,
    epoch_steps=10,
)


def spec(tmp_path: Path, **config: object) -> Spec:
    machine = Machine(
        data_root=tmp_path / "kitti",
        train_ids=("000000", "000001"),
        val_ids=("000002",),
        protocol=PROTOCOL,
        device="cuda",
        workers=4,
        cache_frames=10,
        save_every_steps=100,
        keep_every=5,
        provenance={"fl3d.commit": "1234"},
    )
    stage = Stage(**{**vars(STAGE), "config": {**CONFIG, **config}})
    return Spec(stage, machine)


@pytest.fixture
def folder(tmp_path: Path) -> RunFolder:
    return StoreFolder(tmp_path).run(STAGE.key)


def test_a_spec_comes_back_as_it_was_written(tmp_path: Path, folder: RunFolder) -> None:
    write_spec(folder, spec(tmp_path))
    found = read_spec(folder)
    # JSON has no tuples; a protocol's identity knows no difference.
    assert found.machine.protocol.id == PROTOCOL.id
    assert found.stage == STAGE
    assert vars(found.machine) | {"protocol": PROTOCOL} == vars(spec(tmp_path).machine)


def test_a_spec_knows_its_stages_values(tmp_path: Path) -> None:
    settings = spec(tmp_path).settings
    assert (settings.seed, settings.precision, settings.compile) == (3, "bf16", True)
    assert (settings.batch_size, settings.max_boxes) == (2, 300)


def test_keys_that_older_stages_lack_have_their_defaults(tmp_path: Path) -> None:
    one = spec(tmp_path)
    old = {k: v for k, v in one.stage.config.items() if k not in ("precision", "compile")}
    settings = Spec(Stage(**{**vars(one.stage), "config": old}), one.machine).settings
    assert (settings.precision, settings.compile) == ("float32", False)


def test_frames_may_lie_elsewhere_now(tmp_path: Path) -> None:
    assert spec(tmp_path).kitti().root == tmp_path / "kitti"
    (tmp_path / "moved" / "training").mkdir(parents=True)
    assert spec(tmp_path).kitti(tmp_path / "moved").root == tmp_path / "moved"


def test_a_spec_that_is_not_there_says_who_writes_it(folder: RunFolder) -> None:
    with pytest.raises(StoreError, match=r"stage\.json: no such file; a sweep writes it"):
        read_spec(folder)


@pytest.mark.parametrize("text", ["", '{"stage": {', "{}", '{"stage": {}, "machine": {}}'])
def test_a_torn_spec_is_named(folder: RunFolder, text: str) -> None:
    folder.path.mkdir(parents=True)
    folder.spec.write_text(text)
    with pytest.raises(StoreError, match=r"stage\.json: is not a stage's spec"):
        read_spec(folder)


def test_progress_is_what_the_stage_last_said(folder: RunFolder) -> None:
    assert steps_done(folder, STAGE) == 0
    write_progress(folder, 7, 30)
    assert steps_done(folder, STAGE) == 7
    folder.progress.write_text("{")
    assert steps_done(folder, STAGE) == 0
    write_done(folder, {"step": 150})
    assert folder.is_done
    assert steps_done(folder, STAGE) == 30


def test_scores_are_kept_by_protocol(folder: RunFolder) -> None:
    assert read_scores(folder, 130, PROTOCOL.id) is None
    assert folder.protocols() == []
    scores = {"ap_3d/easy": 0.1 + 0.2, "ap_3d/moderate": 0.2, "ap_3d/hard": 0.0}
    write_scores(folder, 130, PROTOCOL, scores)
    assert read_scores(folder, 130, PROTOCOL.id) == scores
    assert read_scores(folder, 130, "another") is None
    assert folder.protocols() == [PROTOCOL.id]


@pytest.mark.parametrize("text", ["", "{", "3", "null", "[1]", '{"foo": 1}'])
def test_what_is_no_score_and_no_progress_counts_as_none(folder: RunFolder, text: str) -> None:
    for path in (folder.progress, folder.scores(130, PROTOCOL.id)):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    assert steps_done(folder, STAGE) == 0
    assert read_scores(folder, 130, PROTOCOL.id) is None


def checkpoint(folder: RunFolder, step: int, weights: bool = True) -> None:
    sha256 = save_state(folder.weights(step), {"step": step}) if weights else ""
    marker = Checkpoint(
        stage=folder.key, step=step, epoch=step // 10, lr=0.1, losses={}, seconds={}, sha256=sha256
    )
    write_marker(folder, marker)


def test_a_checkpoint_is_there_when_its_marker_is(folder: RunFolder) -> None:
    checkpoint(folder, 130)
    save_state(folder.weights(140), {"step": 140})  # killed before the marker
    assert folder.steps() == [130]
    assert read_marker(folder, 130).epoch == 13


def test_a_torn_marker_is_named(folder: RunFolder) -> None:
    checkpoint(folder, 130)
    for text in ("", '{"stage": "a"', '{"stage": "a"}', "[]"):
        folder.marker(130).write_text(text)
        with pytest.raises(CheckpointError, match=r"00000130\.json: is not a checkpoint's marker"):
            read_marker(folder, 130)


def test_the_last_state_is_the_newest_that_is_whole(folder: RunFolder) -> None:
    assert last_state(folder) is None
    for step in (130, 140, 150, 160):
        checkpoint(folder, step)
    folder.marker(160).write_text("{")
    folder.weights(150).write_bytes(folder.weights(150).read_bytes()[:-10])
    folder.weights(140).unlink()
    found = last_state(folder)
    assert found is not None
    assert found[0]["step"] == found[1].step == 130


def test_weights_that_are_kept_are_the_last_the_best_and_each_kth(
    tmp_path: Path, folder: RunFolder
) -> None:
    """Asked for now, or when the stage was trained: each 5th then."""
    write_spec(folder, spec(tmp_path))
    means = {1: 10.0, 2: 40.0, 3: 40.0, 4: 20.0, 5: 5.0, 6: 7.0, 7: 6.0}
    for epoch, mean in means.items():
        step = STAGE.start_step + 10 * epoch
        checkpoint(folder, step)
        aps = {f"ap_3d/{name}": mean for name in ("easy", "moderate", "hard")}
        write_scores(folder, step, PROTOCOL, aps)

    def kept(every: int | None) -> list[int]:
        dropped = superfluous_weights(folder, every)
        steps = {step: folder.weights(step) for step in folder.steps()}
        return [STAGE.own_epoch(step) for step, path in steps.items() if path not in dropped]

    assert kept(None) == [2, 5, 7]
    assert kept(3) == [2, 3, 5, 6, 7]


def test_files_lie_where_published_stores_have_them(folder: RunFolder) -> None:
    """Stores outlive versions of fl3d."""
    assert folder.path.parent.name == "stages"
    names = [
        folder.spec,
        folder.done,
        folder.weights(5),
        folder.marker(5),
        folder.detections(5),
        folder.scores(5, "paper-1"),
        folder.old_windows,
        folder.kept(5, "windows"),
    ]
    assert [str(path.relative_to(folder.path)) for path in names] == [
        "stage.json",
        "done.json",
        "checkpoints/00000005.pt",
        "checkpoints/00000005.json",
        "detections/00000005.parquet",
        "scores/paper-1/00000005.json",
        "windows",
        "kept/00000005-windows.bin",
    ]
    assert folder.beside("other").key == "other"
    assert StoreFolder(Path("runs")).plan("gamma") == Path("runs/plans/gamma.json")
