"""What MLflow shows of an experiment at first: a view that it can share by a link, kept as a tag of the experiment.

MLflow has no setting for columns and charts on its server; a shared view is its own way to hand them on.
"""

from __future__ import annotations

import json

from fl3d.store.base import CURVE, CURVES, STANDING

VIEW = "fl3d"  # its key in links
TAG = f"mlflow.sharedViewState.{VIEW}"
# As ``sweep.recorder`` and ``sweep.verdict_tags`` set them.
TAGS = ("verdict", "gain", "detector", "group", "level", "seed", "best_step")
APS = ("ap_3d/easy", "ap_3d/moderate", "ap_3d/hard", "ap_bev/moderate")
CHARTS = {
    "AP over steps": CURVES[:4],
    "Training": CURVES[4:],
}


def link(experiment: str) -> str:
    """Where the view of an experiment lies, from the UI's root."""
    query = f"viewStateShareKey={VIEW}&compareRunsMode=CHART&workflowType=machine_learning"
    return f"#/experiments/{experiment}/runs?{query}"


def tag_value(has_standing: bool = True, has_curves: bool = True) -> str:
    """The view as MLflow keeps it (at most 5000 characters): levels with their seeds below them, columns, and curves.

    Args:
        has_standing: whether runs have the tag that they are grouped by; else they are by group and level.
        has_curves: whether runs have curves of their own, without what other runs have already.
    """
    prefix = CURVE if has_curves else ""
    sections, charts = [], []
    for title, metrics in CHARTS.items():
        sections.append(
            {"uuid": title, "name": title, "display": True, "isReordered": False, "deleted": False}
        )
        charts += [_curve(title, prefix + metric, metric) for metric in metrics]
    columns = [f"tags.`{name}`" for name in TAGS] + [f"metrics.`{name}`" for name in APS]
    state = {
        "groupBy": _grouping((STANDING,) if has_standing else ("group", "level")),
        "orderByKey": "metrics.`ap_3d/moderate`",
        "orderByAsc": False,
        "selectedColumns": columns,
        "runsHiddenMode": "SHOW_ALL",
        "compareRunSections": sections,
        "compareRunCharts": charts,
    }
    return json.dumps(
        {
            "name": "Levels and their seeds",
            "createdAt": 0,
            "updatedAt": 0,
            "state": json.dumps(state),
        }
    )


def _grouping(tags: tuple[str, ...]) -> dict[str, object]:
    """Runs of one value of some tags lie together; charts draw their mean."""
    keys = [{"mode": "tag", "groupByData": tag} for tag in tags]
    return {"aggregateFunction": "average", "groupByKeys": keys}


def _curve(section: str, metric: str, name: str) -> dict[str, object]:
    return {
        "uuid": f"{section} {name}",
        "type": "LINE",
        "metricSectionId": section,
        "metricKey": metric,
        "displayName": name,
        "runsCountToCompare": 100,
        "deleted": False,
        "isGenerated": False,
        "lineSmoothness": 0,
        "scaleType": "linear",
        "xAxisScaleType": "linear",
        "xAxisKey": "step",
        "yAxisKey": "metric",
        "useGlobalXaxisKey": True,
        "useGlobalLineSmoothing": True,
    }
