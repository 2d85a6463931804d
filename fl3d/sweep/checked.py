"""The look at the data that every sweep begins with: a mistake in them shows here, not in a table of zeros."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path

from fl3d.core.digests import digest
from fl3d.core.errors import DataError
from fl3d.core.files import write_text
from fl3d.inspection import VERSION
from fl3d.inspection.facts import gather
from fl3d.inspection.summary import Checked, checked, start_texts
from fl3d.inspection.wanted import Wanted, wanted_by
from fl3d.sweep.setup import Prepared

MOST_CLOUDS = 200  # of each split: 1.4 s of 1200 simulated frames
MOST_WARNINGS = 5  # that are printed
MOST_ERRORS = 10
TRAIN, VAL = "train", "val"  # what the two splits are called here, whatever their files are


def check_start(prepared: Prepared, say: Callable[[str], None]) -> None:
    """Say what is learnt from and evaluated, and what is odd about it; a second start reads what the first found.

    Raises:
        DataError: there is nothing to learn, or nothing that counts; the message says why.
    """
    wanted = wanted_by([trial.config for trial in prepared.plan.trials] or [prepared.sweeper.base])
    path = prepared.layout.check(_key(prepared, wanted))
    texts = _read(path)
    if texts is None:
        texts = start_texts(_look(prepared, wanted), prepared.data.root)
        if not texts["errors"]:  # what stands in the way may be gone at the next start
            write_text(path, json.dumps(texts, indent=1) + "\n")
    if texts["errors"]:
        raise DataError("\n  ".join(_why_not(texts, _hint(prepared))), prepared.data.root)
    for line in [*texts["lines"], *texts["warnings"][:MOST_WARNINGS]]:
        say(line)
    if len(texts["warnings"]) > MOST_WARNINGS:
        say(f"{len(texts['warnings']) - MOST_WARNINGS} more warnings: {_hint(prepared)}")


def _why_not(texts: dict[str, list[str]], hint: str) -> list[str]:
    """Lines of an error: what is wrong, what is odd and may be why, and where all of it is shown."""
    errors, warnings = texts["errors"], texts["warnings"][:MOST_WARNINGS]
    left = len(errors) - MOST_ERRORS
    more = [f"{left} more errors"] if left > 0 else []
    return ["cannot be used", *errors[:MOST_ERRORS], *more, *warnings, hint]


def _hint(prepared: Prepared) -> str:
    command = f'python -m fl3d check "{prepared.data.root}"'
    return f"{command}, with the words of this sweep, shows all of it, and a picture"


def _key(prepared: Prepared, wanted: tuple[Wanted, ...]) -> str:
    """Identity of what is found: of the data, of how they are read, and of what is looked for."""
    data, settings = prepared.data, prepared.settings
    read = [settings.data.crop, settings.data.calibration]
    looked_for = [asdict(one) for one in wanted]
    return digest(
        [VERSION, data.digest, data.image_digest, read, settings.protocol.id, looked_for]
    )[:16]


def _look(prepared: Prepared, wanted: tuple[Wanted, ...]) -> Checked:
    splits = {TRAIN: prepared.data.train_ids, VAL: prepared.data.val_ids}
    facts = gather(prepared.kitti, splits, wanted, prepared.settings.protocol, MOST_CLOUDS)
    return checked(facts, TRAIN, VAL)


def _read(path: Path) -> dict[str, list[str]] | None:
    try:
        texts: dict[str, list[str]] = json.loads(path.read_text(encoding="utf-8"))
    except (FileNotFoundError, ValueError):  # the first start, or a torn file
        return None
    is_whole = isinstance(texts, dict) and all(
        isinstance(texts.get(name), list) for name in ("errors", "lines", "warnings")
    )
    return texts if is_whole else None
