"""What MLflow shows of an experiment at first: a view that it can share by a link, kept as a tag of the experiment.

MLflow has no setting for columns and charts on its server; a shared view is its own way to hand them on.
"""

from __future__ import annotations

import json

VIEW = "fl3d"  # its key in links
TAG = f"mlflow.sharedViewState.{VIEW}"
# As ``sweep.recorder`` and ``sweep.verdict_tags`` set them.
TAGS = ("verdict", "gain", "detector", "group", "level", "seed", "best_step")
APS = ("ap_3d/easy", "ap_3d/moderate", "ap_3d/hard", "ap_bev/moderate")
CHARTS = {
    "AP over steps": ("ap_3d/moderate", "ap_3d/easy", "ap_3d/hard", "ap_bev/moderate"),
    "Training": ("loss/total", "train/lr"),
}


def link(experiment: str) -> str:
    """Where the view of an experiment lies, from the UI's root."""
    query = f"viewStateShareKey={VIEW}&compareRunsMode=CHART&workflowType=machine_learning"
    return f"#/experiments/{experiment}/runs?{query}"


def tag_value() -> str:
    """The view as MLflow keeps it (at most 5000 characters): columns, order, and the curves of AP before all others."""
    sections, charts = [], []
    for title, metrics in CHARTS.items():
        sections.append(
            {"uuid": title, "name": title, "display": True, "isReordered": False, "deleted": False}
        )
        charts += [_curve(title, metric) for metric in metrics]
    columns = [f"tags.`{name}`" for name in TAGS] + [f"metrics.`{name}`" for name in APS]
    state = {
        "orderByKey": "metrics.`ap_3d/moderate`",
        "orderByAsc": False,
        "selectedColumns": columns,
        "runsHiddenMode": "SHOW_ALL",
        "compareRunSections": sections,
        "compareRunCharts": charts,
    }
    return json.dumps(
        {"name": "AP of every trial", "createdAt": 0, "updatedAt": 0, "state": json.dumps(state)}
    )


def _curve(section: str, metric: str) -> dict[str, object]:
    return {
        "uuid": f"{section} {metric}",
        "type": "LINE",
        "metricSectionId": section,
        "metricKey": metric,
        "displayName": metric,
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
