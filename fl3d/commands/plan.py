"""``plan``: what a sweep would do."""

from __future__ import annotations

from fl3d.commands.words import HELP, parser
from fl3d.config.compose import multirun
from fl3d.config.objects import build
from fl3d.sweep.preview import preview
from fl3d.sweep.winners import with_winners


def run(arguments: list[str]) -> None:
    """Show what a sweep would do, and train nothing.

    That is: its stages and what they share, what is done, time, FLOPs and disk. Without words: of
    +sweep=gamma.
    """
    options = parser("plan", run.__doc__)
    options.add_argument("overrides", nargs="*", help=HELP)
    overrides = options.parse_intermixed_args(arguments).overrides
    asked = with_winners(multirun(overrides or ["+sweep=gamma"]))
    sweeper = build(asked.sweeper, "hydra.sweeper").proposer(asked.arguments, asked.compose)
    launcher = build(asked.launcher, "hydra.launcher")
    preview(sweeper, launcher)
