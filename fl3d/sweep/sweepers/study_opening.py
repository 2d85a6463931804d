"""Opens a study, and refuses what does not go on with what it was begun with."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import optuna
from optuna.distributions import BaseDistribution
from optuna.study import StudyDirection
from optuna.trial import FrozenTrial

from fl3d.config.settings import Settings
from fl3d.core.errors import ConfigError
from fl3d.sweep.sweepers.samplers import BRUTE, Axes, Samplers, make_pruner
from fl3d.sweep.sweepers.space import change_of, in_hydras_grammar
from fl3d.sweep.sweepers.study_settings import StudySettings
from fl3d.sweep.sweepers.study_storage import experimental, open_storage
from fl3d.sweep.sweepers.study_trials import Trials, is_told

SEED = "fl3d.sampler_seed"  # attribute of a study: of its first start


def directions(asked: StudySettings) -> list[StudyDirection]:
    """Every objective is maximised."""
    return [StudyDirection.MAXIMIZE] * len(asked.objectives)


def open_study(
    name: str,
    asked: StudySettings,
    settings: Settings,
    samplers: Samplers,
    say: Callable[[str], None],
) -> optuna.Study:
    """Open a study where it is kept, or begin it.

    Args:
        name: of the study.
        asked: how it asks.
        settings: of the sweep.
        samplers: make its sampler.
        say: told what was mended.

    Raises:
        ConfigError: it was begun with other settings.
        StoreError: where it is kept is damaged or cannot be reached.
    """
    store = settings.store
    storage = open_storage(asked.storage, store.root, store.uri, name=name, say=say)
    with experimental():
        study = optuna.create_study(
            storage=storage,
            study_name=name,
            directions=directions(asked),
            pruner=make_pruner(asked.pruner),
            load_if_exists=True,
        )
    meaning: dict[str, object] = {
        "objectives": list(asked.objectives),
        "rule": asked.rule,
        "protocol": settings.protocol.id,
    }
    _check_meaning(study, meaning)
    _remember(study, {**meaning, SEED: samplers.seed})
    study.sampler = samplers.make(len(study.get_trials(deepcopy=False)), study.user_attrs[SEED])
    return study


def _check_meaning(study: optuna.Study, meaning: dict[str, object]) -> None:
    """Refuse a study whose values mean something else.

    Raises:
        ConfigError: naming what differs.
    """
    for key, value in meaning.items():
        before = study.user_attrs.get(key, value)
        if before != value:
            raise ConfigError(
                f"{key}: the study '{study.study_name}' was begun with {before}, not {value}; their "
                "values cannot be compared; give another hydra.sweeper.study_name"
            )


def _remember(study: optuna.Study, attributes: dict[str, object]) -> None:
    """Let a new study keep what its values mean."""
    for key, value in attributes.items():
        if key not in study.user_attrs:
            study.set_user_attr(key, value)


def check_axes(trials: Trials, axes: Axes, samplers: Samplers) -> None:
    """Refuse a space that a study cannot go on with.

    Args:
        trials: of the study.
        axes: what is searched now.
        samplers: of the sweep: one that goes through a space bears no change of it.

    Raises:
        ConfigError: naming what was and what is.
    """
    for trial in trials.all():
        is_searched = trials.is_ours(trial) and is_told(trial)
        changes = [
            *(_other_keys(trial, axes) if is_searched else ()),
            *_changed(trial, axes, samplers),
        ]
        if changes:
            raise ConfigError(
                f"hydra.sweeper.params: the study '{trials.name}' was begun with another space: {'; '.join(changes)}. "
                "Give another hydra.sweeper.study_name (what both propose is not trained twice), or the space of before"
            )


def _other_keys(trial: FrozenTrial, axes: Axes) -> Sequence[str]:
    before = trial.distributions
    if set(before) == set(axes):
        return ()
    return [f"it searched {', '.join(before)}, and this one {', '.join(axes)}"]


def _changed(trial: FrozenTrial, axes: Axes, samplers: Samplers) -> list[str]:
    """Axes that are not what they were, each with how."""
    pairs = [
        (key, trial.distributions[key], axes[key]) for key in axes if key in trial.distributions
    ]
    changes = [(key, _change(before, now, samplers)) for key, before, now in pairs]
    return [f"{key} {change}" for key, change in changes if change]


def _change(before: BaseDistribution, now: BaseDistribution, samplers: Samplers) -> str:
    if samplers.inner is BRUTE and before != now:
        return f"was {in_hydras_grammar(before)} and is {in_hydras_grammar(now)}"
    return change_of(before, now)
