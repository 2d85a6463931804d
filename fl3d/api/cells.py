"""A cell of a table: the words that pick it, and the chain from it to its files."""

from __future__ import annotations

from collections.abc import Sequence

import pandas as pd

from fl3d.analysis.trace import trace
from fl3d.api.words import Words, names_sweep, open_words, or_gamma, read_words
from fl3d.config.overrides import values_by_key
from fl3d.core.errors import ConfigError, StoreError, options
from fl3d.evaluation.selection import RULES
from fl3d.papers.base import PaperTable
from fl3d.papers.registry import TABLES
from fl3d.papers.tables import paper_tables
from fl3d.runs.design import DETECTOR, SEED, label_of, level_text, short_names
from fl3d.runs.finished import FinishedSweep


def explain_words(table: str, pairs: Sequence[str], metric: str) -> None:
    """Print the chain of each trial behind the cell that words pick.

    Args:
        table: of a paper, or a rule of ``evaluation.selection``.
        pairs: KEY=VALUE: those that pick the row may be short, the others choose the sweep.
        metric: such as ``3d/moderate``.

    Raises:
        ConfigError: a table, row or metric that does not exist.
        StoreError: there is no such sweep here.
    """
    row = [word for word in pairs if is_short(word) and is_one_value(word)]
    words = [word for word in pairs if word not in row or _is_detector(word)]
    short = [word for word in row if not _is_detector(word)]
    is_papers = table not in RULES  # whose tables only sweep files feed
    named = (
        or_gamma(words, short) if names_sweep(words) or not is_papers else [*words, "+sweep=gamma"]
    )
    sweep = _open(read_words(named), short, table)
    swept = {key for trial in sweep.plan.trials for key in trial.values}
    if DETECTOR not in swept:  # then it only says under which settings the sweep ran
        row = [word for word in row if not _is_detector(word)]
    row += [  # written out: loss.gamma=2
        word
        for word in words
        if word.partition("=")[0] in swept - {DETECTOR} and is_one_value(word)
    ]
    values = {key: label_of(value) for key, (value,) in values_by_key(row).items()}
    explain(sweep, table, values, metric)


def _open(words: Words, row: Sequence[str], table: str) -> FinishedSweep:
    """The sweep that words mean; where it is not here, a table that none feeds is told before that.

    Raises:
        ConfigError: there is no such table.
        StoreError: there is no such sweep here.
    """
    try:
        return open_words(words, row)
    except StoreError:
        possible = [*(known.number for known in TABLES.values()), *RULES]
        if table not in possible:
            raise ConfigError(
                f"no sweep feeds a table '{table}'. {options(table, possible)}"
            ) from None
        raise


def _is_detector(word: str) -> bool:
    """Whether a word names a detector, which may choose the sweep's protocol besides the row."""
    return word.partition("=")[0] == DETECTOR


def is_short(word: str) -> bool:
    """Whether a word picks a row by a short name: one without a dot that is no group or key of the config's own."""
    key = word.partition("=")[0]
    return (
        "." not in key
        and not key.startswith(("+", "~"))
        and key not in ("classes", "data", "profile", "protocol", "results")
    )


def is_one_value(word: str) -> bool:
    """Whether a word names a single value; several, such as seed=0,1,2, pick trials of the sweep."""
    return all(len(values) == 1 for values in values_by_key([word]).values())


def explain(sweep: FinishedSweep, table: str, row: dict[str, str], metric: str) -> None:
    """Print the chain of each trial behind a cell.

    Raises:
        ConfigError: a table, row or metric that does not exist.
    """
    paper_table = _table(sweep, table)
    rule = paper_table.rule if paper_table else table
    chosen = sweep.select(rule)
    if paper_table is not None:
        chosen = chosen[chosen["trial"].isin(paper_table.rows(sweep))]
    chosen = _rows(sweep, chosen, row)
    column = f"ap_{metric}"
    if column not in chosen:
        possible = [str(name).removeprefix("ap_") for name in chosen if str(name).startswith("ap_")]
        raise ConfigError(f"no metric '{metric}'. {options(metric, possible)}")
    first = chosen.iloc[0]
    cell = f"{first['group']}, {level_text(sweep.factor, str(first['level']))}"
    seeds = f", mean of {len(chosen)} seeds" if len(chosen) > 1 else ""
    print(f"{table}, {cell}, {metric}: {chosen[column].mean():.2f}{seeds}")
    runs = sweep.runs()
    for _, found in chosen.iterrows():
        for line in trace(sweep, found, column, runs.get(str(found["trial"]), "?")):
            print(line)


def _table(sweep: FinishedSweep, name: str) -> PaperTable | None:
    if name in RULES:
        return None
    tables = {table.number: table for table in paper_tables(sweep)}
    if name not in tables:
        possible = [*tables, *RULES]
        raise ConfigError(f"{sweep.name} feeds no table '{name}'. {options(name, possible)}")
    return tables[name]


def _rows(sweep: FinishedSweep, chosen: pd.DataFrame, row: dict[str, str]) -> pd.DataFrame:
    """The scores of one cell: one group and level, its seeds."""
    for name, value in row.items():
        texts = chosen["trial"].map(
            {trial.key: _texts(sweep, trial.key, name) for trial in sweep.trials}
        )
        possible = sorted({text for several in texts for text in several})
        if value not in possible:
            raise ConfigError(f"{name}={value}: no such row. {options(value, possible)}")
        chosen = chosen[texts.map(lambda several, value=value: value in several)]
    cells = chosen.drop_duplicates(["group", "level"])
    if len(cells) > 1:
        own = set(cells["trial"])
        rows = "; ".join(  # in the sweep's order
            f"{trial.group}, {level_text(sweep.factor, trial.level)}"
            for trial in sweep.trials
            if trial.key in own
        )
        raise ConfigError(f"several rows fit; name one: {rows}")
    return chosen


def _texts(sweep: FinishedSweep, key: str, name: str) -> Sequence[str]:
    """How a trial's value may be written.

    Raises:
        ConfigError: the sweep has no such key.
    """
    trial = sweep.trial(key)
    if name == SEED:
        return [str(trial.seed)]
    if name in trial.plan.values and name != DETECTOR:
        return [label_of(trial.plan.values[name])]
    names = {short: long for long, short in short_names(trial.plan.values).items()}
    if name == DETECTOR:
        return [trial.detector, label_of(trial.plan.values.get(DETECTOR, trial.detector))]
    if name not in names:
        raise ConfigError(
            f"{name}: not what this sweep's trials differ in. {options(name, dict.fromkeys([*names, SEED]))}"
        )
    return [label_of(trial.plan.values[names[name]])]
