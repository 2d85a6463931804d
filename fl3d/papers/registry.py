"""All papers that fl3d knows, and their tables by name."""

from __future__ import annotations

from collections.abc import Iterable

from fl3d.core.errors import ConfigError, options
from fl3d.papers.base import Paper, PaperTable
from fl3d.papers.course_report.paper import COURSE_REPORT
from fl3d.papers.focal_loss.paper import FOCAL_LOSS

PAPERS = (FOCAL_LOSS, COURSE_REPORT)
TABLES = {table.name: table for paper in PAPERS for table in paper.tables}


def tables_named(names: Iterable[str]) -> list[PaperTable]:
    """The tables that a sweep names.

    Raises:
        ConfigError: there is no such table.
    """
    for name in names:
        if name not in TABLES:
            raise ConfigError(f"sweep.tables: no table '{name}'. {options(name, TABLES)}")
    return [TABLES[name] for name in names]


def papers_of(names: Iterable[str]) -> list[Paper]:
    """The papers whose tables a sweep names."""
    wanted = set(names)
    return [paper for paper in PAPERS if any(table.name in wanted for table in paper.tables)]
