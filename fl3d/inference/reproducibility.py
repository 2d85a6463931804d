"""Same config, same bits: seeds, threads and random states."""

from __future__ import annotations

import os
from collections.abc import Mapping

import numpy as np
import torch
from torch import Tensor

from fl3d.core.memory import keep_freed_memory
from fl3d.inference.precision import set_precision


def prepare(seed: int, device: str, precision: str = "float32") -> None:
    """Seed torch and ask it for deterministic algorithms; one thread a process on the CPU."""
    set_precision(precision)
    if device == "cpu":
        torch.set_num_threads(1)
        keep_freed_memory()
    else:
        os.environ.setdefault("CUBLAS_WORKSPACE_CONFIG", ":4096:8")
    torch.use_deterministic_algorithms(True, warn_only=device != "cpu")
    # Torch would write NaN into all fresh memory, in case a kernel read it unwritten; that is a third of some steps.
    torch.utils.deterministic.fill_uninitialized_memory = False  # type: ignore[attr-defined]
    torch.manual_seed(seed)


def sample_generator(seed: int, epoch: int, position: int) -> np.random.Generator:
    """Randomness of one training sample: depends on its place alone, not on workers or on what came before."""
    return np.random.default_rng([seed, epoch, position])


def random_state(device: str) -> dict[str, Tensor]:
    """States of torch's generators."""
    states = {"cpu": torch.get_rng_state()}
    if device != "cpu":
        states["cuda"] = torch.cuda.get_rng_state(device)
    return states


def set_random_state(states: Mapping[str, Tensor], device: str) -> None:
    """Put generators back to a stored state."""
    torch.set_rng_state(states["cpu"].cpu())
    if device != "cpu" and "cuda" in states:
        torch.cuda.set_rng_state(states["cuda"].cpu(), device)
