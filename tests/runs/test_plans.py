"""Frozen plans: what a sweep's trials are, whatever configs say later."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from fl3d.core.errors import StoreError
from fl3d.core.records import Trial
from fl3d.runs.layout import StoreFolder
from fl3d.runs.plans import (
    VERSION,
    FrozenPlan,
    FrozenTrial,
    PlanFile,
    freeze,
    grown_file,
    named_stages,
    read_plan,
    write_plan,
)


def frozen(key: str, gamma: float, **config: object) -> FrozenTrial:
    return FrozenTrial(
        key=key,
        overrides=("detector=voxelnet", f"loss.gamma={gamma}", "detector.rpn={search:2.0,bin:0.2}"),
        values={
            "detector": "voxelnet",
            "loss.gamma": gamma,
            "detector.rpn": {"search": 2.0, "bin": 0.2},
        },
        config={
            "loss.gamma": gamma,
            "loss.alpha": 1,
            "augment": None,
            "detector.rpn.search": 2.0,
            "detector.rpn.bin": 0.2,
            "detector.voxel_size": [0.4, 0.4, 0.4],
            **config,
        },
        stages=("warmup", key),
        first_own_step=100,
        detector="VoxelNet",
        group="VoxelNet",
        level=f"{gamma:g}",
        seed=0,
    )


PLAN = FrozenPlan(
    factor=("loss.gamma",),
    baseline="0",
    trials=(frozen("focal-0", 0.0), frozen("focal-2", 2.0, mixed=None)),
    earlier=("old",),
)


def test_a_plan_that_grows_is_read_whole_and_written_once(tmp_path: Path) -> None:
    """What it gains are lines beside it, of what a trial has of its own."""
    path = tmp_path / "plans" / "gamma.json"
    file = PlanFile(path)
    file.write(PLAN)
    before = path.read_bytes()
    grown = PLAN
    for gamma in (3.0, 4.0, 5.0):
        grown = replace(grown, trials=(*grown.trials, frozen(f"focal-{gamma:g}", gamma, mixed=1)))
        file.write(grown)
        assert read_plan(path) == grown
    file.write(grown)
    assert path.read_bytes() == before
    lines = grown_file(path).read_text().splitlines()
    assert [json.loads(line)["trial"]["key"] for line in lines] == ["focal-3", "focal-4", "focal-5"]
    assert json.loads(lines[0])["trial"]["config"] == {"loss.gamma": 3.0, "mixed": 1}
    assert read_plan(path).stages == {*PLAN.stages, "focal-3", "focal-4", "focal-5"}


@pytest.mark.parametrize("ending", ["", '{"of": "', '{"of": "x", "trial": {}}'])
def test_a_last_line_that_is_torn_is_passed_over(ending: str, tmp_path: Path) -> None:
    path = tmp_path / "gamma.json"
    file = PlanFile(path)
    file.write(PLAN)
    grown = replace(PLAN, trials=(*PLAN.trials, frozen("focal-3", 3.0)))
    file.write(grown)
    with grown_file(path).open("a") as lines:
        lines.write(ending)
    assert read_plan(path) == grown


def test_a_plan_is_written_anew_where_more_than_trials_has_changed(tmp_path: Path) -> None:
    """Another baseline; a trial without a key that all had; the next start: lines of before are nobody's."""
    path = tmp_path / "gamma.json"
    file = PlanFile(path)
    file.write(PLAN)
    third = frozen("focal-3", 3.0)
    file.write(replace(PLAN, trials=(*PLAN.trials, third)))
    other = replace(PLAN, trials=(*PLAN.trials, third), baseline="2")
    file.write(other)
    assert read_plan(path) == other
    assert not grown_file(path).exists()
    short = replace(third, key="focal-4", config={"loss.gamma": 4.0})
    fewer = replace(other, trials=(*other.trials, short))
    file.write(fewer)
    assert read_plan(path) == fewer
    file.write(replace(fewer, trials=(*fewer.trials, replace(short, key="focal-5"))))
    lines = grown_file(path).read_text()
    PlanFile(path).write(PLAN)
    grown_file(path).write_text(lines)  # as a kill between the plan and its lines would leave it
    assert read_plan(path) == PLAN


def test_a_damaged_line_before_the_last_is_no_plan(tmp_path: Path) -> None:
    path = tmp_path / "gamma.json"
    file = PlanFile(path)
    file.write(PLAN)
    file.write(replace(PLAN, trials=(*PLAN.trials, frozen("focal-3", 3.0))))
    grown_file(path).write_text("{\n" + grown_file(path).read_text())
    with pytest.raises(StoreError, match="is not a sweep's plan"):
        read_plan(path)


def test_a_plan_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = tmp_path / "plans" / "gamma.json"
    write_plan(path, PLAN)
    assert read_plan(path) == PLAN


def test_a_key_that_one_trial_lacks_is_not_shared(tmp_path: Path) -> None:
    """Though the others' value is null, as a missing key's would be."""
    path = tmp_path / "gamma.json"
    write_plan(path, PLAN)
    first, second = read_plan(path).trials
    assert "mixed" not in first.config
    assert second.config["mixed"] is None


def test_what_all_trials_share_is_written_once(tmp_path: Path) -> None:
    path = tmp_path / "gamma.json"
    write_plan(path, PLAN)
    content = json.loads(path.read_text())
    assert content["config"]["loss.alpha"] == 1
    assert [trial["config"] for trial in content["trials"]] == [
        {"loss.gamma": 0.0},
        {"loss.gamma": 2.0, "mixed": None},
    ]


def test_equal_plans_are_equal_files(tmp_path: Path) -> None:
    """Whatever the order in which earlier stages were remembered: published plans are diffed."""
    for name, earlier in (("a", ("x", "y")), ("b", ("y", "x"))):
        write_plan(tmp_path / name, replace(PLAN, earlier=earlier))
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_a_plan_without_trials_is_one(tmp_path: Path) -> None:
    empty = FrozenPlan(factor=(), baseline="default", trials=())
    write_plan(tmp_path / "empty.json", empty)
    assert read_plan(tmp_path / "empty.json") == empty


def test_a_plan_of_another_version_is_refused_by_name(tmp_path: Path) -> None:
    path = tmp_path / "gamma.json"
    write_plan(path, PLAN)
    content = json.loads(path.read_text())
    for version in (VERSION + 1, None):
        path.write_text(json.dumps({**content, "version": version}))
        with pytest.raises(StoreError, match=r"gamma\.json: written by another version of fl3d"):
            read_plan(path)


def test_a_plan_that_is_not_there_says_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"gamma\.json: no such file; run the sweep first"):
        read_plan(tmp_path / "gamma.json")


@pytest.mark.parametrize(
    "text",
    [
        "",
        '{"version": ',
        "[]",
        json.dumps({"version": VERSION}),
        json.dumps({"version": VERSION, "factor": [], "baseline": "0", "trials": [{}]}),
        json.dumps(
            {
                "version": VERSION,
                "factor": [],
                "baseline": "0",
                "trials": [{"key": "a", "overrides": [], "stages": [], "config": {}}],
                "config": {},
                "earlier": [],
            }
        ),
    ],
)
def test_a_torn_plan_is_named(tmp_path: Path, text: str) -> None:
    path = tmp_path / "gamma.json"
    path.write_text(text)
    with pytest.raises(StoreError, match=r"gamma\.json: is not a sweep's plan"):
        read_plan(path)


def test_a_trial_is_frozen_with_what_can_change_a_result() -> None:
    trial = Trial(
        key="focal-0",
        overrides=("loss.gamma=0",),
        values={"loss.gamma": 0},
        config={"loss": {"gamma": 0}, "device": "cuda"},
        stages=("warmup", "focal-0"),
        first_own_step=100,
        detector="VoxelNet",
        group="VoxelNet",
        level="0",
        seed=3,
    )
    one = freeze(trial, {"loss.gamma": 0})
    assert one.config == {"loss.gamma": 0}
    assert (one.key, one.stages, one.level, one.seed) == ("focal-0", trial.stages, "0", 3)


def test_a_value_of_a_trial_is_found_by_its_key_or_its_section() -> None:
    trial = PLAN.trials[1]
    assert trial.value("loss.gamma") == 2.0
    assert trial.value("augment") is None
    assert trial.value("augment", "default") is None
    assert trial.value("detector.rpn") == {"search": 2.0, "bin": 0.2}
    assert trial.value("detector.rcnn") is None
    assert trial.value("detector.rcnn", "default") == "default"
    assert trial.value("loss.gam", "default") == "default"  # no key by half its name


def test_a_plan_names_all_its_stages(tmp_path: Path) -> None:
    assert PLAN.stages == {"warmup", "focal-0", "focal-2", "old"}
    layout = StoreFolder(tmp_path)
    assert named_stages(layout) == set()
    write_plan(layout.plan("one"), PLAN)
    write_plan(layout.plan("other"), replace(PLAN, trials=(), earlier=("older",)))
    assert named_stages(layout) == PLAN.stages | {"older"}
