"""`detector.compute` changes speed alone: the same weights, the same outputs, the same gradients."""

from pathlib import Path

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Batch, Detector
from fl3d.inference.load import build_detector
from fl3d.sparse import layers

DETECTORS = ("voxelnet", "fcn3d")


def build(detector: str, compute: str, *words: str) -> Detector:
    torch.manual_seed(0)
    given = [f"detector={detector}", f"detector.compute={compute}", *words]
    return build_detector(compose_config(given)).double()


def batch_of(detector: Detector, simulated: Path) -> Batch:
    folder = KittiFolder(simulated)
    frames = [folder.frame(i) for i in folder.split("train")[:2]]
    samples = [
        detector.encode(frame, np.random.default_rng(k), training=True)
        for k, frame in enumerate(frames)
    ]
    batch = detector.collate(samples)
    return {
        k: v.double() if torch.is_tensor(v) and v.is_floating_point() else v
        for k, v in batch.items()
    }


@pytest.mark.parametrize(
    ("name", "words"),
    [*((name, []) for name in DETECTORS), ("voxelnet", ["detector.middle_kernel=column"])],
)
def test_sparse_and_dense_are_one_function(
    name: str, words: list[str], simulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(
        layers, "DENSE_FROM", float("inf")
    )  # this small network would mostly choose dense
    dense, sparse = build(name, "dense", *words), build(name, "sparse", *words)
    assert all(
        torch.equal(a, b)
        for a, b in zip(dense.state_dict().values(), sparse.state_dict().values(), strict=True)
    )
    batches = batch_of(dense, simulated), batch_of(sparse, simulated)
    assert ["layout" in batch for batch in batches] == [False, True]
    for training in (True, False):
        dense.train(training)
        sparse.train(training)
        for a, b in zip(dense(batches[0]), sparse(batches[1]), strict=True):
            torch.testing.assert_close(a, b, rtol=1e-8, atol=1e-8)
    totals = [
        torch.stack(list(d.train().loss(b).values())).sum()
        for d, b in zip((dense, sparse), batches, strict=True)
    ]
    for total in totals:
        total.backward()  # type: ignore[no-untyped-call]
    for a, b in zip(dense.parameters(), sparse.parameters(), strict=True):
        assert a.grad is not None
        assert b.grad is not None
        torch.testing.assert_close(
            a.grad, b.grad, rtol=1e-6, atol=1e-7 * float(a.grad.abs().max()) + 1e-9
        )


@pytest.mark.parametrize("name", DETECTORS)
def test_a_way_that_does_not_exist_is_refused(name: str) -> None:
    with pytest.raises(ConfigError, match=r"detector.compute.*sparse"):
        build(name, "spares")


def test_a_layer_is_sparse_where_its_channels_and_the_grids_fill_make_it_pay(
    simulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of 3D-FCN in profile quick the first two, of few channels and little fill; behind them it is fuller."""
    (first,) = batch_of(build("fcn3d", "sparse"), simulated)["layout"].rules.values()
    (second,) = first.target.rules.values()
    assert not second.target.rules
    monkeypatch.setattr(layers, "DENSE_FROM", 0.0)
    assert "layout" not in batch_of(build("fcn3d", "sparse"), simulated)
