"""``plan``: what a sweep would do."""

from __future__ import annotations

import argparse
import inspect
import math

from fl3d.commands.parsing import HELP, parser
from fl3d.core.errors import ConfigError
from fl3d.core.loading import loading

EXAMPLES = """\
How many seeds?
  plan +sweep=gamma seeds=5                            what five seeds cost, and the smallest gain they could tell
  plan +sweep=gamma seeds=5 --margin 0.5               how many seeds tell a gain of 0.5 AP, and what those cost
  plan +sweep=gamma seeds=5 --spread 0.9               the same before anything is trained, by a spread of your own

How much a gain differs between seeds is taken from trials of the sweep that are done, or from --spread; of three
seeds it is known to a factor of two or so. A gain is "told" if the sweep calls it better (or worse) with a chance of
four in five. The data need not be there: python -m fl3d plan +sweep=gamma data=kitti profile=paper
"""


def run(arguments: list[str]) -> None:
    """Show what a sweep would do, and train nothing.

    That is: its stages and what they share, what is done, time, FLOPs and disk, and the smallest gain that its seeds
    could tell. Without words: of +sweep=gamma.
    """
    options = parser("plan", inspect.cleandoc(run.__doc__ or ""))
    options.formatter_class = argparse.RawDescriptionHelpFormatter
    options.epilog = EXAMPLES
    options.add_argument("overrides", nargs="*", help=HELP)
    options.add_argument(
        "--spread", help="standard deviation of a gain between seeds, AP (default: of done trials)"
    )
    options.add_argument(
        "--margin", help="gain that the seeds are to tell, AP (default: sweep.margin)"
    )
    given = options.parse_intermixed_args(arguments)
    spread, margin = (_ap(name, getattr(given, name)) for name in ("spread", "margin"))
    with loading():
        from fl3d.config.compose import multirun
        from fl3d.config.objects import build
        from fl3d.sweep.by_hand import named
        from fl3d.sweep.preview import preview
        from fl3d.sweep.winners import with_winners

    asked = named(with_winners(multirun(given.overrides or ["+sweep=gamma"])))
    sweeper = build(asked.sweeper, "hydra.sweeper").proposer(asked.arguments, asked.compose)
    launcher = build(asked.launcher, "hydra.launcher")
    preview(sweeper, launcher, spread=spread, margin=margin)


def _ap(name: str, text: str | None) -> float | None:
    """A number of AP above 0, as given on the command line.

    Raises:
        ConfigError: it is none.
    """
    if text is None:
        return None
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not 0 < value <= 100:
        raise ConfigError(f"--{name} {text}: a number of AP above 0 and up to 100, such as 0.9")
    return value
