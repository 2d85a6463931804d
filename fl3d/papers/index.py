"""The README of a folder of results: every results folder with its tables and pictures."""

from __future__ import annotations

from pathlib import Path

from fl3d.core.files import write_text
from fl3d.papers.published import SWEEPS

HEAD = """# Results

Made by `make publish`; each folder is one kind of data and one profile. Its `stamp.json` says from which data, and by
which commit and on which machine each of its sweeps was made. Of your own runs `make report` makes a page with figures.
What was found comes first: for each level a verdict by its gain over the baseline, from three seeds of training on.
"""
VERDICTS = "_verdicts-"  # in the names of their tables
PICTURES = ("ap_over_level_*", "ap_over_cut_*", "ap_over_steps_*", "figure_4", "figure_5")


def write_index(results: Path) -> Path:
    """Write the index of a folder of results folders."""
    parts = [HEAD]
    for folder in sorted(path for path in results.iterdir() if (path / "tables").is_dir()):
        parts.append(f"## {folder.name}\n")
        parts += _pictures(folder, "forest_*")
        tables = _tables(folder / "tables")
        tables.sort(key=_place_of_table)  # stable: those without verdicts follow as they are
        parts += [path.read_text(encoding="utf-8") for path in tables]
        for pattern in PICTURES:
            parts += _pictures(folder, pattern)
    path = results / "README.md"
    write_text(path, "\n".join(parts))
    return path


def _pictures(folder: Path, pattern: str) -> list[str]:
    paths = sorted((folder / "figures").glob(f"{pattern}.png"))
    paths.sort(key=lambda path: _place(path.stem.removeprefix(pattern.rstrip("*"))))
    return [f"![{path.stem}]({folder.name}/figures/{path.name})\n" for path in paths]


def _place(sweep: str) -> int:
    """Of a sweep among the published ones: the paper's question comes first."""
    return list(SWEEPS).index(sweep) if sweep in SWEEPS else len(SWEEPS)


def _place_of_table(path: Path) -> tuple[bool, int]:
    sweep, is_verdict, _ = path.stem.removeprefix("table_").partition(VERDICTS)
    return not is_verdict, _place(sweep) if is_verdict else 0


def _tables(folder: Path) -> list[Path]:
    """Each table once, with intervals where it has them; those that need no training are left out."""
    every = {path.stem.removeprefix("table_"): path for path in sorted(folder.glob("table_*.md"))}
    shown = []
    for name, path in every.items():
        is_view = name.endswith(("_published", "_intervals"))
        if not is_view and name not in ("I", "VI", "VII"):
            shown.append(every.get(f"{name}_intervals", path))
    return shown
