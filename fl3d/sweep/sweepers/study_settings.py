"""What a study may be told, checked before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from fl3d.config.settings import Settings
from fl3d.core.errors import ConfigError, options
from fl3d.core.names import check_name
from fl3d.evaluation.selection import RULES
from fl3d.sweep.sweepers.space import Space, is_in

WHERE = "hydra.sweeper"


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """How a study asks.

    Args:
        n_trials: how many are asked for, over all starts of this sweep.
        objectives: metrics to maximise, such as ``ap_3d_r40/moderate``; several make a Pareto front.
        rule: whose value counts: of the ``last`` or the ``best`` checkpoint.
        sampler: section with the ``_target_`` of an Optuna sampler; None: TPE.
        pruner: section of an Optuna pruner, or None; for one objective, on each checkpoint of a trial's last stage.
        storage: URL of a database for the study; None: a journal file below the store's root.
        study_name: None: the sweep's.
        enqueue: points to ask first, such as the baseline: ``[{loss.gamma: 0}]``.

    Raises:
        ConfigError: a value that cannot be used, by its key.
    """

    n_trials: int = 20
    objectives: Sequence[str] = ("ap_3d_r40/moderate",)
    rule: str = "last"
    sampler: Mapping[str, Any] | None = None
    pruner: Mapping[str, Any] | None = None
    storage: str | None = None
    study_name: str | int | None = None
    enqueue: Sequence[Mapping[str, Any]] = ()

    def __post_init__(self) -> None:
        """Refuse what cannot be used."""
        count = self.n_trials
        if not isinstance(count, int) or isinstance(count, bool) or count < 1:
            raise ConfigError(
                f"{WHERE}.n_trials: {_shown(count)} is not a whole number of at least 1; it counts the trials of all "
                "starts of the study"
            )
        if not isinstance(self.rule, str) or self.rule not in RULES:
            raise ConfigError(f"{WHERE}.rule: {options(_shown(self.rule), RULES)}")
        self._check_objectives()
        for key in ("sampler", "pruner"):
            _check_section(key, getattr(self, key))
        self._check_places()
        if not _is_list(self.enqueue) or not all(isinstance(one, Mapping) for one in self.enqueue):
            raise ConfigError(
                f"{WHERE}.enqueue: {_shown(self.enqueue)} is no list of points, such as [{{loss.gamma: 0}}]"
            )

    def _check_objectives(self) -> None:
        names = self.objectives
        if not _is_list(names) or not names or not all(isinstance(name, str) for name in names):
            raise ConfigError(
                f"{WHERE}.objectives: {_shown(names)} is no list of metrics, such as [ap_3d_r40/moderate]"
            )
        twice = next((name for name in names if list(names).count(name) > 1), None)
        if twice is not None:
            raise ConfigError(f"{WHERE}.objectives: '{twice}' is named twice")
        if self.pruner is not None and len(names) > 1:
            raise ConfigError(
                f"{WHERE}.pruner: Optuna prunes on one objective only; set pruner=null or one objective"
            )

    def _check_places(self) -> None:
        if self.storage is not None and not (
            isinstance(self.storage, str) and "://" in self.storage
        ):
            raise ConfigError(
                f"{WHERE}.storage: {_shown(self.storage)} is no URL of a database, such as "
                "postgresql://USER@HOST/OPTUNA or sqlite:///FILE; null: a journal file below store.root"
            )
        name = self.study_name
        if name is not None and not (isinstance(name, str | int) and not isinstance(name, bool)):
            raise ConfigError(f"{WHERE}.study_name: {_shown(name)} is no name of a study")
        if name is not None and self.storage is None:  # then a file has it
            check_name(f"{WHERE}.study_name", str(name))

    def check_with(self, settings: Settings, space: Space) -> None:
        """Refuse what does not go with a sweep and a search space.

        Raises:
            ConfigError: by its key.
        """
        for name in self.objectives:
            if name not in settings.protocol.metric_names:
                possible = options(name, settings.protocol.metric_names)
                raise ConfigError(f"{WHERE}.objectives: no metric '{name}'. {possible}")
        if settings.sweep.tables:
            raise ConfigError(
                "sweep.tables: the papers' tables are made of a grid; an Optuna sweep has tables of its own"
            )
        for point in self.enqueue:
            if set(point) != set(space.axes):
                raise ConfigError(
                    f"{WHERE}.enqueue: {dict(point)} does not name exactly {', '.join(space.axes)}"
                )
            for key, value in point.items():
                if not is_in(space.axes[key], value):
                    raise ConfigError(
                        f"{WHERE}.enqueue: {key}={_shown(value)} is outside of what is searched, {space.written(key)}"
                    )


def _check_section(key: str, section: object) -> None:
    """Refuse what is no section with a ``_target_``."""
    if section is None:
        return
    target = section.get("_target_") if isinstance(section, Mapping) else None
    if not isinstance(target, str):
        example = {"sampler": "samplers.RandomSampler", "pruner": "pruners.MedianPruner"}[key]
        raise ConfigError(
            f"{WHERE}.{key}: {_shown(section)} names no class; give {WHERE}.{key}._target_=optuna.{example}"
        )


def _is_list(value: object) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _shown(value: object) -> str:
    """As it is typed."""
    return "null" if value is None else str(value) or "''"
