"""Sparse layers compute the dense layers' function: forward, gradients, statistics."""

import pickle
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor, nn

from fl3d.sparse import layers
from fl3d.sparse.background import BackgroundMap, dense, dense_bev, sum_in_blocks
from fl3d.sparse.layout import Layout, pack
from fl3d.sparse.rulebook import voxel_layout

Shape = tuple[int, int, int]
Layer = tuple[int, int, object, object, object]  # channels in and out, kernel, stride, padding

VOXELNET = (
    (10, 13, 17),
    [(3, 4, 3, (2, 1, 1), (1, 1, 1)), (4, 5, 3, 1, (0, 1, 1)), (5, 6, 3, (2, 1, 1), 1)],
)
FCN3D = ((16, 15, 22), [(1, 4, 5, 2, 2), (4, 5, 5, 2, 2), (5, 6, 3, 2, 1), (6, 6, 3, 1, 1)])
ODD = ((5, 9, 11), [(2, 4, 3, 1, 1), (4, 4, 3, 2, 1), (4, 3, (1, 3, 3), 1, (0, 1, 1))])
# On into two dimensions, the depth in the channels; "up" is a deconvolution.
BEV = (
    (5, 13, 16),
    [(2, 3, 3, (2, 1, 1), 1), (9, 5, (3, 3), 2, 1), (5, 6, (3, 3), 1, 1), (6, 4, "up", 1, 1)],
)
RAISED = (
    (4, 7, 9),
    [(8, 5, (3, 1), (1, 2), (0, 1)), (5, 3, "up", 1, 0)],
)  # begins in two dimensions
FORWARD, GRADIENT = 1e-12, 1e-10
CASES = (VOXELNET, FCN3D, ODD, BEV, RAISED)


class Flatten(nn.Module):
    def forward(self, x: Tensor) -> Tensor:
        return x.flatten(1, 2) if isinstance(x, Tensor) and x.dim() == 5 else x


def network(sparse: bool, config: Sequence[Layer], norm_first: bool) -> nn.Sequential:
    kinds = layers if sparse else nn
    modules: list[nn.Module] = []
    for c_in, c_out, kernel, stride, padding in config:
        if kernel == "up":
            conv, norm = (
                kinds.ConvTranspose2d(c_in, c_out, 3, stride, padding),
                kinds.BatchNorm2d(c_out),
            )
        elif isinstance(kernel, tuple) and len(kernel) == 2:
            conv, norm = (
                kinds.Conv2d(c_in, c_out, kernel, stride, padding),
                kinds.BatchNorm2d(c_out),
            )
        else:
            conv, norm = (
                kinds.Conv3d(c_in, c_out, kernel, stride, padding),
                kinds.BatchNorm3d(c_out),
            )
        flat = [] if isinstance(conv, nn.Conv3d) else [Flatten()]
        modules += flat + ([conv, norm, kinds.ReLU()] if norm_first else [conv, kinds.ReLU(), norm])
    return nn.Sequential(*modules)


def width(shape: Shape, config: Sequence[Layer]) -> int:
    """Channels of a voxel: a network that begins in two dimensions takes the depth for channels too."""
    return config[0][0] // (
        shape[0] if isinstance(config[0][2], tuple) and len(config[0][2]) == 2 else 1
    )


def pair(config: Sequence[Layer], norm_first: bool) -> tuple[nn.Sequential, nn.Sequential]:
    """A dense network and a sparse one of the same weights; no value is at ReLU's corner."""
    torch.manual_seed(0)
    dense, sparse = (
        network(False, config, norm_first).double(),
        network(True, config, norm_first).double(),
    )
    for parameter in dense.parameters():
        nn.init.normal_(parameter, std=0.4)
    sparse.load_state_dict(dense.state_dict())
    return dense, sparse


def scatter(values: Tensor, cells: Tensor, shape: Shape, batch: int) -> Tensor:
    grid = torch.zeros(batch, *shape, values.shape[1], dtype=values.dtype)
    return grid.index_put(tuple(cells.unbind(1)), values).movedim(-1, 1)


def through(
    network: nn.Sequential, values: Tensor, cells: Tensor, shape: Shape, batch: int
) -> Tensor:
    """Sort the voxels and send them through as a map."""
    b, z, y, x = cells.unbind(1)
    order = torch.argsort(((b * shape[0] + z) * shape[1] + y) * shape[2] + x)
    out = network(
        BackgroundMap.from_voxels(values[order], voxel_layout(cells[order], shape, batch))
    )
    assert isinstance(out, BackgroundMap)
    flat = any(isinstance(module, nn.BatchNorm2d) for module in network)
    return dense_bev(out) if flat else dense(out)


def random_cells(shape: Shape, batch: int, fill: float) -> Tensor:
    chosen = torch.rand(batch, *shape) < fill
    return torch.nonzero(chosen)[torch.randperm(int(chosen.sum()))]


def corners(shape: Shape, batch: int) -> Tensor:
    ends = [[0, n - 1] for n in shape]
    return torch.cartesian_prod(torch.arange(batch), *(torch.tensor(e) for e in ends))


def compare(
    dense: nn.Sequential,
    sparse: nn.Sequential,
    cells: Tensor,
    shape: Shape,
    batch: int,
    width: int,
    loose: float = 1.0,
) -> None:
    values = torch.randn(len(cells), width, dtype=torch.float64, requires_grad=True)
    again = values.detach().clone().requires_grad_()
    expected = dense(scatter(values, cells, shape, batch))
    found = through(sparse, again, cells, shape, batch)
    assert (found - expected).abs().max() <= loose * FORWARD * max(
        1.0, float(expected.detach().abs().max())
    )
    gradient = torch.randn_like(expected)
    dense.zero_grad()
    sparse.zero_grad()
    expected.backward(gradient)
    found.backward(gradient)
    pairs = [(a.grad, b.grad) for a, b in zip(dense.parameters(), sparse.parameters(), strict=True)]
    pairs += [(values.grad, again.grad)] if len(cells) else []
    for mine, theirs in pairs:
        assert mine is not None
        assert theirs is not None
        assert (mine - theirs).abs().max() <= loose * GRADIENT * max(1.0, float(mine.abs().max()))
    for mine, theirs in zip(dense.buffers(), sparse.buffers(), strict=True):
        torch.testing.assert_close(theirs, mine, rtol=loose * FORWARD, atol=loose * FORWARD)


@pytest.fixture(autouse=True)
def _never_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layers, "DENSE_FROM", float("inf"))


@pytest.mark.parametrize("norm_first", [False, True])
@pytest.mark.parametrize("batch", [1, 2])
@pytest.mark.parametrize("case", ["sparse", "corners", "empty", "dense"])
@pytest.mark.parametrize(("shape", "config"), CASES)
def test_a_map_goes_through_as_the_dense_grid_does(
    shape: Shape, config: list[Layer], case: str, batch: int, norm_first: bool
) -> None:
    dense, sparse = pair(config, norm_first)
    cells = corners(shape, batch)
    if case != "corners":
        cells = random_cells(shape, batch, {"sparse": 0.02, "empty": 0.0, "dense": 0.3}[case])
    for mode in (
        True,
        True,
        False,
    ):  # the running statistics of two steps, then evaluation with them
        dense.train(mode)
        sparse.train(mode)
        # An empty grid is constant before the first normalisation, which divides its zero spread, or what rounding
        # makes of it in the dense network, by sqrt(eps): 316 times larger, layer after layer.
        compare(
            dense,
            sparse,
            cells,
            shape,
            batch,
            width(shape, config),
            1e5 if case == "empty" else 1.0,
        )


def test_one_sample_may_be_empty() -> None:
    shape, config = VOXELNET
    dense, sparse = pair(config, norm_first=False)
    cells = random_cells(shape, 2, 0.05)
    compare(dense, sparse, cells[cells[:, 0] == 1], shape, 2, config[0][0])


def test_tensors_go_through_dense_and_the_states_have_the_same_keys() -> None:
    shape, config = ODD
    dense, sparse = pair(config, norm_first=True)
    assert list(dense.state_dict()) == list(sparse.state_dict())
    x = torch.randn(2, 2, *shape, dtype=torch.float64)
    torch.testing.assert_close(dense(x), sparse(x), rtol=FORWARD, atol=FORWARD)


def test_the_same_bits_each_time_whatever_the_order_of_the_voxels() -> None:
    shape, config = FCN3D
    cells = random_cells(shape, 2, 0.05)
    torch.manual_seed(1)
    values, seen = torch.randn(len(cells), 1), []
    for order in (torch.arange(len(cells)), torch.randperm(len(cells)), torch.arange(len(cells))):
        torch.manual_seed(2)
        sparse = network(True, config, norm_first=False)
        out = through(sparse, values[order], cells[order], shape, 2)
        out.square().sum().backward()
        seen.append([out, *(p.grad for p in sparse.parameters())])
    for other in seen[1:]:
        assert all(torch.equal(a, b) for a, b in zip(seen[0], other, strict=True))


def test_a_map_of_many_rows_becomes_dense(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(layers, "DENSE_FROM", 0.6)
    (shape, config), values = ODD, torch.ones(1, 2, dtype=torch.float64)
    dense, sparse = pair(config, norm_first=False)
    cells = random_cells(shape, 1, 0.9)
    values = torch.randn(len(cells), 2, dtype=torch.float64)
    _, z, y, x = cells.unbind(1)
    order = torch.argsort((z * shape[1] + y) * shape[2] + x)
    out = sparse(BackgroundMap.from_voxels(values[order], voxel_layout(cells[order], shape, 1)))
    assert isinstance(out, Tensor)
    torch.testing.assert_close(out, dense(scatter(values, cells, shape, 1)))


def test_a_layout_travels_as_one_tensor_and_arrives_whole() -> None:
    shape, config = VOXELNET
    _, sparse = pair(config, norm_first=False)
    cells = random_cells(shape, 2, 0.05)
    b, z, y, x = cells.unbind(1)
    layout = voxel_layout(
        cells[torch.argsort(((b * shape[0] + z) * shape[1] + y) * shape[2] + x)], shape, 2
    )
    assert layers.lay_out(layout, sparse) is not None
    packed, _ = pack(layout)
    again = pickle.loads(pickle.dumps(layout))
    assert torch.equal(pack(again)[0], packed)
    values = torch.randn(len(cells), 3, dtype=torch.float64)
    outs = [sparse(BackgroundMap.from_voxels(values, one)).dense() for one in (layout, again)]
    assert torch.equal(*outs)
    depth, here = 0, again
    while here.rules:
        (rule,) = here.rules.values()
        depth, here = depth + 1, rule.target
    assert depth == len(config)


def test_under_autocast_products_are_low_and_all_else_is_single() -> None:
    """The canvas is the same to the bit; rows move by what bfloat16 rounds of their difference from it."""
    shape, _ = VOXELNET
    torch.manual_seed(0)
    conv, norm = layers.Conv3d(3, 4, 3, (2, 1, 1), (1, 1, 1)), layers.BatchNorm3d(4)
    cells = random_cells(shape, 1, 0.05)
    _, z, y, x = cells.unbind(1)
    layout = voxel_layout(cells[torch.argsort((z * shape[1] + y) * shape[2] + x)], shape, 1)
    canvas = torch.randn(1, 3) + 1.0
    maps = []
    for low in (False, True):
        with torch.autocast("cpu", torch.bfloat16, enabled=low):
            rows = torch.randn(len(cells), 3, generator=torch.Generator().manual_seed(1))
            out = conv(BackgroundMap(canvas, rows, layout))
            assert out.canvas.dtype == out.rows.dtype == torch.float32
            after = norm(out)
            assert after.canvas.dtype == after.rows.dtype == torch.float32
            maps.append(out)
    single, lowered = maps
    assert torch.equal(single.canvas, lowered.canvas)
    below = single.canvas[single.layout.row_classes]
    change = (single.rows - lowered.rows).abs().max() / (single.rows - below).abs().max()
    assert 1e-5 < change < 2e-2


@pytest.mark.parametrize("case", [(16, 3, (2, 1, 1), 1), (8, 3, 1, (0, 1, 1))])
def test_a_single_small_grid_takes_another_way_to_the_same(
    case: tuple[int, int, object, object],
) -> None:
    channels, kernel, stride, padding = case
    torch.manual_seed(0)
    ours = layers.Conv3d(channels, 5, kernel, stride, padding)
    theirs = nn.Conv3d(channels, 5, kernel, stride, padding)  # type: ignore[arg-type]
    theirs.load_state_dict(ours.state_dict())
    x = torch.randn(1, channels, 5, 60, 120)
    assert layers.is_misjudged(x)
    found, expected = ours(x), theirs(x)
    torch.testing.assert_close(found, expected, rtol=1e-4, atol=1e-4)
    assert found.is_contiguous(memory_format=torch.channels_last_3d)
    for grad in (found, expected):
        grad.square().sum().backward()
    torch.testing.assert_close(ours.weight.grad, theirs.weight.grad, rtol=1e-3, atol=1e-2)


def test_a_map_of_one_layer_is_convolved_in_two_dimensions_to_the_same() -> None:
    torch.manual_seed(0)
    ours = layers.Conv3d(4, 5, 3, (2, 1, 1), 1).double()
    theirs = nn.Conv3d(4, 5, 3, (2, 1, 1), 1).double()
    theirs.load_state_dict(ours.state_dict())
    x = torch.randn(2, 4, 1, 9, 7, dtype=torch.float64)
    outs = [ours(x), theirs(x)]
    torch.testing.assert_close(*outs, rtol=1e-12, atol=1e-12)
    for out in outs:
        out.pow(3).sum().backward()
    torch.testing.assert_close(ours.weight.grad, theirs.weight.grad, rtol=1e-11, atol=1e-11)
    assert ours.weight.grad is not None
    assert not ours.weight.grad[:, :, [0, 2]].any()  # they see nothing but padding


@pytest.mark.parametrize(
    ("kernel", "stride", "padding"), [(5, 2, 2), (3, (1, 2, 2), (1, 1, 0)), (4, 2, (1, 0, 2))]
)
def test_neighbours_are_taken_in_pairs_to_the_same(
    kernel: int, stride: object, padding: object
) -> None:
    torch.manual_seed(0)
    ours = layers.Conv3d(8, 3, kernel, stride, padding).double()
    theirs = nn.Conv3d(8, 3, kernel, stride, padding).double()  # type: ignore[arg-type]
    theirs.load_state_dict(ours.state_dict())
    x = torch.randn(2, 8, 6, 9, 12, dtype=torch.float64)
    last = x.contiguous(memory_format=torch.channels_last_3d).requires_grad_()
    assert ours._fills_half_a_vector(last)
    plain = x.clone().requires_grad_()
    outs = [ours(last), theirs(plain)]
    torch.testing.assert_close(*outs, rtol=1e-12, atol=1e-12)
    for out in outs:
        out.pow(3).sum().backward()
    torch.testing.assert_close(last.grad, plain.grad, rtol=1e-10, atol=1e-10)
    torch.testing.assert_close(ours.weight.grad, theirs.weight.grad, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(("n_rows", "fill"), [(0, 0.0), (1, 1.0), (700, 0.5), (2000, 0.02)])
def test_sums_in_blocks_are_those_of_each_class(n_rows: int, fill: float) -> None:
    """What CUDA does instead of a sum for each class: classes of no row, of one, and of many blocks."""
    generator = torch.Generator().manual_seed(0)
    z, y, x = (
        torch.arange(3),
        torch.arange(5),
        (torch.rand(n_rows + 4, generator=generator) > fill).long(),
    )
    x[-1] = 1  # both classes are there, whether or not a row is
    sites = torch.stack([torch.arange(n_rows) % n for n in (1, 3, 5, n_rows + 1)], dim=1)
    layout = Layout(1, (z, y, x), sites)
    values = torch.randn(n_rows, 3, dtype=torch.float64, generator=generator)
    found = sum_in_blocks(values, layout)
    truth = torch.zeros(layout.n_canvas, 3, dtype=torch.float64).index_add_(
        0, layout.row_classes, values
    )
    torch.testing.assert_close(found, truth, rtol=1e-12, atol=1e-12)
