"""A sweep of two classes: all cars are found somehow and no pedestrian, so that every mean is half of the cars'."""

from pathlib import Path

import numpy as np
import pytest

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import judge_sweep
from fl3d.analysis.gains import recalls
from fl3d.analysis.judge import Judge
from fl3d.analysis.samples import compare_sweep
from fl3d.papers.protocol_note import protocol_note
from fl3d.papers.results import write_sweep
from fl3d.papers.tables import generic_tables
from fl3d.papers.views import write_views
from fl3d.runs.finished import FinishedSweep
from tests.analysis.making import detected_sweep

POINTS = [[f"loss.gamma={gamma}", f"seed={seed}"] for gamma in (0, 2) for seed in (0, 1, 2)]
BOTH = "classes=[Car,Pedestrian]"


def noise(trial: object) -> float:
    return 0.05 if "loss.gamma=0" in trial.overrides else 0.4  # type: ignore[attr-defined]


@pytest.fixture(scope="module")
def sweep(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    root = tmp_path_factory.mktemp("two")
    return detected_sweep(simulated, root, POINTS, noise, BOTH, "sweep.name=two")


def test_scores_are_of_the_mean_and_of_each_class(sweep: FinishedSweep) -> None:
    scores = sweep.scores
    assert scores["ap_3d_r40/moderate/Car"].max() > 0
    assert (scores["ap_3d_r40/moderate/Pedestrian"] == 0).all()
    np.testing.assert_allclose(
        scores["ap_3d_r40/moderate"], scores["ap_3d_r40/moderate/Car"] / 2, rtol=1e-12
    )


def test_each_class_sees_the_sweep_by_its_own_scores(sweep: FinishedSweep) -> None:
    cars, people = sweep.each_class()
    assert [one.name for one in (sweep, cars, people)] == ["two", "two-Car", "two-Pedestrian"]
    assert cars.each_class() == ()
    assert (cars.scores["ap_3d/moderate"] == sweep.scores["ap_3d/moderate/Car"]).all()
    assert not [name for name in cars.scores if "Pedestrian" in name]
    assert (people.scores["recall_3d/0.5"] == 0).all()


def test_verdicts_are_of_the_mean_and_of_each_class(sweep: FinishedSweep) -> None:
    cars, people = sweep.each_class()
    mean, own, none = (judge_sweep(one, n_resamples=50) for one in (sweep, cars, people))
    np.testing.assert_allclose(mean.verdicts["ap"], own.verdicts["ap"] / 2)
    np.testing.assert_allclose(mean.verdicts["gain"], own.verdicts["gain"] / 2)
    assert set(own.verdicts["metric"]) == {"3d_r40/moderate/Car"}
    assert (none.verdicts["ap"] == 0).all()
    shares = recalls(compare_sweep(sweep), sweep.classes)["recall_0.1"]
    own_shares = recalls(compare_sweep(cars), cars.classes)["recall_0.1"]
    np.testing.assert_allclose(shares, own_shares / 2)


def test_the_primary_metric_decides_by_the_class_that_it_names(
    sweep: FinishedSweep, simulated: Path, tmp_path: Path
) -> None:
    words = (BOTH, "sweep.primary=3d_r40/moderate/Car")
    named = detected_sweep(simulated, tmp_path, POINTS, noise, *words)
    cars = judge_sweep(sweep.of_class("Car"), n_resamples=50).verdicts
    found = judge_sweep(named, n_resamples=50).verdicts
    while_it_runs = Judge(print, n_resamples=50).verdicts(named)
    for verdicts in (found, while_it_runs):
        np.testing.assert_allclose(verdicts["ap"], cars["ap"])
        assert set(verdicts["metric"]) == {"3d_r40/moderate/Car"}


def test_tables_and_figures_are_written_for_the_mean_and_for_each_class(
    sweep: FinishedSweep,
) -> None:
    folder = sweep.settings.results_folder
    for one in (sweep, *sweep.each_class()):
        tables, _ = write_sweep(one, lambda table: [], lambda line: None)
        write_views(one, tables, judge_sweep(one, n_resamples=50), lambda line: None)
    for name in ("two", "two-Car", "two-Pedestrian"):
        assert (folder / "tables" / f"table_{name}-voxelnet_intervals.md").exists()
        assert (folder / "figures" / f"forest_{name}.png").exists()
    assert [path.name for path in (folder / "scores").glob("*.csv")] == ["two.csv"]
    people = sweep.of_class("Pedestrian")
    (table,) = generic_tables(people, people.groups)
    assert table.caption.endswith(": Pedestrian")


def test_a_note_says_whose_ap_it_is(sweep: FinishedSweep) -> None:
    mean = protocol_note(sweep.settings, "R40")
    assert "mean over Car, Pedestrian, R40" in mean
    assert "0.7 / 0.5 / 0.5 for Car, 0.5 / 0.25 / 0.25 for Pedestrian" in mean
    own = protocol_note(sweep.settings, "R40", class_name="Pedestrian")
    assert "; Pedestrian, R40, overlaps 0.5 / 0.25 / 0.25 (image" in own


def test_curves_are_of_the_mean_and_of_each_class(sweep: FinishedSweep) -> None:
    trial = sweep.trials[0]
    mean, cars, people = (Contributions(one, 20) for one in (sweep, *sweep.each_class()))
    for curve in (Contributions.precision, Contributions.at_cuts):
        np.testing.assert_allclose(
            curve(mean, trial), (curve(cars, trial) + curve(people, trial)) / 2
        )
    assert curve(cars, trial).max() > 0
