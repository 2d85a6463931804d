"""Whether what is published is still what the code makes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

from fl3d.api.words import Words, read_words
from fl3d.config.objects import build
from fl3d.config.settings import read_settings
from fl3d.papers.published import words_of
from fl3d.papers.stamp import read_stamp
from fl3d.runs.plans import read_plan
from fl3d.runs.scores import score_file
from fl3d.sweep.plan import DataInfo
from fl3d.sweep.planner import Planner
from fl3d.sweep.winners import with_winners

NO_STORE = ".no_store"  # a folder that is nowhere: what is published is read, and no store


def outdated(folder: Path, names: Iterable[str]) -> list[str]:
    """Those of some sweeps of a folder that the code plans or scores differently today."""
    stamp = read_stamp(folder)
    found = []
    for name in names:
        file = score_file(folder, name).with_suffix(".json")
        published = [trial.key for trial in read_plan(file).trials]
        if (published, stamp["sweeps"][name]["protocol"]) != planned_today(folder, name):
            found.append(name)
    return found


def planned_today(folder: Path, name: str) -> tuple[list[str], str]:
    """What the code makes today of a published sweep: the keys of its trials, and its protocol.

    Planned on the data that the folder's stamp names, which need not be here, and with the winners of what the folder
    holds.

    Args:
        folder: ``DATA-PROFILE``, of published results.
        name: of the sweep.
    """
    places = [f"store.root={folder.parent / NO_STORE}", f"results={folder.parent}"]
    multirun = with_winners(words_in(folder, name, places).multirun, lambda line: None)
    sweeper = build(multirun.sweeper, "hydra.sweeper").proposer(
        multirun.arguments, multirun.compose
    )
    settings = read_settings(sweeper.base)
    own = read_stamp(folder)["data"]
    info = DataInfo(own["digest"], own["train_frames"], own["image_digest"])
    plan = Planner(sweeper.base, settings, sweeper.swept, info).plan(sweeper.first())
    return [trial.key for trial in plan.trials], settings.protocol.id


def words_in(folder: Path, name: str, words: Sequence[str]) -> Words:
    """What the words of a published sweep mean in a folder, whatever data the sweep's file names."""
    data, _, profile = folder.name.rpartition("-")
    places = [word for word in words if word.partition("=")[0] not in ("data", "profile")]
    return read_words(words_of(name, [*places, f"data={data}", f"profile={profile}"]))
