"""What a sweep that is published adds to a results folder."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from PIL import Image

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import judge_sweep
from fl3d.papers.base import Feeding
from fl3d.papers.drawings import draw_curves, draw_papers
from fl3d.papers.published import SWEEPS
from fl3d.papers.results import write_sweep
from fl3d.papers.stored import feeding_among
from fl3d.papers.tables import write_still_tables
from fl3d.papers.views import write_views
from fl3d.runs.finished import FinishedSweep

COLOURS = 256
PARTS = "parts"  # beside the folder: what a single sweep writes


def add_results(sweep: FinishedSweep, every: Sequence[FinishedSweep], folder: Path) -> list[str]:
    """Add the results of a sweep to a folder; the names of its files there.

    Args:
        sweep: the sweep.
        every: all sweeps of the folder, some of which feed a joint table with it.
        folder: of results.
    """
    part = folder.parent / PARTS  # alone there, so that its files are known
    own = replace(sweep, settings=replace(sweep.settings, results=part))
    written = own.settings.results_folder
    write_results(own, feeding_among(own, lambda: every))
    make_small(written / "figures")
    files = [path.relative_to(written) for path in written.rglob("*") if path.is_file()]
    shutil.copytree(written, folder, dirs_exist_ok=True)
    shutil.rmtree(part)
    return [path.as_posix() for path in files]


def make_small(figures: Path) -> None:
    """Leave no PDFs, which ``fl3d figures`` draws again, and PNGs of 256 colours: 2.5 MB where there were 7.4."""
    for pdf in figures.glob("*.pdf"):
        pdf.unlink()
    for png in figures.glob("*.png"):
        with Image.open(png) as picture:
            small = picture.convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        small.save(png, optimize=True)


def write_results(sweep: FinishedSweep, find: Feeding) -> None:
    """Write the tables and figures of a sweep into its results folder.

    Of one seed, which judges nothing, those of the papers alone: a clone stays small.
    """
    tables, _ = write_sweep(sweep, find, print)
    if SWEEPS[sweep.name] > 1:
        made = Contributions(sweep)
        judged = judge_sweep(sweep, contributions=made)
        write_views(sweep, tables, judged, print, made)
        draw_curves(sweep, made)
    write_still_tables(sweep)
    draw_papers(sweep, find)
