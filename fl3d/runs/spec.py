"""What is written beside a stage: its spec, its progress and its end. The only parser of these files."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from fl3d.config.settings import StageSettings, read_stage_settings, stage_folder
from fl3d.core.errors import DataError, DataMissing, StoreError
from fl3d.core.files import write_text
from fl3d.core.records import Stage
from fl3d.data.frame_digests import labels_digest
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.selection import MEAN_3D
from fl3d.runs.layout import RunFolder


@dataclass(frozen=True, kw_only=True)
class Machine:
    """Settings under which a stage was last started; none of them changes a result.

    Args:
        data_root: a KITTI folder.
        train_ids: training frames.
        val_ids: validation frames.
        device: torch's name of it.
        workers: loader processes; None: by the device.
        cache_frames: kept in memory.
        save_every_steps: steps between resume points within an epoch; None: none.
        protocol: that its checkpoints are scored under.
        keep_every: epochs between checkpoints whose weights are kept; None: only the last and the best.
        provenance: commit, versions and machine, see ``core.provenance``.
        modules: folders of the user's own Python modules.
        labels_digest: of what the validation frames are scored by; empty: it was not written down.
    """

    data_root: Path
    train_ids: tuple[str, ...]
    val_ids: tuple[str, ...]
    protocol: Protocol
    device: str = "cpu"
    workers: int | None = None
    cache_frames: int = 0
    save_every_steps: int | None = None
    keep_every: int | None = None
    provenance: Mapping[str, str] = field(default_factory=dict)
    modules: tuple[str, ...] = ()
    labels_digest: str = ""


@dataclass(frozen=True)
class Spec:
    """A stage as it lies in its run folder.

    Args:
        stage: what is trained.
        machine: what it was last started with.
        beside: where its frames lie if they were moved together with the store.
    """

    stage: Stage
    machine: Machine
    beside: Path | None = field(default=None, compare=False)

    @cached_property
    def settings(self) -> StageSettings:
        """Values of the stage's config."""
        return read_stage_settings(self.stage.config)

    def kitti(self, given: Path | None = None) -> KittiFolder:
        """Its frames, read as the stage reads them.

        Args:
            given: where the user says that they lie; None: nowhere, or they are no longer there.

        Raises:
            DataError: they are not there, or others are.
        """
        return self._read(self._place(given))

    def _read(self, root: Path) -> KittiFolder:
        return stage_folder(self.stage.config, root)

    def _place(self, given: Path | None) -> Path:
        """Where its frames lie: as the user says, or moved together with the store, or as they lay."""
        before = self.machine.data_root
        if given is not None and is_same(given, before):
            return before
        tried = [place for place in (given, self.beside) if place and not is_same(place, before)]
        if not tried:
            return before  # nothing says that they have moved
        there = [place for place in (*tried, before) if (place / "training").is_dir()]
        right = next((place for place in there if self._are_its_own(place)), None)
        if right is None or (given in there and right != given):
            raise self._not_there(there, tried)
        return right

    def _are_its_own(self, place: Path) -> bool:
        """Whether a folder's frames are those of the stage, as far as was written down."""
        if not self.machine.labels_digest:
            return True
        try:
            found = labels_digest(self._read(place), self.machine.val_ids)
        except DataError:  # it has not all of them
            return False
        return found == self.machine.labels_digest

    def _not_there(self, there: Sequence[Path], tried: Sequence[Path]) -> DataError:
        lay = f"they lay in {self.machine.data_root}; give data.root=FOLDER, where they lie now"
        if not there:
            return DataMissing(f"the frames of {self.stage.key} are not there: {lay}", tried[0])
        what = "holds other labels or calibrations than those that the validation frames of"
        return DataError(f"{what} {self.stage.key} were scored by; {lay}", there[0])


def is_same(place: Path, other: Path) -> bool:
    """Whether two paths lead to one folder."""
    try:
        return place.absolute() == other.absolute() or place.samefile(other)
    except OSError:  # one of them is not there
        return False


def write_spec(folder: RunFolder, spec: Spec) -> None:
    """Freeze a stage in its folder, with the settings of this machine.

    Paths are kept twice, absolute and as seen from the store's root: what is moved together is found again.
    """
    machine = {**asdict(spec.machine), "data_root": str(spec.machine.data_root)}
    seen = {
        "data_root": os.path.relpath(spec.machine.data_root, folder.root),
        "modules": [os.path.relpath(module, folder.root) for module in spec.machine.modules],
    }
    content = {"stage": asdict(spec.stage), "machine": machine, "from_store": seen}
    write_text(folder.spec, json.dumps(content, indent=1) + "\n")


def read_spec(folder: RunFolder) -> Spec:
    """Read what ``write_spec`` wrote, wherever the store has been moved since.

    Raises:
        StoreError: there is none, or it is torn.
    """
    try:
        written: dict[str, Any] = json.loads(folder.spec.read_text(encoding="utf-8"))
        machine = written["machine"]
        seen = written.get("from_store", {})  # older ones have absolute paths alone
        ids = {key: tuple(machine.get(key, ())) for key in ("train_ids", "val_ids")}
        places = {
            "data_root": Path(machine["data_root"]),
            "protocol": Protocol(**machine["protocol"]),
            "modules": _modules(folder, machine.get("modules", ()), seen.get("modules", ())),
        }
        beside = _from_store(folder, seen["data_root"]) if "data_root" in seen else None
        return Spec(Stage(**written["stage"]), Machine(**{**machine, **ids, **places}), beside)
    except FileNotFoundError:
        raise StoreError(
            f"{folder.spec}: no such file; a sweep writes it when it starts the stage"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{folder.spec}: is not a stage's spec ({error})") from None


def _from_store(folder: RunFolder, path: str) -> Path:
    """A path as seen from the store's root, without following links: they may lead to another disk."""
    return Path(os.path.normpath(folder.root / path))


def _modules(folder: RunFolder, absolute: Sequence[str], seen: Sequence[str]) -> tuple[str, ...]:
    """Folders of the user's modules: moved together with the store where they are there, or else as they were."""
    moved = [_from_store(folder, path) for path in seen]
    found = [str(path) for path in moved if path.is_dir()]
    return tuple(found if len(found) == len(absolute) else absolute)


def write_progress(folder: RunFolder, step: float, steps: int) -> None:
    """Say how far a stage is: steps of its own, in parts where it tells them."""
    write_text(folder.progress, json.dumps({"step": step, "steps": steps}))


def steps_done(folder: RunFolder, stage: Stage) -> float:
    """Steps of its own that a stage has behind it, by its progress file."""
    if folder.is_done:
        return stage.steps
    try:
        return float(json.loads(folder.progress.read_text(encoding="utf-8"))["step"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def write_done(folder: RunFolder, ended: Mapping[str, float]) -> None:
    """Mark a stage as done; to be called after all its files are written."""
    write_text(folder.done, json.dumps(dict(ended)) + "\n")


def end_of(folder: RunFolder) -> int | None:
    """Step of the last checkpoint of a stage that is done; None where it is not, or does not say."""
    try:
        return int(json.loads(folder.done.read_text(encoding="utf-8"))["step"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def read_scores(folder: RunFolder, step: int, protocol: str) -> dict[str, float] | None:
    """Scores of a checkpoint under a protocol, by its id; None where it was not scored under it."""
    path = folder.scores(step, protocol)
    try:
        scores: dict[str, float] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):  # torn: they are made again from the detections
        return None
    return scores if isinstance(scores, dict) and set(MEAN_3D) <= set(scores) else None


def write_scores(
    folder: RunFolder, step: int, protocol: Protocol, scores: Mapping[str, float]
) -> None:
    """Keep the scores of a checkpoint under a protocol."""
    write_text(folder.scores(step, protocol.id), json.dumps(dict(scores), indent=1) + "\n")
