"""How commands read their arguments. Light: `--help` loads this and nothing that computes."""

from __future__ import annotations

import argparse

from fl3d.config.places import options_of

HELP = "as the sweep was started, such as +sweep=gamma data=kitti seeds=3"

# Each is a file in fl3d/commands; what it does.
COMMANDS = {
    "simulate": "write a KITTI folder of simulated frames",
    "check": "look through a KITTI-format folder before anything is trained",
    "evaluate": "KITTI's official numbers of anybody's result files",
    "compare": "whether a detector is better than another, by result files that any code wrote",
    "plan": "what a sweep would do, share, take and write, and what its seeds could tell",
    "gains": "what a sweep has found: better, worse, equivalent or undecided",
    "tables": "a sweep's tables again, with intervals, beside the published ones",
    "figures": "a sweep's figures",
    "report": "tables, figures and claims on one page",
    "why": "where a cell of a table comes from",
    "rescore": "AP by level and score cut, from stored detections",
    "verify": "score stored detections again, and compare",
    "predict": "a trained detector on anybody's clouds",
    "import": "results of other training code as a sweep",
    "ui": "browse every checkpoint in MLflow",
    "clean": "remove what no sweep needs any more",
    "publish": "make the results anew that the project publishes",
    "stage": "train one stage; launchers call it",
}
OVERVIEW = """\
fl3d: find out whether a loss or a hyper-parameter really makes a 3D object detector better.

Train one trial        python -m fl3d detector=voxelnet loss.gamma=2
Sweep by hand          python -m fl3d -m detector=voxelnet loss.gamma=0,1,2 seeds=3
... what it gained     python -m fl3d gains detector=voxelnet loss.gamma=0,1,2 seeds=3
Run a sweep file       python -m fl3d -m +sweep=gamma
... of five seeds      python -m fl3d -m +sweep=gamma seeds=5
... see it beforehand  python -m fl3d plan +sweep=gamma
... on KITTI           python -m fl3d -m +sweep=gamma data=kitti data.root=FOLDER profile=paper device=cuda
Other classes          python -m fl3d detector=voxelnet 'classes=[Pedestrian,Cyclist]'
Search with Optuna     python -m fl3d -m hydra/sweeper=optuna 'loss.gamma=interval(0,5)'
Every key of a trial   python -m fl3d detector=voxelnet --cfg job
... and all groups     python -m fl3d detector=voxelnet --help
Your own YAMLs         python -m fl3d ... --config-dir FOLDER
Complete words         eval "$(fl3d -sc install=bash)"

Commands (python -m fl3d COMMAND --help):
"""
GROUPS = ("sweep", "data", "detector", "loss", "schedule", "protocol", "profile")


def overview() -> str:
    """What fl3d can be asked: ways to train, commands, and what can be chosen of each group."""
    wide = max(map(len, COMMANDS))
    commands = [f"  {name:{wide}}  {text}" for name, text in COMMANDS.items()]
    groups = [f"  {name:{wide}}  {', '.join(options_of(name))}" for name in GROUPS]
    chosen = ["", "Groups (GROUP=OPTION; +sweep=NAME):", *groups]
    return OVERVIEW + "\n".join([*commands, *chosen])


def parser(name: str, description: str | None, example: str = "") -> argparse.ArgumentParser:
    """An argument parser of a command.

    Args:
        name: of the command.
        description: what it does.
        example: words behind its name, shown below its options; empty: none.
    """
    prog = f"python -m fl3d {name}"
    epilog = f"example: {prog} {example}" if example else None
    return argparse.ArgumentParser(prog=prog, description=description, epilog=epilog)


def protocol_names() -> list[str]:
    """fl3d's own protocols, and those of the user's ``--config-dir``."""
    return options_of("protocol")
