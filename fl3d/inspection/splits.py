"""What may be odd about splits, and about the area that is evaluated."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

from fl3d.inspection.facts import Facts
from fl3d.inspection.finding import Finding, warning


def of_area(facts: Facts) -> Iterator[Finding]:
    """An area that is evaluated, where all that lies around is kept."""
    area = facts.protocol.ignore_beyond
    if area is not None and area[0] >= 0 and facts.kitti.crop == "none":
        x0, y0, x1, y1 = (f"{value:g}" for value in area)
        yield warning(
            f"data.crop=none keeps all around, but objects beyond x {x0} to {x1}, y {y0} to {y1} m do not count.",
            "That is protocol.ignore_beyond, of the profile; widen it together with detector.range_velo.",
        )


SAYS_NOTHING = "What is evaluated on frames that were learnt from says nothing of others."


def of_splits(facts: Facts, train: str, val: str, is_one: bool) -> Iterator[Finding]:
    """Frames that are learnt from and evaluated.

    Args:
        facts: of the folder.
        train: split that is learnt from.
        val: split that is evaluated.
        is_one: whether the same split is meant by both, not only one of them there.
    """
    file = facts.kitti.root / "ImageSets" / f"{val}.txt"
    if is_one:
        yield warning(
            f"all {len(facts.splits[val])} frames of {val} are learnt from and evaluated: data.train_split and "
            "data.val_split are the same.",
            SAYS_NOTHING,
            file,
        )
    for one, other in combinations(dict.fromkeys((train, val)), 2):
        both = sorted(set(facts.splits[one]) & set(facts.splits[other]))
        if both:
            yield warning(
                f"{len(both)} frames are in {one} and in {other}, such as {both[0]}.",
                SAYS_NOTHING,
                facts.kitti.root / "ImageSets" / f"{other}.txt",
            )
