"""From a cell of a table to the files that it comes from, as a user asks for it."""

from pathlib import Path

import pytest

from fl3d.api.cells import is_one_value, is_short
from fl3d.commands.why import run
from fl3d.config.seeds import spell_out_seeds
from fl3d.core.errors import ConfigError, StoreError
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import open_sweep
from fl3d.store.opening import open_store
from tests.analysis.making import detected_sweep
from tests.papers.making import store_scores
from tests.support import SMALL, run_small, small_sweep

POINTS = [["detector=voxelnet", f"loss.gamma={gamma}"] for gamma in (0, 2)]
WORDS = ("+sweep=gamma", "store.keep_every=null")


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("why")


@pytest.fixture(scope="module")
def finished(simulated: Path, root: Path) -> FinishedSweep:
    prepared = small_sweep(simulated, root, POINTS, *WORDS)
    run_small(prepared, store=open_store(prepared.settings.store.root))
    return open_sweep(prepared.settings)


@pytest.fixture
def words(finished: FinishedSweep, simulated: Path, root: Path) -> list[str]:
    places = [
        f"data.root={simulated}",
        f"store.root={root / 'runs'}",
        f"results={root / 'results'}",
    ]
    return [*SMALL, *places, *WORDS]


@pytest.mark.parametrize(
    "asked",
    [
        ["III", "gamma=2"],
        ["last", "gamma=2.0"],
        ["last", "loss.gamma=2"],
        ["best", "gamma=2", "detector=voxelnet"],
    ],
)
def test_why_follows_a_cell_to_its_files(
    asked: list[str], finished: FinishedSweep, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    run([*asked, "3d/moderate", *words])
    said = capsys.readouterr().out
    trial = finished.trials[1]
    row = (
        finished.select("best" if asked[0] == "best" else "last").set_index("trial").loc[trial.key]
    )
    assert said.startswith(
        f"{asked[0]}, VoxelNet, gamma=2, 3d/moderate: {row['ap_3d/moderate']:.2f}\n"
    )
    for key in trial.plan.stages:
        assert key in said
    assert finished.runs()[trial.key] in said
    assert "DOES NOT MATCH" not in said
    assert said.count(", matches") == 2  # weights and detections
    assert "scored now" in said
    assert "NOT THE SAME" not in said


def test_a_file_that_was_changed_is_told(
    finished: FinishedSweep, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    trial = finished.trials[0]
    weights = trial.folder.weights(trial.last_step)
    whole = weights.read_bytes()
    weights.write_bytes(whole + b"x")
    try:
        run(["III", "gamma=0", "3d/moderate", *words])
    finally:
        weights.write_bytes(whole)
    said = capsys.readouterr().out
    assert (said.count("DOES NOT MATCH"), said.count(", matches")) == (1, 1)
    assert "NOT THE SAME" not in said


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (
            ["VI", "gamma=2", "3d/moderate"],
            "gamma feeds no table 'VI'.*II, III, IV, IV_last_stage, best",
        ),
        (["III", "gamma=7", "3d/moderate"], "gamma=7: no such row. Possible: 0, 2"),
        (
            ["III", "gama=2", "3d/moderate"],
            "gama: not what this sweep's trials differ in. Did you mean 'gamma'",
        ),
        (["III", "gamma=2", "3d/modrate"], "Did you mean '3d/moderate'"),
        (
            ["III", "3d/moderate"],
            "several rows fit; name one: VoxelNet, gamma=0; VoxelNet, gamma=2",
        ),
        (["III", "gamma=2"], "give one metric, such as 3d/moderate, not none"),
    ],
)
def test_why_says_what_was_possible(asked: list[str], message: str, words: list[str]) -> None:
    with pytest.raises(ConfigError, match=message):
        run([*asked, *words])


def test_a_table_that_no_sweep_feeds_is_told_before_a_sweep_that_is_not_here(
    tmp_path: Path, simulated: Path
) -> None:
    """It would not be there either once the sweep was run; of one that could be, the sweep is what lacks."""
    places = [f"data.root={simulated}", f"store.root={tmp_path}", f"results={tmp_path}"]
    asked = ["gamma=2", "3d/moderate", *SMALL, *places]
    possible = r"Possible: II, III, IV, IV_last_stage, R1, .*, V, best, last\."
    with pytest.raises(ConfigError, match=rf"^no sweep feeds a table 'IX'\. .*{possible}$"):
        run(["IX", *asked])
    with pytest.raises(StoreError, match="run the sweep first"):
        run(["V", *asked])


def test_words_that_pick_a_row_are_told_from_those_that_pick_a_sweep() -> None:
    words = [
        "gamma=2",
        "seed=1",
        "detector=voxelnet",
        "+sweep=gamma",
        "loss.alpha=1",
        "data=kitti",
        "~loss",
    ]
    assert [word for word in words if is_short(word)] == ["gamma=2", "seed=1", "detector=voxelnet"]


def test_several_values_pick_trials_of_the_sweep_and_no_row() -> None:
    words = ["seed=0,1,2", "seed=range(0,3)", "seed=1", "loss.gamma=2", "detector=a,b", "~loss"]
    assert [word for word in words if is_one_value(word)] == ["seed=1", "loss.gamma=2", "~loss"]


def test_why_of_a_number_of_seeds_is_of_their_mean(
    simulated: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    points = [["detector=voxelnet", f"seed={seed}"] for seed in (0, 1, 2)]
    sweep = detected_sweep(
        simulated, tmp_path, points, lambda trial: 2.0 * (trial.seed % 2), "sweep.name=mine"
    )
    store_scores(sweep)
    settings = sweep.settings
    own = [f"data.root={simulated}", f"store.root={settings.store.root}", "sweep.name=mine"]
    run(["last", "3d_r40/moderate", *SMALL, *own, *spell_out_seeds(["seeds=2"])])
    values = sweep.select("last").set_index("seed")["ap_3d_r40/moderate"]
    assert values[0] != values[1]
    mean = (values[0] + values[1]) / 2
    assert f"3d_r40/moderate: {mean:.2f}, mean of 2 seeds\n" in capsys.readouterr().out
