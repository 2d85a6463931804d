"""Numbers of things, as people write them."""

from __future__ import annotations


def several(number: int, noun: str) -> str:
    """``1 trial``, ``3 trials``.

    Args:
        number: of them.
        noun: one of them, whose plural ends with an s.
    """
    return f"{number} {noun}{'' if number == 1 else 's'}"
