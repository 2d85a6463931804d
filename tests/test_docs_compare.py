"""docs/compare.md: its commands run, and print what the page says."""

import os
import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "compare.md"
BLOCK = re.compile(r"^```(python)?\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def run(block: str, folder: Path) -> str:
    """Standard output of the commands of a block."""
    command = re.sub(r"^python ", f"{sys.executable} ", block, flags=re.MULTILINE)
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        ["bash", "-ec", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_page_prints_what_it_says(tmp_path: Path) -> None:
    """Two commands, what they read, what each prints, and the same from Python."""
    kinds, blocks = zip(*BLOCK.findall(PAGE.read_text()), strict=True)
    assert kinds == ("", "", "", "", "", "python")
    one_run, three_runs, setup, of_one, of_three, library = blocks
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    run(setup, tmp_path)
    assert run(one_run, tmp_path) == of_one
    assert run(three_runs, tmp_path).endswith(of_three)
    for path in re.findall(
        r"`(compare\.\w+|verdicts\.csv|figures/[a-z]+_?[a-z]*)", PAGE.read_text()
    ):
        assert list((tmp_path / "comparison").glob(f"{path}*")), path
    (tmp_path / "library.py").write_text(library)
    printed = run("python library.py\n", tmp_path)
    assert len(printed.splitlines()) == 1 + 2 * 9 * 2  # detectors, cells, averages
