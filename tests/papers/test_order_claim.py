"""VoxelNet above 3D-FCN: the paper's cells, and ours by intervals that hold at once."""

import numpy as np

from fl3d.evaluation.intervals import Sample
from fl3d.papers.focal_loss.order_claim import order_claim

SHAKE = np.array([-0.01, 0.0, 0.01])


def test_the_papers_own_cells_agree() -> None:
    claim = order_claim({})
    assert claim.recomputed == "42 of 42 cells"
    assert claim.verdict == ""


def test_ours_is_told_cell_by_cell() -> None:
    ours = {
        (0.0, "3d_easy"): Sample(8 + SHAKE, 8 + SHAKE),
        (0.0, "3d_hard"): Sample(-2 + SHAKE, -2 + SHAKE),
        (2.0, "3d_hard"): Sample(0 + SHAKE, SHAKE),
    }
    claim = order_claim(ours)
    assert claim.verdict == "ours: larger in 1, smaller in 1 of 3 cells (R40)"
    assert claim.ours.startswith("smallest of 3 differences R40 -2.00 [")
    assert claim.ours.endswith("; 3 seeds")
