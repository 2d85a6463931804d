"""Frustum ConvNet: slabs of points behind 2D boxes, a convolution along each frustum, and a refinement of its boxes.

Wang and Jia: Frustum ConvNet: Sliding Frustums to Aggregate Local Point-Wise Features for Amodal 3D Object Detection.
IROS 2019. Frustums stand at the camera, with the LiDAR's axes (x forward, y left, z up) turned so that x points through
the middle of the 2D box; the paper's camera axes are the same but for their names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from fl3d.data.kitti import Frame
from fl3d.detectors.base import Batch, Detector, Found, Sample
from fl3d.detectors.frustum_net import FrustumNet
from fl3d.detectors.frustums import (
    by_frame,
    enlarged,
    jittered,
    label_places,
    moved,
    rays,
    sampled,
    suppressed,
    turned,
)
from fl3d.detectors.multibin import MultiBin
from fl3d.detectors.regions import centered, turned_back
from fl3d.errors import DataError
from fl3d.geometry.boxes import Array, points_inside
from fl3d.losses import BalancedFocalLoss
from fl3d.points.slabs import resolutions

LEAST_HEIGHT, LEAST_WIDTH = 5.0, 1.0  # pixels of a 2D box that is looked at
LEAST_TRAIN_HEIGHT = 25.0  # pixels of an object that is learnt from its 2D box
ACROSS = np.pi / 2  # the second stage's axis lies across a box, as its code's does: its depth is the width


@dataclass(frozen=True)
class Jitter:
    """How training boxes differ from the labels'.

    Args:
        shift: of a 2D box, share of its size; of a refined box likewise.
        size: change of its size, as a share.
        yaw: of a refined box, degrees.
        depth: spread of the shift along the frustum, as a share of the object's diagonal; normal.
        most: largest such shift, in the same unit, or in metres for refined boxes.
    """

    shift: float
    size: float
    yaw: float
    depth: float
    most: float


class FConvNet(Detector):
    """Frustum ConvNet.

    Args:
        loss: classification of reference points.
        sizes: mean h, w, l of car, pedestrian, cyclist in metres.
        yaw_bins: of headings.
        weights: of the loss's terms, see ``MultiBin``.
        reach: first and last depth of a frustum, metres.
        nearest: points nearer to the LiDAR are left out, metres.
        points: of a frustum.
        frustums: of a frame in training.
        slabs: columns of the four resolutions, see ``points.slabs.Slabs``.
        blocks: widths of the four blocks.
        up: see ``FrustumNet``.
        label_ratio: a reference point in the object shrunk to the first share is positive, outside the second negative.
        jitter: see ``Jitter``.
        flip: probability of left for right.
        refine: the second stage: ``reach``, ``points``, ``enlarge``, ``slabs``, ``blocks``, ``up``, ``label_ratio``,
            ``jitter``, ``candidates``; None: there is none yet.
    """

    NAME = "F-ConvNet"
    STAGES = ("frustum", "refine")
    AUGMENTED = False  # 2D boxes stay where they were
    IMAGE_BOXES = True

    def __init__(
        self,
        loss: BalancedFocalLoss,
        sizes: Sequence[Sequence[float]],
        yaw_bins: int,
        weights: Mapping[str, float],
        reach: tuple[float, float],
        nearest: float,
        points: int,
        frustums: int,
        slabs: Mapping[str, Sequence[Any]],
        blocks: Sequence[int],
        up: int,
        label_ratio: tuple[float, float],
        jitter: Mapping[str, float],
        flip: float,
        refine: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__()
        self.point_loss, self.nearest, self.flip = loss, nearest, flip
        self.n_points, self.n_frustums = points, frustums
        self.label_ratio, self.jitter = label_ratio, Jitter(**jitter)
        self.code = MultiBin(sizes, yaw_bins, weights)
        self.frustum = FrustumNet(resolutions(slabs), reach, blocks, up, self.code)
        self.refine: FrustumNet | None = None
        if refine is not None:
            self.second, self.second_jitter = refine, Jitter(**refine["jitter"])
            own = resolutions(refine["slabs"])
            self.refine = FrustumNet(own, refine["reach"], refine["blocks"], refine["up"], self.code)
            self.frustum.requires_grad_(False)

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Points of frustums behind 2D boxes, or, training the second stage, of jittered boxes; and their objects."""
        if training:
            cars = frame.labels.types == "Car"
            if self.refine is None:
                cars &= frame.labels.boxes_image[:, 3] - frame.labels.boxes_image[:, 1] >= LEAST_TRAIN_HEIGHT
            objects = frame.calibration.boxes_to_velo(frame.labels.boxes_cam[cars])
            held = points_inside(frame.points_velo, objects).any(axis=1)
            objects, boxes_image = objects[held], frame.labels.boxes_image[cars][held]
            drawn = rng.integers(len(objects), size=self.n_frustums if len(objects) else 0)
            if self.refine is not None:
                return self._encode_boxes(frame, objects[drawn], rng)
            return self._encode_frustums(
                frame, jittered(boxes_image[drawn], self.jitter.shift, self.jitter.size, rng), objects[drawn], rng
            )
        if frame.image_boxes is None:
            raise DataError("Frustum ConvNet needs 2D boxes, in rgb_detection_train.txt and _val.txt", "rgb_detections")
        sample = self._encode_frustums(frame, frame.image_boxes[:, :4], None, rng)
        sample["image_scores"] = frame.image_boxes[:, 4][sample.pop("kept")].astype(np.float32)
        if self.refine is not None:  # stage one's boxes choose among all points
            cloud = frame.points_velo[frame.points_velo[:, 0] > self.nearest, :3]
            sample["cloud"] = cloud[rng.permutation(len(cloud))]
        return sample

    def _encode_frustums(
        self, frame: Frame, boxes_image: Array, objects: Array | None, rng: np.random.Generator
    ) -> Sample:
        """Frustums that hold points; with objects their labels too."""
        width, height = frame.image_size
        boxes = np.clip(boxes_image, 0, np.array([width - 1, height - 1] * 2))
        points_velo = frame.points_velo[frame.points_velo[:, 0] > self.nearest, :3].astype(np.float64)
        pixels, depth = frame.calibration.points_to_image(frame.calibration.points_to_cam(points_velo))
        ahead = depth > 0
        points_velo, pixels = points_velo[ahead], pixels[ahead]
        origin, directions = rays(frame.calibration, (boxes[:, :2] + boxes[:, 2:]) / 2)
        kept, rows, boxes_out = [], [], []
        angle = np.arctan2(directions[:, 1], directions[:, 0])
        slope = directions[:, 2] / np.hypot(directions[:, 0], directions[:, 1])
        for k, box in enumerate(boxes):
            inside = ((pixels >= box[:2]) & (pixels <= box[2:])).all(axis=1)
            is_small = box[3] - box[1] < LEAST_HEIGHT or box[2] - box[0] < LEAST_WIDTH
            if is_small or not inside.any():
                continue
            own = turned(points_velo[inside] - origin, -angle[k])
            target = None if objects is None else moved(objects[k : k + 1], -origin, -angle[k])[0]
            low, high = self.frustum.reach
            if not (low <= target[0] < high if target is not None else (own[:, 0] < high).any()):
                continue
            own = sampled(own, self.n_points, rng)
            if target is not None:
                spread = self.jitter.depth * np.hypot(target[4], target[5])
                limit = self.jitter.most * np.hypot(target[4], target[5])
                self._augment(own, target, float(np.clip(rng.normal(0, spread), -limit, limit)), rng)
                boxes_out.append(target)
            kept.append(k)
            rows.append(own)
        return self._frustum_sample(rows, angle[kept], slope[kept], origin, boxes_out, kept)

    def _frustum_sample(
        self, rows: list[Array], angle: Array, slope: Array, origin: Array, boxes: list[Array], kept: list[int]
    ) -> Sample:
        sample: Sample = {
            "points": np.array(rows, dtype=np.float32).reshape(-1, self.n_points, 3),
            "angle": angle.astype(np.float32),
            "slope": slope.astype(np.float32),
            "origin": np.tile(origin, (len(kept), 1)).astype(np.float32),
        }
        if boxes:
            sample["boxes"] = np.array(boxes, dtype=np.float32)
        else:
            sample["kept"] = np.array(kept, dtype=np.int64)
        return sample

    def _augment(self, points: Array, box: Array, shift: float, rng: np.random.Generator) -> None:
        """Flip and shift along the axis, in place; the box stays within the frustum's depth."""
        if rng.random() < self.flip:
            points[:, 1] *= -1
            box[[1, 6]] *= -1
        low, high = self.frustum.reach
        shift = float(np.clip(box[0] + shift, low, high)) - box[0]
        points[:, 0] += shift
        box[0] += shift

    def _encode_boxes(self, frame: Frame, objects: Array, rng: np.random.Generator) -> Sample:
        """The second stage's training samples: jittered objects, enlarged, as if the first stage had found them."""
        cloud = frame.points_velo[frame.points_velo[:, 0] > self.nearest, :3].astype(np.float64)
        rule, n = self.second_jitter, len(objects)
        found = objects.copy()
        shift = found[:, [5, 4, 3]] * self.second["enlarge"] * rng.uniform(-rule.shift, rule.shift, (n, 3))
        found[:, :3] += np.concatenate(
            [turned(s[None], yaw) for s, yaw in zip(shift, found[:, 6], strict=True)] or [shift]
        )
        found[:, 3:6] *= 1 + rng.uniform(-rule.size, rule.size, (n, 3))
        found[:, 6] += np.deg2rad(rng.uniform(-rule.yaw, rule.yaw, n))
        rows, boxes = [], []
        for box, target in zip(found, objects, strict=True):
            own = cloud[points_inside(cloud, enlarged(box[None], self.second["enlarge"]))[0]]
            if len(own):
                center = box[:3] + [0, 0, box[3] / 2]
                points = sampled(turned(own - center, -box[6] - ACROSS), self.second["points"], rng)
                relative = moved(target[None], -center, -box[6] - ACROSS)[0]
                spread = rule.depth * np.hypot(target[4], target[5])
                shift = float(np.clip(rng.normal(0, spread), -rule.most, rule.most))
                if rng.random() < self.flip:
                    points[:, 1] *= -1
                    relative[[1, 6]] *= -1
                points[:, 0] += shift
                relative[0] += shift
                rows.append(points)
                boxes.append(relative)
        return {
            "points": np.array(rows, dtype=np.float32).reshape(-1, self.second["points"], 3),
            "boxes": np.array(boxes, dtype=np.float32).reshape(-1, 7),
        }

    def collate(self, samples: list[Sample]) -> Batch:
        """Concatenate frustums; how many each frame has is told."""
        batch: Batch = {"counts": torch.tensor([len(s["points"]) for s in samples])}
        for key in ("points", "angle", "slope", "origin", "image_scores"):
            if key in samples[0]:
                batch[key] = torch.from_numpy(np.concatenate([s[key] for s in samples]))
        if any("boxes" in s for s in samples):
            none = np.zeros((0, 7), dtype=np.float32)
            batch["boxes"] = torch.from_numpy(np.concatenate([s.get("boxes", none) for s in samples]))
        if "cloud" in samples[0]:
            batch["cloud_sizes"] = torch.tensor([len(s["cloud"]) for s in samples])
            batch["cloud"] = torch.from_numpy(np.concatenate([s["cloud"] for s in samples]))
        return batch

    def forward(self, batch: Batch) -> tuple[Tensor, ...]:
        """Logits (K, L) and codes (K, L, width) of frustums; with a second stage those of as many boxes too."""
        found = self.frustum(batch["points"], batch["slope"])
        if self.refine is None:
            return tuple(found)
        points = batch["points"].new_zeros(len(batch["points"]), self.second["points"], 3)
        return (*found, *self.refine(points, torch.zeros_like(batch["slope"])))

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Of the first stage, or of the second once there is one."""
        if not len(batch["points"]):
            return {}  # frames without a car: nothing to learn
        logits, codes, places, labels = self._labelled(batch)
        terms = self.point_loss.classification(logits[labels == 1].float(), logits[labels == 0].float())
        own = batch["boxes"][:, None].expand(-1, labels.shape[1], -1)[labels == 1].clone()
        own[:, :3] -= places[labels == 1]
        return terms | self.code.loss(codes[labels == 1].float(), centered(own))

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of the positive and of the negative reference points of the stage that is trained."""
        if not len(batch["points"]):
            none = batch["points"].new_zeros(0)
            return none, none
        logits, _, _, labels = self._labelled(batch)
        return logits[labels == 1], logits[labels == 0]

    def _labelled(self, batch: Batch) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Logits, codes, reference points, and what these are: 1 positive, 0 negative, -1 neither."""
        network, ratio = self.frustum, self.label_ratio
        slope = batch["slope"] if "slope" in batch else batch["points"].new_zeros(len(batch["points"]))
        if self.refine is not None:
            network, ratio = self.refine, self.second["label_ratio"]
        logits, codes = network(batch["points"], slope)
        places = network.places(slope, 1)
        return logits, codes, places, label_places(places, batch["boxes"], ratio)

    @torch.no_grad()
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        """Boxes of all reference points that say object; score: the mean of the 2D detector's and the networks'."""
        counts = batch["counts"].tolist()
        found = [Found(np.zeros((0, 7)), np.zeros(0))] * len(counts)
        if sum(counts):
            boxes, p, frustum = self._find(self.frustum, batch["points"], batch["slope"])
            scores = (p + batch["image_scores"].double()[frustum]) / 2
            boxes = turned_back(boxes, batch["angle"][frustum], batch["origin"][frustum])
            frames = torch.repeat_interleave(torch.arange(len(counts), device=boxes.device), batch["counts"])[frustum]
            limits = (max_boxes, min_score) if self.refine is None else (len(scores), 0.0)
            found = by_frame(boxes, scores, frames, len(counts), *limits)
        return found if self.refine is None else self._refined(batch, found, max_boxes, min_score)

    def _find(self, network: FrustumNet, points: Tensor, slope: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Centred boxes in the frustums' frames, their posteriors, and which frustum each is of."""
        logits, codes = network(points, slope)
        p = torch.sigmoid(logits.double())
        chosen = p > 0.5
        chosen[torch.arange(len(p)), p.argmax(dim=1)] = True  # at least the best
        frustum, place = chosen.nonzero(as_tuple=True)
        boxes = self.code.decode(codes[frustum, place].float())
        boxes[:, :3] += network.places(slope, 1)[frustum, place]
        return boxes, p[frustum, place], frustum

    def _refined(self, batch: Batch, found: list[Found], max_boxes: int, min_score: float) -> list[Found]:
        """The second stage on the best boxes of each frame, each looked at once more."""
        assert self.refine is not None
        clouds = torch.split(batch["cloud"], batch["cloud_sizes"].tolist())
        refined, n = [], self.second["points"]
        for one, cloud in zip(found, clouds, strict=True):
            best = suppressed(one, self.second["candidates"])
            cloud_velo = cloud.cpu().numpy().astype(np.float64)
            inside = points_inside(cloud_velo, enlarged(best.boxes_velo, self.second["enlarge"]))
            rows, kept = [], []
            for k, (box, mask) in enumerate(zip(best.boxes_velo, inside, strict=True)):
                if mask.any():
                    own = turned(cloud_velo[mask] - (box[:3] + [0, 0, box[3] / 2]), -box[6] - ACROSS)
                    rows.append(own[np.arange(n) % len(own)])
                    kept.append(k)
            if not rows:
                refined.append(Found(np.zeros((0, 7)), np.zeros(0)))
                continue
            points = torch.from_numpy(np.array(rows, dtype=np.float32)).to(cloud.device)
            before = torch.from_numpy(best.scores[kept]).to(cloud.device)
            boxes, p, frustum = self._find(self.refine, points, points.new_zeros(len(points)))
            scores = (p + 2 * before[frustum]) / 3  # network, network, 2D detector: a third each
            own_boxes = torch.from_numpy(best.boxes_velo[kept]).to(cloud.device).float()[frustum]
            boxes = turned_back(boxes, own_boxes[:, 6] + ACROSS, centered(own_boxes)[:, :3])
            refined += by_frame(boxes, scores, torch.zeros_like(frustum), 1, max_boxes, min_score)
        return refined

    def example(self) -> Batch:
        """A frame of as many frustums as in training."""
        return {"points": torch.zeros(self.n_frustums, self.n_points, 3), "slope": torch.zeros(self.n_frustums)}
