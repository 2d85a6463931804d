"""The frozen plan of a sweep: what its trials are, whatever configs say later. The only parser of it."""

from __future__ import annotations

import json
import os
import uuid
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.core.errors import StoreError, Unwritable
from fl3d.core.files import write_atomically
from fl3d.core.records import Trial
from fl3d.runs.design import SEED
from fl3d.runs.layout import StoreFolder

VERSION = (
    2  # raised whenever the file means something else. 2: values, levels and configs of trials
)


@dataclass(frozen=True, kw_only=True)
class FrozenTrial:
    """A trial as a plan tells it; see ``core.records.Trial``.

    Args:
        config: what can change a result, by dotted key.
    """

    key: str
    overrides: tuple[str, ...]
    values: Mapping[str, Any]
    config: Mapping[str, Any]
    stages: tuple[str, ...]
    first_own_step: int
    detector: str
    group: str
    level: str
    seed: int

    def swept(self, key: str) -> Any:
        """Its value of a key that is swept, the seed among them; None of another."""
        return self.seed if key == SEED else self.values.get(key)

    def value(self, key: str, default: Any = None) -> Any:
        """A value of its config; of a section its values by what follows the section's name."""
        if key in self.config:
            return self.config[key]
        prefix = f"{key}."
        section = {
            name.removeprefix(prefix): v
            for name, v in self.config.items()
            if name.startswith(prefix)
        }
        return section or default


@dataclass(frozen=True, kw_only=True)
class FrozenPlan:
    """A sweep as it was planned last.

    Args:
        factor: keys that are compared.
        baseline: level that the others are held against.
        trials: in the sweeper's order.
        earlier: stages of trials of earlier starts under the same name: they are nobody's waste.
        looks: numbers of seeds after which verdicts are asked for, where seeds are added until there is one.
        words: of the command line that started it last.
    """

    factor: tuple[str, ...]
    baseline: str
    trials: tuple[FrozenTrial, ...]
    earlier: tuple[str, ...] = ()
    looks: tuple[int, ...] = ()
    words: tuple[str, ...] = ()

    @property
    def stages(self) -> set[str]:
        """Keys of all stages that it names."""
        return {key for trial in self.trials for key in trial.stages} | set(self.earlier)


def is_of_program(trial: FrozenTrial) -> bool:
    """Whether a trial's detections are result files of somebody's program, see ``evaluation.results``."""
    return "detector.program.digest" in trial.config


def freeze(trial: Trial, config: Mapping[str, Any]) -> FrozenTrial:
    """A trial with what can change a result, by dotted key."""
    return FrozenTrial(
        key=trial.key,
        overrides=trial.overrides,
        values=trial.values,
        config=config,
        stages=trial.stages,
        first_own_step=trial.first_own_step,
        detector=trial.detector,
        group=trial.group,
        level=trial.level,
        seed=trial.seed,
    )


class PlanFile:
    """The file of a plan that may grow: each time what is new costs a line, and not the whole plan.

    Lines lie beside the plan and name the plan that they belong to: those of another are passed over, and so is a last
    one that is torn, of which nothing was begun yet.

    Args:
        path: of the plan.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._written: tuple[Any, ...] = ()  # all of the plan but its trials
        self._keys: tuple[str, ...] = ()  # of these
        self._shared: dict[str, Any] = {}
        self._mark = ""

    def write(self, plan: FrozenPlan) -> None:
        """Freeze a plan: what it has gained since the last call, or all of it."""
        new = self._gained(plan)
        if new is None:
            self._mark = uuid.uuid4().hex
            self._shared = write_plan(self.path, plan, self._mark)
        elif new:
            lines = [{"of": self._mark, "trial": _as_written(one, self._shared)} for one in new]
            _append(grown_file(self.path), [json.dumps(line) for line in lines])
        self._written, self._keys = _head(plan), _keys(plan.trials)

    def _gained(self, plan: FrozenPlan) -> tuple[FrozenTrial, ...] | None:
        """Trials that it has gained; None: something else has changed, or they do not share what the others do."""
        count = len(self._keys)
        if self._written != _head(plan) or self._keys != _keys(plan.trials[:count]):
            return None
        new = plan.trials[count:]
        has_all = all(self._shared.keys() <= trial.config.keys() for trial in new)
        return new if has_all else None


def grown_file(path: Path) -> Path:
    """Where the lines lie of what a plan has gained since it was written."""
    return path.with_suffix(".grown")


def _head(plan: FrozenPlan) -> tuple[Any, ...]:
    """All of a plan but its trials; stages of earlier starts stay named where they come again."""
    return plan.factor, plan.baseline, plan.looks, plan.words


def _keys(trials: Iterable[FrozenTrial]) -> tuple[str, ...]:
    return tuple(trial.key for trial in trials)


def _as_written(trial: FrozenTrial, shared: Mapping[str, Any]) -> dict[str, Any]:
    own = {
        key: value
        for key, value in trial.config.items()
        if key not in shared or shared[key] != value
    }
    return {**vars(trial), "config": own}


def _append(path: Path, lines: Sequence[str]) -> None:
    """Write lines behind those of a file, to the disk.

    Raises:
        Unwritable: they cannot be.
    """
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write("".join(f"{line}\n" for line in lines))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        raise Unwritable(error.errno, error.strerror, str(path)) from error


def write_plan(path: Path, plan: FrozenPlan, mark: str = "") -> dict[str, Any]:
    """Freeze a plan; what all trials share is written once, and returned.

    Args:
        path: where; lines of a plan that was there before go.
        plan: the plan.
        mark: by which lines name it that are written later; empty: it does not grow.
    """
    shared = _shared([trial.config for trial in plan.trials])
    trials = [_as_written(trial, shared) for trial in plan.trials]
    content = {
        "version": VERSION,
        "factor": plan.factor,
        "baseline": plan.baseline,
        "trials": trials,
        "config": shared,
        "earlier": sorted(plan.earlier),
        **({"looks": plan.looks} if plan.looks else {}),
        **({"words": plan.words} if plan.words else {}),
        **({"mark": mark} if mark else {}),
    }
    write_atomically(path, lambda temporary: _dump(content, temporary))
    grown_file(path).unlink(missing_ok=True)
    return shared


def _dump(content: Mapping[str, Any], path: Path) -> None:
    """Write JSON, piece by piece: the text of a large plan would take as much memory as all else of its sweep."""
    with path.open("w", encoding="utf-8") as file:
        json.dump(content, file, indent=1)
        file.write("\n")


def read_plan(path: Path) -> FrozenPlan:
    """Read what ``write_plan`` wrote.

    Raises:
        StoreError: there is none, it is torn or cannot be read, or another version of fl3d wrote it.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
        if content.get("version") != VERSION:
            raise StoreError(
                f"{path}: written by another version of fl3d; run the sweep again, which renews it"
            )
        written = [*content["trials"], *_grown(path, content.get("mark", ""))]
        return FrozenPlan(
            factor=tuple(content["factor"]),
            baseline=content["baseline"],
            trials=tuple(_trial(one, content["config"]) for one in written),
            earlier=tuple(content["earlier"]),
            looks=tuple(content.get("looks", ())),
            words=tuple(content.get("words", ())),
        )
    except FileNotFoundError:
        raise StoreError(f"{path}: no such file; run the sweep first") from None
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise StoreError(f"{path}: is not a sweep's plan ({error})") from None


def _grown(path: Path, mark: str) -> list[dict[str, Any]]:
    """Trials that a plan has gained since it was written."""
    file = grown_file(path)
    if not mark or not file.exists():
        return []
    *lines, _ = file.read_text(encoding="utf-8").split(
        "\n"
    )  # behind the last line's end: nothing, or torn
    found = [json.loads(line) for line in lines]
    return [line["trial"] for line in found if line["of"] == mark]


def _trial(written: Mapping[str, Any], shared: Mapping[str, Any]) -> FrozenTrial:
    lists = {key: tuple(written[key]) for key in ("overrides", "stages")}
    return FrozenTrial(**{**written, **lists, "config": {**shared, **written["config"]}})


def _shared(configs: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    if not configs:
        return {}
    first, *others = configs
    return {
        key: value
        for key, value in first.items()
        if all(key in other and other[key] == value for other in others)
    }


def named_stages(layout: StoreFolder) -> set[str]:
    """Keys of the stages that any plan of a store names, wherever below its root the plan lies.

    Raises:
        StoreError: a plan is torn, of another version or cannot be read, so that nobody knows what it names.
    """
    paths = [*layout.plan_files(), *(path for path in layout.strays() if _looks_like_plan(path))]
    found: set[str] = set()
    for path in paths:
        found |= read_plan(path).stages
    return found


def _looks_like_plan(path: Path) -> bool:
    """Whether a file is a plan, or the beginning of one."""
    try:
        return '"trials": [' in path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        raise StoreError(f"{path}: cannot be read ({error.strerror})") from None
