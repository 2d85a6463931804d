"""Regions of interest of a two-stage detector: chosen among proposals, and drawn for training.

Shi, Wang, Li: PointRCNN: 3D Object Proposal Generation and Detection from Point Cloud. CVPR 2019, §3.2 and §3.3.
Boxes are ``boxes_velo`` throughout, in NumPy: a hundred boxes are work for a CPU.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fl3d.core.typed import Count, NotNegative, Positive, Share
from fl3d.geometry.iou import bev_and_3d_iou_velo
from fl3d.geometry.nms import nms

Float = NDArray[np.float64]
# Jitter of a region: shift in metres, scale, turn in degrees; one of the rows is drawn (the code's five strengths).
STRENGTHS = np.array(
    [(0.2, 0.1, 15), (0.3, 0.15, 15), (0.5, 0.15, 20), (0.8, 0.15, 30), (1.0, 0.15, 60)]
)
KEEP_SHARE = 0.2  # of the jitters leave the region as it is


@dataclass(frozen=True)
class ProposalRule:
    """Which boxes of the first stage become proposals.

    Args:
        iou: above which a worse one is suppressed.
        count: proposals of a frame at most.
        candidates: boxes of a frame that enter suppression.
        depths: rows of nearest and farthest depth in metres and the share of both counts between them.
    """

    iou: Share
    count: Count
    candidates: Count
    depths: Sequence[tuple[NotNegative, Positive, Share]]

    def choose(self, boxes_velo: Float, scores: Float) -> NDArray[np.int64]:
        """Indices of the proposals of a frame, best score first: (N, 7), (N,) -> (P,)."""
        # The code compares boxes as if all stood across the road: their length along the camera's x.
        rectangles = np.column_stack([boxes_velo[:, [0, 1, 4, 5]], np.zeros(len(boxes_velo))])
        order = np.argsort(-scores, kind="stable")
        kept, depth = [], boxes_velo[order, 0]
        for (low, high, _), candidates, count in zip(
            self.depths, self._shares(self.candidates), self._shares(self.count), strict=True
        ):
            some = order[(depth > low) & (depth <= high)][:candidates]
            found = nms(rectangles[some], scores[some], self.iou, "standup", count)
            kept.append(some[found])
        chosen = np.concatenate(kept)
        return chosen[np.argsort(-scores[chosen], kind="stable")]

    def _shares(self, total: int) -> list[int]:
        """Of the depths, whole numbers; the last has the rest."""
        shares = [int(total * share) for _, _, share in self.depths[:-1]]
        return [*shares, total - sum(shares)]


@dataclass(frozen=True)
class RoiRule:
    """Which proposals the second stage learns from, and what it learns.

    Args:
        count: regions of a frame.
        foreground: share of them that overlap an object, at most.
        fg_iou: overlap of a foreground region, at least.
        bg_iou: overlap of a background region, below.
        easy_iou: overlap below which a background region is easy.
        hard: share of hard ones among the background.
        positive_iou: classified as object above this overlap; below ``bg_iou`` as none.
        regress_iou: box learnt above this overlap.
        tries: jitters of a foreground region, until one overlaps enough; the background has one.
    """

    count: Count
    foreground: Share
    fg_iou: Share
    bg_iou: Share
    easy_iou: Share
    hard: Share
    positive_iou: Share
    regress_iou: Share
    tries: Count

    def draw(
        self, proposals: Float, objects: Float, rng: np.random.Generator
    ) -> tuple[Float, Float, Float]:
        """Regions for training, jittered.

        Args:
            proposals: (P, 7).
            objects: (K, 7).
            rng: all randomness.

        Returns:
            regions (count, 7), each one's object (count, 7; itself where there is none), and their overlap (count,).
        """
        if not len(proposals):
            return np.zeros((0, 7)), np.zeros((0, 7)), np.zeros(0)
        best, owner = _best(proposals, objects)
        chosen, n_foreground = self._choose(best, rng)
        targets = objects[owner[chosen]] if len(objects) else proposals[chosen]
        regions, overlaps = proposals[chosen].copy(), best[chosen]
        open_ = np.ones(len(chosen), dtype=bool)
        for attempt in range(self.tries):
            if attempt == 1:
                open_[n_foreground:] = False
            if not open_.any():
                break
            moved = jitter(proposals[chosen[open_]], rng)
            regions[open_] = moved
            overlaps[open_] = _paired(moved, targets[open_]) if len(objects) else 0.0
            open_ &= overlaps < min(self.regress_iou, self.positive_iou)
        return regions, targets, overlaps

    def _choose(self, best: Float, rng: np.random.Generator) -> tuple[NDArray[np.int64], int]:
        fg = np.flatnonzero(best >= self.fg_iou)
        hard = np.flatnonzero((best >= self.easy_iou) & (best < self.bg_iou))
        easy = np.flatnonzero(best < self.easy_iou)
        if not len(hard) + len(easy):
            every = fg if len(fg) else np.arange(len(best))
            return rng.choice(every, self.count), self.count if len(fg) else 0
        n_fg = min(round(self.count * self.foreground), len(fg))
        n_bg = self.count - n_fg
        n_hard = 0 if not len(hard) else n_bg if not len(easy) else int(n_bg * self.hard)
        parts = [rng.permutation(fg)[:n_fg]]
        parts += [rng.choice(some, n) for some, n in ((hard, n_hard), (easy, n_bg - n_hard)) if n]
        return np.concatenate(parts), n_fg


def jitter(boxes_velo: Float, rng: np.random.Generator) -> Float:
    """Shift, scale and turn boxes at random; a fifth of them stays as it is."""
    n = len(boxes_velo)
    strength = STRENGTHS[rng.integers(len(STRENGTHS), size=n)]
    signs = rng.uniform(-1, 1, (n, 7))
    moved = boxes_velo.copy()
    moved[:, :3] += signs[:, :3] * strength[:, :1]
    moved[:, 3:6] *= 1 + signs[:, 3:6] * strength[:, 1:2]
    moved[:, 6] += signs[:, 6] * np.deg2rad(strength[:, 2])
    stays = rng.random(n) < KEEP_SHARE
    moved[stays] = boxes_velo[stays]
    return moved


def _best(boxes: Float, objects: Float) -> tuple[Float, NDArray[np.int64]]:
    if not len(objects):
        return np.zeros(len(boxes)), np.zeros(len(boxes), dtype=np.int64)
    overlaps = bev_and_3d_iou_velo(boxes, objects)[1]
    return overlaps.max(axis=1), overlaps.argmax(axis=1)


def _paired(boxes: Float, objects: Float) -> Float:
    return np.diagonal(bev_and_3d_iou_velo(boxes, objects)[1]).copy()
