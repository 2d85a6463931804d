"""The commands of README.md and docs/*.md, as they are printed there.

A block of commands is fenced without a language, and begins with a program. A comment above the fence may say why it is
not run, or which test runs it: ``<!-- not run: it needs a GPU -->``, ``<!-- run by tests/test_x.py -->``.
"""

import re
import shlex
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGES = (ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md")))
PROGRAMS = ("fl3d", "python", "make", "pip", "pytest", "mv", "eval", "optuna-dashboard", ".", "$")
BLOCK = re.compile(
    r"^(?:<!-- (?P<mark>[^\n]*) -->\n)?```(?P<kind>\w*)\n(?P<text>.*?)^```$", re.M | re.S
)
COMMENT = re.compile(r"\s+# .*$")


@dataclass(frozen=True)
class Command:
    """A command of a page.

    Args:
        page: its file name.
        line: as a shell takes it, on one line and without the comment behind it.
        not_run: why it is not run; empty: it is.
        run_by: the test that runs it; empty: ``test_docs_commands`` does.
    """

    page: str
    line: str
    not_run: str = ""
    run_by: str = ""

    @property
    def fl3d(self) -> list[str]:
        """What fl3d is given: of a make target what it would start; none: it is another program's."""
        first, *rest = shlex.split(self.line)
        if first == "make":
            return [line for line in made(rest) if line.startswith(".venv/bin/python -m fl3d ")]
        return [self.line] if first == "fl3d" or self.line.startswith("python -m fl3d ") else []


def made(arguments: list[str]) -> list[str]:
    """The commands of make targets."""
    done = subprocess.run(
        ["make", "-n", *arguments], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return done.stdout.splitlines()


def commands_of(page: Path) -> Iterator[Command]:
    """The commands of a page, in its order."""
    for block in BLOCK.finditer(page.read_text(encoding="utf-8")):
        text = block["text"].replace("\\\n", " ")
        if block["kind"] or not text.split() or text.split()[0] not in PROGRAMS:
            continue
        kind, _, said = (block["mark"] or "").partition(" ")
        marks = {}
        if kind == "not":
            marks["not_run"] = said.removeprefix("run: ")
        elif kind == "run":
            marks["run_by"] = said.removeprefix("by ")
        lines = text.splitlines()
        if lines[0].startswith("$ "):  # what follows is what it prints
            lines = [lines[0].removeprefix("$ ")]
        for line in lines:
            yield Command(page.name, COMMENT.sub("", line).strip(), **marks)


ALL = [command for page in PAGES for command in commands_of(page)]
