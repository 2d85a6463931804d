"""Tables as Markdown, LaTeX, HTML and CSV. Pure."""

from __future__ import annotations

import csv
import html
import io
import textwrap
from itertools import groupby

from fl3d.reports.table import Cell, Table

GROUPS = {"BEV": r"Bird's Eye View AP (\%)", "3D": r"3D Detection AP (\%)"}
LATEX = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"}
LATEX |= {character: rf"\{character}" for character in "_%&#${}"}
SHRINK = r"\resizebox{\ifdim\width>\linewidth\linewidth\else\width\fi}{!}{%"  # to the column's width, if wider
TEXT_LETTERS = 100  # of a line on a terminal
SYMBOLS = {
    "γ": r"$\gamma$",
    "α": r"$\alpha$",
    "β": r"$\beta$",
    "η": r"$\eta$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "×": r"$\times$",
    "ρ": r"$\rho$",
    "−": r"$-$",
}
SYMBOLS |= {"<": "$<$", ">": "$>$", "–": "--", "…": r"\ldots{}", "†": r"$\dagger$", "§": r"\S{}"}

ESCAPED = LATEX | SYMBOLS


def to_csv(table: Table) -> str:
    """Comma-separated, plain numbers."""
    keys = [column.key for column in table.columns]
    order = [keys.index(key) for key in (table.csv_order or keys)]
    out = io.StringIO()
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow([keys[i] for i in order])
    writer.writerows(
        [row[i].text if row[i].raw is None else row[i].raw for i in order] for row in table.rows
    )
    return out.getvalue()


def to_markdown(table: Table) -> str:
    """GitHub Markdown."""
    heads = [f"{column.group} {column.head}".strip() for column in table.columns]
    rule = "|" + "|".join("---:" if column.is_number else "---" for column in table.columns) + "|"
    title = f"**{table.title}** " if table.title else ""
    lines = [title + _sentence(table), "", _line(heads), rule]
    lines += [_line([_markdown(cell) for cell in row]) for row in table.rows]
    if table.notes:
        lines += ["", *(f"{note}  " for note in table.notes)]
    return "\n".join(lines) + "\n"


def to_text(table: Table) -> str:
    """For a terminal: Markdown whose columns stand below each other."""
    rows = [[f"{column.group} {column.head}".strip() for column in table.columns]]
    rows += [[_markdown(cell) for cell in row] for row in table.rows]
    widths = [max(3, *map(len, cells)) for cells in zip(*rows, strict=True)]
    of_columns = list(zip(table.columns, widths, strict=True))
    rule = ["-" * (w - 1) + ":" if column.is_number else "-" * w for column, w in of_columns]
    lines = [
        [
            text.rjust(width) if column.is_number else text.ljust(width)
            for text, (column, width) in zip(row, of_columns, strict=True)
        ]
        for row in [rows[0], rule, *rows[1:]]
    ]
    notes = ["", *map(wrapped, table.notes)] if table.notes else []
    return "\n".join([wrapped(_sentence(table)), "", *map(_line, lines), *notes]) + "\n"


def wrapped(text: str) -> str:
    """A sentence in lines of a terminal."""
    return textwrap.fill(text, TEXT_LETTERS, break_on_hyphens=False)


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _sentence(table: Table) -> str:
    return ". ".join(part for part in (table.caption, table.legend) if part) + "."


def _markdown(cell: Cell) -> str:
    text = cell.text.replace("|", r"\|")
    return (f"**{text}**" if cell.bold else text) + (r"\*" if cell.star else "")


def to_latex(table: Table) -> str:
    """A table that compiles as it is, with booktabs and graphicx; a wide one spans both columns of a page."""
    width = (
        sum(max(len(cell.text) for cell in column) for column in zip(*table.rows, strict=True))
        if table.rows
        else 0
    )
    kind = "table*" if width > 60 else "table"
    groups = [
        (name, len(list(columns)))
        for name, columns in groupby(table.columns, lambda column: column.group)
    ]
    lines = [rf"\begin{{{kind}}}[t]", r"\centering", r"\setlength{\tabcolsep}{4pt}"]
    lines += [rf"\caption{{{_latex(_sentence(table))}}}", SHRINK]
    lines += [
        rf"\begin{{tabular}}{{{''.join('r' if c.is_number else 'l' for c in table.columns)}}}",
        r"\toprule",
    ]
    if any(name for name, _ in groups):
        cells = [_span(GROUPS.get(name, name), n) if name else "& " * (n - 1) for name, n in groups]
        lines += [" & ".join(cells) + r" \\", _rules(groups)]
    lines += [" & ".join(_latex(column.head) for column in table.columns) + r" \\", r"\midrule"]
    lines += [" & ".join(_latex_cell(cell) for cell in row) + r" \\" for row in table.rows]
    lines += [r"\bottomrule", r"\end{tabular}}"]
    lines += (
        [rf"\par\smallskip\footnotesize {_latex(' '.join(table.notes))}"] if table.notes else []
    )
    return "\n".join([*lines, rf"\end{{{kind}}}"]) + "\n"


def _span(text: str, n: int) -> str:
    return rf"\multicolumn{{{n}}}{{c}}{{{text}}}"


def _rules(groups: list[tuple[str, int]]) -> str:
    """Lines under the groups' names."""
    rules, start = [], 1
    for name, n in groups:
        rules += [rf"\cmidrule(lr){{{start}-{start + n - 1}}}"] if name else []
        start += n
    return " ".join(rules)


def _latex_cell(cell: Cell) -> str:
    text = _latex(cell.text)
    return (rf"\textbf{{{text}}}" if cell.bold else text) + (
        r"\textsuperscript{*}" if cell.star else ""
    )


def _latex(text: str) -> str:
    return "".join(ESCAPED.get(character, character) for character in text)


def to_html(table: Table) -> str:
    """An element for a page."""
    groups = [
        (name, len(list(columns)))
        for name, columns in groupby(table.columns, lambda column: column.group)
    ]
    title = f"<b>{table.title}</b> " if table.title else ""
    lines = [
        f"<figure id='table-{table.name}'><figcaption>{title}{html.escape(_sentence(table))}</figcaption>"
    ]
    lines += ["<div class='scroll'><table><thead>"]
    if any(name for name, _ in groups):
        spans = (f"<th class='group' colspan='{n}'>{html.escape(name)}</th>" for name, n in groups)
        lines += ["<tr>" + "".join(spans) + "</tr>"]
    heads = (
        f"<th{' class=number' if c.is_number else ''}>{html.escape(c.head)}</th>"
        for c in table.columns
    )
    lines += ["<tr>" + "".join(heads) + "</tr></thead>", "<tbody>"]
    for row in table.rows:
        cells = zip(row, table.columns, strict=True)
        lines += [
            "<tr>" + "".join(_html_cell(cell, column.is_number) for cell, column in cells) + "</tr>"
        ]
    notes = [f"<p class='note'>{html.escape(note)}</p>" for note in table.notes]
    return "\n".join([*lines, "</tbody></table></div>", *notes, "</figure>"]) + "\n"


def _html_cell(cell: Cell, is_number: bool) -> str:
    text = html.escape(cell.text)
    text = (f"<b>{text}</b>" if cell.bold else text) + ("<sup>*</sup>" if cell.star else "")
    return f"<td class='number'>{text}</td>" if is_number else f"<td>{text}</td>"
