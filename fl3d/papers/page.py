"""Everything of one sweep on one page, in its results folder."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Sequence
from dataclasses import asdict
from functools import partial
from importlib.metadata import version
from pathlib import Path

import numpy as np

from fl3d.analysis.ahead import make_ahead
from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged
from fl3d.analysis.split_halves import HALVINGS, best_of_k_checkpoints
from fl3d.core.files import write_text
from fl3d.core.plurals import several
from fl3d.evaluation.selection import BEST_OF_LAST_STAGE
from fl3d.papers.base import Say
from fl3d.papers.drawings import draw_curves, draw_papers
from fl3d.papers.judged_views import tables_of_verdicts
from fl3d.papers.page_claims import claims_of_papers
from fl3d.papers.registry import PAPERS
from fl3d.papers.results import jobs_of, write_sweep
from fl3d.papers.stored import feeding
from fl3d.papers.tables import write_still_tables, write_tables
from fl3d.papers.views import judge_or_say, write_views
from fl3d.reports.figures.curves import best_of_k_figure
from fl3d.reports.halves import halves_table
from fl3d.reports.page import (
    Section,
    folded,
    link,
    listing,
    made_small,
    page,
    paragraph,
    picture,
    preformatted,
)
from fl3d.reports.render import to_html
from fl3d.reports.table import Table
from fl3d.reports.verdicts import findings
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.drawn import drawn
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.kept import Arrays, code_digest, kept
from fl3d.runs.spec import read_spec

CAPTIONS = {
    "ap_over_level": "AP of the last models by level, the mean over the seeds of training that the baseline has too "
    "(of a level without such, its own, and no bar); bars: 95 % intervals of 3D moderate (over frames alone where "
    "there is one seed; they may leave the panel); thin lines: the baseline, of all its seeds.",
    "ap_over_steps": "3D AP moderate over training: of each level the mean over its own seeds of training, at steps "
    "at which all of these have a checkpoint, in a band from the lowest to the highest (none around one seed); marks: "
    "the seeds' last and best, on average; dotted is where the trials' last stages begin, in a level's colour where "
    "levels differ in that.",
    "best_of_k": "Mean of the best of k checkpoints of a trial's last stage, and over each level's own seeds of "
    "training, for as many as all of these have: much of the rise is training itself.",
    "precision_recall": "Precision against recall of the last models, 3D moderate: at each recall the mean over each "
    "level's own seeds of training.",
    "ap_over_cut": "3D AP moderate against the score below which detections are dropped, the mean over each level's "
    "own seeds of training.",
}
FOREST = (
    "Gain of each level's last model over the baseline, with simultaneous 95 % intervals, verdict and number of seeds "
    "(n); grey: the margin within which a gain does not matter."
)
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
    make_ahead(sweeps, jobs_of(sweeps, curves=(main,)))
    contributions = Contributions(main)
    contributions.samples()  # what cannot be made is not begun
    found: list[str] = []
    tables: list[str] = []
    pictures: list[Path] = []
    of_sweeps = {main.name: contributions}
    for sweep in (part for one in sweeps for part in (one, *one.each_class())):
        find = feeding(sweep, words, published)
        made, _ = write_sweep(sweep, find, _quiet(say))
        own = contributions if sweep is main else Contributions(sweep)
        judged = judge_or_say(sweep, say, own)
        views = write_views(sweep, made, judged, _quiet(say), own)
        tables += _tables(made, views)
        question = None if sweep is main else _question(sweep)
        found += _found(sweep, judged, question)
        if sweep.class_name is None:
            of_sweeps[sweep.name] = own
        if sweep is main or sweep.class_name is not None:
            pictures += draw_curves(sweep, own)
        pictures += draw_papers(sweep, find)
    halves, more = _halves(contributions)
    pictures += more
    folder = main.settings.results_folder
    claims = claims_of_papers(of_sweeps, words, published)
    write_tables([*claims, halves], folder)
    still = write_still_tables(main)
    pngs = [path for path in pictures if path.suffix == ".png"]
    sections = [
        Section("Verdicts", tuple(found)),
        Section("Figures", tuple(_picture(main, path, _caption(path)) for path in pngs)),
        Section("Tables", tuple(tables)),
        Section("Claims of the papers", tuple(to_html(table) for table in claims)),
        Section("Last, best and honest best", (to_html(halves),)),
        Section("Networks", tuple(to_html(table) for table in still)),
        Section("Plan and provenance", _provenance(main, words)),
    ]
    path = folder / f"report_{main.name}.html"
    title = f"{main.name}: {main.settings.folder_name}"
    shown = [section for section in sections if section.parts]
    write_text(path, page(title, main.settings.sweep.question or "", shown))
    return path, pictures


def _question(sweep: FinishedSweep) -> str:
    """What stands above what a sweep has found: its question, and of a class the class."""
    asked = sweep.settings.sweep.question or sweep.settings.sweep.name
    return asked if sweep.class_name is None else f"{asked} ({sweep.class_name})"


def _found(sweep: FinishedSweep, judged: Judged | None, question: str | None) -> list[str]:
    """What a sweep has found: the question, unless the page begins with it, a picture, words, and the verdicts."""
    if judged is None:
        return []
    levels = levels_of(sweep)
    forest = sweep.settings.results_folder / "figures" / f"forest_{sweep.name}.png"
    parts = [paragraph(question)] if question else []
    parts += [_picture(sweep, forest, FOREST)] if forest.exists() else []
    parts += [listing(findings(judged.verdicts, levels, judged.margin))]
    return [*parts, *(to_html(table) for table in tables_of_verdicts(judged, levels))]


def _quiet(say: Say) -> Say:
    def quiet(line: str) -> None:
        if line.startswith(("Written", "No ")):
            say(line)

    return quiet


def _halves(made: Contributions) -> tuple[Table, list[Path]]:
    sweep = made.sweep
    levels = levels_of(sweep)
    notes = (f"{HALVINGS} random halvings of the validation frames, each in both directions.",)
    table = halves_table(
        sweep.scores,
        sweep.select("last"),
        sweep.select(BEST_OF_LAST_STAGE),
        made.halves(),
        levels,
        notes,
    )
    path = sweep.settings.results_folder / "figures" / f"best_of_k_{sweep.name}"
    figure = partial(best_of_k_figure, best_of_k_checkpoints(sweep.scores), levels)
    return table, drawn(sweep.drawn_as, path, figure)


def _picture(sweep: FinishedSweep, path: Path, caption: str) -> str:
    """A picture on the page; made small once, which takes a fifth of a second, and kept."""
    image = path.read_bytes()
    keep = sweep.drawn_as(f"small-{path.stem}")
    if keep is None:
        return picture(image, caption)

    def make() -> Arrays:
        return {"webp": np.frombuffer(made_small(image), dtype=np.uint8)}

    made_of = {
        "image": hashlib.sha256(image).hexdigest(),
        "code": code_digest("reports/page.py"),
        "pillow": version("pillow"),
    }
    return picture(image, caption, kept(keep, made_of, make)["webp"].tobytes())


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
        epochs = f"{several(stage.epochs, 'epoch')} of {several(stage.epoch_steps, 'step')}"
        stages.append(f"{stage.key}: {epochs} from step {stage.start_step}")
    return (
        preformatted(f"python -m fl3d -m {given}\npython -m fl3d report {given}"),
        listing(sorted(made - {""})),
        paragraph(f"Protocol {sweep.protocol.id}: {json.dumps(asdict(sweep.protocol))}"),
        folded("Stages", preformatted("\n".join(sorted(stages)))),
        link(ADDRESS, f"In MLflow (python -m fl3d ui): experiment {sweep.settings.stored_as}"),
    )
