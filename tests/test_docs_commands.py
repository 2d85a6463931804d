"""Every command of README.md and docs/ runs, at tiny size: a page at a time, in one folder, as a shell runs it.

What is not run says why above its block. Here a command is what the page prints, but for its size: frames, epochs and
seeds are few, folders that a reader has are simulated ones, and a GPU is a CPU.
"""

import itertools
import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.documented import ALL, ROOT, Command
from tests.example_program import results

SECONDS = 1800
PLACE = "profile=tiny data.root=kitti data.generate=false data.cache_frames=10"
SHORT = "schedule.frames_per_epoch=2 schedule.epochs.warmup=1 schedule.epochs.scratch=1"
STUDY = "hydra.sweeper.n_trials=2"
# What a reader has, and what of it is too large: put in place of it before a command runs.
INSTEAD = (
    (r"^(\.venv/bin/)?python -m fl3d", "fl3d"),
    (r"/data/kitti|my/data|\bDATA\b|\bFOLDER\b", "kitti"),
    (r"my/clouds", "clouds"),
    (r"(?<=[ =])training/label_2|\bLABELS\b", "kitti/training/label_2"),
    (r"my/results|their/results|\bRESULTS\b|pointgnn/data", "theirs/0"),
    (r"=t0 ours=o0", "=theirs/0 ours=ours/0"),
    (r"ImageSets/val.txt", "kitti/ImageSets/val.txt"),
    (r"profile=(quick|paper|standard)", "profile=tiny"),
    (r"device=cuda", "device=cpu"),
    (r"--frames 700", "--frames 4 --val 2 --no-pictures"),
    (r"frames/training", "kitti/training"),
)
READ = ("gains", "tables", "figures", "report", "rescore", "why", "verify", "plan")
OURS = [one for one in ALL if not one.not_run and not one.run_by]


@pytest.fixture(scope="module")
def folder(simulated: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as a reader has it: frames, results of two detectors, and two sweeps that were run."""
    return made(simulated, tmp_path_factory.mktemp("docs"))


def made(simulated: Path, place: Path) -> Path:
    """Fill the folder."""
    shutil.copytree(simulated, place / "kitti")
    for name in ("train", "val"):
        text = (simulated / "ImageSets" / f"{name}.txt").read_text()
        (place / "kitti" / "ImageSets" / f"sample_{name}.txt").write_text(text)
    for name in ("docs", "examples", "tests"):
        (place / name).symlink_to(ROOT / name)
    relabel(place / "kitti")
    write_clouds(place)
    write_results(place)
    run(Command("", "fl3d -m +sweep=gamma seeds=1"), place)
    run(Command("", "fl3d -m detector=voxelnet loss.alpha=0.5,1,2 sweep.name=alpha"), place)
    return place


def relabel(kitti: Path) -> None:
    """Call some objects something else, so that in so few frames every class that a page names counts, in either split.

    The nearest person of a split is a cone: what is far away lies outside the protocol's area.
    """
    for split in ("train", "val"):
        names = itertools.cycle(("Cyclist", "Pedestrian"))
        frames = (kitti / "ImageSets" / f"{split}.txt").read_text().split()
        paths = [kitti / "training" / "label_2" / f"{frame}.txt" for frame in frames]
        texts = {path: path.read_text().splitlines() for path in paths}
        for lines in texts.values():
            cars = [n for n, line in enumerate(lines) if line.startswith("Car ")]
            for n in cars[1:]:
                lines[n] = lines[n].replace("Car", next(names), 1)
        people = [line for lines in texts.values() for line in lines if "Pedestrian" in line]
        cone = min(people, key=lambda line: float(line.split()[13]))
        for path, lines in texts.items():
            lines = [line.replace("Pedestrian", "Cone") if line == cone else line for line in lines]
            path.write_text("".join(f"{line}\n" for line in lines))


def write_clouds(place: Path) -> None:
    """Clouds in doubles, with reflectances of 0 to 255."""
    (place / "clouds").mkdir()
    for path in sorted((place / "kitti/training/velodyne").glob("*.bin"))[:2]:
        points = np.fromfile(path, np.float32).reshape(-1, 4).astype(np.float64)
        (points * [1, 1, 1, 255]).tofile(place / "clouds" / path.name)


def write_results(place: Path) -> None:
    """Result files: of two detectors with three runs each, and of the levels and seeds of a sweep."""
    labels = sorted((place / "kitti/training/label_2").glob("*.txt"))
    validation = (place / "kitti/ImageSets/val.txt").read_text().split()
    exp = "exp/gamma_{}/seed{}/epoch_5/data"
    runs = {f"{name}/{n}": (0.2 + n, labels) for name in ("theirs", "ours") for n in range(3)}
    split = [path for path in labels if path.stem in validation]
    runs |= {exp.format(level, n): (0.2 + level, split) for level in (0, 2) for n in range(3)}
    for name, (error, paths) in runs.items():
        (place / name).mkdir(parents=True)
        for path in paths:
            lines = path.read_text().splitlines()
            (place / name / path.name).write_text(results(lines, error, name + path.stem))


def small(line: str) -> str:
    """A command at tiny size."""
    for pattern, text in INSTEAD:
        line = re.sub(pattern, text, line)
    words = shlex.split(line)
    if words[0] != "fl3d":
        return line
    name = words[1]
    is_training = name.startswith("-") or "=" in name
    if name != "plan":
        line = re.sub(r"seeds=\d+", "seeds=1", line)
    if name in READ or is_training:
        line += f" {PLACE}"
    if "+sweep=gamma" in words and "detector=height_map" not in words:
        line += " loss.gamma=0,2"
    if is_training and "--cfg" not in words:
        line += f" {SHORT} workers=0"
    if "hydra/sweeper=optuna" in words:
        line += f" {STUDY}"
    if "hydra/sweeper=until_decided" in words:
        line += " hydra.sweeper.most=3"
    return line


def run(command: Command, place: Path) -> None:
    """Run a command as a shell would."""
    programs = place / "programs"
    if not programs.is_dir():
        programs.mkdir()
        for name, rest in (("python", ""), ("fl3d", "-m fl3d ")):
            (programs / name).write_text(f'#!/bin/sh\nexec {sys.executable} {rest}"$@"\n')
            (programs / name).chmod(0o755)
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "PATH": f"{programs}:{os.environ['PATH']}",
    }
    for line in command.fl3d or [command.line]:
        done = subprocess.run(
            ["bash", "-ec", small(line).replace("runs/stages/NAME", first_stage(place))],
            cwd=place,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
            timeout=SECONDS,
        )
        assert done.returncode == 0, f"{small(line)}\n{done.stdout[-2000:]}\n{done.stderr[-4000:]}"


def first_stage(place: Path) -> str:
    """The run folder of a trained stage, if there is one."""
    found = sorted((place / "runs" / "stages").glob("voxelnet-focal*"))
    return str(found[0]) if found else "runs/stages/NAME"


@pytest.mark.slow
@pytest.mark.parametrize("page", sorted({command.page for command in OURS}))
def test_the_commands_of_a_page_run(page: str, folder: Path) -> None:
    for command in OURS:
        if command.page == page:
            run(command, folder)
