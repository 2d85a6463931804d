"""Which names a sweep, a dataset, a profile and a stage can have: those that a file, a link and a URL can hold."""

import pytest

from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.core.errors import ConfigError
from fl3d.core.names import LONGEST, check_name
from fl3d.runs.layout import StoreFolder

GOOD = ("gamma", "gamma_2", "a.b-c", "2024", "Größe", "学习率", "x" * LONGEST)
BAD = {
    "alice/gamma": "holds '/'",
    "../../evil": "holds '/'",
    "..": r"begins with '\.'",
    ".": r"begins with '\.'",
    ".hidden": r"begins with '\.'",
    "-m": "begins with '-'",
    "a\\b": r"holds '\\'",
    "": "is no name",
    "a b": "holds a blank",
    "a\nb": r"holds the letter U\+000A",
    "a\u202eb": r"holds the letter U\+202E",
    "a%2Fb": "holds '%'",
    "a#b": "holds '#'",
    "a?b": r"holds '\?'",
    "a:b": "holds ':'",
    "a'b": "holds '''",
    "a*": r"holds '\*'",
    "x" * 250: r"'x{64}\.\.\.' is 250 bytes long",
    "學" * 22: "is 66 bytes long",
}


@pytest.mark.parametrize("name", GOOD)
def test_a_good_name_is_taken_as_it_is(name: str) -> None:
    assert check_name("sweep.name", name) == name


@pytest.mark.parametrize("name", BAD)
def test_another_is_refused_with_what_is_possible(name: str) -> None:
    with pytest.raises(ConfigError, match=rf"^sweep\.name: .*{BAD[name]}\. A name has letters"):
        check_name("sweep.name", name)


def test_a_number_is_a_name_and_other_values_are_none() -> None:
    assert check_name("sweep.name", 2024) == "2024"
    for value in (None, True, ["a"], {"a": 1}):
        with pytest.raises(ConfigError, match="is no name"):
            check_name("sweep.name", value)


@pytest.mark.parametrize("key", ["sweep.name", "data.name", "profile.name", "protocol.name"])
def test_every_name_that_files_have_is_checked(key: str) -> None:
    with pytest.raises(ConfigError, match=rf"^{key}: '\.\./evil' holds '/'"):
        read_settings(compose_config([f"{key}=../evil"]))


def test_the_longest_names_make_files_that_a_file_system_takes() -> None:
    long = "x" * LONGEST
    names = [f"{key}.name={long}" for key in ("sweep", "data", "profile")]
    settings = read_settings(compose_config(names))
    lease = StoreFolder(settings.store.root).lease(settings.experiment).name
    assert len(f".{lease}.{'0' * 32}.clock") <= 255
