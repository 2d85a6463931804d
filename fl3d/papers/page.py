"""Everything of one sweep on one page, in its results folder."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import pandas as pd

from fl3d.analysis.gains import compare_sweep, gains
from fl3d.analysis.split_halves import HALVINGS, best_of_k_checkpoints, split_halves
from fl3d.core.files import write_text
from fl3d.papers.registry import PAPERS, papers_of
from fl3d.papers.results import (
    Say,
    draw_curves,
    draw_papers,
    levels_of,
    write_still_tables,
    write_sweep,
    write_tables,
    write_views,
)
from fl3d.papers.stored import feeding
from fl3d.reports.figures.curves import best_of_k_figure
from fl3d.reports.halves import halves_table
from fl3d.reports.page import Section, folded, link, listing, page, paragraph, picture, preformatted
from fl3d.reports.render import to_html
from fl3d.reports.table import Table
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec

CAPTIONS = {
    "ap_over_level": "AP of the last models by level; bars: 95 % intervals of 3D moderate; thin lines: the baseline.",
    "ap_over_steps": "3D AP moderate of every checkpoint; the dotted line is where each trial's last stage begins.",
    "best_of_k": "Mean of the best of k checkpoints of a trial's whole curve: much of the rise is training itself.",
    "precision_recall": "Precision against recall of the last models, 3D moderate.",
    "ap_over_cut": "3D AP moderate against the score below which detections are dropped.",
}
ADDRESS = "http://127.0.0.1:5000/#/experiments?workflowType=machine_learning"


def write_page(
    sweeps: Sequence[FinishedSweep], words: Sequence[str], published: Path | None, say: Say
) -> tuple[Path, list[Path]]:
    """Make tables, figures and claims of some sweeps, and one page of them; the page, and every picture on it.

    Args:
        sweeps: the first is what the page is about; the others' tables and figures stand below its own.
        words: that say where they lie.
        published: folder of results that were published, for joint tables; None: none.
        say: prints a line for the user.
    """
    main = sweeps[0]
    compared = compare_sweep(main)  # what cannot be made is not begun
    tables: list[str] = []
    pictures: list[Path] = []
    for sweep in sweeps:
        made, _ = write_sweep(sweep, feeding(sweep, words, published), _quiet(say))
        tables += _tables(made, write_views(sweep, made, _quiet(say)))
        if sweep is main:
            pictures += draw_curves(sweep, compared)
        pictures += draw_papers(sweep)
    halves, more = _halves(main)
    pictures += more
    folder = main.settings.results_folder
    papers = papers_of(main.settings.sweep.tables)
    drawn = [paper.claims(main) for paper in papers if paper.claims is not None]
    claims = [table for table in drawn if table is not None]
    write_tables([*claims, halves], folder)
    still = write_still_tables(main)
    pngs = [path for path in pictures if path.suffix == ".png"]
    sections = [
        Section("In short", (listing(findings(gains(compared, main.baseline), main)),)),
        Section("Tables", tuple(tables)),
        Section("Figures", tuple(picture(path.read_bytes(), _caption(path)) for path in pngs)),
        Section("Claims of the paper", tuple(to_html(table) for table in claims)),
        Section("Last, best and honest best", (to_html(halves),)),
        Section("Networks", tuple(to_html(table) for table in still)),
        Section("Plan and provenance", _provenance(main, words)),
    ]
    path = folder / f"report_{main.name}.html"
    title = f"{main.name}: {main.settings.folder_name}"
    shown = [section for section in sections if section.parts]
    write_text(path, page(title, main.settings.sweep.question or "", shown))
    return path, pictures


def findings(table: pd.DataFrame, sweep: FinishedSweep) -> list[str]:
    """For each group, which gains in the primary metric are significant."""
    view, difficulty = sweep.settings.sweep.metric.split("/")
    average = sweep.settings.sweep.average
    own = table[
        (table["metric"] == view)
        & (table["difficulty"] == difficulty)
        & (table["average"] == average)
    ]
    levels = levels_of(sweep)
    found = []
    for group, rows in own.groupby("group"):
        base = rows[rows["level"] == sweep.baseline].iloc[0]
        interval = f"{base['ap']:.1f} [{base['ap_low']:.1f}, {base['ap_high']:.1f}]"
        clear = levels.sorted(rows[rows["significant"] & (rows["level"] != sweep.baseline)])
        parts = [
            f"{levels.text(str(row.level))}: {row.gain:+.1f} [{row.gain_low:+.1f}, {row.gain_high:+.1f}]"
            for row in clear.itertuples()
        ]
        told = (
            f"intervals that exclude zero: {'; '.join(parts)}"
            if parts
            else "no gain's interval excludes zero"
        )
        metric = f"{view.upper()} AP {difficulty} ({average})"
        found.append(f"{group}: {metric} {interval} at {levels.text(sweep.baseline)}; {told}.")
    seeds = int(own["seeds"].max())
    over = (
        "frames alone, from one seed of training"
        if seeds == 1
        else f"frames and {seeds} seeds of training"
    )
    return [*found, f"Intervals of 95 % over {over}."]


def _quiet(say: Say) -> Say:
    def quiet(line: str) -> None:
        if line.startswith(("Written", "No ")):
            say(line)

    return quiet


def _halves(sweep: FinishedSweep) -> tuple[Table, list[Path]]:
    levels = levels_of(sweep)
    notes = (f"{HALVINGS} random halvings of the validation frames, each in both directions.",)
    table = halves_table(
        sweep.scores,
        sweep.select("last"),
        sweep.select("best"),
        split_halves(sweep),
        levels,
        sweep.settings.best_among,
        notes,
    )
    path = sweep.settings.results_folder / "figures" / f"best_of_k_{sweep.name}"
    return table, best_of_k_figure(best_of_k_checkpoints(sweep.scores), levels, path)


def _caption(path: Path) -> str:
    captions = {name: text for paper in PAPERS for name, text in paper.captions.items()}
    if path.stem in captions:
        return captions[path.stem]
    return next((text for name, text in CAPTIONS.items() if path.stem.startswith(name)), path.stem)


def _tables(tables: Sequence[Table], views: Sequence[Table]) -> list[str]:
    """Each table with intervals, the other forms folded below it."""
    parts = []
    for table in tables:
        own = {view.view: view for view in views if view.base == table.name}
        title = table.title.rstrip(".") or table.caption
        parts.append(to_html(own.get("intervals", table)))
        if "published" in own:
            parts.append(folded(f"{title} beside the published one", to_html(own["published"])))
        if own:
            parts.append(folded(f"{title} without intervals", to_html(table)))
    return parts


def _provenance(sweep: FinishedSweep, words: Sequence[str]) -> tuple[str, ...]:
    """Commands, where the trials were made, and where MLflow shows them."""
    given = " ".join(words)
    folders = {folder.key: folder for trial in sweep.trials for folder in trial.folders}
    stages = []
    made: set[str] = set()
    for folder in folders.values():
        stage = read_spec(folder).stage
        marker = read_marker(folder, folder.steps()[-1])
        changed = " with changes" if "fl3d.diff" in marker.made_by else ""
        made.add(f"commit {marker.commit[:12]}{changed}; {marker.made_by.get('fl3d.machine', '')}")
        made.add(marker.made_by.get("fl3d.packages", ""))
        epochs = f"{stage.epochs} epochs of {stage.epoch_steps} steps"
        stages.append(f"{stage.key}: {epochs} from step {stage.start_step}")
    return (
        preformatted(f"python -m fl3d -m {given}\npython -m fl3d report {given}"),
        listing(sorted(made - {""})),
        paragraph(f"Protocol {sweep.protocol.id}: {json.dumps(asdict(sweep.protocol))}"),
        folded("Stages", preformatted("\n".join(sorted(stages)))),
        link(ADDRESS, f"In MLflow (make ui): experiment {sweep.settings.experiment}"),
    )
