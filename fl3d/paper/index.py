"""results/README.md: every results folder with its tables and pictures."""

from __future__ import annotations

from pathlib import Path

from fl3d.files import write_text

HEAD = """# Results

Made by `make report` (and `make tables`, `make figures`); each folder is one kind of data and one profile. Its
`report.html` has everything on one page: clone or download it to read it.
"""
PAPER = ("II_intervals", "III_intervals", "IV_intervals", "V_intervals")
OTHERS = ("gamma-pointrcnn_intervals", "gamma-f-convnet_intervals", "R1", "R2", "R3", "R4", "R5", "R6", "R7")
TABLES = (*PAPER, *OTHERS, "claims", "honest")
PICTURES = (
    "ap_over_gamma",
    "ap_over_gamma_pointrcnn",
    "ap_over_gamma_fconvnet",
    "ap_over_steps",
    "figure_4",
    "figure_5",
)


def write_index(results: Path) -> Path:
    """Write the index of a folder of results folders."""
    parts = [HEAD]
    for folder in sorted(path for path in results.iterdir() if (path / "tables").is_dir()):
        parts.append(f"## {folder.name}\n")
        if (folder / "report.html").exists():
            parts.append(f"[report.html]({folder.name}/report.html) · [tables]({folder.name}/tables)\n")
        for name in TABLES:
            table = folder / "tables" / f"table_{name}.md"
            if not table.exists():
                table = folder / "tables" / f"table_{name.partition('_')[0]}.md"
            if table.exists():
                parts.append(table.read_text())
        for name in PICTURES:
            if (folder / "figures" / f"{name}.png").exists():
                parts.append(f"![{name}]({folder.name}/figures/{name}.png)\n")
    path = results / "README.md"
    write_text(path, "\n".join(parts))
    return path
