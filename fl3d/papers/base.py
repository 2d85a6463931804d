"""What a paper is to fl3d: tables that are objects, figures, claims, and the published cells beside them."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.resources import files
from pathlib import Path
from typing import Any

import pandas as pd

from fl3d.analysis.ahead import Job
from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged
from fl3d.core.errors import ConfigError
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.plans import FrozenTrial

Say = Callable[[str], None]
# Where something of a name is kept, such as ``FinishedSweep.kept_as``; None: it is not.
Place = Callable[[str], Path | None]


class PaperTable(ABC):
    """A table of a paper, made again from finished sweeps.

    Attributes:
        name: how sweep files call it: ``focal_loss.last_voxelnet``.
        number: as printed; files are called after it.
        title: printed before its caption.
        rule: which checkpoint stands for a trial, see ``evaluation.selection.select``.
        is_joint: whether several sweeps feed it.
        joint_figure: of the models of all sweeps that feed it, which needs the run folders of all; empty: none.
    """

    name: str
    number: str
    title: str
    rule: str = "last"
    is_joint: bool = False
    joint_figure: str = ""

    @abstractmethod
    def row_of(self, trial: FrozenTrial) -> Hashable | None:
        """What tells the row that a trial belongs to from the others; None: it belongs to none.

        Raises:
            ConfigError: the trial lacks a value that the table's rows are told by.
        """

    @abstractmethod
    def make(self, sweeps: Sequence[FinishedSweep], notes: tuple[str, ...]) -> Table | None:
        """The table, or None where no trial has a row in it.

        Args:
            sweeps: that feed it: one, unless ``is_joint``.
            notes: put below.
        """

    def beside(self, table: Table) -> Table | None:
        """The table beside the published one; None where its own form has the published cells already."""
        return None

    def base_level(self, sweep: FinishedSweep) -> str | None:
        """Level that the paper holds the others of its table against, as the sweep calls it.

        None: the paper has none, or no trial of it is done; then it is the sweep's own baseline.
        """
        return None

    def intervals(self, table: Table, judged: Judged) -> Table | None:
        """The table with intervals and verdicts; None where it has none.

        Args:
            table: as made.
            judged: what the sweep has found, by the table's rule and against its ``base_level``.
        """
        return None

    def level_of(self, sweep: FinishedSweep, is_base: Callable[[FrozenTrial], bool]) -> str | None:
        """The one level of the trials that have a row in it and are of its baseline; None: none, or several."""
        rows = self.rows(sweep)
        own = {trial.level for trial in sweep.trials if trial.key in rows and is_base(trial.plan)}
        return own.pop() if len(own) == 1 else None

    def rows(self, sweep: FinishedSweep) -> set[str]:
        """Keys of the trials that have a row in it."""
        return {trial.key for trial in sweep.trials if self.row_of(trial.plan) is not None}

    def refuse_twins(self, trials: Iterable[FrozenTrial]) -> None:
        """Refuse trials that would share a row though they differ in more than their seed.

        Raises:
            ConfigError: naming the keys in which they differ.
        """
        seen: dict[tuple[Hashable, int], FrozenTrial] = {}
        for trial in trials:
            row = self.row_of(trial)
            if row is None:
                continue
            other = seen.setdefault((row, trial.seed), trial)
            if other.key != trial.key:
                keys = [key for key in trial.values if trial.values[key] != other.values.get(key)]
                raise ConfigError(
                    f"sweep.tables: two trials would share a row of {self.title.rstrip('.')}: they differ in "
                    f"{', '.join(keys) or 'other keys'}. Sweep one thing at a time, or set sweep.tables=[]"
                )


# What finds all sweeps that feed a joint table, see ``papers.stored.feeding``.
Feeding = Callable[[PaperTable], Sequence[FinishedSweep]]


@dataclass(frozen=True, kw_only=True)
class Paper:
    """A paper.

    Args:
        name: of its folder.
        tables: that sweeps feed, in printed order.
        still: tables that need no training, made now, given where what takes long is kept.
        draw: figures of a sweep into a folder, given what finds the sweeps that feed a joint table with it; every file
            written. None: it has none.
        jobs: what its figures and claims need that takes long and can be made ahead, of the sweep at a place, see
            ``analysis.ahead``; None: nothing.
        claims: sentences of it beside what some sweeps give; None: none are kept, or none are about such sweeps.
        captions: of figures, by their files' names without ending.
    """

    name: str
    tables: tuple[PaperTable, ...]
    still: Callable[[Place], list[Table]] = lambda _: []
    draw: Callable[[FinishedSweep, Path, Feeding], list[Path]] | None = None
    jobs: Callable[[int, FinishedSweep], Iterable[Job]] | None = None
    claims: Callable[[Sequence[Contributions]], Table | None] | None = None
    captions: Mapping[str, str] = field(default_factory=dict)


def published(package: str, name: str) -> pd.DataFrame:
    """Cells of a published table as strings, with a ``<column>_bold`` (0 or 1) beside each AP or recall.

    Args:
        package: of the paper.
        name: of the table's file, ``table_<name>.csv``.
    """
    return read_published(package, f"table_{name}.csv")


def read_published(package: str, file: str) -> pd.DataFrame:
    """A file beside a paper's code, of what it prints: all cells as strings.

    Args:
        package: of the paper.
        file: its name.
    """
    path = files(package) / "published" / file
    with path.open("r", encoding="utf-8") as opened:
        return pd.read_csv(opened, dtype=str, keep_default_na=False)


def with_values(
    sweep: FinishedSweep, rows: pd.DataFrame, columns: Mapping[str, str]
) -> pd.DataFrame:
    """Rows of a sweep's scores with values of their trials' configs.

    Args:
        sweep: the sweep.
        rows: some of its scores.
        columns: keys of the config by the columns that they become.
    """
    values: dict[str, dict[str, Any]] = {column: {} for column in columns}
    for trial in sweep.trials:
        for column, key in columns.items():
            values[column][trial.key] = trial.plan.value(key)
    return rows.assign(**{column: rows["trial"].map(found) for column, found in values.items()})
