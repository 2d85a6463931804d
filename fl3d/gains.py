"""How sure a sweep is: each AP and its gain over gamma = 0, with intervals over frames and seeds; and recall."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import pandas as pd

from fl3d.errors import ConfigError, options
from fl3d.evaluation.average_precision import Comparison
from fl3d.evaluation.bootstrap import Interval, paired_bootstrap
from fl3d.evaluation.detections import Validation, compare_stored
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS, Protocol
from fl3d.evaluation.recall import OVERLAPS, recall
from fl3d.files import write_text
from fl3d.records import Config
from fl3d.rescore import finished_trials, front, stored_with_validation
from fl3d.results import results_folder

Compared = dict[tuple[str, float], dict[int, Comparison]]


def compare_sweep(config: Config, steps: Mapping[str, int] | None = None, by: str = "gamma") -> Compared:
    """Comparisons of a sweep's models: by (detector, gamma), then by seed.

    Args:
        config: names the sweep, its data and profile, and the protocol.
        steps: of the checkpoint that stands for each trial; None: the last.
        by: ``gamma``, or ``normalize``: 0 for the original loss and 1 for the enhanced one.
    """
    protocol = Protocol(**config["protocol"])
    seen: dict[tuple[str, ...], Validation] = {}
    compared: Compared = {}
    for paths in finished_trials(config):
        if steps is not None and paths.folder.name not in steps:
            continue  # finished, and not yet in the store
        trial = front(paths)
        step = steps[paths.folder.name] if steps is not None else None
        comparison = compare_stored(*stored_with_validation(paths, seen, step), protocol)
        compared.setdefault((trial["detector"], trial[by]), {})[trial["seed"]] = comparison
    return compared


def comparable(compared: Compared) -> Compared:
    """What has a gain: the rest has no trial with gamma = 0, or none of the same seed."""
    return {
        (detector, gamma): by_seed
        for (detector, gamma), by_seed in compared.items()
        if set(by_seed) & set(compared.get((detector, 0.0), {}))
    }


def gains(compared: Compared, n_resamples: int = 1000) -> pd.DataFrame:
    """AP and gain of every gamma, metric and difficulty, with 95 % intervals.

    Args:
        compared: see ``compare_sweep``; seeds that gamma = 0 has not are left out.
        n_resamples: of the bootstrap.

    Returns:
        a row for each detector, gamma, metric, difficulty and average (R11, R40).

    Raises:
        ConfigError: a detector has no trial with gamma = 0.
    """
    rows = []
    for (detector, gamma), by_seed in sorted(compared.items()):
        if (detector, 0.0) not in compared:
            raise ConfigError(f"{detector}: a gain needs a trial with gamma = 0")
        base = compared[detector, 0.0]
        seeds = sorted(set(by_seed) & set(base))
        for metric in METRICS:
            for level in DIFFICULTIES:
                own, zero = ([side[s].matches("Car", metric, level) for s in seeds] for side in (by_seed, base))
                paired = paired_bootstrap(own, zero, n_resamples)
                for average, ap, gain in zip(("R11", "R40"), paired.ap, paired.gain, strict=True):
                    rows.append(
                        {
                            "detector": detector,
                            "gamma": gamma,
                            "seeds": len(seeds),
                            "metric": metric,
                            "difficulty": level,
                            "average": average,
                            **_columns("ap", ap),
                            **_columns("gain", gain),
                            "sure": gain.excludes_zero,
                            "one_r11_step": paired.one_step and average == "R11",
                        }
                    )
    return pd.DataFrame(rows)


def recalls(compared: Compared) -> pd.DataFrame:
    """Recall of the final boxes at 3D overlaps 0.1 to 0.9, over all labelled cars; a row a trial."""
    rows = []
    for (detector, gamma), by_seed in sorted(compared.items()):
        for seed, comparison in sorted(by_seed.items()):
            shares = recall(comparison.gt, comparison.overlaps)
            found = {f"recall_{overlap:g}": share for overlap, share in zip(OVERLAPS, shares, strict=True)}
            rows.append({"detector": detector, "gamma": gamma, "seed": seed, **found})
    return pd.DataFrame(rows)


def _columns(name: str, interval: Interval) -> dict[str, float]:
    return {name: interval.value, f"{name}_low": interval.low, f"{name}_high": interval.high}


def gains_to_markdown(table: pd.DataFrame, metric: str, average: str) -> str:
    """AP and gain of one metric, as Markdown; a star where the gain's interval excludes zero."""
    view, level = metric.split("/")
    chosen = table[(table["metric"] == view) & (table["difficulty"] == level) & (table["average"] == average)]
    parts = []
    for detector, own in chosen.groupby("detector"):
        lines = [f"**{detector}**, {view} {level}, {average}, last models, 95 % intervals", ""]
        lines += ["| γ | AP | gain over γ = 0 | |", "|---|---|---|---|"]
        for row in own.to_dict("records"):
            ap = f"{row['ap']:.2f} [{row['ap_low']:.2f}, {row['ap_high']:.2f}]"
            gain = f"{row['gain']:+.2f} [{row['gain_low']:+.2f}, {row['gain_high']:+.2f}]"
            marks = ("*" if row["sure"] else "") + (" one R11 step" if row["one_r11_step"] else "")
            lines.append(f"| {row['gamma']:g} | {ap} | {gain if row['gamma'] else ''} | {marks.strip()} |")
        parts.append("\n".join(lines))
    return "\n\n".join(parts)


def gains_and_write(config: Config, metric: str, average: str, say: Callable[[str], None] = print) -> None:
    """Print AP and gain of one metric, and write those of all, and the recalls, beside the sweep's tables.

    Args:
        config: names the sweep, its data and profile, and the protocol.
        metric: such as ``3d/moderate``.
        average: ``R11`` or ``R40``.
        say: prints a line for the user.
    """
    possible = [f"{view}/{level}" for view in METRICS for level in DIFFICULTIES]
    if metric not in possible:
        raise ConfigError(f"--metric {metric}: {options(metric, possible)}")
    compared = compare_sweep(config)
    table, shares = gains(compared), recalls(compared)
    say(gains_to_markdown(table, metric, average))
    say("\nStar: the interval, over frames (and seeds, where there are several), excludes zero.")
    folder, name = results_folder(config) / "tables", f"{config['sweep']['name']}_{config['protocol']['name']}"
    for kind, frame in (("gains", table), ("recalls", shares)):
        path = folder / f"{kind}_{name}.csv"
        write_text(path, frame.to_csv(index=False, lineterminator="\n"))
        say(f"Written to {path}.")
