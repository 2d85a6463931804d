"""Ray: one task a stage, on whatever node has room, with fractions of a GPU."""

from __future__ import annotations

import os
import signal
from pathlib import Path
from typing import Any

from fl3d.core.errors import ConfigError
from fl3d.core.extras import install
from fl3d.sweep.launchers.base import Job, JobState, Launcher
from fl3d.training.stage import run_stage

THREADS = ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


class _Task(Job):
    """A task that ended badly is launched again by the scheduler, which counts; Ray itself does not retry."""

    def __init__(self, ray: Any, reference: Any) -> None:
        self._ray, self._reference = ray, reference
        self._ended: JobState | None = None

    def state(self) -> JobState:
        if self._ended is None:
            ready, _ = self._ray.wait([self._reference], timeout=0)
            if not ready:
                return JobState.RUNNING
            self._ended = self._outcome()
        return self._ended

    def _outcome(self) -> JobState:
        errors = self._ray.exceptions
        try:
            return JobState.DONE if self._ray.get(self._reference) else JobState.RAISED
        except errors.RayError:
            return JobState.KILLED  # it was cancelled, or its worker or its node died

    def cancel(self) -> None:
        self._ray.cancel(self._reference, force=True)


class RayLauncher(Launcher):
    """Tasks on a Ray cluster; the store's root must be a folder that all nodes share.

    Args:
        address: of the cluster; None: ``RAY_ADDRESS``, or else a cluster of this machine's own.
        cpus: of a stage; also its threads.
        gpus: of a stage; 0.5 lets two share a card.
        slots: stages at once; None: as many as the cluster's CPUs and GPUs hold when it starts.

    Raises:
        ConfigError: Ray is not installed, or (when it is opened) the cluster cannot hold a single stage.
    """

    def __init__(
        self,
        address: str | None = None,
        cpus: float = 1.0,
        gpus: float = 0.0,
        slots: int | None = None,
    ) -> None:
        try:
            import ray
        except ImportError:
            raise ConfigError(f"hydra/launcher=ray needs Ray: {install('ray')}") from None
        self._ray, self._address, self._owns = ray, address, False
        self._cpus, self._gpus, self._asked = cpus, gpus, slots
        self.slots = slots or 1

    def open(self) -> None:
        """Join the cluster, or start one."""
        ray = self._ray
        if not ray.is_initialized():
            self._owns = True
            os.environ.setdefault("RAY_worker_niceness", "0")  # it is 15 otherwise
            os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
            handler = signal.getsignal(signal.SIGTERM)
            where = self._address or os.environ.get("RAY_ADDRESS") or "local"
            ray.init(
                address=where, include_dashboard=False, log_to_driver=False, logging_level="ERROR"
            )
            signal.signal(signal.SIGTERM, handler)  # Ray puts its own in its place
        self.slots = self._asked or self._room()
        environment = {"env_vars": dict.fromkeys(THREADS, str(max(1, int(self._cpus))))}
        # A fresh process for each stage: what one leaves in torch does not reach the next.
        self._run = ray.remote(max_calls=1)(_run).options(
            num_cpus=self._cpus, num_gpus=self._gpus, max_retries=0, runtime_env=environment
        )

    def _room(self) -> int:
        cpus, gpus, there = self._cpus, self._gpus, self._ray.cluster_resources()
        room = [
            int(there.get(name, 0) / need) for name, need in (("CPU", cpus), ("GPU", gpus)) if need
        ]
        if min(room) < 1:
            raise ConfigError(
                f"hydra/launcher=ray: a stage asks for {cpus:g} CPUs and {gpus:g} GPUs; the cluster has "
                f"{there.get('CPU', 0):g} and {there.get('GPU', 0):g} in all"
            )
        return min(room)

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Start a task."""
        return _Task(self._ray, self._run.remote(str(folder.absolute())))

    def close(self) -> None:
        """Leave the cluster, if this launcher joined it."""
        if self._owns:
            self._ray.shutdown()


def _run(folder: str) -> bool:
    """Train a stage; whether it went through. What it raised lies in the stage's folder, not all of it picklable."""
    try:
        run_stage(Path(folder))
    except Exception:
        return False
    return True
