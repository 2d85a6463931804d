"""How much of a sweep is training: fl3d's scheduler beside Hydra's joblib launcher.

    python benchmarks/scheduler.py [--overrides profile=quick] [--without-joblib]

fl3d trains shared beginnings once and starts a stage when its parent is done. Hydra with the joblib
launcher (pip install hydra-joblib-launcher) runs each trial as one job, its stages in turn, as many
jobs at once as cores.

compute  = seconds that stages spent training, detecting and scoring, by their own clocks overhead =
CPU seconds of everything else (parent, starting of stages, recording in MLflow), in percent of
compute busy     = CPU seconds of all processes, in percent of cores times the command's whole time,
start and tables included
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.told import tell
from fl3d.config.compose import compose_config
from fl3d.config.settings import read_settings
from fl3d.sweep.prepare import prepare_data

CORES = len(os.sched_getaffinity(0))
PURPOSES = ("training", "detection", "scoring")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--overrides", nargs="*", default=["profile=quick"])
    parser.add_argument("--without-joblib", action="store_true")
    arguments = parser.parse_args()
    prepare_data(read_settings(compose_config(arguments.overrides)).data)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        ours = ["-m", "fl3d", "-m", "+sweep=gamma", *arguments.overrides]
        fl3d = measure(
            [sys.executable, *ours, f"store.root={work}/runs", f"results={work}/results"],
            work / "runs",
        )
        found = show("fl3d", fl3d)
        if not arguments.without_joblib:
            app = [
                sys.executable,
                str(Path(__file__).with_name("joblib_app.py")),
                "-m",
                *arguments.overrides,
            ]
            app += [
                "detector=fcn3d,voxelnet",
                "loss.gamma=0,0.1,0.2,0.5,1,2,5",
                f"+work={work}/joblib",
            ]
            app += [
                "hydra/sweeper=basic",
                "hydra/launcher=joblib",
                f"hydra.launcher.n_jobs={CORES}",
            ]
            joblib = measure(app, work / "joblib")
            show("hydra + joblib", joblib)
            print(f"time: {joblib['wall'] / fl3d['wall']:.2f} x fl3d's")
            found |= {"joblib / fl3d": joblib["wall"] / fl3d["wall"]}
    tell("scheduler", found)


def measure(command: list[str], root: Path) -> dict[str, float]:
    """Run a command to its end; its time, and what its stages and all its processes spent."""
    started = time.monotonic()
    before = machine_cpu()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    wall, cpu = time.monotonic() - started, machine_cpu() - before
    markers = [json.loads(path.read_text()) for path in root.rglob("checkpoints/*.json")]
    compute = sum(marker["seconds"][purpose] for marker in markers for purpose in PURPOSES)
    done = [json.loads(path.read_text()) for path in root.rglob("stages/*/done.json")]
    first, last = min(stage["started"] for stage in done), max(stage["ended"] for stage in done)
    return {
        "wall": wall,
        "cpu": cpu,
        "compute": compute,
        "stages": len(done),
        "training_wall": last - first,
    }


def machine_cpu() -> float:
    """CPU seconds of the whole machine so far; nothing else should run on it."""
    fields = Path("/proc/stat").read_text().splitlines()[0].split()[1:]
    user, nice, system = (int(field) for field in fields[:3])
    return (user + nice + system) / os.sysconf("SC_CLK_TCK")


def show(name: str, figures: dict[str, float]) -> dict[str, float]:
    """Print what was measured; the command's seconds, and two shares in percent."""
    busy = 100 * figures["cpu"] / (CORES * figures["wall"])
    while_training = 100 * figures["compute"] / (CORES * figures["training_wall"])
    overhead = 100 * (figures["cpu"] - figures["compute"]) / figures["compute"]
    print(
        f"{name}: {figures['stages']:.0f} stages in {figures['wall']:.0f} s, "
        f"compute {figures['compute']:.0f} s, "
        f"overhead {overhead:.1f} %, {CORES} cores {busy:.1f} % busy; "
        f"from the first stage's start to the last one's end "
        f"{while_training:.1f} % of their time was compute",
        flush=True,
    )
    return {"wall s": figures["wall"], "busy %": busy, "overhead %": overhead}


if __name__ == "__main__":
    main()
