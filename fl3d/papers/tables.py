"""The tables of a sweep: as papers print them, and one for each group that no paper's table shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fl3d.core.files import write_text
from fl3d.papers.base import Feeding, PaperTable
from fl3d.papers.protocol_note import protocol_note
from fl3d.papers.registry import papers_of, tables_named
from fl3d.reports.levels import levels_table, slug
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.plans import is_of_program

GENERIC_AVERAGE = "R40"  # of tables that no paper prescribes: KITTI's own since 2019


def paper_tables(sweep: FinishedSweep) -> list[PaperTable]:
    """Tables of papers that a sweep feeds."""
    return tables_named(sweep.settings.sweep.tables)


def rules_of(sweep: FinishedSweep) -> list[str]:
    """Which checkpoints of its trials a sweep's tables are about: the last, and perhaps the best."""
    return list(dict.fromkeys(["last", *(table.rule for table in paper_tables(sweep))]))


def generic_name(sweep: FinishedSweep, group: str) -> str:
    """What the table of a group is called, where no paper has it."""
    return f"{sweep.name}-{slug(group)}"


def make_tables(sweep: FinishedSweep, feeding: Feeding) -> list[Table]:
    """The tables of a sweep as papers print them, and one for each group whose last models no paper's table shows.

    Args:
        sweep: the sweep.
        feeding: all sweeps that feed a joint table, this one among them.

    Raises:
        ConfigError: trials would share a row of a paper's table though they differ in more than their seed.
    """
    named = paper_tables(sweep)
    notes = (protocol_note(sweep.settings),)
    made = []
    for table in named:
        sweeps = feeding(table) if table.is_joint else [sweep]
        for one in sweeps:
            table.refuse_twins(trial.plan for trial in one.trials)
        made.append(table.make(sweeps, notes))
    shown = {key for table in named if table.rule == "last" for key in table.rows(sweep)}
    groups = sorted({trial.group for trial in sweep.trials if trial.key not in shown})
    return [table for table in made if table is not None] + generic_tables(sweep, groups)


def generic_tables(sweep: FinishedSweep, groups: Sequence[str]) -> list[Table]:
    """Last models of some groups by level, as no paper prescribes it."""
    last = sweep.select("last")
    levels = levels_of(sweep)
    tables = []
    for group in groups:
        of_results = any(
            is_of_program(trial.plan) for trial in sweep.trials if trial.group == group
        )
        notes = (
            protocol_note(sweep.settings, GENERIC_AVERAGE, of_results, class_name=sweep.class_name),
        )
        name = generic_name(sweep, group)
        table = levels_table(last, group, levels, name, GENERIC_AVERAGE, notes)
        if sweep.class_name is not None:
            table = replace(table, caption=f"{table.caption}: {sweep.class_name}")
        tables.append(table)
    return tables


def write_tables(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Each table as Markdown, LaTeX and CSV; every file written."""
    written = []
    for table in tables:
        for ending, render in (("md", to_markdown), ("tex", to_latex), ("csv", to_csv)):
            path = folder / "tables" / f"table_{table.name}.{ending}"
            write_text(path, render(table))
            written.append(path)
    return written


def write_still_tables(sweep: FinishedSweep) -> list[Table]:
    """Write the tables that need no training of the papers whose tables a sweep feeds; all of these."""
    tables = [
        table
        for paper in papers_of(sweep.settings.sweep.tables)
        for table in paper.still(sweep.kept_as)
    ]
    write_tables(tables, sweep.settings.results_folder)
    return tables
