"""3D-FCN: a fully convolutional network over an occupancy grid.

Li: 3D Fully Convolutional Network for Vehicle Detection in Point Cloud. IROS 2017; in the form of Yun et al.:
Focal Loss in 3D Object Detection, RA-L 2019 (Table VI, appendix B): four body layers, no deconvolution.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fl3d.core.typed import Count, Positive
from fl3d.data.classes import CARS
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame
from fl3d.data.voxels import Grid, occupancy
from fl3d.detectors.base import Batch, Found, Sample, WindowDetector
from fl3d.detectors.blocks import (
    as_array,
    check_compute,
    conv_block,
    init_he,
    join_ragged,
    scatter_dense,
    sigmoid,
    top_scores_by_class,
)
from fl3d.detectors.per_class import PerClass, least_points, own_section
from fl3d.geometry.boxes import boxes_from_corners, corners_velo, fold
from fl3d.losses import DetectionLoss
from fl3d.sparse.background import BackgroundMap, dense
from fl3d.sparse.functions import unlowered
from fl3d.sparse.layers import BatchNorm3d, Conv3d, lay_out
from fl3d.sparse.norms import Map
from fl3d.sparse.rulebook import voxel_layout

STRIDE = 8  # of the output against the input grid
KERNELS = (5, 5, 3, 3)
STRIDES = (2, 2, 2, 1)


class FCN3D(WindowDetector):
    """3D-FCN.

    The stride-2 convolutions pad evenly on both sides; TensorFlow's SAME pads one more behind. Same shapes,
    half a cell of shift, which the regression takes up.

    Args:
        loss: classification and regression.
        range_velo: x0, y0, z0, x1, y1, z1 in metres.
        voxel_size: x, y, z in metres.
        channels: of the four body layers.
        targets: which labels are positives.
        fov_offset: points with abs(y) >= x - fov_offset are dropped; None keeps all.
        heading_fold: degrees; headings are folded into half a turn from here, so that the corners of a car
            seen from the front and from behind come in one order.
        max_length: metres; longer objects are not targets.
        x_shift: metres added to decoded boxes (the paper's code adds 0.1).
        norm_order: see ``blocks.conv_block``.
        head_bias: whether the two heads have a bias.
        compute: ``sparse`` or ``dense``: the same function, and the same weights, at different speed.
        classes: that it detects; each has its own windows and corners, a map behind the other.
        per_class: of a class ``min_points``, where it is not that of ``targets``.
    """

    VERSION = 3
    NAME = "3D-FCN"
    STAGES = ("warmup", "focal", "scratch")
    DENSE = ("body", "obj", "cor")
    MOST_CLASSES = None

    def __init__(
        self,
        loss: DetectionLoss,
        range_velo: Sequence[float],
        voxel_size: Sequence[Positive],
        channels: tuple[Count, Count, Count, Count],
        targets: TargetRule,
        fov_offset: float | None,
        heading_fold: float,
        max_length: Positive,
        x_shift: float,
        norm_order: str,
        head_bias: bool,
        compute: str = "sparse",
        classes: Sequence[str] = CARS,
        per_class: PerClass | None = None,
    ) -> None:
        super().__init__()
        self.classes = tuple(classes)
        self.least = least_points(per_class, classes)
        for name in self.classes:
            own_section(per_class, name, ("min_points",))
        self.detection_loss = loss
        self.grid = Grid(range_velo, voxel_size)
        self.targets = targets
        self.fov_offset = fov_offset
        self.heading_fold = np.deg2rad(heading_fold)
        self.max_length = max_length
        self.x_shift = x_shift
        check_compute(compute)
        self.compute = compute
        widths = pairwise([1, *channels])
        self.body = nn.Sequential(
            *(
                conv_block(
                    Conv3d(c_in, c_out, k, s, padding=k // 2, bias=False),
                    BatchNorm3d(c_out),
                    norm_order,
                )
                for (c_in, c_out), k, s in zip(widths, KERNELS, STRIDES, strict=True)
            )
        )
        n = len(self.classes)
        self.obj = Conv3d(channels[-1], n, 3, padding=1, bias=head_bias)
        self.cor = Conv3d(channels[-1], 24 * n, 3, padding=1, bias=head_bias)
        init_he(self)

    @property
    def cells(self) -> tuple[int, int, int]:
        """Output cells along z, y, x."""
        nz, ny, nx = (-(-n // STRIDE) for n in self.grid.shape)
        return nz, ny, nx

    def origins(self, cells: NDArray[np.int64]) -> NDArray[np.float64]:
        """Lower corners x, y, z in metres of output cells (N, 3) z, y, x: what corners are measured from."""
        return cells[:, ::-1] * (np.array(self.grid.voxel_size) * STRIDE) + self.grid.low

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Occupied voxels; for training, the cell of each object's centre and its corners (appendix B)."""
        points = frame.points_velo
        if self.fov_offset is not None:
            in_view = np.abs(points[:, 1]) < points[:, 0] - self.fov_offset
            points = points.compress(in_view, axis=0)
        sample: Sample = {"occupied": occupancy(points, self.grid)}
        if training:
            boxes, kinds = self.targets.objects(frame, self.classes, self.least)
            parts = [self.assign(boxes[kinds == kind]) for kind in range(len(self.classes))]
            height = np.array([self.cells[0], 0, 0])
            cells = [own + kind * height for kind, (own, _) in enumerate(parts)]
            sample["cells"] = np.concatenate(cells)
            sample["corners"] = np.concatenate([corners for _, corners in parts])
        return sample

    def assign(
        self, boxes_velo: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float32]]:
        """Positive cells (N, 3) z, y, x and their 24 targets: corners minus the cell's origin.

        Objects whose centre is out of range have no cell; of two centres in one cell the nearer object stays.
        """
        centers = boxes_velo[:, :3] + np.array([0, 0, 0.5]) * boxes_velo[:, 3:4]
        keep = self.grid.inside(centers) & (boxes_velo[:, 5] <= self.max_length)
        boxes, centers = boxes_velo[keep].copy(), centers[keep]
        boxes[:, 6] = fold(boxes[:, 6], self.heading_fold)
        size = np.array(self.grid.voxel_size) * STRIDE
        cells = np.floor((centers - self.grid.low) / size).astype(np.int64)[:, ::-1]
        order = np.argsort(np.hypot(centers[:, 0], centers[:, 1]), kind="stable")
        first = np.sort(order[np.unique(cells[order], axis=0, return_index=True)[1]])
        corners = corners_velo(boxes[first]) - self.origins(cells[first])[:, None]
        return cells[first].copy(), corners.reshape(-1, 24).astype(np.float32)

    def collate(self, samples: list[Sample]) -> Batch:
        """Index rows with their sample's number in front."""
        batch: Batch = {"occupied": join_ragged([s["occupied"] for s in samples])}
        batch["size"] = torch.tensor(len(samples))
        if self.compute == "sparse":
            layout = voxel_layout(batch["occupied"], self.grid.shape, len(samples))
            lay_out(lay_out(layout, self.body), self.obj)  # whose rulebook is that of ``cor`` too
            batch |= {"layout": layout} if layout.rules else {}
        if "cells" in samples[0]:
            batch["cells"] = join_ragged([s["cells"] for s in samples])
            batch["corners"] = torch.from_numpy(np.concatenate([s["corners"] for s in samples]))
        return batch

    def forward(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Objectness logits (B, Z, Y, X) and corner offsets (B, Z, Y, X, 24); Z runs through each class."""
        features = self._features(batch)
        with unlowered(self.obj.weight):
            return self._logits(features), self._by_class(dense(self.cor(features)))

    def _features(self, batch: Batch) -> Map:
        """What both heads read."""
        occupied = batch["occupied"]
        ones = torch.ones(len(occupied), 1, device=occupied.device, dtype=self.obj.weight.dtype)
        if "layout" in batch:
            features = self.body(BackgroundMap.from_voxels(ones, batch["layout"]))
        else:
            features = self.body(
                scatter_dense(ones, occupied, (int(batch["size"]), *self.grid.shape))
            )
        return features.to(ones.dtype)

    def _logits(self, features: Map) -> Tensor:
        """Of objectness, (B, Z, Y, X)."""
        with unlowered(self.obj.weight):  # scores of three digits would tie
            return dense(self.obj(features)).flatten(1, 2)

    def _by_class(self, corners: Tensor) -> Tensor:
        """(B, classes * 24, Z, Y, X) -> (B, classes * Z, Y, X, 24)."""
        by_class = corners.reshape(len(corners), len(self.classes), 24, *corners.shape[2:])
        return by_class.movedim(2, -1).flatten(1, 2)

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Eq. 7-11: every cell without an object's centre is a negative."""
        logits, corners = self(batch)
        b, z, y, x = batch["cells"].unbind(1)
        terms = self.detection_loss.classification(*self.split(logits, batch))
        return {
            **terms,
            "reg": self.detection_loss.localization(corners[b, z, y, x], batch["corners"]),
        }

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of cells with an object's centre, and of all others; where boxes lie is not asked."""
        return self.split(self._logits(self._features(batch)), batch)

    def split(self, logits: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of cells with an object's centre, and of all others."""
        b, z, y, x = batch["cells"].unbind(1)
        negative = torch.ones_like(logits, dtype=torch.bool)
        negative[b, z, y, x] = False
        return logits[b, z, y, x], logits[negative]

    def boxes(self, logits: Tensor, codes: Tensor, max_boxes: int, min_score: float) -> list[Found]:
        """Decode the best cells: corners plus origin, then the nearest box."""
        found = []
        for frame_logits, frame_corners in zip(as_array(logits), as_array(codes), strict=True):
            each = frame_logits.size // len(self.classes)  # windows of a class
            all_kinds = np.repeat(np.arange(len(self.classes)), each)
            best = top_scores_by_class(frame_logits.ravel(), all_kinds, max_boxes, min_score)
            cells = np.stack(np.unravel_index(best, frame_logits.shape), axis=1)
            cells[:, 0] %= self.cells[0]
            offsets = frame_corners.reshape(-1, 8, 3)[best].astype(np.float64)
            boxes = boxes_from_corners(offsets + self.origins(cells)[:, None])
            boxes[:, 0] += self.x_shift
            scores = sigmoid(frame_logits.ravel()[best])
            found.append(Found(boxes, scores, kinds=all_kinds[best]))
        return found

    def example(self) -> Batch:
        """One frame without points."""
        return {"occupied": torch.zeros(0, 4, dtype=torch.int64), "size": torch.tensor(1)}
