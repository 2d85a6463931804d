"""The store: every score once, read back as one frame."""

import json
from pathlib import Path

import pytest

from fl3d.errors import StoreError
from fl3d.store.tracking import Scored, Store

TAGS = {"detector": "VoxelNet"}
PARAMS = {f"key.{i}": i for i in range(150)}  # more than MLflow takes in one request
APS = {"ap_3d/moderate": 50.0, "ap_3d/easy": 60.0}


class Killed(BaseException):
    """Stands for kill -9."""


def killed(*_: object, **__: object) -> None:
    raise Killed


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    store = Store(tmp_path_factory.mktemp("store"))
    store.open()
    return store


def test_scores_come_back_as_they_went_in(store: Store) -> None:
    experiment = store.experiment("in-and-out", "a note")
    run = store.run(experiment, "trial-a", "paper-1", "a", TAGS, PARAMS)
    store.log(run, Scored(100, 1_000, APS))
    store.log(run, Scored(200, 2_000, {"ap_3d/moderate": 0.1 + 0.2, "ap_3d/easy": 1e-9}))
    frame = store.read("in-and-out", ["tags.detector", "params.key.149"])
    assert frame["step"].tolist() == [100, 200]
    assert frame["ap_3d/moderate"].tolist() == [50.0, 0.1 + 0.2]
    assert set(frame["tags.detector"]) == {"VoxelNet"}
    assert set(frame["params.key.149"]) == {"149"}


def test_a_score_that_is_logged_again_is_kept_once(store: Store) -> None:
    experiment = store.experiment("once", "")
    run = store.run(experiment, "trial-a", "paper-1", "a", TAGS, {})
    for _ in range(3):
        store.log(run, Scored(100, 1_000, APS))
    assert len(store.client.get_metric_history(run, "ap_3d/moderate")) == 1
    assert store.logged_steps(run) == {100}


def test_a_trial_has_one_run_for_each_protocol(store: Store) -> None:
    experiment = store.experiment("runs", "")
    runs = [store.run(experiment, "trial-a", p, "a", TAGS, {}) for p in ("paper-1", "paper-1", "paper-2")]
    assert runs[0] == runs[1] != runs[2]


def test_models_carry_their_scores_and_are_made_once(store: Store, tmp_path: Path) -> None:
    experiment = store.experiment("models", "")
    run = store.run(experiment, "trial-a", "paper-1", "a", TAGS, {})
    store.link_dataset(run, "simulated", "abc", tmp_path)
    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")
    scored, data = Scored(100, 1_000, APS), ("simulated", "abc")
    model = store.log_model(experiment, run, "best", [weights], {"step": "100"}, scored, data)
    assert store.log_model(experiment, run, "best", [weights], {"step": "100"}, scored, data) == model
    newer = store.log_model(experiment, run, "best", [weights], {"step": "200"}, scored, data)
    models = store.client.search_logged_models([experiment])
    assert [m.model_id for m in models] == [newer]
    assert {metric.key: metric.value for metric in models[0].metrics} == APS


def test_a_models_scores_do_not_double_the_runs(store: Store) -> None:
    frame = store.read("models", [])
    assert frame["step"].tolist() == [100]


def test_what_a_kill_left_half_done_is_made_whole(
    store: Store, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A run without its parameters, and a model without its files."""
    experiment = store.experiment("half", "")
    log_batch = store.client.log_batch
    monkeypatch.setattr(store.client, "log_batch", killed)
    with pytest.raises(Killed):
        store.run(experiment, "trial-a", "paper-1", "a", TAGS, PARAMS)
    monkeypatch.setattr(store.client, "log_batch", log_batch)
    run = store.run(experiment, "trial-a", "paper-1", "a", TAGS, PARAMS)
    assert len(store.client.search_runs([experiment])) == 1
    assert len(store.client.get_run(run).data.params) == len(PARAMS)

    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")
    arguments = (experiment, run, "best", [weights], {"step": "100"}, Scored(100, 1_000, APS), ("simulated", "abc"))
    log_model_artifact = store.client.log_model_artifact
    monkeypatch.setattr(store.client, "log_model_artifact", killed)
    with pytest.raises(Killed):
        store.log_model(*arguments)
    monkeypatch.setattr(store.client, "log_model_artifact", log_model_artifact)
    store.log_model(*arguments)
    models = store.client.search_logged_models([experiment])
    assert [str(m.status) for m in models] == ["READY"]


def test_an_interrupted_run_is_opened_again(store: Store) -> None:
    experiment = store.experiment("again", "")
    run = store.run(experiment, "trial-a", "paper-1", "a", TAGS, {})
    store.end(run, "KILLED")
    assert store.run(experiment, "trial-a", "paper-1", "a", TAGS, {}) == run
    assert store.client.get_run(run).info.status == "RUNNING"


def test_an_unknown_sweep_is_an_empty_frame(store: Store) -> None:
    assert store.read("never", []).empty


def test_a_closed_run_is_known(store: Store) -> None:
    run = store.run(store.experiment("closed", ""), "trial-a", "paper-1", "a", TAGS, {})
    assert not store.is_finished(run)
    store.end(run, "FINISHED")
    assert store.is_finished(run)


def test_a_uri_that_is_no_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="Possible: sqlite"):
        Store(tmp_path, "ftp://somewhere")


def test_the_default_store_is_a_file_in_wal_mode(store: Store) -> None:
    import sqlite3

    path = store.root / "mlflow.db"
    connection = sqlite3.connect(path)
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    connection.close()


def test_a_view_of_what_matters_can_be_opened_by_link(store: Store) -> None:
    number = store.experiment("viewed", "")
    address = store.views()["viewed"]
    assert f"/{number}/runs?viewStateShareKey=" in address
    assert "workflowType=machine_learning" in address
    key = address.partition("viewStateShareKey=")[2].partition("&")[0]
    view = json.loads(store.client.get_experiment(number).tags[f"mlflow.sharedViewState.{key}"])
    state = json.loads(view["state"])
    sections = {section["uuid"] for section in state["compareRunSections"]}
    assert state["compareRunCharts"][0]["metricKey"] == "ap_3d/moderate"
    assert {chart["metricSectionId"] for chart in state["compareRunCharts"]} == sections
    assert "Default" not in store.views()
