"""The paper on the focal loss: Tables I to VII, Figures 1, 4 and 5, and its claims."""

from __future__ import annotations

from fl3d.papers.base import Paper
from fl3d.papers.focal_loss.best_models import BEST_MODELS, BEST_OWN_MODELS
from fl3d.papers.focal_loss.claims import claims_of
from fl3d.papers.focal_loss.figures import CAPTIONS, draw, jobs
from fl3d.papers.focal_loss.layers import still_tables
from fl3d.papers.focal_loss.tables import LAST_3D_FCN, LAST_VOXELNET, LOSS_FORMS

FOCAL_LOSS = Paper(
    name="focal_loss",
    tables=(LAST_3D_FCN, LAST_VOXELNET, BEST_MODELS, BEST_OWN_MODELS, LOSS_FORMS),
    still=still_tables,
    draw=draw,
    jobs=jobs,
    claims=claims_of,
    captions=CAPTIONS,
)
