"""Commands over a sweep of a text factor: two detectors, two losses, two seeds; no paper's."""

import shutil
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from fl3d.api.words import open_words, read_words
from fl3d.commands import gains, rescore, tables
from fl3d.core.errors import ConfigError, StoreError
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import read_plan, write_plan
from tests.analysis.making import detected_sweep, without
from tests.papers.making import store_scores
from tests.support import SMALL

DETECTORS = ("fcn3d", "voxelnet")
LOSSES = ("original", "enhanced")
POINTS = [
    [f"detector={detector}", f"loss={loss}", f"seed={seed}"]
    for detector in DETECTORS
    for loss in LOSSES
    for seed in (0, 1)
]
SWEPT = [f"detector={','.join(DETECTORS)}", f"loss={','.join(LOSSES)}", "seed=0,1"]


@pytest.fixture(scope="module")
def stored(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> FinishedSweep:
    """All but the baseline of 3D-FCN, and one seed of VoxelNet's enhanced loss, is done."""
    noise = {"original": 0.0, "enhanced": 2.0}
    root = tmp_path_factory.mktemp("commands")
    whole = detected_sweep(
        simulated, root, POINTS, lambda trial: noise[trial.level], "sweep.name=mine"
    )
    done = without(
        whole,
        lambda trial: (
            (trial.group, trial.level) == ("3D-FCN", "original")
            or (trial.group, trial.level, trial.seed) == ("VoxelNet", "enhanced", 1)
        ),
    )
    for trial in whole.trials:
        if trial not in done.trials:
            trial.folder.done.unlink()
    store_scores(done)
    return done


@pytest.fixture
def words(stored: FinishedSweep, simulated: Path) -> list[str]:
    settings = stored.settings
    places = [
        f"data.root={simulated}",
        f"store.root={settings.store.root}",
        f"results={settings.results}",
    ]
    return [*SMALL, *places, "sweep.name=mine", *SWEPT]


def test_gains_are_told_by_level_and_what_has_none_is_named(
    stored: FinishedSweep, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    gains.run(words)
    said = capsys.readouterr().out
    assert "Verdicts on VoxelNet, 3d_r40/moderate, last models." in said
    assert "| loss | seeds | AP | gain over loss = original | verdict |" in said
    rows = [line for line in said.splitlines() if line.startswith(("| original |", "| enhanced |"))]
    assert [row.split(" | ")[1] for row in rows] == ["2", "1"]
    assert rows[0].endswith("| baseline |")
    assert rows[1].endswith("| frames only, not training |")
    assert "VoxelNet enhanced: seed 1 left out, not done." in said
    assert "3D-FCN: no gains, for no trial of the baseline original is done." in said
    assert "Intervals over frames and 1 / 2 seeds of training." in said
    assert "4 frames, taken as independent" in said
    folder = stored.settings.results_folder / "tables"
    verdicts = pd.read_csv(folder / "verdicts_mine_paper.csv", keep_default_na=False)
    assert verdicts["verdict"].tolist() == ["baseline", "none"]
    for ending in ("csv", "png", "pdf"):
        assert (folder.parent / "figures" / f"forest_mine.{ending}").exists()
    table = pd.read_csv(folder / "gains_mine_paper.csv")
    assert set(zip(table["group"], table["level"], strict=True)) == {
        ("VoxelNet", loss) for loss in LOSSES
    }
    recalls = pd.read_csv(folder / "recalls_mine_paper.csv")
    assert len(recalls) == len(stored.trials)


def test_gains_of_some_trials_alone_are_asked_for_by_their_values(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    some = [word for word in words if word not in SWEPT]
    gains.run([*some, "detector=voxelnet", "seed=0"])
    said = capsys.readouterr().out
    assert "| enhanced | 1 |" in said
    assert "| original | 1 |" in said
    assert "3D-FCN" not in said
    assert "Intervals over frames only, not training: one seed says nothing about another." in said
    with pytest.raises(
        StoreError, match=r"seed=7: .* has no finished trial with it\. Possible: 0, 1"
    ):
        gains.run([*some, "seed=7"])


@pytest.mark.parametrize(
    ("word", "part"),
    [
        ("loss=enhanced", ""),  # with its baseline that is all there is
        ("seed=0", "mine_seed=0"),
        ("detector=voxelnet", "mine_detector=voxelnet"),
        ("sweep.primary=bev_r40/easy", "mine_primary=bev_r40-easy"),
        ("sweep.margin=2", "mine_margin=2"),
        ("sweep.margin=1", ""),  # as it is anyhow
        ("sweep.primary=3d_r40/moderate", ""),
    ],
)
def test_gains_of_a_part_leave_the_files_of_the_whole_as_they_are(
    stored: FinishedSweep, words: list[str], word: str, part: str
) -> None:
    gains.run(words)
    folder = stored.settings.results_folder
    files = [path for path in folder.rglob("*_mine*.*") if "asked" not in path.parts]
    assert len(files) > 5
    before = {path: path.read_bytes() for path in files if path.suffix == ".csv"}
    shutil.rmtree(folder / "asked", ignore_errors=True)
    gains.run([*(one for one in words if one not in SWEPT), word])
    assert {path: path.read_bytes() for path in before} == before
    parts = [path.name for path in (folder / "asked").glob("*")]
    assert parts == ([part] if part else [])
    if part:
        assert (folder / "asked" / part / "tables" / "verdicts_mine_paper.csv").exists()


def test_a_sweep_that_was_run_with_another_metric_is_whole_with_it_and_a_part_without(
    stored: FinishedSweep, words: list[str]
) -> None:
    plan = StoreFolder(stored.settings.store.root).plan(stored.settings.experiment)
    kept = plan.read_bytes()
    word = "sweep.primary=bev_r40/easy"
    write_plan(plan, replace(read_plan(plan), words=(*words, word)))
    try:
        assert open_words(read_words([*words, word])).settings.part == ""
        assert open_words(read_words(words)).settings.part == "mine_primary=3d_r40-moderate"
    finally:
        plan.write_bytes(kept)


def test_gains_of_another_metric_are_told_beside_the_verdicts(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    gains.run([*words, "--metric", "bev/easy", "--average", "R11"])
    said = capsys.readouterr().out
    assert "Verdicts on VoxelNet, 3d_r40/moderate, last models." in said
    assert "VoxelNet, bev easy, R11, last models, 95 % intervals" in said
    assert "| loss | seeds | AP | gain over loss = original |  |" in said


def test_rescored_aps_are_told_by_level(
    stored: FinishedSweep, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    rescore.run([*words, "score_threshold=0,1", "protocol.nms_kind=standup,3d"])
    said = capsys.readouterr().out
    assert "| loss | 0, standup | 0, 3d | 1, standup | 1, 3d |" in said
    assert said.count("| enhanced |") == 2
    assert said.count("| original |") == 1
    path = (
        stored.settings.results_folder
        / "tables"
        / "rescored_mine_paper_score_threshold_nms_kind.csv"
    )
    assert len(pd.read_csv(path)) == len(stored.trials) * 4


def test_tables_of_no_paper_come_with_intervals(
    stored: FinishedSweep, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    tables.run(words)
    said = capsys.readouterr().out
    assert (
        said.count(
            "Last models of VoxelNet. AP in percent (R40); bold: better than loss = original."
        )
        == 1
    )
    assert said.count("Last models of VoxelNet. AP in percent [95 % interval]") == 1
    assert "Last models of 3D-FCN. AP in percent [95 % interval]" not in said
    names = {path.name for path in (stored.settings.results_folder / "tables").glob("table_*.md")}
    assert names == {
        "table_mine-3d-fcn.md",
        "table_mine-voxelnet.md",
        "table_mine-voxelnet_intervals.md",
        "table_mine_verdicts-voxelnet.md",
    }


@pytest.mark.parametrize("command", [gains, rescore])
def test_a_misspelt_metric_is_answered_with_the_nearest(command: object, words: list[str]) -> None:
    with pytest.raises(ConfigError, match="Did you mean '3d/moderate'"):
        command.run([*words, "--metric", "3d/modrate"])  # type: ignore[attr-defined]


def test_nothing_to_rescore_says_what_could_be(words: list[str]) -> None:
    with pytest.raises(ConfigError, match=r"nothing to compare; .*score_threshold"):
        rescore.run(words)
