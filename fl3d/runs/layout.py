"""Where the files of a store folder lie; nobody else joins these names."""

from __future__ import annotations

import os
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from fl3d.core.digests import digest
from fl3d.core.errors import StoreError

ASIDE = ".unfinished-"  # in the name of a program's result folder that was put aside


@dataclass(frozen=True)
class RunFolder:
    """The files of a stage.

    Args:
        path: ``runs/stages/<key>``.
    """

    path: Path

    @property
    def key(self) -> str:
        """Of the stage."""
        return self.path.name

    @property
    def is_done(self) -> bool:
        """Whether the stage is trained to its end."""
        return self.done.exists()

    @property
    def root(self) -> Path:
        """Of the store that it lies in, absolute."""
        return self.path.absolute().parent.parent

    def here(self, written: str) -> Path:
        """Where a file of the folder lies now, whose place was written down before the store was moved.

        Args:
            written: relative to the folder, or absolute as it was then; a path that leads elsewhere stays.
        """
        path = Path(written)
        if path.is_absolute():
            ending = (self.path.parent.name, self.key)
            places = [n for n in range(1, len(path.parts)) if path.parts[n - 1 : n + 1] == ending]
            if not places:
                return path
            path = Path(*path.parts[places[-1] + 1 :])
        return self.path / path

    def beside(self, key: str) -> RunFolder:
        """The folder of another stage of the same store."""
        return RunFolder(self.path.parent / key)

    @property
    def spec(self) -> Path:
        """The stage and the machine-dependent settings it was last started with."""
        return self.path / "stage.json"

    @property
    def done(self) -> Path:
        """Marker, written last."""
        return self.path / "done.json"

    @property
    def progress(self) -> Path:
        """Step reached, renewed every second or so."""
        return self.path / "progress.json"

    @property
    def lease(self) -> Path:
        """Held by the process that trains it, see ``leases``."""
        return self.path / "lease.json"

    @property
    def error(self) -> Path:
        """Traceback of the last failure."""
        return self.path / "error.txt"

    @property
    def work(self) -> Path:
        """Where a command runs and keeps what is its own; empty of a network."""
        return self.path / "work"

    @property
    def command_log(self) -> Path:
        """All that the command has printed, start after start."""
        return self.path / "command.log"

    @property
    def command_exits(self) -> Path:
        """What the command's starts came to, a line each."""
        return self.path / "exits.jsonl"

    def split(self, name: str) -> Path:
        """The ids of training or validation frames, for a command to read."""
        return self.path / "splits" / f"{name}.txt"

    def weights(self, step: int) -> Path:
        """Weights, optimiser, generators and position."""
        return self.path / "checkpoints" / f"{step:08d}.pt"

    def marker(self, step: int) -> Path:
        """A ``Checkpoint``; the checkpoint exists when this does."""
        return self.path / "checkpoints" / f"{step:08d}.json"

    @property
    def resume(self) -> Path:
        """A resume point between two checkpoints."""
        return self.path / "resume.pt"

    def detections(self, step: int) -> Path:
        """What a checkpoint predicts on the validation frames."""
        return self.path / "detections" / f"{step:08d}.parquet"

    def kept(self, step: int, name: str) -> Path:
        """What was made of a checkpoint once, see ``kept``."""
        return self.path / "kept" / f"{step:08d}-{name}.bin"

    @property
    def old_windows(self) -> Path:
        """Where windows were kept without a word of what they were made of; nothing reads them any more."""
        return self.path / "windows"

    def scores(self, step: int, protocol_id: str) -> Path:
        """AP of a checkpoint under a protocol."""
        return self.path / "scores" / protocol_id / f"{step:08d}.json"

    def protocols(self) -> list[str]:
        """Ids of the protocols that any of its checkpoints was scored under."""
        return sorted(path.name for path in (self.path / "scores").glob("*") if path.is_dir())

    def steps(self) -> list[int]:
        """Steps of the checkpoints that exist, rising."""
        return sorted(
            int(p.stem) for p in (self.path / "checkpoints").glob("*.json") if p.stem.isdigit()
        )


@dataclass(frozen=True)
class StoreFolder:
    """The files of a store: run folders, plans and studies.

    Args:
        root: ``store.root`` of the config.
    """

    root: Path

    @property
    def stages(self) -> Path:
        """Folder of all run folders."""
        return self.root / "stages"

    @property
    def plans(self) -> Path:
        """Folder of frozen plans, and of the leases of the sweeps that run."""
        return self.root / "plans"

    def run(self, key: str) -> RunFolder:
        """The run folder of a stage."""
        return RunFolder(self.stages / key)

    def runs(self) -> list[RunFolder]:
        """The run folders of all stages, in alphabetical order."""
        return [RunFolder(path) for path in sorted(self.stages.glob("*")) if path.is_dir()]

    def plan(self, experiment: str) -> Path:
        """The frozen plan of a sweep."""
        return self.plans / f"{experiment}.json"

    def plan_files(self) -> list[Path]:
        """What lies in the folder of plans, however deep: names that hold a slash were possible once.

        Raises:
            StoreError: a folder of it cannot be read.
        """
        return [path for path in files_below(self.plans) if path.suffix == ".json"]

    def leases(self) -> list[Path]:
        """Leases of sweeps, held or left behind, however deep.

        Raises:
            StoreError: a folder of them cannot be read.
        """
        return [path for path in files_below(self.plans) if path.suffix == ".lease"]

    def strays(self) -> list[Path]:
        """Files that may be plans and lie elsewhere in the store: a name that began with ``../`` put them there.

        What stages hold is left out: nothing but fl3d and a user's program writes there.

        Raises:
            StoreError: a folder of the store cannot be read.
        """
        own = {run.path for run in self.runs()} | {self.plans}
        return [path for path in files_below(self.root, own) if path.suffix == ".json"]

    def lease(self, experiment: str) -> Path:
        """Held by the process that runs the sweep."""
        return self.plans / f"{experiment}.lease"

    @property
    def checks(self) -> Path:
        """Folder of what looks at data found."""
        return self.root / "checks"

    def check(self, key: str) -> Path:
        """What a look at a sweep's data found, see ``sweep.checked``."""
        return self.checks / f"{key}.json"

    def kept(self, name: str) -> Path:
        """What was made once of a sweep's frames, or of no trial at all, see ``kept``."""
        return self.root / "kept" / f"{name}.bin"

    def drawn(self, experiment: str, name: str) -> Path:
        """A figure of a sweep as it was drawn, see ``drawn``.

        Args:
            experiment: of the sweep; its digest stands in the name, which might else be too long.
            name: of the figure's files without their endings.
        """
        return self.kept(f"figure-{digest(experiment)[:10]}-{name}")

    def study(self, name: str) -> Path:
        """The journal of an Optuna study."""
        return self.root / "studies" / f"{name}.log"

    def study_lease(self, name: str) -> Path:
        """Held by the process that opens an Optuna study."""
        return self.root / "studies" / f"{name}.lease"


def files_below(folder: Path, without: Collection[Path] = ()) -> list[Path]:
    """All files below a folder, those behind links among them, in alphabetical order; none where it is not there.

    Args:
        folder: the folder.
        without: folders that are left out.

    Raises:
        StoreError: a folder cannot be read, so that nobody knows what it holds.
    """
    if not folder.exists():
        return []
    found: list[Path] = []
    seen: set[str] = set()
    for place, folders, files in os.walk(folder, onerror=_refuse, followlinks=True):
        here = os.path.realpath(place)
        kept = [] if here in seen else [one for one in folders if Path(place, one) not in without]
        folders[:] = kept
        if here not in seen:
            found += [Path(place, name) for name in files]
        seen.add(here)
    return sorted(found)


def _refuse(error: OSError) -> NoReturn:
    raise StoreError(f"{error.filename}: cannot be read ({error.strerror})") from None
