"""Write and read checkpoints: whole, or not there."""

from __future__ import annotations

import contextlib
import io
import json
import pickle
import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from fl3d.core.digests import file_digest
from fl3d.core.errors import CheckpointError
from fl3d.core.files import write_atomically, write_text
from fl3d.core.records import Checkpoint
from fl3d.runs.layout import RunFolder

State = dict[str, Any]


def save_state(path: Path, state: State) -> str:
    """Write a state of tensors and plain values, equal ones to equal bytes; returns the file's SHA-256."""
    buffer = io.BytesIO()  # torch would write the temporary file's name into the file
    torch.save(_plain(state), buffer)
    write_atomically(path, lambda temporary: temporary.write_bytes(buffer.getbuffer()))
    return file_digest(path)


def _plain(value: Any) -> Any:
    """Equal texts as one object: pickle writes an object once, and a state that was loaded has several."""
    if isinstance(value, Mapping):
        return {_plain(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_plain(item) for item in value)
    return sys.intern(value) if isinstance(value, str) else value


def load_state(path: Path) -> State:
    """Read a state; nothing but tensors and plain values is unpickled.

    Raises:
        CheckpointError: missing, torn, or of another kind.
    """
    try:
        state: State = torch.load(path, map_location="cpu", weights_only=True)
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, pickle.UnpicklingError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise CheckpointError(f"{path}: cannot be read as a checkpoint ({first})") from None
    return state


def write_marker(paths: RunFolder, checkpoint: Checkpoint) -> None:
    """Declare a checkpoint whole; to be called after all its files are written."""
    write_text(paths.marker(checkpoint.step), json.dumps(asdict(checkpoint), indent=1) + "\n")


def read_marker(paths: RunFolder, step: int) -> Checkpoint:
    """Read a checkpoint's marker.

    Raises:
        CheckpointError: it is torn.
    """
    path = paths.marker(step)
    try:
        return Checkpoint(**json.loads(path.read_text(encoding="utf-8")))
    except (ValueError, TypeError) as error:
        raise CheckpointError(f"{path}: is not a checkpoint's marker ({error})") from None


def last_state(paths: RunFolder) -> tuple[State, Checkpoint] | None:
    """Newest checkpoint whose weights are what its marker says; torn ones are passed over."""
    for step in reversed(paths.steps()):
        path = paths.weights(step)
        with contextlib.suppress(CheckpointError):
            checkpoint = read_marker(paths, step)
            if path.exists() and file_digest(path) == checkpoint.sha256:
                return load_state(path), checkpoint
    return None
