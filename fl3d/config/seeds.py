"""``seeds=5``: how many training seeds a sweep has, spelled out before anybody else reads the words. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from fl3d.core.errors import ConfigError

MOST = 1000


def spell_out_seeds(words: Sequence[str]) -> list[str]:
    """Words of a command line with ``seeds=5`` as Hydra's ``seed=range(0,5)``: seed=0,1,2,3,4.

    A range, so that a sweeper that does not train every trial under every seed can tell it from values that it may
    pick from, see ``sweep.sweepers.space``. Keys of that name further down, such as ``detector.seeds``, stay.

    Args:
        words: options and overrides, as typed.

    Raises:
        ConfigError: not a whole number from 1 on, or seeds that are told twice.
    """
    asked = [word for word in words if _key(word) == "seeds"]
    if not asked:
        return list(words)
    others = [word for word in words if _key(word) == "seed"]
    if len(asked) + len(others) > 1:
        several = " and ".join([*asked, *others])
        raise ConfigError(f"{several}: each says which seeds there are; keep one")
    count = _count(asked[0])
    return [f"seed=range(0,{count})" if word == asked[0] else word for word in words]


def _key(word: str) -> str:
    """Of an override: without Hydra's signs, which add or remove it."""
    return "" if word.startswith("-") else word.partition("=")[0].lstrip("+~")


def _count(word: str) -> int:
    sign, _, text = word.partition("seeds")
    text = text.removeprefix("=").strip()
    if sign:
        raise ConfigError(f"{word}: seeds is no key of the config; write it plainly: seeds=5")
    if "," in text or "(" in text:
        raise ConfigError(f"{word}: seeds says how many there are; to name them: seed={text}")
    if not (text.isascii() and text.isdigit() and 1 <= int(text) <= MOST):
        raise ConfigError(
            f"{word}: seeds is how many training seeds each level has, "
            f"a whole number from 1 to {MOST}; seeds=5 is seed=0,1,2,3,4"
        )
    return int(text)
