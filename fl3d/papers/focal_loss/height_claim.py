"""The paper's sentence that the imbalance of windows grows with their height (§III-B). Pure."""

from __future__ import annotations

import numpy as np
import pandas as pd

from fl3d.papers.claim import Claim

WHERE = "§III-B"
TEXT = "negatives for each positive of 3D-FCN, from its lowest windows to its highest"
PRINTED = "increases with z"


def height_claim(windows: pd.DataFrame) -> Claim:
    """In how many steps from one height to the next more negatives stand against a positive.

    Args:
        windows: ``z_low`` in metres, ``positives`` and ``negatives`` a frame, see ``figures.windows_by_height``;
            heights without any positive say nothing.
    """
    met = windows[windows["positives"] > 0].sort_values("z_low")
    ratios = (met["negatives"] / met["positives"]).to_numpy()
    if len(ratios) < 2:
        return Claim(WHERE, TEXT, PRINTED, "", "", "")
    steps = np.diff(ratios)
    ours = ", ".join(f"{ratio:,.0f}" for ratio in ratios)
    verdict = f"ours: increases in {int((steps > 0).sum())} of {len(steps)} steps"
    return Claim(WHERE, TEXT, PRINTED, "", ours, verdict)
