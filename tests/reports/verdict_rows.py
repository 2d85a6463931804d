"""Rows of verdicts, as ``analysis.verdicts`` makes them."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd

from fl3d.evaluation.verdicts import Verdict
from fl3d.reports.levels import Levels
from tests.reports.frames import GROUPS

# Low, mean and high of a gain, of each verdict with a margin of 1.
ENDS = {
    Verdict.BETTER: (0.3, 2.0, 3.7),
    Verdict.WORSE: (-5.0, -3.0, -1.0),
    Verdict.EQUIVALENT: (-0.8, -0.1, 0.6),
    Verdict.UNDECIDED: (-2.0, 0.5, 3.0),
    Verdict.NONE: (-1.5, 0.3, 2.0),
}
Ends = Mapping[Verdict, tuple[float, float, float]]


def verdict_rows(
    levels: Levels, groups: Sequence[str] = GROUPS, seeds: int = 5, ends: Ends = ENDS
) -> pd.DataFrame:
    """The verdicts in turn, by level; AP 70 plus the gain, four more seeds where undecided."""
    rows = []
    for group in groups:
        for place, level in enumerate(levels.labels):
            is_base = level == levels.baseline
            verdict = Verdict.BASELINE if is_base else list(ends)[(place - 1) % len(ends)]
            low, gain, high = (0.0, 0.0, 0.0) if is_base else ends[verdict]
            row = {"group": group, "level": level, "metric": "3d_r40/moderate", "seeds": seeds}
            row |= {"ap": 70.0 + gain, "ap_low": 68.0, "ap_high": 72.0}
            row |= {"gain": gain, "gain_low": low, "gain_high": high}
            row |= {"spread": np.nan if is_base else 1.0, "verdict": str(verdict)}
            rows.append(row | {"more_seeds": 4.0 if verdict is Verdict.UNDECIDED else np.nan})
    return pd.DataFrame(rows)
