"""The words of a sweep: whatever reads a sweep takes those that it was started with."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

from fl3d.config.compose import Multirun, multirun
from fl3d.config.hydra_app import for_hydra
from fl3d.config.objects import locate
from fl3d.config.overrides import is_interval, values_by_key
from fl3d.config.places import PUBLISHED
from fl3d.config.settings import BY_HAND, Settings, read_settings
from fl3d.core.errors import StoreError
from fl3d.papers.stored import place_words, stored_sweeps
from fl3d.runs.asked import Asked, apart, asked_for
from fl3d.runs.by_hand import find_by_hand, has_by_hand, names_by_hand
from fl3d.runs.by_hand_names import told
from fl3d.runs.design import SEED, label_of
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.opening import is_stored, open_sweep
from fl3d.sweep.by_hand import named

JUDGED = {"sweep.primary": "primary", "sweep.margin": "margin"}  # keys that verdicts are by


@dataclass(frozen=True)
class Words:
    """What the words of a sweep mean.

    Args:
        multirun: as Hydra reads them.
        settings: of the sweep.
        asked: values by key that were named: of a finished sweep those trials are meant.
    """

    multirun: Multirun
    settings: Settings
    asked: Asked


def read_words(overrides: Sequence[str]) -> Words:
    """Read the words of a sweep, swept values among them.

    Raises:
        ConfigError: a group, option, key or value that does not exist.
    """
    composed = multirun(overrides)
    listed = [
        word for word in for_hydra(overrides) if not is_interval(word)
    ]  # a study's trials are not told by its intervals
    asked = values_by_key(listed)
    door = locate(composed.sweeper["_target_"], "hydra.sweeper._target_")
    if getattr(door, "counts_seeds", False) and len(asked.get(SEED, ())) == 1:
        del asked[SEED]  # says where seeds begin
    return Words(composed, read_settings(composed.base), asked)


def open_words(words: Words, row: Sequence[str] = ()) -> FinishedSweep:
    """The finished sweep that words mean; without a name one that was typed by hand, see ``runs.by_hand``.

    Args:
        words: of the sweep.
        row: words that pick a row of it, which it must have.

    Raises:
        StoreError: no trial of it is done here, or none that was typed by hand fits.
    """
    settings = words.settings
    if settings.sweep.name == BY_HAND:
        try:
            name = str(named(words.multirun).base["sweep"]["name"])
            settings = find_by_hand(settings, _typed(words, row), name)
        except StoreError:
            if not is_stored(settings, PUBLISHED):
                raise
    sweep = open_sweep(settings, words.asked, PUBLISHED)
    return apart(sweep, _otherwise(words, sweep))


def _otherwise(words: Words, sweep: FinishedSweep) -> list[str]:
    """Words that judge a sweep otherwise than it was judged when it was run: by another metric, or another margin."""
    arguments = words.multirun.arguments
    started = values_by_key([one for one in sweep.plan.words if _key(one) in JUDGED])
    plain = [one for one in arguments if _key(one) not in JUDGED]
    default = sweep.settings.sweep
    if len(plain) < len(arguments):
        default = read_settings(multirun(plain).base).sweep
    found = []
    for key, name in JUDGED.items():
        now = getattr(sweep.settings.sweep, name)
        if now != started.get(key, [getattr(default, name)])[0]:
            found.append(f"{name}={label_of(now)}")
    return found


def _key(word: str) -> str:
    return word.partition("=")[0].lstrip("+")


def _typed(words: Words, row: Sequence[str]) -> list[str]:
    """All words, but for a seed that says only where seeds begin."""
    typed = words.multirun.arguments
    return [*(word for word in typed if SEED in words.asked or told([word]).keys() != {SEED}), *row]


def or_gamma(words: Sequence[str], row: Sequence[str] = ()) -> list[str]:
    """Words that name a sweep, or mean one that was typed by hand; else those of +sweep=gamma too.

    Args:
        words: of the sweep.
        row: words that pick a row of it.
    """
    if names_sweep(words):
        return list(words)
    if len(place_words(words)) < len(words) or row:
        read = read_words(words)
        if has_by_hand(read.settings, _typed(read, row)):
            return list(words)
        gamma = read_words([*words, "+sweep=gamma"]).settings
        if has_by_hand(read.settings, ()) and not is_stored(gamma, PUBLISHED):
            return list(words)  # that none of those by hand fits is then told, with what there is
    return [*words, "+sweep=gamma"]


def names_sweep(overrides: Sequence[str]) -> bool:
    """Whether words name a sweep, by its file or by a name of the user's own."""
    return any(
        word.startswith(("+sweep=", "sweep=", "sweep.name=", "++sweep")) for word in overrides
    )


def sweeps_of(words: Sequence[str]) -> list[FinishedSweep]:
    """The sweep that words mean, or every one that was run on their data and profile.

    Raises:
        StoreError: there is none.
    """
    places = place_words(words)
    seeds = [word for word in words if word.partition("=")[0] == SEED]
    if names_sweep(words) or len(places) + len(seeds) < len(words):
        return [open_words(read_words(words))]
    settings = read_words(words).settings
    found = stored_sweeps(places, PUBLISHED)
    for name in names_by_hand(settings):
        with suppress(StoreError):  # none of its trials is done
            found.append(open_words(read_words([*places, f"sweep.name={name}"])))
    if seeds:
        wanted = values_by_key(seeds)[SEED]
        found = [chosen for sweep in found if (chosen := _of_seeds(sweep, wanted)).trials]
    if not found:
        raise StoreError(
            f"{settings.store.root}: no sweep of {settings.folder_name} was run here"
            f"{' with any of these seeds' if seeds else ''}, and there are no scores of one; "
            "python -m fl3d -m +sweep=gamma, or give the words of a sweep of your own (sweep.name=...)"
        )
    return found


def _of_seeds(sweep: FinishedSweep, wanted: Sequence[int]) -> FinishedSweep:
    """A sweep's trials of those of some seeds that it has."""
    seeds = {trial.seed for trial in sweep.trials}.intersection(wanted)
    if not seeds:
        return replace(sweep, trials=())
    return asked_for(sweep, {SEED: sorted(seeds)})
