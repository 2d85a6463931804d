"""``gains``: what a sweep has found, and how sure it is."""

from __future__ import annotations

from typing import TYPE_CHECKING

from fl3d.analysis import AVERAGES
from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import ConfigError, options
from fl3d.core.files import write_text
from fl3d.core.loading import loading

if TYPE_CHECKING:
    from fl3d.runs.finished import FinishedSweep


def run(arguments: list[str]) -> None:
    """Say what a sweep has found: each level better or worse than the baseline, equivalent to it, or undecided.

    What is compared is the sweep's factor (sweep.factor: by default what was swept, detector and seed apart); the
    baseline is its first level, or the one that sweep.baseline names. The verdict is about sweep.primary, and gains
    below sweep.margin do not matter. It needs three seeds of training: seeds=3.
    """
    arguments_of = parser("gains", run.__doc__, "detector=voxelnet loss.gamma=0,1,2 seeds=3")
    arguments_of.add_argument("overrides", nargs="+", help=HELP)
    arguments_of.add_argument(
        "--metric",
        help="gains of another metric too, such as bev/easy, or of one of several classes, such as "
        "bev/easy/Pedestrian; without verdicts",
    )
    arguments_of.add_argument(
        "--average", choices=AVERAGES, default="R40", help="of these (default: R40)"
    )
    given = arguments_of.parse_intermixed_args(arguments)
    with loading():
        from fl3d.analysis.samples import CELLS
        from fl3d.api.words import open_words, read_words
        from fl3d.evaluation.protocol import split_metric

    possible = ["/".join(cell) for cell in CELLS]
    metric, class_name = split_metric(given.metric) if given.metric else (None, None)
    if metric is not None and metric not in possible:
        raise ConfigError(f"--metric {given.metric}: {options(metric, possible)}")
    sweep = open_words(read_words(given.overrides))
    if class_name is not None and class_name not in (sweep.classes[1:] and sweep.classes):
        raise ConfigError(f"--metric {given.metric}: the sweep is of {' and '.join(sweep.classes)}")
    if metric is not None and metric.split("/")[0] not in sweep.protocol.metrics:
        raise ConfigError(
            f"--metric {given.metric}: protocol {sweep.protocol.name} has no such metric, only "
            f"{' and '.join(sweep.protocol.metrics)}"
        )
    for one in (sweep, *sweep.each_class()):
        _show(one, metric if one.class_name == class_name else None, given.average)


def _show(sweep: FinishedSweep, metric: str | None, average: str) -> None:
    """Print and write what a sweep has found; of several classes first the mean, then each.

    Args:
        sweep: of the mean, or of a class.
        metric: whose gains are printed too; None: none.
        average: R11 or R40, of them.
    """
    from fl3d.analysis.found import judge_sweep
    from fl3d.analysis.gains import recalls, without_baseline
    from fl3d.analysis.samples import compare_sweep
    from fl3d.papers.judged_views import tables_of_verdicts
    from fl3d.reports.figures.forest import forest
    from fl3d.reports.levels import gains_tables
    from fl3d.reports.render import to_markdown
    from fl3d.runs.finished import levels_of

    levels = levels_of(sweep)
    judged = judge_sweep(sweep)
    compared = compare_sweep(sweep)
    for table in tables_of_verdicts(judged, levels):
        print(to_markdown(table))
    if metric is not None:
        for table in gains_tables(judged.gains, levels, metric, average):
            print(to_markdown(table))
    for group in without_baseline(compared, sweep.baseline):
        print(f"{group}: no gains, for no trial of the baseline {sweep.baseline} is done.")
    folder = sweep.settings.results_folder
    frames = {"verdicts": judged.verdicts, "gains": judged.gains}
    for kind, frame in {**frames, "recalls": recalls(compared, sweep.classes)}.items():
        path = folder / "tables" / f"{kind}_{sweep.name}_{sweep.protocol.name}.csv"
        write_text(path, frame.to_csv(index=False, lineterminator="\n"))
        print(f"Written to {path}.")
    plot = forest(judged.verdicts, levels, judged.margin)
    for path in [] if plot is None else plot.write(folder / "figures" / f"forest_{sweep.name}"):
        print(f"Written to {path}.")
