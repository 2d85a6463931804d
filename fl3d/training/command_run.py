"""A stage that is a command: start it, score its checkpoints as their result files appear, and say how it ended.

What it has printed, how each of its starts ended, and the result files' numbers stay in the stage's folder.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

from fl3d.core.errors import DataError, TrainingError
from fl3d.core.files import write_text
from fl3d.core.leases import Lease
from fl3d.evaluation.results import read_results, write_results
from fl3d.evaluation.validation import Validation
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec
from fl3d.training.command import Command, command_of
from fl3d.training.command_line import CommandLine
from fl3d.training.output import Output
from fl3d.training.process import Exit, Process, read_exits, tail, wait_for_earlier
from fl3d.training.program import read_program
from fl3d.training.result_folders import (
    Numbers,
    ResultFolders,
    Settling,
    check_frames,
    fingerprint,
    is_complete,
    last_changed,
    newest_besides,
    put_aside,
    refuse_surplus,
)
from fl3d.training.running import StageRun

PATIENCE_SECONDS = 30.0  # beyond its grace, for an earlier start of the command to end
POLL_SECONDS = 1.0  # between looks at its result folders


class CommandRun(StageRun):
    """A command in this process's care."""

    def __init__(self, folder: RunFolder, lease: Lease, spec: Spec) -> None:
        # The command runs in another folder, where a relative path would mean another place.
        folder = RunFolder(folder.path.absolute())
        super().__init__(folder, lease, spec)
        self.section: Mapping[str, Any] = self.stage.config["detector"]
        self.command: Command = command_of(self.section)
        self.line = CommandLine(self.command, folder, spec)
        numbers = Numbers(
            first=self.command.first_epoch,
            each=self.command.numbers_per_epoch,
            before=self.stage.start_epoch if self.command.counts_on else 0,
        )
        self.results = ResultFolders(
            self.command.results,
            self.line.values,
            folder.work,
            numbers,
            self.stage.epochs,
        )
        self.output = Output(folder.command_log, self.command.progress, numbers)
        self.settling = Settling(self.command.settle_seconds)
        self._marked = time.time()

    @cached_property
    def labels(self) -> Validation:
        """Of the validation frames."""
        return self.validation()

    def run(self) -> None:
        """Run the command to its end, unless an earlier start has brought it there."""
        if self.command.imported:
            raise TrainingError(
                f"{self.stage.key}: it was imported, and is not whole; import it again"
            )
        self._write_splits()
        self.folder.work.mkdir(exist_ok=True)
        wait_for_earlier(self.folder.command_exits, self.command.grace_seconds + PATIENCE_SECONDS)
        exits = read_exits(self.folder.command_exits)
        if not exits or exits[-1].code != 0 or exits[-1].by_fl3d:
            self._put_aside(exits)
            self._start_and_watch()
            exits = read_exits(self.folder.command_exits)
        self._check_program("has changed while its command ran")
        self._check_exit(exits)
        self._take(has_ended=True)
        self._check_results(len(exits))
        self.show(self.stage.steps)
        self.end(self.stage.end_step)

    def _start_and_watch(self) -> None:
        self._check_program("has changed since the sweep was planned")
        self.line.resume()
        self.output.skip()
        self._marked = time.time()
        with Process(
            self.line.arguments(),
            self.line.cwd,
            self.line.env,
            self.folder.command_log,
            self.folder.command_exits,
            self.command.grace_seconds,
        ) as process:
            while process.is_running:
                self._take(has_ended=False)
                self.output.read()
                self.show(self._steps())
                self.lease.check()
                process.wait(POLL_SECONDS)

    def _write_splits(self) -> None:
        for name, ids in (("train", self.machine.train_ids), ("val", self.machine.val_ids)):
            write_text(self.folder.split(name), "".join(f"{one}\n" for one in ids))

    def _check_program(self, what: str) -> None:
        """Refuse a program that is not the one that the stage's key was made of.

        Raises:
            TrainingError: its digest differs.
        """
        planned = self.section["program"]
        found = read_program(planned, Path.cwd())
        if found["digest"] != planned["digest"]:
            raise TrainingError(
                f"{planned['folder']}: the program {what}: it was {planned['about']}, and is "
                f"{found['about']}; start the sweep again, which trains it anew, or put it back as it was"
            )

    def _take(self, has_ended: bool) -> None:
        """Store and score the checkpoints whose result files are whole and have settled."""
        for epoch, path in sorted(self.results.find().items()):
            step = self.stage.start_step + epoch
            if self.folder.marker(step).exists():
                continue
            files = fingerprint(path)
            if not has_ended and not self.settling.is_settled(path, files):
                continue
            if is_complete(files, self.machine.val_ids):
                self._keep(epoch, path, files)
            else:
                refuse_surplus(path, self.machine.val_ids)  # a missing frame may still come

    def _keep(self, epoch: int, path: Path, files: object) -> None:
        step = self.stage.start_step + epoch
        training = max(0.0, max((last_changed(fingerprint(path)), self._marked)) - self._marked)
        self._marked += training
        results = read_results(path, self.machine.val_ids, self.machine.protocol.classes)
        if fingerprint(path) != files:
            return  # it is being written again: looked at once more
        self.lease.check()
        started = time.perf_counter()
        write_results(self.folder.detections(step), results)
        for protocol in self.folder.protocols():  # of results that were there before
            self.folder.scores(step, protocol).unlink(missing_ok=True)
        self.score(step, self.labels)
        seconds = {"training": training, "detection": 0.0, "scoring": time.perf_counter() - started}
        self.mark(
            step,
            self.stage.start_epoch + epoch,
            seconds={name: round(value, 3) for name, value in seconds.items()},
            losses=self.output.take_losses(),
            made_by={
                "program": self.section["program"]["about"],
                "program.folder": self.section["program"]["folder"],
                "results": self._inside(path),
                "results.sha256": results.sha256,
            },
        )

    def _inside(self, path: Path) -> str:
        """A path as seen from the stage's folder, for the store may be moved; others as they are."""
        here = self.folder.path
        return str(path.relative_to(here) if path.is_relative_to(here) else path)

    def _steps(self) -> float:
        """Steps of its own that are done, by its checkpoints and by what it prints."""
        scored = max(self.folder.steps(), default=self.stage.start_step) - self.stage.start_step
        return min(max(scored, self.output.epochs), self.stage.steps)

    def _put_aside(self, exits: list[Exit]) -> None:
        """Rename result folders that an interrupted start may have left half written.

        Whole are those with a file for each frame of which none had changed for a while when it ended, or behind which
        the program had written something else, such as its own checkpoint: it may go on behind that epoch, and never
        write its results again.
        """
        log = self.folder.command_log
        if not log.exists():
            return
        ended = exits[-1].ended if exits else log.stat().st_mtime
        for epoch, path in self.results.find().items():
            if self.folder.marker(self.stage.start_step + epoch).exists():
                continue
            files = fingerprint(path)
            changed = last_changed(files)
            has_settled = ended - changed > self.command.settle_seconds
            is_written = has_settled or newest_besides(path, self.folder.work) >= changed
            if not (is_complete(files, self.machine.val_ids) and is_written):
                put_aside(path)

    def _check_exit(self, exits: list[Exit]) -> None:
        """Refuse a command that did not end well.

        Raises:
            TrainingError: with its exit code and the last lines that it printed.
        """
        log = self.folder.command_log
        if not exits:
            raise TrainingError(
                f"the last lines of its log:\n{_indented(tail(log))}\n"
                f"its command left no exit code; see {log}"
            )
        if exits[-1].code != 0:
            raise TrainingError(
                f"the last lines that the command printed:\n{_indented(tail(log))}\n"
                f"the command ended with {exits[-1]}; all that it printed is in {log}"
                f"{self._went_on()}"
            )

    def _went_on(self) -> str:
        """Many a program is ended while it writes its checkpoint, and then can never go on from it."""
        if self.line.resumed is None:
            return ""
        return f"; it was to go on from {self.line.resumed}: if that is broken, delete it and start the sweep again"

    def _check_results(self, starts: int) -> None:
        """Refuse a stage whose last epoch has no results, or that has results of other frames.

        Raises:
            DataError: naming what is missing, and what is there.
        """
        found = self.results.find()
        last = self.stage.epochs
        unscored = {
            epoch: path
            for epoch, path in found.items()
            if not self.folder.marker(self.stage.start_step + epoch).exists()
        }
        for epoch, path in unscored.items():
            if epoch == last or starts == 1:  # others may be of a start that was interrupted
                check_frames(path, self.machine.val_ids)
        if not found and not self.folder.steps():
            raise DataError(f"{self.results.nothing()}; {self._again()}", self.results.place())
        if not self.folder.marker(self.stage.end_step).exists():
            number = ", ".join(str(epoch) for epoch in sorted(found))
            raise DataError(
                f"no results of the stage's last epoch, {last}: those that fit detector.results are of epochs "
                f"{number}; the program must write those of its last epoch, or schedule.epochs is not what it trains; "
                f"{self._again()}",
                self.folder.work,
            )

    def _again(self) -> str:
        return (
            "the command itself has ended well: once detector.results and the like are right, the same sweep reads "
            f"what is there and trains nothing again; to run the command again delete {self.folder.path}"
        )


def _indented(text: str) -> str:
    return "\n".join(f"  {line}" for line in text.splitlines())
