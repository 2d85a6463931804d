"""What a results folder shows of a sweep, and that it can make it again from its scores."""

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from fl3d.analysis.found import Judged, judge_sweep
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.files import OLD_SECONDS
from fl3d.papers.base import PaperTable
from fl3d.papers.course_report.frustum_tables import DETECTORS, FRUSTUM
from fl3d.papers.drawings import draw_verdicts
from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.papers.results import write_sweep
from fl3d.papers.stored import feeding, place_words
from fl3d.papers.tables import make_tables
from fl3d.papers.views import interval_views, judge_or_say, remove_views, write_views
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep, levels_of
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import is_stored, open_sweep
from fl3d.runs.scores import score_file, write_score_file
from tests.analysis.making import detected_sweep, without
from tests.papers.making import Made, aps, finished_sweep, printed_aps, store_scores

YAML = {"3D-FCN": "fcn3d", "VoxelNet": "voxelnet"}
FORK = 50


def said_by(run: Sequence[str]) -> str:
    return "\n".join(run)


def alone(table: PaperTable) -> Sequence[FinishedSweep]:
    """A sweep that feeds no joint table."""
    raise AssertionError(table.name)


def gamma_sweep(root: Path) -> FinishedSweep:
    """The paper's last models, each with a checkpoint before, of a third of its APs."""
    made = []
    for number in ("II", "III"):
        for row in published_table(number).to_dict("records"):
            last = printed_aps(row)
            scores = {60: {name: ap / 3 for name, ap in last.items()}, 70: last}
            overrides = (f"detector={YAML[row['detector']]}", f"loss.gamma={row['gamma']}")
            made.append(Made(overrides=overrides, scores=scores, first_own_step=FORK))
    return finished_sweep(("+sweep=gamma",), made, root)


def loss_sweep(root: Path) -> FinishedSweep:
    """No paper's: a text factor, two detectors."""
    made = [
        Made(overrides=(f"detector={detector}", f"loss={loss}"), scores={1: aps(10.0 + place)})
        for detector in ("fcn3d", "voxelnet")
        for place, loss in enumerate(("original", "enhanced"))
    ]
    return finished_sweep(("sweep.name=mine",), made, root)


def with_results(sweep: FinishedSweep, folder: Path) -> FinishedSweep:
    return replace(sweep, settings=replace(sweep.settings, results=folder))


def test_a_real_store_gives_the_papers_tables(tmp_path: Path) -> None:
    made = gamma_sweep(tmp_path)
    store_scores(made)
    found = open_sweep(made.settings)
    assert found.is_from_store
    assert found.plan == made.plan
    pd.testing.assert_frame_equal(found.scores, made.scores, check_dtype=False)
    assert make_tables(found, alone) == make_tables(made, alone)
    assert set(found.runs()) == {trial.key for trial in made.trials}
    some = open_sweep(made.settings, {"loss.gamma": [0, 2.0], "seed": [0]})
    assert some.levels == ["0", "2"]
    with pytest.raises(StoreError, match=r"loss\.gamma=7: .* has no finished trial with it"):
        open_sweep(made.settings, {"loss.gamma": [7]})


def test_trials_that_are_not_done_are_left_out(tmp_path: Path) -> None:
    made = gamma_sweep(tmp_path)
    store_scores(made)
    StoreFolder(made.settings.store.root).run(made.trials[0].key).done.unlink()
    found = open_sweep(made.settings)
    assert [trial.key for trial in found.trials] == [trial.key for trial in made.trials[1:]]
    assert found.plan == made.plan


def test_a_results_folder_makes_its_tables_again_from_its_scores(tmp_path: Path) -> None:
    sweep = with_results(gamma_sweep(tmp_path), tmp_path / "a")
    _, first = write_sweep(sweep, alone, lambda line: None)
    assert is_stored(sweep.settings)
    again = open_sweep(sweep.settings)
    assert again.source == score_file(sweep.settings.results_folder, "gamma")
    assert not again.is_from_store
    _, second = write_sweep(with_results(again, tmp_path / "b"), alone, lambda line: None)
    assert len(first) == len(second) > 10
    for one, other in zip(first, second, strict=True):
        assert one.name == other.name
        assert one.read_bytes() == other.read_bytes(), one.name


def test_levels_that_are_texts_survive_their_file(tmp_path: Path) -> None:
    made = [
        Made(overrides=(f"augment={value}",), scores={1: aps(5.0)})
        for value in ("null", "true", "1e-3")
    ]
    sweep = finished_sweep(("sweep.name=mine", "detector=voxelnet"), made, tmp_path)
    write_score_file(score_file(sweep.settings.results_folder, "mine"), sweep.scores, sweep.plan)
    again = open_sweep(sweep.settings)
    assert again.levels == sweep.levels == ["null", "true", "0.001"]
    assert again.plan == sweep.plan


def test_published_results_stand_in_for_a_users_own(tmp_path: Path) -> None:
    sweep = gamma_sweep(tmp_path)
    published = tmp_path / "published"
    folder = published / sweep.settings.folder_name
    write_score_file(score_file(folder, "gamma"), sweep.scores, sweep.plan)
    assert open_sweep(sweep.settings, None, published).source == score_file(folder, "gamma")
    assert not is_stored(sweep.settings)
    assert is_stored(sweep.settings, published)


def test_missing_scores_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="run the sweep first"):
        open_sweep(gamma_sweep(tmp_path).settings)


def test_figures_carry_their_data(tmp_path: Path) -> None:
    sweep = gamma_sweep(tmp_path)
    write_sweep(sweep, alone, lambda line: None)
    data = pd.read_csv(sweep.settings.results_folder / "figures" / "ap_over_level_gamma.csv")
    assert len(data) == 14
    assert data["ap_3d/moderate"].max() == pytest.approx(58.28)


def test_a_folder_shows_one_set_of_scores(tmp_path: Path) -> None:
    sweep = gamma_sweep(tmp_path)
    write_sweep(sweep, alone, lambda line: None)
    tables = sweep.settings.results_folder / "tables"
    (tables / "table_III_intervals.md").touch()  # of the scores before
    (tables / "table_II_intervals.md").touch()
    some = without(sweep, lambda trial: trial.detector == "3D-FCN")
    made, _ = write_sweep(some, alone, lambda line: None)
    assert [table.name for table in made] == ["III", "IV", "IV_last_stage"]
    assert not (tables / "table_III_intervals.md").exists()


def test_what_a_kill_left_undrawn_is_drawn_by_the_next_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bars of the scores before would stay for ever if the scores of now were there already."""
    sweep = gamma_sweep(tmp_path)
    write_sweep(sweep, alone, lambda line: None)
    folder = sweep.settings.results_folder
    some = without(sweep, lambda trial: trial.detector == "3D-FCN")
    with monkeypatch.context() as patch:
        patch.setattr("fl3d.papers.results.ap_over_level", killed)
        with pytest.raises(KeyboardInterrupt):
            write_sweep(some, alone, lambda line: None)
    _, written = write_sweep(some, alone, lambda line: None)
    assert all(path.exists() for path in written)
    assert len(pd.read_csv(folder / "figures" / "ap_over_level_gamma.csv")) == 7


def killed(*_: object) -> None:
    raise KeyboardInterrupt


def test_a_figure_of_which_a_kill_left_one_form_is_drawn_again(tmp_path: Path) -> None:
    sweep = gamma_sweep(tmp_path)
    _, written = write_sweep(sweep, alone, lambda line: None)
    (pdf,) = (path for path in written if path.name == "ap_over_level_gamma.pdf")
    before = pdf.read_bytes()
    pdf.unlink()
    write_sweep(sweep, alone, lambda line: None)
    assert pdf.read_bytes() == before


def test_temporary_files_of_killed_processes_go_from_a_results_folder(tmp_path: Path) -> None:
    sweep = gamma_sweep(tmp_path)
    folder = sweep.settings.results_folder / "figures"
    folder.mkdir(parents=True)
    old, new = folder / ".a.pdf.1.tmp", folder / ".b.pdf.2.tmp"
    for path, age in ((old, OLD_SECONDS + 60), (new, OLD_SECONDS - 60)):
        path.touch()
        os.utime(path, (time.time() - age,) * 2)
    write_sweep(sweep, alone, lambda line: None)
    assert not old.exists()
    assert new.exists()


def test_a_sweep_of_no_paper_has_a_table_for_each_group(tmp_path: Path) -> None:
    sweep = loss_sweep(tmp_path)
    said: list[str] = []
    tables, written = write_sweep(sweep, alone, said.append)
    assert [table.name for table in tables] == ["mine-3d-fcn", "mine-voxelnet"]
    for table in tables:
        assert [[cell.text for cell in row[:3]] for row in table.rows] == [
            ["original", "1", "10.00"],
            ["enhanced", "1", "11.00"],
        ]
        assert [row[2].bold for row in table.rows] == [False, True]
        assert "R40" in table.legend
        assert "R40" in table.notes[0]
    assert "Last models of VoxelNet" in said_by(said)
    assert all(path.exists() for path in written)
    assert {path.parent.name for path in written} == {"scores", "tables", "figures"}


def test_scores_alone_have_no_intervals_and_are_still_shown_beside_the_paper(
    tmp_path: Path,
) -> None:
    sweep = gamma_sweep(tmp_path)
    tables, _ = write_sweep(sweep, alone, lambda line: None)
    said: list[str] = []
    views = write_views(sweep, tables, judge_or_say(sweep, said.append), said.append)
    assert [view.name for view in views] == ["II_published", "III_published", "IV_published"]
    assert "No verdicts, which need stored detections" in said_by(said)


POINTS = [
    [f"detector={detector}", f"loss={loss}"]
    for detector in ("fcn3d", "voxelnet")
    for loss in ("original", "enhanced")
]


@pytest.fixture(scope="module")
def detected(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    """A text factor: the original loss finds every car, the enhanced one none."""
    root = tmp_path_factory.mktemp("detected")
    noise = {"original": 0.0, "enhanced": 9.0}
    return detected_sweep(
        simulated, root, POINTS, lambda trial: noise[trial.level], "sweep.name=mine"
    )


@pytest.fixture(scope="module")
def judged(detected: FinishedSweep) -> Judged:
    return judge_sweep(detected, n_resamples=100)


def test_any_table_has_intervals_and_verdicts_where_detections_are_stored(
    detected: FinishedSweep, judged: Judged
) -> None:
    tables = make_tables(detected, alone)
    views = interval_views(detected, tables, judged)
    assert [(view.base, view.view) for view in views] == [
        (table.name, "intervals") for table in tables
    ]
    for view, table in zip(views, tables, strict=True):
        assert [cell.text for cell in view.column("level")] == ["original", "enhanced"]
        for cell, own in zip(view.column("3d_moderate"), table.column("3d_moderate"), strict=True):
            assert cell.text.startswith(f"{own.text} [")
        words = [cell.text for cell in view.column("verdict")]
        assert words == ["baseline", "frames only"]
        assert "one seed says nothing about another" in said_by(view.notes)
        assert "4 frames, taken as independent" in said_by(view.notes)
        assert not any(cell.star for row in view.rows for cell in row)


def test_a_failed_replicate_is_named_below_the_table_of_its_group(
    simulated: Path, tmp_path: Path
) -> None:
    points = [[*point, f"seed={seed}"] for point in POINTS for seed in (0, 1)]
    whole = detected_sweep(simulated, tmp_path, points, lambda trial: 0.0, "sweep.name=mine")
    some = without(
        whole, lambda trial: (trial.group, trial.level, trial.seed) == ("VoxelNet", "enhanced", 1)
    )
    judged = judge_sweep(some, n_resamples=20)
    fcn, voxelnet = interval_views(some, make_tables(some, alone), judged)
    assert "VoxelNet enhanced: seed 1 left out, not done." in voxelnet.notes
    assert not any("left out" in note for note in fcn.notes)


def test_the_curve_over_levels_has_the_intervals_and_the_forest_the_verdicts(
    detected: FinishedSweep, judged: Judged
) -> None:
    written = draw_verdicts(detected, judged)
    names = {path.name for path in written}
    assert {"forest_mine.csv", "forest_mine.png", "forest_mine.pdf"} <= names
    folder = detected.settings.results_folder / "figures"
    data = pd.read_csv(folder / "ap_over_level_mine.csv")
    assert data["level"].tolist() == ["original", "enhanced"] * 2
    assert {"ap_3d/moderate low", "ap_3d/moderate high"} <= set(data)
    verdicts = pd.read_csv(folder / "forest_mine.csv", keep_default_na=False)
    assert verdicts["verdict"].tolist() == ["baseline", "none"] * 2


def test_views_are_written_with_the_verdicts_alone_and_go_with_their_scores(
    detected: FinishedSweep, judged: Judged, tmp_path: Path
) -> None:
    sweep = with_results(detected, tmp_path)
    tables, _ = write_sweep(sweep, alone, lambda line: None)
    views = write_views(sweep, tables, judged, lambda line: None)
    assert [view.name for view in views] == [
        "mine-3d-fcn_intervals",
        "mine-voxelnet_intervals",
        "mine_verdicts-3d-fcn",
        "mine_verdicts-voxelnet",
    ]
    folder = sweep.settings.results_folder
    own = [folder / "tables" / f"table_{view.name}.md" for view in views]
    assert all(path.exists() for path in [*own, folder / "figures" / "forest_mine.png"])
    other = without(sweep, lambda trial: trial.level == "enhanced")
    write_sweep(other, alone, lambda line: None)
    assert not any(path.exists() for path in [*own, folder / "figures" / "forest_mine.png"])


def test_a_group_without_the_baseline_has_its_table_and_no_intervals(
    detected: FinishedSweep,
) -> None:
    some = without(detected, lambda trial: trial.group == "3D-FCN" and trial.level == "original")
    tables = make_tables(some, alone)
    assert [len(table.rows) for table in tables] == [1, 2]
    judged = judge_sweep(some, n_resamples=20)
    assert [view.base for view in interval_views(some, tables, judged)] == ["mine-voxelnet"]
    neither = without(detected, lambda trial: trial.level == "original")
    said: list[str] = []
    assert judge_or_say(neither, said.append) is None
    assert write_views(neither, make_tables(neither, alone), None, said.append) == []
    assert "No verdicts: a gain needs a trial of the baseline 'original'" in said_by(said)


def frustum_file(root: Path, name: str, *overrides: str, two: bool = False) -> FinishedSweep:
    """A file of scores of a sweep over Frustum ConvNet, in its results folder."""
    made = [
        Made(
            overrides=(one,),
            scores={10: aps(20.0 + place), 20: aps(40.0 + place)},
            first_own_step=10 * two,
        )
        for place, one in enumerate(overrides)
    ]
    sweep = finished_sweep((f"+sweep={name}",), made, root)
    write_score_file(score_file(sweep.settings.results_folder, name), sweep.scores, sweep.plan)
    return sweep


@pytest.mark.parametrize(
    ("table", "detector", "told"),
    [
        ("focal_loss.loss_forms", "fcn3d", "loss=original"),
        ("focal_loss.last_voxelnet", "voxelnet", "loss.gamma=0"),
        ("course_report.alpha", "pointrcnn", "loss.alpha=0.8"),
    ],
)
def test_trials_that_a_table_would_take_for_seeds_are_refused_whenever_it_is_made(
    table: str, detector: str, told: str
) -> None:
    """They were trained under other tables, so nothing was refused then."""
    made = [
        Made(overrides=(told, f"optimizer.lr={rate}"), scores={1: aps(rate)}) for rate in (0.1, 0.2)
    ]
    sweep = finished_sweep((f"detector={detector}", f"sweep.tables=[{table}]"), made)
    with pytest.raises(ConfigError, match=r"they differ in optimizer\.lr"):
        make_tables(sweep, alone)


def test_a_group_that_no_paper_has_stands_beside_those_that_one_has() -> None:
    made = [
        Made(overrides=(f"detector={detector}", "loss.gamma=0"), scores={1: aps(5.0)})
        for detector in ("voxelnet", "pointrcnn")
    ]
    words = ("sweep.name=mine", "sweep.tables=[focal_loss.last_voxelnet]")
    tables = make_tables(finished_sweep(words, made), alone)
    assert [table.name for table in tables] == ["III", "mine-pointrcnn"]


def test_a_joint_table_is_fed_by_every_sweep_that_was_run(tmp_path: Path) -> None:
    final = frustum_file(tmp_path, "frustum_final", "loss.alpha=0.25", "loss.alpha=0.30", two=True)
    frustum_file(tmp_path, "frustum_batch", "schedule.batch_size=8", "schedule.batch_size=1")
    words = [
        "+sweep=frustum_final",
        f"store.root={tmp_path / 'runs'}",
        f"results={tmp_path / 'results'}",
    ]
    find = feeding(final, words, None)
    assert sorted(sweep.name for sweep in find(FRUSTUM)) == ["frustum_batch", "frustum_final"]
    assert [sweep.name for sweep in find(DETECTORS)] == ["frustum_final"]
    tables: dict[str, Table] = {table.name: table for table in make_tables(final, find)}
    assert [cell.text for cell in tables["R6"].column("setting")] == [
        "Default Parameters",
        "Batch Size = 64",
        "Batch Size = 8",
        "Alpha = 0.3",
        "Default Parameters",
        "Our Final Parameters",
    ]
    other = replace(
        final,
        settings=replace(final.settings, protocol=replace(final.protocol, score_threshold=0.5)),
    )
    assert [sweep.name for sweep in feeding(other, words, None)(FRUSTUM)] == ["frustum_final"]


def test_words_that_say_where_are_told_from_those_that_say_which() -> None:
    words = [
        "+sweep=gamma",
        "data=kitti",
        "data.root=x",
        "loss.gamma=0,1",
        "store.root=y",
        "profile=paper",
    ]
    assert place_words(words) == ["data=kitti", "data.root=x", "store.root=y", "profile=paper"]


def test_levels_are_told_by_the_short_name_of_the_factor(tmp_path: Path) -> None:
    assert levels_of(gamma_sweep(tmp_path)).head == "γ"
    assert levels_of(loss_sweep(tmp_path)).text("enhanced") == "loss = enhanced"


def test_views_of_a_sweep_whose_name_goes_on_behind_a_dot_stay(tmp_path: Path) -> None:
    figures = tmp_path / "figures"
    figures.mkdir()
    for name in ("forest_lr.png", "forest_lr.csv", "forest_lr.1.png"):
        (figures / name).touch()
    remove_views("lr", [], tmp_path)
    assert [path.name for path in figures.iterdir()] == ["forest_lr.1.png"]
