"""The numbers that the course report prints.

Udhayakumar, Das, Gandhi, Price: Evaluation of 3D Object Detection for Cars by improving existing frameworks. 2020.
Tables 1 to 7; strings as printed, bold as 0 or 1.
"""

from __future__ import annotations

import pandas as pd

from fl3d.papers.base import published, read_published

PACKAGE = "fl3d.papers.course_report"


def published_table(name: str) -> pd.DataFrame:
    """Cells of a table, ``R1`` to ``R7``, or of Figure 5, which is one: ``R_figure_5``."""
    return published(PACKAGE, name)


def published_sentences() -> pd.DataFrame:
    """What the report says of rows of its tables, see ``sentences.Sentence``."""
    return read_published(PACKAGE, "sentences.csv")
