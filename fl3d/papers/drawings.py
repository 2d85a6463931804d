"""Figures of a sweep: what scores, verdicts and detections show, and those of the papers that it feeds."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from fl3d.analysis.ahead import Job
from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged, judge_sweep
from fl3d.papers.base import Feeding
from fl3d.papers.curves import cut_curves, precision_curves
from fl3d.papers.registry import papers_of
from fl3d.reports.figures.curves import ap_over_cut, ap_over_level, ap_over_steps, precision_recall
from fl3d.reports.figures.forest import forest
from fl3d.runs.drawn import ToDraw, drawn
from fl3d.runs.finished import FinishedSweep, levels_of

FIGURE_ENDINGS = (".csv", ".png", ".pdf")  # what each figure is written as


def score_figures(sweep: FinishedSweep) -> dict[str, ToDraw]:
    """What scores alone can show, by name: AP over steps and, without bars, over level."""
    levels = levels_of(sweep)
    last, best = sweep.select("last"), sweep.select("best")
    return {
        "ap_over_steps": partial(ap_over_steps, sweep.scores, last, best, levels),
        "ap_over_level": partial(ap_over_level, last, levels),
    }


def verdict_figures(sweep: FinishedSweep, judged: Judged) -> dict[str, ToDraw]:
    """The forest plot, where there is a level beside the baseline, and AP over level with bars; by name."""
    levels = levels_of(sweep)
    chosen = sweep.select("last")
    return {
        "forest": partial(forest, judged.verdicts, levels, judged.margin),
        "ap_over_level": partial(ap_over_level, chosen, levels, judged.gains),
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


def drawing_jobs(place: int, sweep: FinishedSweep) -> Iterator[Job]:
    """Jobs that draw what shows verdicts and curves of a sweep ahead; what was drawn before is the report's to see.

    Args:
        place: of the sweep.
        sweep: its run folders must be at hand.
    """
    for name, draw in (("forest", _verdicts_ahead), ("precision_recall", _curves_ahead)):
        if sweep.is_undrawn(f"{name}_{sweep.name}"):
            yield Job(place, 1, draw, is_last=True)


def _verdicts_ahead(sweep: FinishedSweep) -> None:
    with TemporaryDirectory() as folder:
        _draw(sweep, verdict_figures(sweep, judge_sweep(sweep)), Path(folder))


def _curves_ahead(sweep: FinishedSweep) -> None:
    with TemporaryDirectory() as folder:
        _draw(sweep, curve_figures(sweep), Path(folder))


def draw_verdicts(sweep: FinishedSweep, judged: Judged) -> list[Path]:
    """Write the figures of the verdicts; every file written."""
    return _draw(sweep, verdict_figures(sweep, judged), _folder(sweep))


def draw_curves(sweep: FinishedSweep, contributions: Contributions | None = None) -> list[Path]:
    """Write the curves of any sweep, see ``curve_figures``; every file written."""
    return _draw(sweep, curve_figures(sweep, contributions), _folder(sweep))


def draw_papers(sweep: FinishedSweep, feeding: Feeding) -> list[Path]:
    """Figures of the papers whose tables a sweep feeds; every file written.

    Args:
        sweep: its run folders must be at hand.
        feeding: finds the sweeps that feed a joint table with it.
    """
    drawing = [
        paper.draw for paper in papers_of(sweep.settings.sweep.tables) if paper.draw is not None
    ]
    return [path for draw in drawing for path in draw(sweep, _folder(sweep), feeding)]


def _folder(sweep: FinishedSweep) -> Path:
    return sweep.settings.results_folder / "figures"


def _draw(sweep: FinishedSweep, figures: Mapping[str, ToDraw], folder: Path) -> list[Path]:
    return [
        path
        for name, figure in figures.items()
        for path in drawn(sweep.drawn_as, folder / f"{name}_{sweep.name}", figure)
    ]
