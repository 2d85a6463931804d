"""What a results folder shows of a sweep: its scores, its tables in every form, and its curves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
import pandas as pd

from fl3d.analysis.gains import Comparisons, compare_sweep, gains
from fl3d.analysis.rescore import rescore
from fl3d.config.settings import Settings
from fl3d.core.errors import ConfigError, DataError, StoreError
from fl3d.core.files import write_text
from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.papers.base import PaperTable
from fl3d.papers.registry import papers_of, tables_named
from fl3d.reports.figures.curves import ap_over_cut, ap_over_level, ap_over_steps, precision_recall
from fl3d.reports.intervals import with_intervals
from fl3d.reports.levels import Levels, levels_table, slug
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.table import Table
from fl3d.runs.design import factor_name
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.scores import score_file, write_score_file

Say = Callable[[str], None]
GENERIC_AVERAGE = "R40"  # of tables that no paper prescribes: KITTI's own since 2019
CUTS = (0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)


def levels_of(sweep: FinishedSweep) -> Levels:
    """The levels of a sweep, as tables and figures tell them."""
    return Levels(factor_name(sweep.factor), sweep.levels, sweep.baseline)


def protocol_note(settings: Settings, average: str = "R11") -> str:
    """What a reader must know of a table's APs."""
    protocol = settings.protocol
    overlaps = " / ".join(f"{value:g}" for value in protocol.overlaps["Car"])
    area = protocol.ignore_beyond
    limit = (
        f"; cars beyond x {area[0]:g} to {area[2]:g} m, y {area[1]:g} to {area[3]:g} m ignored"
        if area
        else ""
    )
    return (
        f"Data {settings.data.name}, profile {settings.profile}; Car, {average}, overlaps {overlaps} "
        f"(image / BEV / 3D); score cut {protocol.score_threshold:g}, NMS {protocol.nms_iou:g}{limit}."
    )


def paper_tables(sweep: FinishedSweep) -> list[PaperTable]:
    """Tables of papers that a sweep feeds."""
    return tables_named(sweep.settings.sweep.tables)


def generic_name(sweep: FinishedSweep, group: str) -> str:
    """What the table of a group is called, where no paper has it."""
    return f"{sweep.name}-{slug(group)}"


def make_tables(
    sweep: FinishedSweep, feeding: Callable[[PaperTable], Sequence[FinishedSweep]]
) -> list[Table]:
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
    notes = (protocol_note(sweep.settings, GENERIC_AVERAGE),)
    last = sweep.select("last")
    levels = levels_of(sweep)
    return [
        levels_table(last, group, levels, generic_name(sweep, group), GENERIC_AVERAGE, notes)
        for group in groups
    ]


def write_sweep(
    sweep: FinishedSweep, feeding: Callable[[PaperTable], Sequence[FinishedSweep]], say: Say
) -> tuple[list[Table], list[Path]]:
    """Write a sweep's scores, tables and curves, and print the tables; they and every file written."""
    folder = sweep.settings.results_folder
    file = score_file(folder, sweep.name)
    before = file.read_text() if file.exists() else ""
    written = write_score_file(file, sweep.scores, sweep.plan)
    tables = make_tables(sweep, feeding)
    written += write_tables(tables, folder)
    if file.read_text() != before:
        remove_views(tables, folder)  # of other scores: a folder shows one set
    levels = levels_of(sweep)
    figures = folder / "figures"
    last = sweep.select("last")
    written += ap_over_steps(
        sweep.scores, last, sweep.select("best"), levels, figures / f"ap_over_steps_{sweep.name}"
    )
    bars = figures / f"ap_over_level_{sweep.name}"
    if file.read_text() != before or not bars.with_suffix(".png").exists():
        ap_over_level(last, levels, bars)  # with intervals once tables are made again
    written += [bars.with_suffix(ending) for ending in (".csv", ".png", ".pdf")]
    for table in tables:
        say("\n" + to_markdown(table))
    say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return tables, written


def write_views(sweep: FinishedSweep, tables: Sequence[Table], say: Say) -> list[Table]:
    """Write each table beside the published one, and with intervals where detections are stored; all of these."""
    named = {table.number: table for table in paper_tables(sweep)}
    views = [
        view
        for table in tables
        if table.name in named
        for view in [named[table.name].beside(table)]
        if view
    ]
    try:
        views += interval_views(sweep, tables)
    except ConfigError as error:
        say(f"No intervals of gains: {error}")
    except (DataError, StoreError) as error:
        say(f"No intervals, which need stored detections and the data's labels: {error}")
    for view in views:
        say("\n" + to_markdown(view))
    folder = sweep.settings.results_folder
    written = write_tables(views, folder)
    if written:
        say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return views


def interval_views(sweep: FinishedSweep, tables: Sequence[Table]) -> list[Table]:
    """The tables with intervals, and AP over level with bars."""
    named = {table.number: table for table in paper_tables(sweep)}
    by_rule: dict[str, pd.DataFrame] = {}
    views = []
    for table in tables:
        paper_table = named.get(table.name)
        rule = paper_table.rule if paper_table else "last"
        if rule not in by_rule:
            by_rule[rule] = gains(compare_sweep(sweep, rule), sweep.baseline)
        if paper_table is not None:
            view = paper_table.intervals(table, by_rule[rule])
        else:
            view = _generic_intervals(sweep, table, by_rule[rule])
        views += [view] if view is not None else []
    if "last" in by_rule:
        bars = sweep.settings.results_folder / "figures" / f"ap_over_level_{sweep.name}"
        ap_over_level(sweep.select("last"), levels_of(sweep), bars, by_rule["last"])
    return views


def _generic_intervals(sweep: FinishedSweep, table: Table, found: pd.DataFrame) -> Table | None:
    group = next(group for group in sweep.groups if generic_name(sweep, group) == table.name)
    own = found[found["group"] == group]
    if own.empty:
        return None
    bold = f"better than {levels_of(sweep).text(sweep.baseline)}"
    return with_intervals(table, own.assign(row=own["level"]), bold, average=GENERIC_AVERAGE)


def write_tables(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Each table as Markdown, LaTeX and CSV; every file written."""
    written = []
    for table in tables:
        for ending, render in (("md", to_markdown), ("tex", to_latex), ("csv", to_csv)):
            path = folder / "tables" / f"table_{table.name}.{ending}"
            write_text(path, render(table))
            written.append(path)
    return written


def remove_views(tables: Sequence[Table], folder: Path) -> None:
    """Remove other forms of some tables."""
    for table in tables:
        for view in ("published", "intervals"):
            for path in (folder / "tables").glob(f"table_{table.name}_{view}.*"):
                path.unlink()


def draw_curves(sweep: FinishedSweep, compared: Comparisons) -> list[Path]:
    """Curves of any sweep: AP over steps, levels and score cut, precision over recall; every file written.

    Args:
        sweep: its run folders must be at hand.
        compared: its last models, see ``analysis.gains.compare_sweep``.
    """
    folder = sweep.settings.results_folder / "figures"
    levels = levels_of(sweep)
    last = sweep.select("last")
    best = sweep.select("best")
    try:
        found = gains(compared, sweep.baseline)
    except ConfigError:  # no trial of the baseline is done
        found = None
    written = ap_over_steps(
        sweep.scores, last, best, levels, folder / f"ap_over_steps_{sweep.name}"
    )
    written += ap_over_level(last, levels, folder / f"ap_over_level_{sweep.name}", found)
    cuts = rescore(sweep, {"score_threshold": CUTS})
    written += ap_over_cut(cuts, levels, folder / f"ap_over_cut_{sweep.name}")
    curves = precision_curves(compared)
    return written + precision_recall(curves, levels, folder / f"precision_recall_{sweep.name}")


def precision_curves(compared: Comparisons) -> pd.DataFrame:
    """Precision over recall of 3D moderate, seeds averaged: ``group``, ``level``, ``recall``, ``precision``."""
    recall = np.arange(N_SAMPLES) / (N_SAMPLES - 1)
    parts = []
    for group, levels in compared.items():
        for level, by_seed in levels.items():
            precision = np.mean(
                [c.curve("Car", "3d", "moderate").precision for c in by_seed.values()], axis=0
            )
            front = {"group": group, "level": level}
            parts.append(pd.DataFrame(front | {"recall": recall, "precision": precision}))
    return pd.concat(parts, ignore_index=True)


def draw_papers(sweep: FinishedSweep) -> list[Path]:
    """Figures of the papers whose tables a sweep feeds; every file written."""
    folder = sweep.settings.results_folder / "figures"
    drawing = [
        paper.draw for paper in papers_of(sweep.settings.sweep.tables) if paper.draw is not None
    ]
    return [path for draw in drawing for path in draw(sweep, folder)]


def write_still_tables(sweep: FinishedSweep) -> list[Table]:
    """Write the tables that need no training of the papers whose tables a sweep feeds; all of these."""
    tables = [table for paper in papers_of(sweep.settings.sweep.tables) for table in paper.still()]
    write_tables(tables, sweep.settings.results_folder)
    return tables
