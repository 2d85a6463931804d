"""PointRCNN's box code: places and headings as a bin and a residual in it (Shi et al. 2019, §3.1 and §3.3).

Boxes are rows of x, y, z of their *centre*, h, w, l, yaw in metres and radians; x and y lie in the ground plane.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, pi

import torch
import torch.nn.functional as F
from torch import Tensor

from fl3d.core.errors import ConfigError

YAW, SIZE = 6, slice(3, 6)


@dataclass(frozen=True)
class BinCode:
    """Boxes relative to a reference place.

    Args:
        search: S, how far the centre may lie from the place along x and y, metres.
        bin: b, length of a bin, metres.
        yaw_bins: number of them.
        yaw_range: radians that they cover: 2 pi, or less around 0 where opposite headings are one.
        size: mean h, w, l of the class, metres.

    Raises:
        ConfigError: a bin that is not positive, or longer than the search range.
    """

    search: float
    bin: float
    yaw_bins: int
    yaw_range: float
    size: Sequence[float]

    def __post_init__(self) -> None:
        if not 0 < self.bin <= self.search:
            raise ConfigError(
                f"detector: bins of {self.bin} m do not fit a search range of {self.search} m"
            )

    @property
    def bins(self) -> int:
        """Along one axis."""
        return 2 * floor(self.search / self.bin + 1e-6)

    @property
    def width(self) -> int:
        """R, outputs of a place: bins and residuals of x and y, z, bins and residuals of yaw, size."""
        return 4 * self.bins + 1 + 2 * self.yaw_bins + 3

    def loss(self, outputs: Tensor, boxes: Tensor) -> dict[str, Tensor]:
        """Cross entropy of bins, Smooth-L1 of the right bins' residuals, three times that of sizes: means over boxes.

        Args:
            outputs: (N, R).
            boxes: (N, 7) relative to their places.
        """
        if not len(boxes):
            nothing = outputs.sum() * 0
            return {"reg_place": nothing, "reg_yaw": nothing, "reg_size": nothing}
        x, y, rx, ry, z, yaw, ryaw, size = self._split(outputs)
        bins, residuals = self._place_targets(boxes[:, :2])
        place = F.cross_entropy(x, bins[:, 0]) + F.cross_entropy(y, bins[:, 1])
        place = place + F.smooth_l1_loss(_pick(rx, bins[:, 0]), residuals[:, 0])
        place = place + F.smooth_l1_loss(_pick(ry, bins[:, 1]), residuals[:, 1])
        place = place + F.smooth_l1_loss(z[:, 0], boxes[:, 2])
        yaw_bin, yaw_residual = self._yaw_targets(boxes[:, YAW])
        turn = F.cross_entropy(yaw, yaw_bin) + F.smooth_l1_loss(_pick(ryaw, yaw_bin), yaw_residual)
        mean = boxes.new_tensor(self.size)
        return {
            "reg_place": place,
            "reg_yaw": turn,
            "reg_size": 3 * F.smooth_l1_loss(size, (boxes[:, SIZE] - mean) / mean),
        }

    def decode(self, outputs: Tensor) -> Tensor:
        """Boxes of the likeliest bins, relative to their places: (N, R) -> (N, 7)."""
        x, y, rx, ry, z, yaw, ryaw, size = self._split(outputs)
        columns = []
        for scores, residuals in ((x, rx), (y, ry)):
            chosen = scores.argmax(dim=1)
            columns.append((chosen + 0.5 + _pick(residuals, chosen)) * self.bin - self.search)
        chosen = yaw.argmax(dim=1)
        step = self.yaw_range / self.yaw_bins
        if self._is_full:
            turn = chosen * step + _pick(ryaw, chosen) * (step / 2)
        else:
            turn = (chosen + 0.5) * step + _pick(ryaw, chosen) * (step / 2) - self.yaw_range / 2
        turn = torch.remainder(turn + pi, 2 * pi) - pi
        mean = outputs.new_tensor(self.size)
        return torch.cat(
            [torch.stack([*columns, z[:, 0]], dim=1), size * mean + mean, turn[:, None]], dim=1
        )

    @property
    def _is_full(self) -> bool:
        return self.yaw_range > 2 * pi - 1e-6

    def _split(self, outputs: Tensor) -> tuple[Tensor, ...]:
        n, yaws = self.bins, self.yaw_bins
        return torch.split(outputs, [n, n, n, n, 1, yaws, yaws, 3], dim=1)

    def _place_targets(self, places: Tensor) -> tuple[Tensor, Tensor]:
        """Bins, and distances from their middles in bins; what lies too far is clipped into the last bin."""
        shifted = (places + self.search).clamp(0, 2 * self.search - 1e-3) / self.bin
        bins = shifted.floor().clamp(max=self.bins - 1)
        return bins.long(), shifted - bins - 0.5

    def _yaw_targets(self, yaw: Tensor) -> tuple[Tensor, Tensor]:
        """Bins, and distances from their middles in half bins."""
        step = self.yaw_range / self.yaw_bins
        if self._is_full:  # the first bin's middle is 0
            shifted = torch.remainder(yaw + step / 2, 2 * pi) / step
        else:  # a heading and its opposite are one
            shifted = torch.remainder(yaw + pi / 2, pi) - pi / 2
            shifted = (shifted + self.yaw_range / 2).clamp(1e-3, self.yaw_range - 1e-3) / step
        bins = shifted.floor().clamp(max=self.yaw_bins - 1)
        return bins.long(), 2 * (shifted - bins - 0.5)


def _pick(values: Tensor, index: Tensor) -> Tensor:
    return values.gather(1, index[:, None])[:, 0]
