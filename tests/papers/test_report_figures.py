"""The report's Figure 6: one frame, both detectors."""

from dataclasses import replace
from pathlib import Path

from fl3d.papers.course_report.figures import figure_6
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep


def final_model(sweep: FinishedSweep, detector: str, key: str, value: float) -> FinishedSweep:
    """A sweep of one trial, as if it were of another detector."""
    (trial,) = sweep.trials
    plan = replace(trial.plan, detector=detector, values={key: value})
    return replace(sweep, trials=(replace(trial, plan=plan),))


def test_figure_6_is_of_both_detectors_final_models(simulated: Path, tmp_path: Path) -> None:
    sweep = detected_sweep(simulated, tmp_path, [["detector=fcn3d", "loss.gamma=1"]], lambda t: 0.3)
    pointrcnn = final_model(sweep, "PointRCNN", "detector.rcnn.bin", 0.3)
    fconvnet = final_model(sweep, "F-ConvNet", "loss.alpha", 0.3)
    written = figure_6([pointrcnn, fconvnet], tmp_path / "report_figure_6")
    assert [path.name for path in written] == ["report_figure_6.png", "report_figure_6.pdf"]
    assert all(path.stat().st_size for path in written)
    for sweeps in ([pointrcnn], []):
        assert figure_6(sweeps, tmp_path / "none") == []
