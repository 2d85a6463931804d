"""The tables of a comparison of detectors: as papers print them, and as a terminal shows them."""

from __future__ import annotations

from collections.abc import Mapping

from fl3d.analysis.compare import Compared
from fl3d.reports.comparison import ONE_RUN, Shown, ap_table, gain_table, verdict_table
from fl3d.reports.render import to_text, wrapped
from fl3d.reports.table import Table

NAME_LETTERS = 16  # of a detector's name on a terminal of 100 columns


def tables_of(compared: Compared) -> list[Table]:
    """Of each class the verdicts, APs in R40 and R11, and gains."""
    shown = shown_of(compared)
    tables = []
    for name in compared.classes:
        tables.append(verdict_table(compared.verdicts, name, shown))
        tables += [ap_table(compared.cells, name, average, shown) for average in ("R40", "R11")]
        tables.append(gain_table(compared.cells, name, shown))
    return tables


def text_of(compared: Compared) -> str:
    """Gains and verdicts as Markdown that fits a terminal; long names are cut in their middle."""
    short = short_names(compared.held.names, NAME_LETTERS)
    whole = shown_of(compared)
    shown = Shown([short[name] for name in whole.names], short[whole.baseline], whole.margin)
    cells = compared.cells.replace({"detector": short})
    verdicts = compared.verdicts.replace({"level": short})
    parts = []
    for name in compared.classes:
        parts.append(to_text(gain_table(cells, name, shown, narrow=True)))
        parts.append(to_text(verdict_table(verdicts, name, shown)))
    return "\n".join([*parts, *map(wrapped, whole.notes)])


def shown_of(compared: Compared) -> Shown:
    """Whom the tables show, and what has to be known beside their numbers."""
    units = compared.held.units
    # Where copies leave one run, the notes say so.
    is_single = (compared.verdicts["seeds"] == 1).all() and not compared.verdicts["copies"].any()
    notes = (units.note, *([ONE_RUN.format(units=units.name)] if is_single else []))
    return Shown(compared.held.names, compared.baseline, compared.margin, (*notes, *compared.notes))


def short_names(names: tuple[str, ...], letters: int) -> Mapping[str, str]:
    """Names of so many letters at most, long ones cut in their middle; whole where they could not be told apart."""
    half = (letters - 1) // 2
    short = {n: n if len(n) <= letters else f"{n[:half]}…{n[-half:]}" for n in names}
    return short if len(set(short.values())) == len(short) else {name: name for name in names}
