"""The paper's own tables, as if they were ours."""

from fl3d.papers.focal_loss.published_cells import published_table
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Column, Table

FRONT = {
    "II": ["gamma"],
    "III": ["gamma"],
    "IV": ["detector", "gamma", "lr", "step"],
    "V": ["loss"],
}


def papers_table(number: str, shift: float = 0.0) -> Table:
    """A published table as our own, its rows but the first shifted by some AP."""
    rows = []
    for place, row in enumerate(published_table(number).to_dict("records")):
        moved = shift if place > 0 else 0.0
        aps = [
            Cell(f"{float(row[key]) + moved:.2f}", row[f"{key}_bold"] == "1") for key in AP_COLUMNS
        ]
        rows.append((*(Cell(row[key]) for key in FRONT[number]), *aps))
    columns = (*(Column(key, key) for key in FRONT[number]), *APS)
    return Table(number, "models", columns, tuple(rows), title=f"Table {number}.")
