"""A database that cannot serve as a store: damaged, of another program, or of another version of MLflow."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa

from fl3d.core.errors import StoreError

# What SQLite says of a file that is no database, or no longer one.
DAMAGED = ("file is not a database", "database disk image is malformed")
# What it says of one that lacks what MLflow made, or was left half made: OperationalErrors, though they do not pass.
INCOMPLETE = ("no such table", "no such column", "table _alembic_tmp")
REVISIONS = Path("store") / "db_migrations" / "versions"  # below MLflow's own folder
AWAY = "move it away (with its -wal and -shm, if any)"
AGAIN = "every score lies in the run folders too: the sweep's command logs them into a new one, and nothing is trained"


def shown(uri: str) -> str:
    """A store's address as it was typed, without its password, driver and limits of waiting; of a file its path."""
    try:
        url = sa.engine.make_url(uri)
    except sa.exc.ArgumentError:
        return uri
    is_file = url.drivername.startswith("sqlite")
    if is_file:
        return str(url.database)
    plain = url.set(drivername=url.get_backend_name()) if "+" in url.drivername else url
    return plain.set(query={}).render_as_string(hide_password=True)


def check_owner(connection: sa.Connection, uri: str) -> None:
    """Refuse a database where another program keeps its versions in a table of the same name as MLflow's.

    MLflow would make its tables there first, and only then fail.

    Raises:
        StoreError: naming the database.
    """
    tables = sa.inspect(connection).get_table_names()
    if "alembic_version" in tables and "experiments" not in tables:
        found = _revision(connection)
        if found is not None:
            raise StoreError(
                f"{shown(uri)}: a database of another program (its version is {found}), not MLflow's; nothing was "
                "changed: give a store.uri of its own"
            )


def damage(error: BaseException, uri: str) -> StoreError | None:
    """What an error says of a database that will not get well by itself; None: something else."""
    for one in _chain(error):
        text = str(getattr(one, "orig", None) or one).splitlines()
        first = text[0] if text else ""
        if any(words in first for words in DAMAGED):
            return StoreError(
                f"{shown(uri)}: damaged, or no database ({_named(first, DAMAGED)}). Nothing was changed: bring back a "
                f"copy, or {AWAY}; {AGAIN}"
            )
        if any(words in first for words in INCOMPLETE) and isinstance(one, sa.exc.OperationalError):
            return StoreError(
                f"{shown(uri)}: not a whole database of MLflow's ({first.rpartition(') ')[2]}). Nothing was changed: "
                f"bring back a copy, or {AWAY}; {AGAIN}"
            )
    return None


def other_version(connection: sa.Connection, uri: str) -> StoreError:
    """What to say where MLflow refuses the version of its database."""
    import mlflow

    found = _revision(connection)
    revisions = Path(mlflow.__file__).parent / REVISIONS
    is_known = found is not None and any(revisions.glob(f"{found}_*.py"))
    if is_known:
        way = (
            f"copy it, then: python -m mlflow db upgrade '{uri if 'sqlite' in uri else shown(uri)}'"
        )
    else:
        way = f"install the MLflow that made it, or {AWAY}"
    age = "an older" if is_known else "a newer, or another,"
    return StoreError(
        f"{shown(uri)}: made by {age} version of MLflow (schema {found}; here is MLflow {mlflow.__version__}). Nothing "
        f"was changed: {way}; {AGAIN}"
    )


def _revision(connection: sa.Connection) -> str | None:
    return connection.execute(sa.text("SELECT version_num FROM alembic_version")).scalar()


def _chain(error: BaseException) -> Iterator[BaseException]:
    """An error and what it came from."""
    seen: BaseException | None = error
    while seen is not None:
        yield seen
        seen = seen.__cause__ or seen.__context__


def _named(text: str, possible: tuple[str, ...]) -> str:
    return next(words for words in possible if words in text)
