"""A stage that runs on this machine, whatever trains it: its files, its progress, and its end."""

from __future__ import annotations

import contextlib
import multiprocessing as mp
import time
from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping

from fl3d.core.digests import file_digest
from fl3d.core.errors import CheckpointError, Fl3dError, Unwritable
from fl3d.core.leases import Lease
from fl3d.core.records import Checkpoint
from fl3d.evaluation.validation import Validation, read_validation
from fl3d.inference.scores import scores_of
from fl3d.runs.checkpoints import read_marker, write_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec, write_done, write_progress


class StageRun(ABC):
    """A stage in this process.

    Args:
        folder: of the stage.
        lease: on it, held.
        spec: of the stage.
    """

    def __init__(self, folder: RunFolder, lease: Lease, spec: Spec) -> None:
        self._started = time.time()
        self._cpu = time.process_time()
        self.folder = folder
        self.lease = lease
        self.spec = spec
        self.stage = spec.stage
        self.machine = spec.machine
        self.kitti = spec.kitti()
        parent = mp.parent_process()
        self._parent = (
            parent if parent is not None and parent.sentinel is not None else None
        )  # joblib's has none

    @abstractmethod
    def run(self) -> None:
        """From wherever it stands to its end."""

    def validation(self) -> Validation:
        """Labels of the validation frames."""
        return read_validation(self.kitti, self.machine.val_ids)

    def show(self, steps: float) -> None:
        """Say how many steps of its own are done; leave when the process that started this one has gone."""
        with contextlib.suppress(
            Unwritable
        ):  # a full disk may have room again at the next checkpoint
            write_progress(self.folder, steps, self.stage.steps)
        if self._parent is not None and not self._parent.is_alive():
            raise Fl3dError(
                "the process that started this stage has ended; run the same command to resume"
            )

    def score(self, step: int, validation: Validation) -> None:
        """Score the stored detections of a checkpoint."""
        scores_of(self.folder, step, validation, self.machine.protocol)

    def mark(
        self,
        step: int,
        epoch: int,
        *,
        seconds: Mapping[str, float],
        lr: float | None = None,
        losses: Mapping[str, float] | None = None,
        sha256: str = "",
        made_by: Mapping[str, str] | None = None,
    ) -> None:
        """Declare a checkpoint whole: its detections and scores are stored. See ``core.records.Checkpoint``."""
        found_sha256 = file_digest(self.folder.detections(step))
        self.lease.check()
        write_marker(
            self.folder,
            Checkpoint(
                stage=self.stage.key,
                step=step,
                epoch=epoch,
                lr=lr,
                losses=losses or {},
                seconds=seconds,
                sha256=sha256,
                detections_sha256=found_sha256,
                time_ms=_first_made(self.folder, step),
                made_by={**self.machine.provenance, **(made_by or {})},
            ),
        )

    def end(self, step: int) -> None:
        """Declare the stage done."""
        self.lease.check()
        ended = {"step": step, "started": self._started, "ended": time.time()}
        ended["cpu_seconds"] = round(
            time.process_time() - self._cpu, 3
        )  # of the last process that trained it
        write_done(self.folder, ended)


def _first_made(folder: RunFolder, step: int) -> int:
    """Milliseconds since 1970 at which a checkpoint was first made: made again, it keeps its place in the store."""
    if folder.marker(step).exists():
        with contextlib.suppress(CheckpointError):  # torn
            return read_marker(folder, step).time_ms
    return int(time.time() * 1000)


class Timer:
    """Seconds by purpose, since they were last taken."""

    def __init__(self) -> None:
        self._seconds: dict[str, float] = {}

    @contextlib.contextmanager
    def measure(self, name: str) -> Iterator[None]:
        """Count what is done inside."""
        started = time.perf_counter()
        yield
        self._seconds[name] = self._seconds.get(name, 0.0) + time.perf_counter() - started

    def take(self) -> dict[str, float]:
        """All that was counted since the last time."""
        seconds, self._seconds = self._seconds, {}
        return {name: round(value, 3) for name, value in seconds.items()}
