"""Whether the store's digits come out again, from stored detections and from weights."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import pandas as pd
from tqdm import tqdm

from fl3d.core.errors import CheckpointError, DataError
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.scoring import score
from fl3d.inference.scores import detect_again
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import RunFolder


@dataclass(frozen=True)
class Verified:
    """What a second scoring has shown.

    Args:
        checkpoints: that were scored again.
        from_weights: of them, those whose network was run again.
        metrics: compared of each.
        wrong: a sentence for each checkpoint that came out differently, or could not be read.
    """

    checkpoints: int
    from_weights: int
    metrics: int
    wrong: tuple[str, ...]


def verify(sweep: FinishedSweep, from_weights: bool) -> Verified:
    """Score every stored checkpoint of a sweep again, and compare with what the store holds, digit by digit.

    Args:
        sweep: its run folders must be at hand.
        from_weights: also run the network of every checkpoint whose weights were kept.
    """
    columns = [str(name) for name in sweep.scores if str(name).startswith("ap_")]
    checkpoints = list(checkpoints_of(sweep))
    wrong: list[str] = []
    n_weights = 0
    for folder, step, row in tqdm(checkpoints, unit="checkpoint", disable=None):
        where = f"{folder.key} step {step}"
        said: list[str] = []
        try:
            again = score(
                read_detections(folder.detections(step)), sweep.validation, sweep.protocol
            )
            said += _differences(where, row, again, columns)
            if from_weights and folder.weights(step).exists():
                n_weights += 1
                found = detect_again(folder, step, sweep.kitti().root)
                again = score(found, sweep.validation, sweep.protocol)
                said += _differences(f"{where}, from its weights", row, again, columns)
        except (CheckpointError, DataError) as error:
            said.append(f"  {error}")
        if said:
            wrong.append("\n".join(said))
    return Verified(len(checkpoints), n_weights, len(columns), tuple(wrong))


def checkpoints_of(sweep: FinishedSweep) -> Iterator[tuple[RunFolder, int, pd.Series]]:
    """Each checkpoint once, with a row of the store's scores: a shared stage's stand under several trials."""
    seen: set[tuple[str, int]] = set()
    for trial in sweep.trials:
        own = sweep.scores[sweep.scores["trial"] == trial.key]
        for _, row in own.iterrows():
            step = int(row["step"])
            folder = trial.holder(step)
            if (folder.key, step) not in seen:
                seen.add((folder.key, step))
                yield folder, step, row


def _differences(
    where: str, row: pd.Series, again: Mapping[str, float], columns: list[str]
) -> list[str]:
    wrong = [
        f"{name} {row[name]!r} is {again[name]!r}" for name in columns if row[name] != again[name]
    ]
    return [f"  {where}: {', '.join(wrong[:3])}{' ...' if len(wrong) > 3 else ''}"] if wrong else []
