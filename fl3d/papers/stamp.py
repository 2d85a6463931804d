"""The stamp of a results folder: by what, from what and where its results were made."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fl3d.config.objects import locate
from fl3d.core.files import write_text
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec
from fl3d.simulator import VERSION as SIMULATOR_VERSION
from fl3d.sweep.plan import KEY_VERSION
from fl3d.sweep.prepare import prepare_data
from fl3d.training.trainer import VERSION as TRAINER_VERSION

STAMP = "stamp.json"


def write_stamp(folder: Path, sweeps: Sequence[FinishedSweep], made_by: Mapping[str, str]) -> None:
    """Say in a results folder where it comes from.

    Args:
        folder: that holds the results.
        sweeps: whose results they are.
        made_by: see ``core.provenance.provenance``.
    """
    write_text(folder / STAMP, json.dumps(_stamp(sweeps, made_by), indent=1) + "\n")


def read_stamp(folder: Path) -> dict[str, Any]:
    """The stamp of a results folder."""
    content: dict[str, Any] = json.loads((folder / STAMP).read_text(encoding="utf-8"))
    return content


def _stamp(sweeps: Sequence[FinishedSweep], made_by: Mapping[str, str]) -> dict[str, Any]:
    data = prepare_data(sweeps[0].settings.data)
    trained_by: set[str] = set()
    detectors: dict[str, int] = {}
    for sweep in sweeps:
        for trial in sweep.trials:
            target = read_spec(trial.folder).stage.target
            detectors[trial.detector] = locate(target, "detector._target_").VERSION
            trained_by |= {
                read_marker(folder, folder.steps()[-1]).commit for folder in trial.folders
            }
    return {
        "commit": made_by.get("fl3d.commit", "unknown"),
        "trained_by": sorted(trained_by),
        "machine": made_by["fl3d.machine"],
        "packages": made_by["fl3d.packages"],
        "data": {
            "digest": data.digest,
            "image_digest": data.image_digest,
            "train_frames": len(data.train_ids),
        },
        "versions": {
            "keys": KEY_VERSION,
            "simulator": SIMULATOR_VERSION,
            "trainer": TRAINER_VERSION,
            "detectors": dict(sorted(detectors.items())),
        },
        "sweeps": {
            sweep.name: {"trials": len(sweep.trials), "protocol": sweep.protocol.id}
            for sweep in sweeps
        },
    }
