"""Classes in identities and plans: cars stay what they were, other classes are another training."""

from pathlib import Path

import pytest

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.core.nested import leaves
from fl3d.core.records import Config
from fl3d.sweep.identity import result_config
from fl3d.sweep.setup import freeze
from tests.support import small_sweep

GAMMA = [["loss.gamma=0"], ["loss.gamma=2"]]


def kept(*words: str) -> Config:
    return dict(leaves(result_config(compose_config([*words, "profile=quick"]))))


def test_cars_have_no_class_in_their_identity() -> None:
    """So that what was trained and published before there were classes is what it was."""
    for detector in ("voxelnet", "fcn3d", "fconvnet", "pointrcnn"):
        names = kept(f"detector={detector}")
        assert "classes" not in names
        assert not [name for name in names if name.startswith("detector.per_class")]
        assert names == kept(f"detector={detector}", "classes=[Car]")
    assert kept("detector=voxelnet")["detector.targets.classes"] == ["Car"]


def test_other_classes_are_another_training_with_their_own_settings_alone() -> None:
    names = kept("detector=voxelnet", "classes=[Pedestrian]")
    assert names["classes"] == ["Pedestrian"]
    assert names["detector.targets.classes"] == ["Pedestrian"]
    assert names["detector.per_class.Pedestrian.anchors.size"] == [1.73, 0.6, 0.8]
    assert not [name for name in names if "Cyclist" in name]
    word = "detector.per_class.Cyclist.anchors.positive=0.4"
    assert names == kept("detector=voxelnet", "classes=[Pedestrian]", word)
    assert kept("detector=voxelnet", "classes=[Car,Pedestrian]") != kept(
        "detector=voxelnet", "classes=[Pedestrian,Car]"
    )


def test_all_trials_of_a_sweep_share_their_classes(simulated: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"classes: all trials of a sweep must share it"):
        small_sweep(simulated, tmp_path, [["classes=[Pedestrian]"], ["classes=[Cyclist]"]])


def test_a_name_is_of_one_list_of_classes(simulated: Path, tmp_path: Path) -> None:
    cars = small_sweep(simulated, tmp_path, GAMMA, "sweep.name=mine")
    freeze(cars, cars.plan)
    small_sweep(simulated, tmp_path, GAMMA, "sweep.name=mine")
    with pytest.raises(ConfigError, match=r"classes \['Car'\]; .*sweep\.name=mine_pedestrian"):
        small_sweep(simulated, tmp_path, GAMMA, "sweep.name=mine", "classes=[Pedestrian]")
    small_sweep(simulated, tmp_path, GAMMA, "sweep.name=people", "classes=[Pedestrian]")


def test_a_detector_is_named_by_its_plain_yaml() -> None:
    from fl3d.config.detector_names import spell_out_detectors

    assert spell_out_detectors(["detector=VoxelNet"]) == ["detector=voxelnet"]
