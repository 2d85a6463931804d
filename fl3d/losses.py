"""The losses of the papers: binary cross entropy and focal loss (Eq. 1-6), and what detectors make of them.

Yun, Tai, Wang, Liu, Liu: Focal Loss in 3D Object Detection. IEEE RA-L 2019: ``DetectionLoss`` (Eq. 7-11).
Lin, Goyal, Girshick, He, Dollar: Focal Loss for Dense Object Detection. ICCV 2017: ``BalancedFocalLoss``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
import torch.nn.functional as F
from torch import Tensor

from fl3d.core.errors import ConfigError, options
from fl3d.core.typed import NotNegative

REGRESSIONS = ("square", "smooth_l1")


def bce(x: Tensor, y: Tensor) -> Tensor:
    """Binary cross entropy, Eq. 2: -log(p_t). Its slope in x is y (p_t - 1), Eq. 3.

    Args:
        x: logits, any shape.
        y: +1 or -1, same shape.
    """
    return F.softplus(-y * x)


def focal(x: Tensor, y: Tensor, gamma: float) -> Tensor:
    """Focal loss, Eq. 4: -(1 - p_t)^gamma log(p_t). Its slope is Eq. 5; gamma = 0 is ``bce``.

    Computed from logits: log(p_t) and log(1 - p_t) are exact however sure the network is, so the stabilising
    constants that are added to p_t elsewhere are not needed.

    Args:
        x: logits, any shape.
        y: +1 or -1, same shape.
        gamma: focusing parameter, at least 0.
    """
    cross_entropy = bce(x, y)
    if gamma == 0:
        return cross_entropy
    log_one_minus_p_t = -F.softplus(y * x)
    return torch.exp(gamma * log_one_minus_p_t) * cross_entropy


@dataclass(frozen=True)
class DetectionLoss:
    """Classification and regression of a one-stage detector, both sides of Eq. 7-11.

    The enhanced form (right side) is ``normalize=True``; the original form (left side) is ``normalize=False``
    with alpha = beta = 1 and gamma = 0.

    Args:
        gamma: focusing parameter of the focal loss; 0 is BCE.
        alpha: weight of the positives (Eq. 10).
        beta: weight of the negatives (Eq. 11).
        eta: weight of the classification against the regression (Eq. 8).
        regression: ``square``, the squared error (3D-FCN), or ``smooth_l1`` (VoxelNet).
        sigma: of Smooth-L1, whose switch lies at 1 / sigma^2; the paper's code uses 3. Fast R-CNN (Eq. 3 there)
            has its switch at 1, and no sigma.
        normalize: divide by the numbers of positives and negatives.
        regression_weight: None: the regression is divided like the rest; a number: its sum times this (the paper's
            code for 3D-FCN: 0.02).

    Raises:
        ConfigError: a value out of its range.
    """

    gamma: float = 0.0
    alpha: float = 1.0
    beta: float = 1.0
    eta: float = 1.0
    regression: str = "square"
    sigma: float = 3.0
    normalize: bool = True
    regression_weight: NotNegative | None = None

    def __post_init__(self) -> None:
        if self.regression not in REGRESSIONS:
            raise ConfigError(
                f"loss.regression: no form '{self.regression}'. {options(self.regression, REGRESSIONS)}"
            )
        for name in ("gamma", "alpha", "beta", "eta", "sigma"):
            value = getattr(self, name)
            if not isinstance(value, int | float) or value < 0 or (name == "sigma" and value == 0):
                raise ConfigError(
                    f"loss.{name}: '{value}' is not a number of at least 0 (sigma: above 0)"
                )

    def classification(self, positive: Tensor, negative: Tensor) -> dict[str, Tensor]:
        """Weighted loss of positives and of negatives, times eta (Eq. 8, 10, 11).

        Args:
            positive: (N_pos,) logits of positive windows.
            negative: (N_neg,) logits of negative windows.
        """
        return {
            "cls_pos": self.eta
            * self.alpha
            * self._mean(focal(positive, torch.ones_like(positive), self.gamma)),
            "cls_neg": self.eta
            * self.beta
            * self._mean(focal(negative, -torch.ones_like(negative), self.gamma)),
        }

    def localization(self, u: Tensor, target: Tensor) -> Tensor:
        """Regression loss over the positives (Eq. 9): (N_pos, R) outputs and targets -> scalar."""
        if self.regression == "square":
            loss = (u - target) ** 2
        else:
            loss = F.smooth_l1_loss(u, target, reduction="none", beta=1 / self.sigma**2)
        per_positive = loss.sum(dim=-1)
        if self.regression_weight is not None:
            return self.regression_weight * per_positive.sum()
        return self._mean(per_positive)

    def _mean(self, losses: Tensor) -> Tensor:
        total = losses.sum()
        return total / max(1, losses.numel()) if self.normalize else total


@dataclass(frozen=True)
class BalancedFocalLoss:
    """The alpha-balanced focal loss, summed and divided by the number of positives (Lin et al. 2017, §3.2 and §4.1).

    The positives weigh ``alpha`` and the negatives ``1 - alpha``; PointRCNN and Frustum ConvNet train with it.

    Args:
        gamma: focusing parameter; 0 is weighed cross entropy.
        alpha: weight of the foreground, in 0..1.

    Raises:
        ConfigError: a value out of its range.
    """

    gamma: float = 2.0
    alpha: float = 0.75

    def __post_init__(self) -> None:
        if not isinstance(self.gamma, int | float) or self.gamma < 0:
            raise ConfigError(f"loss.gamma: '{self.gamma}' is not a number of at least 0")
        if not isinstance(self.alpha, int | float) or not 0 <= self.alpha <= 1:
            raise ConfigError(
                f"loss.alpha: '{self.alpha}' is not a number in 0..1; the background weighs 1 - alpha"
            )

    def classification(self, positive: Tensor, negative: Tensor) -> dict[str, Tensor]:
        """Loss of positives and of negatives, both divided by the number of positives, at least one.

        Args:
            positive: (N_pos,) logits.
            negative: (N_neg,) logits.
        """
        count = max(1, positive.numel())
        return {
            "cls_pos": self.alpha
            * focal(positive, torch.ones_like(positive), self.gamma).sum()
            / count,
            "cls_neg": (1 - self.alpha)
            * focal(negative, -torch.ones_like(negative), self.gamma).sum()
            / count,
        }
