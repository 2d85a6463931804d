"""Processes of fl3d's do not run the program that calls fl3d again."""

import subprocess
import sys
from multiprocessing.spawn import get_preparation_data
from pathlib import Path
from types import ModuleType

import pytest

from fl3d.core.processes import pool, without_main
from fl3d.sweep.launchers import local
from fl3d.sweep.launchers.local import LocalLauncher

MAIN = {"init_main_from_name", "init_main_from_path"}


def main_for_a_new_process() -> set[str]:
    """What a process that is started now would load of this one's program."""
    return MAIN & set(get_preparation_data("worker"))


@pytest.fixture(autouse=True)
def program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A script is what runs, whatever started the tests."""
    script = ModuleType("__main__")
    script.__file__ = str(tmp_path / "script.py")
    monkeypatch.setitem(sys.modules, "__main__", script)


def test_a_new_process_loads_nothing_of_the_program() -> None:
    before = main_for_a_new_process()
    assert before == {"init_main_from_path"}
    with without_main():
        assert not main_for_a_new_process()
        with without_main():
            assert not main_for_a_new_process()
        assert not main_for_a_new_process()
    assert main_for_a_new_process() == before


def test_workers_of_a_pool_are_started_so() -> None:
    with pool(1):
        assert not main_for_a_new_process()
    assert main_for_a_new_process()


def test_stages_of_a_sweep_are_started_so(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    seen: list[set[str]] = []

    class Started:
        exitcode = 0

        def __init__(self, **_: object) -> None: ...

        def start(self) -> None:
            seen.append(main_for_a_new_process())

    launcher = LocalLauncher(slots=1)
    monkeypatch.setattr(launcher._context, "Process", Started)
    monkeypatch.setattr(local._Worker, "give", lambda *_: True)
    launcher.launch(tmp_path)
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
