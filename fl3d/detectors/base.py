"""What every detector offers, and what it passes around."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from fl3d.core.errors import ConfigError
from fl3d.data.classes import CARS
from fl3d.data.dataset import TargetRule
from fl3d.data.kitti import Frame

Sample = dict[str, NDArray[np.generic]]
Batch = dict[str, Any]  # tensors, and what else moves between devices by ``to``


@dataclass(frozen=True)
class Found:
    """What a detector finds in one frame, before non-maximum suppression and score cut.

    Args:
        boxes_velo: (N, 7), see ``geometry.boxes``.
        scores: (N,) posterior probabilities, falling.
        boxes_image: (N, 4) 2D boxes x1, y1, x2, y2 in pixels, of a detector that goes by such; None: the projections
            of its boxes stand for them.
        kinds: (N,) index of each box's class into the detector's ``classes``; None: all are of the first.
    """

    boxes_velo: NDArray[np.float64]
    scores: NDArray[np.float64]
    boxes_image: NDArray[np.float64] | None = None
    kinds: NDArray[np.int64] | None = None

    def types(self, classes: Sequence[str]) -> NDArray[np.str_] | None:
        """Names of the boxes' classes: (N,); None: all are cars."""
        if tuple(classes) == CARS:
            return None
        kinds = np.zeros(len(self.scores), dtype=np.int64) if self.kinds is None else self.kinds
        return np.array(classes, dtype=np.str_)[kinds]


class Detector(nn.Module, ABC):
    """A network that turns point clouds into boxes.

    A subclass receives plain arguments (its YAML, and the loss) and never a config object. Its network must not depend
    on the values of its loss, which refuses them itself: a plan builds it with one loss of a class for all.

    Attributes:
        VERSION: raised when the same config would train to another network; part of a stage's identity.
        NAME: as the papers write it.
        STAGES: the stages it can be trained in; a schedule names some of them, in this order.
        AUGMENTED: whether frames may be changed for it; False where it reads what changes leave as it was.
        LEARNS_FROM: label types of which a training frame must hold one, of a detector of cars; none: it learns from
            empty frames too. An epoch has as many frames in either case.
        IMAGE_BOXES: whether it reads what a 2D detector found.
        MOST_CLASSES: how many classes it detects at most, whatever they are called; None: any number. One that
            detects several takes their names as its argument ``classes``.
        classes: that it detects, in order.
        DENSE: its submodules of unchanging shapes where ``compute`` is ``dense``; what ``compile`` compiles.
    """

    VERSION: ClassVar[int] = 1
    NAME: ClassVar[str]
    STAGES: ClassVar[tuple[str, ...]]
    AUGMENTED: ClassVar[bool] = True
    LEARNS_FROM: ClassVar[tuple[str, ...]] = ()
    IMAGE_BOXES: ClassVar[bool] = False
    DENSE: ClassVar[tuple[str, ...]] = ()
    MOST_CLASSES: ClassVar[int | None] = 1
    classes: tuple[str, ...] = CARS

    def learns_from(self) -> tuple[str, ...]:
        """Label types of which a training frame must hold one, for the classes that it detects; none: of no type."""
        if self.classes == CARS or not self.LEARNS_FROM:
            return self.LEARNS_FROM
        targets = getattr(self, "targets", None)
        return tuple(targets.classes) if isinstance(targets, TargetRule) else self.classes

    def train(self, mode: bool = True) -> Self:
        """Set the mode; frozen parts, of an earlier stage, stay in evaluation mode."""
        super().train(mode)
        for part in self.children():
            parameters = list(part.parameters())
            if parameters and not any(parameter.requires_grad for parameter in parameters):
                part.eval()
        return self

    @abstractmethod
    def encode(self, frame: Frame, rng: np.random.Generator, training: bool) -> Sample:
        """Turn a frame into arrays: the network's input and, for training, its targets. Runs on the CPU.

        Args:
            frame: one frame.
            rng: all randomness of the sample.
            training: whether to add targets.
        """

    @abstractmethod
    def collate(self, samples: list[Sample]) -> Batch:
        """Join samples into the tensors of a batch, on the CPU."""

    @abstractmethod
    def loss(self, batch: Batch) -> Mapping[str, Tensor]:
        """Named loss terms of a batch; training minimises their sum. None at all: there is nothing to learn in it."""

    @abstractmethod
    def windows(self, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of the positive and of the negative windows of a batch with targets: (N_pos,), (N_neg,)."""

    @abstractmethod
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        """Boxes of each frame of a batch: of each class the best ``max_boxes`` above ``min_score``, not suppressed."""

    def compile_dense(self) -> None:
        """Let torch compile what is dense; parameters and their names stay.

        Raises:
            ConfigError: there is nothing to compile, or it is computed sparse.
        """
        if not self.DENSE or getattr(self, "compute", None) != "dense":
            raise ConfigError(
                f"compile: {self.NAME} has no dense layers to compile; try detector.compute=dense"
            )
        for (
            name
        ) in self.DENSE:  # the forward of each, for a Sequential's own compile() does nothing
            module = self.get_submodule(name)
            module.forward = torch.compile(module.forward, dynamic=False)

    @abstractmethod
    def example(self) -> Batch:
        """A batch of one empty frame, for counting FLOPs on the meta device."""


class WindowDetector(Detector):
    """A detector each of whose windows says whether it is an object, and where that one's box lies.

    So one pass gives boxes and windows. ``forward`` gives the logits of all windows, and what boxes are made of; a
    sample with targets holds all that one without them holds, to the bit.
    """

    @abstractmethod
    def boxes(self, logits: Tensor, codes: Tensor, max_boxes: int, min_score: float) -> list[Found]:
        """Decode the best windows of each frame, see ``detect``."""

    @abstractmethod
    def split(self, logits: Tensor, batch: Batch) -> tuple[Tensor, Tensor]:
        """Logits of the positive and of the negative windows, see ``windows``."""

    @torch.no_grad()
    def detect(self, batch: Batch, max_boxes: int, min_score: float) -> list[Found]:
        """Decode the best windows."""
        logits, codes = self(batch)
        return self.boxes(logits, codes, max_boxes, min_score)

    @torch.no_grad()
    def detect_with_positives(
        self, batch: Batch, max_boxes: int, min_score: float
    ) -> tuple[list[Found], Tensor]:
        """Of a batch with targets: what ``detect`` finds, and the positives of ``windows``."""
        logits, codes = self(batch)
        return self.boxes(logits, codes, max_boxes, min_score), self.split(logits, batch)[0]
