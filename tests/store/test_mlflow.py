"""What a store in MLflow keeps to beside the contract: files, limits and half-made runs."""

import errno
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from pathlib import Path
from typing import NoReturn
from urllib.parse import quote

import mlflow
import pandas as pd
import pytest
import sqlalchemy as sa

from fl3d.core.errors import StoreDown, StoreError, Unwritable
from fl3d.store.base import RunStatus, Scored
from fl3d.store.mlflow.condition import damage
from fl3d.store.mlflow.connection import GuardedClient, database_url, outages, reading_url
from fl3d.store.mlflow.tracking import MlflowStore
from fl3d.store.mlflow.view import tag_value
from fl3d.store.opening import open_store
from tests.support import keeps_locks

TAGS = {"detector": "VoxelNet"}
PARAMS = {f"key.{i}": i for i in range(150)}  # more than MLflow takes in one request
APS = {"ap_3d/moderate": 50.0, "ap_3d/easy": 60.0}


class Killed(BaseException):
    """Stands for kill -9."""


def killed(*_: object, **__: object) -> None:
    raise Killed


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> MlflowStore:
    store = MlflowStore(tmp_path_factory.mktemp("store"))
    assert not store.exists
    assert store.read("before it is made").empty
    store.open()
    return store


def run_of(store: MlflowStore, name: str) -> tuple[str, str]:
    """Ids of an experiment and of a run in it."""
    experiment = store.experiment(name, "")
    return experiment, store.run(experiment, "trial-a", "paper-1", "a", TAGS, PARAMS)


def test_parameters_go_in_batches(store: MlflowStore) -> None:
    _, run = run_of(store, "params")
    params = store.client.get_run(run).data.params
    assert params == {key: str(value) for key, value in PARAMS.items()}


def test_a_score_that_is_logged_again_is_one_row(store: MlflowStore) -> None:
    _, run = run_of(store, "rows")
    for _ in range(3):
        store.log(run, Scored(100, 1_000, APS))
    assert len(store.client.get_metric_history(run, "ap_3d/moderate")) == 1


def test_only_scores_are_read_back(store: MlflowStore) -> None:
    _, run = run_of(store, "read")
    others = {"train/lr": 0.1, "loss/total": 3.0, "mean_3d": 1.0}
    store.log(run, Scored(100, 1_000, {**APS, "recall_3d/0.7": 0.5, "epoch": 1, **others}))
    expected = {"run", "trial", "protocol", "step", "epoch", *APS, "recall_3d/0.7"}
    assert set(store.read("read")) == expected


def test_each_root_reads_its_own_runs(store: MlflowStore, tmp_path: Path) -> None:
    """Two that share a database."""
    other = MlflowStore(tmp_path, store.uri)
    other.open()
    runs = []
    for number, one in enumerate((store, other)):
        _, run = run_of(one, "shared")
        one.log(run, Scored(100, 1_000, {"ap_3d/moderate": float(number)}))
        runs.append(run)
    assert runs[0] != runs[1]
    assert store.read("shared")["ap_3d/moderate"].tolist() == [0.0]
    assert other.read("shared")["ap_3d/moderate"].tolist() == [1.0]


def test_models_carry_their_scores(store: MlflowStore, tmp_path: Path) -> None:
    experiment, run = run_of(store, "models")
    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")
    data = ("simulated", "abc")
    store.link_dataset(run, *data, tmp_path)
    scored = Scored(100, 1_000, APS)
    made = store.log_model(experiment, run, "best", [weights], {"step": "100"}, scored, data)
    models = store.client.search_logged_models([experiment])
    assert [model.model_id for model in models] == [made]
    assert {metric.key: metric.value for metric in models[0].metrics} == APS


def test_a_run_that_a_kill_left_half_done_is_made_whole(
    store: MlflowStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One without its parameters."""
    with monkeypatch.context() as patch:
        patch.setattr(store.client, "log_batch", killed, raising=False)
        with pytest.raises(Killed):
            run_of(store, "half")
    experiment, run = run_of(store, "half")
    assert len(store.client.search_runs([experiment])) == 1
    assert len(store.client.get_run(run).data.params) == len(PARAMS)


def test_a_model_that_a_kill_left_half_done_is_replaced(
    store: MlflowStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One without its files."""
    experiment, run = run_of(store, "half a model")
    weights = tmp_path / "best.pt"
    weights.write_bytes(b"weights")
    scored = Scored(100, 1_000, APS)
    tags = {"step": "100"}
    arguments = (experiment, run, "best", [weights], tags, scored, ("simulated", "abc"))
    with monkeypatch.context() as patch:
        patch.setattr(store.client, "log_model_artifact", killed, raising=False)
        with pytest.raises(Killed):
            store.log_model(*arguments)
    store.log_model(*arguments)
    models = store.client.search_logged_models([experiment])
    assert [str(model.status) for model in models] == ["READY"]


def test_runs_have_mlflows_own_states(store: MlflowStore) -> None:
    states = {
        RunStatus.STOPPED: "KILLED",
        RunStatus.FAILED: "FAILED",
        RunStatus.DONE: "FINISHED",
    }
    _, run = run_of(store, "states")
    for status, state in states.items():
        store.end(run, status)
        assert store.client.get_run(run).info.status == state


def test_the_commit_has_mlflows_own_name(store: MlflowStore) -> None:
    """Its UI shows it as the source."""
    experiment = store.experiment("commit", "")
    run = store.run(experiment, "trial-a", "paper-1", "a", {"fl3d.commit": "1234"}, {})
    assert store.client.get_run(run).data.tags["mlflow.source.git.commit"] == "1234"


def test_a_sweep_that_was_deleted_in_the_ui_comes_back(store: MlflowStore) -> None:
    experiment = store.experiment("deleted", "")
    store.client.delete_experiment(experiment)
    assert store.experiment("deleted", "a note") == experiment
    assert store.client.get_experiment(experiment).tags["mlflow.note.content"] == "a note"


def test_a_uri_that_is_no_database_is_refused(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="Possible: sqlite"):
        MlflowStore(tmp_path, "ftp://somewhere")


@pytest.mark.parametrize(
    ("uri", "is_server", "is_for_one_machine"),
    [
        (None, False, True),
        ("sqlite:///there.db", False, True),
        ("postgresql://me@host/name", False, False),
        ("http://host:5000", True, False),
    ],
)
def test_a_config_names_a_file_a_database_or_a_server(
    tmp_path: Path, uri: str | None, is_server: bool, is_for_one_machine: bool
) -> None:
    store = open_store(tmp_path, uri)
    assert isinstance(store, MlflowStore)
    assert store.is_server == is_server
    assert store.is_for_one_machine == is_for_one_machine


def test_a_database_has_the_driver_that_is_installed_and_a_limit_of_patience() -> None:
    assert database_url("postgresql://h/db").startswith(
        "postgresql+psycopg2://h/db?connect_timeout"
    )
    assert database_url("postgresql://h/db?a=1") == "postgresql+psycopg2://h/db?a=1"
    assert database_url("sqlite:///file.db") == "sqlite:///file.db"


def test_an_outage_is_told_from_an_error() -> None:
    class Client:
        def search_experiments(self, max_results: int) -> None: ...

        def answer(self) -> None:
            raise ConnectionRefusedError("not MLflow's own error: passed on")

        def ask(self) -> None:
            import requests

            raise requests.ConnectionError("nobody is there\nsecond line")

    client = GuardedClient(lambda uri: Client())  # type: ignore[arg-type,return-value]
    client.connect("http://host")
    with pytest.raises(StoreDown, match=r"^http://host: nobody is there$"):
        client.ask()
    with pytest.raises(ConnectionRefusedError):
        client.answer()


def test_the_default_store_is_a_file_in_wal_mode(store: MlflowStore) -> None:
    connection = sqlite3.connect(store.root / "mlflow.db")
    assert connection.execute("PRAGMA journal_mode").fetchone() == ("wal",)
    connection.close()


def test_a_look_whether_it_can_be_read_leaves_locks_on_it_alone(tmp_path: Path) -> None:
    file = tmp_path / "mlflow.db"
    assert keeps_locks(file, MlflowStore(tmp_path).address.check_readable)
    assert not keeps_locks(tmp_path / "other.db", (tmp_path / "other.db").read_bytes)


def test_a_file_that_may_not_be_read_is_named(
    store: MlflowStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fl3d.core.files.os.access", lambda path, mode: False)
    with pytest.raises(StoreError, match=rf"^{store.file}: cannot be read \(Permission denied\)$"):
        store.read("sweep")


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (sa.exc.OperationalError("SELECT", {}, Exception("disk I/O error")), StoreDown),
        (sa.exc.DatabaseError("SELECT", {}, Exception("disk I/O error")), StoreError),
        (pd.errors.DatabaseError("disk I/O error"), StoreError),
    ],
)
def test_a_database_that_fails_is_named_in_one_line(error: Exception, kind: type) -> None:
    with (
        pytest.raises(StoreError, match=r"^/a\.db: .*disk I/O error$") as found,
        outages("sqlite:////a.db"),
    ):
        raise error
    assert type(found.value) is kind


def test_a_query_that_fails_is_named_in_one_line(
    store: MlflowStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of reading, where there is no MLflow between, and of tagging, where there is."""
    run_of(store, "fails")

    def failing(*_: object, **__: object) -> NoReturn:
        raise sqlite3.OperationalError("disk I/O error")

    monkeypatch.setattr("sqlalchemy.engine.default.DefaultDialect.do_execute", failing)
    for call in (lambda: store.read("fails"), lambda: store.set_tags("0" * 32, {"a": "b"})):
        with pytest.raises(StoreError, match=rf"^{store.file}: .*disk I/O error$"):
            call()


def test_a_view_of_what_matters_can_be_opened_by_link(store: MlflowStore) -> None:
    number = store.experiment("viewed", "")
    address = store.views()["viewed"]
    assert f"/{number}/runs?viewStateShareKey=" in address
    assert "workflowType=machine_learning" in address
    key = address.partition("viewStateShareKey=")[2].partition("&")[0]
    view = json.loads(store.client.get_experiment(number).tags[f"mlflow.sharedViewState.{key}"])
    state = json.loads(view["state"])
    sections = {section["uuid"] for section in state["compareRunSections"]}
    assert state["compareRunCharts"][0]["metricKey"] == "curve/ap_3d/moderate"
    assert state["groupBy"]["groupByKeys"] == [{"mode": "tag", "groupByData": "standing"}]
    assert {chart["metricSectionId"] for chart in state["compareRunCharts"]} == sections
    assert "Default" not in store.views()


def test_runs_of_earlier_versions_are_grouped_and_drawn_by_what_they_have(
    store: MlflowStore,
) -> None:
    """They have neither the tag nor the curves that are recorded today."""
    number = store.experiment("earlier", "")
    run = store.run(number, "trial", "p", "", {"group": "VoxelNet", "level": "2"}, {})
    store.log(run, Scored(1, 0, {"ap_3d/moderate": 1.0}))
    store.views()
    (tag,) = (v for k, v in store.client.get_experiment(number).tags.items() if "sharedView" in k)
    state = json.loads(json.loads(tag)["state"])
    assert [key["groupByData"] for key in state["groupBy"]["groupByKeys"]] == ["group", "level"]
    assert state["compareRunCharts"][0]["metricKey"] == "ap_3d/moderate"


def test_mlflow_keeps_no_longer_view() -> None:
    """Of a longer tag it keeps the beginning, which it cannot read."""
    assert len(tag_value()) <= 5000


def test_the_views_columns_are_tags_that_the_recorder_sets(store: MlflowStore) -> None:
    """A sweep of any factor is told by its levels."""
    number = store.experiment("columns", "")
    store.views()
    (tag,) = (v for k, v in store.client.get_experiment(number).tags.items() if "sharedView" in k)
    columns = json.loads(json.loads(tag)["state"])["selectedColumns"]
    assert {"tags.`group`", "tags.`level`", "tags.`seed`"} <= set(columns)


def copy_of(store: MlflowStore, path: Path) -> None:
    """Its database in another place: MLflow takes seconds to make one."""
    path.parent.mkdir(exist_ok=True)
    assert store.file is not None
    with sqlite3.connect(store.file) as before, sqlite3.connect(path) as after:
        before.backup(after)
    before.close()
    after.close()


def location_of(store: MlflowStore, experiment: str) -> str:
    return str(store.client.get_experiment(experiment).artifact_location)


def test_a_store_that_was_moved_finds_its_artifacts(store: MlflowStore, tmp_path: Path) -> None:
    """Only paths of its own: not those of a name that begins alike, nor an experiment of the user's own."""
    before = MlflowStore(tmp_path / "was # here")
    copy_of(store, before.root / "mlflow.db")
    before.open()
    numbers = [before.experiment(name, "") for name in ("alice/moved", "moved", "moved-2")]
    run = before.run(numbers[1], "trial-a", "paper-1", "a", {}, {})
    own = before.client.create_experiment("own", "file:///mine/of-own")
    bucket = before.client.create_experiment("bucket", "s3://bucket/artifacts/bucket")
    assert before.root.rename(tmp_path / "is 100 % there").exists()
    after = MlflowStore(tmp_path / "is 100 % there")
    for _ in range(2):  # to mend what is mended changes nothing
        after.open()
        base = (after.root / "artifacts").as_uri()
        found = [location_of(after, number) for number in numbers]
        assert found == [f"{base}/alice/moved", f"{base}/moved", f"{base}/moved-2"]
        where = after.client.get_run(run).info.artifact_uri
        assert where == f"{base}/moved/{run}/artifacts"
        assert location_of(after, own) == "file:///mine/of-own"
        assert location_of(after, bucket) == "s3://bucket/artifacts/bucket"


def test_a_shared_database_follows_only_artifacts_that_went_along(
    store: MlflowStore, tmp_path: Path
) -> None:
    """A root that opens it does not take over the sweeps of another, whose place it may not even see."""
    uri = f"sqlite:///{tmp_path / 'shared.db'}"
    copy_of(store, tmp_path / "shared.db")
    mine, other = (MlflowStore(tmp_path / name, uri) for name in ("mine", "other"))
    mine.open()
    number = mine.experiment("lent", "")
    (mine.root / "artifacts" / "lent").mkdir(parents=True)
    before = location_of(mine, number)
    other.open()
    assert location_of(other, number) == before
    (other.root / "artifacts" / "lent").mkdir(parents=True)
    other.open()
    assert location_of(other, number) == before  # it is where it was
    shutil.rmtree(other.root)
    mine.root.rename(tmp_path / "moved")
    other.open()
    assert location_of(other, number) == before  # it is not here
    moved = MlflowStore(tmp_path / "moved", uri)
    moved.open()
    assert location_of(moved, number) == (tmp_path / "moved" / "artifacts" / "lent").as_uri()


def test_a_deleted_model_is_none_that_the_store_holds(store: MlflowStore, tmp_path: Path) -> None:
    experiment, run = run_of(store, "deleted models")
    scored = Scored(100, 1_000, APS)
    made = [
        store.log_model(experiment, run, name, [], {}, scored, ("simulated", "abc"))
        for name in ("best", "last")
    ]
    store.client.delete_logged_model(made[0])
    assert store.models(experiment) == {(run, "last")}
    again = store.log_model(experiment, run, "best", [], {}, scored, ("simulated", "abc"))
    assert again != made[0]
    assert store.models(experiment) == {(run, "best"), (run, "last")}


def test_a_store_is_read_where_nobody_may_write(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the files that SQLite makes beside it; what still waits in one of them is not left out."""
    root = tmp_path / "read 100 % only"
    root.mkdir()
    store = MlflowStore(root)
    assert store.file is not None
    uri = store.uri
    store.file.touch()
    monkeypatch.setattr(os, "access", lambda path, mode: path != root)
    assert reading_url(uri) == f"sqlite:///file:{quote(str(store.file))}?immutable=1&uri=true"
    (root / "mlflow.db-wal").write_bytes(b"waiting")
    assert reading_url(uri) == uri
    assert reading_url("postgresql://h/db") == "postgresql://h/db"


def test_artifacts_that_cannot_be_copied_name_their_place(
    store: MlflowStore, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, run = run_of(store, "full")

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(store.client, "log_artifact", full, raising=False)
    with pytest.raises(Unwritable, match=rf"^{store.root}/artifacts: cannot be written \(No space"):
        store.log_files(run, [tmp_path / "a"], "")


def test_a_driver_that_is_not_installed_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(StoreError, match=r"//me@h/db.*: needs .* pip install 'fl3d\[postgres\]'"):
        MlflowStore(tmp_path, "postgresql://me@h/db").open()


def test_a_start_that_is_killed_as_tables_are_made_leaves_no_database(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """MLflow goes on from none that is half made."""

    class Killed(mlflow.MlflowClient):
        def search_experiments(self, *_: object, **__: object) -> NoReturn:
            super().search_experiments()
            raise KeyboardInterrupt

    store = MlflowStore(tmp_path)
    assert store.file is not None
    with monkeypatch.context() as patch:
        patch.setattr(mlflow, "MlflowClient", Killed)
        with pytest.raises(KeyboardInterrupt):
            store.open()
    assert not store.file.exists()
    (aside,) = tmp_path.glob(".mlflow.db.*.tmp")
    aside.with_name(f"{aside.name}-journal").touch()
    store.open()
    assert store.experiment("sweep", "") == "1"
    assert not list(tmp_path.glob("*.tmp*"))


def test_a_database_that_was_left_in_the_making_is_told_with_the_way_out(tmp_path: Path) -> None:
    """Of older code: what MLflow says where a migration was cut off."""
    said = sqlite3.OperationalError("table _alembic_tmp_experiments already exists")
    found = damage(sa.exc.OperationalError("CREATE TABLE", {}, said), MlflowStore(tmp_path).uri)
    assert "mlflow.db: not a whole database" in str(found)
    assert "move it away" in str(found)


@pytest.mark.parametrize("uri", ["sqlite://", "sqlite:///", "sqlite:///:memory:"])
def test_a_store_in_memory_is_refused(tmp_path: Path, uri: str) -> None:
    with pytest.raises(StoreError, match=r"^store\.uri: .*(is no store|is in memory)"):
        MlflowStore(tmp_path, uri)


def test_a_file_that_lies_beside_a_run_as_it_is_now_is_known(tmp_path: Path) -> None:
    store = MlflowStore(tmp_path / "runs")
    store.open()
    _, run = run_of(store, "ü page")  # a letter that a URI escapes, and a blank
    page = tmp_path / "page.html"
    page.write_text("one")
    assert store.without([run], page, "results") == [run]
    store.log_files(run, [page], "results")
    assert store.without([run], page, "results") == []
    assert store.without([run], page, "elsewhere") == [run]
    page.write_text("two")  # as long
    assert store.without([run], page, "results") == [run]


def test_a_file_beside_a_run_of_the_store_that_this_was_copied_from_does_not_count(
    tmp_path: Path,
) -> None:
    """Until the copy is opened, its database says where the files of the first lie."""
    store = MlflowStore(tmp_path / "runs")
    store.open()
    _, run = run_of(store, "copied")
    page = tmp_path / "page.html"
    page.write_text("one")
    store.log_files(run, [page], "results")
    shutil.copytree(store.root, tmp_path / "copy")
    copy = MlflowStore(tmp_path / "copy")
    assert copy.without([run], page, "results") == [run]
    copy.open()
    assert copy.without([run], page, "results") == []


def test_scores_of_a_database_are_read_without_mlflow(tmp_path: Path) -> None:
    """It takes seconds to load, and a report that is made again logs nothing."""
    store = MlflowStore(tmp_path)
    store.open()
    _, run = run_of(store, "light")
    store.log(run, Scored(1, 0, APS))
    page = tmp_path / "page.html"
    page.write_text("one")
    store.log_files(run, [page], "")
    lines = (
        "import sys, pathlib",
        "from fl3d.store.opening import open_store",
        f"root = pathlib.Path({str(tmp_path)!r})",
        "store = open_store(root)",
        "assert store.read('light')['ap_3d/moderate'].tolist() == [50.0]",
        f"assert store.without([{run!r}], root / 'page.html', '') == []",
        "assert 'mlflow' not in sys.modules",
    )
    subprocess.run([sys.executable, "-c", "\n".join(lines)], check=True, timeout=60)
