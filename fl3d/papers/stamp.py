"""The stamp of a results folder: from what data it is, and by what and where each of its sweeps was made."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from fl3d.config.objects import locate
from fl3d.core.errors import StoreError
from fl3d.core.files import write_text
from fl3d.papers.published import SWEEPS
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec
from fl3d.simulator import VERSION as SIMULATOR_VERSION
from fl3d.sweep.plan import KEY_VERSION
from fl3d.sweep.prepare import PreparedData
from fl3d.training.trainer import VERSION as TRAINER_VERSION

STAMP = "stamp.json"
OF_ALL = ("keys", "simulator")  # versions that hold for a folder
OF_EACH = ("commit", "trained_by", "machine", "packages")  # in old stamps said once, of all sweeps
# Of the files of a sweep that are called after it, for stamps that list none.
FIGURES_OF_SWEEPS = ("ap_over_cut", "ap_over_level", "ap_over_steps", "forest", "precision_recall")


def read_stamp(folder: Path) -> dict[str, Any]:
    """The stamp of a results folder.

    ``data`` and ``versions`` (of keys and of the simulator) hold for all of it; ``sweeps`` has of each sweep its
    ``commit``, ``trained_by`` (commits), ``machine``, ``packages``, ``versions`` (of the trainer and of detectors),
    ``trials`` (their number), ``protocol`` and ``files``. Of a folder whose stamp says the first five once, each sweep
    has those of the folder, and no files.

    Raises:
        StoreError: there is none, or it is torn.
    """
    path = folder / STAMP
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        own = _by_sweep(content) if "commit" in content else content["sweeps"]
        versions = {key: content["versions"][key] for key in OF_ALL}
        return {"data": content["data"], "versions": versions, "sweeps": dict(own)}
    except FileNotFoundError:
        raise StoreError(f"{path}: no such file; it says which sweeps the folder holds") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError(f"{path}: is no stamp of a results folder ({error})") from None


def _by_sweep(old: Mapping[str, Any]) -> dict[str, Any]:
    """What a stamp says of each sweep whose sweeps were all published at once."""
    versions = {key: old["versions"][key] for key in ("trainer", "detectors")}
    shared = {**{key: old[key] for key in OF_EACH}, "versions": versions}
    return {name: {**shared, **one} for name, one in old["sweeps"].items()}


def write_stamp(folder: Path, data: PreparedData, sweeps: Mapping[str, Mapping[str, Any]]) -> None:
    """Say in a results folder where it comes from.

    Args:
        folder: that holds the results.
        data: that all its sweeps are of.
        sweeps: what is said of each, by name, see ``origin``.
    """
    content = {
        "data": data_of(data),
        "versions": {"keys": KEY_VERSION, "simulator": SIMULATOR_VERSION},
        "sweeps": {name: sweeps[name] for name in SWEEPS if name in sweeps},
    }
    write_text(folder / STAMP, json.dumps(content, indent=1) + "\n")


def data_of(data: PreparedData) -> dict[str, Any]:
    """What a stamp says of the data."""
    return {
        "digest": data.digest,
        "image_digest": data.image_digest,
        "train_frames": len(data.train_ids),
    }


def origin(
    sweep: FinishedSweep, made_by: Mapping[str, str], files: Sequence[str]
) -> dict[str, Any]:
    """What a stamp says of a sweep.

    Args:
        sweep: the sweep.
        made_by: see ``core.provenance.provenance``.
        files: that it has written, from the results folder on.
    """
    trained_by: set[str] = set()
    detectors: dict[str, int] = {}
    for trial in sweep.trials:
        target = read_spec(trial.folder).stage.target
        detectors[trial.detector] = locate(target, "detector._target_").VERSION
        trained_by |= {read_marker(folder, folder.steps()[-1]).commit for folder in trial.folders}
    return {
        "commit": made_by.get("fl3d.commit", "unknown"),
        "trained_by": sorted(trained_by),
        "machine": made_by["fl3d.machine"],
        "packages": made_by["fl3d.packages"],
        "versions": {"trainer": TRAINER_VERSION, "detectors": dict(sorted(detectors.items()))},
        "trials": len(sweep.trials),
        "protocol": sweep.protocol.id,
        "files": sorted(files),
    }


def files_of(folder: Path, stamp: Mapping[str, Any], sweep: str) -> list[Path]:
    """The files that a sweep has written into a results folder, as far as that can be told.

    Where its stamp lists none they are those that are called after the sweep; papers' tables and figures are not.
    """
    listed = stamp["sweeps"][sweep].get("files")
    if listed is not None:
        return [folder / name for name in listed]
    figures = {f"{kind}_{sweep}" for kind in FIGURES_OF_SWEEPS}
    tables = (f"table_{sweep}-", f"table_{sweep}_verdicts-")
    return [
        *(path for path in folder.glob("scores/*") if path.stem == sweep),
        *(path for path in folder.glob("figures/*") if path.stem in figures),
        *(path for path in folder.glob("tables/*") if path.name.startswith(tables)),
    ]
