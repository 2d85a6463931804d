"""From run folders to the store: each checkpoint once for every trial, whatever goes wrong."""

import os
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from fl3d.core.errors import StoreDown
from fl3d.core.records import Checkpoint, Trial
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.validation import Validation
from fl3d.runs.checkpoints import load_state, save_state, write_marker
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.spec import write_done, write_scores
from fl3d.store.base import RunStatus, Scored
from fl3d.store.memory import MemoryRun, MemoryStore
from fl3d.sweep.recorder import Recorder, Subject, run_name
from fl3d.sweep.scoreboard import Scoreboard
from fl3d.sweep.sweepers.base import Standing, TrialState

PROTOCOL = Protocol("test", "A", {"Car": (0.7, 0.7, 0.7)}, 0.5, 0.01, "standup", 10)
NO_FRAMES = Validation((), (), (), ())
# Its value at each step; the best is the first of the trial's own.
VALUES = {2: 10.0, 4: 20.0, 6: 50.0, 8: 30.0}


class FlakyStore(MemoryStore):
    """Can be taken down, and remembers the calls."""

    def __init__(self, root: Path) -> None:
        super().__init__(root)
        self.is_down = False
        self.logged: list[tuple[str, int]] = []
        self.ended: list[str] = []

    def log(self, run: str, scored: Scored) -> None:
        self._check()
        self.logged.append((run, scored.step))
        super().log(run, scored)

    def log_files(self, run: str, files: Iterable[Path], folder: str) -> None:
        self._check()
        super().log_files(run, files, folder)

    def end(self, run: str, status: RunStatus) -> None:
        self._check()
        self.ended.append(run)
        super().end(run, status)

    def _check(self) -> None:
        if self.is_down:
            raise StoreDown("nobody answers")


class Bench:
    """A store folder of two trials that share a warm-up, and a recorder over it."""

    def __init__(self, root: Path, factor: str = "loss.gamma") -> None:
        self.layout = StoreFolder(root)
        self.store = FlakyStore(root)
        self.said: list[str] = []
        self.drawn: list[tuple[str, int]] = []
        self.subject = Subject(
            experiment="sweep",
            factor=(factor,),
            best_among="last",
            dataset=("simulated-tiny", "abc"),
            data_root=root / "data",
            tags={"fl3d.commit": "1234"},
            files={"uncommitted.patch": "changes"},
            draw=self._draw,
        )
        scores = Scoreboard(self.layout, NO_FRAMES, PROTOCOL)
        self.recorder = Recorder(self.store, scores, self.subject, self.said.append)
        self.trials = [trial("focal-0", "0"), trial("focal-2", "2")]

    def _draw(self, trial: Trial, step: int, folder: Path) -> list[Path]:
        self.drawn.append((trial.key, step))
        picture = folder / "picture.png"
        picture.write_bytes(b"")
        return [picture]

    def checkpoint(self, key: str, step: int) -> None:
        """As a stage leaves it."""
        folder = self.layout.run(key)
        values = {f"ap_3d/{name}": VALUES[step] for name in ("easy", "moderate", "hard")}
        write_scores(folder, step, PROTOCOL, values)
        save_state(folder.weights(step), {"model": {}, "optimizer": {}, "step": step})
        checkpoint = Checkpoint(
            stage=key,
            step=step,
            epoch=step // 2,
            lr=0.1,
            losses={"total": 3.0},
            seconds={"training": 7.0},
            sha256="",
            time_ms=1000 + step,
        )
        write_marker(folder, checkpoint)

    def trained(self) -> None:
        """All stages to their ends."""
        for key, steps in {"warmup": (2, 4), "focal-0": (6, 8), "focal-2": (6, 8)}.items():
            for step in steps:
                self.checkpoint(key, step)

    def sync(self, *states: TrialState) -> bool:
        return self.recorder.sync(self.standings(*states))

    def standings(self, *states: TrialState) -> dict[str, Standing]:
        return {
            one.key: Standing(one, state, {}, 2)
            for one, state in zip(self.trials, states, strict=True)
        }

    def run(self, number: int) -> MemoryRun:
        return self.store.runs[f"sweep/{self.trials[number].key}/{PROTOCOL.id}"]


def trial(key: str, level: str, **loss: Any) -> Trial:
    return Trial(
        key=key,
        overrides=("detector=voxelnet", f"loss.gamma={level}"),
        values={"detector": "voxelnet", "loss.gamma": float(level)},
        config={
            "loss": loss or {"_target_": "fl3d.losses.DetectionLoss", "gamma": float(level)},
            "seed": 3,
            "protocol": {"name": "test", "score_threshold": 0.5},
            "device": "cpu",
        },
        stages=("warmup", key),
        first_own_step=4,
        detector="VoxelNet",
        group="VoxelNet",
        level=level,
        seed=3,
    )


RUNNING = TrialState.RUNNING
DONE = TrialState.DONE


@pytest.fixture
def bench(tmp_path: Path) -> Bench:
    return Bench(tmp_path)


def test_each_checkpoint_is_logged_once_for_every_trial_it_belongs_to(bench: Bench) -> None:
    bench.checkpoint("warmup", 2)
    assert bench.sync(RUNNING, RUNNING)
    assert [sorted(bench.run(n).scores) for n in (0, 1)] == [[2], [2]]
    bench.checkpoint("warmup", 4)
    bench.checkpoint("focal-2", 6)
    for _ in range(3):
        assert bench.sync(RUNNING, RUNNING)
    assert [sorted(bench.run(n).scores) for n in (0, 1)] == [[2, 4], [2, 4, 6]]
    assert len(bench.store.logged) == len(set(bench.store.logged)) == 5


def test_what_an_earlier_start_has_logged_is_not_logged_again(bench: Bench) -> None:
    bench.checkpoint("warmup", 2)
    bench.sync(RUNNING, RUNNING)
    bench.checkpoint("warmup", 4)
    again = Recorder(bench.store, bench.recorder.scores, bench.subject, bench.said.append)
    again.sync(bench.standings(RUNNING, RUNNING))
    assert [step for _, step in bench.store.logged] == [2, 2, 4, 4]


def test_a_score_carries_its_checkpoints_time_and_what_training_told(bench: Bench) -> None:
    bench.checkpoint("warmup", 4)
    bench.sync(RUNNING, RUNNING)
    scored = bench.run(1).scores[4]
    assert scored.time_ms == 1004  # the same row, whenever it is logged
    assert scored.values == {
        "ap_3d/easy": 20.0,
        "ap_3d/moderate": 20.0,
        "ap_3d/hard": 20.0,
        "mean_3d": 20.0,
        "epoch": 2,
        "train/lr": 0.1,
        "loss/total": 3.0,
        "seconds/training": 7.0,
    }


def test_a_shared_beginning_is_one_curve(bench: Bench) -> None:
    """Its scores belong to every trial; what is drawn over steps has them once."""
    bench.trained()
    bench.sync(TrialState.DONE, TrialState.DONE)
    name = "curve/ap_3d/moderate"
    drawn = [
        {step: one.values[name] for step, one in bench.run(n).scores.items() if name in one.values}
        for n in (0, 1)
    ]
    assert drawn == [VALUES, {6: 50.0, 8: 30.0}]


def test_a_run_says_what_its_trial_is(bench: Bench) -> None:
    bench.sync(RUNNING, RUNNING)
    run = bench.run(1)
    assert run.name == "VoxelNet gamma=2 seed=3"
    assert run.dataset == ("simulated-tiny", "abc")
    assert run.tags == {
        "detector": "VoxelNet",
        "factor": "loss.gamma",
        "group": "VoxelNet",
        "level": "2",
        "standing": "VoxelNet gamma=2",
        "seed": "3",
        "fl3d.overrides": "detector=voxelnet loss.gamma=2",
        "fl3d.stages": "warmup focal-2",
        "fl3d.first_own_step": "4",
        "fl3d.data_digest": "abc",
        "fl3d.commit": "1234",
    }
    assert run.params == {
        "loss._target_": "fl3d.losses.DetectionLoss",
        "loss.gamma": 2.0,
        "seed": 3,
        "protocol.name": "test",
        "protocol.score_threshold": 0.5,
    }


def test_no_gamma_is_told_of_a_loss_that_has_none(tmp_path: Path) -> None:
    bench = Bench(tmp_path, factor="loss.margin")
    hinge = replace(
        trial("focal-0", "0.1", _target_="mine.Hinge", margin=0.1),
        overrides=("loss.margin=0.1",),
        values={"loss.margin": 0.1},
    )
    bench.trials = [hinge]
    bench.sync(RUNNING)
    run = bench.run(0)
    assert run.name == "VoxelNet margin=0.1 seed=3"
    assert run.tags["level"] == "0.1"
    told = [run.name, *run.tags, *run.tags.values(), *run.params]
    assert not any("gamma" in one or "BCE" in one for one in told)


@pytest.mark.parametrize(
    ("factor", "level", "name"),
    [
        (("loss.gamma",), "0.5", "VoxelNet gamma=0.5 seed=3"),
        (("loss.alpha", "loss.beta"), "alpha=1, beta=5", "VoxelNet alpha=1, beta=5 seed=3"),
        ((), "default", "VoxelNet default seed=3"),
    ],
)
def test_a_run_is_called_by_group_level_and_seed(
    factor: tuple[str, ...], level: str, name: str
) -> None:
    assert run_name(replace(trial("focal-0", "0"), level=level), factor) == name


def test_a_trial_that_is_done_has_its_last_and_its_best_model(bench: Bench, tmp_path: Path) -> None:
    bench.trained()
    assert bench.sync(DONE, RUNNING)
    run = bench.run(0)
    assert run.status is RunStatus.DONE
    assert {name: tags["step"] for name, tags in run.models.items()} == {"last": "8", "best": "6"}
    assert run.tags["last_step"] == "8"
    assert run.tags["best_step"] == "6"
    assert run.files == {
        "": ["config.json", "uncommitted.patch"],
        "pictures": ["picture.png"],
    }
    assert bench.drawn == [("focal-0", 8)]
    assert bench.run(1).status is RunStatus.RUNNING
    bench.sync(DONE, RUNNING)
    assert len(bench.drawn) == 1  # once


def test_best_may_look_at_the_whole_curve(bench: Bench) -> None:
    values = {**VALUES, 4: 90.0}
    bench.recorder.subject = replace(bench.subject, best_among="all")
    bench.trained()
    folder = bench.layout.run("warmup")
    aps = {f"ap_3d/{name}": values[4] for name in ("easy", "moderate", "hard")}
    write_scores(folder, 4, PROTOCOL, aps)
    bench.sync(DONE, RUNNING)
    best = bench.run(0).models["best"]
    assert (best["stage"], best["step"]) == ("warmup", "4")


def test_a_model_is_weights_alone_and_may_have_lost_them(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of a stage of an earlier sweep, whose best was another under another protocol."""
    held: dict[str, Mapping[str, Any] | None] = {}

    def log_model(self: MemoryStore, *arguments: Any) -> str:
        _, _, name, files, *_ = arguments
        weights = [file for file in files if file.suffix == ".pt"]
        held[name] = load_state(weights[0]) if weights else None
        return name

    monkeypatch.setattr(MemoryStore, "log_model", log_model)
    bench.trained()
    bench.layout.run("focal-0").weights(6).unlink()
    bench.sync(DONE, RUNNING)
    assert held == {"last": {"model": {}, "stage": "focal-0", "step": 8}, "best": None}


@pytest.mark.parametrize(
    ("state", "status"),
    [(TrialState.FAILED, RunStatus.FAILED), (TrialState.STOPPED, RunStatus.STOPPED)],
)
def test_a_trial_that_ends_before_its_time_closes_its_run(
    bench: Bench, state: TrialState, status: RunStatus
) -> None:
    bench.checkpoint("warmup", 2)
    bench.sync(RUNNING, RUNNING)
    bench.sync(state, RUNNING)
    assert bench.run(0).status is status
    assert bench.run(1).status is RunStatus.RUNNING
    assert bench.run(0).models == {}
    bench.sync(state, RUNNING)
    assert len(bench.store.ended) == 1  # once


def test_an_interrupt_closes_what_is_not_done(bench: Bench) -> None:
    bench.trained()
    bench.sync(DONE, RUNNING)
    bench.recorder.interrupt()
    assert bench.run(0).status is RunStatus.DONE
    assert bench.run(1).status is RunStatus.STOPPED
    again = Recorder(bench.store, bench.recorder.scores, bench.subject, bench.said.append)
    again.sync(bench.standings(DONE, RUNNING))  # the next start opens it again
    assert bench.run(1).status is RunStatus.RUNNING
    assert bench.drawn == [("focal-0", 8)]  # and leaves what is done alone


def test_an_interrupt_while_the_store_is_down_does_not_hang(bench: Bench) -> None:
    bench.sync(RUNNING, RUNNING)
    bench.store.is_down = True
    bench.recorder.interrupt()
    assert bench.run(0).status is RunStatus.RUNNING


def test_while_the_store_is_down_scores_wait_on_disk(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fl3d.sweep.recorder.RETRY_SECONDS", 0.0)
    bench.checkpoint("warmup", 2)
    bench.store.is_down = True
    for _ in range(3):
        assert not bench.sync(RUNNING, RUNNING)
    bench.trained()
    assert not bench.sync(DONE, DONE)
    assert bench.said == [
        "The store is down; training continues, scores wait on disk. nobody answers"
    ]
    bench.store.is_down = False
    assert bench.sync(DONE, DONE)
    assert bench.said[1:] == ["The store is back; what waited is logged."]
    assert [sorted(bench.run(n).scores) for n in (0, 1)] == [[2, 4, 6, 8]] * 2
    assert [bench.run(n).status for n in (0, 1)] == [RunStatus.DONE] * 2


def test_a_store_that_is_down_is_not_asked_at_every_step(bench: Bench) -> None:
    """Each call may take seconds, and stages wait to be started."""
    bench.checkpoint("warmup", 2)
    bench.store.is_down = True
    assert not bench.sync(RUNNING, RUNNING)
    bench.store.is_down = False
    assert not bench.sync(RUNNING, RUNNING)
    assert bench.run(0).scores == {}


def tear_marker(bench: Bench) -> Path:
    path = bench.layout.run("focal-0").marker(6)
    path.write_text(path.read_text()[:20])
    return path


def tear_detections(bench: Bench) -> Path:
    """Whose scores are not known yet, as under another protocol."""
    folder = bench.layout.run("focal-0")
    folder.scores(6, PROTOCOL.id).unlink()
    folder.detections(6).parent.mkdir()
    folder.detections(6).write_bytes(b"PAR1")
    return folder.detections(6)


def tear_weights(bench: Bench) -> Path:
    path = bench.layout.run("focal-0").weights(8)
    path.write_bytes(path.read_bytes()[:-100])
    return path


@pytest.mark.parametrize("tear", [tear_marker, tear_detections, tear_weights])
def test_a_torn_file_stops_its_trial_alone(bench: Bench, tear: Callable[[Bench], Path]) -> None:
    bench.trained()
    path = tear(bench)
    for _ in range(2):
        assert bench.sync(DONE, DONE)
    assert len(bench.said) == 1  # once
    assert bench.said[0].startswith("focal-0: not recorded any further: ")
    assert str(path) in bench.said[0]
    assert bench.run(0).status is RunStatus.FAILED
    assert bench.run(1).status is RunStatus.DONE
    assert sorted(bench.run(1).scores) == [2, 4, 6, 8]
    bench.recorder.interrupt()
    assert bench.run(0).status is RunStatus.FAILED


def test_tables_and_figures_are_put_beside_every_trial(bench: Bench, tmp_path: Path) -> None:
    bench.sync(RUNNING, RUNNING)
    bench.recorder.attach([tmp_path / "table.md"], "tables")
    assert [bench.run(n).files for n in (0, 1)] == [{"tables": ["table.md"]}] * 2
    assert bench.recorder.runs == list(bench.store.runs)


def test_what_is_read_of_a_trial_is_let_go_when_it_is_recorded_and_of_what_others_share_is_kept(
    bench: Bench,
) -> None:
    """Asked for again, it is read again, which a changed file shows."""
    bench.trained()
    bench.sync(DONE, RUNNING)
    values = {f"ap_3d/{name}": 1.0 for name in ("easy", "moderate", "hard")}
    for key in ("warmup", "focal-0", "focal-2"):
        for step in bench.layout.run(key).steps():
            write_scores(bench.layout.run(key), step, PROTOCOL, values)
    scores = bench.recorder.scores
    expected = {("warmup", 4): 20.0, ("focal-0", 8): 1.0, ("focal-2", 8): 30.0}
    assert {of: scores.aps(*of)["ap_3d/easy"] for of in expected} == expected


def test_a_folder_that_is_listed_late_is_waited_for_when_its_trial_is_done(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its last checkpoint would be its last model, and its score would be missing for ever."""
    bench.trained()
    for key in ("warmup", "focal-0", "focal-2"):
        write_done(bench.layout.run(key), {"step": 4 if key == "warmup" else 8})
    steps, looks = RunFolder.steps, []

    def late(folder: RunFolder) -> list[int]:
        looks.append(folder.key)
        found = steps(folder)
        return found if looks.count(folder.key) > 2 else found[:-1]

    monkeypatch.setattr(RunFolder, "steps", late)
    monkeypatch.setattr("fl3d.sweep.scoreboard.LIST_AGAIN_SECONDS", 0.01)
    assert bench.sync(DONE, DONE)
    for number in range(2):
        assert set(bench.run(number).scores) == {2, 4, 6, 8}


def test_a_checkpoint_of_the_same_tick_as_the_one_before_is_seen(bench: Bench) -> None:
    """The folder's time does not tell them apart."""
    bench.checkpoint("warmup", 2)
    folder = bench.layout.run("warmup").marker(0).parent
    before = folder.stat()
    assert bench.recorder.scores.steps("warmup") == [2]
    bench.checkpoint("warmup", 4)
    os.utime(folder, ns=(before.st_atime_ns, before.st_mtime_ns))
    assert bench.recorder.scores.steps("warmup") == [2, 4]


def test_tables_stay_on_disk_while_the_store_is_down(bench: Bench, tmp_path: Path) -> None:
    """All is trained and logged: an outage as a sweep ends is no error."""
    bench.trained()
    bench.sync(DONE, DONE)
    bench.store.is_down = True
    bench.recorder.attach([tmp_path / "table.md"], "results")
    assert bench.said[-1].startswith("The store is down: tables and figures are on disk")
    bench.store.is_down = False
    bench.recorder.attach([tmp_path / "table.md"], "results")
    assert bench.run(0).files["results"] == ["table.md"]
