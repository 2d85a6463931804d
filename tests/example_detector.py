"""The detector of docs/new_detector.md: a map of car centres from the heights of points, in sixty lines.

It is here to show, and to test, that a detector is one file and one YAML; it is no rival of the others.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import torch
from torch import Tensor, nn

from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame
from fl3d.data.voxels import Grid
from fl3d.detectors.base import Batch, Detector, Found, Sample
from fl3d.detectors.blocks import join, join_ragged, sigmoid, top_scores
from fl3d.losses import DetectionLoss


class HeightMap(Detector):
    """Highest point of each cell in; a logit and seven offsets of each cell out.

    Args:
        loss: classification and regression.
        range_velo: x0, y0, z0, x1, y1, z1 in metres.
        cell: edge of a cell, metres.
        width: channels.
        targets: which labels are positives.
    """

    NAME = "HeightMap"
    STAGES = ("warmup", "focal", "scratch")

    def __init__(
        self,
        loss: DetectionLoss,
        range_velo: Sequence[float],
        cell: float,
        width: int,
        targets: TargetRule,
    ) -> None:
        super().__init__()
        self.detection_loss, self.targets = loss, targets
        self.grid = Grid(range_velo, (cell, cell, range_velo[5] - range_velo[2]))
        self.cell = cell
        layers = [
            nn.Conv2d(1, width, 5, 1, 2),
            nn.ReLU(),
            nn.Conv2d(width, width, 5, 1, 2),
            nn.ReLU(),
        ]
        self.network = nn.Sequential(*layers, nn.Conv2d(width, 8, 1))

    def _cells(self, places: np.ndarray) -> np.ndarray:
        return ((places[:, [1, 0]] - self.grid.low[[1, 0]]) / self.cell).astype(np.int64)

    def _centers(self, cells: np.ndarray) -> np.ndarray:
        return (cells[:, [1, 0]] + 0.5) * self.cell + self.grid.low[:2]

    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        points = frame.points_velo[self.grid.inside(frame.points_velo)]
        heights = np.zeros(self.grid.shape[1:], dtype=np.float32)
        cells = self._cells(points)
        np.maximum.at(
            heights, (cells[:, 0], cells[:, 1]), points[:, 2] - self.grid.low[2].astype(np.float32)
        )
        sample: Sample = {"heights": heights}
        if training:
            boxes = self.targets.boxes_velo(frame)
            boxes = boxes[self.grid.inside(boxes)]
            sample["cells"] = self._cells(boxes)
            off = np.column_stack([boxes[:, :2] - self._centers(sample["cells"]), boxes[:, 2:]])
            sample["offsets"] = off.astype(np.float32)
        return sample

    def collate(self, samples: list[Sample]) -> Batch:
        batch: Batch = {"heights": join([s["heights"] for s in samples])}
        if "cells" in samples[0]:
            batch["cells"] = join_ragged([s["cells"] for s in samples])
            batch["offsets"] = torch.from_numpy(np.concatenate([s["offsets"] for s in samples]))
        return batch

    def forward(self, batch: Batch) -> Tensor:
        return self.network(batch["heights"][:, None]).movedim(1, -1)

    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        outputs, (frame, y, x) = self(batch), batch["cells"].unbind(1)
        own = outputs[frame, y, x]
        terms = self.detection_loss.classification(own[:, 0], self._negatives(outputs, batch))
        return terms | {"reg": self.detection_loss.localization(own[:, 1:], batch["offsets"])}

    def _negatives(self, outputs: Tensor, batch: Batch) -> Tensor:
        free = torch.ones(outputs.shape[:3], dtype=torch.bool)
        free[tuple(batch["cells"].unbind(1))] = False
        return outputs[..., 0][free]

    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        outputs = self(batch)
        return outputs[tuple(batch["cells"].unbind(1))][:, 0], self._negatives(outputs, batch)

    @torch.no_grad()
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        found = []
        for outputs in self(batch).double().cpu().numpy():
            flat = outputs.reshape(-1, 8)
            best = top_scores(flat[:, 0], max_boxes, min_score)
            cells = np.stack(np.unravel_index(best, outputs.shape[:2]), axis=1)
            boxes = np.column_stack([self._centers(cells) + flat[best, 1:3], flat[best, 3:]])
            found.append(Found(boxes, sigmoid(flat[best, 0])))
        return found

    def example(self) -> Batch:
        return {"heights": torch.zeros(1, *self.grid.shape[1:])}
