"""The paper's sentence that VoxelNet outperforms 3D-FCN (§VI-A). Pure."""

from __future__ import annotations

from collections.abc import Mapping

from fl3d.evaluation.intervals import Sample, joint_intervals
from fl3d.papers.claim import Claim, interval_text, seeds_in, too_few, word_of
from fl3d.papers.focal_loss.gain_claims import published_last

WHERE = "§VI-A"
TEXT = "AP of VoxelNet above 3D-FCN's, last models of the same γ"


def order_claim(ours: Mapping[tuple[float, str], Sample], looks: tuple[int, ...] = ()) -> Claim:
    """VoxelNet is better than 3D-FCN, by all cells of Tables II and III at once.

    Args:
        ours: differences in AP (R40) by gamma and AP column, over the seeds that both have; none where one is missing.
        looks: see ``gain_claims.gain_claims``.
    """
    above = published_last("VoxelNet") > published_last("3D-FCN")
    theirs = f"{int(above.to_numpy().sum())} of {above.size} cells"
    if not ours:
        return Claim(WHERE, TEXT, "in general", theirs, "", "")
    counts = [len(one.values) for one in ours.values()]
    found = joint_intervals(list(ours.values()), looks=looks)
    words = [word_of(one) for one in found]
    smallest = min(found, key=lambda one: one.low)
    shown = f"smallest of {len(found)} differences R40 {interval_text(smallest)}; {seeds_in(min(counts))}"
    verdict = too_few(min(counts)) or (
        f"larger in {words.count('larger')}, smaller in {words.count('smaller')} of {len(found)} cells (R40)"
    )
    return Claim(WHERE, TEXT, "in general", theirs, shown, f"ours: {verdict}")
