"""VoxelNet: features learnt per voxel, 3D convolutions over height, a 2D region proposal network.

Zhou and Tuzel: VoxelNet: End-to-End Learning for Point Cloud Based 3D Object Detection. CVPR 2018; in the form of
Yun et al.: Focal Loss in 3D Object Detection, RA-L 2019 (Table VII, appendix C).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from fl3d.core.errors import ConfigError, options
from fl3d.core.typed import Count, Positive, make
from fl3d.data.classes import CARS
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame
from fl3d.data.voxels import Grid, Voxels, voxelize
from fl3d.detectors.anchors import Anchors, ClassAnchors, decode_boxes, encode_boxes
from fl3d.detectors.base import Batch, Found, Sample, WindowDetector
from fl3d.detectors.blocks import (
    as_array,
    check_compute,
    conv_block,
    init_he,
    join,
    join_ragged,
    scatter_dense,
    sigmoid,
    top_scores_by_class,
)
from fl3d.detectors.per_class import PerClass, least_points, needs, own_section
from fl3d.detectors.voxel_nets import N_FEATURES, RPN, FeatureNet
from fl3d.geometry.boxes import fold, wrap
from fl3d.losses import DetectionLoss
from fl3d.sparse.background import BackgroundMap
from fl3d.sparse.functions import unlowered
from fl3d.sparse.layers import BatchNorm3d, Conv3d, lay_out
from fl3d.sparse.norms import Map
from fl3d.sparse.rulebook import voxel_layout

ACROSS = {"cube": 3, "column": 1}  # width of the middle layers' kernels along y and x


class VoxelNet(WindowDetector):
    """VoxelNet.

    Args:
        loss: classification and regression.
        range_velo: x0, y0, z0, x1, y1, z1 in metres.
        voxel_size: x, y, z in metres.
        max_points: points kept in one voxel (T), drawn at random.
        vfe: output widths of the two encoding layers.
        voxel_features: channels of a voxel (after the fully connected layer).
        middle: channels of the three 3D convolutions.
        rpn: channels of the RPN's blocks.
        up: channels of each of its deconvolutions.
        anchors: h, w, l, bottom z and matching; see ``Anchors``.
        targets: which labels are positives.
        heading_fold: degrees; headings are folded into half a turn from here.
        norm_order: see ``blocks.conv_block``.
        mask_max: leave padded slots out of the maxima and of batch normalisation; False pads every voxel to
            ``max_points`` rows, as the paper's code does.
        compute: ``sparse``, up to where maps are nearly dense, or ``dense``: the same function, and the same weights.
        middle_kernel: of the middle layers: ``cube``, [3, 3, 3] along z, y, x, as Table VII of the paper and its code,
            or ``column``, [3, 1, 1], as its text (§V-A: [d, 1, 1]).
        rpn_stride: of the RPN's first convolution; its paper has 2 for cars and 1 for pedestrians and cyclists.
        classes: that it detects; each has its own two anchors at every place, and a box is of its anchor's class.
        per_class: of classes other than cars ``anchors``, with ``size`` and ``z`` at least, and ``min_points``.
    """

    VERSION = 4
    NAME = "VoxelNet"
    STAGES = ("warmup", "focal", "scratch")
    DENSE = ("middle", "rpn")
    MOST_CLASSES = None

    def __init__(
        self,
        loss: DetectionLoss,
        range_velo: Sequence[float],
        voxel_size: Sequence[Positive],
        max_points: Count,
        vfe: tuple[Count, Count],
        voxel_features: Count,
        middle: Count,
        rpn: tuple[Count, Count, Count],
        up: Count,
        anchors: Mapping[str, object],
        targets: TargetRule,
        heading_fold: float,
        norm_order: str,
        mask_max: bool,
        compute: str = "sparse",
        rpn_stride: Count = 2,
        middle_kernel: str = "cube",
        classes: Sequence[str] = CARS,
        per_class: PerClass | None = None,
    ) -> None:
        super().__init__()
        check_compute(compute)
        self.compute = compute
        self.classes = tuple(classes)
        self.least = least_points(per_class, classes)
        self.detection_loss = loss
        self.grid = Grid(range_velo, voxel_size)
        self.max_points = max_points
        self.targets = targets
        self.heading_fold = np.deg2rad(heading_fold)
        self.mask_max = mask_max
        depth, height, width = self.grid.shape
        self.feature_net = FeatureNet(vfe, voxel_features)
        layers = (
            (voxel_features, 2, 1),
            (middle, 1, 0),
            (middle, 2, 1),
        )  # channels in; stride, padding over z
        if middle_kernel not in ACROSS:
            raise ConfigError(
                f"detector.middle_kernel: no kernel '{middle_kernel}'. {options(middle_kernel, ACROSS)}"
            )
        across = ACROSS[middle_kernel]
        self.middle = nn.Sequential(
            *(
                conv_block(
                    Conv3d(
                        c, middle, (3, across, across), (s, 1, 1), (p, across // 2, across // 2)
                    ),
                    BatchNorm3d(middle),
                    norm_order,
                )
                for c, s, p in layers
            )
        )
        for _, stride, pad in layers:
            depth = (depth + 2 * pad - 3) // stride + 1
        self.rpn = RPN(middle * depth, rpn, up, norm_order, rpn_stride, len(self.classes))
        shape = (-(-height // rpn_stride), -(-width // rpn_stride))
        self.matcher = ClassAnchors(
            [self._anchors(name, anchors, per_class, shape) for name in self.classes]
        )
        self.anchors = self.matcher.boxes_velo
        init_he(self)

    def _anchors(
        self,
        name: str,
        plain: Mapping[str, object],
        per_class: PerClass | None,
        shape: tuple[int, int],
    ) -> Anchors:
        """Of one class: its own keys, and those of cars for what it does not tell.

        Raises:
            ConfigError: it is not cars, and has no size or height.
        """
        own = own_section(per_class, name, ("anchors", "min_points")).get("anchors")
        is_told = isinstance(own, Mapping) and {"size", "z"} <= set(own)
        if (name,) != CARS and not is_told:
            example = "'{size:[1.73,0.6,0.8],z:-1.465,positive:0.5,negative:0.35}'"
            raise needs(name, "anchors", example, "height, width, length and bottom in metres")
        key = f"detector.per_class.{name}.anchors" if own else "detector.anchors"
        return make(
            Anchors,
            {**plain, **(own or {})},
            key,
            range_velo=self.grid.range_velo,
            shape=shape,
        )

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Grouped points with seven features; for training, matched anchors and their residuals."""
        points = self.grid.cropped(frame.points_velo)
        voxels = voxelize(points, self.grid, self.max_points, rng.permutation(len(points)))
        sample: Sample = {"cells": voxels.cells, "rows": voxels.rows, "lengths": voxels.lengths}
        if not self.mask_max:
            sample.update(self._pad(voxels))
        if training:
            boxes, kinds = self.targets.objects(frame, self.classes, self.least)
            boxes[:, 6] = fold(boxes[:, 6], self.heading_fold)
            chosen, owners, negative = self.matcher.assign(boxes, kinds)
            sample["positive"] = chosen[:, None]
            sample["residuals"] = encode_boxes(boxes[owners], self.anchors[chosen]).astype(
                np.float32
            )
            sample["negative"] = negative
        return sample

    def _pad(self, voxels: Voxels) -> Sample:
        """Fill every voxel up to ``max_points`` with zero rows, told apart by a mask."""
        owner = np.repeat(np.arange(len(voxels.lengths)), voxels.lengths)
        slot = np.arange(len(owner)) - (np.cumsum(voxels.lengths) - voxels.lengths)[owner]
        place = owner * self.max_points + slot
        padded = np.zeros((len(voxels.lengths) * self.max_points, N_FEATURES), dtype=np.float32)
        mask = np.zeros((len(padded), 1), dtype=np.float32)
        padded[place], mask[place] = voxels.rows, 1
        return {
            "rows": padded,
            "mask": mask,
            "lengths": np.full(len(voxels.lengths), self.max_points),
        }

    def collate(self, samples: list[Sample]) -> Batch:
        """Concatenate rows; cells and positives carry their sample's number in front."""
        batch: Batch = {
            "cells": join_ragged([s["cells"] for s in samples]),
            "size": torch.tensor(len(samples)),
        }
        if self.compute == "sparse":
            layout = voxel_layout(batch["cells"], self.grid.shape, len(samples))
            self.rpn.lay_out(lay_out(layout, self.middle))
            batch |= {"layout": layout} if layout.rules else {}
        for key in ("rows", "lengths", "mask", "residuals"):
            if key in samples[0]:
                batch[key] = torch.from_numpy(np.concatenate([s[key] for s in samples]))
        if "positive" in samples[0]:
            batch["positive"] = join_ragged([s["positive"] for s in samples])
            batch["negative"] = join([s["negative"] for s in samples])
        return batch

    def forward(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits (B, A) and residuals (B, A, 7) of all anchors."""
        logits, residuals = self.rpn(self._from_above(batch))
        return logits, residuals

    def _from_above(self, batch: Batch) -> Map:
        """What the RPN reads."""
        rows = batch["rows"].to(self.rpn.prob.weight.dtype)
        with unlowered(rows):  # bfloat16 knows a place at 70 m to half a metre
            voxels = self.feature_net(rows, batch["lengths"], batch.get("mask"))
        if "layout" in batch:
            features = self.middle(BackgroundMap.from_voxels(voxels, batch["layout"]))
        else:
            features = self.middle(
                scatter_dense(voxels, batch["cells"], (int(batch["size"]), *self.grid.shape))
            )
        return features.flatten(1, 2) if isinstance(features, Tensor) else features

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Eq. 7-11 over matched anchors; those between the two overlaps count for nothing."""
        logits, residuals = self(batch)
        b, a = batch["positive"].unbind(1)
        terms = self.detection_loss.classification(*self.split(logits, batch))
        return {
            **terms,
            "reg": self.detection_loss.localization(residuals[b, a], batch["residuals"]),
        }

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of positive and of negative anchors; where boxes lie is not asked."""
        return self.split(self.rpn.logits(self.rpn.features(self._from_above(batch))), batch)

    def split(self, logits: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of positive and of negative anchors."""
        b, a = batch["positive"].unbind(1)
        return logits[b, a], logits[batch["negative"]]

    def boxes(self, logits: Tensor, codes: Tensor, max_boxes: int, min_score: float) -> list[Found]:
        """Decode the best anchors."""
        found = []
        for frame_logits, frame_residuals in zip(as_array(logits), as_array(codes), strict=True):
            best = top_scores_by_class(frame_logits, self.matcher.kinds, max_boxes, min_score)
            boxes = decode_boxes(frame_residuals[best].astype(np.float64), self.anchors[best])
            boxes[:, 6] = wrap(boxes[:, 6])
            kinds = self.matcher.kinds[best]
            found.append(Found(boxes, sigmoid(frame_logits[best]), kinds=kinds))
        return found

    def example(self) -> Batch:
        """A frame of 5300 voxels of 35 points, the paper's typical one (§V-A)."""
        voxels, points = 5300, 35
        return {
            "rows": torch.zeros(voxels * points, N_FEATURES),
            "lengths": torch.full((voxels,), points),
            "cells": torch.zeros(voxels, 4, dtype=torch.int64),
            "size": torch.tensor(1),
        }
