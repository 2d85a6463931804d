"""Sweeps and trials that were typed by hand, without a name: they name themselves, and words find them."""

import csv
import os
from dataclasses import replace
from pathlib import Path

import pytest

from fl3d.api.words import open_words, or_gamma, read_words, sweeps_of
from fl3d.commands import tables, why
from fl3d.config.compose import compose_config, multirun
from fl3d.config.detector_names import spell_out_detectors
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.runs.by_hand import find_by_hand
from fl3d.runs.by_hand_names import sweep_name
from fl3d.runs.plans import read_plan, write_plan
from fl3d.store.opening import open_store
from fl3d.sweep.by_hand import name_trial, named
from fl3d.sweep.launchers.inline import InlineLauncher
from fl3d.sweep.run import run_sweep
from fl3d.sweep.setup import prepare_sweep
from fl3d.sweep.sweepers.base import Sweeper
from fl3d.sweep.sweepers.grid import Listed, grid, point_of
from tests.support import SMALL

SHORT = ["schedule=from_scratch", "schedule.stages.scratch.epochs=1"]
GAMMAS = ["detector=voxelnet", "loss.gamma=0,2", *SHORT]
NETWORKS = ["detector=fcn3d,voxelnet", "loss.alpha=0.3", *SHORT]
TRIAL = ["detector=voxelnet", "loss.gamma=5"]


@pytest.fixture(scope="module")
def root(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("by_hand")


@pytest.fixture(scope="module")
def places(simulated: Path, root: Path) -> list[str]:
    folders = [
        f"data.root={simulated}",
        f"store.root={root / 'runs'}",
        f"results={root / 'results'}",
    ]
    return [*SMALL[:4], *folders]


def start(words: list[str], sweeper: Sweeper) -> None:
    run_sweep(prepare_sweep(sweeper, words), InlineLauncher(), say=lambda line: None)


@pytest.fixture(scope="module")
def started(places: list[str]) -> list[str]:
    """Two sweeps and a trial, one after another, none with a name."""
    for words in (GAMMAS, NETWORKS):
        asked = named(multirun([*words, *places]))
        start(asked.arguments, grid({}, asked.arguments, asked.compose))
    config = compose_config([*TRIAL, *SHORT, *places])
    name_trial(config)
    start([*TRIAL, *SHORT, *places], Listed([point_of(TRIAL, config)]))
    return places


def shown(words: list[str], capsys: pytest.CaptureFixture[str]) -> str:
    tables.run(words)
    return capsys.readouterr().out


def test_words_find_the_sweep_that_they_started(
    started: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    said = shown([*NETWORKS, *started], capsys)
    assert "| detector | seeds |" in said
    assert "| 3D-FCN | 1 |" in said


@pytest.mark.parametrize(
    ("words", "levels"),
    [
        (["loss.gamma=0,2"], ["0", "2"]),
        (["loss.gamma=2"], ["0", "2"]),  # beside its baseline
        (["loss.alpha=0.3"], ["3D-FCN", "VoxelNet"]),
        (["loss.alpha=0.3", "detector=fcn3d"], ["3D-FCN"]),
        (["loss.gamma=5"], ["5"]),
    ],
)
def test_some_of_the_words_are_enough(
    words: list[str], levels: list[str], started: list[str]
) -> None:
    assert open_words(read_words([*words, *started])).levels == levels


def test_tables_of_a_sweep_by_hand_come_in_every_form_with_verdicts(
    started: list[str], root: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    said = shown([*GAMMAS, *started], capsys)
    assert "verdict" in said
    name = sweep_name([*GAMMAS, *started])
    folder = root / "results" / "simulated-tiny" / "tables"
    for ending in ("md", "tex", "csv"):
        for view in ("", "_intervals"):
            assert (folder / f"table_{name}-voxelnet{view}.{ending}").exists()
    with (folder / f"table_{name}-voxelnet.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["level"] for row in rows] == ["0", "2"]
    assert {"seeds", "bev_easy", "3d_hard"} <= set(rows[0])


def test_seeds_alone_leave_other_seeds_out_of_every_sweep(started: list[str]) -> None:
    """As ``make tables SEEDS=2`` says it."""
    where = [
        word for word in started if word.startswith(("profile", "store", "results", "data.root"))
    ]
    found = sweeps_of([*where, "seed=0,1"])
    assert len(found) == 2
    assert all({trial.seed for trial in sweep.trials} == {0} for sweep in found)
    with pytest.raises(StoreError, match="run here with any of these seeds"):
        sweeps_of([*where, "seed=7"])


@pytest.mark.slow
def test_tables_without_a_word_show_every_sweep_by_hand(
    started: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    where = [
        word for word in started if word.startswith(("profile", "store", "results", "data.root"))
    ]
    said = shown(where, capsys)
    assert "| γ | seeds |" in said
    assert "| detector | seeds |" in said


@pytest.mark.parametrize(
    ("words", "cell"),
    [
        (["gamma=2"], "VoxelNet, gamma=2"),
        (["loss.gamma=2", "detector=voxelnet"], "VoxelNet, gamma=2"),
        (["loss.alpha=0.3", "detector=fcn3d"], "all, detector=3D-FCN"),
        (["loss.alpha=0.3", "detector=voxelnet"], "all, detector=VoxelNet"),
        (["loss.gamma=5"], "VoxelNet, gamma=5"),
    ],
)
def test_why_follows_a_cell_of_a_sweep_by_hand(
    words: list[str], cell: str, started: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    why.run(["last", *words, "3d/moderate", *started])
    said = capsys.readouterr().out
    assert said.startswith(f"last, {cell}, 3d/moderate: ")
    assert "scored now" in said
    assert "the same" in said


def test_a_detector_that_was_not_typed_is_known_by_either_name(
    started: list[str], root: Path, tmp_path: Path
) -> None:
    plans = tmp_path / "runs" / "plans"
    old = read_plan(next((root / "runs" / "plans").glob("trials-gamma*.json")))
    write_plan(
        plans / "trials-gamma-1-simulated-tiny.json", replace(old, words=("loss.gamma=0,2",))
    )
    settings = read_settings(compose_config([*started, f"store.root={tmp_path / 'runs'}"]))
    for detector in ("voxelnet", "VoxelNet"):
        words = [f"detector={detector}", "gamma=2"]
        assert find_by_hand(settings, words).sweep.name == "trials-gamma-1"
    with pytest.raises(StoreError, match="detector=fcn3d"):
        find_by_hand(settings, ["detector=fcn3d", "gamma=2"])


def test_a_row_that_nobody_typed_is_told_with_what_was(
    started: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    places = [word for word in started if "=" in word]
    with pytest.raises(StoreError) as error:
        why.run(["last", "gamma=7", "3d/moderate", *places])
    assert "gamma=7" in str(error.value)
    assert "detector=voxelnet loss.gamma=0,2" in str(error.value)


def test_trials_by_hand_are_runs_of_one_experiment_and_sweeps_have_their_own(
    started: list[str], root: Path
) -> None:
    store = open_store(root / "runs")
    assert len(store.read("trials-simulated-tiny")["run"].unique()) == 1
    assert len(store.read(f"{sweep_name([*GAMMAS, *started])}-simulated-tiny")["run"].unique()) == 2
    assert len(list((root / "runs" / "plans").glob("trials*.json"))) == 3


def test_what_was_never_started_is_told_with_what_was(started: list[str]) -> None:
    with pytest.raises(StoreError) as error:
        open_words(read_words(["loss.gamma=7", *started]))
    said = str(error.value)
    assert "no sweep typed by hand on simulated-tiny has loss.gamma=7" in said
    assert "detector=voxelnet loss.gamma=0,2 schedule=from_scratch" in said


def test_of_two_that_fit_the_last_that_was_started_is_meant(started: list[str], root: Path) -> None:
    plans = {path.name: path for path in (root / "runs" / "plans").glob("trials*.json")}
    gammas = plans[f"{sweep_name([*GAMMAS, *started])}-simulated-tiny.json"]
    trial = next(path for name, path in plans.items() if name.startswith("trials."))
    for last, levels in ((trial, ["5"]), (gammas, ["0", "2"])):
        for path in plans.values():
            os.utime(path, (1, 1))
        os.utime(last, (2, 2))
        assert open_words(read_words(["detector=voxelnet", *started])).levels == levels


def test_a_plan_that_kept_no_words_is_found_by_its_values(
    started: list[str], root: Path, tmp_path: Path
) -> None:
    """As older code wrote it: the name was trials, whatever was swept."""
    plans = tmp_path / "runs" / "plans"
    old = read_plan(next((root / "runs" / "plans").glob("trials-gamma*.json")))
    write_plan(plans / "trials-simulated-tiny.json", replace(old, words=()))
    words = [*started, f"store.root={tmp_path / 'runs'}"]
    settings = read_settings(compose_config(words))
    for fitting in (["loss.gamma=2", "detector=voxelnet"], ["gamma=0"]):
        assert find_by_hand(settings, fitting).sweep.name == "trials"
    with pytest.raises(StoreError, match=r"has loss\.gamma=9"):
        find_by_hand(settings, ["loss.gamma=9"])


def test_other_sweeps_have_other_names_and_more_seeds_the_same() -> None:
    name = sweep_name(["loss.gamma=0,1", "detector=voxelnet"])
    assert name.startswith("trials-gamma-")
    assert name == sweep_name(["detector=voxelnet", "loss.gamma=0.0,1", "seed=range(0,5)"])
    assert name == sweep_name(["loss.gamma=0,1", "detector=voxelnet", "data.root=/kitti"])
    others = (
        ["loss.gamma=0,1", "detector=fcn3d"],
        ["loss.gamma=0,2", "detector=voxelnet"],
        ["loss.gamma=interval(0,1)", "detector=voxelnet"],
        ["loss.gamma=1,0", "detector=voxelnet"],  # its baseline is 1
        ["loss.gamma=0,1", "detector=voxelnet", "sweep.baseline=1"],
    )
    assert len({name, *(sweep_name(other) for other in others)}) == 6


@pytest.mark.parametrize("group", ["detector", "data", "sweep"])
def test_yamls_of_one_name_in_two_folders_make_two_names(
    group: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What they say counts, and not where they lie or how they are commented."""
    words = ["loss.gamma=0,1", f"{'+' * (group == 'sweep')}{group}=mine", "hydra/launcher=mine"]
    names = []
    for number, text in enumerate(("a: 1\n", "a: 2\n", "# as it was\na: 1\n")):
        for place in (group, "hydra/launcher"):
            file = tmp_path / str(number) / place / "mine.yaml"
            file.parent.mkdir(parents=True)
            file.write_text(text if place == group else str(number))
        monkeypatch.setattr("fl3d.config.places._OWN", [tmp_path / str(number)])
        names.append(sweep_name(words))
    assert names[0] == names[2] != names[1]


def test_levels_behind_the_baseline_may_stand_in_any_order() -> None:
    assert sweep_name(["loss.gamma=0,1,2"]) == sweep_name(["loss.gamma=0,2,1"])


@pytest.mark.parametrize(
    ("words", "is_same"),
    [
        (["hydra/sweeper=until_decided"], True),  # the same trials, more seeds
        (["hydra/sweeper=until_decided", "seed=3"], True),
        (
            ["hydra/sweeper=optuna"],
            False,
        ),  # a search has trials of its own, and takes nobody's plan
        (["+hydra.sweeper.params={loss.gamma:'0,1'}"], False),
        (["+hydra.sweeper.params={loss.gamma:'0,2'}"], False),
    ],
)
def test_what_a_sweeper_trains_is_in_the_name(words: list[str], is_same: bool) -> None:
    swept = [] if "params" in words[0] else ["loss.gamma=0,1"]
    name = named(multirun([*swept, *words])).base["sweep"]["name"]
    assert name.startswith("trials-gamma-")
    assert (name == named(multirun(["loss.gamma=0,1"])).base["sweep"]["name"]) is is_same


def name_of(*words: str) -> str:
    return str(named(multirun(list(words))).base["sweep"]["name"])


def test_unnamed_studies_over_one_key_differ_in_name_where_they_ask_otherwise() -> None:
    """Under one name the second would go on in the study of the first, and take the place of its tables."""
    study = ("hydra/sweeper=optuna", "loss.gamma=interval(0,5)")
    grid_of_points = "hydra.sweeper.sampler._target_=optuna.samplers.GridSampler"
    points = "+hydra.sweeper.sampler.search_space={loss.gamma:[0,%d]}"
    lines = (
        study,
        (*study, grid_of_points, points % 1),
        (*study, grid_of_points, points % 2),
        (*study, "hydra.sweeper.rule=best"),
        (*study, "hydra.sweeper.study_name=other"),
        (*study, "seed=1"),
    )
    assert len({name_of(*line) for line in lines}) == len(lines)
    assert name_of(*study) == name_of(*study, "hydra.sweeper.n_trials=50", "device=cpu")


def test_a_study_is_another_where_optuna_would_refuse_to_go_on() -> None:
    words = (["a=0,1,2"], ["a=0,2,1"], ["a=range(0,3)"], ["a=0,1,2", "seed=0,1"], ["a=0,1,2,3"])
    assert len({sweep_name(one, search={"rule": "last"}) for one in words}) == len(words)
    as_grids = {sweep_name(one) for one in words}
    assert len(as_grids) == 2  # the same trials but for the last, and seeds are added


@pytest.mark.parametrize(
    ("one", "other"),
    [
        (["+sweep=mine", "a=0,1"], ["+sweep=yours", "a=0,1"]),  # files without a name in them
        (["a=0,1", "~b"], ["a=0,1"]),
        (["a=0,1", "b={_target_:mine.Loss}"], ["a=0,1", "b={_target_:yours.Loss}"]),
    ],
)
def test_whatever_is_trained_otherwise_is_in_the_name(one: list[str], other: list[str]) -> None:
    assert sweep_name(one) != sweep_name(other)
    assert sweep_name(one) == sweep_name([*one, "seed=0,1"])


def test_names_of_grids_are_what_they_were() -> None:
    """The same line goes on in a store of an earlier version."""
    assert sweep_name(["loss.gamma=0,1"]) == "trials-gamma-b79119e3"
    assert sweep_name(["loss.gamma=0,1", "optimizer.lr=1e-3"]) == "trials-gamma-de14ed68"


def test_other_params_are_another_sweep() -> None:
    names = {sweep_name([], {"loss.gamma": values}) for values in ("0,1", "0,2")}
    assert len(names) == 2


def test_of_two_orders_each_finds_its_own_baseline(
    started: list[str], root: Path, tmp_path: Path
) -> None:
    plans = root / "runs" / "plans"
    plan = read_plan(plans / f"{sweep_name([*GAMMAS, *started])}-simulated-tiny.json")
    folder = tmp_path / "runs" / "plans"
    turned = ["detector=voxelnet", "loss.gamma=2,0", *SHORT]
    for typed, baseline in ((GAMMAS, "0"), (turned, "2")):
        path = folder / f"{sweep_name([*typed, *started])}-simulated-tiny.json"
        write_plan(path, replace(plan, words=(*typed, *started), baseline=baseline))
    settings = read_settings(compose_config([*started, f"store.root={tmp_path / 'runs'}"]))
    for typed in (GAMMAS, turned):
        name = sweep_name([*typed, *started])
        assert find_by_hand(settings, [*typed, *started], name).sweep.name == name


def test_a_trial_is_the_same_however_it_is_typed() -> None:
    names = []
    for words in (["loss.gamma=2"], ["loss.gamma=2.0", "seed=0", "device=cpu"], ["seed=1"]):
        config = compose_config(["detector=voxelnet", *words])
        name_trial(config)
        names.append(config["sweep"]["name"])
    assert names[0] == names[1] != names[2]


def test_a_name_of_the_users_own_is_kept() -> None:
    config = compose_config(["detector=voxelnet", "sweep.name=mine"])
    name_trial(config)
    assert config["sweep"]["name"] == "mine"
    assert named(multirun(["sweep.name=mine"])).base["sweep"]["name"] == "mine"


def test_without_words_commands_mean_the_gamma_sweep(tmp_path: Path) -> None:
    words = [f"store.root={tmp_path}", "profile=tiny"]
    assert or_gamma(words) == [*words, "+sweep=gamma"]
    assert or_gamma(["sweep.name=mine"]) == ["sweep.name=mine"]


@pytest.mark.parametrize(
    ("typed", "meant"),
    [
        ("detector=3D-FCN", "detector=fcn3d"),
        ("detector=VoxelNet,3d-fcn,pointrcnn", "detector=voxelnet,fcn3d,pointrcnn"),
        ("detector=F-ConvNet", "detector=fconvnet"),
        ("detector=fcn3d", "detector=fcn3d"),
        ("detector=yolo", "detector=yolo"),  # refused where it is read
        ("detector.channels=3D-FCN", "detector.channels=3D-FCN"),
    ],
)
def test_a_detector_is_meant_by_either_of_its_names(typed: str, meant: str) -> None:
    assert spell_out_detectors(["-m", typed]) == ["-m", meant]


def test_a_sweep_over_detectors_takes_either_name_for_its_baseline(
    simulated: Path, tmp_path: Path
) -> None:
    from tests.support import small_sweep

    points = [["detector=voxelnet"], ["detector=fcn3d"]]
    for name in ("fcn3d", "3D-FCN"):
        prepared = small_sweep(simulated, tmp_path, points, f"sweep.baseline={name}")
        assert prepared.planner.frozen(prepared.plan).baseline == "3D-FCN"
    with pytest.raises(ConfigError, match=r"sweep\.baseline: no level 'pointrcnn'"):
        small_sweep(simulated, tmp_path, points, "sweep.baseline=pointrcnn")


@pytest.mark.parametrize(
    "word", ["sweep.name=a,b", "store.root=a,b", "sweep.primary=3d/easy,3d/hard"]
)
def test_what_belongs_to_the_whole_sweep_cannot_be_swept(places: list[str], word: str) -> None:
    asked = named(multirun([*places, "loss.gamma=0,2", word]))
    key = word.partition("=")[0]
    with pytest.raises(ConfigError, match=f"^{key}: all trials of a sweep must share it"):
        start(asked.arguments, grid({}, asked.arguments, asked.compose))


def test_frames_are_not_simulated_for_a_sweep_that_is_refused(tmp_path: Path) -> None:
    data = tmp_path / "data"
    words = ["profile=tiny", "data.train_frames=2,3", f"data.root={data}"]
    asked = named(multirun([*words, f"store.root={tmp_path / 'runs'}"]))
    with pytest.raises(ConfigError, match=r"^data.train_frames: all trials of a sweep must share"):
        start(asked.arguments, grid({}, asked.arguments, asked.compose))
    assert not data.exists()
