"""Equations 2 to 11."""

from dataclasses import replace

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from fl3d.core.errors import ConfigError
from fl3d.losses import BalancedFocalLoss, DetectionLoss, bce, focal

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
    torch.testing.assert_close(
        focal(x, torch.tensor(sign).double(), gamma), expected, rtol=1e-7, atol=1e-12
    )


@given(logits, signs)
def test_gamma_zero_is_binary_cross_entropy(value: float, sign: float) -> None:
    x, y = torch.tensor(value), torch.tensor(sign)
    assert focal(x, y, 0.0) == bce(x, y)
    expected = torch.nn.functional.binary_cross_entropy_with_logits(x, (y + 1) / 2)
    torch.testing.assert_close(bce(x, y), expected)


@given(logits, signs, gammas)
def test_slope_is_equation_5_and_for_gamma_zero_equation_3(
    value: float, sign: float, gamma: float
) -> None:
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


def test_alpha_weighs_positives_beta_negatives_and_eta_both_but_not_the_regression() -> None:
    """Eq. 8-11 at p = 1/2 and gamma = 0, where every window loses log 2.

    Positives: eta alpha log 2 = 0.25 * 3 log 2 = 0.75 log 2. Negatives: eta beta log 2 =
    0.25 * 7 log 2 = 1.75 log 2. Regression: 1 + 4 = 5.
    """
    loss = DetectionLoss(alpha=3, beta=7, eta=0.25, regression="square")
    terms = loss.classification(torch.zeros(2), torch.zeros(8))
    two = torch.log(torch.tensor(2.0))
    torch.testing.assert_close(terms["cls_pos"], 0.75 * two)
    torch.testing.assert_close(terms["cls_neg"], 1.75 * two)
    assert loss.localization(torch.tensor([[1.0, 2.0]]), torch.zeros(1, 2)) == pytest.approx(5)


def test_weights_act_on_sums_as_they_do_on_means() -> None:
    """As above without the division: 2 * 0.75 log 2, 8 * 1.75 log 2, and 5 + 1 of two positives."""
    loss = DetectionLoss(alpha=3, beta=7, eta=0.25, regression="square", normalize=False)
    terms = loss.classification(torch.zeros(2), torch.zeros(8))
    two = torch.log(torch.tensor(2.0))
    torch.testing.assert_close(terms["cls_pos"], 1.5 * two)
    torch.testing.assert_close(terms["cls_neg"], 14 * two)
    u = torch.tensor([[1.0, 2.0], [0.0, 1.0]])
    assert loss.localization(u, torch.zeros(2, 2)) == pytest.approx(6)


@pytest.mark.parametrize("regression_weight", [None, 0.02])
@pytest.mark.parametrize("regression", ["square", "smooth_l1"])
def test_no_weight_of_the_classification_touches_the_regression(
    regression: str, regression_weight: float | None
) -> None:
    plain = DetectionLoss(regression=regression, regression_weight=regression_weight)
    weighed = replace(plain, gamma=2, alpha=3, beta=7, eta=0.25)
    u = torch.tensor([[1.0, 2.0], [0.0, 0.05]])
    assert plain.localization(u, torch.zeros(2, 2)) > 0
    assert weighed.localization(u, torch.zeros(2, 2)) == plain.localization(u, torch.zeros(2, 2))


def test_balanced_form_by_hand() -> None:
    """Lin et al. at p = 1/2 and gamma = 2, where a window loses log 2 / 4.

    Two positives: 3/4 * 2 * (log 2 / 4) / 2 = 3/16 log 2. Eight negatives, divided by the number
    of positives too: 1/4 * 8 * (log 2 / 4) / 2 = 4/16 log 2. Alpha exchanged with 1 - alpha would
    give 1/16 and 12/16.
    """
    terms = BalancedFocalLoss(gamma=2, alpha=0.75).classification(torch.zeros(2), torch.zeros(8))
    sixteenth = torch.log(torch.tensor(2.0)) / 16
    torch.testing.assert_close(terms["cls_pos"], 3 * sixteenth)
    torch.testing.assert_close(terms["cls_neg"], 4 * sixteenth)


def test_balanced_form_knows_which_windows_are_positive() -> None:
    """At p = 3/4 and gamma = 1: a positive loses 1/4 * log(4/3), a negative 3/4 * log 4."""
    logit = torch.log(torch.tensor([3.0]))
    terms = BalancedFocalLoss(gamma=1, alpha=0.2).classification(logit, logit)
    torch.testing.assert_close(terms["cls_pos"], 0.2 * torch.log(torch.tensor(4 / 3)) / 4)
    torch.testing.assert_close(terms["cls_neg"], 0.8 * torch.log(torch.tensor(4.0)) * 3 / 4)


def test_balanced_form_without_positives_divides_by_one() -> None:
    """Four negatives at p = 1/2 and gamma = 0: 1/4 * 4 log 2."""
    terms = BalancedFocalLoss(gamma=0, alpha=0.75).classification(torch.zeros(0), torch.zeros(4))
    assert terms["cls_pos"] == 0
    torch.testing.assert_close(terms["cls_neg"], torch.log(torch.tensor(2.0)))


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
    assert loss.localization(torch.tensor([[0.1]]), torch.zeros(1, 1)) == pytest.approx(
        0.5 * 9 * 0.01
    )
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
