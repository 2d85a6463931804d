"""PointRCNN: boxes proposed by every foreground point, then refined from the points around each proposal.

Shi, Wang, Li: PointRCNN: 3D Object Proposal Generation and Detection from Point Cloud. CVPR 2019. The paper's camera
frame is turned into the LiDAR's (its z is x here, its x is -y, its y is -z); the network sees no difference.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import log, pi
from typing import Any

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from fl3d.core.typed import Count, NotNegative, Positive, make
from fl3d.data.classes import CARS
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame
from fl3d.data.voxels import Grid
from fl3d.detectors.base import Batch, Detector, Found, Sample
from fl3d.detectors.bins import BinCode
from fl3d.detectors.blocks import join, join_ragged, sigmoid, top_scores
from fl3d.detectors.per_class import PerClass, least_points, mean_size
from fl3d.detectors.point_nets import RCNN, RPN, Refinement, initialise, last_layer
from fl3d.detectors.regions import centered, from_regions, pool, relative_to_regions
from fl3d.detectors.rois import ProposalRule, RoiRule
from fl3d.geometry.boxes import NEAR, Array, Points, owners, wrap
from fl3d.losses import BalancedFocalLoss
from fl3d.points.network import Backbone, Level

PRIOR = 0.01  # of foreground, at the start
BACKGROUND, FOREGROUND, IGNORED = 0, 1, 2
DEPTH_SCALE = 70.0  # metres


class PointRCNN(Detector):
    """PointRCNN.

    Args:
        loss: classification of points, and of regions where ``rcnn.classification`` is ``focal``.
        range_velo: x0, y0, z0, x1, y1, z1 in metres.
        points: sampled of a frame.
        far: metres; points beyond are kept before any other.
        margin: metres around an object where points are neither foreground nor background.
        size: mean h, w, l of cars in metres.
        targets: which labels are objects.
        levels: of the backbone's way down, see ``points.network.Level``.
        up: widths of its way up.
        rpn: ``search`` and ``bin`` of its box code in metres, ``yaw_bins``, ``head`` width, ``dropout``.
        train: which proposals the second stage sees in training, see ``ProposalRule``.
        test: likewise at test time.
        rcnn: the second stage, see ``Refinement``; None: there is none yet, and proposals are what is found.
        classes: the one that it detects: its code has a network of each.
        per_class: of a class other than cars ``size``, and ``min_points``.
    """

    VERSION = 2
    NAME = "PointRCNN"
    STAGES = ("rpn", "rcnn")
    LEARNS_FROM = ("Car", "Van")  # as its code, whichever of them `targets` names

    def __init__(
        self,
        loss: BalancedFocalLoss,
        range_velo: Sequence[float],
        points: Count,
        far: NotNegative,
        margin: NotNegative,
        size: tuple[Positive, Positive, Positive],
        targets: TargetRule,
        levels: Sequence[Mapping[str, Any]],
        up: Sequence[Sequence[Count]],
        rpn: Mapping[str, float],
        train: Mapping[str, Any],
        test: Mapping[str, Any],
        rcnn: Mapping[str, Any] | None = None,
        classes: Sequence[str] = CARS,
        per_class: PerClass | None = None,
    ) -> None:
        super().__init__()
        self.classes = tuple(classes)
        self.least = least_points(per_class, classes)
        own_size = mean_size(self.classes[0], size, per_class)
        self.point_loss = loss
        self.grid = Grid(
            range_velo, [a - b for a, b in zip(range_velo[3:], range_velo[:3], strict=True)]
        )
        self.n_points, self.far, self.margin, self.targets = points, far, margin, targets
        self.rules = {
            True: make(ProposalRule, train, "detector.train"),
            False: make(ProposalRule, test, "detector.test"),
        }
        self.code = BinCode(rpn["search"], rpn["bin"], int(rpn["yaw_bins"]), 2 * pi, own_size)
        backbone = Backbone([make(Level, level, "detector.levels") for level in levels], up)
        self.rpn = RPN(backbone, int(rpn["head"]), self.code, rpn["dropout"])
        initialise(self.rpn, nn.init.kaiming_normal_)
        nn.init.constant_(last_layer(self.rpn.score).bias, -log((1 - PRIOR) / PRIOR))
        self.rcnn: RCNN | None = None
        if rcnn is not None:
            own = {
                "levels": [make(Level, one, "detector.rcnn.levels") for one in rcnn["levels"]],
                "rois": make(RoiRule, rcnn["rois"], "detector.rcnn.rois"),
            }
            self.second = make(Refinement, {**rcnn, **own}, "detector.rcnn")
            self.roi_code = BinCode(
                self.second.search, self.second.bin, self.second.yaw_bins, pi / 2, own_size
            )
            self.rcnn = RCNN(self.second, backbone.c_out, self.roi_code)
            initialise(self.rcnn, nn.init.xavier_normal_)
            self.rpn.requires_grad_(False)

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Sampled points; for training, what each belongs to, and the objects."""
        points = self.grid.cropped(frame.points_velo[:, :3])
        points = (
            points[self._sample(points, rng)]
            if len(points)
            else np.zeros((self.n_points, 3), np.float32)
        )
        sample: Sample = {"points": points}
        if training:
            objects, _ = self.targets.objects(frame, self.classes, self.least)
            objects = objects[self.grid.inside(objects)]
            owner = owners(points, objects, self.margin)
            labels = np.where(owner >= 0, FOREGROUND, np.where(owner == NEAR, IGNORED, BACKGROUND))
            sample |= {"labels": labels, "objects": objects.astype(np.float32)}
            sample["own"] = objects[owner[owner >= 0]].astype(np.float32)
        return sample

    def _sample(
        self, points: Points, rng: np.random.Generator
    ) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
        """Indices of exactly ``points`` of them, far ones first, in random order; copies where there are fewer."""
        order = rng.permutation(len(points))
        if len(points) >= self.n_points:
            is_near = points[order, 0] <= self.far
            order = order[np.argsort(is_near, kind="stable")][: self.n_points]
            return rng.permutation(order)
        return np.concatenate([order, rng.choice(order, self.n_points - len(points))])

    def collate(self, samples: list[Sample]) -> Batch:
        """Stack points; objects carry their sample's number in front."""
        batch: Batch = {"points": join([s["points"] for s in samples])}
        if "labels" in samples[0]:
            batch["labels"] = join([s["labels"] for s in samples])
            batch["own"] = torch.from_numpy(np.concatenate([s["own"] for s in samples]))
            batch["objects"] = join_ragged([s["objects"] for s in samples])
        return batch

    def forward(self, batch: Batch) -> tuple[Tensor, ...]:
        """Logits (B, N), codes (B, N, R) and features of all points; with a second stage those of one region each."""
        found = self.rpn(batch["points"])
        if self.rcnn is None:
            return tuple(found)
        regions = batch["points"].new_zeros(
            len(batch["points"]), self.second.points, 5 + found[2].shape[2]
        )
        return (*found, *self.rcnn(regions))

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Of the first stage, or of the second once there is one."""
        if self.rcnn is not None:
            return self._refinement_loss(batch)
        logits, codes, _ = self.rpn(batch["points"])
        labels = batch["labels"]
        positive = labels == FOREGROUND
        terms = self.point_loss.classification(
            logits[positive].float(), logits[labels == BACKGROUND].float()
        )
        return terms | self.code.loss(
            codes[positive].float(), self._relative(batch["own"], batch["points"][positive])
        )

    def _relative(self, boxes_velo: Tensor, places: Tensor) -> Tensor:
        own = centered(boxes_velo)
        return torch.cat([own[:, :3] - places, own[:, 3:]], dim=1)

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of the foreground's and of the background's points."""
        logits, labels = self.rpn(batch["points"])[0], batch["labels"]
        return logits[labels == FOREGROUND], logits[labels == BACKGROUND]

    @torch.no_grad()
    def _propose(
        self, points: Tensor, training: bool
    ) -> tuple[list[Array], list[Array], Tensor, Tensor]:
        """Proposals of each frame, their scores, and all points' logits and features."""
        logits, codes, features = self.rpn(points)
        boxes = self.code.decode(codes.flatten(0, 1).float())
        boxes[:, :3] += points.flatten(0, 1)
        boxes[:, 2] -= boxes[:, 3] / 2
        boxes_velo = boxes.view(*points.shape[:2], 7).double().cpu().numpy()
        raw = logits.float().cpu().numpy()
        rule, chosen, scores = self.rules[training], [], []
        for own, of in zip(boxes_velo, raw, strict=True):
            kept = rule.choose(own, of)
            chosen.append(own[kept])
            scores.append(of[kept])
        return chosen, scores, logits, features

    def _pool(
        self, batch: Batch, logits: Tensor, features: Tensor, regions: Tensor, frames: Tensor
    ) -> tuple[Tensor, Tensor]:
        points = batch["points"]
        mark = (torch.sigmoid(logits) > self.second.mask).to(points.dtype)
        depth = points.norm(dim=-1) / DEPTH_SCALE - 0.5
        rows = torch.cat([mark[..., None], depth[..., None], features], dim=-1)
        return pool(points, rows, regions, frames, self.second.extra, self.second.points)

    def _refinement_loss(self, batch: Batch) -> Mapping[str, Tensor]:
        assert self.rcnn is not None
        proposals, _, logits, features = self._propose(batch["points"], training=True)
        rng = np.random.default_rng(int(torch.randint(2**62, ())))
        rows = batch["objects"].double().cpu().numpy()
        objects = [rows[rows[:, 0] == frame, 1:] for frame in range(len(proposals))]
        drawn = [self.second.rois.draw(p, o, rng) for p, o in zip(proposals, objects, strict=True)]
        counts = [len(regions) for regions, _, _ in drawn]
        regions, targets, overlaps = (
            torch.from_numpy(np.concatenate(part)).to(logits.device)
            for part in zip(*drawn, strict=True)
        )
        frames = torch.arange(len(counts)).repeat_interleave(torch.tensor(counts)).to(logits.device)
        regions, targets = regions.float(), targets.float()
        rows_in, held = self._pool(batch, logits, features, regions, frames)
        relative = relative_to_regions(targets, regions)
        self._augment(rows_in, relative, rng)
        scores, codes = self.rcnn(rows_in)
        rule = self.second.rois
        positive, negative = (overlaps > rule.positive_iou) & held, (overlaps < rule.bg_iou) & held
        terms = self._region_loss(scores[positive].float(), scores[negative].float())
        learnt = (overlaps > rule.regress_iou) & held
        return terms | self.roi_code.loss(codes[learnt].float(), relative[learnt])

    def _region_loss(self, positive: Tensor, negative: Tensor) -> dict[str, Tensor]:
        if self.second.classification == "focal":
            return self.point_loss.classification(positive, negative)
        count = max(1, len(positive) + len(negative))
        return {
            "cls_pos": F.softplus(-positive).sum() / count,
            "cls_neg": F.softplus(negative).sum() / count,
        }

    def _augment(self, rows: Tensor, boxes: Tensor, rng: np.random.Generator) -> None:
        """Scale and flip each region, in place; turning the scene would not change what a region sees of itself."""
        limit = self.second.scale
        scale = rows.new_tensor(rng.uniform(1 - limit, 1 + limit, len(rows)))
        flip = rows.new_tensor(rng.choice([-1.0, 1.0], len(rows)))
        rows[..., :3] *= scale[:, None, None]
        rows[..., 1] *= flip[:, None]
        boxes[:, :6] *= scale[:, None]
        boxes[:, 1] *= flip
        boxes[:, 6] *= flip

    @torch.no_grad()
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        """Refined proposals, or proposals as long as there is no second stage."""
        proposals, scores, logits, features = self._propose(batch["points"], training=False)
        if self.rcnn is not None:
            counts = [len(boxes) for boxes in proposals]
            every = torch.from_numpy(np.concatenate(proposals)).to(logits.device).float()
            frames = (
                torch.arange(len(counts)).repeat_interleave(torch.tensor(counts)).to(logits.device)
            )
            refined, codes = self.rcnn(self._pool(batch, logits, features, every, frames)[0])
            boxes_velo = (
                from_regions(self.roi_code.decode(codes.float()), every).double().cpu().numpy()
            )
            ends = np.cumsum(counts)[:-1]
            proposals, scores = (
                np.split(boxes_velo, ends),
                np.split(refined.float().cpu().numpy(), ends),
            )
        found = []
        for boxes, raw in zip(proposals, scores, strict=True):
            best = top_scores(raw, max_boxes, min_score)
            boxes[:, 6] = wrap(boxes[:, 6])
            found.append(Found(boxes[best], sigmoid(raw[best])))
        return found

    def example(self) -> Batch:
        """A frame of points."""
        return {"points": torch.zeros(1, self.n_points, 3)}
