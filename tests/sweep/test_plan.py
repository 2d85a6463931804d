"""Plans and identities."""

import copy

import pytest

from fl3d.config import CONF, compose_config
from fl3d.errors import ConfigError
from fl3d.records import Config
from fl3d.sweep.identity import BOOKKEEPING, RESULT, leaves, matches, result_config
from fl3d.sweep.plan import DataInfo, longest_paths, make_plan
from fl3d.sweep.sweepers.grid import expand

FCN, VOXELNET = "fl3d.detectors.fcn3d.FCN3D", "fl3d.detectors.voxelnet.VoxelNet"
VERSIONS = {"trainer": 1, FCN: 1, VOXELNET: 1}
STAGES = dict.fromkeys((FCN, VOXELNET), ("warmup", "focal", "scratch"))
KITTI = DataInfo("digest", 3712)
GAMMAS = (0, 0.1, 0.2, 0.5, 1, 2, 5)


def config(*overrides: str) -> Config:
    return compose_config(["profile=paper", *overrides])


def plan_of(*configs: Config, data: DataInfo = KITTI, versions: dict[str, int] = VERSIONS):
    return make_plan("test", [((), c) for c in configs], data, versions, STAGES)


def test_the_papers_sweep_trains_240_of_420_epochs_per_detector() -> None:
    plan = plan_of(*(config(f"detector={d}", f"loss.gamma={g}") for d in ("fcn3d", "voxelnet") for g in GAMMAS))
    assert len(plan.trials) == 14
    assert len(plan.stages) == 2 * (1 + 7)
    assert (plan.epochs, plan.plain_epochs) == (480, 840)


def test_gamma_zero_gets_its_second_stage_like_the_others() -> None:
    plan = plan_of(config("loss.gamma=0"))
    assert [stage.name for stage in plan.stages.values()] == ["warmup", "focal"]
    focal = plan.stages[plan.trials[0].key]
    assert focal.config["schedule"]["stage"] == {"epochs": 30, "lr_factor": 0.1}


def test_steps_of_the_paper() -> None:
    """Phase 1 ends at 30 x 3712 = 111,360; the last model is at 222,720."""
    focal = plan_of(config()).stages[plan_of(config()).trials[0].key]
    assert (focal.start_step, focal.end_step) == (111_360, 222_720)


def test_the_same_trial_twice_is_one() -> None:
    assert len(plan_of(config("loss.gamma=1"), config("loss.gamma=1.0")).trials) == 1


def test_alpha_beta_share_nothing_of_a_warmup_they_change() -> None:
    """alpha acts in the warm-up as well, so only gamma's trials share it."""
    assert len(plan_of(config("loss.alpha=1.0"), config("loss.alpha=2.0")).stages) == 4


def test_seeds_share_nothing() -> None:
    assert len(plan_of(config("seed=0"), config("seed=1")).stages) == 4


@pytest.mark.parametrize(
    "change",
    [
        "loss.gamma=3",
        "optimizer.lr=0.5",
        "detector.voxel_size=[0.4,0.4,0.4]",
        "schedule.batch_size=2",
        "data.crop=none",
    ],
)
def test_what_changes_a_result_changes_the_key(change: str) -> None:
    assert plan_of(config()).trials[0].key != plan_of(config(change)).trials[0].key


@pytest.mark.parametrize(
    "change", ["device=cuda", "workers=4", "store.root=elsewhere", "results=there", "protocol.score_threshold=0.5"]
)
def test_what_does_not_does_not(change: str) -> None:
    assert plan_of(config()).trials[0].key == plan_of(config(change)).trials[0].key


def test_data_and_versions_change_the_key() -> None:
    base = plan_of(config()).trials[0].key
    assert plan_of(config(), data=DataInfo("other", 3712)).trials[0].key != base
    assert plan_of(config(), versions=VERSIONS | {"trainer": 2}).trials[0].key != base
    assert plan_of(config(), versions=VERSIONS | {VOXELNET: 2}).trials[0].key != base
    assert plan_of(config(), versions=VERSIONS | {FCN: 2}).trials[0].key == base


def test_a_class_that_moves_within_its_package_keeps_its_key() -> None:
    """Identity knows a class by its package and name, not by the module it lies in."""
    moved = copy.deepcopy(config())
    moved["loss"]["_target_"] = "fl3d.somewhere.else.DetectionLoss"
    moved["optimizer"]["_target_"] = "torch.optim.adam.Adam"
    moved["detector"]["targets"]["_target_"] = "fl3d.data.rules.TargetRule"
    assert plan_of(moved).trials[0].key == plan_of(config()).trials[0].key


@pytest.mark.parametrize("target", ["mylab.losses.DetectionLoss", "fl3d.losses.BalancedFocalLoss"])
def test_another_class_has_another_key(target: str) -> None:
    other = copy.deepcopy(config())
    other["loss"]["_target_"] = target
    assert plan_of(other).trials[0].key != plan_of(config()).trials[0].key


def test_two_classes_of_one_name_in_one_package_are_refused() -> None:
    other = copy.deepcopy(config())
    other["loss"]["_target_"] = "fl3d.experimental.DetectionLoss"
    with pytest.raises(ConfigError, match=r"fl3d.losses.DetectionLoss and fl3d.experimental.DetectionLoss"):
        plan_of(config(), other)


def test_a_stage_may_have_its_own_batch_size() -> None:
    """Steps of the ancestors are counted in the ancestors' batches."""
    changed = copy.deepcopy(config())
    changed["schedule"]["stages"]["focal"]["set"] = {"schedule": {"batch_size": 4}}
    stages = list(plan_of(changed).stages.values())
    assert [s.epoch_steps for s in stages] == [3712, 928]
    assert (stages[1].start_step, stages[1].end_step) == (30 * 3712, 30 * 3712 + 30 * 928)


def test_a_longer_second_stage_keeps_the_first() -> None:
    plan = plan_of(config(), config("schedule.stages.focal.epochs=60"))
    assert len(plan.stages) == 3


def test_a_stage_is_trained_from_nothing_but_what_is_hashed() -> None:
    """The warm-up's config holds no trace of the trial's gamma, nor of the stages after it."""
    plan = plan_of(config("loss.gamma=5"))
    warmup = plan.stages[plan.trials[0].stages[0]]
    assert warmup.config["loss"]["gamma"] == 0
    assert "stages" not in warmup.config["schedule"]
    assert "protocol" not in warmup.config


def test_an_unknown_stage_names_those_the_detector_offers() -> None:
    wrong = copy.deepcopy(config())
    wrong["schedule"]["stages"]["focall"] = wrong["schedule"]["stages"].pop("focal")
    with pytest.raises(ConfigError, match=r"no stage 'focall'.*Did you mean 'focal'"):
        plan_of(wrong)


@pytest.mark.parametrize("change", ["batch_size=0", "checkpoint_every=0", "frames_per_epoch=0", "epochs.focal=0"])
def test_counts_below_one_are_refused(change: str) -> None:
    with pytest.raises(ConfigError, match="not a whole number of at least 1"):
        plan_of(config(f"schedule.{change}"))


@pytest.mark.parametrize("schedule", ["two_phase", "from_scratch"])
@pytest.mark.parametrize("profile", ["paper", "quick", "standard", "tiny"])
def test_every_schedule_plans_under_every_profile(schedule: str, profile: str) -> None:
    plan = plan_of(compose_config([f"schedule={schedule}", f"profile={profile}"]))
    assert plan.epochs > 0


def test_an_interval_is_no_grid() -> None:
    with pytest.raises(ConfigError, match="to search an interval add hydra/sweeper=optuna"):
        expand({}, ["loss.gamma=interval(0,5)"])


def test_the_longest_path_counts_what_is_left() -> None:
    plan = plan_of(config("loss.gamma=0"), config("loss.gamma=1"))
    warmup, first, second = plan.stages
    assert longest_paths(plan, {first: 3.0, second: 2.0}) == {warmup: 3.0, first: 3.0, second: 2.0}
    assert longest_paths(plan, {warmup: 5.0, first: 3.0, second: 4.0})[warmup] == 9.0


def every_config() -> list[list[str]]:
    options = {
        group: sorted(p.stem for p in (CONF / group).glob("*.yaml"))
        for group in ("detector", "profile", "data", "loss", "schedule")
    }
    detectors = [[f"detector={d}", f"profile={p}"] for d in options["detector"] for p in options["profile"]]
    others = [[f"{group}={o}"] for group in ("data", "loss", "schedule") for o in options[group]]
    return [*detectors, *others]


@pytest.mark.parametrize("overrides", every_config(), ids=" ".join)
def test_every_key_is_either_a_result_or_bookkeeping(overrides: list[str]) -> None:
    for key, _ in leaves(compose_config(overrides)):
        assert matches(key, RESULT) != matches(key, BOOKKEEPING), f"{key}: name it in sweep/identity.py, once"


def test_result_config_keeps_values_and_nesting() -> None:
    kept = result_config(config("loss.gamma=2"))
    assert kept["loss"]["gamma"] == 2
    assert set(kept) == {
        *["seed", "precision", "compile", "detections", "data", "schedule", "detector", "loss", "optimizer"],
        "augment",
    }
    assert set(kept["data"]) == {"crop", "calibration"}


def test_a_grid_is_every_combination_and_the_command_line_overrules_the_file() -> None:
    params = {"detector": "fcn3d,voxelnet", "loss.gamma": "0,2"}
    fixed, grid = expand(params, ["+sweep=gamma", "seed=3"])
    assert fixed == ["+sweep=gamma", "seed=3"]
    assert len(grid) == 4
    assert grid[0] == ["detector=fcn3d", "loss.gamma=0"]
    fixed, grid = expand(params, ["detector=voxelnet", "loss.gamma=1,3"])
    assert fixed == []  # one value of what the file sweeps still tells the trials apart from others
    assert grid == [["detector=voxelnet", "loss.gamma=1"], ["detector=voxelnet", "loss.gamma=3"]]


def test_hydras_ranges_and_choices_are_axes() -> None:
    _, grid = expand({}, ["seed=range(3)", "loss.gamma=choice(0,2)"])
    assert len(grid) == 6
