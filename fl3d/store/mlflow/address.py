"""Where an MLflow store is: a file, a PostgreSQL database or a server, and what each of them needs to be opened."""

from __future__ import annotations

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path

import sqlalchemy as sa

from fl3d.core.errors import StoreError
from fl3d.core.files import check_access, check_writable
from fl3d.core.leases import leased
from fl3d.store.mlflow.condition import check_owner
from fl3d.store.mlflow.connection import check_driver, database_url, file_url, make_whole
from fl3d.store.mlflow.moved import mend_locations

IN_MEMORY = re.compile(r"^sqlite:/*($|\?)|:memory:|mode=memory")  # as SQLAlchemy and SQLite tell it
POSSIBLE = "sqlite:///FILE, postgresql://USER@HOST/NAME, http://HOST:PORT (an MLflow server)"
SCHEMA_LOCK = 0x666C3364  # of PostgreSQL, while MLflow makes its tables


class Address:
    """Of a store.

    Args:
        root: folder of the stages, of the default store and of its artifacts.
        uri: a database (``postgresql://...``, ``sqlite:///...``) or an MLflow server (``http://...``); None:
            ``root/mlflow.db``.

    Raises:
        StoreError: the URI is neither.
    """

    def __init__(self, root: Path, uri: str | None = None) -> None:
        self.root = root.absolute()
        self.uri = database_url(uri or file_url(self.root))
        self.is_file = self.uri.startswith("sqlite:")
        self.is_server = self.uri.startswith(("http://", "https://"))
        if not (self.is_server or self.uri.startswith(("sqlite:///", "postgresql"))):
            raise StoreError(f"store.uri: '{self.uri}' is no store. Possible: {POSSIBLE}")
        if self.is_file and IN_MEMORY.search(self.uri):
            raise StoreError(
                f"store.uri: '{self.uri}' is in memory, and gone when fl3d ends. Possible: {POSSIBLE}"
            )

    @property
    def file(self) -> Path | None:
        """The database, where it is a file."""
        return Path(self.uri.removeprefix("sqlite:///")).absolute() if self.is_file else None

    @property
    def exists(self) -> bool:
        """Whether the default store has been made; a named one is taken to exist."""
        return self.file is None or self.file.exists()

    def check(self) -> None:
        """Refuse what cannot be opened, before MLflow is loaded.

        Raises:
            StoreError: PostgreSQL's driver is not installed.
            Unwritable: it is a file in a folder that cannot be written.
        """
        check_driver(self.uri)
        if self.file is not None:
            check_writable(self.file.parent)

    def check_readable(self) -> None:
        """Refuse a file that this user may not read, by its name.

        Raises:
            StoreError: it cannot be read.
        """
        if self.file is None:
            return
        try:
            check_access(self.file, os.R_OK)
        except OSError as error:
            raise StoreError(f"{self.file}: cannot be read ({error.strerror})") from None

    @contextlib.contextmanager
    def alone(self) -> Iterator[sa.Connection | None]:
        """One process at a time: several that make MLflow's tables together destroy a SQLite store.

        Yields:
            a connection to its database; None of a server.
        """
        if self.file is not None:
            with leased(self.file.with_name(f".{self.file.name}.lease")), self._of_file() as one:
                yield one
        elif self.is_server:
            yield None
        else:
            # The lock is the session's: a pool would keep both.
            with sa.create_engine(self.uri, poolclass=sa.NullPool).connect() as connection:
                connection.execute(sa.text(f"SELECT pg_advisory_lock({SCHEMA_LOCK})"))
                check_owner(connection, self.uri)
                yield connection

    @contextlib.contextmanager
    def _of_file(self) -> Iterator[sa.Connection]:
        assert self.file is not None
        make_whole(self.file)
        with sa.create_engine(self.uri).connect() as connection:
            check_owner(connection, self.uri)
            connection.commit()  # a reader's lock would keep the mode from changing
            connection.execute(sa.text("PRAGMA journal_mode=WAL"))
            yield connection

    def mend(self) -> None:
        """Let MLflow find the artifacts of a root that was moved; a server keeps its own."""
        if self.is_server:
            return
        is_own = self.file is not None and self.file.parent == self.root
        engine = sa.create_engine(self.uri)
        try:
            with engine.connect() as connection:
                mend_locations(connection, self.root, is_own)
        finally:
            engine.dispose()
