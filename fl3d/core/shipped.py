"""What belongs to fl3d and is no code: configs, sweep files, published scores.

In a checkout they lie at its top, beside the package; a wheel has them within it, where ``hatch_build.py`` puts them.
"""

from __future__ import annotations

from pathlib import Path

PACKAGE = Path(__file__).resolve().parent.parent


def shipped(name: str) -> Path:
    """The folder ``conf`` or ``results``, wherever fl3d is installed.

    The one in the package comes first: what lies beside an installed package, in ``site-packages``, is somebody else's.
    """
    inside = PACKAGE / name
    return inside if inside.is_dir() else PACKAGE.parent / name


def is_checkout() -> bool:
    """Whether fl3d runs from its repository, whose files may be made anew."""
    return not (PACKAGE / "conf").is_dir()
