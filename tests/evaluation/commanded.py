"""The command `evaluate`, called in this process."""

import pytest

from fl3d.commands.evaluate import run

Printed = pytest.CaptureFixture[str]


def evaluate(capsys: Printed, *words: object) -> tuple[int | str | None, str, str]:
    """Exit code, stdout and stderr of the command."""
    code: int | str | None = 0
    try:
        run([str(word) for word in words])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, out, err


def row(out: str, metric: str, name: str = "Car") -> list[str]:
    """Cells of a row of the table behind class and metric."""
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in out.splitlines()]
    return next(cells[2:] for cells in rows if cells[:2] == [name, metric])
