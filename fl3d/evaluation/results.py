"""Result files of somebody else's detector as a checkpoint's stored detections: every number as it was written.

They are what a program says in the end, after its own cut and suppression, with its own 2D boxes, classes and angles.
A protocol's suppression and its number of detections are not done again; a score cut above 0 is.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fl3d.core.errors import DataError
from fl3d.core.files import write_atomically
from fl3d.data.calibration import Calibration
from fl3d.data.classes import CARS
from fl3d.data.label_parser import FIELDS, Codes
from fl3d.data.label_table import LabelTable, read_table
from fl3d.data.labels import TYPES, Labels, labels_from_columns
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.stored import StoredDetections

APPLIES = ("variant", "score_threshold", "ignore_beyond")  # of a protocol, besides its overlaps
Float = NDArray[np.float64]


@dataclass(frozen=True)
class Results(StoredDetections):
    """The result files of several frames.

    Args:
        frame_ids: every frame that has a file, with or without lines.
        lines: of all files, in the frames' order.
        source: folder that they were read from.
        sha256: of the files' names and bytes.
    """

    frame_ids: tuple[str, ...]
    lines: LabelTable
    source: str
    sha256: str

    def labels_of(
        self,
        index: int,
        calibration: Calibration,
        image_size: tuple[int, int],
        protocol: Protocol,
    ) -> Labels:
        """The protocol's classes in one frame from its score on, best first; they are projected already."""
        kept = self._is_kept(protocol)
        found, types = [np.zeros(0, dtype=np.int64)], []
        for name in protocol.classes:
            lines = self._of(index, name)
            found.append(lines[kept[lines]])
            types += [name] * len(found[-1])
        lines = np.concatenate(found)
        order = np.argsort(-self.lines.scores[lines], kind="stable")
        values = self.lines.values[lines[order]]
        return labels_from_columns([types[k] for k in order], values, scored=True)

    def boxes_of(self, index: int, name: str, calibration: Calibration) -> Float:
        """See ``StoredDetections``."""
        return calibration.boxes_to_velo(self.lines.boxes_cam[self._of(index, name)])

    def table(
        self,
        calibrations: Sequence[Calibration],
        image_sizes: Sequence[tuple[int, int]],
        protocol: Protocol,
    ) -> LabelTable:
        """The lines of all frames from the protocol's score on, of whatever class; 0 cuts nothing."""
        kept = self._is_kept(protocol)
        before = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)  # kept lines before each
        offsets = before[self.lines.offsets]
        types, values = self.lines.types[kept], self.lines.values[kept]
        return LabelTable(offsets, types, values, self.lines.others)

    def _is_kept(self, protocol: Protocol) -> NDArray[np.bool_]:
        cut = protocol.score_threshold
        return self.lines.scores >= (cut if cut > 0 else -np.inf)

    def _of(self, index: int, name: str) -> NDArray[np.int64]:
        first, last = self.lines.offsets[index], self.lines.offsets[index + 1]
        return np.arange(first, last)[self.lines.of(name)[first:last]]


def read_results(folder: Path, ids: Sequence[str], classes: Sequence[str] = CARS) -> Results:
    """Read the result files of frames.

    Args:
        folder: holds ``<id>.txt`` of each.
        ids: of the frames.
        classes: that are scored.

    Raises:
        DataError: a file is missing, a line is malformed, or no line of any is of a class that is scored and some are
            of classes that KITTI does not name, which may be what the program calls cars. Pedestrians alone are what
            a detector of several classes may find early in its training.
    """
    table = read_table(folder, ids, scored=True)
    if table.others and not any(table.of(name).any() for name in classes):
        raise DataError(
            f"{len(table.types)} detections in {len(ids)} files, and no {' or '.join(classes)} among them; its types "
            f"are: {', '.join(_types_in(folder, ids))}",
            folder,
        )
    return Results(tuple(ids), table, str(folder), results_digest(folder, ids))


def results_digest(folder: Path, ids: Sequence[str]) -> str:
    """SHA-256 of the result files of frames: their names and bytes, by name.

    Raises:
        DataError: a file is missing.
    """
    found = hashlib.sha256()
    for frame_id in sorted(ids):
        path = folder / f"{frame_id}.txt"
        try:
            content = path.read_bytes()
        except OSError:
            raise DataError("no such file", path) from None
        found.update(f"{frame_id} {len(content)} ".encode() + content)
    return found.hexdigest()


def _types_in(folder: Path, ids: Sequence[str]) -> list[str]:
    found: set[str] = set()
    for frame_id in ids:
        lines = (
            (folder / f"{frame_id}.txt").read_text(encoding="utf-8", errors="replace").splitlines()
        )
        found |= {line.split()[0] for line in lines if line.split()}
    return sorted(found)


def write_results(path: Path, results: Results) -> None:
    """Store as Parquet: a row a line, its numbers as they were read."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    known = (*TYPES, *results.lines.others)
    names = [known[code] for code in results.lines.types]
    columns: dict[str, Any] = {"frame": results.lines.frame.astype(np.int32), "type": names}
    columns |= {name: results.lines.values[:, i] for i, name in enumerate(FIELDS[1:])}
    about = {"frames": json.dumps(results.frame_ids), "source": results.source}
    table = pa.table(columns).replace_schema_metadata({**about, "source_sha256": results.sha256})
    write_atomically(path, lambda temporary: pq.write_table(table, temporary, compression="zstd"))


def from_parquet(table: Any) -> Results:
    """What ``write_results`` wrote, from its Parquet table."""
    about = {
        key: table.schema.metadata[key].decode() for key in (b"frames", b"source", b"source_sha256")
    }
    ids = tuple(json.loads(about[b"frames"]))
    codes = Codes()
    types = np.array([codes.of(name) for name in table["type"].to_pylist()], dtype=np.int64)
    values = np.column_stack([table[name].to_numpy() for name in FIELDS[1:]])
    counts = np.bincount(table["frame"].to_numpy(), minlength=len(ids))
    offsets = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
    stored = LabelTable(
        offsets, types, np.ascontiguousarray(values, dtype=np.float64), codes.others
    )
    return Results(ids, stored, about[b"source"], about[b"source_sha256"])


def is_results(table: Any) -> bool:
    """Whether a Parquet table holds result files."""
    return b"source_sha256" in (table.schema.metadata or {})
