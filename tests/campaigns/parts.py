"""The sweeps that are disturbed: small ones of every kind, each seconds long where nobody disturbs it."""

from __future__ import annotations

import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from tests import example_program
from tests.campaigns.starts import Start

TRAIN, VAL = 8, 12  # frames of the set that most of them share
PROGRAM = Path(example_program.__file__)
RUN = [
    *("{python}", "{program}/example_program.py", "--data={data_root}", "--val={val_split}"),
    *("--out={folder}", "--epochs={epochs}", "--gamma={loss.gamma}", "--seed={seed}"),
]


@dataclass(frozen=True)
class Part:
    """One kind of sweep.

    Args:
        name: of it.
        words: behind ``python -m fl3d``; the places of store and results are added.
        victims: what is killed.
        aims: phases to wait for.
        before: brings about what it needs, given the folder that parts share and its own.
        server: whether its scores go to an MLflow server.
        differs: parts of names of result files that may differ: a study numbers the trials that were killed, too.
    """

    name: str
    words: tuple[str, ...]
    victims: tuple[str, ...]
    aims: tuple[str, ...]
    before: Callable[[Path, Path], None] = lambda shared, work: None
    server: bool = False
    differs: tuple[str, ...] = ()

    def command(self, shared: Path, work: Path) -> list[str]:
        """Its words with all places filled in."""
        places = [f"store.root={work / 'runs'}", f"results={work / 'results'}"]
        filled = [word.format(shared=shared, work=work) for word in self.words]
        return [*filled, *places]


SMALL = (
    *("profile=tiny", "data.generate=false", "data.root={shared}/data"),
    *("schedule.frames_per_epoch=8", "schedule.epochs.warmup=2", "schedule.epochs.focal=2"),
)
OWN = (
    *("--config-dir", "{shared}/own", "detector=fake", *SMALL[:3]),
    *("schedule.epochs.warmup=2", "schedule.epochs.focal=1"),
)
ALL = ("planning", "opening", "training", "detecting", "scoring", "recording", "closing")
INLINE = ("hydra/launcher=inline",)
COMMAND = tuple(name for name in ALL if name != "detecting")

PARTS = (
    Part(
        "replicates",
        ("-m", "detector=fcn3d", "loss.gamma=0,2", "seeds=3", "sweep.name=grid", *SMALL),
        ("worker", "server", "parent", "all"),
        ALL,
    ),
    Part(
        "simulated",
        (
            *("-m", "detector=fcn3d", "loss.gamma=0,2", "sweep.name=simulated", "profile=tiny"),
            *("data.root={work}/data", "data.train_frames=26", "data.val_frames=14"),
            *("schedule.frames_per_epoch=8", "schedule.epochs.warmup=1", "schedule.epochs.focal=1"),
            *INLINE,
        ),
        ("worker", "server", "parent", "all"),
        ("simulating", "simulating", "planning", "opening", "training", "detecting"),
    ),
    Part(
        "command",
        ("-m", "sweep.name=command", "loss.gamma=0,2", "seeds=2", *OWN),
        ("worker", "server", "program", "guard", "parent", "all"),
        COMMAND,
    ),
    Part(
        "until_decided",
        (
            *("-m", "sweep.name=until", "loss.gamma=0,2", "hydra/sweeper=until_decided"),
            *("hydra.sweeper.most=5", *INLINE, *OWN),
        ),
        ("program", "parent", "all"),
        COMMAND,
    ),
    Part(
        "study",
        (
            *("-m", "sweep.name=study", "loss.gamma=interval(0,5)", "hydra/sweeper=optuna"),
            *(
                "hydra.sweeper.n_trials=4",
                "hydra.sweeper.sampler._target_=optuna.samplers.QMCSampler",
            ),
            *(
                "hydra.sweeper.enqueue=[{{loss.gamma:0}},{{loss.gamma:1}},{{loss.gamma:2}},{{loss.gamma:3}}]",
            ),
            *("hydra.launcher.slots=1", "sweep.baseline=0", *OWN),
        ),
        ("worker", "server", "parent", "all"),
        COMMAND,
        differs=("tables/study_", "scores/study.json"),
    ),
    Part(
        "import",
        (
            *(
                "import",
                "{shared}/exp/{{level}}/seed{{seed}}/epoch_{{epoch}}/data",
                "--factor",
                "gamma",
            ),
            *("sweep.name=theirs", *SMALL[:3]),
        ),
        ("parent", "all"),
        ("planning", "opening", "scoring", "recording", "closing"),
    ),
    Part(
        "mlflow_server",
        ("-m", "sweep.name=served", "loss.gamma=0,2", "store.uri=URI", *INLINE, *OWN),
        ("mlflow", "parent", "all"),
        ("opening", "recording", "training", "closing"),
        server=True,
    ),
)


def share(shared: Path) -> None:
    """Write what all parts need: frames, a detector of the user's own, results of somebody's."""
    shared.mkdir(parents=True, exist_ok=True)
    words = ["simulate", str(shared / "made"), "--frames", str(TRAIN + VAL), "--seed", "3"]
    made = Start(words, shared / "log.txt")
    if not made.wait(600) or made.code:
        raise RuntimeError(made.said())
    (folder,) = (path.parent for path in (shared / "made").rglob("training"))
    folder.rename(shared / "data")
    ids = [f"{number:06d}" for number in range(TRAIN + VAL)]
    for name, own in (("train", ids[:TRAIN]), ("val", ids[TRAIN:])):
        (shared / "data" / "ImageSets" / f"{name}.txt").write_text("\n".join(own) + "\n")
    _own_detector(shared / "own")
    _results(shared / "exp", shared / "data", ids[TRAIN:])


def _own_detector(folder: Path) -> None:
    (folder / "detector").mkdir(parents=True)
    section = {
        "name": "Fake",
        "run": [*RUN, "--slow=0.3"],
        "from_parent": ["--init={parent}/last.json"],
        "program": {"folder": str(PROGRAM.parent), "files": [PROGRAM.name]},
        "results": "results/epoch_{epoch}/data",
        "settle_seconds": 0.2,
        "grace_seconds": 2,
    }
    content = {
        "defaults": ["command", {"override /schedule": "two_phase"}, "_self_"],
        "detector": section,
        "loss": {"gamma": 0.0},
        "schedule": {"epochs": {"warmup": 2, "focal": 2}},
    }
    text = "# @package _global_\n" + yaml.safe_dump(content, sort_keys=False)
    (folder / "detector" / "fake.yaml").write_text(text)


def _results(folder: Path, data: Path, ids: Sequence[str]) -> None:
    for level in ("0", "0.5", "1"):
        for seed in range(3):
            own = folder / level / f"seed{seed}" / "epoch_5" / "data"
            own.mkdir(parents=True)
            for name in ids:
                labels = (data / "training" / "label_2" / f"{name}.txt").read_text().splitlines()
                shift = 0.2 + float(level)
                text = example_program.results(labels, shift, f"{seed} {name}")
                (own / f"{name}.txt").write_text(text)


def forget(work: Path) -> None:
    """Remove what a sweep has made, so that it starts afresh."""
    for name in ("runs", "results", "data", "mlflow"):
        shutil.rmtree(work / name, ignore_errors=True)
