"""The report's tables: sweeps that scored its own cells give its Tables 1 to 7 back."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import pytest

from fl3d.core.errors import ConfigError
from fl3d.papers.course_report.frustum_tables import (
    DETECTORS,
    FIRST,
    FRUSTUM,
    KITTI_LEVEL,
    LEVELS,
    SECOND,
)
from fl3d.papers.course_report.published_cells import published_table
from fl3d.papers.course_report.recall_tables import NETWORKS, OVERLAPS, RECALL_TABLES, RecallTable
from fl3d.papers.course_report.resolutions_table import RESOLUTIONS
from fl3d.papers.registry import TABLES
from fl3d.reports.render import to_latex, to_markdown
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep
from tests.papers.making import Made, aps, finished_sweep

Row = Mapping[Any, Any]
FORK = 10
END = 20
BATCH = "schedule.stages.rpn.set.schedule.batch_size"
# What a row's trial is swept to, and whether its sweep has both stages.
SWEPT: Mapping[str, tuple[Callable[[Row], str], bool]] = {
    "R1": (lambda row: "seed=0", True),
    "R2": (lambda row: f"{BATCH}={row['batch_size']}", False),
    "R3": (lambda row: f"loss.alpha={row['alpha_fg']}", False),
    "R4": (
        lambda row: (
            f"detector.rpn={{search:{row['search_range'][:-1]},bin:{row['bin_size'][:-1]}}}"
        ),
        False,
    ),
    "R5": (lambda row: f"detector.rcnn.bin={row['rcnn_bin_size'].removesuffix(' m')}", True),
}
BY_NUMBER = {table.number: table for table in RECALL_TABLES}


def recalls(row: Row) -> dict[str, float]:
    return aps() | {f"recall_3d/{overlap}": float(row[f"iou_{overlap}"]) for overlap in OVERLAPS}


def recall_sweep(number: str, *words: str) -> FinishedSweep:
    """Scores that say what the report printed.

    Proposals at the first stage's end, refined boxes at the second's.
    """
    write, has_both = SWEPT[number]
    trials: dict[str, Made] = {}
    for row in published_table(number).to_dict("records"):
        step = FORK if row.get("network") == NETWORKS[0] else END
        overrides = write(row)
        trial = trials.get(
            overrides, Made(overrides=(overrides,), scores={}, first_own_step=FORK * has_both)
        )
        trials[overrides] = replace(trial, scores={**trial.scores, step: recalls(row)})
    return finished_sweep(("detector=pointrcnn", *words), list(trials.values()))


def with_more(sweep: FinishedSweep, more: FinishedSweep) -> FinishedSweep:
    """A sweep with the trials of another."""
    scores = type(sweep.scores)(sweep.scores.to_dict("records") + more.scores.to_dict("records"))
    trials = sweep.trials + more.trials
    return replace(
        sweep,
        plan=replace(sweep.plan, trials=tuple(t.plan for t in trials)),
        trials=trials,
        scores=scores,
    )


def table_of(table: RecallTable, sweep: FinishedSweep) -> Table:
    made = table.make([sweep], ("a note",))
    assert made is not None
    return made


@pytest.mark.parametrize("number", BY_NUMBER)
def test_the_reports_numbers_come_back_beside_themselves(number: str) -> None:
    table = table_of(BY_NUMBER[number], recall_sweep(number))
    printed = published_table(number)
    assert len(table.rows) == len(printed)
    for overlap in OVERLAPS:
        ours = [float(cell.text) for cell in table.column(f"iou_{overlap}")]
        theirs = [float(cell.text) for cell in table.column(f"iou_{overlap}_published")]
        assert ours == theirs
    fronts = [column.key for column in table.columns if not column.is_number]
    for row, expected in zip(table.rows, printed.to_dict("records"), strict=True):
        assert [cell.text for cell in row[: len(fronts)]] == [expected[key] for key in fronts]


@pytest.mark.parametrize("number", ["R2", "R3", "R4"])
def test_bold_is_the_best_of_a_column_and_the_reports_slips_are_ties(number: str) -> None:
    table = table_of(BY_NUMBER[number], recall_sweep(number))
    for overlap in OVERLAPS:
        ours = table.column(f"iou_{overlap}")
        theirs = table.column(f"iou_{overlap}_published")
        best = max(float(cell.text) for cell in ours)
        differ = len({cell.text for cell in ours}) > 1
        assert [cell.bold for cell in ours] == [
            differ and float(cell.text) == best for cell in ours
        ]
        if sum(cell.bold for cell in ours) == 1:
            assert [cell.bold for cell in ours] == [cell.bold for cell in theirs]


def test_another_value_has_no_printed_cell_and_seeds_are_averaged() -> None:
    report = recall_sweep("R2")
    row = {f"iou_{overlap}": "0.5" for overlap in OVERLAPS}
    other = finished_sweep(
        ("detector=pointrcnn",), [Made(overrides=(f"{BATCH}=8",), scores={END: recalls(row)})]
    )
    table = table_of(BY_NUMBER["R2"], with_more(report, other))
    assert [own[0].text for own in table.rows] == ["8", "16", "32", "64"]
    assert {cell.text for cell in table.rows[0][6:]} == {""}
    nothing = {f"iou_{overlap}": "0" for overlap in OVERLAPS}
    again = Made(overrides=(f"{BATCH}=32", "seed=1"), scores={END: recalls(nothing)})
    both = with_more(report, finished_sweep(("detector=pointrcnn",), [again]))
    assert table_of(BY_NUMBER["R2"], both).column("iou_0.5")[1].text == "0.415"


def test_a_table_whose_key_the_config_lacks_names_the_key() -> None:
    sweep = finished_sweep(
        ("detector=voxelnet",), [Made(overrides=("loss.gamma=0",), scores={1: aps()})]
    )
    with pytest.raises(
        ConfigError, match=r"needs detector\.rcnn\.bin, which 'loss\.gamma=0' lacks"
    ):
        BY_NUMBER["R5"].make([sweep], ())


def test_trials_that_would_share_a_row_are_refused_by_what_they_differ_in() -> None:
    made = [
        Made(overrides=(f"{BATCH}=16", f"loss.alpha={alpha}"), scores={END: aps()})
        for alpha in (0.7, 0.8)
    ]
    sweep = finished_sweep(("detector=pointrcnn",), made)
    with pytest.raises(
        ConfigError, match=r"share a row of Table 2 of the report: they differ in loss\.alpha\."
    ):
        BY_NUMBER["R2"].refuse_twins(trial.plan for trial in sweep.trials)


def test_it_renders() -> None:
    table = table_of(BY_NUMBER["R5"], recall_sweep("R5"))
    assert to_markdown(table).startswith("**Table 5 of the report.**")
    assert "Box Refinement" in to_latex(table)


# What the trials of Table 6 are swept to, as the sweep files write it.
OVERRIDES = {
    "Batch Size = 64": "schedule.batch_size=8",
    "Batch Size = 8": "schedule.batch_size=1",
    "s and u_half = 1,2,4,8": "detector.slabs={stride:[1.0,2.0,4.0,8.0],half:[1.0,2.0,4.0,8.0]}",
    "s and u_half = 0.5,1,2,4": "detector.slabs={stride:[0.5,1.0,2.0,4.0],half:[0.5,1.0,2.0,4.0]}",
    "Alpha = 0.2": "loss.alpha=0.2",
    "Head_REG Weight = 30": "detector.weights={yaw:30.0}",
    "Heading_class loss multiplier = 1.5": "detector.weights={yaw_bin:1.5}",
    "Default Parameters": "loss.alpha=0.25",
}


def frustum_aps(row: Row) -> dict[str, float]:
    return aps() | {f"ap_3d/{KITTI_LEVEL[level]}": float(row[f"3d_{level}"]) for level in LEVELS}


def frustum_sweeps(
    final: str = "loss.alpha=0.3", seeds: tuple[int, ...] = (0,)
) -> list[FinishedSweep]:
    """Sweeps that scored what Table 6 printed.

    One for each key, of first stages alone; and one of the two trials that have both.
    """
    rows = {(row["stage"], row["setting"]): row for row in published_table("R6").to_dict("records")}
    first = {setting: row for (stage, setting), row in rows.items() if stage == FIRST}
    by_key: dict[str, list[Made]] = {}
    for seed in seeds:
        for setting, row in first.items():
            written = OVERRIDES.get(setting, final)
            made = Made(overrides=(written, f"seed={seed}"), scores={FORK: frustum_aps(row)})
            if setting != "Default Parameters":
                by_key.setdefault(written.partition("=")[0], []).append(made)
        both = by_key.setdefault("final", [])
        for setting, alone in (
            ("Default Parameters", "Default Parameters"),
            ("Our Final Parameters", "Alpha = 0.3"),
        ):
            scores = {FORK: frustum_aps(first[alone]), END: frustum_aps(rows[SECOND, setting])}
            written = OVERRIDES.get(setting, final)
            stage = f"F-ConvNet {written} seed={seed}"
            overrides = (written, f"seed={seed}")
            both.append(
                Made(overrides=overrides, scores=scores, first_own_step=FORK, first_stage=stage)
            )
    words = {key: ["schedule.stages.refine=null"] if key != "final" else [] for key in by_key}
    return [
        finished_sweep(["+sweep=frustum_final", *words[key]], made) for key, made in by_key.items()
    ]


def frustum_table(sweeps: list[FinishedSweep]) -> Table:
    table = FRUSTUM.make(sweeps, ())
    assert table is not None
    return table


def test_table_6_comes_back_from_its_own_cells() -> None:
    table = frustum_table(frustum_sweeps())
    printed = published_table("R6")
    assert [cell.text for cell in table.column("setting")] == list(printed["setting"])
    for level in LEVELS:
        ours = table.column(f"3d_{level}")
        theirs = table.column(f"3d_{level}_published")
        assert [cell.text for cell in ours] == [cell.text for cell in theirs]
        wrong = [a.bold != b.bold for a, b in zip(ours, theirs, strict=True)]
        assert sum(wrong) == (
            1 if level == "easy" else 0
        )  # the report forgot one bold: its final row, easy


def test_seeds_of_table_6_are_averaged() -> None:
    two, one = frustum_table(frustum_sweeps(seeds=(0, 1))), frustum_table(frustum_sweeps())
    assert two.rows == one.rows
    assert (two.notes, one.notes) == (
        ("Mean of 2 seeds of training.",),
        ("One seed of training.",),
    )


@pytest.mark.parametrize("written", ["loss.alpha=0.30", "loss.alpha=3e-1"])
def test_a_value_written_otherwise_keeps_its_row(written: str) -> None:
    assert frustum_table(frustum_sweeps(written)) == frustum_table(frustum_sweeps())


def test_a_first_stage_that_sweeps_share_counts_once() -> None:
    """Row Alpha = 0.3: the same stage lies under a trial of its own and under the final one."""
    sweeps = frustum_sweeps()
    table = frustum_table([*sweeps, *sweeps])
    assert table == frustum_table(sweeps)


def test_settings_that_were_not_run_are_left_out() -> None:
    final = [sweep for sweep in frustum_sweeps() if sweep.trials[0].plan.first_own_step]
    settings = [cell.text for cell in frustum_table(final).column("setting")]
    assert settings == [
        "Default Parameters",
        "Alpha = 0.3",
        "Default Parameters",
        "Our Final Parameters",
    ]
    assert FRUSTUM.make([recall_sweep("R5")], ()) is None


def test_every_trial_of_the_frustum_sweeps_has_a_row_of_its_own() -> None:
    for sweep in frustum_sweeps():
        FRUSTUM.refuse_twins(trial.plan for trial in sweep.trials)
        rows = {FRUSTUM.row_of(trial.plan) for trial in sweep.trials}
        assert len(rows) == len(sweep.trials)
        assert None not in rows


def both_detectors(final: str = "loss.alpha=0.3") -> list[FinishedSweep]:
    """PointRCNN's settings at 50 and 60, Frustum ConvNet's at 90 and, the final one, 55."""
    trials = {
        "pointrcnn": [("detector.rcnn.bin=0.5", 50.0), ("detector.rcnn.bin=0.3", 60.0)],
        "fconvnet": [("loss.alpha=0.25", 90.0), (final, 55.0)],
    }
    return [
        finished_sweep(
            [f"detector={detector}"],
            [
                Made(overrides=(written,), scores={END: aps(ap)}, first_own_step=FORK)
                for written, ap in own
            ],
        )
        for detector, own in trials.items()
    ]


@pytest.mark.parametrize("final", ["loss.alpha=0.3", "loss.alpha=0.30"])
def test_table_7_chooses_the_final_models_and_bolds_the_better(final: str) -> None:
    table = DETECTORS.make(both_detectors(final), ())
    assert table is not None
    assert [[cell.text for cell in row[:3]] for row in table.rows] == [
        ["PointRCNN", "ours", "60.0"],
        ["", "report", "89.6"],
        ["Frustum ConvNet", "ours", "55.0"],
        ["", "report", "98.7"],
    ]
    assert [row[2].bold for row in table.rows] == [True, False, False, True]


def test_table_7_comes_back_from_its_own_cells() -> None:
    metrics = {"bbox": "image", "bev": "bev", "3d": "3d"}
    sweeps = []
    yaml = {
        "PointRCNN": ("pointrcnn", "detector.rcnn.bin=0.3"),
        "Frustum ConvNet": ("fconvnet", "loss.alpha=0.3"),
    }
    for row in published_table("R7").to_dict("records"):
        detector, written = yaml[row["method"]]
        scores = aps() | {
            f"ap_{metric}/{KITTI_LEVEL[level]}": float(row[f"{level}_{name}"])
            for level in LEVELS
            for name, metric in metrics.items()
        }
        made = Made(overrides=(written,), scores={END: scores}, first_own_step=FORK)
        sweeps.append(finished_sweep([f"detector={detector}"], [made]))
    table = DETECTORS.make(sweeps, ())
    assert table is not None
    for ours, theirs in zip(table.rows[::2], table.rows[1::2], strict=True):
        assert ours[2:] == theirs[2:]


def test_table_7_of_one_detector_has_no_better_one() -> None:
    table = DETECTORS.make(both_detectors()[:1], ())
    assert table is not None
    assert len(table.rows) == 2
    assert not any(cell.bold for cell in table.rows[0])


LEVELS_USED = ("[1]", "[2]", "[3]", "[1,2]", "[2,3]", "[3,1,2]", "null")


def resolutions_sweep() -> FinishedSweep:
    """What Figure 5 printed, of first stages that saw some resolutions."""
    rows = published_table("R_figure_5").to_dict("records")
    made = [
        Made(overrides=(f"detector.slabs_used={used}",), scores={END: frustum_aps(row)})
        for used, row in zip(LEVELS_USED, rows, strict=True)
    ]
    return finished_sweep(("+sweep=frustum_resolutions",), made)


def test_figure_5_comes_back_from_its_own_cells() -> None:
    sweep = resolutions_sweep()
    table = RESOLUTIONS.make([sweep], ())
    assert table is not None
    assert [cell.text for cell in table.column("strides")] == list(
        published_table("R_figure_5")["strides"]
    )
    for level in LEVELS:
        assert table.column(f"3d_{level}") == table.column(f"3d_{level}_published")
    RESOLUTIONS.refuse_twins(trial.plan for trial in sweep.trials)


def test_joint_tables_say_so() -> None:
    assert {name for name, table in TABLES.items() if table.is_joint} == {
        FRUSTUM.name,
        DETECTORS.name,
    }
