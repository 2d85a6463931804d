"""What a results folder shows of a sweep: its scores, its tables in every form, and its curves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pandas as pd

from fl3d.analysis.ahead import Job, contribution_jobs
from fl3d.analysis.contributions import CUTS, Contributions
from fl3d.analysis.found import Judged, judge_sweep
from fl3d.config.settings import Settings
from fl3d.core.errors import CheckpointError, ConfigError, DataError, StoreError
from fl3d.core.files import remove_old_temporaries, write_text
from fl3d.data.classes import CARS
from fl3d.evaluation.average_precision import N_SAMPLES
from fl3d.evaluation.protocol import METRICS, Protocol
from fl3d.papers.base import Feeding, PaperTable
from fl3d.papers.judged_views import intervals_by_level, tables_of_verdicts
from fl3d.papers.registry import papers_of, tables_named
from fl3d.reports.figures.curves import (
    METRIC,
    ap_over_cut,
    ap_over_level,
    ap_over_steps,
    precision_recall,
)
from fl3d.reports.figures.forest import forest
from fl3d.reports.figures.style import beside
from fl3d.reports.levels import levels_table, slug
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.table import Table
from fl3d.runs.drawn import ToDraw, drawn_at
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.plans import is_of_program
from fl3d.runs.scores import score_file, score_text, write_score_file

Say = Callable[[str], None]
FIGURES = (".csv", ".png", ".pdf")  # what each figure is written as
GENERIC_AVERAGE = "R40"  # of tables that no paper prescribes: KITTI's own since 2019


def protocol_note(
    settings: Settings,
    average: str = "R11",
    of_results: bool = False,
    class_name: str | None = None,
) -> str:
    """What a reader must know of a table's APs.

    Args:
        settings: of the sweep.
        average: R11 or R40.
        of_results: whether they are of result files, which programs have suppressed themselves.
        class_name: of several classes the one that they are of; None: the one class, or the mean.
    """
    protocol = settings.protocol
    classes = protocol.classes if class_name is None else (class_name,)
    overlaps = [_overlaps_text(protocol, name) for name in classes]
    if len(classes) > 1:
        overlaps = [f"{text} for {name}" for text, name in zip(overlaps, classes, strict=True)]
    mean = classes[0] if len(classes) == 1 else f"mean over {', '.join(classes)}"
    what = "cars" if classes == CARS else "objects"
    names = " / ".join({"image": "image", "bev": "BEV", "3d": "3D"}[m] for m in protocol.metrics)
    levels = "" if protocol.uses_picture else f"; objects all around, {protocol.levels_text}"
    area = protocol.ignore_beyond
    limit = (
        f"; {what} beyond x {area[0]:g} to {area[2]:g} m, y {area[1]:g} to {area[3]:g} m ignored"
        if area
        else ""
    )
    suppression = "NMS as the programs did it" if of_results else f"NMS {protocol.nms_iou:g}"
    return (
        f"Data {settings.data.name}, profile {settings.profile}; {mean}, {average}, overlaps {', '.join(overlaps)} "
        f"({names}){levels}; score cut {protocol.score_threshold:g}, {suppression}{limit}."
    )


def _overlaps_text(protocol: Protocol, name: str) -> str:
    of_metric = dict(zip(METRICS, protocol.overlaps[name], strict=True))
    return " / ".join(f"{of_metric[metric]:g}" for metric in protocol.metrics)


def paper_tables(sweep: FinishedSweep) -> list[PaperTable]:
    """Tables of papers that a sweep feeds."""
    return tables_named(sweep.settings.sweep.tables)


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


def write_sweep(sweep: FinishedSweep, feeding: Feeding, say: Say) -> tuple[list[Table], list[Path]]:
    """Write a sweep's scores, tables and curves, and print the tables; they and every file written.

    The score file comes last: where it holds the scores of now, all other files are of them too.
    """
    folder = sweep.settings.results_folder
    remove_old_temporaries(folder)
    file = score_file(folder, sweep.name)
    is_part = sweep.class_name is not None  # whose scores lie in the whole sweep's file
    is_new = (
        is_part or not file.exists() or file.read_text(encoding="utf-8") != score_text(sweep.scores)
    )
    tables = make_tables(sweep, feeding)
    if is_new:
        remove_views(sweep.name, tables, folder)  # of other scores: a folder shows one set
    written = write_tables(tables, folder)
    levels = levels_of(sweep)
    figures = folder / "figures"
    last = sweep.select("last")
    steps = partial(ap_over_steps, sweep.scores, last, sweep.select("best"), levels)
    written += drawn_at(sweep.drawn_as, figures / f"ap_over_steps_{sweep.name}", steps)
    stem = figures / f"ap_over_level_{sweep.name}"
    bars = [beside(stem, ending) for ending in FIGURES]
    if is_new or not all(path.exists() for path in bars):
        ap_over_level(last, levels).write(stem)  # with intervals once tables are made again
    kept = [] if is_part else write_score_file(file, sweep.scores, sweep.plan)
    written = [*kept, *written, *bars]
    for table in tables:
        say("\n" + to_markdown(table))
    say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return tables, written


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
    by_rule = {"last": judged}
    views = []
    for table in tables:
        paper_table = named.get(table.name)
        rule = paper_table.rule if paper_table else "last"
        if rule not in by_rule:
            by_rule[rule] = judge_sweep(sweep, rule, contributions=contributions)
        if paper_table is not None:
            view = paper_table.intervals(table, by_rule[rule])
        else:
            view = _generic_intervals(sweep, table, judged)
        views += [view] if view is not None else []
    return views


def _generic_intervals(sweep: FinishedSweep, table: Table, judged: Judged) -> Table | None:
    group = next(group for group in sweep.groups if generic_name(sweep, group) == table.name)
    bold = f"better than {levels_of(sweep).text(sweep.baseline)}"
    return intervals_by_level(table, judged, group, bold, average=GENERIC_AVERAGE)


def verdict_views(sweep: FinishedSweep, judged: Judged) -> list[Table]:
    """The verdicts alone, one table a group."""
    found = tables_of_verdicts(judged, levels_of(sweep))
    return [replace(table, name=f"{sweep.name}_{table.name}") for table in found]


def verdict_figures(sweep: FinishedSweep, judged: Judged) -> dict[str, ToDraw]:
    """The forest plot, where there is a level beside the baseline, and AP over level with bars; by name."""
    levels = levels_of(sweep)
    chosen = sweep.select("last")
    return {
        "forest": partial(forest, judged.verdicts, levels, judged.margin),
        "ap_over_level": partial(ap_over_level, chosen, levels, judged.gains),
    }


def draw_verdicts(sweep: FinishedSweep, judged: Judged) -> list[Path]:
    """Write the figures of the verdicts; every file written."""
    return _write_figures(sweep, verdict_figures(sweep, judged))


def _write_figures(sweep: FinishedSweep, figures: Mapping[str, ToDraw]) -> list[Path]:
    folder = sweep.settings.results_folder / "figures"
    return [
        path
        for name, figure in figures.items()
        for path in drawn_at(sweep.drawn_as, folder / f"{name}_{sweep.name}", figure)
    ]


def write_tables(tables: Sequence[Table], folder: Path) -> list[Path]:
    """Each table as Markdown, LaTeX and CSV; every file written."""
    written = []
    for table in tables:
        for ending, render in (("md", to_markdown), ("tex", to_latex), ("csv", to_csv)):
            path = folder / "tables" / f"table_{table.name}.{ending}"
            write_text(path, render(table))
            written.append(path)
    return written


def remove_views(sweep: str, tables: Sequence[Table], folder: Path) -> None:
    """Remove other forms of some tables of a sweep, and its verdicts."""
    for table in tables:
        for view in ("published", "intervals"):
            for path in (folder / "tables").glob(f"table_{table.name}_{view}.*"):
                path.unlink()
    for path in (folder / "tables").glob(f"table_{sweep}_verdicts-*"):
        path.unlink()
    for ending in FIGURES:  # no pattern: sweep.1 is another sweep than sweep
        beside(folder / "figures" / f"forest_{sweep}", ending).unlink(missing_ok=True)


def rules_of(sweep: FinishedSweep) -> list[str]:
    """Which checkpoints of its trials a sweep's tables are about: the last, and perhaps the best."""
    return list(dict.fromkeys(["last", *(table.rule for table in paper_tables(sweep))]))


def jobs_of(sweeps: Sequence[FinishedSweep], curves: Sequence[FinishedSweep]) -> Iterator[Job]:
    """What tables, verdicts and figures of some sweeps need of their trials, as far as it is not kept.

    Args:
        sweeps: some sweeps.
        curves: those of them whose curves are drawn.
    """
    for place, sweep in enumerate(sweeps):
        yield from contribution_jobs(
            place, sweep, rules_of(sweep), any(sweep is one for one in curves)
        )
        for paper in papers_of(sweep.settings.sweep.tables):
            yield from paper.jobs(place, sweep) if paper.jobs is not None else ()


def score_figures(sweep: FinishedSweep) -> dict[str, ToDraw]:
    """What scores alone can show, by name: AP over steps and, without bars, over level."""
    levels = levels_of(sweep)
    last, best = sweep.select("last"), sweep.select("best")
    return {
        "ap_over_steps": partial(ap_over_steps, sweep.scores, last, best, levels),
        "ap_over_level": partial(ap_over_level, last, levels),
    }


def curve_figures(
    sweep: FinishedSweep, contributions: Contributions | None = None
) -> dict[str, ToDraw]:
    """Curves of any sweep by name: AP over steps and score cut, precision over recall.

    Args:
        sweep: its run folders must be at hand.
        contributions: of its trials, where they are at hand.
    """
    made = contributions or Contributions(sweep)
    levels = levels_of(sweep)
    last, best = sweep.select("last"), sweep.select("best")
    return {
        "ap_over_steps": partial(ap_over_steps, sweep.scores, last, best, levels),
        "ap_over_cut": partial(ap_over_cut, cut_curves(made), levels),
        "precision_recall": partial(precision_recall, precision_curves(made), levels),
    }


def draw_curves(sweep: FinishedSweep, contributions: Contributions | None = None) -> list[Path]:
    """Write the curves of any sweep, see ``curve_figures``; every file written."""
    return _write_figures(sweep, curve_figures(sweep, contributions))


def cut_curves(made: Contributions) -> pd.DataFrame:
    """3D AP moderate of the last models by score cut; a row a trial and cut, by group, level and seed."""
    sweep = made.sweep
    place = {level: number for number, level in enumerate(sweep.levels)}
    parts = []
    for trial in sorted(sweep.trials, key=lambda t: (t.group, place[t.level], t.seed)):
        front = {"group": trial.group, "level": trial.level, "seed": trial.seed}
        aps = {"score_threshold": CUTS, METRIC: made.at_cuts(trial)}
        parts.append(pd.DataFrame(front | aps))
    return pd.concat(parts, ignore_index=True)


def precision_curves(made: Contributions) -> pd.DataFrame:
    """Precision over recall of 3D moderate, seeds averaged: ``group``, ``level``, ``recall``, ``precision``."""
    recall = np.arange(N_SAMPLES) / (N_SAMPLES - 1)
    found: dict[tuple[str, str], list[np.ndarray]] = {
        (group, level): [] for group in made.sweep.groups for level in made.sweep.levels
    }
    for trial in made.sweep.trials:
        found[trial.group, trial.level].append(made.precision(trial))
    parts = []
    for (group, level), by_seed in found.items():
        if by_seed:
            precision = np.mean(by_seed, axis=0)
            front = {"group": group, "level": level}
            parts.append(pd.DataFrame(front | {"recall": recall, "precision": precision}))
    return pd.concat(parts, ignore_index=True)


def draw_papers(sweep: FinishedSweep, feeding: Feeding) -> list[Path]:
    """Figures of the papers whose tables a sweep feeds; every file written.

    Args:
        sweep: its run folders must be at hand.
        feeding: finds the sweeps that feed a joint table with it.
    """
    folder = sweep.settings.results_folder / "figures"
    drawing = [
        paper.draw for paper in papers_of(sweep.settings.sweep.tables) if paper.draw is not None
    ]
    return [path for draw in drawing for path in draw(sweep, folder, feeding)]


def write_still_tables(sweep: FinishedSweep) -> list[Table]:
    """Write the tables that need no training of the papers whose tables a sweep feeds; all of these."""
    tables = [
        table
        for paper in papers_of(sweep.settings.sweep.tables)
        for table in paper.still(sweep.kept_as)
    ]
    write_tables(tables, sweep.settings.results_folder)
    return tables
