"""What a results folder shows of a sweep, and what that needs of its trials."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

from fl3d.analysis.ahead import Job, contribution_jobs
from fl3d.core.files import remove_old_temporaries
from fl3d.papers.base import Feeding, Say
from fl3d.papers.drawings import FIGURE_ENDINGS, drawing_jobs
from fl3d.papers.registry import papers_of
from fl3d.papers.tables import make_tables, rules_of, write_tables
from fl3d.papers.views import remove_views
from fl3d.reports.figures.curves import ap_over_level, ap_over_steps
from fl3d.reports.figures.style import beside
from fl3d.reports.render import to_markdown
from fl3d.reports.table import Table
from fl3d.runs.drawn import drawn
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.scores import score_file, score_text, write_score_file


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
    written += drawn(sweep.drawn_as, figures / f"ap_over_steps_{sweep.name}", steps)
    stem = figures / f"ap_over_level_{sweep.name}"
    bars = [beside(stem, ending) for ending in FIGURE_ENDINGS]
    if is_new or not all(path.exists() for path in bars):
        ap_over_level(last, levels).write(stem)  # with intervals once tables are made again
    kept = [] if is_part else write_score_file(file, sweep.scores, sweep.plan)
    written = [*kept, *written, *bars]
    for table in tables:
        say("\n" + to_markdown(table))
    say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return tables, written


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
        yield from drawing_jobs(place, sweep) if any(sweep is one for one in curves) else ()
        for paper in papers_of(sweep.settings.sweep.tables):
            yield from paper.jobs(place, sweep) if paper.jobs is not None else ()
