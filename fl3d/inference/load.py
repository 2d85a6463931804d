"""The one way to build a detector and to open a checkpoint."""

from __future__ import annotations

from fl3d.config.objects import build, make_importable
from fl3d.core.errors import CheckpointError, ConfigError
from fl3d.core.records import Config
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
    detector = build(config["detector"], "detector", loss=loss)
    if not isinstance(detector, Detector):
        target = config["detector"]["_target_"]
        raise ConfigError(f"detector._target_: {target} is not a Detector (fl3d.detectors.base)")
    return detector


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
