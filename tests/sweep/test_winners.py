"""Sweeps that build on what won before."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from fl3d.config.compose import compose_config, multirun
from fl3d.config.settings import Settings, read_settings
from fl3d.core.errors import ConfigError, StoreError
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import open_sweep
from fl3d.runs.plans import FrozenPlan, FrozenTrial, write_plan
from fl3d.runs.scores import FRONT, score_file, write_score_file
from fl3d.sweep.sweepers.grid import point_of
from fl3d.sweep.winners import best, with_winners

BATCH = "schedule.stages.rpn.set.schedule.batch_size"
RECALL = "recall_3d/0.7"
Scores = Mapping[str, Mapping[str, float]]  # metrics of a trial, by its overrides


@pytest.fixture(autouse=True)
def published(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What the project publishes: nothing, so far."""
    folder = tmp_path / "published"
    monkeypatch.setattr("fl3d.sweep.winners.PUBLISHED", folder)
    return folder


def places(root: Path) -> list[str]:
    return [f"store.root={root}/runs", f"results={root}/results"]


def settings_of(root: Path, sweep: str) -> Settings:
    return read_settings(compose_config([*places(root), f"+sweep={sweep}"]))


def frozen(overrides: Sequence[str]) -> FrozenTrial:
    point = point_of(overrides, {})
    key = " ".join(overrides)
    return FrozenTrial(
        key=key,
        overrides=point.overrides,
        values=point.values,
        config={},
        stages=(key,),
        first_own_step=0,
        detector="PointRCNN",
        group="PointRCNN",
        level=key,
        seed=point.values.get("seed", 0),
    )


def write_scores(
    settings: Settings, scores: Scores, missing: Sequence[str] = (), folder: Path | None = None
) -> None:
    """As if a sweep had been run and its scores were kept: overrides are split at blanks."""
    trials = tuple(frozen(key.split()) for key in [*scores, *missing])
    plan = FrozenPlan(factor=("any",), baseline=trials[0].level, trials=trials)
    rows = []
    for key, metrics in scores.items():
        for step in (5, 10):
            front = dict.fromkeys(FRONT, 0) | {"trial": key, "step": step}
            half = 1.0 if step == 10 else 0.5
            measured = {name: value * half for name, value in metrics.items()}
            rows.append(front | {"protocol": settings.protocol.id} | measured)
    place = folder or settings.results
    file = score_file(place / settings.folder_name, settings.sweep.name)
    write_score_file(file, pd.DataFrame(rows), plan)


def ran(root: Path, sweep: str, scores: Scores, missing: Sequence[str] = ()) -> None:
    write_scores(settings_of(root, sweep), scores, missing)


def batches(*recalls: float) -> Scores:
    return {
        f"{BATCH}={size}": {RECALL: recall}
        for size, recall in zip((16, 32, 64), recalls, strict=False)
    }


def arguments(root: Path, sweep: str, *more: str, said: list[str] | None = None) -> list[str]:
    asked = multirun([*places(root), f"+sweep={sweep}", *more])
    say = (said if said is not None else []).append
    return with_winners(asked, say).arguments


def open_scores(root: Path, scores: Scores) -> FinishedSweep:
    settings = settings_of(root, "pointrcnn_batch")
    write_scores(settings, scores)
    return open_sweep(settings)


def test_a_sweep_keeps_the_winners_of_all_sweeps_before(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", batches(0.3, 0.5))
    alphas = {"loss.alpha=0.75": {RECALL: 0.6}, "loss.alpha=0.8": {RECALL: 0.2}}
    ran(tmp_path, "pointrcnn_alpha", alphas)
    assert arguments(tmp_path, "pointrcnn_alpha")[:1] == [f"{BATCH}=32"]
    kept = arguments(tmp_path, "pointrcnn_bins", "seed=3")
    assert kept[:2] == [f"{BATCH}=32", "loss.alpha=0.75"]
    assert kept[-1] == "seed=3"
    first = arguments(tmp_path, "pointrcnn_batch")  # of the chain
    assert first[0].startswith("store.root")


def test_what_is_swept_now_is_not_kept(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16 loss.alpha=0.75": {RECALL: 0.3}})
    kept = arguments(tmp_path, "pointrcnn_alpha")
    assert f"{BATCH}=16" in kept
    assert "loss.alpha=0.75" not in kept


def test_before_its_time_it_says_what_to_run(tmp_path: Path) -> None:
    message = r"builds on the winner of pointrcnn_batch-simulated-quick; run that first"
    with pytest.raises(StoreError, match=message):
        arguments(tmp_path, "pointrcnn_alpha")


def test_a_metric_that_was_not_measured_is_named(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", {f"{BATCH}=16": {"recall_3d/0.5": 0.3}})
    with pytest.raises(ConfigError, match=r"sweep.winner: .*recall_3d/0.7.*recall_3d/0.5"):
        arguments(tmp_path, "pointrcnn_alpha")


def test_a_metric_of_some_trials_alone_decides_nothing(tmp_path: Path) -> None:
    scores = {
        f"{BATCH}=16": {RECALL: 0.3, "recall_3d/0.5": 0.1},
        f"{BATCH}=32": {"recall_3d/0.5": 0.2},
    }
    ran(tmp_path, "pointrcnn_batch", scores)
    with pytest.raises(ConfigError, match=r"no metric recall_3d/0.7\. .*Possible: recall_3d/0.5\."):
        arguments(tmp_path, "pointrcnn_alpha")


def test_going_round_in_circles_is_refused(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_alpha", {"loss.alpha=0.75": {RECALL: 0.1}})
    message = r"pointrcnn_alpha builds on pointrcnn_alpha: there is no first one"
    with pytest.raises(ConfigError, match=message):
        arguments(tmp_path, "pointrcnn_alpha", "sweep.after=pointrcnn_alpha")


def test_a_sweep_without_a_rule_has_no_winner(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"sweep gamma: sweep.winner is not set"):
        arguments(tmp_path, "pointrcnn_alpha", "sweep.after=gamma")


def test_seeds_are_averaged_and_may_be_swept(tmp_path: Path) -> None:
    scores = {
        "loss.alpha=1 seed=0": {RECALL: 0.9},
        "loss.alpha=1 seed=1": {RECALL: 0.1},
        "loss.alpha=2": {RECALL: 0.6},
        "loss.alpha=4": {RECALL: 0.5},
    }
    won = best(open_scores(tmp_path, scores), RECALL)
    assert won.overrides == {"loss.alpha": "loss.alpha=2"}
    assert won.value == 0.6


def test_trials_are_told_by_their_values_and_not_by_how_they_were_written(tmp_path: Path) -> None:
    """1 and 1.0 are one value, of two seeds."""
    scores = {
        "seed=0 loss.alpha=1": {RECALL: 0.2},
        "loss.alpha=1.0 seed=1": {RECALL: 0.8},
        "loss.alpha=2 seed=0": {RECALL: 0.4},
    }
    won = best(open_scores(tmp_path, scores), RECALL)
    assert won.overrides == {"loss.alpha": "loss.alpha=1"}
    assert won.value == 0.5


def test_values_that_no_words_can_be_split_from_are_kept_as_the_user_wrote_them(
    tmp_path: Path,
) -> None:
    """A text with blanks and equality signs in it, and a mapping."""
    settings = settings_of(tmp_path, "pointrcnn_batch")
    write_scores(settings, {"loss.alpha=1": {RECALL: 0.4}})
    overrides = ("data.name='seed=3 of a'", "detector.rpn={search: 3.0, bin: 0.5}", "seed=1")
    sweep = open_sweep(settings)
    (trial,) = sweep.trials
    plan = replace(frozen(overrides), key=trial.key)
    won = best(replace(sweep, trials=(replace(trial, plan=plan),)), RECALL)
    assert list(won.overrides.values()) == list(overrides[:2])
    assert plan.values["data.name"] == "seed=3 of a"


def test_the_first_of_equals_wins(tmp_path: Path) -> None:
    won = best(open_scores(tmp_path, batches(0.3, 0.5, 0.5)), RECALL)
    assert won.overrides == {BATCH: f"{BATCH}=32"}


def test_swept_seeds_and_what_is_kept_are_told(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", batches(0.3))
    said: list[str] = []
    found = arguments(tmp_path, "pointrcnn_alpha", "seed=0,1", said=said)
    assert found[0] == f"{BATCH}=16"
    assert found[-1] == "seed=0,1"
    source, kept = said
    file = tmp_path / "results" / "simulated-quick" / "scores" / "pointrcnn_batch.csv"
    assert source == f"From {file} (the store holds no such sweep)."
    assert kept == f"Keeps {BATCH}=16, which won pointrcnn_batch (recall_3d/0.7 0.3)."


def test_an_unfinished_sweep_has_no_winner_yet(tmp_path: Path) -> None:
    ran(tmp_path, "pointrcnn_batch", batches(0.3), missing=[f"{BATCH}=32"])
    message = r"1 of 2 trials of pointrcnn_batch-simulated-quick are done"
    with pytest.raises(StoreError, match=message):
        arguments(tmp_path, "pointrcnn_alpha")


def test_published_scores_will_do(tmp_path: Path, published: Path) -> None:
    """As in a fresh clone."""
    write_scores(settings_of(tmp_path, "pointrcnn_batch"), batches(0.3), folder=published)
    said: list[str] = []
    assert arguments(tmp_path, "pointrcnn_alpha", said=said)[0] == f"{BATCH}=16"
    assert str(published) in said[0]


def test_ones_own_scores_come_before_published_ones(tmp_path: Path, published: Path) -> None:
    settings = settings_of(tmp_path, "pointrcnn_batch")
    write_scores(settings, batches(0.5, 0.3), folder=published)
    write_scores(settings, batches(0.3, 0.5))
    assert arguments(tmp_path, "pointrcnn_alpha")[0] == f"{BATCH}=32"


def test_a_plan_without_scores_in_the_store_does_not_hide_a_file_of_scores(tmp_path: Path) -> None:
    """As while the sweep is being run anew in an empty store."""
    settings = settings_of(tmp_path, "pointrcnn_batch")
    write_scores(settings, batches(0.3, 0.5))
    trials = (frozen([f"{BATCH}=16"]),)
    plan = FrozenPlan(factor=("any",), baseline=trials[0].level, trials=trials)
    write_plan(StoreFolder(settings.store.root).plan(settings.experiment), plan)
    assert arguments(tmp_path, "pointrcnn_alpha")[0] == f"{BATCH}=32"
