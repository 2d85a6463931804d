"""Free the disk: show the files that can be deleted, and delete them only when told to."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tqdm import tqdm

from fl3d.core.errors import StoreError
from fl3d.core.files import TEMPORARY, is_old_temporary
from fl3d.core.leases import holder_of, living
from fl3d.runs.layout import ASIDE, RunFolder, StoreFolder
from fl3d.runs.plans import named_stages
from fl3d.runs.retention import superfluous_weights

SHOWN = 5  # files of a kind that are named
HALF = "half-written results of programs that were killed and have written them again"
UPLOADING = ".artifact.uploading.*"  # what MLflow writes beside an artifact, and then renames


@dataclass(frozen=True)
class Waste:
    """Something that can be deleted.

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

    def delete(self) -> None:
        """Delete the file, or the folder with all in it."""
        if self.path.is_dir():
            shutil.rmtree(self.path)
        else:
            self.path.unlink(missing_ok=True)


@dataclass
class Findings:
    """What can be deleted in a store.

    Args:
        waste: what nobody needs.
        orphans: stages that no plan names.
        notes: what could not be told, and why.
    """

    waste: list[Waste] = field(default_factory=list)
    orphans: list[Waste] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def clean(
    root: Path,
    keep_every: int | None,
    *,
    delete: bool,
    orphans: bool,
    say: Callable[[str], None] = print,
) -> None:
    """Show, and with ``delete`` delete, the files of a store that nobody needs.

    Args:
        root: of the store.
        keep_every: see ``retention.kept_epochs``.
        delete: whether to delete them.
        orphans: whether stages that no plan names go too: those of other versions, data or
            settings.
        say: prints a line for the user.

    Raises:
        StoreError: there is no store, a sweep is running on it, or orphans are asked for and a plan
            cannot be read, so that nobody can tell which stages it names.
    """
    layout = StoreFolder(root)
    if not layout.stages.is_dir():
        raise StoreError(f"{root}: there is no store; give store.root=FOLDER as of your sweeps")
    if delete:
        _refuse_while_running(layout)
    found = _find(layout, keep_every, orphans)
    for note in found.notes:
        say(note)
    if not found.waste and not found.orphans:
        say(f"{root}: there is nothing to delete")
        return
    _show(root, found.waste, "", say)
    _show(root, found.orphans, "" if orphans else " (kept; --orphans takes them too)", say)
    going = [*found.waste, *(found.orphans if orphans else [])]
    total = _bytes(sum(one.size for one in going))
    if not delete:
        say(f"{total} can be deleted. Nothing was deleted; --yes does it.")
        say("Detections, scores and markers of the stages that plans name stay.")
        return
    for one in going:
        one.delete()
    say(f"{total} deleted")


def _refuse_while_running(layout: StoreFolder) -> None:
    for lease, holder in living(layout.leases()).items():
        name = lease.relative_to(layout.plans).with_suffix("")
        raise StoreError(f"{name} is being run by {holder}; nothing is deleted meanwhile")


def _find(layout: StoreFolder, keep_every: int | None, orphans: bool) -> Findings:
    found = Findings()
    idle = list(_idle_runs(layout))
    for run in idle:
        if run.is_done:
            _find_weights(run, keep_every, found)
            found.waste += [Waste(HALF, path) for path in sorted(run.work.rglob(f"*{ASIDE}*"))]
        if run.old_windows.is_dir():
            found.waste.append(Waste("windows as older versions kept them", run.old_windows))
    found.waste += _leases([*layout.leases(), *(run.lease for run in idle)])
    found.waste += _temporary(layout)
    try:
        named = named_stages(layout)
    except StoreError as error:
        if orphans:
            raise StoreError(f"--orphans: nobody can tell which stages it names: {error}") from None
        found.notes.append(f"Stages that no sweep's plan names are not looked for: {error}")
        return found
    for run in idle:
        if run.key not in named:
            found.orphans.append(Waste("stages that no sweep's plan names", run.path))
    return found


def _idle_runs(layout: StoreFolder) -> Iterator[RunFolder]:
    """Stages that nobody trains now."""
    runs = [run for run in layout.runs() if run.spec.exists()]
    held = living(run.lease for run in runs)
    yield from (run for run in runs if run.lease not in held)


def _find_weights(run: RunFolder, keep_every: int | None, found: Findings) -> None:
    why = "weights of checkpoints that are neither last, best nor every k-th"
    try:
        found.waste += [Waste(why, path) for path in superfluous_weights(run, keep_every)]
    except StoreError as error:  # of another version of fl3d
        found.notes.append(f"All its weights are kept: {error}")


def _leases(paths: Sequence[Path]) -> Iterator[Waste]:
    """What killed processes left of what nobody takes again: a stage that is done, a sweep that nobody resumes."""
    for path in paths:
        if path.exists() and holder_of(path) is None:
            yield Waste("leases of processes that were killed", path)


def _temporary(layout: StoreFolder) -> Iterator[Waste]:
    programs = [run.work for run in layout.runs()]
    for path in sorted(one for name in (TEMPORARY, UPLOADING) for one in layout.root.rglob(name)):
        is_ours = not any(path.is_relative_to(work) for work in programs)
        if is_ours and is_old_temporary(path):
            yield Waste("temporary files of processes that were killed", path)


def _show(root: Path, every: Sequence[Waste], remark: str, say: Callable[[str], None]) -> None:
    """Say what there is of each kind, with the names of a few."""
    kinds: dict[str, list[Waste]] = {}
    for one in every:
        kinds.setdefault(one.why, []).append(one)
    for why, members in kinds.items():
        size = _bytes(sum(one.size for one in members))
        say(f"{size:>8}  {len(members)} {why}{remark}")
        for one in members[:SHOWN]:
            say(f"          {one.path.relative_to(root)}")
        if len(members) > SHOWN:
            say(f"          ... and {len(members) - SHOWN} more")


def _bytes(count: float) -> str:
    return str(tqdm.format_sizeof(count, "B", 1000))
