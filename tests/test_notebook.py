"""The example notebook runs from simulated frames to a verdict, and its figures can be shown."""

import ast
import json
from pathlib import Path
from typing import Any

import pytest

from tests.conftest import ROOT

NOTEBOOK = ROOT / "examples" / "from_python.ipynb"


def cells() -> list[str]:
    """Its code, a text a cell."""
    found: list[dict[str, Any]] = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    return ["".join(cell["source"]) for cell in found if cell["cell_type"] == "code"]


def shown(source: str, names: dict[str, Any]) -> Any:
    """Run a cell; what a notebook would show: the value of its last line, if that is one."""
    *body, last = ast.parse(source).body
    if not isinstance(last, ast.Expr):
        body, last = [*body, last], None
    exec(compile(ast.Module(body, []), "cell", "exec"), names)
    return (
        None if last is None else eval(compile(ast.Expression(last.value), "cell", "eval"), names)
    )


def test_every_cell_is_python_and_none_holds_output() -> None:
    for source in cells():
        ast.parse(source)
    stored = json.loads(NOTEBOOK.read_text(encoding="utf-8"))["cells"]
    assert not any(cell.get("outputs") for cell in stored)


@pytest.mark.slow
def test_the_notebook_goes_from_frames_to_a_verdict(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    names: dict[str, Any] = {"__name__": "__main__"}
    values = [shown(source, names) for source in cells()]
    pictures = [value for value in values if hasattr(value, "_repr_png_")]
    assert len(pictures) == 3
    for picture in pictures:
        assert picture._repr_png_().startswith(b"\x89PNG")
    sweep = names["sweep"]
    assert sweep.trials["done"].tolist() == [True] * 6
    assert sweep.levels == ["0", "2"]
    assert set(sweep.verdicts["level"]) == {"0", "2"}
    assert set(sweep.figures) == {
        *("forest", "ap_over_level", "ap_over_steps", "ap_over_cut", "precision_recall")
    }
    assert (sweep.gains["average"] == "R40").any()
