"""Databases that cannot be a store are named, and left as they are."""

import shutil
import sqlite3
from pathlib import Path

import pytest
import sqlalchemy as sa

from fl3d.core.errors import StoreError
from fl3d.store.base import Scored
from fl3d.store.mlflow.condition import shown
from fl3d.store.mlflow.connection import outages
from fl3d.store.mlflow.tracking import MlflowStore


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A store with a score, all of it in its one file."""
    root = tmp_path_factory.mktemp("made")
    store = MlflowStore(root)
    store.open()
    run = store.run(store.experiment("sweep", "note"), "trial", "protocol", "name", {}, {})
    store.log(run, Scored(5, 1000, {"ap_3d/moderate": 50.0}))
    alone = tmp_path_factory.mktemp("alone")
    change(root, f"VACUUM INTO '{alone / 'mlflow.db'}'")
    change(alone, "PRAGMA journal_mode=WAL")
    shutil.copy(root / "id", alone / "id")
    return alone


@pytest.fixture
def root(made: Path, tmp_path: Path) -> Path:
    shutil.copytree(made, tmp_path / "runs")
    return tmp_path / "runs"


def change(root: Path, *statements: str) -> None:
    connection = sqlite3.connect(root / "mlflow.db")
    for statement in statements:
        connection.execute(statement)
        connection.commit()
    connection.close()


def refused(root: Path, says: str) -> str:
    file = root / "mlflow.db"
    before = file.read_bytes()
    with pytest.raises(StoreError, match=rf"{file}: {says}") as error:
        MlflowStore(root).open()
    assert file.read_bytes() == before
    return str(error.value)


@pytest.mark.parametrize("how", ["text", "half", "middle"])
def test_a_damaged_file_is_named_with_the_way_out(root: Path, how: str) -> None:
    file = root / "mlflow.db"
    whole = file.read_bytes()
    file.write_bytes(
        {
            "text": b"not a database at all, though as long as one" * 100,
            "half": whole[: len(whole) // 2],
            "middle": whole[:4096] + b"\xab" * (len(whole) - 4096),
        }[how]
    )
    assert "logs them into a new one" in refused(root, "damaged, or no database")
    with pytest.raises(StoreError, match=rf"{file}: damaged"):
        MlflowStore(root).read("sweep")


def test_a_file_that_is_damaged_while_a_sweep_runs_is_named(root: Path) -> None:
    store = MlflowStore(root)
    store.open()
    says = sqlite3.DatabaseError("database disk image is malformed")
    with pytest.raises(StoreError, match=r"mlflow\.db: damaged"), outages(store.uri):
        raise sa.exc.DatabaseError("SELECT 1", {}, says)


@pytest.mark.parametrize(
    ("revision", "says", "way"),
    [
        ("451aebb31d03", "made by an older version of MLflow", "mlflow db upgrade 'sqlite:///"),
        ("ffffffffffff", "made by a newer, or another, version", "install the MLflow that made"),
    ],
)
def test_another_version_of_mlflow_is_named(root: Path, revision: str, says: str, way: str) -> None:
    change(root, f"UPDATE alembic_version SET version_num = '{revision}'")
    assert way in refused(root, says)
    # What it holds is read all the same: the tables that scores lie in are those of before.
    assert list(MlflowStore(root).read("sweep")["ap_3d/moderate"]) == [50.0]


def test_a_database_of_another_program_gets_no_tables_of_mlflows(root: Path) -> None:
    (root / "mlflow.db").unlink()
    change(
        root,
        "CREATE TABLE alembic_version (version_num TEXT)",
        "INSERT INTO alembic_version VALUES ('v3.2.0.a')",
    )
    refused(root, r"a database of another program \(its version is v3\.2\.0\.a\)")
    with pytest.raises(StoreError, match="not a whole database of MLflow's"):
        MlflowStore(root).read("sweep")


def test_an_empty_file_becomes_a_store(root: Path) -> None:
    (root / "mlflow.db").write_bytes(b"")
    store = MlflowStore(root)
    store.open()
    assert store.experiment("sweep", "note")
    assert store.read("sweep").empty


@pytest.mark.parametrize(
    ("uri", "text"),
    [
        (
            "postgresql+psycopg2://me:secret@host:5/db?connect_timeout=10",
            "postgresql://me:***@host:5/db",
        ),
        ("sqlite:////store/mlflow.db", "/store/mlflow.db"),
        ("http://host:5000", "http://host:5000"),
    ],
)
def test_an_address_is_shown_as_it_was_typed(uri: str, text: str) -> None:
    assert shown(uri) == text
