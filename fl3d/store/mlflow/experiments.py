"""Experiments of a store in MLflow: one a sweep, with the sweep's note and a view of what matters."""

from __future__ import annotations

from typing import Any

from fl3d.store.base import CURVE, CURVES, STANDING
from fl3d.store.mlflow.view import TAG as VIEW_TAG
from fl3d.store.mlflow.view import link, tag_value

NOTE = "mlflow.note.content"


def open_experiment(client: Any, name: str, note: str, location: str | None) -> str:
    """Id of an experiment, made if need be and brought back if it was deleted; several processes may ask at once.

    Args:
        client: of the store.
        name: of the experiment.
        note: shown above its runs.
        location: of its artifacts; None: where the server keeps them.
    """
    from mlflow.exceptions import MlflowException

    found = client.get_experiment_by_name(name)
    if found is None:
        try:
            return str(client.create_experiment(name, location, {NOTE: note}))
        except MlflowException as error:
            found = client.get_experiment_by_name(name)
            # Unless it was made by another just now.
            if found is None or error.error_code != "RESOURCE_ALREADY_EXISTS":
                raise
    if found.lifecycle_stage == "deleted":
        client.restore_experiment(found.experiment_id)
    client.set_experiment_tag(found.experiment_id, NOTE, note)
    return str(found.experiment_id)


def set_views(client: Any) -> dict[str, str]:
    """Name and link, from the UI's root, of each experiment, each given a view of what matters."""
    found = [one for one in client.search_experiments() if one.name != "Default"]
    for one in found:
        newest = client.search_runs([one.experiment_id], max_results=1)
        # Runs of fl3d 0.1 have neither.
        has_standing = all(STANDING in run.data.tags for run in newest)
        has_curves = all(CURVE + CURVES[0] in run.data.metrics for run in newest)
        view = tag_value(has_standing, has_curves)
        client.set_experiment_tag(one.experiment_id, VIEW_TAG, view)
    by_name = sorted(found, key=lambda one: str(one.name))
    return {one.name: link(one.experiment_id) for one in by_name}
