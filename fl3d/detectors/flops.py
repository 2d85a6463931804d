"""Work of a network, layer by layer, from its shapes alone: nothing is computed."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.flop_counter import FlopCounterMode

from fl3d.detectors.base import Detector

LAYERS = (nn.Conv1d, nn.Conv2d, nn.Conv3d, nn.ConvTranspose1d, nn.ConvTranspose2d, nn.Linear)


@dataclass(frozen=True)
class LayerWork:
    """One layer's work on one frame.

    Args:
        name: in the network.
        module: itself, on the meta device.
        inputs: shape of what goes in, with the batch of one.
        outputs: shape of what comes out.
        flops: two for a multiply-add.
    """

    name: str
    module: nn.Module
    inputs: tuple[int, ...]
    outputs: tuple[int, ...]
    flops: int


def layer_works(make: Callable[[], Detector]) -> list[LayerWork]:
    """Each convolution and linear layer's work on one frame, in the order in which they run.

    Args:
        make: builds the detector; called on the meta device, so that full size costs neither memory nor time.
    """
    with torch.device("meta"):
        detector = make()
    names: dict[nn.Module, str] = {
        m: name for name, m in detector.named_modules() if isinstance(m, LAYERS)
    }
    shapes: dict[str, tuple[tuple[int, ...], tuple[int, ...]]] = {}

    def note(module: nn.Module, inputs: tuple[Any, ...], output: Tensor) -> None:
        shapes[names[module]] = tuple(inputs[0].shape), tuple(output.shape)

    for module in names:
        module.register_forward_hook(note)
    batch = {
        key: value if key == "size" else value.to("meta")
        for key, value in detector.example().items()
    }
    with FlopCounterMode(display=False, depth=100) as counter, torch.no_grad():
        detector(batch)
    counts, root = counter.get_flop_counts(), type(detector).__name__
    modules = {name: module for module, name in names.items()}
    return [
        LayerWork(name, modules[name], *shape, sum(counts[f"{root}.{name}"].values()))
        for name, shape in shapes.items()
    ]


def layer_flops(make: Callable[[], Detector]) -> dict[str, int]:
    """Floating point operations of each layer for one frame, by its name; see ``layer_works``."""
    return {work.name: work.flops for work in layer_works(make)}
