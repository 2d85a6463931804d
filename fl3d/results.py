"""The results of a sweep: what they are called, where they lie, and how they are made again from the store."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from fl3d.errors import StoreError
from fl3d.evaluation.protocol import Protocol
from fl3d.records import Config, StagePaths
from fl3d.reports.render import to_markdown
from fl3d.reports.selection import select
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.reports.write import NAMED, read_scores, scores_path, tidy, write_results
from fl3d.store.tracking import Store


@dataclass(frozen=True)
class Names:
    """What a sweep is called.

    Args:
        sweep: such as ``gamma``.
        results: ``<data>-<profile>``.
    """

    sweep: str
    results: str

    @property
    def experiment(self) -> str:
        """Of MLflow."""
        return f"{self.sweep}-{self.results}"

    def plan(self, root: Path) -> Path:
        """The frozen plan below a store's root: trials with their stages."""
        return root / "plans" / f"{self.experiment}.json"


def names(config: Config) -> Names:
    """The names that a config gives."""
    return Names(config["sweep"]["name"], f"{config['data']['name']}-{config['profile']['name']}")


def stored_scores(store: Store, experiment: str, trials: set[str], protocol: str) -> pd.DataFrame:
    """Tidy scores of an experiment, of some trials under one protocol."""
    raw = store.read(experiment, list(NAMED)) if store.exists else pd.DataFrame()
    return tidy(raw, trials, protocol)


def report_from_store(config: Config, say: Callable[[str], None] = print) -> tuple[list[Table], pd.DataFrame]:
    """Make the tables of a sweep again: from the store where it holds the sweep, else from its file of scores.

    Returns:
        the tables, and the scores that they are made from.

    Raises:
        StoreError: neither has scores.
    """
    scores = scores_of(config, say)
    return write_report(config, scores, say)[0], scores


def scores_of(config: Config, say: Callable[[str], None] = lambda line: None) -> pd.DataFrame:
    """Tidy scores of a sweep's finished trials under the config's protocol, from the store or its file of scores.

    Raises:
        StoreError: neither has any.
    """
    called = names(config)
    root = Path(config["store"]["root"])
    frozen = called.plan(root)
    scores = pd.DataFrame()
    if frozen.exists():
        plan = json.loads(frozen.read_text())
        store = Store(root, config["store"]["uri"])
        protocol = Protocol(**config["protocol"]).id
        done = {t["key"] for t in plan["trials"] if StagePaths(root / "stages" / t["key"]).done.exists()}
        scores = stored_scores(store, called.experiment, done, protocol)
    if scores.empty:
        path = scores_path(results_folder(config), called.sweep)
        scores = read_scores(path)
        scores = of_protocol(scores, Protocol(**config["protocol"]).id, path)
        say(f"From {path} (the store holds no such sweep).\n")
    return scores


def of_protocol(scores: pd.DataFrame, protocol: str, source: Path) -> pd.DataFrame:
    """Scores of one protocol.

    Raises:
        StoreError: there are none; the message names those there are.
    """
    own = scores[scores["protocol"] == protocol]
    if own.empty:
        there = ", ".join(sorted(scores["protocol"].unique()))
        raise StoreError(f"{source}: no scores under protocol {protocol}, only {there}; run the sweep with it first")
    return own.reset_index(drop=True)


def results_folder(config: Config) -> Path:
    """``results/<data>-<profile>``."""
    return Path(config["results"]) / names(config).results


def write_report(config: Config, scores: pd.DataFrame, say: Callable[[str], None]) -> tuple[list[Table], list[Path]]:
    """Write a results folder and print its tables; returns them and every file written."""
    folder = results_folder(config)
    numbers, stages = tuple(config["sweep"]["tables"]), config["selection"]["stages"]
    tables, written = write_results(scores, folder, names(config).sweep, numbers, stages, _notes(config))
    for table in tables:
        say("\n" + to_markdown(table))
    say(f"Written to {folder}: " + ", ".join(str(path.relative_to(folder)) for path in written))
    return tables, written


def _notes(config: Config) -> tuple[str, ...]:
    protocol = config["protocol"]
    overlaps = " / ".join(f"{v:g}" for v in protocol["overlaps"]["Car"])
    area = protocol["ignore_beyond"]
    limit = f"; cars beyond x {area[0]:g} to {area[2]:g} m, y {area[1]:g} to {area[3]:g} m ignored" if area else ""
    return (
        f"Data {config['data']['name']}, profile {config['profile']['name']}; Car, R11, overlaps {overlaps} "
        f"(image / BEV / 3D); score cut {protocol['score_threshold']:g}, NMS {protocol['nms_iou']:g}{limit}.",
    )


def summary(scores: pd.DataFrame, labels: dict[str, str], stages: str) -> str:
    """Last and best model of each trial, in the order of the labels, as Markdown."""
    head, order = ["trial", "model", "step", *AP_COLUMNS], {trial: place for place, trial in enumerate(labels)}
    lines = ["| " + " | ".join(head) + " |", "|" + "---|" * 2 + "---:|" * 7]
    for rule in ("last", "best"):
        chosen = select(scores, rule, stages).sort_values("trial", key=lambda trials: trials.map(order), kind="stable")
        for _, row in chosen.iterrows():
            aps = [f"{row[metric]:.2f}" for metric in AP_COLUMNS.values()]
            lines.append("| " + " | ".join([labels[row["trial"]] or row["trial"], rule, str(row["step"]), *aps]) + " |")
    return "\n" + "\n".join(lines)
