"""From a config's `data` section to frames on disk."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fl3d.config.settings import DataSettings
from fl3d.core.digests import digest
from fl3d.core.errors import ConfigError, DataError, DataMissing
from fl3d.data.dataset import subset
from fl3d.data.frame_digests import data_digest, image_digest, labels_digest
from fl3d.simulator.generate import Settings, generate, is_whole


@dataclass(frozen=True, kw_only=True)
class PreparedData:
    """Where the frames of a sweep lie, and which they are.

    Args:
        root: a KITTI folder.
        train_ids: training frames.
        val_ids: validation frames.
        digest: identity of all of them.
        image_digest: of what a 2D detector found in them; None where none was run.
        labels_digest: of what the validation frames are scored by.
    """

    root: Path
    train_ids: tuple[str, ...]
    val_ids: tuple[str, ...]
    digest: str
    image_digest: str | None = None
    labels_digest: str = ""


def is_prepared(data: DataSettings) -> bool:
    """Whether the frames are on disk: all but simulated ones are taken to be."""
    return not data.generate or (data.root is not None and is_whole(data.root, _settings(data)))


def _settings(data: DataSettings) -> Settings:
    if data.train_frames is None or data.val_frames is None:
        raise ConfigError(
            "data.train_frames, data.val_frames: a simulated dataset needs both numbers"
        )
    return Settings(data.train_frames, data.val_frames, data.seed, people=data.people)


def prepare_data(data: DataSettings) -> PreparedData:
    """Find the frames, or simulate them where the config says so.

    Args:
        data: which frames.

    Raises:
        ConfigError: no folder is given, or a simulated set has no size.
        DataMissing: the folder is no KITTI folder, or a file is not there.
        DataError: a file is malformed.
    """
    if data.root is None:
        raise ConfigError(
            "data.root: where is KITTI? Give data.root=FOLDER (make: KITTI=FOLDER), holding training/ and ImageSets/"
        )
    root = data.root
    if data.generate:
        root = generate(root, _settings(data))
    elif not (root / "training").is_dir():
        hint = f"; give the folder above it, {root.parent}" if root.name == "training" else ""
        raise DataMissing(f"is no KITTI folder: it holds no 'training'{hint}", root)
    folder = data.folder(root)
    train = subset(folder.split(data.train_split), data.train_frames, data.seed)
    val = subset(folder.split(data.val_split), data.val_frames, data.seed)
    for key, name, frames in (
        ("train_split", data.train_split, train),
        ("val_split", data.val_split, val),
    ):
        if not frames:
            raise DataError(f"names no frame, and is data.{key}", folder.split_path(name))
    whole = digest([data_digest(folder, train), data_digest(folder, val)])[:16]
    return PreparedData(
        root=root,
        train_ids=tuple(train),
        val_ids=tuple(val),
        digest=whole,
        image_digest=image_digest(folder, [*train, *val]),
        labels_digest=labels_digest(folder, val),
    )
