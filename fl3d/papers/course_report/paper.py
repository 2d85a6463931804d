"""The course report: Tables 1 to 7, Figures 4 to 8, and its claims."""

from __future__ import annotations

from fl3d.papers.base import Paper
from fl3d.papers.course_report.claims import claims_of
from fl3d.papers.course_report.figures import CAPTIONS, draw
from fl3d.papers.course_report.frustum_tables import DETECTORS, FRUSTUM
from fl3d.papers.course_report.recall_tables import RECALL_TABLES
from fl3d.papers.course_report.resolutions_table import RESOLUTIONS

COURSE_REPORT = Paper(
    name="course_report",
    tables=(*RECALL_TABLES, FRUSTUM, DETECTORS, RESOLUTIONS),
    draw=draw,
    claims=claims_of,
    captions=CAPTIONS,
)
