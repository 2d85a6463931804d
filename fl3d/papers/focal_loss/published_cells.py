"""The numbers that the paper prints.

Yun, Tai, Wang, Liu, Liu: Focal Loss in 3D Object Detection. IEEE Robotics and Automation Letters, 2019: Tables I to
VII; strings as printed, bold as 0 or 1. The first arXiv version (1809.06065v1) prints the same numbers but for some
cells, which lie in files of their own.
"""

from __future__ import annotations

import pandas as pd

from fl3d.papers.base import published

TABLES = ("I", "II", "III", "IV", "V", "VI", "VII")
ARXIV = {"IV": "IV_arxiv", "VII": "VII_arxiv"}  # where the arXiv version differs


def published_table(name: str) -> pd.DataFrame:
    """Cells of a table.

    Args:
        name: of the journal's table, or a value of ``ARXIV``.
    """
    return published("fl3d.papers.focal_loss", name)
