"""The frames that a sweep will have, where they are not there yet: a plan needs their number, not the frames."""

from __future__ import annotations

from dataclasses import dataclass

from fl3d.config.settings import DataSettings
from fl3d.core.errors import ConfigError, DataMissing, options
from fl3d.data.kitti import SPLIT_SIZES
from fl3d.sweep.plan import DataInfo
from fl3d.sweep.prepare import is_prepared, prepare_data

UNKNOWN = "not known yet"  # stands for a digest, which no stage that was trained is of


@dataclass(frozen=True)
class Expected:
    """What a plan knows of the frames.

    Args:
        info: identity and size, for the planner.
        n_val: validation frames.
        missing: why the identity, and so the stages' keys, are not known yet; None: they are.
    """

    info: DataInfo
    n_val: int
    missing: str | None = None


def expect_data(data: DataSettings) -> Expected:
    """Identity of the frames, or else their number alone; nothing is simulated for it.

    Raises:
        ConfigError: neither the frames nor their number are known.
        DataError: what is there is malformed.
    """
    if is_prepared(data):
        if data.root is None:
            return _by_size(data, "not there yet: data.root=FOLDER says where")
        try:
            return _at_hand(data)
        except DataMissing as error:
            if data.generate:
                raise
            return _by_size(data, f"not there yet: {error}")
    if data.train_frames is None or data.val_frames is None:
        return _at_hand(data)  # which says that both are needed
    info = DataInfo(UNKNOWN, data.train_frames, UNKNOWN)
    return Expected(info, data.val_frames, "not simulated yet")


def _at_hand(data: DataSettings) -> Expected:
    prepared = prepare_data(data)
    info = DataInfo(prepared.digest, len(prepared.train_ids), prepared.image_digest)
    return Expected(info, len(prepared.val_ids))


def _by_size(data: DataSettings, missing: str) -> Expected:
    n_train = _size(data, "train", data.train_split, data.train_frames)
    n_val = _size(data, "val", data.val_split, data.val_frames)
    sizes = f"{n_train} frames to train, {n_val} to validate"
    return Expected(DataInfo(UNKNOWN, n_train, UNKNOWN), n_val, f"{missing}; {sizes}")


def _size(data: DataSettings, part: str, split: str, most: int | None) -> int:
    """Frames of a split: of its list where there is one, or else of KITTI's split of that name."""
    whole = SPLIT_SIZES.get(split, most)
    if data.root is not None and (data.root / "ImageSets" / f"{split}.txt").exists():
        whole = len(data.folder(data.root).split(split))
    if whole is None:
        raise ConfigError(
            f"data.{part}_split={split}: how many frames it has is not known before its list is there; "
            f"give data.{part}_frames=N. Known: {options(split, SPLIT_SIZES)}"
        )
    size = whole if most is None else min(whole, most)
    if size < 1:
        raise ConfigError(f"data.{part}_frames={most}: a split without frames cannot be used")
    return size
