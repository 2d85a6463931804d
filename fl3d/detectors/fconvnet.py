"""Frustum ConvNet: slabs of points behind 2D boxes, a convolution along each frustum, and a refinement of its boxes.

Wang and Jia: Frustum ConvNet: Sliding Frustums to Aggregate Local Point-Wise Features for Amodal 3D Object Detection.
IROS 2019. What its stages are shown lies in ``frustum_samples``, their network in ``frustum_net``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from fl3d.core.errors import DataError
from fl3d.core.typed import Count, NotNegative, Positive, Whole, make
from fl3d.data.classes import CARS
from fl3d.data.kitti import Frame
from fl3d.data.labels import check_sizes
from fl3d.detectors.base import Batch, Detector, Found, Sample
from fl3d.detectors.frustum_net import FrustumNet
from fl3d.detectors.frustum_samples import ACROSS, BoxView, FrustumView, Jitter, cloud_velo
from fl3d.detectors.frustums import by_frame, label_places, suppressed
from fl3d.detectors.multibin import MultiBin
from fl3d.detectors.per_class import PerClass, further_sizes, least_points
from fl3d.detectors.regions import centered, turned_back
from fl3d.geometry.boxes import points_inside
from fl3d.losses import BalancedFocalLoss
from fl3d.points.slabs import resolutions

LEAST_TRAIN_HEIGHT = 25.0  # pixels of an object that is learnt from its 2D box
NOTHING = Found(np.zeros((0, 7)), np.zeros(0), np.zeros((0, 4)), np.zeros(0, dtype=np.int64))
KINDS = ("Car", "Pedestrian", "Cyclist")  # whose mean sizes `sizes` has


class FConvNet(Detector):
    """Frustum ConvNet.

    Args:
        loss: classification of reference points.
        sizes: mean h, w, l of car, pedestrian, cyclist in metres: the size classes that its network knows.
        yaw_bins: of headings.
        weights: of the loss's terms, see ``MultiBin``.
        reach: first and last depth of a frustum, metres.
        nearest: points nearer to the LiDAR are left out, metres.
        points: of a frustum.
        frustums: of a frame in training.
        slabs: columns of the four resolutions, see ``points.slabs.Slabs``.
        slabs_used: resolutions that the first stage sees, see ``FrustumNet``; None: all four.
        blocks: widths of the four blocks.
        up: see ``FrustumNet``.
        label_ratio: a reference point in the object shrunk to the first share is positive, outside the second negative.
        jitter: see ``Jitter``.
        refine: the second stage: ``reach``, ``points``, ``enlarge``, ``slabs``, ``blocks``, ``up``, ``label_ratio``,
            ``jitter``, ``candidates``; None: there is none yet.
        classes: that it detects; a 2D detection brings its class, and a box is of that class.
        per_class: of classes that are none of the three ``size``: a further size class each; of all ``min_points``.
    """

    VERSION = 2
    NAME = "F-ConvNet"
    STAGES = ("frustum", "refine")
    AUGMENTED = False  # 2D boxes stay where they were
    LEARNS_FROM = ("Car",)
    IMAGE_BOXES = True
    MOST_CLASSES = None

    def __init__(
        self,
        loss: BalancedFocalLoss,
        sizes: Sequence[tuple[Positive, Positive, Positive]],
        yaw_bins: Count,
        weights: Mapping[str, float],
        reach: tuple[float, float],
        nearest: NotNegative,
        points: Count,
        frustums: Count,
        slabs: Mapping[str, Sequence[Any]],
        blocks: Sequence[Count],
        up: Count,
        label_ratio: tuple[float, float],
        jitter: Mapping[str, float],
        refine: Mapping[str, Any] | None = None,
        slabs_used: Sequence[Whole] | None = None,
        classes: Sequence[str] = CARS,
        per_class: PerClass | None = None,
    ) -> None:
        super().__init__()
        self.classes = tuple(classes)
        self.least = least_points(per_class, classes)
        own_sizes = further_sizes(classes, KINDS, per_class)
        self.size_classes = np.array([(*KINDS, *own_sizes).index(name) for name in classes])
        self.point_loss, self.nearest = loss, nearest
        self.n_points, self.n_frustums, self.label_ratio = points, frustums, label_ratio
        self.view = FrustumView(reach, nearest, points, make(Jitter, jitter, "detector.jitter"))
        self.code = MultiBin([*sizes, *own_sizes.values()], yaw_bins, weights)
        self.frustum = FrustumNet(resolutions(slabs), reach, blocks, up, self.code, slabs_used)
        self.refine: FrustumNet | None = None
        if refine is not None:
            self.second, self.second_view = refine, BoxView.of(refine, nearest)
            own = resolutions(refine["slabs"])
            self.refine = FrustumNet(
                own, refine["reach"], refine["blocks"], refine["up"], self.code
            )
            self.frustum.requires_grad_(False)

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Points of frustums behind 2D boxes, or, training the second stage, of jittered boxes; and their objects."""
        if training:
            return self._encode_objects(frame, rng)
        if frame.image_boxes is None:
            raise DataError(
                "Frustum ConvNet needs 2D boxes, in rgb_detection_train.txt and _val.txt",
                "rgb_detections",
            )
        types = frame.image_types
        if types is None:
            types = np.full(len(frame.image_boxes), CARS[0])
        own = np.isin(types, self.classes)
        sample = self.view.look(frame, frame.image_boxes[own], self._kinds(types[own]), rng)
        if self.refine is not None:  # stage one's boxes choose among all points
            cloud = cloud_velo(frame, self.nearest)
            sample["cloud"] = cloud[rng.permutation(len(cloud))]
        return sample

    def _encode_objects(self, frame: Frame, rng: np.random.Generator) -> Sample:
        """As many of a frame's objects as are drawn, some of them more than once."""
        check_sizes(frame.labels, self.classes, frame.label_file)
        own = np.isin(frame.labels.types, self.classes)
        if self.refine is None:
            own &= (
                frame.labels.boxes_image[:, 3] - frame.labels.boxes_image[:, 1]
                >= LEAST_TRAIN_HEIGHT
            )
        labels = frame.labels.select(own)
        objects = frame.calibration.boxes_to_velo(labels.boxes_cam)
        points = points_inside(frame.points_velo, objects).sum(axis=1)
        held = points >= [max(1, self.least.get(str(name), 1)) for name in labels.types]
        objects, boxes_image = objects[held], labels.boxes_image[held]
        kinds = self._kinds(labels.types[held])
        drawn = rng.integers(len(objects), size=self.n_frustums if len(objects) else 0)
        if self.refine is not None:
            return self.second_view.learn(frame, objects[drawn], kinds[drawn], rng)
        return self.view.learn(frame, boxes_image[drawn], objects[drawn], kinds[drawn], rng)

    def _kinds(self, types: NDArray[np.str_]) -> NDArray[np.int64]:
        """Index into ``classes`` of names of classes: (N,)."""
        return np.array([self.classes.index(str(name)) for name in types], dtype=np.int64)

    def _sizes(self, kinds: Tensor) -> Tensor:
        """Size classes of classes: (K,)."""
        return torch.from_numpy(self.size_classes).to(kinds.device)[kinds]

    def collate(self, samples: list[Sample]) -> Batch:
        """Concatenate frustums; how many each frame has is told."""
        batch: Batch = {"counts": torch.tensor([len(s["points"]) for s in samples])}
        for key in samples[0]:
            batch[key] = torch.from_numpy(np.concatenate([s[key] for s in samples]))
        if "cloud" in samples[0]:
            batch["cloud_sizes"] = torch.tensor([len(s["cloud"]) for s in samples])
        return batch

    def forward(self, batch: Batch) -> tuple[Tensor, ...]:
        """Logits (K, L) and codes (K, L, width) of frustums; with a second stage those of as many boxes too."""
        kinds = self._sizes(batch["kinds"])
        found = self.frustum(batch["points"], batch["slope"], kinds)
        if self.refine is None:
            return tuple(found)
        points = batch["points"].new_zeros(len(batch["points"]), self.second["points"], 3)
        return (*found, *self.refine(points, torch.zeros_like(batch["slope"]), kinds))

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Of the first stage, or of the second once there is one."""
        if not len(batch["points"]):
            return {}  # frames without an object: nothing to learn
        logits, codes, places, labels = self._labelled(batch)
        terms = self.point_loss.classification(
            logits[labels == 1].float(), logits[labels == 0].float()
        )
        own = batch["boxes"][:, None].expand(-1, labels.shape[1], -1)[labels == 1].clone()
        own[:, :3] -= places[labels == 1]
        kinds = self._sizes(batch["kinds"])[:, None].expand_as(labels)[labels == 1]
        return terms | self.code.loss(codes[labels == 1].float(), centered(own), kinds)

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
        slope = (
            batch["slope"] if "slope" in batch else batch["points"].new_zeros(len(batch["points"]))
        )
        if self.refine is not None:
            network, ratio = self.refine, self.second["label_ratio"]
        logits, codes = network(batch["points"], slope, self._sizes(batch["kinds"]))
        places = network.places(slope, 1)
        return logits, codes, places, label_places(places, batch["boxes"], ratio)

    @torch.no_grad()
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        """Boxes of all reference points that say object; score: the mean of the 2D detector's and the networks'."""
        counts = batch["counts"].tolist()
        found = [NOTHING] * len(counts)
        if sum(counts):
            kinds = batch["kinds"]
            boxes, p, frustum = self._find(self.frustum, batch["points"], batch["slope"], kinds)
            scores = (p + batch["image_scores"].double()[frustum]) / 2
            boxes = turned_back(boxes, batch["angle"][frustum], batch["origin"][frustum])
            frames = torch.repeat_interleave(
                torch.arange(len(counts), device=boxes.device), batch["counts"]
            )[frustum]
            limits = (max_boxes, min_score) if self.refine is None else (len(scores), 0.0)
            images = batch["boxes_image"][frustum]
            found = by_frame(boxes, scores, images, kinds[frustum], frames, len(counts), *limits)
        if self.refine is None:
            return found
        clouds = torch.split(batch["cloud"], batch["cloud_sizes"].tolist())
        return [
            self._refined(one, cloud, max_boxes, min_score)
            for one, cloud in zip(found, clouds, strict=True)
        ]

    def _find(
        self, network: FrustumNet, points: Tensor, slope: Tensor, kinds: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Centred boxes in the frustums' frames, their posteriors, and which frustum each is of."""
        logits, codes = network(points, slope, self._sizes(kinds))
        p = torch.sigmoid(logits.double())
        chosen = p > 0.5
        chosen[torch.arange(len(p)), p.argmax(dim=1)] = True  # at least the best
        frustum, place = chosen.nonzero(as_tuple=True)
        boxes = self.code.decode(codes[frustum, place].float())
        boxes[:, :3] += network.places(slope, 1)[frustum, place]
        return boxes, p[frustum, place], frustum

    def _refined(self, found: Found, cloud: Tensor, max_boxes: int, min_score: float) -> Found:
        """The second stage on the best boxes of a frame, each looked at once more."""
        assert self.refine is not None
        best = suppressed(found, self.second["candidates"])
        rows, kept = self.second_view.look(cloud.cpu().numpy().astype(np.float64), best.boxes_velo)
        if not kept:
            return NOTHING
        points = torch.from_numpy(rows).to(cloud.device)
        assert best.kinds is not None
        kinds = torch.from_numpy(best.kinds[np.array(kept)]).to(cloud.device)
        slope = points.new_zeros(len(points))
        boxes, p, frustum = self._find(self.refine, points, slope, kinds)
        chosen = np.array(kept)[frustum.cpu().numpy()]
        before = torch.from_numpy(best.scores[chosen]).to(cloud.device)
        scores = (p + 2 * before) / 3  # network, network, 2D detector: a third each
        seen = torch.from_numpy(best.boxes_velo[chosen]).to(cloud.device).float()
        boxes = turned_back(boxes, seen[:, 6] + ACROSS, centered(seen)[:, :3])
        assert best.boxes_image is not None
        boxes_image = torch.from_numpy(best.boxes_image[chosen])
        frames = torch.zeros_like(frustum)
        limits = (1, max_boxes, min_score)
        return by_frame(boxes, scores, boxes_image, kinds[frustum], frames, *limits)[0]

    def example(self) -> Batch:
        """A frame of as many frustums as in training."""
        return {
            "points": torch.zeros(self.n_frustums, self.n_points, 3),
            "slope": torch.zeros(self.n_frustums),
            "kinds": torch.zeros(self.n_frustums, dtype=torch.int64),
        }
