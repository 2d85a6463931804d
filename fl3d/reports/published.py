"""The numbers that the paper prints.

Yun, Tai, Wang, Liu, Liu: Focal Loss in 3D Object Detection. IEEE Robotics and Automation Letters, 2019: Table II
(last models of 3D-FCN), III (last models of VoxelNet) and IV (best models); strings as printed, bold as 0 or 1.
"""

from __future__ import annotations

from importlib.resources import files

import pandas as pd

TABLES = ("II", "III", "IV")


def published_table(number: str) -> pd.DataFrame:
    """Cells of a published table as strings, with a ``<column>_bold`` beside each AP."""
    path = files("fl3d.reports") / "published" / f"table_{number}.csv"
    with path.open("r", encoding="ascii") as file:
        return pd.read_csv(file, dtype=str)
