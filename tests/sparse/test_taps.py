"""Convolutions of few channels, pair by pair, are the sums that a rulebook spells out."""

import numpy as np
import pytest
import torch

from fl3d.sparse.functions import has_few
from fl3d.sparse.rulebook import make_rulebook, voxel_layout
from fl3d.sparse.taps import FEW, add_taps, tap_gradients

N_IN, N_OUT, TAPS, PAIRS = 11, 7, 3, 5


@pytest.mark.parametrize(("c_in", "c_out"), [(1, 8), (3, 5), (8, 16), (24, 7)])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_they_add_what_each_pair_gives_and_receives(c_in: int, c_out: int, dtype: type) -> None:
    rng = np.random.default_rng(c_in)
    pairs = [(rng.permutation(N_IN)[:PAIRS], rng.permutation(N_OUT)[:PAIRS]) for _ in range(TAPS)]
    rows_in, rows_out = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
    offsets = np.arange(TAPS + 1) * PAIRS
    rows, weight, grad, before = (
        rng.normal(size=shape).astype(dtype)
        for shape in ((N_IN, c_in), (TAPS, c_in, c_out), (N_OUT, c_out), (N_OUT, c_out))
    )
    out, to_rows, to_weight = before.copy(), np.ones_like(rows), np.ones_like(weight)
    add_taps(out, rows, weight, rows_in, rows_out, offsets)
    tap_gradients(grad, rows, weight, rows_in, rows_out, offsets, to_rows, to_weight)
    weight_alone = np.ones_like(weight)
    tap_gradients(grad, rows, weight, rows_in, rows_out, offsets, None, weight_alone)
    assert (weight_alone == to_weight).all()

    own = before.astype(np.float64)
    own_rows, own_weight = np.ones(rows.shape), np.ones(weight.shape)
    for tap, (source, target) in enumerate(pairs):
        for i, o in zip(source, target, strict=True):
            own[o] += rows[i].astype(np.float64) @ weight[tap]
            own_rows[i] += weight[tap].astype(np.float64) @ grad[o]
            own_weight[tap] += np.outer(rows[i], grad[o])
    error = 1e-13 if dtype is np.float64 else 1e-5
    for found, true in ((out, own), (to_rows, own_rows), (to_weight, own_weight)):
        np.testing.assert_allclose(found, true, rtol=error, atol=error)


def test_they_are_for_few_channels_alone() -> None:
    rows = torch.zeros(2, 16)
    assert has_few(rows, torch.zeros(3, 16, FEW // 16))
    assert not has_few(rows, torch.zeros(3, 16, FEW // 16 + 1))
    assert not has_few(rows.bfloat16(), torch.zeros(3, 16, 1))


@pytest.mark.parametrize("stride", [(1, 1, 1), (2, 1, 1), (2, 2, 2), (1, 3, 2)])
@pytest.mark.parametrize(("kernel", "padding"), [((3, 3, 3), (1, 1, 1)), ((1, 2, 5), (0, 1, 2))])
def test_a_rulebook_has_each_pair_once_with_rows_rising_within_a_tap(
    stride: tuple[int, int, int], kernel: tuple[int, int, int], padding: tuple[int, int, int]
) -> None:
    """Told by looking at every site and every tap."""
    shape, batch = (4, 7, 9), 2
    rng = np.random.default_rng(0)
    every = np.array(list(np.ndindex(batch, *shape)))
    sites = every[np.sort(rng.permutation(len(every))[:60])]
    rules = make_rulebook(
        voxel_layout(torch.from_numpy(sites), shape, batch), kernel, stride, padding
    )
    sizes = [
        (n + 2 * p - k) // s + 1 for n, k, s, p in zip(shape, kernel, stride, padding, strict=True)
    ]
    found: dict[int, list[object]] = {}
    for tap, d in enumerate(np.ndindex(*kernel)):
        for row, (b, *at) in enumerate(sites.tolist()):
            parts = [
                divmod(a + p - k, s) for a, p, k, s in zip(at, padding, d, stride, strict=True)
            ]
            if all(rest == 0 and 0 <= o < n for (o, rest), n in zip(parts, sizes, strict=True)):
                found.setdefault(tap, []).append((row, (b, *(o for o, _ in parts))))
    target = [tuple(site) for site in rules.target.sites.tolist()]
    assert target == sorted({site for own in found.values() for _, site in own})
    for tap in range(np.prod(kernel)):
        own = slice(rules.offsets[tap], rules.offsets[tap + 1])
        told = [target[out] for out in rules.rows_out[own].tolist()]
        assert list(zip(rules.rows_in[own].tolist(), told, strict=True)) == found.get(tap, [])
