"""What a sweep would do, before it does it: stages, time, FLOPs, disk, and what it could tell. Nothing is trained."""

from __future__ import annotations

from collections.abc import Callable

from fl3d.config.settings import Settings, read_settings
from fl3d.core.errors import ConfigError
from fl3d.core.plurals import several
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.expected import expect_data
from fl3d.sweep.forecast import Forecast
from fl3d.sweep.launchers.base import Launcher
from fl3d.sweep.pilot import find_pilots
from fl3d.sweep.plan import Plan
from fl3d.sweep.planner import Planner
from fl3d.sweep.power import Question, power_lines
from fl3d.sweep.setup import looks_before, paid_looks
from fl3d.sweep.sweepers.base import Point, Sweeper
from fl3d.sweep.tree import plan_tree


def preview(
    sweeper: Sweeper,
    launcher: Launcher,
    say: Callable[[str], None] = print,
    spread: float | None = None,
    margin: float | None = None,
) -> Plan:
    """Print the plan of a sweep.

    Args:
        sweeper: proposes its trials.
        launcher: where its stages would run.
        say: prints a line for the user.
        spread: of a gain between seeds, AP, where the user knows it; None: as finished trials tell it.
        margin: gain that the seeds are to tell, AP; None: ``sweep.margin``.

    Returns:
        the plan; of a study, that of one of its trials.

    Raises:
        ConfigError: the sweep cannot be run.
        DataError: the data cannot be used.
    """
    if not sweeper.base:
        raise ConfigError("a sweep needs at least one trial")
    settings = read_settings(sweeper.base)
    data = expect_data(settings.data)
    points = sweeper.first()
    swept = sweeper.swept if points else ()  # a study's one trial has no values of its own
    planner = Planner(sweeper.base, settings, swept, data.info)
    plan = planner.plan(points or [Point((), {}, sweeper.base)])
    baseline = planner.check(plan)
    forecast = Forecast(
        plan,
        StoreFolder(settings.store.root),
        data.n_val,
        launcher.slots if points else 1,
        settings.store.keep_every,
        data.missing is None,
        is_example=not points,
    )
    unready = f" (data: {data.missing})" if data.missing else ""
    if points:
        say(f"{settings.experiment}: {forecast.counts()}{unready}")
    else:
        count = several(sweeper.n_trials, "trial")
        say(f"{settings.experiment}: a study of {count}, proposed as it goes{unready}")
        say(f"One of them, with nothing shared, has {several(len(plan.stages), 'stage')}:")
    for line in forecast.summary():
        say(line)
    if sweeper.outlook():
        say(sweeper.outlook())
    if points:
        seeds = [trial.seed for trial in plan.trials]
        looks = paid_looks(looks_before(settings, plan), sweeper.looks, seeds)
        asked = Question(settings.sweep, baseline, looks, margin)
        for line in _power(plan, settings, forecast, asked, spread):
            say(line)
    say("")
    for line in plan_tree(plan, forecast.note):
        say(line)
    return plan


def _power(
    plan: Plan, settings: Settings, forecast: Forecast, asked: Question, spread: float | None
) -> list[str]:
    """What the plan's seeds could tell, by finished trials or by hand."""
    if not asked.is_of(plan):
        return []
    groups = dict.fromkeys(trial.group for trial in plan.trials)
    return power_lines(plan, asked, find_pilots(settings, groups, spread), forecast.price)
