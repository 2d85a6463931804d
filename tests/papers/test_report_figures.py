"""The report's Figure 6: one frame, both detectors."""

from pathlib import Path

from fl3d.papers.course_report.figures import figure_6
from tests.analysis.making import detected_sweep
from tests.reports.frames import is_figure


def test_figure_6_is_of_both_detectors_final_models(simulated: Path, tmp_path: Path) -> None:
    pointrcnn, fconvnet = (
        detected_sweep(simulated, tmp_path / name, [[swept]], lambda trial: 0.3, f"detector={name}")
        for name, swept in (("pointrcnn", "detector.rcnn.bin=0.3"), ("fconvnet", "loss.alpha=0.3"))
    )
    written = figure_6([pointrcnn, fconvnet], tmp_path / "report_figure_6")
    assert [path.name for path in written] == ["report_figure_6.png", "report_figure_6.pdf"]
    assert is_figure(written)
    for sweeps in ([pointrcnn], []):
        assert figure_6(sweeps, tmp_path / "none") == []
