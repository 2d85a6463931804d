"""Where a number comes from: the chain from a trial's AP to its run, checkpoint, files and digests."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import pandas as pd

from fl3d.core.digests import file_digest
from fl3d.core.errors import DataError
from fl3d.core.plurals import several
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.results import results_digest
from fl3d.evaluation.scoring import score
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec


def trace(sweep: FinishedSweep, row: pd.Series, column: str, run: str) -> Iterator[str]:
    """Lines that lead from an AP to its files; each digest is checked, and the AP is computed again.

    Args:
        sweep: its run folders must be at hand.
        row: of the sweep's scores.
        column: of the AP.
        run: id of the trial's run in the store.
    """
    trial = sweep.trial(str(row["trial"]))
    step = int(row["step"])
    holder = trial.holder(step)
    marker = read_marker(holder, step)
    spec = read_spec(holder)
    yield f"  trial       {trial.key}, seed {trial.seed}: {' '.join(trial.plan.overrides)}"
    yield f"  run         {run}, step {step}: {row[column]!r}"
    for folder in trial.folders:
        yield from _stage(folder)
        if folder == holder:
            break
    if "results" in marker.made_by:
        yield f"  checkpoint  the program's own, in {holder.work}"
        yield f"  results     {_results(holder, marker.made_by, spec.machine.val_ids)}"
    else:
        yield f"  checkpoint  {_checked(holder.weights(step), marker.sha256)}"
    yield f"  detections  {_checked(holder.detections(step), marker.detections_sha256)}"
    yield f"  scores      {holder.scores(step, sweep.protocol.id)}"
    again = score(read_detections(holder.detections(step)), sweep.validation, sweep.protocol)[
        column
    ]
    same = "the same" if again == row[column] else "NOT THE SAME"
    yield f"  scored now  {again!r}: {same}"
    yield f"  data        {sweep.kitti().root}, {len(spec.machine.val_ids)} validation frames"


def _stage(folder: RunFolder) -> Iterator[str]:
    spec = read_spec(folder)
    stage = spec.stage
    marker = read_marker(folder, folder.steps()[-1])
    made = marker.made_by
    dirty = f" + uncommitted changes {made['fl3d.diff']}" if "fl3d.diff" in made else ""
    epochs = several(stage.epochs, "epoch")
    yield f"  stage       {stage.key}: {epochs} from step {stage.start_step}"
    yield f"              commit {marker.commit[:12]}{dirty}; {made.get('fl3d.packages', '')}"
    if "program" in made:
        yield f"              program {made['program.folder']}, {made['program']}"
    yield f"              on {made.get('fl3d.machine', 'unknown')}, device {spec.machine.device}"


def _checked(path: Path, sha256: str) -> str:
    if not path.exists():
        return f"{path}: not kept (sha256 {sha256[:16]})"
    if not sha256:
        return f"{path}: its digest was not recorded"
    return f"{path}: sha256 {sha256[:16]}, " + (
        "matches" if file_digest(path) == sha256 else "DOES NOT MATCH"
    )


def _results(holder: RunFolder, made_by: Mapping[str, str], ids: Sequence[str]) -> str:
    """Whether the result files of a checkpoint are what they were when it was scored."""
    folder, sha256 = holder.here(made_by["results"]), made_by["results.sha256"]
    try:
        found = results_digest(folder, ids)
    except DataError:
        return f"{folder}: not kept (sha256 {sha256[:16]})"
    return f"{folder}: sha256 {sha256[:16]}, " + (
        "matches" if found == sha256 else "DOES NOT MATCH"
    )
