"""Processes of fl3d's do not run the program that calls fl3d again."""

import subprocess
import sys
from multiprocessing.spawn import get_preparation_data
from pathlib import Path

import pytest

import fl3d.api.sweeps
from fl3d.core.errors import ConfigError
from fl3d.core.processes import pool, without_main

MAIN = {"init_main_from_name", "init_main_from_path"}


def main_for_a_new_process() -> set[str]:
    """What a process that is started now would load of this one's program."""
    return MAIN & set(get_preparation_data("worker"))


def test_a_new_process_loads_nothing_of_the_program() -> None:
    before = main_for_a_new_process()
    assert before  # pytest's
    with without_main():
        assert not main_for_a_new_process()
        with without_main():
            assert not main_for_a_new_process()
        assert not main_for_a_new_process()
    assert main_for_a_new_process() == before


def test_workers_of_a_pool_and_of_a_sweep_are_started_so(monkeypatch: pytest.MonkeyPatch) -> None:
    with pool(1):
        assert not main_for_a_new_process()
    seen: list[set[str]] = []

    def look(words: tuple[str, ...]) -> list[str]:
        seen.append(main_for_a_new_process())
        raise ConfigError("that will do")

    monkeypatch.setattr(fl3d.api.sweeps, "_spelled", look)
    with pytest.raises(ConfigError, match="that will do"):
        fl3d.run("loss.gamma=0,1")
    assert seen == [set()]
    assert main_for_a_new_process()


def test_a_script_of_a_few_lines_needs_no_main(tmp_path: Path) -> None:
    """It ran itself anew in each worker, and so on without an end."""
    script = tmp_path / "few_lines.py"
    lines = [
        "import fl3d",
        "from fl3d.simulator import generate",
        "generate.FEW = 2  # workers for so few frames too",
        "fl3d.simulate('street', frames=3, pictures=False, workers=2)",
        "print('once')",
    ]
    script.write_text("\n".join(lines))
    done = subprocess.run(
        [sys.executable, str(script)], cwd=tmp_path, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["once"]
    assert len(list((tmp_path / "street/training/velodyne").iterdir())) == 3
