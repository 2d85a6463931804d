"""The frozen plan of a sweep: what its trials are, whatever configs say later. The only parser of it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fl3d.core.errors import StoreError
from fl3d.core.files import write_text
from fl3d.core.records import Trial
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


def write_plan(path: Path, plan: FrozenPlan) -> None:
    """Freeze a plan; what all trials share is written once."""
    shared = _shared([trial.config for trial in plan.trials])
    trials = []
    for trial in plan.trials:
        own = {key: value for key, value in trial.config.items() if key not in shared}
        trials.append({**vars(trial), "config": own})
    content = {
        "version": VERSION,
        "factor": plan.factor,
        "baseline": plan.baseline,
        "trials": trials,
        "config": shared,
        "earlier": sorted(plan.earlier),
        **({"looks": plan.looks} if plan.looks else {}),
        **({"words": plan.words} if plan.words else {}),
    }
    write_text(path, json.dumps(content, indent=1) + "\n")


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
        return FrozenPlan(
            factor=tuple(content["factor"]),
            baseline=content["baseline"],
            trials=tuple(_trial(one, content["config"]) for one in content["trials"]),
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
