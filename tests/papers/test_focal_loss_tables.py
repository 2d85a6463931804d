"""A sweep that scored the paper's own numbers gives its Tables II to V back, cell by cell."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.contributions import Contributions
from fl3d.analysis.found import Judged
from fl3d.core.errors import ConfigError
from fl3d.papers.base import PaperTable
from fl3d.papers.focal_loss.best_models import (
    BEST_MODELS,
    BEST_OWN_MODELS,
    best_pairs,
    format_lr,
)
from fl3d.papers.focal_loss.paper import FOCAL_LOSS
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.focal_loss.tables import (
    LAST_3D_FCN,
    LAST_VOXELNET,
    LOSS_FORMS,
    OVER_GAMMA,
    is_over_gamma,
)
from fl3d.papers.registry import TABLES, papers_of, tables_named
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.units import Units
from tests.papers.making import Made, aps, finished_sweep, printed_aps

LAST_STEP = 222_720
FORK = 111_360
STEPS = {
    "126k": 126_208,
    "137k": 137_344,
    "134k": 133_632,
    "215k": 215_296,
}  # whole epochs of 3712 steps
YAML = {"3D-FCN": "fcn3d", "VoxelNet": "voxelnet"}
OF_GAMMA = ("+sweep=gamma", "data=kitti", "data.root=kitti", "profile=paper")
MADE_OF = {"II": LAST_3D_FCN, "III": LAST_VOXELNET, "IV": BEST_MODELS}


@pytest.fixture(scope="module")
def papers_sweep() -> FinishedSweep:
    """Every published last model at its last step, and every published best model at its own."""
    best = published_table("IV").to_dict("records")
    made = []
    for number in ("II", "III"):
        for row in published_table(number).to_dict("records"):
            scores = {3712: aps(1.0), LAST_STEP: printed_aps(row)}  # the first is of the warm-up
            for own in best:
                if (own["detector"], own["gamma"]) == (row["detector"], row["gamma"]):
                    scores[STEPS[own["step"]]] = printed_aps(own)
            overrides = (f"detector={YAML[row['detector']]}", f"loss.gamma={row['gamma']}")
            made.append(Made(overrides=overrides, scores=scores, first_own_step=FORK))
    return finished_sweep(OF_GAMMA, made)


@pytest.fixture(scope="module")
def tables(papers_sweep: FinishedSweep) -> dict[str, Table]:
    return {number: made(table, papers_sweep) for number, table in MADE_OF.items()}


def made(table: PaperTable, *sweeps: FinishedSweep) -> Table:
    found = table.make(sweeps, ("a note",))
    assert found is not None
    return found


def voxelnet_sweep(trials: Sequence[tuple[str, float]], *words: str) -> FinishedSweep:
    """Trials of VoxelNet: overrides, and the AP that each has at its one checkpoint."""
    made = [
        Made(overrides=tuple(overrides.split()), scores={100 * (place + 1): aps(ap)})
        for place, (overrides, ap) in enumerate(trials)
    ]
    return finished_sweep(("detector=voxelnet", *words), made)


@pytest.mark.parametrize("number", MADE_OF)
def test_the_papers_numbers_give_the_papers_table(tables: dict[str, Table], number: str) -> None:
    published = published_table(number).to_dict("records")
    table = tables[number]
    keys = [column.key for column in table.columns]
    assert len(table.rows) == len(published)
    for row, expected in zip(table.rows, published, strict=True):
        for key, cell in zip(keys, row, strict=True):
            assert cell.text == expected[key]
            if key in AP_COLUMNS:
                assert cell.bold == (expected[f"{key}_bold"] == "1"), (expected["gamma"], key)


def test_original_and_enhanced_loss_as_published() -> None:
    """In whichever order they were run."""
    published = published_table("V").to_dict("records")
    rows = [
        Made(overrides=(f"loss={row['loss'].lower()}",), scores={5: printed_aps(row)})
        for row in reversed(published)
    ]
    sweep = finished_sweep(("+sweep=loss_form",), rows)
    assert sweep.levels == ["enhanced", "original"]
    table = made(LOSS_FORMS, sweep)
    for own, theirs in zip(table.rows, published, strict=True):
        assert [cell.text for cell in own] == [theirs["loss"], *(theirs[key] for key in AP_COLUMNS)]
        assert [cell.bold for cell in own[1:]] == [
            theirs[f"{key}_bold"] == "1" for key in AP_COLUMNS
        ]


def test_csv_has_the_documented_columns_and_plain_numbers(tables: dict[str, Table]) -> None:
    ap_columns = "bev_easy,bev_moderate,bev_hard,3d_easy,3d_moderate,3d_hard"
    assert to_csv(tables["II"]).splitlines()[0] == f"gamma,{ap_columns}"
    rows = list(csv.DictReader(io.StringIO(to_csv(tables["IV"]))))
    assert list(rows[0]) == ["detector", "lr", "step", "gamma", *ap_columns.split(",")]
    assert (rows[0]["lr"], rows[0]["step"]) == ("0.01", "126208")


def test_markdown_sets_bold_and_order_as_the_paper(tables: dict[str, Table]) -> None:
    text = to_markdown(tables["IV"])
    assert "| Detector | γ | lr | Step | BEV Easy |" in text
    assert "| 3D-FCN | 2 | 1e-2 | 137k | **53.19** |" in text
    assert "| **58.39** | 57.60 |" in text


def test_latex_has_the_papers_heads(tables: dict[str, Table]) -> None:
    text = to_latex(tables["III"])
    assert r"\multicolumn{3}{c}{3D Detection AP (\%)}" in text
    assert r"0.1 & \textbf{85.93} &" in text
    assert text.count(r"\\") == 2 + 7
    assert text.count("{") == text.count("}")


def test_last_is_the_final_step(papers_sweep: FinishedSweep) -> None:
    assert set(papers_sweep.select("last")["step"]) == {LAST_STEP}


def forked_sweep(*words: str) -> FinishedSweep:
    """A warm-up to step 100 that both gammas share: it has the best model of seed 0, and not that of seed 1."""
    warmup, own = {0: 50.0, 1: 30.0}, {(0, 0): 40.0, (0, 1): 60.0, (2, 0): 45.0, (2, 1): 70.0}
    made = [
        Made(
            overrides=(f"loss.gamma={gamma}", f"seed={seed}"),
            scores={100: aps(warmup[seed]), 200: aps(ap)},
            first_own_step=100,
        )
        for (gamma, seed), ap in own.items()
    ]
    return finished_sweep(("detector=voxelnet", *words), made)


def test_best_models_are_of_all_weights_and_beside_them_of_the_last_stage_alone() -> None:
    """By hand: (50 + 60) / 2 and (50 + 70) / 2, of the last stage (40 + 60) / 2 and (45 + 70) / 2."""
    sweep = forked_sweep()
    table = made(BEST_MODELS, sweep)
    assert [cell.text for cell in table.column("3d_hard")] == ["55.00", "60.00"]
    assert [cell.bold for cell in table.column("3d_hard")] == [False, True]
    assert [cell.text for cell in table.column("step")] == ["100/200"] * 2
    earlier = "VoxelNet γ = 0 (1 of 2), VoxelNet γ = 2 (1 of 2)"
    assert f"of an earlier stage, which all γ share: {earlier}. In a seed" in table.notes[1]
    own = made(BEST_OWN_MODELS, sweep)
    assert [cell.text for cell in own.column("3d_hard")] == ["50.00", "57.50"]
    assert [cell.text for cell in own.column("step")] == ["200"] * 2
    assert own.notes[1] == "Best of the checkpoints of each trial's last stage."
    assert (own.name, BEST_OWN_MODELS.beside(own)) == ("IV_last_stage", None)


def test_table_iv_says_so_where_best_is_asked_of_the_last_stage() -> None:
    sweep = forked_sweep("selection.stages=last")
    table, own = made(BEST_MODELS, sweep), made(BEST_OWN_MODELS, sweep)
    assert table.rows == own.rows
    assert table.notes == own.notes


def test_the_papers_best_models_are_all_of_the_last_stage(tables: dict[str, Table]) -> None:
    note = "Best of all checkpoints of each trial; all of these rows are of its last stage."
    assert tables["IV"].notes[1] == note


def test_sweeps_over_gamma_are_told_by_tables_that_there_are() -> None:
    assert set(TABLES) >= OVER_GAMMA


def test_equal_is_not_better() -> None:
    """50.00 and 50.001 print alike."""
    table = made(LAST_VOXELNET, voxelnet_sweep([("loss.gamma=0", 50.0), ("loss.gamma=1", 50.001)]))
    assert len(table.rows) == 2
    assert not any(cell.bold for row in table.rows for cell in row)


def test_a_replicate_without_its_pair_is_said_and_makes_nothing_bold() -> None:
    """Gamma 1 has the better seed alone: its mean is above gamma 0's, and in the seed of both it is not."""
    trials = [("loss.gamma=0 seed=0", 1.0), ("loss.gamma=0 seed=1", 9.0)]
    table = made(LAST_VOXELNET, voxelnet_sweep([*trials, ("loss.gamma=1 seed=1", 8.0)]))
    assert [row[1].text for row in table.rows] == ["5.00", "8.00"]
    assert not any(cell.bold for row in table.rows for cell in row)
    assert "rows without all of seeds 0, 1: γ = 1 (1)" in table.notes[-1]


def test_seeds_are_averaged() -> None:
    trials = [("loss.gamma=0 seed=0", 1.0), ("loss.gamma=0 seed=1", 2.0)]
    sweep = voxelnet_sweep(trials)
    assert [cell.text for cell in made(LAST_VOXELNET, sweep).rows[0]] == ["0", *["1.50"] * 6]
    best = made(BEST_MODELS, sweep)
    assert best.column("step")[0].text == "100/200"
    assert best.notes[0::2] == ("a note", "Mean of 2 seeds of training.")


@pytest.mark.parametrize("table", [LAST_VOXELNET, BEST_MODELS])
def test_trials_that_would_share_a_row_are_refused_by_what_they_differ_in(
    table: PaperTable,
) -> None:
    """Their design tells them apart, as a group each; the table does not."""
    trials = [("loss.gamma=0 loss.alpha=1", 1.0), ("loss.gamma=0 loss.alpha=2", 2.0)]
    sweep = voxelnet_sweep(trials, "sweep.factor=loss.gamma")
    assert len(sweep.groups) == 2
    message = f"share a row of {table.title.rstrip('.')}: they differ in loss.alpha. "
    with pytest.raises(ConfigError, match=message):
        table.refuse_twins(trial.plan for trial in sweep.trials)
    with pytest.raises(ConfigError, match=message):
        table.make([sweep], ())


def test_seeds_and_trials_without_a_row_are_no_twins() -> None:
    trials = [
        ("loss.gamma=0 seed=0", 1.0),
        ("loss.gamma=0 seed=1", 2.0),
        ("loss.gamma=2 seed=0", 3.0),
    ]
    sweep = voxelnet_sweep(trials)
    LAST_VOXELNET.refuse_twins(trial.plan for trial in sweep.trials)
    other = voxelnet_sweep([("loss.alpha=1", 1.0), ("loss.alpha=2", 2.0)])
    LAST_3D_FCN.refuse_twins(trial.plan for trial in other.trials)
    assert LAST_3D_FCN.make([other], ()) is None


@pytest.mark.parametrize("table", [LAST_VOXELNET, BEST_MODELS])
def test_a_loss_without_gamma_is_refused_and_not_shown_as_gamma_zero(table: PaperTable) -> None:
    sweep = voxelnet_sweep([("loss.alpha=1", 1.0), ("loss.alpha=2", 2.0)], "~loss.gamma")
    with pytest.raises(ConfigError, match=r"needs loss\.gamma, which 'loss\.alpha=1' lacks"):
        table.make([sweep], ())


def test_a_gamma_that_is_not_swept_is_the_configs_own() -> None:
    sweep = voxelnet_sweep([("loss.alpha=1", 1.0)], "loss.gamma=0.50")
    assert made(LAST_VOXELNET, sweep).column("gamma")[0].text == "0.5"


def test_of_equal_values_written_otherwise_there_is_one_row() -> None:
    sweep = voxelnet_sweep([("loss.gamma=0.50 seed=0", 1.0), ("loss.gamma=0.5 seed=1", 3.0)])
    assert [[cell.text for cell in row[:2]] for row in made(LAST_VOXELNET, sweep).rows] == [
        ["0.5", "2.00"]
    ]


def test_of_all_focal_models_the_one_of_highest_mean_stands_for_them() -> None:
    trials = [
        ("loss.gamma=0", 9.0),
        ("loss.gamma=1", 5.0),
        ("loss.gamma=2", 7.0),
        ("loss.gamma=5", 6.0),
    ]
    pairs = best_pairs(voxelnet_sweep(trials), BEST_MODELS)
    assert pairs["gamma"].tolist() == [0, 2]


@pytest.mark.parametrize(
    ("value", "text"), [(0.01, "1e-2"), (0.0001, "1e-4"), (0.0025, "2.5e-3"), (1.0, "1e0")]
)
def test_learning_rates_print_as_in_the_paper(value: float, text: str) -> None:
    assert format_lr(value) == text


def test_a_table_that_no_paper_has_is_answered_with_those_that_are() -> None:
    with pytest.raises(
        ConfigError, match=r"no table 'focal_loss\.last_voxelnt'.*'focal_loss\.last_voxelnet'"
    ) as found:
        tables_named(["focal_loss.last_3d_fcn", "focal_loss.last_voxelnt"])
    assert all(name in str(found.value) for name in TABLES)


def test_tables_lead_to_their_paper() -> None:
    assert [paper.name for paper in papers_of(["focal_loss.best_models"])] == ["focal_loss"]
    assert [paper.name for paper in papers_of(["course_report.bins", "focal_loss.loss_forms"])] == [
        "focal_loss",
        "course_report",
    ]
    assert papers_of([]) == []
    assert all(name.startswith(("focal_loss.", "course_report.")) for name in TABLES)


def test_a_loss_that_does_not_say_whether_it_is_normalised_is_not_shown_as_the_original_one() -> (
    None
):
    sweep = finished_sweep(
        ("detector=fcn3d", "~loss.normalize"), [Made(overrides=("loss.beta=1",), scores={5: aps()})]
    )
    with pytest.raises(
        ConfigError, match=r"Table V\. needs loss\.normalize, which 'loss\.beta=1' lacks"
    ):
        LOSS_FORMS.make([sweep], ())


def test_a_detector_whose_baseline_is_not_done_has_no_table_with_intervals() -> None:
    sweep = voxelnet_sweep([("loss.gamma=1", 1.0), ("loss.gamma=2", 2.0)])
    front = {"group": ["3D-FCN"], "level": ["0"], "seeds": [1]}
    judged = Judged(
        samples={},
        gains=pd.DataFrame(front),
        verdicts=pd.DataFrame(front),
        units=Units("frames", np.arange(3), "a note"),
        margin=1.0,
        left_out=(),
    )
    assert LAST_VOXELNET.intervals(made(LAST_VOXELNET, sweep), judged) is None


def test_best_models_have_intervals_and_neither_stars_nor_verdicts() -> None:
    """They were chosen on the frames that the intervals are over."""
    sweep = voxelnet_sweep([("loss.gamma=0", 40.0), ("loss.gamma=2", 50.0)])
    table = made(BEST_MODELS, sweep)
    rows = [
        {
            "group": "VoxelNet",
            "level": level,
            "seeds": 3,
            "seeds_done": 3,
            "metric": "3d",
            "difficulty": "hard",
        }
        | {"average": "R11", "ap": ap, "ap_low": ap - 1, "ap_high": ap + 1, "gain": ap - 40}
        | {"marked": ap > 40, "one_r11_step": False}
        for level, ap in (("0", 40.0), ("2", 50.0))
    ]
    gains = pd.DataFrame(rows)
    units = Units("frames", np.arange(3), "a note")
    judged = Judged(samples={}, gains=gains, verdicts=gains, units=units, margin=1.0, left_out=())
    view = BEST_MODELS.intervals(table, judged)
    assert view is not None
    assert [cell.text for cell in view.column("3d_hard")] == [
        "40.00 [39.0, 41.0]",
        "50.00 [49.0, 51.0]",
    ]
    assert not any(cell.star for row in view.rows for cell in row)
    assert [column.key for column in view.columns] == [column.key for column in table.columns]
    assert any("no gain is marked here" in note for note in view.notes)


def test_a_sweep_of_loss_forms_has_no_figures_and_claims_over_gamma(tmp_path: Path) -> None:
    """Its trials all have gamma 0, and would be taken for twins."""
    rows = [
        Made(overrides=(f"loss={form}",), scores={10: aps(5)}) for form in ("original", "enhanced")
    ]
    sweep = finished_sweep(("+sweep=loss_form",), rows)
    assert not is_over_gamma(sweep)
    assert FOCAL_LOSS.draw is not None
    assert FOCAL_LOSS.claims is not None
    assert FOCAL_LOSS.draw(sweep, tmp_path, lambda table: []) == []
    assert FOCAL_LOSS.claims([Contributions(sweep)]) is None
    assert list(tmp_path.iterdir()) == []
