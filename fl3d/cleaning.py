"""Free the disk: show what could go, and remove it only when told to."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tqdm import tqdm

from fl3d.errors import StoreError
from fl3d.leases import holder_of
from fl3d.records import Stage, StagePaths
from fl3d.sweep.retention import superfluous_weights

OLD_SECONDS = 3600.0  # a temporary file of this age belongs to a process that was killed


@dataclass(frozen=True)
class Waste:
    """Something that could go.

    Args:
        why: in words.
        path: file or folder.
    """

    why: str
    path: Path

    @property
    def size(self) -> int:
        """Bytes."""
        if self.path.is_file():
            return self.path.stat().st_size
        return sum(path.stat().st_size for path in self.path.rglob("*") if path.is_file())


def clean(root: Path, keep_every: int | None, delete: bool, orphans: bool, say: Callable[[str], None] = print) -> None:
    """Show, and with ``delete`` remove, what a store can do without.

    Args:
        root: of the store.
        keep_every: see ``retention.kept_epochs``.
        delete: whether to remove it.
        orphans: whether stages that no plan names go too: those of other versions, data or settings.
        say: prints a line for the user.

    Raises:
        StoreError: there is no store, or a sweep is running on it.
    """
    if not (root / "stages").is_dir():
        raise StoreError(f"{root}: there is no store; give --root FOLDER, the store.root of your sweeps")
    for lease in (root / "plans").glob("*.lease"):
        if delete and (holder := holder_of(lease)) is not None:
            raise StoreError(f"{lease.stem} is being run by {holder}; nothing is removed meanwhile")
    found = list(_weights(root, keep_every)) + list(_temporary(root))
    orphaned = list(_orphans(root))
    kinds: dict[str, list[Waste]] = {}
    for waste in [*found, *orphaned]:
        kinds.setdefault(waste.why, []).append(waste)
    if not kinds:
        say(f"{root}: nothing can go")
        return
    for why, members in kinds.items():
        kept = " (kept; --orphans takes them too)" if members[0] in orphaned and not orphans else ""
        say(f"{_bytes(sum(waste.size for waste in members)):>8}  {len(members)} {why}{kept}")
        for waste in members[:5]:
            say(f"          {waste.path.relative_to(root)}")
        if len(members) > 5:
            say(f"          ... and {len(members) - 5} more")
    going = [*found, *(orphaned if orphans else [])]
    total = _bytes(sum(waste.size for waste in going))
    if not delete:
        say(f"{total} can go. Nothing was removed; --yes removes it. Detections, scores and markers of plans stay.")
        return
    for waste in going:
        if waste.path.is_dir():
            shutil.rmtree(waste.path)
        else:
            waste.path.unlink(missing_ok=True)
    say(f"{total} removed")


def _stages(root: Path) -> Iterator[tuple[StagePaths, Stage]]:
    """Stages that nobody trains now."""
    for folder in sorted((root / "stages").glob("*")):
        paths = StagePaths(folder)
        if paths.spec.exists() and holder_of(paths.lease) is None:
            yield paths, Stage(**json.loads(paths.spec.read_text())["stage"])


def _weights(root: Path, keep_every: int | None) -> Iterator[Waste]:
    for paths, stage in _stages(root):
        if paths.done.exists():
            for path in superfluous_weights(paths, stage, keep_every):
                yield Waste("weights of checkpoints that are neither last, best nor every k-th", path)


def _temporary(root: Path) -> Iterator[Waste]:
    for path in sorted(root.rglob(".*.tmp")):
        if time.time() - path.stat().st_mtime > OLD_SECONDS:
            yield Waste("temporary files of processes that were killed", path)


def _orphans(root: Path) -> Iterator[Waste]:
    named: set[str] = set()
    for plan in (root / "plans").glob("*.json"):
        frozen = json.loads(plan.read_text())
        for trial in [*frozen["trials"], *frozen.get("earlier", [])]:
            named |= set(trial["stages"])
    for paths, _ in _stages(root):
        if paths.folder.name not in named:
            yield Waste("stages that no sweep's plan names", paths.folder)


def _bytes(count: float) -> str:
    return str(tqdm.format_sizeof(count, "B", 1000))
