"""Figures that are drawn ahead of a report are those that it asks for."""

from pathlib import Path

from fl3d.analysis.found import judge_sweep
from fl3d.papers.drawings import draw_curves, draw_verdicts, drawing_jobs
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep

POINTS = [["detector=fcn3d", f"loss={loss}"] for loss in ("original", "enhanced")]
FIGURES = ("forest", "ap_over_level", "ap_over_steps", "ap_over_cut", "precision_recall")


def kept(sweep: FinishedSweep) -> dict[str, tuple[int, bytes]]:
    """When each figure was kept, and what."""
    found = {}
    for name in FIGURES:
        path = sweep.drawn_as(f"{name}_mine")
        assert path is not None
        found[name] = (path.stat().st_mtime_ns, path.read_bytes())
    return found


def test_a_report_finds_them_drawn_and_no_job_draws_them_again(
    simulated: Path, tmp_path: Path
) -> None:
    sweep = detected_sweep(simulated, tmp_path, POINTS, lambda trial: 0.0, "sweep.name=mine")
    jobs = list(drawing_jobs(0, sweep))
    assert [job.is_last for job in jobs] == [True, True]
    for job in jobs:
        job.run(sweep, *job.given)
    assert not list(drawing_jobs(0, sweep))
    before = kept(sweep)
    written = [*draw_verdicts(sweep, judge_sweep(sweep)), *draw_curves(sweep)]
    assert {path.stem for path in written} == {f"{name}_mine" for name in FIGURES}
    assert kept(sweep) == before
