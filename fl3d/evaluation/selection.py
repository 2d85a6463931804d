"""Which checkpoint stands for a trial: written rules over scores. Pure."""

from __future__ import annotations

import pandas as pd

from fl3d.core.errors import ConfigError, options

MEAN_3D = ["ap_3d/easy", "ap_3d/moderate", "ap_3d/hard"]
RULES = ("last", "best")  # that people name
BEST_OF_LAST_STAGE = "best_of_last_stage"  # whatever ``best`` is asked to look at
STAGES = ("last", "all")


def select(scores: pd.DataFrame, rule: str, stages: str = "all") -> pd.DataFrame:
    """One checkpoint of each trial.

    Args:
        scores: a row for each ``trial`` and ``step``, with ``first_own_step``, the step at which the trial's last
            stage began.
        rule: ``last``, the final step; or ``best``, the highest mean of the three 3D APs (paper, §VI-A: "3D
            detection mAP"), the earliest where they tie; or ``best_of_last_stage``, the same of the last stage alone.
        stages: where ``best`` looks: ``all`` of the trial's curve (paper, Table IV: "among all intermediate weights"),
            or its ``last`` stage. Checkpoints of earlier stages may be those of several trials.

    Raises:
        ConfigError: a rule that does not exist.
    """
    for key, value, possible in (
        ("rule", rule, (*RULES, BEST_OF_LAST_STAGE)),
        ("stages", stages, STAGES),
    ):
        if value not in possible:
            raise ConfigError(f"selection.{key}: no choice '{value}'. {options(value, possible)}")
    ordered = scores.sort_values(["trial", "step"])
    if rule == "last":
        return ordered.groupby("trial", sort=False).tail(1).reset_index(drop=True)
    if stages == "last" or rule == BEST_OF_LAST_STAGE:
        ordered = ordered[ordered["step"] > ordered["first_own_step"]]
    mean = ordered[MEAN_3D].mean(axis=1)
    return ordered.loc[mean.groupby(ordered["trial"]).idxmax()].reset_index(drop=True)
