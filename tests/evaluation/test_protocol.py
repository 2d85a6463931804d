"""Protocols are known by an id that stays, whatever keys come later."""

import pytest

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.evaluation.protocol import Protocol

# Of published scores: they are found by these.
IDS = {
    "paper": "paper-556e6ed6",
    "paper_strict": "paper_strict-ed6e3107",
    "kitti": "kitti-4b836a6d",
    "kitti_loose": "kitti_loose-28a62cdc",
    "report": "report-2374823a",
}


def protocol(name: str, *words: str) -> Protocol:
    return Protocol(**compose_config([f"protocol={name}", "profile=paper", *words])["protocol"])


@pytest.mark.parametrize("name", IDS)
def test_ids_of_published_scores_stay(name: str) -> None:
    assert protocol(name).id == IDS[name]


def test_other_levels_are_another_protocol() -> None:
    words = ((), ("protocol.difficulty=none",), ("protocol.difficulty=points",))
    further = ("protocol.limits=[10,20,30]",)
    ids = {protocol("lidar", *word).id for word in (*words, further)}
    assert len(ids | set(IDS.values())) == 4 + len(IDS)


def test_default_limits_are_the_same_protocol_as_naming_them() -> None:
    assert protocol("lidar").id == protocol("lidar", "protocol.limits=[30,50,70]").id
    assert protocol("lidar").level_limits == (30, 50, 70)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["protocol.difficulty=far"], "protocol.difficulty: no choice 'far'"),
        (["protocol.limits=[30,50]"], r"protocol.limits: \[30, 50\] are not three rising"),
        (["protocol.limits=[50,30,70]"], "not three rising"),
        (["protocol.limits=[1,b,3]"], "not three rising"),
        (["protocol.limits=30"], "not three rising"),
        (["protocol.difficulty=points", "protocol.limits=[1,2,3]"], "not three falling"),
        (["protocol.difficulty=none", "protocol.limits=[1,2,3]"], "difficulty none has none"),
    ],
)
def test_levels_that_cannot_be_are_named(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        protocol("lidar", *words)
