"""Batch normalisation in one pass with its ReLU: torch's function, and more of its digits."""

import pytest
import torch
from torch import Tensor, nn

from fl3d.detectors.blocks import conv_block
from fl3d.sparse import layers
from fl3d.sparse.norms import Relu, normalise

SHAPES = ((300, 8), (2, 3, 7, 11), (2, 5, 3, 4, 6), (1, 130, 9, 9), (3, 16, 50, 50))


def reference(x: Tensor, norm: nn.Module, relu: Relu) -> Tensor:
    x = torch.relu(x) if relu == "before" else x
    x = norm(x)
    return torch.relu(x) if relu == "behind" else x


def norms(channels: int, dim: int) -> tuple[nn.Module, nn.Module]:
    torch.manual_seed(1)
    ours = getattr(layers, f"BatchNorm{dim}d")(channels).double()
    theirs = getattr(nn, f"BatchNorm{dim}d")(channels).double()
    for parameter in ours.parameters():
        nn.init.normal_(parameter)
    theirs.load_state_dict(ours.state_dict())
    return ours, theirs


@pytest.mark.parametrize("relu", ["none", "before", "behind"])
@pytest.mark.parametrize("shape", SHAPES)
def test_outputs_gradients_and_statistics_are_those_of_torch(
    shape: tuple[int, ...], relu: Relu
) -> None:
    ours, theirs = norms(shape[1], max(1, len(shape) - 2))
    x = torch.randn(shape, dtype=torch.float64) * 3 + 1
    grad = torch.randn_like(x)
    found = []
    for norm, way in ((ours, normalise), (theirs, None)):
        own = x.clone().requires_grad_()
        out = reference(own, norm, relu) if way is None else way(norm, own, relu)  # type: ignore[arg-type]
        out.backward(grad)
        norm.eval()
        with torch.no_grad():
            later = reference(x, norm, relu) if way is None else way(norm, x, relu)  # type: ignore[arg-type]
        found.append([out, own.grad, later, *(p.grad for p in norm.parameters()), *norm.buffers()])
    for mine, other in zip(*found, strict=True):
        torch.testing.assert_close(mine, other, rtol=1e-11, atol=1e-11)


def test_a_map_that_is_nearly_constant_keeps_its_digits() -> None:
    """Torch's own loses three of them where channels lie last."""
    torch.manual_seed(0)
    x = torch.full((2, 8, 40, 200), 5.0)
    x[:, :, 20, :7] += torch.rand(2, 8, 7)
    norm = layers.BatchNorm2d(8)
    exact = nn.BatchNorm2d(8).double()(x.double())
    found = norm(x.contiguous(memory_format=torch.channels_last))
    assert (found - exact).abs().max() < 1e-6 * exact.abs().max()


@pytest.mark.parametrize("relu", ["none", "before", "behind"])
def test_what_is_not_a_number_stays_so(relu: Relu) -> None:
    norm = layers.BatchNorm1d(2)
    x = torch.randn(6, 2)
    x[3, 1] = torch.nan
    out = normalise(norm, x, relu)
    assert out[:, 1].isnan().all()
    assert not out[:, 0].isnan().any()


def test_one_value_a_channel_is_refused_and_none_passes() -> None:
    norm = layers.BatchNorm1d(3)
    with pytest.raises(ValueError, match="one value a channel"):
        norm(torch.zeros(1, 3))
    assert norm(torch.zeros(0, 3)).shape == (0, 3)


@pytest.mark.parametrize("order", ["conv_relu_norm", "conv_norm_relu"])
def test_a_block_is_its_three_layers_one_after_the_other(order: str) -> None:
    torch.manual_seed(0)
    block = conv_block(layers.Conv2d(3, 4, 3), layers.BatchNorm2d(4), order).double()
    plain = nn.Sequential(*block)
    x = torch.randn(2, 3, 8, 8, dtype=torch.float64)
    torch.testing.assert_close(block(x), plain(x), rtol=1e-12, atol=1e-12)
    assert list(block.state_dict()) == list(plain.state_dict())


def test_gradients_of_gradients_are_refused() -> None:
    x = torch.randn(4, 3, requires_grad=True)
    out = layers.BatchNorm1d(3)(x)
    with pytest.raises(RuntimeError, match="have no gradients themselves"):
        torch.autograd.grad(out.sum(), x, create_graph=True)


def test_what_was_looked_at_in_inference_mode_can_be_trained_afterwards() -> None:
    norm, x = layers.BatchNorm1d(37), torch.randn(5, 37)  # a width that no other test has
    with torch.inference_mode():
        norm.eval()(x)
    norm.train()(x).sum().backward()
    assert norm.bias.grad is not None
