"""``publish``: make the results that the project publishes."""

from __future__ import annotations

from fl3d.commands.parsing import parser
from fl3d.core.errors import ConfigError, options
from fl3d.core.loading import loading
from fl3d.papers.published import SWEEPS


def run(arguments: list[str]) -> None:
    """Make results/DATA-PROFILE anew: train or reuse every published sweep, tabulate, draw, and stamp the folder.

    What is published stays as it is until all of the new is there, and where anything fails.

    --only renews some sweeps and leaves the others of the folder as they are. Those that the code plans differently
    today cannot be left, nor any beside sweeps on other data: this is looked at before anything is trained.

    A sweep whose file names its data (people's) has its own folder, unless data=... is given for all.

    Only this command writes there; everybody's own runs write to out/. What is committed stays small: no page, and
    figures as PNG with their data alone.
    """
    arguments_of = parser("publish", run.__doc__)
    arguments_of.add_argument(
        "overrides", nargs="*", help="where: data=..., profile=..., store.root=..."
    )
    arguments_of.add_argument(
        "--only",
        nargs="+",
        metavar="SWEEP",
        help=f"renew these alone, some of: {', '.join(SWEEPS)}",
    )
    given = arguments_of.parse_intermixed_args(arguments)
    only = given.only or ()  # which takes all that comes behind it: words of config too
    names = [word for word in only if "=" not in word]
    words = [*given.overrides, *(word for word in only if "=" in word)]
    for name in names:
        if name not in SWEEPS:
            raise ConfigError(f"--only {name}: {options(name, SWEEPS)}")
    if only and not names:
        raise ConfigError(f"--only: names no sweep; it can be {', '.join(SWEEPS)}")
    with loading():
        from fl3d.api.publishing import publish

    *folders, index = publish(names or SWEEPS, words)
    print(f"Written to {', '.join(map(str, folders))}; {index}.")
