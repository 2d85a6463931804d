"""How a device multiplies: in IEEE single precision, in TF32 or in bfloat16. Weights and sums stay single."""

from __future__ import annotations

import os

# The backward pass of bfloat16 convolutions ends in a segmentation fault on processors with AMX (torch 2.13.0, seen on
# a Xeon with amx_bf16): oneDNN is kept to AVX-512, which has bfloat16 too. It reads this at its first primitive.
os.environ.setdefault("ONEDNN_MAX_CPU_ISA", "AVX512_CORE_FP16")

import torch

from fl3d.core.errors import ConfigError, options

PRECISIONS = ("float32", "tf32", "bf16")


def check_precision(precision: str, device: str) -> None:
    """Refuse a precision that does not exist, or not on this device.

    Raises:
        ConfigError: naming the key and what there is.
    """
    if precision not in PRECISIONS:
        raise ConfigError(f"precision: no choice '{precision}'. {options(precision, PRECISIONS)}")
    if precision == "tf32" and device == "cpu":
        raise ConfigError(
            "precision: tf32 is a mode of CUDA devices; with device=cpu there are float32 and bf16"
        )


def set_precision(precision: str) -> None:
    """Let CUDA's products of single-precision numbers be what was asked for; torch's own default is TF32 in cuDNN."""
    mode = "tf32" if precision == "tf32" else "ieee"
    torch.backends.cuda.matmul.fp32_precision = mode
    torch.backends.cudnn.conv.fp32_precision = mode  # type: ignore[attr-defined]
    torch.backends.cudnn.rnn.fp32_precision = mode  # type: ignore[attr-defined]  # torch reads the two together
    torch.backends.cuda.matmul.allow_bf16_reduced_precision_reduction = False  # sums are single


def multiplying(precision: str, device: str) -> torch.autocast:
    """A context in which convolutions and matrix products are of this precision."""
    return torch.autocast(
        torch.device(device).type, dtype=torch.bfloat16, enabled=precision == "bf16"
    )
