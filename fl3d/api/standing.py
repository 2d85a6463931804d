"""What stays of a results folder as it is, while other sweeps of that folder are published anew."""

from __future__ import annotations

import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.api.outdated import outdated, words_in
from fl3d.api.words import Words
from fl3d.config.settings import Settings
from fl3d.core.errors import StoreError
from fl3d.papers.published import SWEEPS
from fl3d.papers.registry import tables_named
from fl3d.papers.stamp import data_of, files_of, read_stamp
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import open_scores, open_sweep
from fl3d.runs.scores import score_text
from fl3d.sweep.prepare import prepare_data


@dataclass(frozen=True)
class Standing:
    """The sweeps of a published folder that are left as they are.

    Args:
        folder: as it was published; it need not be there.
        stamp: of the folder; no sweeps where there is none.
        sweeps: those that are left.
    """

    folder: Path
    stamp: Mapping[str, Any]
    sweeps: tuple[FinishedSweep, ...]

    @property
    def origins(self) -> dict[str, Any]:
        """What the stamp says of them."""
        return {sweep.name: self.stamp["sweeps"][sweep.name] for sweep in self.sweeps}

    def copy(self, made: Path) -> None:
        """Begin a folder with what the sweeps that are left have written; empty where there is none."""
        if not self.sweeps:
            return
        shutil.copytree(self.folder, made)
        for name in self.stamp["sweeps"].keys() - self.origins:
            for path in files_of(made, self.stamp, name):
                path.unlink(missing_ok=True)

    def check(self, made: Path) -> None:
        """See that a folder that was made has all that is left, and that it is still true.

        Raises:
            StoreError: a file is not there that one of them feeds too, or another value has won a sweep that one of
                the folder builds on.
        """
        for name in self.origins:
            lost = [path for path in files_of(made, self.stamp, name) if not path.exists()]
            if lost:
                lost_names = ", ".join(path.relative_to(made).as_posix() for path in lost)
                raise StoreError(
                    f"{self.folder}: {name} feeds {lost_names} too, not made without it: add it to --only"
                )
        if self.sweeps:
            _refuse_other_winners(self.folder, made)


def find_standing(folder: Path, asked: Mapping[str, Words], words: Sequence[str]) -> Standing:
    """What is left of a published folder, and may be.

    Args:
        folder: as it was published; it need not be there.
        asked: the sweeps that are published in it anew, by name.
        words: that say where sweeps lie.

    Raises:
        StoreError: what would be left is no longer true, is of other data than those asked for, or cannot be told.
    """
    if not folder.exists():
        return Standing(folder, {"sweeps": {}}, ())
    stamp = read_stamp(folder)
    names = [name for name in SWEEPS if name in stamp["sweeps"] and name not in asked]
    if old := outdated(folder, names):
        raise StoreError(
            f"{folder}: its {', '.join(old)} would be left as published, but the code plans or scores other trials "
            f"today: add to --only: {' '.join(old)}"
        )
    if names:
        _refuse_other_data(folder, stamp, names, asked)
    sweeps = tuple(_open(folder, name, words) for name in names)
    _refuse_undrawn(folder, asked, sweeps)
    return Standing(folder, stamp, sweeps)


def _refuse_other_winners(published: Path, made: Path) -> None:
    """Refuse a folder in which a sweep builds on another value than the one that has won there."""
    after = {
        name: words_in(made, name, ()).settings.sweep.after for name in read_stamp(made)["sweeps"]
    }
    for name in outdated(made, [name for name, earlier in after.items() if earlier]):
        chain = [name]
        while earlier := after.get(chain[-1]):
            chain.append(earlier)
        raise StoreError(
            f"{published}: {name} builds on other values than those that have won there: add to --only: "
            f"{' '.join(chain)}"
        )


def _open(folder: Path, name: str, words: Sequence[str]) -> FinishedSweep:
    """A sweep as it was published: with its runs where the store has them of just these scores."""
    settings = words_in(folder, name, words).settings
    published = open_scores(settings, folder.parent)
    return published if (stored := _stored(settings, published)) is None else stored


def _stored(settings: Settings, published: FinishedSweep) -> FinishedSweep | None:
    try:
        stored = open_sweep(settings)
    except StoreError:  # none of its trials
        return None
    is_same = score_text(stored.scores) == published.source.read_text(encoding="utf-8")
    return stored if stored.is_from_store and is_same else None


def _refuse_other_data(
    folder: Path, stamp: Mapping[str, Any], names: Sequence[str], asked: Mapping[str, Words]
) -> None:
    for name, one in asked.items():
        own = data_of(prepare_data(one.settings.data))
        if own != stamp["data"]:
            raise StoreError(
                f"{folder}: its {', '.join(names)} would be left as published, of data {_told(stamp['data'])}; {name} "
                f"is of data {_told(own)} now. A folder is of one kind of data: publish all of its sweeps"
            )


def _told(data: Mapping[str, Any]) -> str:
    return f"{data['digest']} (pictures {data['image_digest']}, {data['train_frames']} frames)"


def _refuse_undrawn(
    folder: Path, asked: Mapping[str, Words], sweeps: Sequence[FinishedSweep]
) -> None:
    """Refuse to publish a sweep whose models a figure shows beside those of another that cannot be drawn."""
    for name, one in asked.items():
        for table in tables_named(one.settings.sweep.tables):
            figure = folder / "figures" / f"{table.joint_figure}.png"
            others = [
                sweep.name
                for sweep in sweeps
                if table.name in sweep.settings.sweep.tables and not sweep.is_from_store
            ]
            if table.joint_figure and others and figure.exists():
                raise StoreError(
                    f"{figure}: shows models of {name} and of {', '.join(others)}, of which "
                    f"{one.settings.store.root} does not hold the published runs: add to --only: {' '.join(others)}"
                )
