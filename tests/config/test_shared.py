"""What trials share of a composition: a value set beside it is what composing anew would give."""

import math
from typing import Any

import pytest

from fl3d.config.compose import compose_config, multirun, resolve
from fl3d.config.hydra_app import composed, hydra_session
from fl3d.config.overrides import parse
from fl3d.config.shared import Shared
from fl3d.core.errors import ConfigError
from fl3d.core.nested import leaves

WORDS = ["detector=voxelnet", "data=simulated", "profile=tiny"]


def shared(words: list[str] = WORDS) -> Shared:
    with hydra_session():
        return Shared(composed(words), resolve)


def another(value: Any) -> str:
    """A value of the same kind, as one types it."""
    if isinstance(value, bool):
        return str(not value).lower()
    if isinstance(value, int):
        return str(value + 1)
    return repr(value / 2 or 0.25) if isinstance(value, float) else f"{value}x"


def outcome(make: Any) -> Any:
    """What a call gives, or the error's text."""
    try:
        return make()
    except ConfigError as error:
        return str(error)


def test_every_plain_key_is_set_as_composing_sets_it() -> None:
    config = compose_config(WORDS)
    sharing = shared()
    plain = {key: v for key, v in leaves(config) if isinstance(v, int | float | str)}
    assert len(plain) > 60
    for key, value in plain.items():
        word = f"{key}={another(value)}"
        found = outcome(lambda word=word: sharing.having([parse(word)]))
        assert found == outcome(lambda word=word: sharing._anew([parse(word)])), word
        if isinstance(found, dict):
            assert dict(leaves(found))[key] != value, word


def test_what_is_shared_is_not_changed() -> None:
    sharing = shared()
    before = compose_config(WORDS)
    first = sharing.having([parse("loss.gamma=5"), parse("optimizer.lr=0.5")])
    assert sharing.having([]) == before
    assert (first["loss"]["gamma"], first["optimizer"]["lr"]) == (5, 0.5)
    assert first["schedule"] is sharing.having([])["schedule"]


def test_what_another_value_reads_is_resolved_anew() -> None:
    """The warm-up's epochs are named by its stage, and here the seed by a weight of the loss."""
    sharing = shared([*WORDS, "loss.alpha=${seed}"])
    assert sharing.having([parse("seed=7")])["loss"]["alpha"] == 7
    assert sharing.having([parse("schedule.epochs.warmup=9")]) == compose_config(
        [*WORDS, "loss.alpha=${seed}", "schedule.epochs.warmup=9"]
    )
    nested = shared([*WORDS, 'loss.alpha="${loss.${sweep.name}}"', "sweep.name=eta"])
    assert nested.having([parse("loss.eta=0.25")])["loss"]["alpha"] == 0.25


def test_text_that_names_a_value_is_resolved() -> None:
    found = shared().having([parse("optimizer.lr=${loss.alpha}")])
    assert found["optimizer"]["lr"] == found["loss"]["alpha"]


@pytest.mark.parametrize("word", ["optimizer.lr=nan", "seed=-1", "schedule.batch_size=0"])
def test_a_value_that_cannot_be_is_refused(word: str) -> None:
    with pytest.raises(ConfigError, match=word.partition("=")[0]):
        shared().having([parse(word)])


def test_a_value_that_each_trial_overrules_may_be_wrong_in_what_they_share() -> None:
    asked = multirun([*WORDS, "seed=-1", "seed=3,4"])
    assert asked.compose([*WORDS, "seed=-1", "seed=3"])["seed"] == 3


def test_numbers_keep_their_kind() -> None:
    found = shared().having([parse("loss.gamma=1"), parse("optimizer.lr=1e-3")])
    assert type(found["loss"]["gamma"]) is int
    assert math.isclose(found["optimizer"]["lr"], 0.001)
