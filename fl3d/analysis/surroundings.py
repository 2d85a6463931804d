"""What lies around the boxes of a comparison where it is at hand: clouds with their calibrations, and pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from fl3d.analysis.compare import Compared
from fl3d.core.errors import DataMissing
from fl3d.data.calibration_files import read_calibration
from fl3d.data.clouds import find_cloud, read_cloud
from fl3d.data.pictures import find_picture, read_picture
from fl3d.evaluation.at_score import AtScore
from fl3d.geometry.boxes import count_points_inside
from fl3d.reports.figures.differences import Seen


@dataclass(frozen=True)
class Surroundings:
    """Where clouds and pictures lie.

    Args:
        clouds: folder of ``<frame>.bin``, ``.npy`` or ``.pcd``, or None.
        calib: folder of ``<frame>.txt``, for clouds.
        pictures: folder of ``<frame>.png``, ``.jpg`` or ``.jpeg``, or None.
    """

    clouds: Path | None = None
    calib: Path | None = None
    pictures: Path | None = None

    def check(self, ids: tuple[str, ...]) -> None:
        """Refuse folders that are not there, and clouds or calibrations that lack a frame; pictures may lack some.

        Raises:
            DataMissing: names folder, file, and how many are missing.
        """
        if self.pictures is not None and not self.pictures.is_dir():
            raise DataMissing("no such folder of pictures", self.pictures)
        if self.clouds is None:
            return
        if self.calib is None:
            raise DataMissing("these clouds need calibrations: --calib FOLDER", self.clouds)
        calib = self.calib
        _check(self.clouds, "clouds", [find_cloud(self.clouds, one) for one in ids])
        _check(calib, "calibrations", [calib / f"{one}.txt" for one in ids])

    def points_on_objects(self, compared: Compared) -> NDArray[np.int64] | None:
        """LiDAR points within each ground truth: (G,); None without clouds."""
        if self.clouds is None or self.calib is None:
            return None
        gt = compared.held.runs[compared.baseline][0].gt
        counts = np.zeros(len(gt.types), dtype=np.int64)
        for place, frame_id in enumerate(compared.held.ids):
            start, end = gt.offsets[place : place + 2]
            calibration = read_calibration(self.calib / f"{frame_id}.txt")
            boxes = calibration.boxes_to_velo(gt.boxes_cam[start:end])
            cloud = read_cloud(find_cloud(self.clouds, frame_id)).points_velo
            counts[start:end] = count_points_inside(cloud, boxes)
        return counts

    def seen(self, compared: Compared, name: str, at: AtScore, place: int) -> Seen:
        """What a detector finds in one frame, with what is at hand of its surroundings.

        Args:
            compared: see ``compare.compare_detectors``.
            name: of the detector; its first run stands for it.
            at: what that finds.
            place: of the frame.
        """
        run, frame_id = compared.held.runs[name][0], compared.held.ids[place]
        of_gt = slice(*run.gt.offsets[place : place + 2])
        of_det = slice(*run.det.offsets[place : place + 2])
        shown = at.hit[of_det] | at.alarm[of_det]
        return Seen(
            gt_cam=run.gt.boxes_cam[of_gt][_is_body(run.gt.boxes_cam[of_gt])],
            found=at.found[of_gt][_is_body(run.gt.boxes_cam[of_gt])],
            det_cam=run.det.boxes_cam[of_det][shown],
            alarm=at.alarm[of_det][shown],
            hit=at.hit[of_det][shown],
            points_cam=self._points_cam(frame_id),
            image=self._image(frame_id),
            boxes_image=run.det.boxes_image[of_det][shown],
        )

    def _points_cam(self, frame_id: str) -> NDArray[np.float64] | None:
        if self.clouds is None or self.calib is None:
            return None
        calibration = read_calibration(self.calib / f"{frame_id}.txt")
        cloud = read_cloud(find_cloud(self.clouds, frame_id))
        return calibration.points_to_cam(cloud.points_velo[:, :3])

    def _image(self, frame_id: str) -> NDArray[np.uint8] | None:
        path = None if self.pictures is None else find_picture(self.pictures, frame_id)
        return None if path is None else read_picture(path)


def _check(folder: Path, kind: str, paths: Sequence[Path]) -> None:
    if not folder.is_dir():
        raise DataMissing(f"no such folder of {kind}", folder)
    lacking = [path for path in paths if not path.is_file()]
    if lacking:
        raise DataMissing(
            f"no such file; {len(lacking)} of {len(paths)} frames have no {kind} here", lacking[0]
        )


def _is_body(boxes_cam: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which boxes are of objects: regions to be ignored have none."""
    return boxes_cam[:, 3] > 0
