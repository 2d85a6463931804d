"""README.md and docs/: links lead somewhere, commands are fl3d's, the site has every page and every key."""

import importlib
import os
import re
import subprocess
import sys
import tomllib
from fnmatch import fnmatchcase
from functools import cache
from pathlib import Path

import pytest
import yaml

from fl3d.cli import COMMANDS
from fl3d.config.compose import CONF
from fl3d.config.rules import RULES
from tests.documented import ALL, PAGES, ROOT, Command

sys.path.insert(0, str(ROOT / "docs" / "site"))
reference = importlib.import_module("reference")
LINKING = (*PAGES, ROOT / "benchmarks" / "README.md", ROOT / "results" / "README.md")
# Keys that every YAML writes in one line with the section above them, whose comment says what they are.
PARTS_OF_A_SECTION = (
    "schedule.epochs.*",
    *(f"schedule.decay.{key}" for key in ("every", "factor", "lowest")),
)
LINK = re.compile(r"!?\[[^\]]*\]\(([^)\s]+)\)")
OURS = [one for one in ALL if one.fl3d]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text().splitlines()) < 200


def prose(page: Path) -> str:
    """A page without its fenced blocks and its code."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    return re.sub(r"`[^`\n]*`", lambda match: match[0].replace("](", ""), text)


@cache
def anchors(page: Path) -> set[str]:
    """Headings of a page, as GitHub and the site call them."""
    lines = re.findall(r"^#+ (.*)$", prose(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", line.lower()).strip().replace(" ", "-") for line in lines}


@pytest.mark.parametrize("page", LINKING, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page: Path) -> None:
    links = [link for link in LINK.findall(prose(page)) if not link.startswith("http")]
    for link in links:
        place, _, anchor = link.partition("#")
        target = (page.parent / place).resolve() if place else page
        assert target.is_file(), f"{page.name}: {link}"
        assert not anchor or anchor in anchors(target), f"{page.name}: {link}"


def test_pages_that_the_code_names_are_there() -> None:
    for path in [*(ROOT / "fl3d").rglob("*.py"), *CONF.rglob("*.yaml")]:
        for name in re.findall(r"\b(?:docs|benchmarks)/\w+\.md", path.read_text(encoding="utf-8")):
            assert (ROOT / name).is_file(), f"{path}: {name}"


def test_the_site_shows_every_page() -> None:
    text = re.sub(r"!!python/\S+ ", "", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"))
    shown = set(re.findall(r"[\w/]+\.md", str(yaml.safe_load(text)["nav"])))
    assert {path.relative_to(ROOT).as_posix() for path in LINKING} <= shown


def test_what_is_not_run_says_why_and_what_another_test_runs_is_there() -> None:
    for command in ALL:
        assert not command.run_by or (ROOT / command.run_by).is_file(), command
        assert not command.not_run or len(command.not_run.split()) > 2, command


@cache
def helped(name: str) -> str:
    return str(reference.help_of([name, "--help"]))


@pytest.mark.parametrize("command", OURS, ids=lambda one: f"{one.page} {one.line[:50]}")
def test_words_of_a_command_are_fl3ds(command: Command) -> None:
    """Parsed alone, which is less than run: options, groups and sweep files that do not exist."""
    for line in command.fl3d:
        words = line.partition("fl3d ")[2].split()
        name = words[0] if not words[0].startswith(("-", "'")) and "=" not in words[0] else ""
        assert not name or name in COMMANDS, line
        for word in words:
            option = word.partition("=")[0]
            if name and option.startswith("--") and option != "--config-dir":
                assert option in helped(name), line
            group, _, choice = word.strip("'").lstrip("+").partition("=")
            if "--config-dir" not in words and (CONF / group).is_dir() and "(" not in choice:
                options = {path.stem for path in (CONF / group).glob("*.yaml")} | {"height_map"}
                assert set(choice.split(",")) <= options, line


def test_every_key_has_a_row_with_a_meaning() -> None:
    rows = re.findall(r"^\| `([^`]+)` \|.*\| ([^|]*) \|$", reference.config(), re.MULTILINE)
    told = {key for key, meaning in rows if meaning.strip()}
    for rule in RULES:
        if rule not in PARTS_OF_A_SECTION:
            assert any(fnmatchcase(key, rule) for key in told), rule


@pytest.mark.slow
def test_the_site_builds_without_a_warning_and_needs_no_network(tmp_path: Path) -> None:
    pytest.importorskip("mkdocs", reason="make docs installs what builds the site")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=600
    )
    assert done.returncode == 0, done.stderr
    pages = {path: path.read_text(encoding="utf-8") for path in tmp_path.rglob("*.html")}
    assert tmp_path / "index.html" in pages
    for path, text in pages.items():
        assert "<!-- generated" not in text, path
        assert not re.search(r"<(script|img|link)[^>]+(src|href)=\"?(https?:)?//", text), path


def test_what_machines_check_is_make_check_and_make_test() -> None:
    ci = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text())
    (job,) = ci["jobs"].values()
    assert job["strategy"]["matrix"]["target"] == ["check", "test"]
    assert [step["run"] for step in job["steps"] if "run" in step] == ["make ${{ matrix.target }}"]
    for action in (step["with"] for step in job["steps"] if "with" in step):
        assert (ROOT / action["cache-dependency-path"]).is_file()
        lowest = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["requires-python"]
        assert lowest == f">={action['python-version']}"
    config = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text())
    hooks = config["repos"][0]["hooks"]
    assert [hook["entry"] for hook in hooks] == ["make check", "make test"]
    assert [hook["stages"] for hook in hooks] == [["pre-commit"], ["pre-push"]]
    assert config["default_install_hook_types"] == ["pre-commit", "pre-push"]
    assert {"check", "test"} <= set(re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), re.M))
