"""What a network costs before anything of it was measured: its FLOPs, and the bytes of a checkpoint."""

from __future__ import annotations

import time
from dataclasses import dataclass

import torch

from fl3d.config.settings import read_stage_settings
from fl3d.core.records import Config
from fl3d.detectors.base import Detector
from fl3d.detectors.flops import layer_flops
from fl3d.inference.load import build_detector
from fl3d.training.build import build_optimizer

BACKWARD = 2  # a backward pass costs twice a forward one


@dataclass(frozen=True, kw_only=True)
class NetworkCost:
    """What one configuration of a detector costs.

    Args:
        target: the detector.
        flops: of a frame, forward.
        step_flops: of a training step.
        bytes: of a checkpoint.
    """

    target: str
    flops: float
    step_flops: float
    bytes: float


def network_cost(config: Config) -> NetworkCost:
    """What the network of a stage costs, by building it.

    Args:
        config: of the stage.

    Raises:
        ConfigError: the network cannot be built from it.
    """
    flops = sum(layer_flops(lambda: build_detector(config)).values())
    batch_size = read_stage_settings(config).batch_size
    return NetworkCost(
        target=config["detector"]["_target_"],
        flops=flops,
        step_flops=flops * batch_size * (1 + BACKWARD),
        bytes=_state_bytes(config),
    )


def _state_bytes(config: Config) -> float:
    """Size of a checkpoint's weights and optimiser, found by one step of the optimiser on zeros."""
    with torch.device("meta"):  # no weights are drawn
        detector: Detector = build_detector(config)
    detector.to_empty(device="cpu")  # where Adam of torch 2.11 can read its count of steps
    optimizer = build_optimizer(config, detector)
    for parameter in detector.parameters():
        parameter.data.zero_()
        parameter.grad = torch.zeros_like(parameter)
    optimizer.step()
    moments = [
        v
        for state in optimizer.state.values()
        for v in state.values()
        if isinstance(v, torch.Tensor)
    ]
    tensors = [*detector.state_dict().values(), *moments]
    return float(sum(tensor.numel() * tensor.element_size() for tensor in tensors))


def measure_speed() -> float:
    """FLOP/s of one thread of this machine at convolutions, in a fifth of a second."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        images, kernels = torch.randn(1, 64, 64, 64), torch.randn(64, 64, 3, 3)
        torch.nn.functional.conv2d(images, kernels, padding=1)
        started, count = time.perf_counter(), 0
        while time.perf_counter() - started < 0.2:
            torch.nn.functional.conv2d(images, kernels, padding=1)
            count += 1
        return count * 2 * 9 * 64 * 64 * 64 * 64 / (time.perf_counter() - started)
    finally:
        torch.set_num_threads(threads)
