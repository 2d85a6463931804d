"""The one way to build a detector and to open a checkpoint."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from typing import Any

from fl3d.config.modules import make_importable
from fl3d.config.objects import build, locate
from fl3d.core.errors import CheckpointError, ConfigError
from fl3d.core.records import Config
from fl3d.data.classes import CARS
from fl3d.data.dataset import TargetRule
from fl3d.detectors.base import Detector
from fl3d.inference.reproducibility import prepare
from fl3d.runs.checkpoints import load_state, read_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec


def build_detector(config: Config) -> Detector:
    """The network of a stage, with fresh weights from torch's generator.

    Raises:
        ConfigError: the config's ``detector`` or ``loss`` cannot be built, or is no detector.
    """
    if not config.get("loss"):
        raise ConfigError(
            "loss: none is given; the detector's YAML must have one, such as "
            "loss: {_target_: fl3d.losses.DetectionLoss, gamma: 0.0}"
        )
    loss = build(config["loss"], "loss")
    classes = tuple(config.get("classes", CARS))
    detector = build(config["detector"], "detector", loss=loss, **_classes(config, classes))
    if not isinstance(detector, Detector):
        target = config["detector"]["_target_"]
        raise ConfigError(f"detector._target_: {target} is not a Detector (fl3d.detectors.base)")
    detector.classes = classes
    targets = getattr(detector, "targets", None)
    if isinstance(targets, TargetRule):
        targets.check(classes)
    return detector


def _classes(config: Config, classes: tuple[str, ...]) -> dict[str, Any]:
    """The argument ``classes`` of a detector that takes it.

    Raises:
        ConfigError: it detects fewer.
    """
    section = config["detector"]
    if not isinstance(section, Mapping) or not isinstance(section.get("_target_"), str):
        return {}  # refused by ``build``
    kind = locate(section["_target_"], "detector._target_")
    most = getattr(kind, "MOST_CLASSES", None)
    if most is not None and len(classes) > most:
        raise ConfigError(
            f"classes: {getattr(kind, 'NAME', kind.__name__)} is a network of one class; give one of "
            f"{' or '.join(f'classes=[{name}]' for name in classes)}, or a detector of several, such as "
            "detector=voxelnet, fcn3d or fconvnet"
        )
    return {"classes": classes} if "classes" in inspect.signature(kind).parameters else {}


def load(folder: RunFolder, step: int, device: str = "cpu") -> Detector:
    """A stored checkpoint's network on a device, in evaluation mode; torch is seeded as the stage was.

    Args:
        folder: of the stage.
        step: of the checkpoint.
        device: torch's name of it.

    Raises:
        CheckpointError: its weights cannot be read, or are of a version of fl3d whose network differs.
    """
    spec = read_spec(folder)
    make_importable(spec.machine.modules)
    prepare(spec.settings.seed, device, spec.settings.precision)
    weights = folder.weights(step)
    try:
        detector = build_detector(spec.stage.config)
        detector.load_state_dict(load_state(weights)["model"])
    except (ConfigError, RuntimeError) as error:
        commit = read_marker(folder, step).commit
        raise CheckpointError(
            f"{weights}: made by another version of fl3d ({commit[:10]}), whose network differs: {error}"
        ) from None
    return detector.to(device).eval()
