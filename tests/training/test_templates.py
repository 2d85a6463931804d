"""Places in command lines, and how values come into them."""

import subprocess

import pytest

from fl3d.core.errors import ConfigError
from fl3d.training.templates import check_names, fill, names_in


def test_each_argument_stays_one_whatever_its_value_holds() -> None:
    line = ["train", "--note={note}", "{gamma}", "a b"]
    values = {"note": "it's; rm -rf {x} $HOME", "gamma": 0.5}
    assert fill(line, values) == ["train", "--note=it's; rm -rf {x} $HOME", "0.5", "a b"]


def test_an_argument_that_is_a_list_becomes_one_for_each_of_its_items() -> None:
    assert fill(["x", "{set}", "y"], {"set": ["--set", "A B", 2]}) == [
        "x",
        "--set",
        "A B",
        "2",
        "y",
    ]
    assert fill(["x", "{set}"], {"set": []}) == ["x"]
    assert fill(["s={set}"], {"set": [1, 2]}) == ["s=[1,2]"]


def test_values_of_a_line_of_bash_are_quoted() -> None:
    line = fill(
        "printf '%s|' {note} {set} ${{HOME:+home}}", {"note": "a 'b' $c;d", "set": [1, "x y"]}
    )
    assert isinstance(line, str)
    done = subprocess.run(["bash", "-c", line], capture_output=True, text=True, check=True)
    assert done.stdout == "a 'b' $c;d|1|x y|home|"


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (True, "true"),
        (None, "null"),
        (2, "2"),
        (1e-5, "1e-05"),
        (0.5, "0.5"),
        ({"a": 1}, '{"a":1}'),
    ],
)
def test_values_are_written_as_people_type_them(value: object, text: str) -> None:
    assert fill(["{v}"], {"v": value}) == [text]


def test_a_place_that_has_no_value_is_answered_with_those_that_have() -> None:
    with pytest.raises(ConfigError, match=r"no placeholder \{gama\}. Did you mean 'gamma'\?"):
        check_names(["--g={gama}"], "detector.run", ["gamma", "seed"])
    with pytest.raises(ConfigError, match=r"a single \{ is no placeholder; write \{\{"):
        names_in("{", "detector.run")
