"""The course report's claims beside its own cells and our store."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fl3d.analysis.contributions import Contributions
from fl3d.config.compose import compose_config
from fl3d.detectors.pointrcnn import FOREGROUND
from fl3d.inference.load import build_detector
from fl3d.papers.claim import Claim, claims_table
from fl3d.papers.course_report.cells import our_cells
from fl3d.papers.course_report.frustum_tables import DETECTORS, FIRST, FRUSTUM, SETTINGS
from fl3d.papers.course_report.recall_tables import RECALL_TABLES
from fl3d.papers.course_report.report_claims import claim_of, only_change_claim
from fl3d.papers.course_report.resolutions_table import RESOLUTIONS
from fl3d.papers.course_report.sentences import DEFAULT, sentences
from fl3d.reports.table import Table
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.spec import read_spec

LOOKED_AT = 100  # training frames that foreground points are counted in
BINS = Claim(
    "§3.1.1 iii",
    "PointRCNN: bins of an axis, 2 m in bins of 0.2 m instead of 3 m and 0.5 m",
    "10 instead of 6",
    "20 instead of 12",
    "",
    "counted to one side of the point alone",
)
NO_DEFAULT = Claim(
    "abstract",
    "PointRCNN: 3D AP above the default's, medium and hard",
    "higher",
    "",
    "",
    "cannot be judged: no table has an AP of a default PointRCNN",
)
NOTES = (
    "From its own cells: the differences that a sentence is about. Ours: the same of our rows, by the seeds that both "
    "have, with intervals that hold for all of a sentence at once (95 %): of APs over frames and seeds; of recalls "
    "over seeds of training alone ('over seeds'), as these are not resampled, which says nothing of other frames. AP "
    "is R11 in the report and in Table 7 of ours, and R40, which has more recall steps, where ours are judged.",
)


def claims_of(sources: Sequence[Contributions]) -> Table | None:
    """All claims, as a table; None where no sweep feeds a table of the report.

    Args:
        sources: sweeps whose run folders are at hand.
    """
    names = {table.name for table in (*RECALL_TABLES, FRUSTUM, DETECTORS, RESOLUTIONS)}
    own = [one for one in sources if names & set(one.sweep.settings.sweep.tables)]
    if not own:
        return None
    cells = our_cells(own)
    settings = {
        setting: (FRUSTUM.number, (stage, setting))
        for stage, setting in SETTINGS
        if stage == FIRST and (FRUSTUM.number, (stage, setting)) != DEFAULT
    }
    claims = [claim_of(one, cells) for one in sentences("PointRCNN")]
    claims += [_foreground(own[0].sweep), BINS, NO_DEFAULT]
    claims += [claim_of(one, cells) for one in sentences("Frustum ConvNet")]
    claims.append(only_change_claim(settings, cells))
    caption = "Claims of the course report that its tables bear on"
    return claims_table(claims, NOTES, "claims_report", caption)


def _foreground(sweep: FinishedSweep) -> Claim:
    """Of the points that PointRCNN at full size is trained with, those in cars: what alpha is chosen by."""
    detector = build_detector(compose_config(["detector=pointrcnn", "profile=paper"]))
    kitti = sweep.kitti()
    shares = []
    for frame_id in read_spec(sweep.trials[0].folder).machine.train_ids[:LOOKED_AT]:
        sample = detector.encode(kitti.frame(frame_id), np.random.default_rng(0), training=True)
        shares.append(float(np.mean(sample["labels"] == FOREGROUND)))
    return Claim(
        "§3.1.1 ii",
        "PointRCNN: share of foreground among its points, which α is chosen by",
        "around 20 %",
        "",
        f"{np.mean(shares):.1%} of {len(shares)} training frames, at most {max(shares):.1%}",
        "ours: counted, not judged; of other data than the report's unless this is KITTI",
    )
