"""What a sweep says of itself: above its runs in the store, and when it starts."""

from __future__ import annotations

from collections.abc import Sequence

from fl3d.config.settings import Settings
from fl3d.core.plurals import several
from fl3d.reports.render import to_markdown
from fl3d.reports.table import Table
from fl3d.runs.layout import StoreFolder
from fl3d.sweep.plan import Plan


def note(settings: Settings, short: str = "", tables: Sequence[Table] = ()) -> str:
    """What the store shows above a sweep's runs, as Markdown.

    Its first line is all that is seen of it at first.

    Args:
        settings: of the sweep.
        short: what it has found so far, on that line.
        tables: of verdicts.
    """
    words = (
        f"+sweep={settings.sweep.name}"
        if settings.sweep.question
        else f"sweep.name={settings.sweep.name}"
    )
    place = f"data={settings.data.name} profile={settings.profile}"
    found = "".join(to_markdown(table) + "\n" for table in tables)
    head = f"**{settings.sweep.question or 'Trials started by hand.'}** {short}".rstrip()
    return (
        f"{head}\n\n{found}"
        f"Tables: `python -m fl3d tables {words} {place}`; gains with intervals: `python -m fl3d gains` with the same "
        "words. One run is one trial, and lies below its level; charts draw the mean over a level's seeds, and what "
        "several levels share once, by the first of them; the models *last* and *best* are what tables show. "
        f"Protocol {settings.protocol.id}."
    )


def announcement(settings: Settings, plan: Plan, layout: StoreFolder, slots: int) -> str:
    """What is said before a sweep starts."""
    if not plan.trials:
        return f"{settings.experiment}: trials are proposed one by one, {slots} stages at once"
    todo = [key for key in plan.stages if not layout.run(key).is_done]
    shared = f"{several(plan.epochs, 'epoch')} (without shared beginnings {plan.plain_epochs})"
    left = f"{several(len(todo), 'stage')} to train, {slots} at once"
    counts = f"{several(len(plan.trials), 'trial')} in {several(len(plan.stages), 'stage')}"
    return f"{settings.experiment}: {counts}, {shared}; {left if todo else 'everything is done'}"
