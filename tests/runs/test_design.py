"""What a sweep compares: factor, levels, groups and baseline, from what is swept."""

from dataclasses import replace
from typing import Any

import pytest

from fl3d.config.settings import SweepSettings
from fl3d.core.errors import ConfigError
from fl3d.core.records import Trial
from fl3d.runs.design import (
    Design,
    baseline_level,
    in_order,
    label_of,
    level_text,
    make_design,
    refuse_lone_level,
    refuse_twins,
    short_names,
)

ALPHA_1 = "schedule.stages.warmup.set.loss.alpha"
ALPHA_2 = "schedule.stages.focal.set.loss.alpha"


def asked(
    factor: tuple[str, ...] = (), groups: tuple[str, ...] | None = None, baseline: Any = None
) -> SweepSettings:
    return SweepSettings(
        name="test",
        question=None,
        factor=factor,
        baseline=baseline,
        groups=groups,
        primary="3d_r40/moderate",
        margin=1.0,
        tables=(),
        after=None,
        winner=None,
    )


@pytest.mark.parametrize(
    ("swept", "factor", "groups"),
    [
        (["loss.gamma"], ("loss.gamma",), ()),
        (["detector", "loss.gamma", "seed"], ("loss.gamma",), ("detector",)),
        (["loss.alpha", "loss.beta"], ("loss.alpha", "loss.beta"), ()),
        (["detector"], ("detector",), ()),
        (["detector", "seed"], ("detector",), ()),
        (["seed"], (), ()),
        ([], (), ()),
    ],
)
def test_compared_is_what_is_swept_but_detector_and_seed(
    swept: list[str], factor: tuple[str, ...], groups: tuple[str, ...]
) -> None:
    """A sweep over detectors alone compares them."""
    assert make_design(swept, asked()) == Design(factor, groups)


@pytest.mark.parametrize(
    ("swept", "settings", "expected"),
    [
        (
            ["detector", "loss.gamma", "optimizer.lr"],
            asked(factor=("loss.gamma",)),
            Design(("loss.gamma",), ("detector", "optimizer.lr")),
        ),
        (
            ["detector", "loss.gamma", "optimizer.lr"],
            asked(groups=("optimizer.lr",)),
            Design(("detector", "loss.gamma"), ("optimizer.lr",)),
        ),
        (
            ["loss.gamma"],
            asked(factor=("loss.gamma",), groups=("optimizer.lr",)),
            Design(("loss.gamma",), ("optimizer.lr",)),
        ),
        (
            ["detector", "loss.gamma"],
            asked(factor=("detector",)),
            Design(("detector",), ("loss.gamma",)),
        ),
        (["detector", "loss.gamma"], asked(groups=()), Design(("detector", "loss.gamma"), ())),
    ],
)
def test_a_user_may_name_factor_and_groups(
    swept: list[str], settings: SweepSettings, expected: Design
) -> None:
    assert make_design(swept, settings) == expected


@pytest.mark.parametrize(
    ("value", "label"),
    [
        (0, "0"),
        (0.5, "0.5"),
        (1.0, "1"),
        (1e-4, "0.0001"),
        (100000.0, "100000"),
        (1234567.0, "1234567.0"),
        (0.30000000000000004, "0.30000000000000004"),
        ("two_phase", "two_phase"),
        ("", ""),
        (None, "null"),
        (True, "true"),
        (False, "false"),
        ([0.4, 0.4], "[0.4, 0.4]"),
        ((1, [2.0, None]), "[1, [2, null]]"),
        ({"search": 3.0, "bin": 0.5}, "search=3 bin=0.5"),
    ],
)
def test_a_value_is_told_as_people_write_it(value: object, label: str) -> None:
    assert label_of(value) == label


def test_values_that_differ_have_labels_that_differ() -> None:
    """Though six digits would not tell them apart."""
    assert label_of(0.1234567) != label_of(0.12345678)


def test_equal_values_have_one_label() -> None:
    assert label_of(1) == label_of(1.0)
    assert label_of([1, 2.0]) == label_of([1.0, 2])


@pytest.mark.parametrize(
    ("keys", "names"),
    [
        (["loss.gamma"], ["gamma"]),
        (["loss.gamma", "loss.alpha"], ["gamma", "alpha"]),
        ([ALPHA_1, ALPHA_2], ["warmup.set.loss.alpha", "focal.set.loss.alpha"]),
        (["a.x", "b.x", "b.y"], ["a.x", "b.x", "y"]),
        (["x", "a.x"], ["x", "a.x"]),
        ([], []),
    ],
)
def test_a_key_is_called_by_as_few_parts_as_tell_it_from_the_others(
    keys: list[str], names: list[str]
) -> None:
    assert short_names(keys) == dict(zip(keys, names, strict=True))


def test_a_level_is_the_factors_value_and_a_group_begins_with_the_detector() -> None:
    design = make_design(["detector", "loss.gamma", "seed"], asked())
    values = {"detector": "voxelnet", "loss.gamma": 0.5, "seed": 3}
    assert design.level(values, {}, "VoxelNet") == "0.5"
    assert design.group(values, {}, "VoxelNet") == "VoxelNet"
    assert design.factor_name == "gamma"


def test_a_level_of_several_keys_names_each() -> None:
    design = make_design(["loss.alpha", "loss.beta"], asked())
    values = {"loss.beta": 5, "loss.alpha": 0.5}
    assert design.level(values, {}, "VoxelNet") == "alpha=0.5, beta=5"
    assert design.factor_name == "alpha, beta"


def test_groups_are_told_by_their_values() -> None:
    design = make_design(["detector", "loss.gamma", "optimizer.lr"], asked(("loss.gamma",)))
    values = {"detector": "voxelnet", "loss.gamma": 0.5, "optimizer.lr": 0.01}
    assert design.group(values, {}, "VoxelNet") == "VoxelNet, lr=0.01"


def test_detectors_that_are_compared_are_levels() -> None:
    design = make_design(["detector"], asked())
    assert design.level({"detector": "fcn3d"}, {}, "3D-FCN") == "3D-FCN"
    assert design.group({"detector": "fcn3d"}, {}, "3D-FCN") == "all"


def test_a_sweep_that_compares_nothing_has_one_level() -> None:
    design = make_design(["seed"], asked())
    assert design.level({"seed": 1}, {}, "VoxelNet") == "default"
    assert design.group({"seed": 1}, {}, "VoxelNet") == "VoxelNet"


def test_a_key_that_is_not_swept_is_read_from_the_config() -> None:
    """As of a sweep with one γ, that later ones will be compared with."""
    design = make_design([], asked(factor=("loss.gamma",)))
    assert design.level({}, {"loss": {"gamma": 2.0}}, "VoxelNet") == "2"
    mapping = {"detector": {"rpn": {"search": 3.0, "bin": 0.5}}}
    section = make_design([], asked(factor=("detector.rpn",)))
    assert section.level({}, mapping, "PointRCNN") == "search=3 bin=0.5"


@pytest.mark.parametrize("key", ["loss.gama", "los", "loss.gamma.more"])
def test_a_key_that_is_nowhere_is_refused(key: str) -> None:
    values = {"loss.alpha": 1}
    config = {"loss": {"gamma": 2.0, "alpha": 1}}
    with pytest.raises(ConfigError, match=rf"no key '{key}'.*Possible: loss.alpha"):
        make_design(values, asked(factor=(key,))).level(values, config, "VoxelNet")
    with pytest.raises(ConfigError, match=rf"no key '{key}'"):
        make_design(values, asked(groups=(key,))).group(values, config, "VoxelNet")


@pytest.mark.parametrize(
    ("factor", "baseline", "level"),
    [
        (("loss.gamma",), None, "0.5"),
        (("loss.gamma",), 0, "0"),
        (("loss.gamma",), 0.0, "0"),
        (("loss.gamma",), "0", "0"),
    ],
)
def test_the_baseline_is_the_first_level_or_the_one_that_is_named(
    factor: tuple[str, ...], baseline: object, level: str
) -> None:
    assert baseline_level(["0.5", "0", "2"], factor, baseline) == level


@pytest.mark.parametrize(
    "baseline",
    [
        "alpha=1, beta=5",
        {"loss.alpha": 1, "loss.beta": 5},
        {"beta": 5.0, "alpha": 1.0},
        [1, 5],
    ],
)
def test_the_baseline_of_several_keys_may_be_named_in_several_ways(baseline: object) -> None:
    levels = ["alpha=0.5, beta=5", "alpha=1, beta=5"]
    assert baseline_level(levels, ("loss.alpha", "loss.beta"), baseline) == levels[1]


def test_a_baseline_of_a_mapping_is_a_value_of_the_one_key() -> None:
    levels = ["search=3 bin=0.5", "search=2 bin=0.2"]
    assert baseline_level(levels, ("detector.rpn",), {"search": 2.0, "bin": 0.2}) == levels[1]


@pytest.mark.parametrize(
    ("factor", "baseline"),
    [
        (("loss.gamma",), 3),
        (("loss.gamma",), {"gamma": 0}),
        (("loss.alpha", "loss.beta"), [1]),
        (("loss.alpha", "loss.beta"), {"loss.alpha": 1}),
    ],
)
def test_a_baseline_that_no_trial_has_is_answered_with_the_levels(
    factor: tuple[str, ...], baseline: object
) -> None:
    with pytest.raises(ConfigError, match=r"sweep.baseline: no level .*Possible: 0, 2\."):
        baseline_level(["0", "2"], factor, baseline)


@pytest.mark.parametrize(
    ("baseline", "message"),
    [
        (
            [1, 5, 9],
            r"\[1, 5, 9\] has 3 values, and the sweep compares 2 keys, loss.alpha, loss.beta",
        ),
        (
            {"alpha": 1, "beta": 5, "gamma": 2},
            "'gamma' is no key that the sweep compares.*loss.beta",
        ),
    ],
)
def test_a_baseline_with_a_value_too_many_is_refused_and_not_cut(
    baseline: object, message: str
) -> None:
    levels = ["alpha=0.5, beta=5", "alpha=1, beta=5"]
    with pytest.raises(ConfigError, match=f"sweep.baseline: {message}"):
        baseline_level(levels, ("loss.alpha", "loss.beta"), baseline)


def trial(key: str, **values: Any) -> Trial:
    named = {name.replace("_", "."): value for name, value in values.items()}
    return Trial(
        key=key,
        overrides=tuple(f"{name}={value}" for name, value in named.items()),
        values=named,
        config={},
        stages=(key,),
        first_own_step=0,
        detector="VoxelNet",
        group="VoxelNet",
        level=label_of(named.get("loss.gamma", "default")),
        seed=named.get("seed", 0),
    )


def test_trials_that_the_design_does_not_tell_apart_are_refused_with_what_they_differ_in() -> None:
    twins = [trial("a", loss_gamma=0, loss_alpha=1), trial("b", loss_gamma=0, loss_alpha=2)]
    with pytest.raises(ConfigError) as caught:
        refuse_twins(twins)
    assert str(caught.value) == (
        "'loss.gamma=0 loss.alpha=1' and 'loss.gamma=0 loss.alpha=2' would both be "
        "VoxelNet 0 seed 0: they differ in loss.alpha. Name these keys in sweep.factor "
        "(they are compared) or in sweep.groups (a table each)"
    )


def test_a_factor_of_one_level_where_other_keys_vary_is_refused_with_these_keys() -> None:
    """Two groups of one level each have nothing to be held against."""
    two = [
        trial(str(number), loss_gamma=gamma, seed=seed)
        for number, (gamma, seed) in enumerate([(0, 0), (0, 1), (2, 0), (2, 1)])
    ]
    split = [replace(one, group=f"gamma={one.values['loss.gamma']}", level="1") for one in two]
    message = r"^sweep\.factor: loss\.alpha has one level here \(1\).*Swept: loss\.gamma\. Name one"
    with pytest.raises(ConfigError, match=message):
        refuse_lone_level(["loss.alpha"], split)
    refuse_lone_level([], split)  # nobody asked for a factor
    refuse_lone_level(["loss.alpha"], split[:2])  # replicates alone
    refuse_lone_level(["loss.alpha"], [*split, replace(split[0], level="2")])


def test_a_key_that_one_twin_alone_sets_is_named_too() -> None:
    twins = [trial("a", loss_gamma=0), trial("b", loss_gamma=0, optimizer_lr=0.1)]
    with pytest.raises(ConfigError, match=r"they differ in optimizer.lr\."):
        refuse_twins(twins)


def test_replicates_levels_and_groups_are_no_twins() -> None:
    trials = [
        trial("a", loss_gamma=0, seed=0),
        trial("b", loss_gamma=0, seed=1),
        trial("c", loss_gamma=2, seed=0),
        trial("a", loss_gamma=0, seed=0),  # the same trial twice is one
    ]
    refuse_twins(trials)


def test_levels_are_ordered_by_number_where_all_are_numbers() -> None:
    assert in_order(["10", "0.5", "2", "0.5"]) == ["0.5", "2", "10"]
    assert in_order(["b", "a", "2", "b"]) == ["b", "a", "2"]


def test_outside_its_table_a_level_is_told_with_its_factor() -> None:
    assert level_text(("loss.gamma",), "0.5") == "gamma=0.5"
    assert level_text(("loss.alpha", "loss.beta"), "alpha=1, beta=5") == "alpha=1, beta=5"
    assert level_text((), "default") == "default"
