"""What a store of scores is: one experiment a sweep, one run a trial and protocol, every score once."""

from __future__ import annotations

import contextlib
import os
import uuid
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

import pandas as pd

from fl3d.core.files import write_text


class RunStatus(Enum):
    """What has become of a trial's run."""

    RUNNING = "running"
    DONE = "done"
    FAILED = "failed"
    STOPPED = "stopped"


@dataclass(frozen=True)
class Scored:
    """The scores of one checkpoint, on their way into the store.

    Args:
        step: of the checkpoint.
        time_ms: when it was made, milliseconds since 1970.
        values: metrics by name.
    """

    step: int
    time_ms: int
    values: Mapping[str, float]


# What is drawn over steps is logged under names of its own as well, of each stage by one trial alone: a beginning that
# seven levels share is one curve.
CURVE = "curve/"
CURVES = ("ap_3d/moderate", "ap_3d/easy", "ap_3d/hard", "ap_bev/moderate", "loss/total", "train/lr")
STANDING = "standing"  # tag of a run: its group, level and verdict, by which the seeds of a level lie together


def is_score(key: str) -> bool:
    """Whether a metric is one that tables are made of."""
    return key.startswith(("ap_", "recall_")) or key == "epoch"


class Store(ABC):
    """Where the scores of sweeps are kept.

    Every call may be made again, and leaves what a single one leaves. Every call raises ``StoreDown`` where the store
    cannot be reached now.

    Attributes:
        root: folder of the run folders whose scores it holds.
    """

    root: Path

    @property
    @abstractmethod
    def exists(self) -> bool:
        """Whether it has been made; what lies on a server is taken to exist."""

    @property
    @abstractmethod
    def is_for_one_machine(self) -> bool:
        """Whether no two machines may write to it at a time."""

    @property
    def file(self) -> Path | None:
        """The one file that it is, absolute; None where it is something else."""
        return None

    @property
    def id(self) -> str:
        """Tells the runs of this root from those of others in a shared store; made at first use."""
        path = self.root / "id"
        if not path.exists():
            own = path.with_name(f".id.{uuid.uuid4().hex}.tmp")
            write_text(own, uuid.uuid4().hex + "\n")
            with contextlib.suppress(FileExistsError):  # another process was first
                os.link(own, path)
            own.unlink()
        return path.read_text(encoding="utf-8").strip()

    @abstractmethod
    def open(self) -> None:
        """Make the store if need be, and connect to it; several processes may do so at once."""

    @abstractmethod
    def models(self, experiment: str) -> set[tuple[str, str]]:
        """Run and name of every model of a sweep's experiment that is whole and was not deleted.

        Args:
            experiment: id.
        """

    @abstractmethod
    def experiment(self, name: str, note: str) -> str:
        """Id of a sweep's experiment, made at first use; ``note`` is shown above its runs, as Markdown."""

    @abstractmethod
    def run(
        self,
        experiment: str,
        trial: str,
        protocol: str,
        name: str,
        tags: Mapping[str, str],
        params: Mapping[str, object],
    ) -> str:
        """Id of a trial's run, made at first use; a closed one is opened again unless it is done.

        Args:
            experiment: id.
            trial: its key; with the protocol the run's identity.
            protocol: id.
            name: shown to people.
            tags: further ones.
            params: the config, flat; written once.
        """

    @abstractmethod
    def log(self, run: str, scored: Scored) -> None:
        """Log one checkpoint's metrics."""

    @abstractmethod
    def logged_steps(self, run: str) -> set[int]:
        """Steps whose scores the run holds."""

    @abstractmethod
    def link_dataset(self, run: str, name: str, digest: str, root: Path) -> None:
        """Name the validation frames as the run's dataset."""

    @abstractmethod
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
        """Id of a model of a run under a name (``last``, ``best``), made at first use.

        Args:
            experiment: id.
            run: of the trial.
            name: of the model.
            files: put beside it.
            tags: its checkpoint; a model with other tags, or one that was never finished, is replaced.
            scored: its scores.
            dataset: name and digest of what it was scored on.
        """

    @abstractmethod
    def log_files(self, run: str, files: Iterable[Path], folder: str) -> None:
        """Put files beside a run; those of the same name are overwritten."""

    def without(self, runs: Iterable[str], file: Path, folder: str) -> list[str]:
        """Those of some runs that a file is not known to lie beside with the content that it has now, in order.

        Args:
            runs: ids.
            file: see ``log_files``.
            folder: likewise.
        """
        return sorted(set(runs))

    @abstractmethod
    def set_tags(self, run: str, tags: Mapping[str, str]) -> None:
        """Set tags of a run."""

    @abstractmethod
    def is_finished(self, run: str) -> bool:
        """Whether the run was closed as done."""

    @abstractmethod
    def end(self, run: str, status: RunStatus) -> None:
        """Close a run."""

    @abstractmethod
    def read(self, experiment_name: str) -> pd.DataFrame:
        """All scores of this root's runs of a sweep.

        Returns:
            a row for each run and step: ``run``, ``trial``, ``protocol``, ``step``, ``epoch`` and every AP and recall.
            Empty where there is no such experiment.
        """
