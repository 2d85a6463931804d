"""What a command prints, read as it comes: how far it is, and its losses."""

from __future__ import annotations

import contextlib
import re
from pathlib import Path

from fl3d.core.errors import ConfigError
from fl3d.training.result_folders import Numbers

PLACES = ("epoch", "step", "steps")  # groups that tell how far it is; all others are losses


class Output:
    """Reads the log of a command.

    Args:
        log: what it prints.
        pattern: see ``Command.progress``.
        numbers: how its epochs are numbered.

    Raises:
        ConfigError: the pattern is no regular expression, or has no group ``epoch``.
    """

    def __init__(self, log: Path, pattern: str | None, numbers: Numbers) -> None:
        self.epochs = 0.0  # of its own that are done
        self._log, self._numbers = log, numbers
        self._regex = compiled(pattern)
        self._offset = 0
        self._sums: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def skip(self) -> None:
        """Leave out what was printed so far, by an earlier start."""
        self._offset = self._log.stat().st_size if self._log.exists() else 0

    def read(self) -> None:
        """Read what is new, up to its last whole line."""
        if self._regex is None or not self._log.exists():
            return
        with self._log.open("rb") as file:
            file.seek(self._offset)
            new = file.read()
        # Progress bars end their lines with a carriage return.
        whole = max(new.rfind(b"\n"), new.rfind(b"\r")) + 1
        self._offset += whole
        for line in re.split(r"[\r\n]+", new[:whole].decode(errors="replace")):
            match = self._regex.search(line)
            if match is not None:
                self._learn(match.groupdict())

    def take_losses(self) -> dict[str, float]:
        """Mean of each loss since the last time; numbers that are none are left out."""
        self.read()
        means = {name: self._sums[name] / self._counts[name] for name in self._sums}
        self._sums, self._counts = {}, {}
        return means

    def _learn(self, groups: dict[str, str | None]) -> None:
        numbers = {
            name: number for name, text in groups.items() if (number := _number(text)) is not None
        }
        if "epoch" in numbers:
            begun = self._numbers.epoch(int(numbers["epoch"])) - 1
            within = numbers.get("step", 0.0) / numbers["steps"] if numbers.get("steps") else 0.0
            self.epochs = max(0.0, begun + min(within, 1.0))
        for name in numbers.keys() - set(PLACES):
            self._sums[name] = self._sums.get(name, 0.0) + numbers[name]
            self._counts[name] = self._counts.get(name, 0) + 1


def compiled(pattern: str | None) -> re.Pattern[str] | None:
    """A regular expression of ``detector.progress``.

    Raises:
        ConfigError: it is none, or has no group ``epoch``.
    """
    if pattern is None:
        return None
    try:
        found = re.compile(pattern)
    except re.error as error:
        raise ConfigError(
            f"detector.progress: '{pattern}' is no regular expression: {error}"
        ) from None
    if "epoch" not in found.groupindex:
        raise ConfigError(
            f"detector.progress: '{pattern}' has no group named epoch, such as 'epoch (?P<epoch>\\d+)'"
        )
    return found


def _number(text: str | None) -> float | None:
    with contextlib.suppress(ValueError):
        return float(text) if text is not None else None
    return None
