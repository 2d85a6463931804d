"""A GPU computes what the CPU does: every detector in every stage, checkpoints that cross over, stages that resume."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from fl3d.config.compose import compose_config
from fl3d.data.dataset import Frames
from fl3d.data.kitti import KittiFolder
from fl3d.detectors.base import Batch, Detector, Found
from fl3d.evaluation.detections import read_detections
from fl3d.inference.detect import detect_frames, to_device
from fl3d.inference.load import build_detector, load
from fl3d.inference.precision import multiplying
from fl3d.inference.reproducibility import prepare
from fl3d.points.operators import ball_query, farthest_points, interpolate
from fl3d.runs.checkpoints import load_state
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import read_spec
from fl3d.sparse import layers
from fl3d.sweep.launchers.local import LocalLauncher
from fl3d.sweep.plan import configure_stage
from fl3d.sweep.setup import Prepared, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training.trainer import Trainer
from tests.support import run_small, small_sweep, train, train_stages

DEVICE = "cuda"
pytestmark = [
    pytest.mark.skipif(not torch.cuda.is_available(), reason="torch sees no CUDA device"),
    # CUDA is asked to be deterministic, and says where it cannot.
    pytest.mark.filterwarnings("ignore:.*deterministic implementation:UserWarning"),
    # Loader processes are forked, and touch no CUDA (Python 3.12 warns of any fork beside threads).
    pytest.mark.filterwarnings("ignore:.*multi-threaded, use of fork:DeprecationWarning"),
]

NETWORKS = [
    ("fcn3d", "focal", "sparse"),
    ("fcn3d", "focal", "dense"),
    ("voxelnet", "warmup", "sparse"),
    ("voxelnet", "focal", "sparse"),
    ("voxelnet", "focal", "dense"),
    ("pointrcnn", "rpn", ""),
    ("pointrcnn", "rcnn", ""),
    ("fconvnet", "frustum", ""),
    ("fconvnet", "refine", ""),
]
every_network = pytest.mark.parametrize("network", NETWORKS, ids="-".join)
Network = tuple[str, str, str]


def build(network: Network) -> Detector:
    """With the same weights each time, on the CPU."""
    name, stage, compute = network
    own = [f"detector.compute={compute}"] if compute else []
    config = compose_config([f"detector={name}", "profile=quick", "loss.gamma=2", *own])
    torch.manual_seed(0)
    return build_detector(configure_stage(config, stage))


def batch_of(detector: Detector, simulated: Path, training: bool = True) -> Batch:
    folder = KittiFolder(simulated)
    frames = [folder.frame(i) for i in folder.split("train")[:2]]
    rngs = [np.random.default_rng(k) for k in range(2)]
    return detector.collate(
        [detector.encode(f, rng, training) for f, rng in zip(frames, rngs, strict=True)]
    )


def learn(
    network: Network, simulated: Path, device: str, dtype: torch.dtype
) -> tuple[Tensor, Tensor]:
    """Loss terms and the gradient of fresh weights, as one row each."""
    prepare(0, device)
    detector = build(network).to(device, dtype)
    batch = {
        key: value.to(dtype) if torch.is_tensor(value) and value.is_floating_point() else value
        for key, value in batch_of(detector, simulated).items()
    }
    torch.manual_seed(1)  # of regions that are drawn
    terms = torch.stack(list(detector.loss(to_device(batch, device)).values()))
    terms.sum().backward()
    gradients = [p.grad.flatten() for p in detector.parameters() if p.grad is not None]
    return terms.detach().double().cpu(), torch.cat(gradients).double().cpu()


def apart(found: Tensor, truth: Tensor) -> float:
    return float((found - truth).norm() / truth.norm())


@every_network
def test_it_learns_the_same_in_double_precision(
    network: Network, simulated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """PointRCNN and Frustum ConvNet take logits and boxes to single precision before their losses."""
    monkeypatch.setattr(layers, "DENSE_FROM", float("inf"))  # maps of small networks stay sparse
    exact = network[0] in ("fcn3d", "voxelnet")
    truth = learn(network, simulated, "cpu", torch.float64)
    found = learn(network, simulated, DEVICE, torch.float64)
    assert apart(found[0], truth[0]) < (1e-9 if exact else 1e-5)
    assert apart(found[1], truth[1]) < (1e-6 if exact else 1e-4)


@every_network
def test_in_single_precision_it_is_as_far_from_the_truth_as_the_cpu(
    network: Network, simulated: Path
) -> None:
    """Which is a hundredth at the gradient: batch normalisation of maps that are nearly alike."""
    truth = learn(network, simulated, "cpu", torch.float64)
    cpu = learn(network, simulated, "cpu", torch.float32)
    found = learn(network, simulated, DEVICE, torch.float32)
    for own, beside, true in zip(found, cpu, truth, strict=True):
        assert apart(own, true) < 10 * apart(beside, true) + 1e-5


@every_network
def test_it_finds_the_same_boxes(network: Network, simulated: Path) -> None:
    found: dict[str, list[Found]] = {}
    for device in ("cpu", DEVICE):
        prepare(0, device)
        detector = build(network).to(device).eval()
        batch = to_device(batch_of(detector, simulated, training=False), device)
        found[device] = detector.detect(batch, 200, 0.0)
    for cpu, other in zip(found["cpu"], found[DEVICE], strict=True):
        assert len(cpu.scores) > 0
        gaps = np.abs(cpu.boxes_velo[:50, None, :6] - other.boxes_velo[None, :, :6]).max(axis=2)
        gaps = np.maximum(gaps, np.abs(cpu.scores[:50, None] - other.scores[None]))
        assert (gaps.min(axis=1) < 1e-3).mean() > 0.9


@pytest.mark.parametrize(
    "ask", [farthest_points, ball_query, interpolate], ids=lambda f: f.__name__
)
def test_points_are_chosen_alike(ask: Callable) -> None:
    points = torch.rand(2, 500, 3, generator=torch.Generator().manual_seed(0))
    arguments = {
        "farthest_points": (points, 60),
        "ball_query": (points, points[:, :60], (0.1, 0.3), (8, 16)),
        "interpolate": (points, points[:, :60], points[:, :60]),
    }[ask.__name__]
    there = [a.to(DEVICE) if torch.is_tensor(a) else a for a in arguments]
    cpu, other = ask(*arguments), ask(*there)
    pairs = zip(cpu, other, strict=True) if isinstance(cpu, list) else [(cpu, other)]
    for a, b in pairs:
        torch.testing.assert_close(b.cpu(), a, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("detector", ["fcn3d", "voxelnet", "pointrcnn", "fconvnet"])
@pytest.mark.parametrize(("made", "used"), [(DEVICE, "cpu"), ("cpu", DEVICE)])
def test_a_checkpoint_of_one_device_detects_on_the_other(
    detector: str, made: str, used: str, simulated: Path, tmp_path: Path
) -> None:
    """What its last stage has stored, to a centimetre: of the best 20 boxes four fifths, as some are all but ties."""
    sweep = one_trial(simulated, tmp_path, detector, made)
    train_stages(sweep)
    folder = sweep.layout.run(sweep.plan.trials[0].key)
    spec = read_spec(folder)
    step = folder.steps()[-1]
    frames = Frames(KittiFolder(simulated), spec.machine.val_ids, 0)
    settings = spec.settings
    found = detect_frames(
        load(folder, step, used), frames, settings.max_boxes, settings.min_score, used
    )
    stored = read_detections(folder.detections(step))
    assert len(stored.scores) > 0
    assert len(found.scores) == pytest.approx(len(stored.scores), rel=0.05)
    best = np.argsort(-stored.scores)[:20]
    gaps = np.abs(stored.boxes_velo[best][:, None, :6] - found.boxes_velo[None, :, :6]).max(axis=2)
    assert (gaps.min(axis=1) < 1e-2).mean() > 0.8


def one_trial(simulated: Path, root: Path, detector: str, device: str) -> Prepared:
    """A sweep of one trial of two steps a stage, whatever its stages are called."""
    start = ["profile=tiny", f"detector={detector}", f"device={device}"]
    places = [f"data.root={simulated}", "data.generate=false", f"store.root={root / 'runs'}"]
    stages = compose_config(start)["schedule"]["stages"]
    short = [f"schedule.stages.{name}.epochs=1" for name in stages]
    config = compose_config([*start, *places, *short, "schedule.frames_per_epoch=4"])
    return prepare_sweep(Listed([point_of([], config)]))


GAMMA_2 = ["detector=voxelnet", "loss.gamma=2", f"device={DEVICE}"]


class Stopped(BaseException):
    """Stands for a kill: nothing catches it."""


def final_state(stages: Path, key: str) -> dict:
    folder = RunFolder(stages / key)
    return load_state(folder.weights(folder.steps()[-1]))


def distance(a: dict, b: dict) -> float:
    """Of the weights of two states."""
    pairs = [(a["model"][key].double(), b["model"][key].double()) for key in a["model"]]
    return float(sum((x - y).square().sum() for x, y in pairs)) ** 0.5


@pytest.mark.parametrize("workers", [0, 2])
def test_a_stage_resumes_where_it_was_interrupted(
    workers: int, simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    point = [*GAMMA_2, f"workers={workers}", "schedule.save_every_steps=1"]
    _, whole = train(simulated, tmp_path / "whole", point)
    sweep = small_sweep(simulated, tmp_path / "cut", [point])
    original, steps = Trainer._step, iter(range(100))

    def step(self: Trainer, batch: dict) -> None:
        if next(steps) == 3:
            raise Stopped
        original(self, batch)

    monkeypatch.setattr(Trainer, "_step", step)
    with pytest.raises(Stopped):
        train_stages(sweep)
    monkeypatch.setattr(Trainer, "_step", original)
    train_stages(sweep)
    key = sweep.plan.trials[0].key
    states = final_state(whole, key), final_state(sweep.layout.stages, key)
    assert states[0]["step"] == states[1]["step"]
    assert "cuda" in states[1]["random"]
    assert distance(*states) == 0.0


@pytest.mark.parametrize("detector", ["fcn3d", "voxelnet"])
def test_the_local_launcher_trains_on_it(detector: str, simulated: Path, tmp_path: Path) -> None:
    """Processes of a fork server, each with loader processes; two stages share the card."""
    points = [[f"detector={detector}", f"loss.gamma={g}", f"device={DEVICE}"] for g in (0, 2)]
    sweep = small_sweep(simulated, tmp_path, points)
    launcher = LocalLauncher(device=DEVICE, per_card=2)
    try:
        ran = run_small(sweep, launcher)
    finally:
        launcher.close()
    assert len(ran.outcome.trained) == 3


@every_network
def test_twice_it_learns_to_the_same_bits(network: Network, simulated: Path) -> None:
    first, second = (learn(network, simulated, DEVICE, torch.float32) for _ in range(2))
    assert torch.equal(first[0], second[0])
    assert torch.equal(first[1], second[1])


def test_precisions_are_what_their_names_say() -> None:
    """Products of 24, 11 and 8 bits: float32 must not be torch's default, TF32 in convolutions."""
    generator = torch.Generator().manual_seed(0)
    x = torch.randn(1, 64, 32, 32, generator=generator)
    w = torch.randn(64, 64, 3, 3, generator=generator)
    truth = torch.nn.functional.conv2d(x.double(), w.double())
    wrong = {}
    for precision in ("float32", "tf32", "bf16"):
        prepare(0, DEVICE, precision)
        with multiplying(precision, DEVICE):
            found = torch.nn.functional.conv2d(x.to(DEVICE), w.to(DEVICE))
        wrong[precision] = apart(found.double().cpu(), truth)
    prepare(0, DEVICE)
    assert wrong["float32"] < 1e-6
    assert 1e-5 < wrong["tf32"] < 1e-3
    assert 1e-3 < wrong["bf16"] < 1e-2
