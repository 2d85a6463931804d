"""What is written beside a stage: its spec, its progress and its end. The only parser of these files."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from fl3d.config.settings import StageSettings, read_stage_settings, stage_folder
from fl3d.core.errors import StoreError
from fl3d.core.files import write_text
from fl3d.core.records import Stage
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


@dataclass(frozen=True)
class Spec:
    """A stage as it lies in its run folder.

    Args:
        stage: what is trained.
        machine: what it was last started with.
    """

    stage: Stage
    machine: Machine

    @cached_property
    def settings(self) -> StageSettings:
        """Values of the stage's config."""
        return read_stage_settings(self.stage.config)

    def kitti(self, root: Path | None = None) -> KittiFolder:
        """Its frames, read as the stage reads them.

        Args:
            root: where they lie now; None: where they lay when the stage was started.
        """
        return stage_folder(self.stage.config, root or self.machine.data_root)


def write_spec(folder: RunFolder, spec: Spec) -> None:
    """Freeze a stage in its folder, with the settings of this machine."""
    machine = {**asdict(spec.machine), "data_root": str(spec.machine.data_root)}
    write_text(
        folder.spec, json.dumps({"stage": asdict(spec.stage), "machine": machine}, indent=1) + "\n"
    )


def read_spec(folder: RunFolder) -> Spec:
    """Read what ``write_spec`` wrote.

    Raises:
        StoreError: there is none, or it is torn.
    """
    try:
        written: dict[str, Any] = json.loads(folder.spec.read_text())
        machine = written["machine"]
        ids = {key: tuple(machine.get(key, ())) for key in ("train_ids", "val_ids", "modules")}
        places = {
            "data_root": Path(machine["data_root"]),
            "protocol": Protocol(**machine["protocol"]),
        }
        return Spec(Stage(**written["stage"]), Machine(**{**machine, **ids, **places}))
    except FileNotFoundError:
        raise StoreError(
            f"{folder.spec}: no such file; a sweep writes it when it starts the stage"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise StoreError(f"{folder.spec}: is not a stage's spec ({error})") from None


def write_progress(folder: RunFolder, step: float, steps: int) -> None:
    """Say how far a stage is: steps of its own, in parts where it tells them."""
    write_text(folder.progress, json.dumps({"step": step, "steps": steps}))


def steps_done(folder: RunFolder, stage: Stage) -> float:
    """Steps of its own that a stage has behind it, by its progress file."""
    if folder.is_done:
        return stage.steps
    try:
        return float(json.loads(folder.progress.read_text())["step"])
    except (OSError, ValueError, KeyError, TypeError):
        return 0


def write_done(folder: RunFolder, ended: Mapping[str, float]) -> None:
    """Mark a stage as done; to be called after all its files are written."""
    write_text(folder.done, json.dumps(dict(ended)) + "\n")


def read_scores(folder: RunFolder, step: int, protocol: str) -> dict[str, float] | None:
    """Scores of a checkpoint under a protocol, by its id; None where it was not scored under it."""
    path = folder.scores(step, protocol)
    try:
        scores: dict[str, float] = json.loads(path.read_text())
    except (FileNotFoundError, ValueError):  # torn: they are made again from the detections
        return None
    return scores if isinstance(scores, dict) and set(MEAN_3D) <= set(scores) else None


def write_scores(
    folder: RunFolder, step: int, protocol: Protocol, scores: Mapping[str, float]
) -> None:
    """Keep the scores of a checkpoint under a protocol."""
    write_text(folder.scores(step, protocol.id), json.dumps(dict(scores), indent=1) + "\n")
