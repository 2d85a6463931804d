"""The README of the published results."""

from pathlib import Path

from fl3d.papers.index import write_index


def test_the_papers_question_comes_first(tmp_path: Path) -> None:
    folder = tmp_path / "simulated-quick"
    for name in ("tables", "figures"):
        (folder / name).mkdir(parents=True)
    for sweep in ("from_scratch", "gamma", "gamma_pointrcnn", "mine"):
        (folder / "figures" / f"forest_{sweep}.png").touch()
        (folder / "tables" / f"table_{sweep}_verdicts-x.md").write_text(f"Verdicts of {sweep}.")
    (folder / "tables" / "table_II.md").write_text("Table II.")
    text = write_index(tmp_path).read_text()
    order = ["gamma", "from_scratch", "gamma_pointrcnn", "mine"]
    wanted = [*(f"forest_{name}.png" for name in order), *(f"of {name}." for name in order)]
    places = [text.index(word) for word in [*wanted, "Table II."]]
    assert places == sorted(places)
