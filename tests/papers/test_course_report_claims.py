"""The report's sentences: by its own cells as it prints them, and by ours where sweeps have three seeds."""

from dataclasses import replace

import numpy as np
import pytest

from fl3d.analysis import AVERAGES
from fl3d.analysis.samples import CELLS, Measured, Resampled
from fl3d.papers.claim import Claim
from fl3d.papers.course_report.cells import Cells, our_cells
from fl3d.papers.course_report.claims import claims_of
from fl3d.papers.course_report.frustum_tables import DETECTORS, FRUSTUM
from fl3d.papers.course_report.recall_tables import RECALL_TABLES
from fl3d.papers.course_report.report_claims import claim_of, only_change_claim
from fl3d.papers.course_report.sentences import (
    DEFAULT,
    FRONTS,
    LEVELS,
    RECALLS,
    Place,
    sentences,
)
from fl3d.reports.verdicts import ONE_SEED
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.trials import FinishedTrial
from tests.papers.making import Made, finished_sweep
from tests.papers.test_course_report import (
    END,
    both_detectors,
    frustum_sweeps,
    recall_sweep,
    resolutions_sweep,
)

ALPHA = ("R6", ("first", "Alpha = 0.3"))
SENTENCES = (*sentences("PointRCNN"), *sentences("Frustum ConvNet"))


class Scored:
    """A source whose resampled APs are its scores, R40 one above R11; every resample is like the frames."""

    def __init__(self, sweep: FinishedSweep) -> None:
        self.sweep = sweep

    def resampled(self, trial: FinishedTrial, step: int) -> Resampled:
        own = self.sweep.scores
        row = own[(own["trial"] == trial.key) & (own["step"] == step)].iloc[0]
        r11 = np.array([row[f"ap_{metric}/{difficulty}"] for metric, difficulty in CELLS])
        values = np.stack([r11 + (name == "R40") for name in AVERAGES], axis=1)
        return Resampled(values, np.tile(values, (4, 1, 1)))


def cells_of(*sweeps: FinishedSweep) -> Cells:
    return our_cells([Scored(sweep) for sweep in sweeps])  # type: ignore[misc]


def naming(sweep: FinishedSweep, *tables: str) -> FinishedSweep:
    """A sweep that says which tables it feeds, called after what it sweeps."""
    name = "-".join(one.key for one in sweep.trials)
    asked = replace(sweep.settings.sweep, tables=tables, name=name)
    return replace(sweep, settings=replace(sweep.settings, sweep=asked))


def told(text: str, ours: Cells | None = None) -> Claim:
    """The claim whose text holds some words."""
    (sentence,) = [one for one in SENTENCES if text in one.text]
    return claim_of(sentence, ours or {})


@pytest.mark.parametrize(
    ("text", "recomputed", "verdict"),
    [
        ("batch of 32", "+0.000 to +0.005", "holds in 8 of 10"),  # a tie of all three at 0.9
        ("batch of 64 as of 16", "+0.002, +0.001, +0.001, +0.000, +0.000", "no bound was printed"),
        ("α = 0.80", "-0.001 to +0.022", "holds in 8 of 10"),  # worst of all at 0.9
        ("overlap up to 0.3", "+0.003, +0.002", "no bound was printed"),
        ("overlap from 0.5", "+0.008, +0.007, +0.001", "holds in its cells"),
        ("in bins of 0.3 m", "-0.001, +0.000, +0.001, +0.011, -0.004", "no bound was printed"),
        ("a batch of 16)", "+0.029, +0.026, +0.024, +0.012, +0.000", "holds in 4 of 5"),
        ("authors' weights", "-0.022, -0.033, -0.032, -0.064, -0.071", "holds in 3 of 5"),
        ("Frustum ConvNet: a batch of 64", "-1.07, -0.53, -1.70", "holds in its cells"),
        ("Frustum ConvNet: a batch of 8", "-17.34, -12.40, -11.75", "holds in its cells"),
        ("slabs of 1 m alone", "+0.10, -0.44, -0.50", "holds in 1 of 3"),
        ("larger slabs", "+3.07 to +10.87", "holds in its cells"),
        ("α = 0.2, medium", "+0.16", "holds in its cells"),
        ("α = 0.3", "+0.83, +0.28", "holds in its cells"),
        ("weight 30, hard", "+0.19", "holds in its cells"),
        ("after refinement", "+0.22, +5.94", "holds in its cells"),
        ("above PointRCNN", "+8.70", "holds in its cells"),
        ("above Frustum", "+6.80, +11.10", "holds in its cells"),
    ],
)
def test_the_reports_own_cells(text: str, recomputed: str, verdict: str) -> None:
    claim = told(text)
    assert (claim.recomputed, claim.ours, claim.verdict) == (recomputed, "", verdict)


def test_every_row_of_a_sentence_is_printed() -> None:
    places = {place for one in SENTENCES for place in (one.row, *one.over)}
    assert {number for number, _ in places} == set(FRONTS)
    for sentence in SENTENCES:
        assert claim_of(sentence, {}).recomputed
        assert set(sentence.columns) <= {*RECALLS, *LEVELS}


def test_ours_are_read_from_the_sweeps_of_each_table() -> None:
    recalls = [naming(recall_sweep(table.number), table.name) for table in RECALL_TABLES]
    ours = cells_of(
        *recalls, *(naming(one, FRUSTUM.name) for one in frustum_sweeps()), resolutions_sweep()
    )
    for sentence in SENTENCES:
        if sentence.row[0] == "R7":
            continue
        claim = claim_of(sentence, ours)  # sweeps that scored what the report printed
        assert claim.ours == f"{claim.recomputed}; 1 seed"
        assert claim.verdict.endswith(f"ours: {ONE_SEED}")


def seeds(place: Place, column: str, *values: float) -> Cells:
    return {
        (place, column): {n: Measured(value, np.full(4, value)) for n, value in enumerate(values)}
    }


def test_three_seeds_are_judged_by_intervals_that_hold_at_once() -> None:
    ours: dict = {}
    for column, gain in zip(LEVELS, (0.0, 5.0, -4.0), strict=True):
        ours |= seeds(DEFAULT, column, 60.0, 62.0, 61.0)
        ours |= seeds(ALPHA, column, 60.1 + gain, 61.9 + gain, 61.0 + gain)
    claim = told("α = 0.3", ours)
    assert "over seeds" not in claim.ours
    assert claim.verdict == "holds in its cells; ours: larger in 1, smaller in 1 of 2 cells"
    assert claim.ours.startswith("+5.00 [+4.")
    assert claim.ours.endswith("; 3 seeds")
    only = only_change_claim({"Alpha = 0.3": ALPHA}, ours)
    assert only.verdict == "holds in its cells; ours: larger at two levels: none"
    better = only_change_claim({"Alpha = 0.3": ALPHA}, ours | seeds(ALPHA, LEVELS[2], 65, 67, 66))
    assert better.verdict.endswith("larger at two levels: Alpha = 0.3")


def test_a_bound_other_than_zero_is_what_ours_are_held_against() -> None:
    row, over = ("R5", ("0.3 m", "Box Refinement")), ("R1", ("Box Refinement",))
    ours: dict = {}
    for column, gap in zip(RECALLS, (0.0, -0.02, -0.034, -0.05, -0.2), strict=True):
        ours |= seeds(over, column, 0.80, 0.82, 0.81)
        ours |= seeds(row, column, *(np.array([0.80, 0.82, 0.81]) + gap))
    assert told("authors' weights", ours).verdict == (
        "holds in 3 of 5; ours: larger than -0.035 in 3, smaller in 2 of 5 cells"
    )


def test_recalls_are_not_resampled_and_their_intervals_are_said_to_be_over_seeds() -> None:
    row, over = ("R5", ("0.3 m", "Box Refinement")), ("R1", ("Box Refinement",))
    ours: dict = {}
    for column in RECALLS:
        for place, recalls in ((row, (0.70, 0.72, 0.74)), (over, (0.80, 0.81, 0.82))):
            by_seed = {n: Measured(one, np.array([one])) for n, one in enumerate(recalls)}
            ours[place, column] = by_seed
    assert told("authors' weights", ours).ours.endswith("] over seeds; 3 seeds")


def test_models_that_were_chosen_on_the_frames_are_not_judged() -> None:
    claim = told(
        "above Frustum", cells_of(*(naming(one, DETECTORS.name) for one in both_detectors()))
    )
    assert claim.ours == "+5.00, +5.00; 1 seed"
    assert "no verdict: PointRCNN's setting was chosen" in claim.verdict


def test_sides_without_a_common_seed_say_nothing() -> None:
    ours = seeds(DEFAULT, LEVELS[1], 60.0) | {(ALPHA, LEVELS[1]): {7: Measured(61.0, np.zeros(4))}}
    assert told("α = 0.3", ours).ours == ""


def test_sweeps_under_another_protocol_are_not_paired() -> None:
    one, *others = (naming(one, FRUSTUM.name) for one in frustum_sweeps())
    settings = replace(one.settings, protocol=replace(one.protocol, score_threshold=0.5))
    assert len(cells_of(replace(one, settings=settings), *others)) < len(cells_of(one, *others))


def test_a_sweep_of_no_table_of_the_report_has_no_claims() -> None:
    sweep = finished_sweep(
        ("detector=voxelnet",), [Made(overrides=("loss.gamma=0",), scores={END: {}})]
    )
    assert claims_of([Scored(sweep)]) is None  # type: ignore[list-item]
