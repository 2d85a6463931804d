"""Which program it is: what changes its digest, and what does not."""

import subprocess
from pathlib import Path

import pytest

from fl3d.core.errors import ConfigError
from fl3d.training.program import read_program

AUTHOR = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")


def git(folder: Path, *words: str) -> None:
    subprocess.run(["git", "-C", str(folder), *AUTHOR, *words], check=True, capture_output=True)


def test_a_repository_is_its_commit_its_changes_and_its_new_sources(tmp_path: Path) -> None:
    (tmp_path / "train.py").write_text("a")
    (tmp_path / "tools").mkdir()
    git(tmp_path, "init", "-q")
    with pytest.raises(ConfigError, match="no git repository with a commit; name the files"):
        read_program({"folder": "."}, tmp_path)
    git(tmp_path, "add", ".")
    git(tmp_path, "commit", "-qm", "one")
    clean = read_program({"folder": "."}, tmp_path)
    assert clean["about"].startswith("commit ")
    assert len(clean["digest"]) == 40
    (tmp_path / "tools" / "log.txt").write_text("output")
    assert read_program({"folder": "."}, tmp_path) == clean
    seen = {clean["digest"]}
    for name, text in (("train.py", "b"), ("tools/new.yaml", "x"), ("tools/new.yaml", "y")):
        (tmp_path / name).write_text(text)
        found = read_program({"folder": "."}, tmp_path)
        assert " + changes " in found["about"]
        seen.add(found["digest"])
    assert len(seen) == 4
    git(tmp_path, "checkout", "-q", "train.py")
    (tmp_path / "tools" / "new.yaml").unlink()
    assert read_program({"folder": "."}, tmp_path) == clean
