"""``seeds=5``: how many training seeds a sweep has, as every command reads it."""

import subprocess

import pytest

from fl3d.cli import main
from fl3d.config.compose import CONF
from fl3d.config.overrides import values_by_key
from fl3d.config.seeds import spell_out_seeds
from fl3d.core.errors import ConfigError
from fl3d.sweep.sweepers.grid import expand
from fl3d.sweep.sweepers.space import parse_space


def test_seeds_are_the_first_so_many() -> None:
    words = ["+sweep=gamma", "seeds=5", "data=kitti"]
    spelled = spell_out_seeds(words)
    assert values_by_key(spelled)["seed"] == [0, 1, 2, 3, 4]
    params = {"loss.gamma": "0,2"}
    by_hand = ["+sweep=gamma", "seed=0,1,2,3,4", "data=kitti"]
    assert expand(params, spelled) == expand(params, by_hand)
    assert [point[1] for point in expand(params, spelled).points] == [
        f"seed={n}" for n in range(5)
    ] * 2


def test_one_seed_is_seed_0() -> None:
    assert values_by_key(spell_out_seeds(["seeds=1"])) == {"seed": [0]}


def test_other_words_stay_as_they_are() -> None:
    words = ["-m", "detector.seeds=4", "+detector.seeds=4", "seed=3", "--metric", "bev/easy"]
    assert spell_out_seeds(words) == words


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["seeds=0"], "seeds=0: seeds is how many .* a whole number from 1 to 1000"),
        (["seeds=-1"], "whole number from 1"),
        (["seeds=abc"], "whole number from 1"),
        (["seeds=2.5"], "whole number from 1"),
        (["seeds=²"], "whole number from 1"),
        (["seeds="], "whole number from 1"),
        (["seeds"], "whole number from 1"),
        (["seeds=1001"], "whole number from 1 to 1000"),
        (["seeds=0,1,2"], "seeds says how many there are; to name them: seed=0,1,2"),
        (["seeds=range(0,4)"], r"to name them: seed=range\(0,4\)"),
        (["seeds=3", "seed=7"], "seeds=3 and seed=7: each says which seeds there are; keep one"),
        (["+seed=7", "seeds=3"], "keep one"),
        (["seeds=3", "seeds=4"], "seeds=3 and seeds=4"),
        (["+seeds=3"], r"\+seeds=3: seeds is no key of the config; write it plainly: seeds=5"),
        (["++seeds=3"], "write it plainly"),
        (["~seeds"], "write it plainly"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_seeds_that_cannot_be_told_are_refused(words: list[str], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        spell_out_seeds(words)


def test_a_study_refuses_a_number_of_seeds_and_takes_seeds_to_draw_from() -> None:
    """It trains a trial under one seed; ``seeds=3`` would promise three of each."""
    space = "loss.gamma=interval(0,5)"
    with pytest.raises(ConfigError, match=r"seeds=N: a study .* give 'seed=choice\(0,1,2\)'"):
        parse_space({}, [space, *spell_out_seeds(["seeds=3"])])
    with pytest.raises(ConfigError, match=r"seed=interval\(0,5\): a study .* seeds have no order"):
        parse_space({}, ["seed=interval(0,5)"])
    drawn = parse_space({}, [space, "seed=choice(0,1,2)"]).axes["seed"]
    assert drawn == parse_space({}, [space, "seed=0,1,2"]).axes["seed"]


@pytest.mark.parametrize(
    ("typed", "command", "heard"),
    [
        (["-m", "seeds=2"], "train", ["-m", "seed=range(0,2)"]),
        (["loss.gamma=0,2", "seeds=2", "--multirun"], "train", None),
        (["gains", "+sweep=gamma", "seeds=2"], "gains", ["+sweep=gamma", "seed=range(0,2)"]),
        (["plan", "seeds=2", "--margin", "1"], "plan", ["seed=range(0,2)", "--margin", "1"]),
        (["why", "III", "seeds=2"], "why", ["III", "seed=range(0,2)"]),
        (["seeds=2", "--cfg", "job"], "train", ["--cfg", "job"]),  # Hydra shows one trial
        (["-m", "seeds=2", "--help"], "train", ["-m", "--help"]),
    ],
)
def test_every_command_hears_seeds(
    typed: list[str], command: str, heard: list[str] | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[list[str]] = []
    monkeypatch.setattr(f"fl3d.commands.{command}.run", calls.append)
    main(typed)
    assert calls == [heard or ["loss.gamma=0,2", "seed=range(0,2)", "--multirun"]]


@pytest.mark.parametrize(
    ("typed", "message"),
    [
        (["detector=voxelnet", "seeds=3"], "which is a sweep: python -m fl3d -m"),
        (["-m", "seeds=0"], "fl3d: seeds=0:"),
        (["gains", "seeds=3", "seed=0"], "keep one"),
    ],
)
def test_slips_end_with_one_sentence(typed: list[str], message: str) -> None:
    with pytest.raises(SystemExit, match=message):
        main(typed)


@pytest.mark.parametrize("target", ["sweep-gamma", "plan", "gains", "figures", "tables", "report"])
def test_make_hands_seeds_on(target: str) -> None:
    def commands(*words: str) -> str:
        made = ["make", "-n", "-o", ".venv/installed", target, *words]
        done = subprocess.run(made, capture_output=True, text=True, cwd=CONF.parent, check=True)
        return done.stdout

    assert "seeds=5" in commands("SEEDS=5")
    assert "seeds" not in commands()
