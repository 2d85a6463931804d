"""A finished sweep, opened from a store folder or from a file of its scores."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.analysis.found import left_out
from fl3d.config.compose import compose_config
from fl3d.config.settings import Settings, read_settings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.records import Checkpoint, Stage
from fl3d.data.kitti import KittiFolder
from fl3d.evaluation.detections import Detections, write_detections
from fl3d.evaluation.protocol import Protocol
from fl3d.evaluation.selection import BEST_OF_LAST_STAGE, MEAN_3D
from fl3d.runs.asked import apart
from fl3d.runs.checkpoints import write_marker
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import is_stored, open_sweep
from fl3d.runs.plans import FrozenPlan, FrozenTrial, write_plan
from fl3d.runs.scores import FRONT, read_score_file, score_file, write_score_file
from fl3d.runs.spec import Machine, Spec, write_done, write_spec
from fl3d.runs.trials import FinishedTrial
from fl3d.store.base import Scored, Store
from fl3d.store.memory import MemoryStore

STEPS = {"warmup": (2,), "focal": (4, 6)}


def settings_of(root: Path, *overrides: str) -> Settings:
    places = [f"store.root={root / 'runs'}", f"results={root / 'results'}", "profile=tiny"]
    return read_settings(compose_config(["sweep.name=test", *places, *overrides]))


def frozen(gamma: float, seed: int, detector: str = "VoxelNet") -> FrozenTrial:
    key = f"{detector.lower()}-focal-{gamma:g}-{seed}"
    warmup = f"{detector.lower()}-warmup-{seed}"
    name = detector.lower()
    return FrozenTrial(
        key=key,
        overrides=(f"detector={name}", f"loss.gamma={gamma}", f"seed={seed}"),
        values={"detector": name, "loss.gamma": gamma, "seed": seed},
        config={"loss.gamma": gamma, "seed": seed},
        stages=(warmup, key),
        first_own_step=2,
        detector=detector,
        group=detector,
        level=f"{gamma:g}",
        seed=seed,
    )


GRID = tuple(frozen(gamma, seed) for gamma in (10.0, 0.0, 2.0) for seed in (0, 1))
PLAN = FrozenPlan(factor=("loss.gamma",), baseline="0", trials=GRID)


def value(trial: FrozenTrial, step: int) -> float:
    """Of every AP: highest at the last stage's first checkpoint."""
    return trial.value("loss.gamma") + 100 * trial.seed + {2: 50, 4: 9, 6: 3}[step] + 0.1


class World:
    """A sweep as it would lie in a store folder, with its scores in memory."""

    def __init__(self, root: Path, store: MemoryStore) -> None:
        self.root = root
        self.settings = settings_of(root)
        self.layout = StoreFolder(self.settings.store.root)
        self.store = store

    def plan(self, plan: FrozenPlan = PLAN) -> None:
        write_plan(self.layout.plan(self.settings.experiment), plan)

    def train(self, trials: Sequence[FrozenTrial] = GRID) -> None:
        """To its end: markers without weights."""
        for trial in trials:
            for key, steps in zip(trial.stages, STEPS.values(), strict=True):
                folder = self.layout.run(key)
                for step in steps:
                    write_marker(
                        folder,
                        Checkpoint(
                            stage=key,
                            step=step,
                            epoch=step // 2,
                            lr=0.1,
                            losses={},
                            seconds={},
                            sha256="",
                        ),
                    )
                write_done(folder, {"step": steps[-1]})

    def log(
        self,
        trials: Sequence[FrozenTrial] = GRID,
        protocol: Protocol | None = None,
        until: int = 6,
    ) -> None:
        experiment = self.store.experiment(self.settings.experiment, "")
        named = (protocol or self.settings.protocol).id
        for trial in trials:
            run = self.store.run(experiment, trial.key, named, "", {}, {})
            for step in range(2, until + 1, 2):
                values = dict.fromkeys([*MEAN_3D, "recall_3d/0.7"], value(trial, step))
                self.store.log(run, Scored(step, 0, {**values, "epoch": step // 2}))


@pytest.fixture
def world(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> World:
    store = MemoryStore(tmp_path / "runs")

    def open_store(root: Path, uri: str | None) -> Store:
        assert root == store.root
        return store

    for reader in ("opening", "finished"):
        monkeypatch.setattr(f"fl3d.runs.{reader}.open_store", open_store)
    return World(tmp_path, store)


def lose(world: World, trial: FrozenTrial, step: int, names: Sequence[str]) -> None:
    """Some scores of a checkpoint, as a store that was written by halves."""
    (run,) = (run for run in world.store.runs.values() if run.trial == trial.key)
    left = {name: value for name, value in run.scores[step].values.items() if name not in names}
    run.scores[step] = replace(run.scores[step], values=left)


@pytest.fixture
def ran(world: World) -> World:
    world.plan()
    world.train()
    world.log()
    return world


def test_it_is_opened_from_the_store(ran: World) -> None:
    sweep = open_sweep(ran.settings)
    assert sweep.name == "test"
    assert sweep.is_from_store
    assert sweep.source == ran.settings.store.root
    assert sweep.factor == ("loss.gamma",)
    assert sweep.baseline == "0"
    assert sweep.levels == ["0", "2", "10"]
    assert sweep.groups == ["VoxelNet"]
    assert [trial.plan for trial in sweep.trials] == list(GRID)  # in the sweep's order
    assert sweep.protocol == ran.settings.protocol


def test_its_scores_are_a_row_for_each_trial_and_step(ran: World) -> None:
    scores = open_sweep(ran.settings).scores
    assert list(scores) == [*FRONT, *sorted(MEAN_3D), "recall_3d/0.7"]
    assert len(scores) == 6 * 3
    assert scores["level"].drop_duplicates().tolist() == ["0", "2", "10"]  # by number
    row = scores[(scores["level"] == "2") & (scores["seed"] == 1)].iloc[-1]
    assert row["trial"] == "voxelnet-focal-2-1"
    assert (row["step"], row["epoch"], row["first_own_step"]) == (6, 3, 2)
    assert row["ap_3d/moderate"] == 2.0 + 100 + 3 + 0.1


def test_a_rule_picks_the_checkpoint_that_stands_for_a_trial(ran: World) -> None:
    sweep = open_sweep(ran.settings)
    key = GRID[0].key
    assert sweep.steps("last")[key] == 6
    assert sweep.steps("best")[key] == 2  # of the stage that it shares
    assert sweep.steps(BEST_OF_LAST_STAGE)[key] == 4
    narrow = replace(sweep, settings=replace(sweep.settings, best_among="last"))
    assert narrow.steps("best")[key] == narrow.steps(BEST_OF_LAST_STAGE)[key] == 4
    assert sweep.trial(key).last_step == 6


def test_a_trial_that_is_not_done_is_left_out(world: World) -> None:
    world.plan()
    world.train()
    world.log()
    world.layout.run(GRID[0].key).done.unlink()
    sweep = open_sweep(world.settings)
    assert [trial.key for trial in sweep.trials] == [trial.key for trial in GRID[1:]]
    assert GRID[0].key not in set(sweep.scores["trial"])
    assert len(sweep.plan.trials) == 6  # which tells that one is missing


def test_a_trial_whose_scores_wait_for_the_store_is_left_out(world: World) -> None:
    world.plan()
    world.train()
    world.log(GRID[1:])
    assert len(open_sweep(world.settings).trials) == 5


def test_a_trial_whose_last_checkpoint_lacks_a_score_is_left_out_and_what_it_lacks_is_said(
    world: World,
) -> None:
    """Of gamma 2 seed 0 lacks one at its last step, and seed 1 at an earlier one: that checkpoint alone is left out."""
    world.plan()
    world.train()
    world.log()
    lose(world, GRID[4], 6, MEAN_3D[:1])
    lose(world, GRID[5], 4, MEAN_3D[:1])
    sweep = open_sweep(world.settings)
    assert [trial.key for trial in sweep.trials] == [one.key for one in (*GRID[:4], GRID[5])]
    assert left_out(sweep) == ["VoxelNet 2: seed 0 left out, its scores lack ap_3d/easy"]
    own = sweep.scores[sweep.scores["trial"] == GRID[5].key]
    assert own["step"].tolist() == [2, 6]


def test_where_the_baseline_lacks_a_score_its_pairs_say_so(world: World) -> None:
    world.plan()
    world.train()
    world.log()
    lose(world, GRID[2], 6, MEAN_3D[1:])
    lacks = "scores lack ap_3d/hard, ap_3d/moderate"
    assert left_out(open_sweep(world.settings)) == [
        f"VoxelNet 10: seed 0 left out, its baseline's {lacks}",
        f"VoxelNet 0: seed 0 left out, its {lacks}",
        f"VoxelNet 2: seed 0 left out, its baseline's {lacks}",
    ]


def test_a_trial_that_is_done_and_not_in_the_store_is_not_said_to_be_open(world: World) -> None:
    world.plan()
    world.train()
    world.log(GRID[1:])
    (line,) = left_out(open_sweep(world.settings))
    assert line.startswith("VoxelNet 10: seed 0 left out, its scores under protocol ")
    assert line.endswith(" are not in the store")


def test_a_trial_whose_last_scores_wait_for_the_store_is_left_out_and_known(world: World) -> None:
    """What the store holds of it ends in the middle of its training: step 4 of 6, with 9 AP instead of 3."""
    world.plan()
    world.train()
    world.log(GRID[1:])
    world.log(GRID[:1], until=4)
    sweep = open_sweep(world.settings)
    assert [trial.key for trial in sweep.trials] == [trial.key for trial in GRID[1:]]
    assert set(sweep.select("last")["step"]) == {6}
    assert set(sweep.unshown) == {GRID[0].key}
    world.log(GRID[:1])
    assert open_sweep(world.settings).steps("last") == dict.fromkeys((t.key for t in GRID), 6)


def test_a_trial_that_has_ended_with_a_step_that_nobody_has_logged_is_left_out(ran: World) -> None:
    """Whether its last marker is listed or not: step 6 does not stand for one that ended with step 8."""
    write_done(ran.layout.run(GRID[0].key), {"step": 8})
    assert GRID[0].key not in open_sweep(ran.settings).steps("last")


def test_trials_of_an_earlier_start_are_left_out(ran: World) -> None:
    """They lie in the store, but the sweep asks for others now."""
    ran.plan(replace(PLAN, trials=GRID[2:]))
    sweep = open_sweep(ran.settings)
    assert sweep.levels == ["0", "2"]
    assert set(sweep.scores["level"]) == {"0", "2"}


def test_a_checkpoint_is_held_by_the_stage_that_made_it(ran: World) -> None:
    sweep = open_sweep(ran.settings)
    trial = sweep.trials[0]
    assert trial.holder(2).key == "voxelnet-warmup-0"
    assert trial.holder(4).key == trial.key
    assert trial.folder.key == trial.key
    with pytest.raises(StoreError, match=r"neither it nor a stage it resumes from.*step 99"):
        trial.holder(99)


def detections(score: float) -> Detections:
    box = np.array([[20.0, 0.0, -1.0, 1.5, 1.6, 4.0, 0.0]])
    return Detections(("000000",), np.array([0]), box, np.array([score]))


def test_detections_are_those_of_the_stage_that_made_the_checkpoint(ran: World) -> None:
    """Of a stage that trials share, for each of them."""
    for key, step, score in (("voxelnet-warmup-0", 2, 0.2), (GRID[0].key, 6, 0.6)):
        write_detections(ran.layout.run(key).detections(step), detections(score))
    sweep = open_sweep(ran.settings)
    first, other = sweep.trials[0], sweep.trial(GRID[2].key)
    assert sweep.detections(first).scores.tolist() == [0.6]  # the last
    assert sweep.detections(first, 2).scores.tolist() == [0.2]
    assert sweep.detections(other, 2).scores.tolist() == [0.2]


def machine_of(settings: Settings, root: Path) -> Machine:
    return Machine(
        data_root=root,
        train_ids=(),
        val_ids=tuple(KittiFolder(root).split("val")),
        protocol=settings.protocol,
    )


def stage_of(trial: FrozenTrial) -> Stage:
    config = {
        "seed": trial.seed,
        "schedule": {"batch_size": 1, "checkpoint_every": 1},
        "data": {"crop": "image", "calibration": "frame"},
        "detections": {"max_boxes": 10, "min_score": 0.1},
    }
    return Stage(
        key=trial.key,
        name="focal",
        config=config,
        parent=trial.stages[0],
        start_epoch=1,
        start_step=2,
        epochs=2,
        epoch_steps=2,
    )


def test_detections_are_held_against_its_own_frames(ran: World, simulated: Path) -> None:
    machine = machine_of(ran.settings, simulated)
    for trial in GRID:
        write_spec(ran.layout.run(trial.key), Spec(stage_of(trial), machine))
    nothing = Detections(machine.val_ids, np.array([], int), np.zeros((0, 7)), np.zeros(0))
    write_detections(ran.layout.run(GRID[0].key).detections(6), nothing)
    sweep = open_sweep(ran.settings)
    assert sweep.kitti().root == simulated
    assert sweep.validation.ids == machine.val_ids
    compared = sweep.comparison(sweep.trials[0])
    assert compared.protocol == ran.settings.protocol
    assert len(compared.gt.types) == sum(len(one.types) for one in sweep.validation.labels)
    assert len(compared.det.types) == 0


def test_frames_that_have_moved_are_read_where_the_config_says(
    ran: World, simulated: Path, tmp_path: Path
) -> None:
    machine = replace(machine_of(ran.settings, simulated), data_root=tmp_path / "gone")
    for trial in GRID:
        write_spec(ran.layout.run(trial.key), Spec(stage_of(trial), machine))
    moved = settings_of(tmp_path, "data=kitti", f"data.root={simulated}", "data.name=simulated")
    assert open_sweep(replace(moved, sweep=ran.settings.sweep)).kitti().root == simulated


def write_file(root: Path, settings: Settings, plan: FrozenPlan = PLAN) -> pd.DataFrame:
    """As a report publishes a sweep's scores."""
    rows = [
        {
            "trial": trial.key,
            "detector": trial.detector,
            "group": trial.group,
            "level": trial.level,
            "seed": trial.seed,
            "protocol": settings.protocol.id,
            "first_own_step": 2,
            "epoch": step // 2,
            "step": step,
            **dict.fromkeys(MEAN_3D, value(trial, step)),
        }
        for trial in plan.trials
        for step in (2, 4, 6)
    ]
    scores = pd.DataFrame(rows)
    write_score_file(score_file(root / settings.folder_name, "test"), scores, plan)
    return scores


def test_it_is_opened_from_a_file_where_the_store_holds_none(world: World) -> None:
    scores = write_file(world.settings.results, world.settings)
    sweep = open_sweep(world.settings)
    assert not sweep.is_from_store
    assert sweep.source == world.root / "results" / "simulated-tiny" / "scores" / "test.csv"
    assert sweep.plan == PLAN
    assert [trial.plan for trial in sweep.trials] == list(GRID)
    pd.testing.assert_frame_equal(sweep.scores, scores, check_exact=True)
    assert sweep.levels == ["0", "2", "10"]


def test_scores_that_were_written_are_those_that_were_read(ran: World) -> None:
    """To the bit, from a store to a file and back."""
    sweep = open_sweep(ran.settings)
    path = ran.root / "copy.csv"
    told = replace(sweep.plan, words=("data.root=/home/me/kitti",))
    assert write_score_file(path, sweep.scores, told) == [path, path.with_suffix(".json")]
    assert "/home/me" not in path.with_suffix(".json").read_text()
    plan, scores = read_score_file(path, sweep.protocol)
    assert plan == sweep.plan
    pd.testing.assert_frame_equal(scores, sweep.scores, check_exact=True)


def test_labels_that_look_like_something_else_stay_labels(world: World) -> None:
    """``null`` is a level, and so are ``true`` and 1e3."""
    trials = tuple(
        replace(frozen(0.0, seed), level=level, group="NA")
        for seed, level in enumerate(("null", "true", "1e3", "nan"))
    )
    write_file(world.settings.results, world.settings, replace(PLAN, trials=trials))
    scores = open_sweep(world.settings).scores
    assert scores["level"].drop_duplicates().tolist() == ["null", "true", "1e3", "nan"]
    assert set(scores["group"]) == {"NA"}


def test_of_a_file_there_are_no_run_folders(world: World) -> None:
    write_file(world.settings.results, world.settings)
    trial = open_sweep(world.settings).trials[0]
    for ask in (
        lambda one: one.folder,
        lambda one: one.last_step,
        lambda one: one.holder(6),
    ):
        with pytest.raises(StoreError, match=r"only its scores are here; run the sweep"):
            ask(trial)


def test_the_store_comes_first_then_ones_own_results_then_published_ones(world: World) -> None:
    published = world.root / "published"
    for root, trials in ((published, GRID[:1]), (world.settings.results, GRID[:2])):
        write_file(root, world.settings, replace(PLAN, trials=trials))
    assert len(open_sweep(world.settings, published=published).trials) == 2
    score_file(world.settings.results_folder, "test").unlink()
    assert len(open_sweep(world.settings, published=published).trials) == 1
    world.plan()
    world.train()
    world.log()
    assert len(open_sweep(world.settings, published=published).trials) == 6


def test_a_sweep_that_is_nowhere_says_where_was_looked(world: World) -> None:
    with pytest.raises(StoreError) as caught:
        open_sweep(world.settings, published=world.root / "published")
    for part in ("no scores of test-simulated-tiny", "results/", "published/", "run the sweep"):
        assert part in str(caught.value)


def test_scores_under_another_protocol_are_not_shown(ran: World) -> None:
    other = settings_of(ran.root, "protocol=kitti")
    with pytest.raises(
        StoreError, match="6 trials done, and none to show: its scores under protocol"
    ) as caught:
        open_sweep(other)
    assert "trains nothing again" in str(caught.value)
    ran.log(GRID[:2], other.protocol)
    assert len(open_sweep(other).trials) == 2
    assert len(open_sweep(ran.settings).scores) == 6 * 3


def test_a_file_under_another_protocol_is_refused_by_name(world: World) -> None:
    write_file(world.settings.results, world.settings)
    other = settings_of(world.root, "protocol=kitti")
    message = rf"no scores under protocol {other.protocol.id}, only {world.settings.protocol.id}"
    with pytest.raises(StoreError, match=message):
        open_sweep(other)


def test_a_file_without_its_columns_is_refused(world: World) -> None:
    """As of a version that told trials by gamma."""
    write_file(world.settings.results, world.settings)
    path = score_file(world.settings.results_folder, "test")
    pd.read_csv(path).drop(columns=["group", "level"]).to_csv(path, index=False)
    with pytest.raises(StoreError, match=r"test\.csv: no column group, level"):
        open_sweep(world.settings)


def test_a_file_without_its_plan_is_refused(world: World) -> None:
    write_file(world.settings.results, world.settings)
    score_file(world.settings.results_folder, "test").with_suffix(".json").unlink()
    with pytest.raises(StoreError, match=r"test\.json: no such file"):
        open_sweep(world.settings)


@pytest.mark.parametrize(
    ("asked", "keys"),
    [
        ({}, [trial.key for trial in GRID]),
        ({"loss.gamma": [0]}, ["voxelnet-focal-0-0", "voxelnet-focal-0-1"]),
        (
            {"loss.gamma": [2.0, 10], "seed": [1]},
            ["voxelnet-focal-10-1", "voxelnet-focal-0-1", "voxelnet-focal-2-1"],
        ),  # gamma 0 is the baseline
        ({"seed": [0]}, ["voxelnet-focal-10-0", "voxelnet-focal-0-0", "voxelnet-focal-2-0"]),
        ({"detector": ["voxelnet"], "device": ["cuda"]}, [trial.key for trial in GRID]),
    ],
)
def test_values_that_are_asked_for_pick_trials(
    ran: World, asked: dict[str, list[object]], keys: list[str]
) -> None:
    """The baseline stays beside other levels; what the trials do not differ in picks nothing."""
    sweep = open_sweep(ran.settings, asked)
    assert [trial.key for trial in sweep.trials] == keys
    assert set(sweep.scores["trial"]) == set(keys)
    assert list(sweep.scores.index) == list(range(3 * len(keys)))


@pytest.mark.parametrize(
    ("asked", "part"),
    [
        ({}, ""),
        ({"loss.gamma": [0, 2, 10], "seed": [1, 0]}, ""),  # all of it
        ({"device": ["cuda"]}, ""),  # nothing that its trials differ in
        ({"seed": [1]}, "asked/test_seed=1"),
        ({"seed": [0], "loss.gamma": [10]}, "asked/test_gamma=10_seed=0"),
        ({"seed": [1, 0], "loss.gamma": [10]}, "asked/test_gamma=10"),
        ({"loss.gamma": [2.0]}, "asked/test_gamma=2"),
    ],
)
def test_results_of_a_part_lie_apart_from_those_of_the_whole(
    ran: World, asked: dict[str, list[object]], part: str
) -> None:
    sweep = open_sweep(ran.settings, asked)
    assert sweep.settings.results_folder == ran.settings.results_folder / part
    assert (sweep.drawn_as("forest") is None) == bool(part)
    other = replace(ran.settings, sweep=replace(ran.settings.sweep, baseline=2))
    folder = open_sweep(other, asked).settings.results_folder
    assert folder.name == f"{Path(part).name or 'test'}_baseline=2"


def test_a_part_of_many_values_has_a_name_that_a_folder_can_have(ran: World) -> None:
    names = set()
    for end in "ab":
        part = apart(open_sweep(ran.settings), ["level=" + "a b/" * 100 + end]).settings.part
        assert len(part) < 140
        assert "/" not in part
        names.add(part)
    assert len(names) == 2


def test_levels_that_are_picked_keep_those_that_they_are_judged_with(ran: World) -> None:
    """A seed that is picked is another matter: it leaves out that of all levels."""
    sweep = open_sweep(ran.settings, {"loss.gamma": [2.0], "seed": [1]})
    assert sweep.levels == ["0", "2"]
    assert sweep.family is not None
    assert sweep.family.levels == ["0", "2", "10"]
    assert {trial.seed for trial in sweep.family.trials} == {1}
    assert open_sweep(ran.settings, {"seed": [1]}).family is None


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"loss.gamma": [3]}, r"loss.gamma=3: test-simulated-tiny has no .*Possible: 0, 10, 2\."),
        ({"seed": [0, 7]}, r"seed=7: .*Possible: 0, 1\."),
        ({"detector": ["voxlnet"]}, r"Did you mean 'voxelnet'"),
    ],
)
def test_a_value_that_no_trial_has_is_answered_with_those_there_are(
    ran: World, asked: dict[str, list[object]], message: str
) -> None:
    with pytest.raises(StoreError, match=message):
        open_sweep(ran.settings, asked)


def test_values_that_no_trial_has_together_are_refused(ran: World) -> None:
    only = (GRID[0], GRID[3])  # gamma 10 of seed 0, gamma 0 of seed 1
    ran.plan(replace(PLAN, trials=only))
    with pytest.raises(StoreError, match=r"seed=1: .*Possible: 0\."):
        open_sweep(ran.settings, {"loss.gamma": [10], "seed": [1]})


def test_detectors_are_groups_in_alphabetical_order(world: World) -> None:
    trials = (*GRID[:2], frozen(0.0, 0, "3D-FCN"))
    world.plan(replace(PLAN, trials=trials))
    world.train(trials)
    world.log(trials)
    sweep = open_sweep(world.settings)
    assert sweep.groups == ["3D-FCN", "VoxelNet"]
    assert sweep.scores["group"].drop_duplicates().tolist() == ["3D-FCN", "VoxelNet"]


def test_whether_a_sweep_is_here_is_known_without_opening_it(world: World) -> None:
    published = world.root / "published"
    assert not is_stored(world.settings, published)
    write_file(published, world.settings)
    assert not is_stored(world.settings)
    assert is_stored(world.settings, published)
    world.plan()
    assert is_stored(world.settings)


def test_a_trial_tells_what_its_plan_tells() -> None:
    trial = FinishedTrial(GRID[0], ())
    assert (trial.key, trial.group, trial.level) == (GRID[0].key, "VoxelNet", "10")
    assert (trial.seed, trial.detector) == (0, "VoxelNet")


def test_a_baseline_asked_for_now_is_held_to_and_must_be_a_level(ran: World) -> None:
    def asking(baseline: object) -> str:
        sweep = replace(ran.settings.sweep, baseline=baseline)
        return open_sweep(replace(ran.settings, sweep=sweep)).baseline

    assert asking(None) == "0"
    assert asking(2.0) == "2"
    with pytest.raises(ConfigError, match=r"sweep.baseline: no level '7'"):
        asking(7)


@pytest.mark.parametrize("factor", ["loss.alpha", "loss.nosuch", "[loss.gamma,loss.alpha]"])
def test_another_factor_than_the_sweep_was_run_with_is_refused(ran: World, factor: str) -> None:
    """It would be answered with the verdicts of the factor that it has."""
    asking = settings_of(ran.root, f"sweep.factor={factor}")
    message = r"^sweep\.factor: test-simulated-tiny was run to compare loss\.gamma, not loss\."
    with pytest.raises(ConfigError, match=message):
        open_sweep(asking)
    assert len(open_sweep(settings_of(ran.root, "sweep.factor=loss.gamma")).trials) == 6


def test_a_sweep_that_has_begun_and_has_nothing_done_says_so(ran: World) -> None:
    for trial in GRID:
        StoreFolder(ran.settings.store.root).run(trial.key).done.unlink()
    with pytest.raises(StoreError, match="none of its 6 trials is done yet; the command"):
        open_sweep(ran.settings)
