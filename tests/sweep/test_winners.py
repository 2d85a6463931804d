"""Sweeps that go on from what won before."""

import json
from collections.abc import Sequence
from pathlib import Path

import pandas as pd
import pytest

from fl3d.config import compose_config, multirun
from fl3d.errors import ConfigError, StoreError
from fl3d.evaluation.protocol import Protocol
from fl3d.reports.write import FRONT, scores_path
from fl3d.results import names, results_folder
from fl3d.sweep.sweepers.grid import expand
from fl3d.sweep.winners import best_overrides, with_winners

PLACES = ("store.root={0}/runs", "results={0}/results")


def ran(root: Path, sweep: str, values: dict[str, dict[str, float]], missing: Sequence[str] = ()) -> None:
    """As if a sweep had been run: its plan and its scores, by override."""
    config = compose_config([*(place.format(root) for place in PLACES), f"+sweep={sweep}"])
    plan = names(config).plan(Path(config["store"]["root"]))
    plan.parent.mkdir(parents=True, exist_ok=True)
    every = [*values, *missing]
    plan.write_text(json.dumps({"trials": [{"key": k, "overrides": k.split(), "stages": [k]} for k in every]}))
    rows = []
    for key, metrics in values.items():
        front = dict.fromkeys(FRONT, 0) | {"trial": key, "detector": "PointRCNN", "step": 10}
        rows.append(front | {"protocol": Protocol(**config["protocol"]).id, "overrides": key} | metrics)
    path = scores_path(results_folder(config), names(config).sweep)
    path.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(rows).to_csv(path, index=False)


def arguments(root: Path, sweep: str, *more: str, said: list[str] | None = None) -> list[str]:
    asked = multirun([*(place.format(root) for place in PLACES), f"+sweep={sweep}", *more])
    return with_winners(asked, (said if said is not None else []).append).arguments


BATCH = "schedule.stages.rpn.set.schedule.batch_size"


def test_a_sweep_keeps_the_winners_of_all_sweeps_before(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}={b}": {"recall_3d/0.7": r} for b, r in ((16, 0.3), (32, 0.5))})
    ran(tmp_path, "pointrcnn_alpha", {f"loss.alpha={a}": {"recall_3d/0.7": r} for a, r in ((0.75, 0.6), (0.8, 0.2))})
    assert arguments(tmp_path, "pointrcnn_alpha")[:1] == [f"{BATCH}=32"]
    found = arguments(tmp_path, "pointrcnn_bins", "seed=3")
    assert found[:2] == [f"{BATCH}=32", "loss.alpha=0.75"]
    assert found[-1] == "seed=3"
    assert arguments(tmp_path, "pointrcnn_batch")[0].startswith("store.root")  # the first of the chain


def test_before_its_time_it_says_what_to_run(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match=r"goes on from the winner of pointrcnn_batch-simulated-quick; run that first"):
        arguments(tmp_path, "pointrcnn_alpha")


def test_a_metric_that_was_not_measured_is_named(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16": {"recall_3d/0.5": 0.3}})
    with pytest.raises(ConfigError, match=r"sweep.winner: .*recall_3d/0.7.*recall_3d/0.5"):
        arguments(tmp_path, "pointrcnn_alpha")


def test_going_round_in_circles_is_refused(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_alpha", {"loss.alpha=0.75": {"recall_3d/0.7": 0.1}})
    with pytest.raises(ConfigError, match="there is no first one"):
        arguments(tmp_path, "pointrcnn_alpha", "sweep.after=pointrcnn_alpha")


def test_a_sweep_without_a_rule_has_no_winner(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sweep gamma: sweep.winner is not set"):
        arguments(tmp_path, "pointrcnn_alpha", "sweep.after=gamma")


def test_seeds_are_averaged_and_may_be_swept() -> None:
    rows = [("a=1 seed=0", 0.9), ("a=1 seed=1", 0.1), ("a=2", 0.6), ("a=4", 0.5)]
    scores = pd.DataFrame(
        [(overrides, overrides, 10, value, 0) for overrides, value in rows],
        columns=["trial", "overrides", "step", "recall_3d/0.7", "first_own_step"],
    )
    assert best_overrides(scores, "recall_3d/0.7") == (["a=2"], 0.6)


def test_swept_seeds_and_what_is_kept_are_told(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16": {"recall_3d/0.7": 0.3}})
    said: list[str] = []
    found = arguments(tmp_path, "pointrcnn_alpha", "seed=0,1", said=said)
    assert found[0] == f"{BATCH}=16"
    assert found[-1] == "seed=0,1"
    source, kept = said
    assert source.startswith("From ")  # a file of scores, not the store
    assert "scores/pointrcnn_batch.csv" in source
    assert kept == f"Keeps {BATCH}=16, which won pointrcnn_batch (recall_3d/0.7 0.3)."


def test_an_unfinished_sweep_has_no_winner_yet(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16": {"recall_3d/0.7": 0.3}}, [f"{BATCH}=32"])
    with pytest.raises(StoreError, match=r"1 of 2 trials of pointrcnn_batch-simulated-quick are done"):
        arguments(tmp_path, "pointrcnn_alpha")


def test_scores_without_a_plan_will_do(tmp_path: Path) -> None:
    """As in a fresh clone, with committed results."""
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16": {"recall_3d/0.7": 0.3}})
    next((tmp_path / "runs" / "plans").glob("*.json")).unlink()
    assert arguments(tmp_path, "pointrcnn_alpha")[0] == f"{BATCH}=16"


def test_one_value_of_what_a_file_sweeps_is_still_told() -> None:
    fixed, points = expand({"loss.alpha": "0.75,0.8"}, ["loss.alpha=0.8", "seed=3"])
    assert fixed == ["seed=3"]
    assert points == [["loss.alpha=0.8"]]
