"""``stage``: one stage, in this process."""

from __future__ import annotations

from pathlib import Path

from fl3d.commands.parsing import parser
from fl3d.core.loading import loading


def run(arguments: list[str]) -> None:
    """Train one planned stage from its folder, in this process.

    It is what launchers start; started like this, a debugger can follow it.
    """
    options = parser("stage", run.__doc__)
    options.add_argument("folder", type=Path, help="runs/stages/<key>")
    folder = options.parse_args(arguments).folder
    with loading():
        from fl3d.training.stage import run_stage

    run_stage(folder)
