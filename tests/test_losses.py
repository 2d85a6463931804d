"""Equations 2 to 11."""

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fl3d.errors import ConfigError
from fl3d.losses import DetectionLoss, bce, focal

logits = st.floats(-12, 12)
signs = st.sampled_from([-1.0, 1.0])
gammas = st.sampled_from([0.0, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0])


def p_t(x: torch.Tensor, y: float) -> torch.Tensor:
    """Eq. 1."""
    p = torch.sigmoid(x)
    return p if y == 1 else 1 - p


@given(logits, signs, gammas)
def test_focal_is_equation_4(value: float, sign: float, gamma: float) -> None:
    x = torch.tensor(value, dtype=torch.float64)
    expected = -((1 - p_t(x, sign)) ** gamma) * torch.log(p_t(x, sign))
    torch.testing.assert_close(focal(x, torch.tensor(sign).double(), gamma), expected, rtol=1e-7, atol=1e-12)


@given(logits, signs)
def test_gamma_zero_is_binary_cross_entropy(value: float, sign: float) -> None:
    x, y = torch.tensor(value), torch.tensor(sign)
    assert focal(x, y, 0.0) == bce(x, y)
    expected = torch.nn.functional.binary_cross_entropy_with_logits(x, (y + 1) / 2)
    torch.testing.assert_close(bce(x, y), expected)


@given(logits, signs, gammas)
def test_slope_is_equation_5_and_for_gamma_zero_equation_3(value: float, sign: float, gamma: float) -> None:
    x = torch.tensor(value, dtype=torch.float64, requires_grad=True)
    focal(x, torch.tensor(sign).double(), gamma).backward()
    p = p_t(x.detach(), sign)
    expected = sign * (1 - p) ** gamma * (gamma * p * torch.log(p) + p - 1)
    if gamma == 0:
        torch.testing.assert_close(expected, sign * (p - 1))
    torch.testing.assert_close(x.grad, expected, rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("gamma", [0.0, 0.5, 5.0])
@pytest.mark.parametrize("value", [-200.0, 200.0])
def test_certainty_gives_finite_loss_and_slope(value: float, gamma: float) -> None:
    x = torch.tensor(value, requires_grad=True)
    loss = focal(x, torch.tensor(1.0), gamma)
    loss.backward()
    assert torch.isfinite(loss)
    assert x.grad is not None
    assert torch.isfinite(x.grad)


def test_enhanced_form_by_hand() -> None:
    """Right side of Eq. 8-11 at p = 1/2, where -log(p_t) = log 2 and, with gamma = 1, half of it."""
    loss = DetectionLoss(gamma=1, alpha=1, beta=10, eta=0.5, regression="square")
    terms = loss.classification(torch.zeros(2), torch.zeros(8))
    half = torch.log(torch.tensor(2.0)) / 2
    torch.testing.assert_close(terms["cls_pos"], 0.5 * 1 * half)
    torch.testing.assert_close(terms["cls_neg"], 0.5 * 10 * half)
    u, target = torch.tensor([[1.0, 2.0], [0.0, 0.0]]), torch.zeros(2, 2)
    assert loss.localization(u, target) == pytest.approx(5 / 2)


def test_original_form_sums() -> None:
    """Left side of Eq. 8-11."""
    loss = DetectionLoss(eta=0.1, regression="square", normalize=False)
    terms = loss.classification(torch.zeros(2), torch.zeros(8))
    two = torch.log(torch.tensor(2.0))
    torch.testing.assert_close(terms["cls_pos"], 0.1 * 2 * two)
    torch.testing.assert_close(terms["cls_neg"], 0.1 * 8 * two)
    assert loss.localization(torch.ones(3, 2), torch.zeros(3, 2)) == 6


def test_the_codes_fixed_weight_of_the_regression_is_an_option() -> None:
    loss = DetectionLoss(regression="square", regression_weight=0.02)
    assert loss.localization(torch.ones(3, 2), torch.zeros(3, 2)) == pytest.approx(0.02 * 6)


def test_smooth_l1_switches_at_one_over_sigma_squared() -> None:
    loss = DetectionLoss(regression="smooth_l1", sigma=3)
    assert loss.localization(torch.tensor([[0.1]]), torch.zeros(1, 1)) == pytest.approx(0.5 * 9 * 0.01)
    assert loss.localization(torch.tensor([[1.0]]), torch.zeros(1, 1)) == pytest.approx(1 - 0.5 / 9)


def test_a_frame_without_cars_has_no_positive_loss() -> None:
    terms = DetectionLoss().classification(torch.zeros(0), torch.zeros(4))
    assert terms["cls_pos"] == 0
    assert torch.isfinite(terms["cls_neg"])


def test_bad_values_are_named() -> None:
    with pytest.raises(ConfigError, match=r"loss\.regression.*smooth_l1"):
        DetectionLoss(regression="smooth")
    with pytest.raises(ConfigError, match=r"loss\.gamma"):
        DetectionLoss(gamma=-1)
    with pytest.raises(ConfigError, match=r"loss\.gamma: 'abc'"):
        DetectionLoss(gamma="abc")  # type: ignore[arg-type]
