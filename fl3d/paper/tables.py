"""All that a store can tell for a paper: the tables in every form, made again from what is stored. Trains nothing."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pandas as pd

from fl3d.config import CONF, compose_config
from fl3d.errors import DataError, StoreError
from fl3d.gains import Compared, comparable, compare_sweep, gains
from fl3d.paper.index import write_index
from fl3d.records import Config
from fl3d.reports.beside import beside
from fl3d.reports.figures.curves import ap_over_gamma
from fl3d.reports.intervals import with_intervals
from fl3d.reports.layer_tables import DETECTORS, layer_table
from fl3d.reports.published import REPORT_TABLES, published_table
from fl3d.reports.render import to_markdown
from fl3d.reports.selection import select
from fl3d.reports.table import Cell, Column, Table
from fl3d.reports.tables import LAST_TABLES
from fl3d.reports.write import write_tables
from fl3d.results import names, report_from_store, results_folder
from fl3d.training.build import build_detector


def write_all_tables(overrides: list[str], say: Callable[[str], None] = print) -> None:
    """Make all tables again for which the store, or the results folder, holds scores.

    Args:
        overrides: of the config; ``+sweep=NAME`` keeps to one sweep.
        say: prints a line for the user.

    Raises:
        StoreError: there is nothing to make tables of.
    """
    chosen = any(override.startswith("+sweep=") for override in overrides)
    configs = [compose_config(overrides)] if chosen else list(stored_sweeps(overrides))
    for config in configs:
        refuse_without_tables(config)
        tables, scores = report_from_store(config, say)
        write_views(config, tables, scores, say)
    write_still_tables(results_folder(configs[0]), say)
    write_index(Path(configs[0]["results"]))


def refuse_without_tables(config: Config) -> None:
    """A study's trials are no rows of the paper's tables, and must not take the place of a grid's.

    Raises:
        StoreError: the sweep feeds no table.
    """
    if not config["sweep"]["tables"]:
        raise StoreError(
            f"sweep {config['sweep']['name']} feeds no table of the paper (sweep.tables); look at it in make ui"
        )


def stored_sweeps(overrides: list[str]) -> list[Config]:
    """Configs of the sweep files that the store, or the results folder, holds scores of, for some data and profile.

    Raises:
        StoreError: of none.
    """
    found = []
    for path in sorted((CONF / "sweep").glob("*.yaml")):
        config = compose_config([*overrides, f"+sweep={path.stem}"])
        called = names(config)
        scores = results_folder(config) / "scores" / f"{called.sweep}.csv"
        if config["sweep"]["tables"] and (called.plan(Path(config["store"]["root"])).exists() or scores.exists()):
            found.append(config)
    if not found:
        called = names(compose_config(overrides))
        raise StoreError(f"no sweep of {called.results} was run here, and there are no scores of one; make sweep-gamma")
    return found


def write_views(config: Config, tables: list[Table], scores: pd.DataFrame, say: Callable[[str], None]) -> list[Table]:
    """Write each table beside the published one, and with intervals where the detections are stored; all of these."""
    views = [view for view in map(beside, tables) if view is not None]
    try:
        views += interval_views(config, tables, scores, results_folder(config) / "figures")
    except (DataError, StoreError) as error:
        say(f"No intervals, which need stored detections and the data's labels: {error}")
    for view in views:
        say("\n" + to_markdown(view))
    folder = results_folder(config)
    written = write_tables(views, folder)
    say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return views


def interval_views(config: Config, tables: list[Table], scores: pd.DataFrame, figures: Path) -> list[Table]:
    """The tables with intervals: best models for IV, last ones for others; and AP over gamma, with bars.

    Tables of recall have none.
    """
    best = select(scores, "best", config["selection"]["stages"])
    steps = dict(zip(best["trial"], best["step"], strict=True))
    views, found = [], {}
    for table in tables:
        if table.number in REPORT_TABLES:
            continue
        rule = "best" if table.number == "IV" else "last"
        by = "normalize" if table.number == "V" else "gamma"
        if (rule, by) not in found:
            found[rule, by] = _gains(compare_sweep(config, steps if rule == "best" else None, by), rule, by)
            if (rule, by) == ("last", "gamma"):
                name = "ap_over_gamma" if table.number in LAST_TABLES else f"ap_over_{config['sweep']['name']}"
                ap_over_gamma(scores, figures / name, found[rule, by])
        own = found[rule, by]
        if table.number in ("II", "III"):
            own = own[own["detector"] == table.caption.rpartition(" ")[2]]
        views.append(with_intervals(table, own))
    return views


def _gains(compared: Compared, rule: str, by: str) -> pd.DataFrame:
    """Gains, each with the text of the row it belongs to."""
    table = gains(comparable(compared))
    if by == "normalize":
        return table.assign(row=table["gamma"].map({0.0: "Original", 1.0: "Enhanced"}))
    text = table["gamma"].map(lambda gamma: f"{gamma:g}")
    return table.assign(row=table["detector"] + " " + text if rule == "best" else text)


def write_still_tables(folder: Path, say: Callable[[str], None]) -> list[Table]:
    """Write Tables I, VI and VII, that need no training: traits, layers and work of the networks; all of these."""
    traits = published_table("I")
    columns = (
        Column("property", ""),
        Column("image", "Image-based"),
        Column("fcn3d", "3D-FCN"),
        Column("voxelnet", "VoxelNet"),
    )
    rows = tuple(tuple(Cell(text) for text in row) for row in traits.itertuples(index=False))
    tables = [Table("I", "The two detectors beside image-based ones, as the paper describes them", columns, rows)]
    for number, name in DETECTORS.items():
        config = compose_config([f"detector={name}", "profile=paper"])
        tables.append(layer_table(number, lambda config=config: build_detector(config)))  # type: ignore[misc]
    for table in tables[1:]:
        say("\n" + to_markdown(table))
    write_tables(tables, folder)
    return tables
