"""How a device multiplies: choices, refusals, what stays single, and what reaches the products."""

from pathlib import Path

import numpy as np
import pytest
import torch

from fl3d.config.compose import compose_config
from fl3d.core.errors import ConfigError
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Batch, Detector
from fl3d.inference.load import build_detector
from fl3d.inference.precision import check_precision, multiplying, set_precision
from fl3d.runs.spec import read_scores
from fl3d.sparse import layers
from fl3d.sweep.setup import prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from tests.support import train_stages

NAMES = ("fcn3d", "voxelnet")


def build(name: str, *overrides: str) -> Detector:
    torch.manual_seed(0)
    return build_detector(compose_config([f"detector={name}", "profile=quick", *overrides])).train()


def batch_of(detector: Detector, simulated: Path) -> Batch:
    folder = KittiFolder(simulated)
    frames = [folder.frame(i) for i in folder.split("train")[:2]]
    rng = np.random.default_rng
    return detector.collate([detector.encode(frame, rng(0), training=True) for frame in frames])


@pytest.mark.parametrize(
    ("precision", "device", "message"),
    [
        ("fp16", "cuda", "precision: no choice 'fp16'.*bf16"),
        ("tf32", "cpu", "precision: tf32 is a mode of CUDA"),
    ],
)
def test_what_does_not_exist_is_refused(precision: str, device: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        check_precision(precision, device)


def test_single_precision_is_not_tf32_unless_asked_for() -> None:
    """torch's own convolutions on CUDA are."""
    for precision, mode in (("tf32", "tf32"), ("bf16", "ieee"), ("float32", "ieee")):
        set_precision(precision)
        assert torch.backends.cuda.matmul.fp32_precision == mode
        assert torch.backends.cudnn.conv.fp32_precision == mode  # type: ignore[attr-defined]


@pytest.mark.parametrize("dense_from", [0.6, float("inf")])
@pytest.mark.parametrize("name", NAMES)
def test_bf16_multiplies_low_and_keeps_the_rest_single(
    name: str, dense_from: float, simulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(layers, "DENSE_FROM", dense_from)  # inf: nothing becomes dense
    totals = []
    gradients = []
    for precision in ("float32", "bf16"):
        detector = build(name)
        batch = batch_of(detector, simulated)
        with multiplying(precision, "cpu"):
            terms = detector.loss(batch)
        assert all(value.dtype == torch.float32 for value in terms.values())
        total = torch.stack(list(terms.values())).sum()
        total.backward()  # type: ignore[no-untyped-call]
        assert all(p.dtype == torch.float32 and p.grad is not None for p in detector.parameters())
        totals.append(float(total.detach()))
        own = [p.grad.flatten() for p in detector.parameters() if p.grad is not None]
        gradients.append(torch.cat(own))
    assert totals[0] != totals[1]
    assert totals[1] == pytest.approx(totals[0], rel=0.05)
    # Deep networks of random weights: many ReLUs are near their corner, and flips there turn the
    # gradient.
    assert torch.cosine_similarity(*gradients, dim=0) > 0.6


def test_features_of_points_are_not_lowered(simulated: Path) -> None:
    """Coordinates of 40 m lie a quarter of a metre apart in bfloat16."""
    detector = build("voxelnet")
    batch = batch_of(detector, simulated)
    seen = []
    net = detector.get_submodule("feature_net")
    net.register_forward_hook(lambda module, inputs, output: seen.append((inputs[0], output)))
    detector.loss(batch)
    with multiplying("bf16", "cpu"):
        detector.loss(batch)
    (_, single), (_, low) = seen
    torch.testing.assert_close(low, single)


@pytest.mark.parametrize("name", NAMES)
def test_scores_are_not_lowered(name: str, simulated: Path) -> None:
    """In bfloat16 a thousand cells would share a score."""
    detector = build(name).eval()
    with torch.no_grad(), multiplying("bf16", "cpu"):
        logits, _ = detector(batch_of(detector, simulated))
    assert logits.dtype == torch.float32
    logits = logits[logits != 0]  # 3D-FCN's untrained heads have no bias
    assert (logits != logits.bfloat16()).float().mean() > 0.9


def test_compiling_needs_what_is_dense() -> None:
    with pytest.raises(ConfigError, match=r"compile: VoxelNet.*detector\.compute=dense"):
        build("voxelnet").compile_dense()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:`torch.jit:DeprecationWarning", "ignore::UserWarning:torch")
@pytest.mark.parametrize(
    "change", [["precision=bf16"], ["detector.compute=dense", "compile=true"]], ids=" ".join
)
@pytest.mark.parametrize("name", NAMES)
def test_ap_is_that_of_plain_training(name: str, change: list[str], tmp_path: Path) -> None:
    """All of profile quick: rounding moves a seed's AP by points, as another seed does."""
    aps = []
    for overrides in ([], change):
        point = [f"detector={name}", "profile=quick", "loss.gamma=0", *overrides]
        places = [f"store.root={tmp_path}", f"data.root={tmp_path / 'data'}"]
        config = compose_config([*point, *places])
        sweep = prepare_sweep(Listed([point_of(point, config)]))
        train_stages(sweep)
        folder = sweep.layout.run(sweep.plan.trials[0].key)
        scores = read_scores(folder, folder.steps()[-1], sweep.settings.protocol.id)
        assert scores is not None
        aps.append(scores["ap_3d/moderate"])
    assert aps[1] == pytest.approx(aps[0], abs=8), aps


@pytest.mark.filterwarnings(
    "ignore:`torch.jit:DeprecationWarning"
)  # torch's own, as it loads its compiler
@pytest.mark.parametrize("name", NAMES)
def test_each_dense_part_is_compiled_whole(
    name: str, simulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One graph for each; the compiler's own work is left out here."""
    graphs: list[int] = []
    plain = torch.compile

    def count(graph: torch.fx.GraphModule, inputs: object) -> object:
        graphs.append(1)
        return graph.forward

    def counted(function: object, **options: object) -> object:
        return plain(function, backend=count, **options)  # type: ignore[call-overload]

    monkeypatch.setattr(torch, "compile", counted)
    detector = build(name, "detector.compute=dense").double()
    compiled = build(name, "detector.compute=dense").double()
    compiled.compile_dense()
    batch = batch_of(detector, simulated)
    with torch.no_grad():
        for a, b in zip(detector(batch), compiled(batch), strict=True):
            torch.testing.assert_close(a, b)
    assert len(graphs) == len(detector.DENSE)
    assert list(detector.state_dict()) == list(compiled.state_dict())
