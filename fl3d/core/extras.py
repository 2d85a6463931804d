"""Packages that only some commands need, and the extra of ``pyproject.toml`` that brings each."""

from __future__ import annotations

# Modules by extra, as they are imported; a test holds them to pyproject.toml.
EXTRAS = {
    "train": ("torch", "mlflow", "optuna", "sqlalchemy", "pyarrow"),
    "slurm": ("submitit",),
    "ray": ("ray",),
    "postgres": ("psycopg2",),
}


def install(extra: str) -> str:
    """The command that brings an extra to an installed fl3d.

    Args:
        extra: such as ``slurm``.
    """
    if extra not in EXTRAS:
        raise KeyError(extra)
    return f"pip install 'fl3d[{extra}]'"


def lacking(error: BaseException | None) -> str | None:
    """What is to be said of an import that failed because an extra is not installed; None: it failed otherwise.

    Args:
        error: with its causes, of which one may be that import.
    """
    while error is not None:
        if isinstance(error, ModuleNotFoundError):
            module = (error.name or "").partition(".")[0]
            for extra, modules in EXTRAS.items():
                if module in modules:
                    return f"needs {module}, which is not installed: {install(extra)}"
        error = error.__cause__ or error.__context__
    return None
