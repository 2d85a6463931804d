"""Score stored detections of a sweep again, under other protocols: no network is run."""

from __future__ import annotations

import itertools
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

import pandas as pd
from tqdm import tqdm

from fl3d.config import locate
from fl3d.data.kitti import KittiFolder
from fl3d.errors import ConfigError, StoreError, options
from fl3d.evaluation.detections import Detections, Validation, read_detections, read_validation, score
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol
from fl3d.files import write_text
from fl3d.records import Config, StagePaths
from fl3d.results import names, results_folder

KEYS = tuple(field.name for field in fields(Protocol) if field.name not in ("name", "overlaps"))


def rescore(config: Config, changes: Mapping[str, Sequence[Any]]) -> pd.DataFrame:
    """Scores of the last models of a sweep under every combination of changed protocol values.

    Args:
        config: names the sweep, its data and profile, and the protocol that is changed.
        changes: values of protocol keys, such as ``{"score_threshold": [0, 0.8]}``.

    Returns:
        a row a trial and combination: detector, gamma, seed, step, protocol, the changed keys (as text), every AP.

    Raises:
        ConfigError: a key that no protocol has.
        StoreError: the sweep was never run here.
    """
    for key in changes:
        if key not in KEYS:
            raise ConfigError(f"{key}: no key of a protocol. {options(key, KEYS)}")
    trials = finished_trials(config)
    combinations = [dict(zip(changes, values, strict=True)) for values in itertools.product(*changes.values())]
    protocols = [Protocol(**{**config["protocol"], **combination}) for combination in combinations]
    seen: dict[tuple[str, ...], Validation] = {}
    rows = []
    for paths, (combination, protocol) in tqdm(
        list(itertools.product(trials, zip(combinations, protocols, strict=True))), unit="score", disable=None
    ):
        changed = {name: _plain(value) for name, value in combination.items()}
        scores = score(*stored_with_validation(paths, seen), protocol)
        rows.append({**front(paths), "protocol": protocol.id, **changed, **scores})
    return pd.DataFrame(rows).sort_values(["detector", "gamma", "seed"], kind="stable").reset_index(drop=True)


def finished_trials(config: Config) -> list[StagePaths]:
    """Last stages of the finished trials of a sweep.

    Raises:
        StoreError: the sweep was never run here, or none of its trials is done.
    """
    root = Path(config["store"]["root"])
    plan = names(config).plan(root)
    if not plan.exists():
        raise StoreError(f"{plan}: no such file; run the sweep first")
    paths = [StagePaths(root / "stages" / trial["key"]) for trial in json.loads(plan.read_text())["trials"]]
    done = [one for one in paths if one.done.exists()]
    if not done:
        raise StoreError(f"{plan}: none of its trials is done")
    return done


def front(paths: StagePaths) -> dict[str, Any]:
    """What a trial is: detector, gamma, form of the loss, seed and last step."""
    config = json.loads(paths.spec.read_text())["stage"]["config"]
    detector = locate(config["detector"]["_target_"], "detector._target_").NAME
    gamma = float(config["loss"].get("gamma", 0.0))
    normalize = float(config["loss"].get("normalize", True))
    step = paths.steps()[-1]
    return {"detector": detector, "gamma": gamma, "normalize": normalize, "seed": config["seed"], "step": step}


def stored_with_validation(
    paths: StagePaths, seen: dict[tuple[str, ...], Validation], step: int | None = None
) -> tuple[Detections, Validation]:
    """Detections of a trial's checkpoint and the labels of their frames.

    Args:
        paths: of the trial's last stage.
        seen: keeps labels that were read.
        step: of the checkpoint; None: the last.
    """
    spec = json.loads(paths.spec.read_text())
    step = paths.steps()[-1] if step is None else step
    detections = read_detections(stage_at(paths, step).detections(step))
    if detections.frame_ids not in seen:
        data = spec["stage"]["config"]["data"]
        folder = KittiFolder(Path(spec["machine"]["data_root"]), data["crop"], data["calibration"])
        seen[detections.frame_ids] = read_validation(folder, detections.frame_ids)
    return detections, seen[detections.frame_ids]


def stage_at(paths: StagePaths, step: int) -> StagePaths:
    """The stage of a trial that holds a checkpoint: its last one, or one that it goes on from.

    Raises:
        StoreError: none does.
    """
    holder: StagePaths | None = paths
    while holder is not None and step not in holder.steps():
        parent = json.loads(holder.spec.read_text())["stage"]["parent"]
        holder = StagePaths(holder.folder.parent / parent) if parent else None
    if holder is None:
        raise StoreError(f"{paths.folder}: no checkpoint of it or of what it goes on from is at step {step}")
    return holder


def rescored_to_markdown(scores: pd.DataFrame, changes: Sequence[str], metric: str) -> str:
    """AP over gamma (rows) and changed values (columns), a table for each detector; seeds are averaged."""
    parts = []
    for detector, own in scores.groupby("detector"):
        wide = own.pivot_table(index="gamma", columns=list(changes), values=metric, aggfunc="mean", sort=False)
        heads = [", ".join(c) if isinstance(c, tuple) else str(c) for c in wide.columns]
        lines = [f"**{detector}**, {metric}, last models; columns: {', '.join(changes)}", ""]
        lines += ["| γ | " + " | ".join(heads) + " |", "|---|" + "---:|" * len(heads)]
        lines += [
            f"| {gamma:g} | " + " | ".join(f"{ap:.2f}" for ap in row) + " |"
            for gamma, row in zip(wide.index, wide.to_numpy(), strict=True)
        ]
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def _plain(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) else str(value)


def rescore_and_write(
    config: Config, changes: Mapping[str, Sequence[Any]], metric: str, say: Callable[[str], None] = print
) -> None:
    """Score again, print AP over gamma and changed values, and write all APs beside the sweep's tables.

    Args:
        config: see ``rescore``.
        changes: see ``rescore``.
        metric: such as ``3d/moderate`` (R11) or ``3d_r40/moderate``.
        say: prints a line for the user.
    """
    possible = [f"{m}{average}/{level}" for m in METRICS for average in ("", "_r40") for level in DIFFICULTIES]
    if metric not in possible:
        raise ConfigError(f"--metric {metric}: {options(metric, possible)}")
    scores = rescore(config, changes)
    overlaps = " / ".join(f"{v:g}" for v in config["protocol"]["overlaps"]["Car"])
    say(f"Car, protocol {config['protocol']['name']}, overlaps {overlaps} (image / BEV / 3D)\n")
    say(rescored_to_markdown(scores, list(changes), f"ap_{metric}"))
    called = f"rescored_{config['sweep']['name']}_{config['protocol']['name']}_{'_'.join(changes)}.csv"
    path = results_folder(config) / "tables" / called
    write_text(path, scores.to_csv(index=False, lineterminator="\n"))
    say(f"\nWritten to {path}, all APs.")
