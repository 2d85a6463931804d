"""Tables that were made once and are kept, see ``kept``."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.kept import Arrays, code_digest, kept

JSON = "json"


def kept_table(path: Path | None, made_of: Mapping[str, Any], make: Callable[[], Table]) -> Table:
    """A table as it is kept, or made and then kept.

    Args:
        path: where; None: it is made.
        made_of: plain values that decide what ``make`` gives, but for what a table is.
        make: gives the table.
    """
    if path is None:
        return make()

    def written() -> Arrays:
        text = json.dumps(asdict(make()))
        return {JSON: np.frombuffer(text.encode(), dtype=np.uint8)}

    whole = {**made_of, "tables": code_digest("reports/table.py", "runs/kept_tables.py")}
    return _read(kept(path, whole, written)[JSON].tobytes())


def _read(text: bytes) -> Table:
    values = json.loads(text)
    return Table(
        **values
        | {
            "columns": tuple(Column(**one) for one in values["columns"]),
            "rows": tuple(tuple(Cell(**one) for one in row) for row in values["rows"]),
            "notes": tuple(values["notes"]),
            "csv_order": tuple(values["csv_order"]),
        }
    )
