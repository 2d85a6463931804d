"""What each key of a config may be; ``values`` holds configs to it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from fl3d.data.classes import why_no_classes
from fl3d.data.kitti import CALIBRATIONS, CROPS

LARGEST_SEED = 2**63 - 1  # torch and the store's tables keep it as a signed integer of 64 bits
# Sections that a class is made of check themselves, see ``objects``; here their numbers must be finite alone.
BY_CLASS = ("detector", "loss", "optimizer", "augment", "protocol")
SECTIONS = (
    *("data", "data.cloud", "detections", "detector", "profile", "protocol", "selection", "store"),
    *("sweep", "schedule", "schedule.epochs", "schedule.stages"),
)
OPTIONAL = (
    "data.cloud*",
    "data.image_size",
    "data.people",
)  # came later than YAMLs that users may have


@dataclass(frozen=True)
class Rule:
    """What a value may be.

    Args:
        says: the same for people.
        fits: whether a value is so.
    """

    says: str
    fits: Callable[[Any], bool]

    def or_null(self) -> Rule:
        """The same, or nothing."""
        return Rule(f"{self.says}, or null", lambda value: value is None or self.fits(value))


def is_number(value: object) -> bool:
    """Whether a value is a finite number; a truth value is none."""
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def is_whole(value: object) -> bool:
    """Whether a value is a whole number; a truth value is none."""
    return isinstance(value, int) and not isinstance(value, bool)


def _whole(least: int, most: int | None = None) -> Rule:
    says = f"a whole number of at least {least}" + (f" and at most {most}" if most else "")
    return Rule(
        says, lambda value: is_whole(value) and least <= value and (most is None or value <= most)
    )


def _number(says: str, fits: Callable[[float], bool]) -> Rule:
    return Rule(f"a number {says}", lambda value: is_number(value) and fits(value))


PEOPLE = _number("above 0 and at most 3", lambda value: 0 < value <= 3)
ABOVE_0 = _number("above 0", lambda value: value > 0)
FROM_0 = _number("of at least 0", lambda value: value >= 0)
SHARE = _number("from 0 to 1", lambda value: 0 <= value <= 1)
COUNT = _whole(1)
FLAG = Rule("true or false", lambda value: isinstance(value, bool))
TEXT = Rule("a text", lambda value: isinstance(value, str) and bool(value.strip()))
DEVICE = Rule(
    "cpu, cuda or cuda:N",
    lambda value: isinstance(value, str) and bool(re.fullmatch(r"cpu|cuda(:\d+)?", value)),
)
SCALAR = Rule("a text", lambda value: isinstance(value, str | int | float) and value != "")
SECTION = Rule("a section of keys, or null", lambda value: value is None or value == {})
SEED = _whole(0, LARGEST_SEED)
KEYS_OF_SWEEP = Rule(
    "a key such as loss.gamma, a list of several, or null",
    lambda value: (
        value is None
        or (isinstance(value, str) and bool(value))
        or (isinstance(value, list) and all(isinstance(key, str) for key in value))
    ),
)
TEXTS = Rule(
    "a list of texts",
    lambda value: isinstance(value, list) and all(isinstance(one, str) for one in value),
)


def _one_of(*names: str) -> Rule:
    return Rule(f"one of {', '.join(names)}", lambda value: value in names)


CLASSES = Rule(
    "a list of names of classes, such as [Car] or [Car,Pedestrian]; each is there once, and KITTI's as KITTI spells it",
    lambda value: isinstance(value, list) and not why_no_classes(value),
)
ANY = Rule("any value", lambda value: True)

RULES: dict[str, Rule] = {
    "seed": SEED,
    "device": DEVICE,
    "precision": TEXT,
    "compile": FLAG,
    "workers": _whole(0).or_null(),
    "results": TEXT,
    "classes": CLASSES,
    "store.root": TEXT,
    "store.uri": TEXT.or_null(),
    "store.keep_every": COUNT.or_null(),
    "detections.max_boxes": COUNT,
    "detections.min_score": SHARE,
    "selection.stages": TEXT,
    "sweep.name": SCALAR,
    "sweep.question": SCALAR.or_null(),
    "sweep.factor": KEYS_OF_SWEEP,
    "sweep.baseline": ANY,
    "sweep.groups": KEYS_OF_SWEEP,
    "sweep.primary": TEXT,
    "sweep.margin": _number("of AP above 0, such as 1", lambda value: value > 0),
    "sweep.tables": TEXTS,
    "sweep.after": TEXT.or_null(),
    "sweep.winner": TEXT.or_null(),
    "data.name": SCALAR,
    "data.root": TEXT.or_null(),
    "data.generate": FLAG,
    "data.seed": SEED,
    "data.train_split": SCALAR,
    "data.val_split": SCALAR,
    "data.train_frames": COUNT.or_null(),
    "data.val_frames": COUNT.or_null(),
    "data.crop": _one_of(*CROPS),
    "data.calibration": _one_of(*CALIBRATIONS),
    "data.cloud.columns": _whole(3).or_null(),
    "data.cloud.dtype": TEXT.or_null(),
    "data.cloud.reflectance_scale": ABOVE_0,
    "data.image_size": ANY,  # read by ``data.pictures.checked_size``
    "data.cache_frames": _whole(0),
    "data.people": PEOPLE.or_null(),
    "data.mapping": TEXT.or_null(),
    "profile.name": SCALAR,
    "schedule.batch_size": COUNT,
    "schedule.frames_per_epoch": COUNT.or_null(),
    "schedule.clip": ABOVE_0.or_null(),
    "schedule.ramp_steps": _whole(0),
    "schedule.checkpoint_every": COUNT,
    "schedule.save_every_steps": COUNT.or_null(),
    "schedule.one_cycle": SECTION,
    "schedule.one_cycle.start": FROM_0,
    "schedule.one_cycle.rise": _number("between 0 and 1", lambda value: 0 < value < 1),
    "schedule.one_cycle.end": FROM_0,
    "schedule.one_cycle.momentum": Rule(
        "two numbers of at least 0 and below 1",
        lambda value: (
            isinstance(value, list)
            and len(value) == 2
            and all(is_number(one) and 0 <= one < 1 for one in value)
        ),
    ),
    "schedule.decay": SECTION,
    "schedule.decay.every": COUNT,
    "schedule.decay.factor": _number("above 0 and at most 1", lambda value: 0 < value <= 1),
    "schedule.decay.lowest": FROM_0,
    "schedule.epochs": SECTION,
    "schedule.epochs.*": COUNT,
    "schedule.stages.*.epochs": COUNT,
    "schedule.stages.*.lr_factor": ABOVE_0,
    "schedule.stages.*.set": SECTION,
    "schedule.stages.*": SECTION,  # null: the stage is left out
}
# Of torch's optimisers, which say no key in their errors.
OPTIMIZER: dict[str, Rule] = {
    "lr": ABOVE_0,
    "weight_decay": FROM_0,
    "momentum": FROM_0,
    "eps": FROM_0,
}
# Of a launcher; the class takes others, which are its own.
LAUNCHER: dict[str, Rule] = {
    "slots": COUNT.or_null(),
    "device": TEXT,
    "per_card": COUNT,
    "minutes": COUNT,
    "cpus": ABOVE_0,
    "gpus": FROM_0,
    "memory_gb": ABOVE_0.or_null(),
    "signal_seconds": _whole(0),
    "partition": SCALAR.or_null(),
}
