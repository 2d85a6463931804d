"""Where a number comes from, and whether it comes out again."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pandas as pd
from tqdm import tqdm

from fl3d.data.kitti import KittiFolder
from fl3d.digests import file_digest
from fl3d.errors import ConfigError, DataError, StoreError, options
from fl3d.evaluation.detections import Detections, Validation, read_detections, read_validation, score
from fl3d.evaluation.protocol import Protocol
from fl3d.records import Config, StagePaths
from fl3d.reports.selection import select
from fl3d.reports.tables import LAST_TABLES
from fl3d.reports.write import NAMED, tidy
from fl3d.results import Names, names, results_folder
from fl3d.store.tracking import Store
from fl3d.training.checkpoints import read_marker
from fl3d.training.run import detect_again

RULES = {"II": "last", "III": "last", "IV": "best", "V": "last"}


def why(config: Config, table: str, row: Mapping[str, str], metric: str, say: Callable[[str], None] = print) -> None:
    """Print the chain from a table's cell to run, checkpoint, files and digests; each digest is checked.

    Args:
        config: names the sweep, its data and profile, and the protocol.
        table: of the paper: II, III, IV or V.
        row: what picks the row: ``gamma`` (of V ``normalize``), and where there are several ``detector`` and ``seed``.
        metric: such as ``3d/moderate``.
        say: prints a line for the user.

    Raises:
        ConfigError: a table, row or metric that does not exist.
        StoreError: the store holds no such sweep.
    """
    if table not in RULES:
        raise ConfigError(f"no table '{table}' is made of a sweep. {options(table, RULES)}")
    scores, runs = _scores(config)
    chosen = select(scores, RULES[table], config["selection"]["stages"])
    if table in LAST_TABLES:
        chosen = chosen[chosen["detector"] == LAST_TABLES[table]]
    chosen = _rows(chosen, row)
    column = f"ap_{metric}"
    if column not in chosen:
        possible = [str(name).removeprefix("ap_") for name in chosen if str(name).startswith("ap_")]
        raise ConfigError(f"no metric '{metric}'. {options(metric, possible)}")
    mean = chosen[column].mean()
    seeds = f", mean of {len(chosen)} seeds" if len(chosen) > 1 else ""
    told = " ".join(f"{key}={value}" for key, value in row.items())
    say(f"Table {table}, {told}, {metric}: {mean:.2f}{seeds}")
    say(f"  table       {results_folder(config) / 'tables' / f'table_{table}.csv'}")
    for _, found in chosen.iterrows():
        for line in _chain(config, found, column, runs.get(str(found["trial"]), "?")):
            say(line)


def _scores(config: Config) -> tuple[pd.DataFrame, dict[str, str]]:
    """Tidy scores of a sweep under the config's protocol, and the run of each trial."""
    called, root = names(config), Path(config["store"]["root"])
    store = Store(root, config["store"]["uri"])
    raw = store.read(called.experiment, list(NAMED)) if store.exists else pd.DataFrame()
    protocol = Protocol(**config["protocol"]).id
    scores = tidy(raw, _finished(called, root), protocol)
    if scores.empty:
        raise StoreError(f"{root}: the store holds no scores of {called.experiment} under protocol {protocol}")
    own = raw[raw["tags.fl3d.protocol"] == protocol]
    return scores, dict(zip(own["tags.fl3d.trial"], own["run_uuid"], strict=True))


def _finished(called: Names, root: Path) -> set[str]:
    plan = called.plan(root)
    if not plan.exists():
        raise StoreError(f"{plan}: no such file; run the sweep first")
    keys = [str(trial["key"]) for trial in json.loads(plan.read_text())["trials"]]
    return {key for key in keys if StagePaths(root / "stages" / key).done.exists()}


def _rows(chosen: pd.DataFrame, row: Mapping[str, str]) -> pd.DataFrame:
    for key, value in row.items():
        texts = chosen[key].map(lambda one: f"{one:g}" if isinstance(one, int | float) else str(one))
        if value not in set(texts):
            raise ConfigError(f"{key}={value}: no such row. {options(value, set(texts))}")
        chosen = chosen[texts == value]
    points = chosen.drop_duplicates(["detector", "gamma", "normalize"])
    if len(points) > 1:
        forms = chosen["normalize"].nunique() > 1
        heads = [f"detector={r.detector} gamma={r.gamma:g}" for r in points.itertuples()]
        ends = [f" normalize={value}" * forms for value in points["normalize"]]
        rows = "; ".join(head + end for head, end in zip(heads, ends, strict=True))
        raise ConfigError(f"several rows fit; name one: {rows}")
    return chosen


def _chain(config: Config, row: pd.Series, column: str, run: str) -> Iterator[str]:
    stages_root = Path(config["store"]["root"]) / "stages"
    last = json.loads(StagePaths(stages_root / row["trial"]).spec.read_text())
    chain = [last]
    while chain[0]["stage"]["parent"]:
        chain.insert(0, json.loads(StagePaths(stages_root / chain[0]["stage"]["parent"]).spec.read_text()))
    step = int(row["step"])
    holder = next(spec["stage"] for spec in chain if step <= _end_step(spec["stage"]))
    paths = StagePaths(stages_root / holder["key"])
    marker = read_marker(paths, step)
    yield f"  trial       {row['trial']} (seed {row['seed']}), {row[column]!r} at step {step}"
    yield f"  run         {run} in MLflow's experiment {names(config).experiment}"
    for spec in chain:
        stage = spec["stage"]
        own = StagePaths(stages_root / stage["key"])
        made = read_marker(own, own.steps()[-1]).made_by
        commit = made.get("mlflow.source.git.commit", "unknown")[:12]
        dirty = f" + uncommitted changes {made['fl3d.diff']}" if "fl3d.diff" in made else ""
        yield f"  stage       {stage['key']}: {stage['epochs']} epochs from step {stage['start_step']}"
        yield f"              commit {commit}{dirty}; {made.get('fl3d.packages', '')}"
        yield f"              on {made.get('fl3d.machine', 'unknown')}, device {spec['machine']['device']}"
    yield f"  checkpoint  {_checked(paths.weights(step), marker.sha256)}"
    yield f"  detections  {_checked(paths.detections(step), marker.detections_sha256)}"
    protocol = Protocol(**config["protocol"])
    yield f"  scores      {paths.scores(step, protocol.id)}"
    again = _score_again(paths, step, protocol, {})[column]
    yield f"  scored now  {again!r}: " + ("the same" if again == row[column] else "NOT THE SAME")
    yield f"  data        {last['machine']['data_root']}, {len(last['machine']['val_ids'])} validation frames"


def _end_step(stage: Mapping[str, int]) -> int:
    return stage["start_step"] + stage["epochs"] * stage["epoch_steps"]


def _checked(path: Path, sha256: str) -> str:
    if not path.exists():
        return f"{path}: not kept (sha256 {sha256[:16]})"
    if not sha256:
        return f"{path}: its digest was not recorded"
    return f"{path}: sha256 {sha256[:16]}, " + ("matches" if file_digest(path) == sha256 else "DOES NOT MATCH")


def _score_again(
    paths: StagePaths, step: int, protocol: Protocol, seen: dict[str, Validation], found: Detections | None = None
) -> dict[str, float]:
    """Scores of stored (or given) detections, computed now."""
    spec = json.loads(paths.spec.read_text())
    root, data = spec["machine"]["data_root"], spec["stage"]["config"]["data"]
    if root not in seen:
        folder = KittiFolder(Path(root), data["crop"], data["calibration"])
        seen[root] = read_validation(folder, tuple(spec["machine"]["val_ids"]))
    return score(found if found is not None else read_detections(paths.detections(step)), seen[root], protocol)


def verify(config: Config, from_weights: bool, say: Callable[[str], None] = print) -> None:
    """Score every stored checkpoint of a sweep again, and compare with what the store holds, digit by digit.

    Args:
        config: names the sweep, its data and profile, and the protocol.
        from_weights: also run the network of every checkpoint whose weights were kept.
        say: prints a line for the user.

    Raises:
        StoreError: something came out differently; the message names each checkpoint.
    """
    scores, _ = _scores(config)
    stages_root = Path(config["store"]["root"]) / "stages"
    protocol = Protocol(**config["protocol"])
    columns = [str(name) for name in scores if str(name).startswith("ap_")]
    logged = _by_checkpoint(scores, stages_root)
    seen: dict[str, Validation] = {}
    wrong: list[str] = []
    n_weights = 0
    for (key, step), row in tqdm(logged.items(), unit="checkpoint", disable=None):
        paths = StagePaths(stages_root / key)
        try:
            wrong += _differences(f"{key} step {step}", row, _score_again(paths, step, protocol, seen), columns)
            if from_weights and paths.weights(step).exists():
                n_weights += 1
                again = _score_again(paths, step, protocol, seen, detect_again(paths, step))
                wrong += _differences(f"{key} step {step}, from its weights", row, again, columns)
        except DataError as error:
            wrong.append(str(error))
    if wrong:
        raise StoreError(f"{len(wrong)} of {len(logged)} checkpoints do not come out again:\n" + "\n".join(wrong))
    say(
        f"{len(logged)} checkpoints of {names(config).experiment}, {len(columns)} APs each: every digit comes out again"
    )
    if from_weights:
        say(f"{n_weights} of them from their weights; the weights of the others were not kept")


def _by_checkpoint(scores: pd.DataFrame, stages_root: Path) -> dict[tuple[str, int], pd.Series]:
    """The store's row of each checkpoint; a shared stage's checkpoints stand under several trials."""
    found: dict[tuple[str, int], pd.Series] = {}
    for _, row in scores.iterrows():
        key: str | None = str(row["trial"])
        while key is not None:
            stage = json.loads(StagePaths(stages_root / key).spec.read_text())["stage"]
            if int(row["step"]) > stage["start_step"]:
                found.setdefault((key, int(row["step"])), row)
                break
            key = stage["parent"]
    return found


def _differences(where: str, row: pd.Series, again: Mapping[str, float], columns: list[str]) -> list[str]:
    wrong = [f"{name} {row[name]!r} is {again[name]!r}" for name in columns if row[name] != again[name]]
    return [f"  {where}: {', '.join(wrong[:3])}{' ...' if len(wrong) > 3 else ''}"] if wrong else []
