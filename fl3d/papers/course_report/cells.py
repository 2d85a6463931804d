"""Our cells of the report's tables, seed by seed, in resamples of the frames where they are APs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from fl3d.analysis import AVERAGES
from fl3d.analysis.contributions import Contributions
from fl3d.analysis.samples import CELLS, Measured
from fl3d.papers.course_report.frustum_tables import (
    DETECTORS,
    FRUSTUM,
    KITTI_LEVEL,
    LEVELS,
    NAMES,
    SETTINGS,
    stage_ends,
)
from fl3d.papers.course_report.recall_tables import OVERLAPS, RECALL_TABLES
from fl3d.papers.course_report.resolutions_table import RESOLUTIONS
from fl3d.papers.course_report.sentences import Place
from fl3d.runs.trials import FinishedTrial

R40 = AVERAGES.index("R40")
Seeds = Mapping[int, Measured]  # by seed; of a recall, which is not resampled, there is one draw
Cells = Mapping[tuple[Place, str], Seeds]  # by row and column
Drawn = dict[tuple[Place, str], dict[int, Measured]]  # being filled


def our_cells(sources: Sequence[Contributions]) -> Cells:
    """Every cell that some sweeps fill."""
    found: dict[tuple[Place, str], Seeds] = {}
    for table in RECALL_TABLES:
        for source in _feeding(sources, table.name)[:1]:
            for front, rows in table.models(source.sweep).items():
                for overlap in OVERLAPS:
                    own = dict(zip(rows["seed"], rows[f"recall_3d/{overlap}"], strict=True))
                    found[(table.number, front), f"iou_{overlap}"] = _unresampled(own)
    return {**found, **_of_frustum(sources), **_of_resolutions(sources), **_of_detectors(sources)}


def _feeding(sources: Sequence[Contributions], name: str) -> list[Contributions]:
    """Those that feed a table; under several protocols those of the first one's."""
    own = [one for one in sources if name in one.sweep.settings.sweep.tables]
    return [one for one in own if one.sweep.protocol.id == own[0].sweep.protocol.id]


def _unresampled(values: Mapping[int, float]) -> Seeds:
    return {int(seed): Measured(float(value), np.array([value])) for seed, value in values.items()}


def _of_frustum(sources: Sequence[Contributions]) -> Cells:
    """Table 6, in R40."""
    own = {one.sweep.name: one for one in _feeding(sources, FRUSTUM.name)}
    found: Drawn = {}
    for end in stage_ends([one.sweep for one in own.values()]):
        source = own[end["sweep"]]
        trial = source.sweep.trial(end["trial"])
        for row, set_to in SETTINGS.items():
            if (row[0], set_to) == (end["stage"], end["values"]):
                _draw(found, (FRUSTUM.number, row), source, trial, int(end["step"]))
    return dict(found)


def _of_resolutions(sources: Sequence[Contributions]) -> Cells:
    """Figure 5, in R40."""
    found: Drawn = {}
    for source in _feeding(sources, RESOLUTIONS.name)[:1]:
        steps = source.sweep.steps("last")
        for trial in source.sweep.trials:
            strides = RESOLUTIONS.row_of(trial.plan)
            if strides is not None:
                place = (RESOLUTIONS.number, (str(strides),))
                _draw(found, place, source, trial, steps[trial.key])
    return dict(found)


def _draw(
    found: Drawn, place: Place, source: Contributions, trial: FinishedTrial, step: int
) -> None:
    """Put the 3D APs of a checkpoint into a row."""
    drawn = source.resampled(trial, step)
    for level in LEVELS:
        cell = CELLS.index(("3d", KITTI_LEVEL[level]))
        by_seed = found.setdefault((place, f"3d_{level}"), {})
        value, draws = float(drawn.values[cell, R40]), drawn.draws[:, cell, R40]
        by_seed[trial.seed] = Measured(value, draws, drawn.detections)


def _of_detectors(sources: Sequence[Contributions]) -> Cells:
    """Table 7, as it shows it: in R11, and of PointRCNN's settings the best."""
    sweeps = [one.sweep for one in _feeding(sources, DETECTORS.name)]
    found: dict[tuple[Place, str], Seeds] = {}
    for detector, name in NAMES.items() if sweeps else ():
        rows = DETECTORS.models(sweeps, detector)
        for level in LEVELS if len(rows) else ():
            own = dict(zip(rows["seed"], rows[f"ap_3d/{KITTI_LEVEL[level]}"], strict=True))
            found[(DETECTORS.number, (name,)), f"3d_{level}"] = _unresampled(own)
    return found
