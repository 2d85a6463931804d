"""SLURM, through submitit: one job a stage, each after its parent; needs no accounting database.

A job's end is read from the queue and from the stage's own files: without accounting SLURM forgets a job soon after it
has ended, and submitit then waits for ever. Jobs outlive the sweep's own process; started again, it takes up those that
are still in the queue.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from fl3d.core.errors import ConfigError
from fl3d.core.extras import install
from fl3d.core.files import write_text
from fl3d.runs.layout import RunFolder
from fl3d.sweep.launchers.base import Job, JobState, Launcher, LauncherBusy
from fl3d.training.stage import run_stage

POLL_SECONDS = 2.0  # between queries of the queue, for all jobs together
GRACE_SECONDS = 10.0  # a job that has left the queue may have its last file still on the way
MAX_REQUEUES = 1000  # of a job that reaches its time limit
SUBMIT_WAITS = (0, 2, 10)  # seconds before each try: a controller may be busy
WAITING = (
    "PENDING",
    "RUNNING",
    "COMPLETING",
    "CONFIGURING",
    "SUSPENDED",
    "REQUEUED",
    "REQUEUE_HOLD",
    "PREEMPTED",
)


class StageTask:
    """What a job runs; picklable, and run again by SLURM after a pre-emption: the stage resumes by itself."""

    def __call__(self, folder: str) -> None:
        """Train the stage."""
        run_stage(Path(folder))

    def checkpoint(self, folder: str) -> Any:
        """Near the time limit: the same job once more, from the stage's last resume point."""
        import submitit

        return submitit.helpers.DelayedSubmission(self, folder)


class Queue:
    """What SLURM says of this user's jobs, asked once every few seconds for all of them."""

    def __init__(self) -> None:
        self._states: dict[str, str] = {}
        self._asked = self.answered = float("-inf")

    def state(self, job: str) -> str | None:
        """Of a job, such as ``RUNNING``; None where SLURM does not know it (any more)."""
        if time.monotonic() - self._asked > POLL_SECONDS:
            self.refresh()
        return self._states.get(job)

    def refresh(self) -> None:
        """Ask now; while the controller does not answer, what it said last still holds."""
        command = ["squeue", "--noheader", "--me", "--states=all", "--format=%i %T"]
        try:
            done = subprocess.run(command, capture_output=True, text=True, timeout=30, check=True)
        except (OSError, subprocess.SubprocessError):
            return
        finally:
            self._asked = time.monotonic()
        self.answered = time.monotonic()
        pairs = [line.split() for line in done.stdout.splitlines()]
        self._states = {pair[0]: pair[1] for pair in pairs if len(pair) == 2}


class _SlurmJob(Job):
    def __init__(self, number: str, folder: Path, queue: Queue) -> None:
        self.number, self.paths, self.queue = number, RunFolder(folder), queue
        self._taken = time.monotonic()
        self._left: float | None = None

    def state(self) -> JobState:
        if self.paths.done.exists():
            return JobState.DONE
        if self.queue.state(self.number) in WAITING:
            self._left = None
            return JobState.RUNNING
        if self.queue.answered < self._taken:
            return JobState.RUNNING  # the controller has said nothing since
        self._left = self._left or time.monotonic()
        if self.paths.error.exists():
            return JobState.RAISED
        # It is being requeued, or its last files are on their way.
        return (
            JobState.KILLED if time.monotonic() - self._left > GRACE_SECONDS else JobState.RUNNING
        )

    def cancel(self) -> None:
        subprocess.run(["scancel", self.number], capture_output=True, check=False, timeout=30)


class SlurmLauncher(Launcher):
    """One job for each stage, submitted with a dependency on its parent's.

    Args:
        slots: jobs in the queue at once, waiting ones among them.
        partition: None: the cluster's own choice.
        minutes: time limit of a job; a stage that needs longer resumes in the same job, requeued.
        cpus: of a job.
        memory_gb: of a job; None: the cluster's own choice.
        gpus: of a job; 0: none.
        signal_seconds: before the time limit, when the job is requeued; it resumes from its last resume point
            (``schedule.save_every_steps``) or checkpoint.
        extra: further ``#SBATCH`` options, such as ``{account: physics, qos: low}``.
        setup: shell lines before each job, such as ``module load cuda``.

    Raises:
        ConfigError: submitit is not installed.
    """

    has_queue = True

    def __init__(
        self,
        slots: int = 64,
        partition: str | None = None,
        minutes: int = 1440,
        cpus: int = 1,
        memory_gb: float | None = None,
        gpus: int = 0,
        signal_seconds: int = 120,
        extra: Mapping[str, Any] | None = None,
        setup: list[str] | None = None,
    ) -> None:
        self._submitit = _submitit()
        self.slots = slots
        self._queue = Queue()
        options: dict[str, Any] = {
            "use_srun": False,
            "time": minutes,
            "cpus_per_task": cpus,
            "ntasks_per_node": 1,
        }
        options |= {"partition": partition} if partition else {}
        options |= {"mem": f"{memory_gb:g}G"} if memory_gb else {}
        options |= {"gpus_per_node": gpus} if gpus else {}
        threads = [
            f"export {name}={cpus}"
            for name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS")
        ]
        options["setup"] = [*threads, *(setup or [])]
        # To the batch process itself, which `exec` makes Python: without srun nothing else is told.
        own = {"requeue": True, "kill-on-invalid-dep": "yes", "signal": f"B:USR2@{signal_seconds}"}
        options["additional_parameters"] = {**own, **(extra or {})}
        self._options = options

    def launch(self, folder: Path, after: Job | None = None) -> Job:
        """Submit a stage, or take up the job that is still in the queue from an earlier start."""
        ticket = folder / "slurm.json"
        if ticket.exists():
            number = str(json.loads(ticket.read_text(encoding="utf-8"))["job"])
            self._queue.refresh()
            if self._queue.state(number) in WAITING:
                return _SlurmJob(number, folder, self._queue)
        RunFolder(folder).error.unlink(missing_ok=True)  # of an earlier job
        number = self._submit_patiently(folder, after)
        write_text(ticket, json.dumps({"job": number}) + "\n")
        self._queue.refresh()
        return _SlurmJob(number, folder, self._queue)

    def _submit_patiently(self, folder: Path, after: Job | None) -> str:
        for wait in SUBMIT_WAITS:
            time.sleep(wait)
            try:
                return self._submit(folder, after)
            except LauncherBusy as error:
                refused = error
        raise refused

    def _submit(self, folder: Path, after: Job | None) -> str:
        submitit = self._submitit
        logs = folder / "slurm"
        try:
            executor = submitit.SlurmExecutor(
                logs, max_num_timeout=MAX_REQUEUES, python=f"exec {sys.executable}"
            )
            options = dict(self._options, job_name=folder.name)
            if isinstance(after, _SlurmJob) and not after.paths.done.exists():
                options["dependency"] = f"afterok:{after.number}"
            executor.update_parameters(**options)
            return str(executor.submit(StageTask(), str(folder.absolute())).job_id)
        except (
            submitit.core.utils.FailedJobError,
            subprocess.SubprocessError,
            FileNotFoundError,
        ) as error:
            raise LauncherBusy(f"SLURM took no job for {folder.name}: {error}") from None
        except (RuntimeError, ValueError) as error:
            raise ConfigError(f"hydra/launcher=slurm: {error}") from None


def _submitit() -> Any:
    try:
        import submitit
    except ImportError:
        raise ConfigError(f"hydra/launcher=slurm needs submitit: {install('slurm')}") from None
    return submitit
