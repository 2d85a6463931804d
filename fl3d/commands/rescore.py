"""``rescore``: stored detections under other protocols."""

from __future__ import annotations

from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import ConfigError, options
from fl3d.core.files import write_text
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Score a sweep's stored detections again under other protocol values; no network is run.

    Values with commas are compared: score_threshold=0,0.5,0.8,0.9 or nms_iou=0.1,0.5 nms_kind=standup,rotated,3d.
    """
    arguments_of = parser("rescore", run.__doc__, "+sweep=gamma score_threshold=0,0.5,0.8")
    arguments_of.add_argument(
        "overrides", nargs="+", help=f"{HELP}; and KEY=VALUES of the protocol"
    )
    arguments_of.add_argument(
        "--metric", default="3d/moderate", help="of the printed table (default: 3d/moderate, R11)"
    )
    given = arguments_of.parse_intermixed_args(arguments)
    with loading():
        from fl3d.analysis.rescore import KEYS, rescore
        from fl3d.api.words import open_words, read_words
        from fl3d.config.overrides import values_by_key
        from fl3d.evaluation.protocol import METRIC_NAMES, split_metric
        from fl3d.reports.levels import rescored_tables
        from fl3d.reports.render import to_markdown
        from fl3d.runs.finished import levels_of

    possible = [name.removeprefix("ap_") for name in METRIC_NAMES]
    plain = split_metric(given.metric)[0]
    if plain not in possible:
        raise ConfigError(f"--metric {given.metric}: {options(plain, possible)}")
    changes = {}
    words = []
    for word in given.overrides:
        key = word.partition("=")[0].removeprefix("protocol.")
        if key in KEYS:
            changes[key] = values_by_key([word.removeprefix("protocol.")])[key]
        else:
            words.append(word)
    if not changes:
        raise ConfigError(
            f"nothing to compare; give KEY=VALUE,VALUE with one of: {', '.join(KEYS)}"
        )
    sweep = open_words(read_words(words))
    scores = rescore(sweep, changes)
    if f"ap_{given.metric}" not in scores:
        there = [str(name).removeprefix("ap_") for name in scores if str(name).startswith("ap_")]
        why = (
            ": a protocol without the picture has no image metric"
            if plain == given.metric
            else f", of these classes: {options(given.metric, there)}"
        )
        raise ConfigError(f"--metric {given.metric}{why}")
    for name in sweep.classes:
        overlaps = " / ".join(f"{value:g}" for value in sweep.protocol.overlaps[name])
        print(f"{name}, protocol {sweep.protocol.name}, overlaps {overlaps} (image / BEV / 3D)")
    print("" if len(sweep.classes) == 1 else "\nMeans over classes, unless the metric names one.\n")
    for table in rescored_tables(scores, levels_of(sweep), list(changes), f"ap_{given.metric}"):
        print(to_markdown(table))
    name = f"rescored_{sweep.name}_{sweep.protocol.name}_{'_'.join(changes)}.csv"
    path = sweep.settings.results_folder / "tables" / name
    write_text(path, scores.to_csv(index=False, lineterminator="\n"))
    print(f"Written to {path}, all APs.")
