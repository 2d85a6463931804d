"""What must hold of a store when all is over."""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Iterator, Sequence
from pathlib import Path

from fl3d.core.files import TEMPORARY
from fl3d.runs.cleaning import UPLOADING
from fl3d.runs.layout import ASIDE

NOISE = (
    "-wal",
    "-shm",
    ".lease",
    "lease.json",
    ".guard",
    ".log",
    "uncommitted.patch",
)  # come and go
MOST = 5  # faults of a kind that are told


def contents(folder: Path) -> dict[str, bytes]:
    """Every file of a folder, hidden ones too."""
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def differing(
    expected: dict[str, bytes], found: dict[str, bytes], but: Sequence[str] = ()
) -> list[str]:
    """Names of files that are missing, too many or of other bytes; not of those that have a part of ``but``."""
    names = [name for name in sorted({*expected, *found}) if not name.endswith(".tmp")]
    return [
        name
        for name in names
        if expected.get(name) != found.get(name) and not any(part in name for part in but)
    ]


def checkpoints(root: Path) -> set[str]:
    """Checkpoints that are whole, as ``stage/step``."""
    return {f"{p.parts[-3]}/{p.stem}" for p in (root / "stages").glob("*/checkpoints/*.json")}


def doubled_or_lost(root: Path) -> list[str]:
    """Scores of finished checkpoints that the store does not hold exactly once, and runs that are doubled."""
    query = """SELECT r.experiment_id || ' ' || t.value AS trial, m.step, m.key, COUNT(*)
               FROM metrics m JOIN tags t USING (run_uuid) JOIN runs r USING (run_uuid)
               WHERE t.key = 'fl3d.stages' AND m.key LIKE 'ap_%' AND r.lifecycle_stage = 'active'
               GROUP BY trial, m.step, m.key"""
    found = {(stages, step, key): count for stages, step, key, count in _rows(root, query)}
    keys = {key for _, _, key in found}
    wrong = [f"score {where} stands {count} times" for where, count in found.items() if count != 1]
    for stages in {stages for stages, _, _ in found}:
        for checkpoint in checkpoints(root):
            stage, step = checkpoint.split("/")
            if stage in stages.split():
                lost = [key for key in keys if (stages, int(step), key) not in found]
                wrong += [f"score {checkpoint} {key} is missing" for key in lost]
    if len(wrong) > MOST:
        wrong = [*wrong[:MOST], f"and {len(wrong) - MOST} more scores"]
    models = """SELECT source_run_id, name, COUNT(*) FROM logged_models
                WHERE lifecycle_stage = 'active' GROUP BY source_run_id, name"""
    wrong += [
        f"model {run} {name} stands {n} times" for run, name, n in _rows(root, models) if n != 1
    ]
    return wrong


def still_running(root: Path) -> list[str]:
    """Runs that MLflow holds to be running, and trials of studies likewise."""
    runs = "SELECT run_uuid FROM runs WHERE status = 'RUNNING' AND lifecycle_stage = 'active'"
    return [f"run {run} is RUNNING" for (run,) in _rows(root, runs)]


def running_trials(root: Path) -> list[str]:
    """Trials of studies that are neither done, failed nor pruned."""
    import optuna

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    found = []
    for path in sorted((root / "studies").glob("*.log")):
        backend = optuna.storages.journal.JournalFileBackend(str(path))
        storage = optuna.storages.JournalStorage(backend)
        for study in storage.get_all_studies():
            for trial in storage.get_all_trials(study._study_id):
                if not trial.state.is_finished():
                    found.append(f"study {path.stem}: trial {trial.number} is {trial.state.name}")
    return found


def left_over(root: Path, whole: Path) -> list[str]:
    """Files of a store that an undisturbed one does not have, and that `clean` would never delete."""
    known = {_kind(path, whole) for path in whole.rglob("*")}
    found = []
    for path in root.rglob("*"):
        is_temporary = path.match(TEMPORARY) or path.match(UPLOADING)
        is_aside = any(ASIDE in part for part in path.parts)
        is_known = (
            is_temporary or is_aside or path.name.endswith(NOISE) or _kind(path, root) in known
        )
        if path.is_file() and not is_known:
            found.append(f"{path.relative_to(root)} is left over")
    return found


def temporary(folder: Path) -> list[Path]:
    """Temporary files below a folder."""
    return list(folder.rglob("*.tmp"))


def _kind(path: Path, root: Path) -> str:
    """A path without what differs between two stores: the random names of MLflow's artifacts."""
    parts = path.relative_to(root).parts
    if parts[:1] == ("artifacts",):
        kept = [part for part in parts if not _is_random(part)]
        return "/".join(kept)
    return "/".join(parts)


def _is_random(part: str) -> bool:
    text = part.removeprefix("m-")
    return len(text) == 32 and all(letter in "0123456789abcdef" for letter in text)


def _rows(root: Path, query: str) -> Iterator[tuple]:  # type: ignore[type-arg]
    connection = sqlite3.connect(root / "mlflow.db")
    try:
        yield from connection.execute(query).fetchall()
    finally:
        connection.close()


def holder(lease: Path) -> int | None:
    """Process that a lease names."""
    try:
        return int(json.loads(lease.read_text())["pid"])
    except (OSError, ValueError, KeyError):
        return None
