"""The numbers that the papers print.

Yun, Tai, Wang, Liu, Liu: Focal Loss in 3D Object Detection. IEEE Robotics and Automation Letters, 2019: Tables I to
VII; strings as printed, bold as 0 or 1. The first arXiv version (1809.06065v1) prints the same numbers but for some
cells, which lie in files of their own. Tables R1 to R7 are Tables 1 to 7 of a course report on PointRCNN and Frustum
ConvNet.
"""

from __future__ import annotations

from importlib.resources import files

import pandas as pd

TABLES = ("I", "II", "III", "IV", "V", "VI", "VII")
REPORT_TABLES = ("R1", "R2", "R3", "R4", "R5", "R6", "R7")  # of the course report
ARXIV = {"IV": "IV_arxiv", "VII": "VII_arxiv"}  # where the arXiv version differs


def published_table(name: str) -> pd.DataFrame:
    """Cells of a published table as strings, with a ``<column>_bold`` beside each AP.

    Args:
        name: of the journal's table, or a value of ``ARXIV``.
    """
    path = files("fl3d.reports") / "published" / f"table_{name}.csv"
    with path.open("r", encoding="ascii") as file:
        return pd.read_csv(file, dtype=str, keep_default_na=False)
