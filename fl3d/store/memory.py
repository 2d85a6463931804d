"""A store that lives as long as its process: for tests, and for what needs no database."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd

from fl3d.store.base import RunStatus, Scored, Store, is_score


@dataclass
class MemoryRun:
    """A run in memory; see ``store.base.Store.run``."""

    experiment: str
    trial: str
    protocol: str
    name: str
    tags: dict[str, str]
    params: dict[str, object]
    status: RunStatus = RunStatus.RUNNING
    scores: dict[int, Scored] = field(default_factory=dict)
    files: dict[str, list[str]] = field(default_factory=dict)
    models: dict[str, dict[str, str]] = field(default_factory=dict)
    dataset: tuple[str, str] | None = None


class MemoryStore(Store):
    """Holds everything in dictionaries.

    Args:
        root: folder of the run folders whose scores it holds.
    """

    exists = True
    is_for_one_machine = True

    def __init__(self, root: Path) -> None:
        self.root = root
        self.notes: dict[str, str] = {}
        self.runs: dict[str, MemoryRun] = {}

    def open(self) -> None:
        """Nothing is needed."""

    def experiment(self, name: str, note: str) -> str:
        self.notes[name] = note
        return name

    def run(
        self,
        experiment: str,
        trial: str,
        protocol: str,
        name: str,
        tags: Mapping[str, str],
        params: Mapping[str, object],
    ) -> str:
        key = f"{experiment}/{trial}/{protocol}"
        made = MemoryRun(experiment, trial, protocol, name, dict(tags), dict(params))
        run = self.runs.setdefault(key, made)
        if run.status is not RunStatus.DONE:
            run.status = RunStatus.RUNNING
        return key

    def log(self, run: str, scored: Scored) -> None:
        self.runs[run].scores.setdefault(scored.step, scored)

    def logged_steps(self, run: str) -> set[int]:
        return set(self.runs[run].scores)

    def link_dataset(self, run: str, name: str, digest: str, root: Path) -> None:
        self.runs[run].dataset = (name, digest)

    def log_model(
        self,
        experiment: str,
        run: str,
        name: str,
        files: Sequence[Path],
        tags: Mapping[str, str],
        scored: Scored,
        dataset: tuple[str, str],
    ) -> str:
        self.runs[run].models[name] = dict(tags)
        return f"{run}/{name}"

    def models(self, experiment: str) -> set[tuple[str, str]]:
        return {
            (key, name)
            for key, run in self.runs.items()
            if run.experiment == experiment
            for name in run.models
        }

    def log_files(self, run: str, files: Iterable[Path], folder: str) -> None:
        kept = self.runs[run].files.setdefault(folder, [])
        kept.extend(path.name for path in files if path.name not in kept)

    def set_tags(self, run: str, tags: Mapping[str, str]) -> None:
        self.runs[run].tags.update(tags)

    def is_finished(self, run: str) -> bool:
        return self.runs[run].status is RunStatus.DONE

    def end(self, run: str, status: RunStatus) -> None:
        self.runs[run].status = status

    def read(self, experiment_name: str) -> pd.DataFrame:
        rows = [
            {
                "run": key,
                "trial": run.trial,
                "protocol": run.protocol,
                "step": scored.step,
                **{name: value for name, value in scored.values.items() if is_score(name)},
            }
            for key, run in self.runs.items()
            if run.experiment == experiment_name
            for scored in run.scores.values()
        ]
        return pd.DataFrame(rows)
