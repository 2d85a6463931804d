"""Values that cannot be, and keys that nothing reads, are refused by name before anything starts."""

import copy
from collections.abc import Iterator, Mapping
from typing import Any

import pytest

from fl3d.config.compose import compose_config, multirun
from fl3d.config.objects import build
from fl3d.config.rules import BY_CLASS, RULES
from fl3d.config.values import check_values
from fl3d.core.errors import ConfigError
from fl3d.core.records import Config
from fl3d.evaluation.protocol import Protocol
from fl3d.inference.load import build_detector
from fl3d.sweep.detectors import planned
from fl3d.sweep.sweepers.grid import grid

NAN, INF = float("nan"), float("inf")
WRONG = (NAN, INF, -1, "abc", True, [])  # of any number but an offset or an angle
FREE = ("sweep.baseline", "data.image_size")  # the second is read, and refused, where it is used


def config_of(detector: str) -> Config:
    return compose_config([f"detector={detector}", "profile=quick"])


@pytest.fixture(scope="module")
def usual() -> Config:
    return config_of("voxelnet")


def numbers(node: Mapping[str, Any], prefix: str = "") -> Iterator[str]:
    """Dotted keys of a config's numbers."""
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from numbers(value, f"{prefix}{key}.")
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield f"{prefix}{key}"


def changed(config: Config, key: str, value: object) -> Config:
    made = copy.deepcopy(config)
    node = made
    *parents, last = key.split(".")
    for part in parents:
        node = node[part]
    node[last] = value
    return made


def check(config: Config) -> None:
    """All that is checked of a trial's values before anything starts."""
    check_values(config, config)
    Protocol(**config["protocol"])
    planned(config).check()


@pytest.mark.parametrize("section", ["schedule", "data", "store", "detections", "sweep", "seed"])
def test_no_number_of_the_config_may_be_another_thing(usual: Config, section: str) -> None:
    part = usual[section]
    keys = [f"{section}.{key}" for key in numbers(part)] if isinstance(part, Mapping) else [section]
    keys = [key for key in keys if ".set.loss." not in key]  # the class's own
    assert keys
    for key in keys:
        for value in WRONG:
            with pytest.raises(
                ConfigError, match=rf"^{key}: '?(nan|inf|-1|abc|true|\[\])'? is not"
            ):
                check_values(changed(usual, key, value), {})


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("data.people", 0, "'0' is not a number above 0 and at most 3, or null"),
        ("data.people", 3.5, "'3.5' is not a number above 0 and at most 3"),
        ("seed", None, "'null' is not a whole number of at least 0"),
        ("seed", 1.5, "'1.5' is not a whole number"),
        ("seed", 2**63, "and at most 9223372036854775807"),
        ("schedule.batch_size", 0, "'0' is not a whole number of at least 1"),
        ("schedule.epochs.focal", 0, "whole number of at least 1"),
        ("schedule.stages.focal.epochs", 0, "whole number of at least 1"),
        ("schedule.stages.focal.lr_factor", 0, "number above 0"),
        ("schedule.stages.warmup.set.schedule", {"batch_size": 0}, "whole number of at least 1"),
        ("schedule.clip", 0, "number above 0, or null"),
        ("schedule.decay", 3, "a section of keys, or null"),
        ("detections.min_score", 1.5, "number from 0 to 1"),
        ("compile", "yes", "'yes' is not true or false"),
        ("results", "", "'' is not a text"),
        ("store.root", None, "'null' is not a text"),
        ("sweep.factor", 3, "a key such as loss.gamma"),
        ("sweep.margin", NAN, "'nan' is not a number of AP above 0"),
        ("sweep.tables", "focal_loss.loss_forms", "a list of texts"),
        ("data.train_frames", 0, "whole number of at least 1, or null"),
        ("optimizer.lr", 0, "'0' is not a number above 0"),
        ("optimizer.lr", "abc", "'abc' is not a number above 0"),
        ("device", "gpu", "'gpu' is not cpu, cuda or cuda:N"),
        ("data.crop", "picture", "'picture' is not one of image, none"),
        ("loss.gamma", NAN, "nan is not a finite number"),
        ("detector.range_velo", [0, INF, 0, 1, 1, 1], "inf is not a finite number"),
        ("schedule", None, "'null', but it is a section of keys"),
    ],
)
def test_a_value_that_cannot_be_is_refused_by_name(
    usual: Config, key: str, value: object, says: str
) -> None:
    with pytest.raises(ConfigError, match=says) as raised:
        check_values(changed(usual, key, value), {})
    assert str(raised.value).startswith(key)


def test_every_key_of_the_configs_has_a_rule(usual: Config) -> None:
    """Whoever adds one says what it may be; a detector's own are checked by its class."""
    for detector in ("voxelnet", "pointrcnn", "fconvnet"):
        config = config_of(detector)
        check_values(config, {})  # nothing is read but what has a rule
    own = {key.partition(".")[0] for key in RULES} | set(BY_CLASS)
    assert own == {*usual}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("overlaps", {"Car": [0.7, 0.7]}),
        ("overlaps", {"Car": [0.7, 0.7, 7]}),
        ("ignore_beyond", [1, 2, "a", 4]),
        ("ignore_beyond", 3),
        ("score_threshold", True),
        ("score_threshold", NAN),
        ("nms_iou", -1),
        ("max_detections", True),
        ("variant", None),
    ],
)
def test_a_protocol_says_which_of_its_keys_cannot_be(
    usual: Config, key: str, value: object
) -> None:
    with pytest.raises(ConfigError, match=f"^protocol.{key}"):
        Protocol(**{**usual["protocol"], key: value})


@pytest.mark.parametrize(
    ("detector", "key", "value", "says"),
    [
        ("voxelnet", "detector.max_points", 0, "detector.max_points: '0' is not a whole number of"),
        ("voxelnet", "detector.max_points", None, "detector.max_points: 'null' is not a whole"),
        ("voxelnet", "detector.voxel_size", [0.4, 0, 0.8], "detector.voxel_size: .* each a number"),
        ("voxelnet", "detector.rpn", [16, 32], "detector.rpn: .* a list of 3, each a whole number"),
        ("voxelnet", "detector.mask_max", 3, "detector.mask_max: '3' is not true or false"),
        ("voxelnet", "detector.anchors.positive", 1.5, "detector.anchors.positive: '1.5' is not"),
        (
            "voxelnet",
            "detector.anchors",
            {"siz": 1},
            "detector.anchors: no key 'siz'. Did you mean",
        ),
        ("voxelnet", "detector.targets.min_points", "abc", "detector.targets.min_points: 'abc'"),
        ("voxelnet", "detector.targets.classes", "Car", "detector.targets.classes: 'Car' is not a"),
        ("voxelnet", "loss.gamma", None, "loss.gamma: 'null' is not"),
        (
            "voxelnet",
            "loss.regression_weight",
            -1,
            "loss.regression_weight: '-1' is not a number of",
        ),
        (
            "voxelnet",
            "detector.range_velo",
            [1, 2],
            "detector: .*VoxelNet: ValueError: .*voxels.py:",
        ),
        ("fcn3d", "detector.max_length", 0, "detector.max_length: '0' is not a number above 0"),
        ("pointrcnn", "detector.rcnn.rois.tries", -1, "detector.rcnn.rois.tries: '-1' is not"),
        (
            "pointrcnn",
            "detector.train.iou",
            2,
            "detector.train.iou: '2' is not a number from 0 to 1",
        ),
        ("pointrcnn", "augment.flip", 2, "augment.flip: '2' is not a number from 0 to 1"),
        ("pointrcnn", "augment.objects.gap", "wide", "augment.objects.gap: 'wide' is not a number"),
        ("fconvnet", "detector.points", 1.5, "detector.points: '1.5' is not a whole number"),
        ("fconvnet", "detector.weights.yaw", "abc", "detector.weights: .* is not"),
        (
            "fconvnet",
            "detector.jitter.flip",
            -1,
            "detector.jitter.flip: '-1' is not a number from 0",
        ),
    ],
)
def test_a_class_says_by_its_types_what_it_takes(
    detector: str, key: str, value: object, says: str
) -> None:
    config = changed(config_of(detector), key, value)
    with pytest.raises(ConfigError, match=says):
        check(config)


def test_an_argument_that_a_class_does_not_take_is_told_with_those_that_it_takes(
    usual: Config,
) -> None:
    with pytest.raises(
        ConfigError, match=r"loss: .*'gama'. Did you mean 'gamma'\? Possible: alpha"
    ):
        build_detector(changed(usual, "loss.gama", 1))


class Fussy:
    """Of a user's own, whose types are not all known."""

    def __init__(self, size: "Unknown", name: str = "a") -> None:  # type: ignore[name-defined] # noqa: F821
        if size != 3:
            raise ValueError(f"size {size} will not do")
        self.size = size


def test_a_class_that_raises_ends_in_a_sentence_with_the_line() -> None:
    target = f"{__name__}.Fussy"
    assert build({"_target_": target, "size": 3}, "loss").size == 3
    with pytest.raises(
        ConfigError, match=r"loss: .*Fussy: ValueError: size 2 .*test_values.py:\d+"
    ):
        build({"_target_": target, "size": 2}, "loss")


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["+foo=1"], "foo: no key that anything reads. Possible: augment"),
        (["+los=1"], "los: no key that anything reads. Did you mean 'loss'?"),
        (["+data.rot=1"], "data.rot: no key that anything reads. Did you mean 'root'?"),
        (["+sweep.factr=seed"], "Did you mean 'factor'?"),
        (["+protocol.nms=1"], "protocol.nms: no key that anything reads. Did you mean 'nms_iou'"),
        (["+schedule.stages.focal.epoch=3"], "Did you mean 'epochs'?"),
        (["+schedule.stages.focal.set.los.gamma=3"], "set.los.gamma: .* Did you mean 'loss'?"),
        (["++detections.max_box=3"], "Did you mean 'max_boxes'?"),
        (["~schedule.clip"], "schedule.clip: is not there"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_a_key_that_nothing_reads_is_refused_with_its_neighbours(
    words: list[str], says: str
) -> None:
    with pytest.raises(ConfigError, match=says.replace("?", r"\?")):
        compose_config(words)


def test_a_key_that_another_reads_may_be_added() -> None:
    """By an interpolation, or by a place in a command's text."""
    assert compose_config(["+mine.g=3", "loss.gamma=${mine.g}"])["loss"]["gamma"] == 3
    read = multirun(["+foo=2,3", "loss.gamma=${foo}"])
    points = grid({}, read.arguments, read.compose).first()
    assert [point.config["loss"]["gamma"] for point in points] == [2, 3]
    run = ["detector=command", "detector.run='train --depth {net.depth} --lr {optimizer.lr}'"]
    assert compose_config([*run, "+net.depth=3"])["net"] == {"depth": 3}
    with pytest.raises(ConfigError, match=r"net\.width: no key that anything reads"):
        compose_config([*run, "+net.width=3"])


@pytest.mark.parametrize(
    ("word", "says"),
    [
        ("hydra.launcher.slots=-1", "slots: '-1' is not a whole number of at least 1, or null"),
        ("hydra.launcher.slots=0", "slots: '0' is not"),
        ("hydra.launcher.slots=1.5", "slots: '1.5' is not"),
        ("hydra.launcher.slots=abc", "slots: 'abc' is not"),
        ("hydra.launcher.per_card=-1", "per_card: '-1' is not a whole number of at least 1"),
        ("hydra.launcher.device=3", "device: '3' is not a text"),
        ("hydra/launcher=slurm hydra.launcher.minutes=0", "minutes: '0' is not"),
        ("hydra/launcher=ray hydra.launcher.gpus=nan", "gpus: 'nan' is not a number of at least 0"),
    ],
)
def test_a_launcher_without_a_slot_is_refused(word: str, says: str) -> None:
    with pytest.raises(ConfigError, match=f"hydra.launcher.{says}"):
        multirun(word.split())
