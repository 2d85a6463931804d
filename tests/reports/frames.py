"""Frames of scores, as ``runs.scores`` and ``analysis`` make them."""

from collections.abc import Sequence
from pathlib import Path

import pandas as pd

from fl3d.evaluation.protocol import METRIC_NAMES

GROUPS = ("3D-FCN", "VoxelNet")


def tidy_scores(
    levels: Sequence[str], groups: Sequence[str] = GROUPS, seeds: Sequence[int] = (0,)
) -> pd.DataFrame:
    """Checkpoints at steps 10, 20 and 30.

    The AP is the step and twice the level's place; 15 less at the last step.
    """
    rows = []
    for group in groups:
        for place, level in enumerate(levels):
            for seed in seeds:
                front = {
                    "trial": f"{group} {level} {seed}",
                    "group": group,
                    "level": level,
                    "seed": seed,
                }
                for step in (10, 20, 30):
                    ap = step + 2.0 * place - (step == 30) * 15
                    rows.append(
                        front
                        | {"step": step, "first_own_step": 5}
                        | dict.fromkeys(METRIC_NAMES, ap)
                    )
    return pd.DataFrame(rows)


def is_figure(written: list[Path]) -> bool:
    """Whether it was written in all its forms, and none of them is empty."""
    has_all = {path.suffix for path in written} == {".csv", ".png", ".pdf"}
    return has_all and all(path.stat().st_size for path in written)
