"""The evaluator once more, as plainly as its rules read: one loop for each sentence, nothing shared, nothing fast.

The fast evaluator is held against this one on scenes made to be awkward.
"""

import numpy as np

from fl3d.data.labels import Labels
from fl3d.geometry.iou import bev_and_3d_iou_cam, image_iou

LIMITS = {"easy": (40, 0, 0.15), "moderate": (25, 1, 0.30), "hard": (25, 2, 0.50)}
NEIGHBOUR = {"car": "van", "pedestrian": "person_sitting", "cyclist": ""}
METRICS = {"image": 0, "bev": 1, "3d": 2}


def overlaps(det: Labels, gt: Labels, metric: str) -> np.ndarray:
    if metric == "image":
        return image_iou(det.boxes_image, gt.boxes_image)
    return bev_and_3d_iou_cam(det.boxes_cam, gt.boxes_cam)[METRICS[metric] - 1]


def role_of_gt(gt: Labels, g: int, name: str, level: str, variant: str) -> str:
    height, occlusion, truncation = LIMITS[level]
    kind, tall = str(gt.types[g]).lower(), gt.boxes_image[g, 3] - gt.boxes_image[g, 1]
    if kind == NEIGHBOUR[name]:
        return "ignored"
    if kind != name:
        return "absent"
    is_low = tall < height if variant == "A" else tall <= height
    return (
        "ignored"
        if gt.occluded[g] > occlusion or gt.truncated[g] > truncation or is_low
        else "counts"
    )


def role_of_det(det: Labels, d: int, name: str, level: str) -> str:
    if int(abs(det.boxes_image[d, 1] - det.boxes_image[d, 3])) < LIMITS[level][0]:
        return "ignored"
    return "counts" if str(det.types[d]).lower() == name else "absent"


class Frame:
    def __init__(
        self,
        gt: Labels,
        det: Labels,
        name: str,
        metric: str,
        level: str,
        variant: str,
        minimum: float,
    ) -> None:
        self.gt, self.det, self.minimum, self.metric = gt, det, minimum, metric
        self.overlap = overlaps(det, gt, metric)
        self.gts = [role_of_gt(gt, g, name, level, variant) for g in range(len(gt))]
        self.dets = [role_of_det(det, d, name, level) for d in range(len(det))]

    def candidates(self, g: int, taken: set[int], threshold: float) -> list[int]:
        return [
            d
            for d in range(len(self.det))
            if self.dets[d] != "absent"
            and d not in taken
            and self.det.scores[d] >= threshold
            and self.overlap[d, g] > self.minimum
        ]

    def hits(self) -> list[float]:
        taken: set[int] = set()
        scores = []
        for g, role in enumerate(self.gts):
            free = self.candidates(g, taken, -np.inf) if role != "absent" else []
            if free:
                best = max(free, key=lambda d: (self.det.scores[d], -d))
                taken.add(best)
                if role == "counts" and self.dets[best] == "counts":
                    scores.append(float(self.det.scores[best]))
        return scores

    def count(self, threshold: float) -> tuple[int, int]:
        taken: set[int] = set()
        tp = 0
        for g, role in enumerate(self.gts):
            free = self.candidates(g, taken, threshold) if role != "absent" else []
            if not free:
                continue
            valid = [d for d in free if self.dets[d] == "counts"]
            best = max(valid, key=lambda d: (self.overlap[d, g], -d)) if valid else free[0]
            taken.add(best)
            tp += role == "counts" and self.dets[best] == "counts"
        fp = 0
        for d in range(len(self.det)):
            if self.dets[d] == "counts" and d not in taken and self.det.scores[d] >= threshold:
                fp += not (self.metric == "image" and self.is_excused(d))
        return tp, fp

    def is_excused(self, d: int) -> bool:
        regions = np.array([str(t).lower() == "dontcare" for t in self.gt.types], dtype=bool)
        inside = image_iou(
            self.det.boxes_image[d : d + 1], self.gt.boxes_image[regions], over_a=True
        )
        return bool((inside > self.minimum).any())


def thresholds(hits: list[float], n_gt: int) -> list[float]:
    hits = sorted(hits, reverse=True)
    kept, wanted = [], 0.0
    for i, score in enumerate(hits):
        here, is_last = (i + 1) / n_gt, i == len(hits) - 1
        following = here if is_last else (i + 2) / n_gt
        if following - wanted < wanted - here and not is_last:
            continue
        kept.append(score)
        wanted += 1 / 40
    return kept


def evaluate_plainly(
    gt: list[Labels],
    det: list[Labels],
    name: str,
    metric: str,
    level: str,
    variant: str,
    minimum: float,
) -> tuple[int, list[float], list[int], list[int]]:
    frames = [
        Frame(g, d, name, metric, level, variant, minimum) for g, d in zip(gt, det, strict=True)
    ]
    n_gt = sum(frame.gts.count("counts") for frame in frames)
    cuts = thresholds([s for frame in frames for s in frame.hits()], n_gt) if n_gt else []
    counts = [[frame.count(cut) for frame in frames] for cut in cuts]
    return (
        n_gt,
        cuts,
        [sum(tp for tp, _ in c) for c in counts],
        [sum(fp for _, fp in c) for c in counts],
    )
