"""Work of a network, layer by layer, from its shapes alone: nothing is computed."""

from __future__ import annotations

from collections.abc import Callable

import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from fl3d.detectors.base import Detector

LAYERS = (nn.Conv2d, nn.Conv3d, nn.ConvTranspose2d, nn.Linear)


def layer_flops(make: Callable[[], Detector]) -> dict[str, int]:
    """Floating point operations of each convolution and linear layer for one frame, two for a multiply-add.

    Args:
        make: builds the detector; called on the meta device, so that full size costs neither memory nor time.

    Returns:
        by the layer's name in the network, in the network's order.
    """
    with torch.device("meta"):
        detector = make()
    batch = {key: value if key == "size" else value.to("meta") for key, value in detector.example().items()}
    with FlopCounterMode(display=False, depth=100) as counter, torch.no_grad():
        detector(batch)
    counts = counter.get_flop_counts()
    root = type(detector).__name__
    names = [name for name, module in detector.named_modules() if isinstance(module, LAYERS)]
    return {name: sum(counts[f"{root}.{name}"].values()) for name in names}
