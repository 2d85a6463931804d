"""Everything of a comparison of detectors in one folder: tables, figures and a page of them."""

from __future__ import annotations

import json
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from fl3d.analysis.compare import Compared
from fl3d.analysis.compare_tables import tables_of
from fl3d.analysis.differences import ALARMS, changed_frames, cuts, found_by_part
from fl3d.analysis.surroundings import Surroundings
from fl3d.core.files import write_text
from fl3d.reports.comparison import VIEWS, metric_text
from fl3d.reports.figures.curves import precision_recall
from fl3d.reports.figures.differences import draw_found_by_part, frames_from_above
from fl3d.reports.figures.forest import forest
from fl3d.reports.levels import Levels, slug
from fl3d.reports.page import Section, folded, listing, page, paragraph, picture, preformatted
from fl3d.reports.render import to_html, to_latex, to_markdown
from fl3d.reports.table import Table

FEW = 3  # frames of each kind that are drawn
RECALLS = np.arange(41) / 40
FOREST = (
    "Gain of each detector over {baseline} in AP, with 95 % intervals that hold for all of a class at once, and "
    "number of runs (n); grey: the margin within which a gain does not matter."
)
CURVES = "Precision against recall, moderate; of several runs the mean at each recall."
PARTS = (
    "{name}, {view}: share of the objects found, by what they are like; numbers of objects below. Each detector is cut "
    "at the score where it makes {alarms:g} false alarms a frame. Bars: 95 % intervals, each for itself."
)
FRAMES = (
    "Frames in which {other} finds {more} than {baseline}, false alarms taken off; both cut at {alarms:g} false alarms "
    "a frame. Above each: {baseline} → {other}. The stroke in a box points to its front."
)


def write_comparison(
    compared: Compared, folder: Path, surroundings: Surroundings, command: str = ""
) -> list[Path]:
    """Write tables (Markdown, LaTeX, CSV), figures and one page.

    Args:
        compared: see ``compare.compare_detectors``.
        folder: is made.
        surroundings: clouds and pictures, where they are at hand.
        command: that made it, for the page.

    Returns:
        ``compare.html`` first, then the other files.

    Raises:
        DataError: clouds, calibrations or pictures cannot be read.
    """
    surroundings.check(compared.held.ids)
    tables = tables_of(compared)
    written = _write_tables(tables, compared, folder)
    figures = folder / "figures"
    levels = Levels("", compared.held.names, compared.baseline)
    plot = forest(_told(compared.verdicts), levels, compared.margin)
    drawn = [] if plot is None else plot.write(figures / "forest")
    recalls = _curves(compared)
    order = list(dict.fromkeys(recalls["group"]))
    curves = precision_recall(recalls, levels, order).write(figures / "precision_recall")
    points = surroundings.points_on_objects(compared)
    parts, frames = [], []
    for name in compared.classes:
        data = found_by_part(compared, name, points)
        path = figures / f"found_{slug(name)}"
        parts.append((name, draw_found_by_part(data, compared.held.names, path)))
        frames += _draw_frames(compared, name, surroundings, figures)
    sections = [
        Section("Verdict", (_shown(drawn, FOREST.format(baseline=compared.baseline)), *_html(tables, "-verdicts"))),
        Section("AP", (*_html(tables, "-r40"), *_html(tables, "-gains"), *_folded(tables, "-r11"))),
        Section("Precision and recall", (_shown(curves, CURVES),)),
        Section("Where they differ", tuple(_shown(paths, _part_caption(compared, name)) for name, paths in parts)),
        Section("Frames", tuple(_shown(paths, caption) for caption, paths in frames)),
        Section("How it was made", _provenance(compared, command)),
    ]  # fmt: skip
    title = f"{' and '.join(compared.others)} against {compared.baseline}"
    lead = f"{len(compared.held.ids)} frames, {', '.join(compared.classes)}. {compared.held.units.note}"
    target = folder / "compare.html"
    write_text(target, page(title, lead, [one for one in sections if any(one.parts)]))
    files = [*written, *drawn, *curves, *(p for _, paths in [*parts, *frames] for p in paths)]
    return [target, *files]


def _told(verdicts: pd.DataFrame) -> pd.DataFrame:
    """Verdicts with their metrics in words, which stand in the panels' titles where they differ."""
    told = verdicts.assign(metric=verdicts["metric"].map(metric_text))
    if told["metric"].nunique() == 1:
        return told
    return told.assign(group=told["group"] + ", " + told["metric"], metric="AP")


def _write_tables(tables: Sequence[Table], compared: Compared, folder: Path) -> list[Path]:
    texts = {
        "compare.md": "\n".join(to_markdown(table) for table in tables),
        "compare.tex": "\n".join(to_latex(table) for table in tables),
        "compare.csv": compared.cells.to_csv(index=False, lineterminator="\n"),
        "verdicts.csv": compared.verdicts.to_csv(index=False, lineterminator="\n"),
    }
    for name, text in texts.items():
        write_text(folder / name, text)
    return [folder / name for name in texts]


def _shown(paths: Sequence[Path], caption: str) -> str:
    """The PNG of some written files, on the page; nothing where nothing was drawn."""
    pngs = [path for path in paths if path.suffix == ".png"]
    return picture(pngs[0].read_bytes(), caption) if pngs else ""


def _html(tables: Sequence[Table], ending: str) -> list[str]:
    """Tables of one kind, as their names end."""
    return [to_html(table) for table in tables if table.name.endswith(ending)]


def _folded(tables: Sequence[Table], ending: str) -> list[str]:
    """Likewise, opened by a click."""
    return [
        folded(table.caption, to_html(table)) for table in tables if table.name.endswith(ending)
    ]


def _part_caption(compared: Compared, name: str) -> str:
    return PARTS.format(name=name, view=VIEWS[compared.primary(name)], alarms=ALARMS)


def _curves(compared: Compared) -> pd.DataFrame:
    """Precision at 41 recalls of each class and view (``group``) and detector (``level``)."""
    held, rows = compared.held, []
    for class_name in compared.classes:
        for view, told in VIEWS.items():
            for name in held.names:
                if view not in held.metrics(name, class_name):
                    continue
                runs = [
                    one.curve(class_name, view, "moderate").precision for one in held.runs[name]
                ]
                front = {"group": f"{class_name}, {told}", "level": name, "recall": RECALLS}
                rows.append(pd.DataFrame({**front, "precision": np.mean(runs, axis=0)}))
    return pd.concat(rows, ignore_index=True)


def _draw_frames(
    compared: Compared, class_name: str, surroundings: Surroundings, figures: Path
) -> list[tuple[str, list[Path]]]:
    """Frames with the largest change, for each detector those gained and those lost: captions and files."""
    if compared.primary(class_name) == "image":
        return []
    at = cuts(compared, class_name)
    drawn = []
    for number, other in enumerate(compared.others):
        if other not in at:
            continue
        frames = changed_frames(compared, class_name, other)
        kinds = {"more": frames[frames["change"] > 0].head(FEW)}
        kinds["less"] = frames[frames["change"] < 0].tail(FEW).iloc[::-1]
        for more, rows in kinds.items():
            if rows.empty:
                continue
            names = (compared.baseline, other)
            seen = [
                (
                    _frame_title(row),
                    [
                        surroundings.seen(compared, name, at[name][0], row["place"])
                        for name in names
                    ],
                )
                for row in rows.to_dict("records")
            ]
            words = {"other": other, "more": more, "baseline": compared.baseline, "alarms": ALARMS}
            path = figures / f"frames_{slug(class_name)}_{number + 1}_{more}"
            caption = f"{class_name}: {FRAMES.format(**words)}"
            drawn.append((caption, frames_from_above(seen, names, path)))
    return drawn


def _frame_title(row: Mapping[Hashable, Any]) -> str:
    found = f"found {row['found_base']} → {row['found']} of {row['n_gt']}"
    return f"{row['frame']}\n{found}, alarms {row['alarms_base']} → {row['alarms']}"


def _provenance(compared: Compared, command: str) -> tuple[str, ...]:
    held = compared.held
    folders = [f"{one.name}: {', '.join(map(str, one.folders))}" for one in held.detectors]
    protocol = f"Protocol {held.protocol.id}: {json.dumps(asdict(held.protocol))}"
    return (
        *([preformatted(command)] if command else []),
        listing(folders),
        paragraph(protocol),
        paragraph("Results are taken as they are, neither cut nor suppressed."),
    )
