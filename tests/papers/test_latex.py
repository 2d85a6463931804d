"""LaTeX takes every table."""

import shutil
import subprocess
from pathlib import Path

import pytest

from fl3d.papers.focal_loss.best_models import BEST_MODELS
from fl3d.papers.focal_loss.layers import still_tables
from fl3d.papers.focal_loss.tables import LAST_3D_FCN, LAST_VOXELNET, LOSS_FORMS
from fl3d.reports.levels import Levels, levels_table
from fl3d.reports.render import to_latex
from tests.papers.published_tables import papers_table
from tests.reports.frames import tidy_scores

TABLES = (LAST_3D_FCN, LAST_VOXELNET, BEST_MODELS, LOSS_FORMS)


@pytest.mark.slow
@pytest.mark.skipif(
    shutil.which("pdflatex") is None, reason="no pdflatex here (Debian: texlive-latex-recommended)"
)
def test_latex_compiles_and_nothing_is_too_wide(tmp_path: Path) -> None:
    tables = [papers_table(table.number) for table in TABLES]
    tables += [
        view
        for made, table in zip(TABLES, tables, strict=True)
        for view in [made.beside(table)]
        if view
    ]
    tables += still_tables(lambda _: None)
    levels = Levels("alpha, beta", ["alpha=0.5, beta=5", "alpha=1, beta=10"], "alpha=0.5, beta=5")
    tables.append(
        levels_table(tidy_scores(levels.labels), "VoxelNet", levels, "any_name-voxelnet", "R40")
    )
    head = r"\documentclass[twocolumn]{article}\usepackage{booktabs,graphicx}\begin{document}"
    text = "\n".join(
        [head, *(to_latex(table) + r"\clearpage" for table in tables), r"\end{document}"]
    )
    (tmp_path / "all.tex").write_text(text)
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "all.tex"]
    done = subprocess.run(
        command, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120
    )
    assert done.returncode == 0, done.stdout[-2000:]
    assert "Overfull" not in done.stdout
