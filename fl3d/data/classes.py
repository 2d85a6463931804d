"""Classes of objects: what a list of them may be, and which types of labels stand near them in KITTI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from fl3d.core.errors import ConfigError
from fl3d.core.names import check_name
from fl3d.data.label_parser import kitti_spelling

CARS = ("Car",)  # what a config without classes is of, and every file that names none
DONTCARE = "DontCare"
# KITTI's: objects so like those of a class that finding one is neither right nor wrong.
NEIGHBOURS: Mapping[str, tuple[str, ...]] = {"Car": ("Van",), "Pedestrian": ("Person_sitting",)}


def why_no_classes(names: object) -> str:
    """What is wrong with a list of classes; nothing where it is good."""
    if not isinstance(names, list | tuple) or not names:
        return "is no list of names, such as [Car] or [Car,Pedestrian]"
    for name in names:
        try:
            check_name("classes", name)
        except ConfigError as error:
            return f"names no class: {str(error).removeprefix('classes: ')}"
        if "." in str(name):  # which would part the keys of a config
            return f"names {name}, which holds a dot"
        right = kitti_spelling(str(name))
        if right == DONTCARE:
            return f"names {DONTCARE}, which is no class: such regions are left out"
        if right != name:
            return f"names '{name}', which KITTI spells {right}"
    lower = [str(name).lower() for name in names]
    twice = next((name for name in names if lower.count(str(name).lower()) > 1), None)
    return "" if twice is None else f"names {twice} twice"


def class_of(label: str, classes: Sequence[str]) -> int | None:
    """Index of the class that objects of a label's type are learnt as; None: of none.

    A type is its own class, or that of the class that it is a neighbour of; with one class alone it is of that.
    """
    if label in classes:
        return list(classes).index(label)
    for number, name in enumerate(classes):
        if label in NEIGHBOURS.get(name, ()):
            return number
    return 0 if len(classes) == 1 else None
