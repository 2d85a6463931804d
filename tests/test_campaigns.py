"""The campaigns, whole: `make test-slow`; and of the malformed files those that take no time.

What they try and have found is told in docs/robust.md.
"""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from fl3d.data.kitti import KittiFolder
from tests.campaigns.malformed_files import FILES, Spoilt
from tests.campaigns.starts import called
from tests.example_program import results

ROOT = Path(__file__).resolve().parent.parent
SECONDS = 3 * 3600
QUICK = [case for case in FILES if case.words[0] in ("evaluate", "compare")]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["kills", "malformed", "slow_disk", "clocks", "together"])
def test_a_campaign_finds_nothing(name: str) -> None:
    """In a process of its own: it forks, and adopts what its starts leave behind."""
    command = [sys.executable, "-m", f"tests.campaigns.{name}", "--seed", "0"]
    done = subprocess.run(
        command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=SECONDS
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.fixture(scope="module")
def whole(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Frames, and results of two levels."""
    folder = tmp_path_factory.mktemp("malformed")
    shutil.copytree(simulated, folder / "data")
    for level in ("0", "1"):
        own = folder / "exp" / level / "seed0" / "epoch_5" / "data"
        own.mkdir(parents=True)
        for name in KittiFolder(simulated).split("val"):
            labels = (simulated / f"training/label_2/{name}.txt").read_text().splitlines()
            (own / f"{name}.txt").write_text(results(labels, 0.2 + float(level), name))
    return folder


@pytest.mark.parametrize("case", QUICK, ids=[case.name for case in QUICK])
def test_a_malformed_file_is_answered_in_a_sentence(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], case: Spoilt
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(whole, copy)
    path = case.spoil(copy)
    code = called([word.replace("COPY", str(copy)) for word in case.words])
    said = capsys.readouterr().err
    assert "Traceback" not in said
    assert code in case.codes, said
    assert code == 0 or path.stem in said
