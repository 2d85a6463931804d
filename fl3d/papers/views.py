"""What stands beside a sweep's tables: the published cells, intervals, and the verdicts alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged, judge_sweep
from fl3d.core.errors import CheckpointError, ConfigError, DataError, StoreError
from fl3d.papers.base import Say
from fl3d.papers.drawings import FIGURE_ENDINGS, draw_verdicts
from fl3d.papers.judged_views import intervals_by_level, tables_of_verdicts
from fl3d.papers.tables import GENERIC_AVERAGE, generic_name, paper_tables, write_tables
from fl3d.reports.figures.style import beside
from fl3d.reports.render import to_markdown
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep, levels_of


def write_views(
    sweep: FinishedSweep,
    tables: Sequence[Table],
    judged: Judged | None,
    say: Say,
    contributions: Contributions | None = None,
) -> list[Table]:
    """Write each table beside the published one, with intervals and verdicts, and the verdicts alone; all of these.

    Args:
        sweep: the sweep.
        tables: as ``write_sweep`` made them.
        judged: what the sweep has found; None: only what needs no detections is written.
        say: prints a line for the user.
        contributions: of its trials, where they are at hand.
    """
    named = {table.number: table for table in paper_tables(sweep)}
    views = [
        view
        for table in tables
        if table.name in named
        for view in [named[table.name].beside(table)]
        if view
    ]
    if judged is not None:
        views += interval_views(sweep, tables, judged, contributions)
        views += verdict_views(sweep, judged)
    for view in views:
        say("\n" + to_markdown(view))
    folder = sweep.settings.results_folder
    written = write_tables(views, folder)
    if judged is not None:
        written += draw_verdicts(sweep, judged)
    if written:
        say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return views


def judge_or_say(
    sweep: FinishedSweep, say: Say, contributions: Contributions | None = None
) -> Judged | None:
    """What a sweep has found; None, and a line why, where that cannot be told."""
    try:
        return judge_sweep(sweep, contributions=contributions)
    except ConfigError as error:
        say(f"No verdicts: {error}")
    except (CheckpointError, DataError, StoreError) as error:
        say(f"No verdicts, which need stored detections and the data's labels: {error}")
    return None


def interval_views(
    sweep: FinishedSweep,
    tables: Sequence[Table],
    judged: Judged,
    contributions: Contributions | None = None,
) -> list[Table]:
    """The tables with intervals and verdicts."""
    named = {table.number: table for table in paper_tables(sweep)}
    found = {("last", sweep.baseline): judged}
    views = []
    for table in tables:
        paper_table = named.get(table.name)
        if paper_table is None:
            view = _generic_intervals(sweep, table, judged)
        else:
            # A paper's bold and its verdicts are about the paper's baseline, whichever the sweep was asked for.
            held = sweep.against(paper_table.base_level(sweep) or sweep.baseline)
            place = (paper_table.rule, held.baseline)
            if place not in found:
                found[place] = judge_sweep(held, paper_table.rule, contributions=contributions)
            view = paper_table.intervals(table, found[place])
            view = view and view.with_notes(*view.notes, *_other_baseline(sweep, held))
        views += [view] if view is not None else []
    return views


def _other_baseline(sweep: FinishedSweep, held: FinishedSweep) -> tuple[str, ...]:
    """What must be said where a paper's table is held against another level than the sweep."""
    if held is sweep:
        return ()
    levels = levels_of(sweep)
    own, papers = levels.text(sweep.baseline), levels.text(held.baseline)
    return (f"Held against {papers}, as in the paper; the sweep's own verdicts are against {own}.",)


def _generic_intervals(sweep: FinishedSweep, table: Table, judged: Judged) -> Table | None:
    group = next(group for group in sweep.groups if generic_name(sweep, group) == table.name)
    bold = f"better than {levels_of(sweep).text(sweep.baseline)}"
    return intervals_by_level(table, judged, group, bold, average=GENERIC_AVERAGE)


def verdict_views(sweep: FinishedSweep, judged: Judged) -> list[Table]:
    """The verdicts alone, one table a group."""
    found = tables_of_verdicts(judged, levels_of(sweep))
    return [replace(table, name=f"{sweep.name}_{table.name}") for table in found]


def remove_views(sweep: str, tables: Sequence[Table], folder: Path) -> None:
    """Remove other forms of some tables of a sweep, and its verdicts."""
    for table in tables:
        for view in ("published", "intervals"):
            for path in (folder / "tables").glob(f"table_{table.name}_{view}.*"):
                path.unlink()
    for path in (folder / "tables").glob(f"table_{sweep}_verdicts-*"):
        path.unlink()
    for ending in FIGURE_ENDINGS:  # no pattern: sweep.1 is another sweep than sweep
        beside(folder / "figures" / f"forest_{sweep}", ending).unlink(missing_ok=True)
