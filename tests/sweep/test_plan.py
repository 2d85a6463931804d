"""Plans and identities."""

import ast
import copy
import os
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import yaml

import fl3d
from fl3d.config.compose import CONF, compose_config
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config, Stage, Trial
from fl3d.sweep.identity import (
    BOOKKEEPING,
    RESULT,
    leaves,
    matches,
    result_config,
    stable_name,
    targets,
)
from fl3d.sweep.plan import (
    DataInfo,
    DetectorInfo,
    Plan,
    check_names,
    longest_paths,
    trial_stages,
)
from fl3d.sweep.sweepers.grid import expand, grid, point_of

FCN = "fl3d.detectors.fcn3d.FCN3D"
VOXELNET = "fl3d.detectors.voxelnet.VoxelNet"
VERSIONS = {"trainer": 1, FCN: 1, VOXELNET: 1}
STAGES = ("warmup", "focal", "scratch")
KITTI = DataInfo("digest", 3712)
GAMMAS = (0, 0.1, 0.2, 0.5, 1, 2, 5)


def config(*overrides: str) -> Config:
    return compose_config(["profile=paper", *overrides])


def chain_of(
    config: Config, data: DataInfo = KITTI, versions: Mapping[str, int] = VERSIONS
) -> list[Stage]:
    """Stages of a trial, as if its detector had the stages of the paper's."""
    target = config["detector"]["_target_"]
    name = target.rpartition(".")[2]
    detector = DetectorInfo(name, versions.get(target, 1), STAGES)
    return trial_stages(config, data, versions["trainer"], detector)


def plan_of(
    *configs: Config, data: DataInfo = KITTI, versions: Mapping[str, int] = VERSIONS
) -> Plan:
    check_names(configs)
    plan = Plan("test", (), {})
    for one in configs:
        chain = chain_of(one, data, versions)
        trial = Trial(
            key=chain[-1].key,
            overrides=(),
            values={},
            config=one,
            stages=tuple(stage.key for stage in chain),
            first_own_step=chain[-1].start_step,
            detector="",
            group="",
            level="",
            seed=one["seed"],
        )
        plan = plan.joined(Plan("test", (trial,), {stage.key: stage for stage in chain}))
    return plan


def test_the_papers_sweep_trains_240_of_420_epochs_per_detector() -> None:
    detectors = ("fcn3d", "voxelnet")
    points = [(f"detector={d}", f"loss.gamma={g}") for d in detectors for g in GAMMAS]
    plan = plan_of(*(config(*point) for point in points))
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
    focal = chain_of(config())[-1]
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
    "change",
    [
        "device=cuda",
        "workers=4",
        "store.root=elsewhere",
        "results=there",
        "protocol.score_threshold=0.5",
        "sweep.factor=loss.gamma",
        "sweep.primary=bev/easy",
    ],
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
    message = r"fl3d.losses.DetectionLoss and fl3d.experimental.DetectionLoss"
    with pytest.raises(ConfigError, match=message):
        plan_of(config(), other)


def classes_of_fl3d() -> Iterator[str]:
    """Every class that fl3d defines."""
    package = Path(fl3d.__file__).parent
    for path in package.rglob("*.py"):
        module = ".".join(["fl3d", *path.relative_to(package).with_suffix("").parts])
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef):
                yield f"{module}.{node.name}"


def configured_targets() -> set[str]:
    """Every ``_target_`` of fl3d's in conf/, sweeps among them."""
    files = [
        Path(folder) / name
        for folder, _, names in os.walk(CONF, followlinks=True)  # conf/sweep is a link
        for name in names
        if name.endswith(".yaml")
    ]
    found = {target for file in files for target in targets(yaml.safe_load(file.read_text()))}
    return {target for target in found if target.startswith("fl3d.")}


def test_every_class_that_a_config_names_has_a_name_of_its_own_in_fl3d() -> None:
    """Identity knows it by that name alone: another class of the name would pass for it."""
    named: dict[str, list[str]] = {}
    for path in classes_of_fl3d():
        named.setdefault(stable_name(path), []).append(path)
    configured = configured_targets()
    assert len(configured) > 10
    for target in configured:
        assert len(named[stable_name(target)]) == 1, named[stable_name(target)]


def test_a_stage_may_have_its_own_batch_size() -> None:
    """Steps of the ancestors are counted in the ancestors' batches."""
    changed = copy.deepcopy(config())
    changed["schedule"]["stages"]["focal"]["set"] = {"schedule": {"batch_size": 4}}
    stages = list(plan_of(changed).stages.values())
    assert [s.epoch_steps for s in stages] == [3712, 928]
    assert stages[1].start_step == 30 * 3712
    assert stages[1].end_step == 30 * 3712 + 30 * 928


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


@pytest.mark.parametrize(
    "change", ["batch_size=0", "checkpoint_every=0", "frames_per_epoch=0", "epochs.focal=0"]
)
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
    left = {first: 3.0, second: 2.0}
    assert longest_paths(plan, left) == {warmup: 3.0, first: 3.0, second: 2.0}
    assert longest_paths(plan, {warmup: 5.0, first: 3.0, second: 4.0})[warmup] == 9.0


def every_config() -> list[list[str]]:
    options = {
        group: sorted(p.stem for p in (CONF / group).glob("*.yaml"))
        for group in ("detector", "profile", "data", "loss", "schedule")
    }
    profiles = options["profile"]
    detectors = [[f"detector={d}", f"profile={p}"] for d in options["detector"] for p in profiles]
    groups = ("data", "loss", "schedule")
    others = [[f"{group}={option}"] for group in groups for option in options[group]]
    return [*detectors, *others]


@pytest.mark.parametrize("overrides", every_config(), ids=" ".join)
def test_every_key_is_either_a_result_or_bookkeeping(overrides: list[str]) -> None:
    for key, _ in leaves(compose_config(overrides)):
        is_named_once = matches(key, RESULT) != matches(key, BOOKKEEPING)
        assert is_named_once, f"{key}: name it in sweep/identity.py, once"


def test_result_config_keeps_values_and_nesting() -> None:
    kept = result_config(config("loss.gamma=2"))
    assert kept["loss"]["gamma"] == 2
    assert set(kept) == {
        "augment",
        "compile",
        "data",
        "detections",
        "detector",
        "loss",
        "optimizer",
        "precision",
        "schedule",
        "seed",
    }
    assert set(kept["data"]) == {"crop", "calibration"}


def test_a_grid_is_every_combination_and_the_command_line_overrules_the_file() -> None:
    params = {"detector": "fcn3d,voxelnet", "loss.gamma": "0,2"}
    grid = expand(params, ["+sweep=gamma", "seed=3"])
    assert grid.fixed == ["+sweep=gamma", "seed=3"]
    assert len(grid.points) == 4
    assert grid.points[0] == ("detector=fcn3d", "loss.gamma=0")
    grid = expand(params, ["detector=voxelnet", "loss.gamma=1,3"])
    assert grid.fixed == []  # one value of what the file sweeps still tells its trials from others
    own = [("detector=voxelnet", "loss.gamma=1"), ("detector=voxelnet", "loss.gamma=3")]
    assert grid.points == own


def test_hydras_ranges_and_choices_are_axes() -> None:
    assert len(expand({}, ["seed=range(3)", "loss.gamma=choice(0,2)"]).points) == 6


def test_one_value_of_what_a_file_sweeps_is_still_a_value_of_the_trial() -> None:
    grid = expand({"loss.alpha": "0.75,0.8"}, ["loss.alpha=0.8", "seed=3"])
    assert grid.fixed == ["seed=3"]
    assert grid.points == [("loss.alpha=0.8",)]
    grid = expand({"loss.alpha": "0.75,0.8"}, ["~loss.alpha"])
    assert grid.fixed == ["~loss.alpha"]  # it has no value
    assert grid.points == [()]


def test_a_point_has_its_values_as_data_beside_the_overrides() -> None:
    overrides = (
        "detector=voxelnet",
        "loss.gamma=0.5",
        "+schedule.stages.focal.set.loss.alpha=2",
        "detector.voxel_size=[0.4,0.4,0.4]",
        "protocol.ignore_beyond=null",
        "store.root='a b'",
        "detector.rpn={search:2.0,bin:0.2}",
    )
    point = point_of(overrides, {})
    assert point.overrides == overrides
    assert list(point.values.items()) == [
        ("detector", "voxelnet"),
        ("loss.gamma", 0.5),
        ("schedule.stages.focal.set.loss.alpha", 2),
        ("detector.voxel_size", [0.4, 0.4, 0.4]),
        ("protocol.ignore_beyond", None),
        ("store.root", "a b"),
        ("detector.rpn", {"search": 2.0, "bin": 0.2}),
    ]


def test_a_grid_knows_the_keys_that_it_sweeps() -> None:
    listed = grid({"detector": "fcn3d,voxelnet"}, ["loss.gamma=0,2", "seed=3"], lambda line: {})
    assert listed.swept == ("detector", "loss.gamma")
    assert listed.n_trials == 4
