"""``gains``: how sure a sweep's gains over its baseline are."""

from __future__ import annotations

from fl3d.analysis.gains import AVERAGES, compare_sweep, gains, recalls, without_baseline
from fl3d.commands.words import HELP, open_words, parser, read_words
from fl3d.core.errors import ConfigError, options
from fl3d.core.files import write_text
from fl3d.evaluation.protocol import DIFFICULTIES, METRICS
from fl3d.papers.results import levels_of
from fl3d.reports.levels import gains_tables
from fl3d.reports.render import to_markdown


def run(arguments: list[str]) -> None:
    """Say how sure a sweep's gains over its baseline are: intervals over frames and seeds, from stored detections.

    What is compared is the sweep's factor (sweep.factor: by default what was swept, detector and seed apart); the
    baseline is its first level, or the one that sweep.baseline names.
    """
    arguments_of = parser("gains", run.__doc__)
    arguments_of.add_argument("overrides", nargs="+", help=HELP)
    arguments_of.add_argument(
        "--metric", help="of the printed table, such as 3d/moderate (default: of sweep.primary)"
    )
    arguments_of.add_argument(
        "--average", choices=AVERAGES, help="of the printed table (default: of sweep.primary)"
    )
    given = arguments_of.parse_intermixed_args(arguments)
    possible = [f"{view}/{level}" for view in METRICS for level in DIFFICULTIES]
    if given.metric is not None and given.metric not in possible:
        raise ConfigError(f"--metric {given.metric}: {options(given.metric, possible)}")
    sweep = open_words(read_words(given.overrides))
    compared = compare_sweep(sweep)
    table = gains(compared, sweep.baseline)
    metric = given.metric or sweep.settings.sweep.metric
    average = given.average or sweep.settings.sweep.average
    for printed in gains_tables(table, levels_of(sweep), metric, average):
        print(to_markdown(printed))
    for group in without_baseline(compared, sweep.baseline):
        print(f"{group}: no gains, for no trial of the baseline {sweep.baseline} is done.")
    over = (
        "frames alone, not over training"
        if (table["seeds"] == 1).all()
        else "frames and seeds of training"
    )
    print(f"Star: the interval, over {over}, excludes zero.")
    folder = sweep.settings.results_folder / "tables"
    for kind, frame in (("gains", table), ("recalls", recalls(compared))):
        path = folder / f"{kind}_{sweep.name}_{sweep.protocol.name}.csv"
        write_text(path, frame.to_csv(index=False, lineterminator="\n"))
        print(f"Written to {path}.")
