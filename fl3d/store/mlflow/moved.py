"""Artifacts of a store that was moved: MLflow keeps absolute paths of them, which are mended when a store is opened."""

from __future__ import annotations

import os
from pathlib import Path
from urllib.parse import unquote, urlsplit

import sqlalchemy as sa

ARTIFACTS = "artifacts"  # folder below a store's root
# Where MLflow's database says where artifacts lie.
COLUMNS = (
    ("experiments", "artifact_location"),
    ("runs", "artifact_uri"),
    ("logged_models", "artifact_location"),
)


def artifact_location(root: Path, experiment: str) -> str:
    """Where the artifacts of a sweep lie, as MLflow is told it."""
    return (root / ARTIFACTS / experiment).as_uri()


def mend_locations(connection: sa.Connection, root: Path, is_own: bool) -> list[str]:
    """Let MLflow's paths of artifacts lead to where a store's root lies now; what leads there already stays.

    A database in the root itself moves with its artifacts: all of its sweeps' are here. In one that lies elsewhere and
    may be shared, only those are taken over that are gone from where they were, and are here.

    Args:
        connection: to MLflow's database, whose tables are there.
        root: absolute, of the store.
        is_own: whether the database lies in the root.

    Returns:
        names of the experiments whose artifacts had moved.
    """
    rows = connection.execute(sa.text("SELECT name, artifact_location FROM experiments")).fetchall()
    mended = []
    for name, location in rows:
        before = root_of(location, name)
        if before is None or _is_same(before, root):
            continue
        is_gone = not (before / ARTIFACTS / name).exists()
        if is_own or (is_gone and (root / ARTIFACTS / name).exists()):
            _replace(connection, location, artifact_location(root, name))
            mended.append(str(name))
    connection.commit()
    return mended


def root_of(location: str | None, experiment: str) -> Path | None:
    """The root that a sweep's artifacts were put below; None where fl3d did not choose the place."""
    parts = urlsplit(location or "")
    path, ending = unquote(parts.path), f"/{ARTIFACTS}/{experiment}"
    if parts.scheme != "file" or not path.endswith(ending):
        return None
    return Path(path.removesuffix(ending) or "/")


def _is_same(before: Path, root: Path) -> bool:
    """Whether two paths lead to one folder, by a link or a mount."""
    try:
        return before == root or os.path.samefile(before, root)
    except OSError:  # gone, or nobody may look
        return False


def _replace(connection: sa.Connection, before: str, now: str) -> None:
    """Replace the beginning of all paths that are this one or lead below it."""
    values = {"before": before, "now": now, "length": len(before), "next": len(before) + 1}
    tables = sa.inspect(connection).get_table_names()
    for table, column in COLUMNS:
        if table in tables:
            query = (
                f"UPDATE {table} SET {column} = :now || substr({column}, :next) "
                f"WHERE substr({column}, 1, :length) = :before "
                f"AND substr({column}, :next, 1) IN ('', '/')"
            )
            connection.execute(sa.text(query), values)
