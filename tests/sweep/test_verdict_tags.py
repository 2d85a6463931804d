"""Verdicts in the store: a tag of every run, and sentences above the runs."""

from pathlib import Path

import pytest

from fl3d.analysis.found import sweep_verdicts
from fl3d.api.training import tell_verdicts
from fl3d.runs.finished import FinishedSweep
from fl3d.store.base import Scored
from fl3d.store.memory import MemoryRun, MemoryStore
from fl3d.sweep.verdict_tags import tag_verdicts
from tests.analysis.making import detected_sweep

FAR = 2.0  # metres: no box is found


def stored(sweep: FinishedSweep, root: Path) -> MemoryStore:
    """A store that holds a run of every trial."""
    store = MemoryStore(root)
    experiment = store.experiment(sweep.settings.experiment, "")
    for trial in sweep.trials:
        run = store.run(experiment, trial.key, sweep.protocol.id, trial.key, {}, {})
        store.log(run, Scored(trial.last_step, 0, {"epoch": 1.0}))
    return store


def tagged(store: MemoryStore) -> dict[tuple[str, str], MemoryRun]:
    return {(run.trial, run.protocol): run for run in store.runs.values()}


@pytest.mark.parametrize(("seeds", "word"), [((0, 1, 2), "worse"), ((0,), "none")])
def test_every_run_is_tagged_with_its_levels_verdict(
    seeds: tuple[int, ...], word: str, simulated: Path, tmp_path: Path
) -> None:
    points = [[f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 2) for seed in seeds]
    noise = {"0": 0.0, "2": FAR}
    sweep = detected_sweep(
        simulated, tmp_path, points, lambda trial: noise[trial.level], "detector=voxelnet"
    )
    store = stored(sweep, tmp_path)
    verdicts = sweep_verdicts(sweep, n_resamples=50)
    verdicts.loc[verdicts["level"] == "2", "verdict"] = word  # four frames would not tell
    tag_verdicts(sweep, verdicts, store)
    runs = tagged(store)
    for trial in sweep.trials:
        tags = runs[trial.key, sweep.protocol.id].tags
        assert tags["verdict"] == ("baseline" if trial.level == "0" else word)
        assert tags["verdict.seeds"] == str(len(seeds))
        assert tags["verdict.metric"] == "3d_r40/moderate"
        assert tags["gain"].startswith("" if trial.level == "0" else "-")
        told = "frames only" if word == "none" else word
        assert (
            tags["standing"]
            == {
                "0": "VoxelNet γ = 0: baseline",
                "2": f"VoxelNet γ = 2: {told}",
            }[trial.level]
        )
    first, *rest = store.notes[sweep.settings.experiment].splitlines()
    short = "1 without a verdict" if word == "none" else "γ = 2 worse"
    assert first.endswith(f" VoxelNet: {short}.")
    (row,) = (line for line in rest if line.startswith("| 2 |"))
    assert ("worse" if len(seeds) > 1 else "frames only, not training") in row
    assert "python -m fl3d gains" in "\n".join(rest)  # what stood there before stays


def test_runs_of_an_earlier_start_keep_no_verdict(simulated: Path, tmp_path: Path) -> None:
    """They would be drawn and found among those of the sweep as it is."""
    points = [[f"loss.gamma={gamma}", "seed=0"] for gamma in (0, 2)]
    sweep = detected_sweep(simulated, tmp_path, points, lambda trial: 0.0, "detector=voxelnet")
    store = stored(sweep, tmp_path)
    before = {"verdict": "worse", "gain": "-4.1", "standing": "VoxelNet γ = 5: worse"}
    other = store.run(sweep.settings.experiment, "other", sweep.protocol.id, "", before, {})
    store.log(other, Scored(1, 0, {"epoch": 1.0}))
    tag_verdicts(sweep, sweep_verdicts(sweep, n_resamples=50), store)
    tags = store.runs[other].tags
    assert tags["verdict"] == "left out"
    assert tags["standing"] == "left out: of an earlier start"
    assert tags["gain"] == ""


def test_a_sweep_whose_detections_cannot_be_read_ends_with_a_line_and_no_verdict(
    simulated: Path, tmp_path: Path
) -> None:
    """All is trained and recorded by then: nothing else is lost for it."""
    points = [[f"loss.gamma={gamma}", "seed=0"] for gamma in (0, 2)]
    sweep = detected_sweep(simulated, tmp_path, points, lambda trial: 0.0, "detector=voxelnet")
    trial = sweep.trials[0]
    trial.folder.detections(trial.last_step).write_text("torn")
    said: list[str] = []
    tell_verdicts(sweep, stored(sweep, tmp_path), said.append)
    assert len(said) == 1
    assert said[0].startswith("No verdicts: ")
