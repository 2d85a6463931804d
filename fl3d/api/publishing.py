"""Make the results that the project publishes: all of them are there before any takes its place."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterable, Mapping, Sequence
from pathlib import Path

from fl3d.api.standing import Standing, find_standing
from fl3d.api.training import train_sweep
from fl3d.api.words import Words, open_words, read_words
from fl3d.config.objects import build
from fl3d.config.places import PUBLISHED
from fl3d.core.errors import ConfigError, StoreError
from fl3d.core.files import swap_folder
from fl3d.core.leases import leased, living
from fl3d.core.provenance import provenance
from fl3d.core.shipped import is_checkout
from fl3d.papers.folder import add_results
from fl3d.papers.index import write_index
from fl3d.papers.published import SWEEPS, words_of
from fl3d.papers.stamp import origin, write_stamp
from fl3d.runs.finished import FinishedSweep
from fl3d.runs.layout import StoreFolder
from fl3d.runs.opening import open_sweep
from fl3d.store.opening import open_store
from fl3d.sweep.prepare import prepare_data

MAKING = ".making"  # beside the published folders: those that are being made


def publish(names: Collection[str], words: Sequence[str]) -> list[Path]:
    """Make some published sweeps anew; the others of their results folders are left as they are.

    Args:
        names: of the sweeps.
        words: that say where they lie.

    Returns:
        the folders, and the index of all.

    Raises:
        ConfigError: this is no checkout of fl3d's repository, or it has uncommitted changes.
        StoreError: a sweep could not be run to its end, or what is left of a folder is no longer true beside those
            made anew; what was published is as it was.
    """
    made_by = _clean_commit()
    making = PUBLISHED / MAKING
    words = [*words, f"results={making}"]
    with leased(making / "publish.lease", wait=False):
        try:
            for abandoned in making.glob("*/"):  # by a process that was killed
                shutil.rmtree(abandoned)
            asked = read_sweeps(names, words)
            folders = by_folder(asked)
            standing = {
                folder: find_standing(PUBLISHED / folder.name, own, words)
                for folder, own in folders.items()
            }
            for left in standing.values():
                if left.sweeps:
                    print(f"{left.folder} keeps as published: {', '.join(left.origins)}")
            check_ready(asked, words, standing.values())
            make(folders, standing, made_by)
            for folder in folders:
                swap_folder(folder, PUBLISHED / folder.name)
        finally:
            shutil.rmtree(making, ignore_errors=True)
    return [*(PUBLISHED / folder.name for folder in folders), write_index(PUBLISHED)]


def _clean_commit() -> dict[str, str]:
    """Where the results come from: a commit of fl3d's repository.

    Raises:
        ConfigError: there is none, or it is not what runs.
    """
    if not is_checkout():
        raise ConfigError(
            "publish: makes results/ of fl3d's repository anew, which is not here; your own tables are made by tables"
        )
    made_by = provenance()
    if made_by.get("fl3d.dirty") == "true":
        raise ConfigError(
            "publish: there are uncommitted changes; commit them first, for the stamp names the commit"
        )
    return made_by


def read_sweeps(names: Collection[str], words: Sequence[str]) -> dict[str, Words]:
    """What the words of some published sweeps mean, by name and in the order of ``SWEEPS``."""
    return {name: read_words(words_of(name, words)) for name in SWEEPS if name in names}


def by_folder(asked: Mapping[str, Words]) -> dict[Path, dict[str, Words]]:
    """Some sweeps by the results folder that each is published in, in their order."""
    folders: dict[Path, dict[str, Words]] = {}
    for name, one in asked.items():
        folders.setdefault(one.settings.results_folder, {})[name] = one
    return folders


def check_ready(
    asked: Mapping[str, Words], words: Sequence[str], standing: Iterable[Standing]
) -> None:
    """Find now what would stop the publishing of some sweeps after hours.

    Args:
        asked: the sweeps by name, in the order in which they are run.
        words: that say where they lie.
        standing: what is left of their folders, whose winners may be kept.

    Raises:
        StoreError: a sweep is being run, the store cannot be reached, or an earlier sweep whose winner one keeps is
            neither there nor asked for.
    """
    left = {sweep.name for one in standing for sweep in one.sweeps}
    before: set[str] = set()
    for name, one in asked.items():
        after = one.settings.sweep.after
        while after is not None and after not in before:
            earlier = read_words(words_of(after, words)).settings
            _check_finished(open_sweep(earlier, None, PUBLISHED if after in left else None))
            after = earlier.sweep.after
        before.add(name)
    settings = [one.settings for one in asked.values()]
    leases = {StoreFolder(one.store.root).lease(one.experiment): one.experiment for one in settings}
    for lease, holder in living(leases).items():
        raise StoreError(f"{leases[lease]}: is being run by {holder}; wait for it or end it")
    for root, uri in {(one.store.root, one.store.uri) for one in settings}:
        open_store(root, uri).open()


def _check_finished(sweep: FinishedSweep) -> None:
    done, planned = len(sweep.trials), len(sweep.plan.trials)
    if done < planned:
        raise StoreError(
            f"{sweep.name}: {done} of {planned} trials are done; nothing is published before all are"
        )


def make(
    folders: Mapping[Path, Mapping[str, Words]],
    standing: Mapping[Path, Standing],
    made_by: Mapping[str, str],
) -> None:
    """Train or reuse the sweeps of some results folders, then fill the folders.

    Args:
        folders: sweeps by folder and name.
        standing: what is left of each folder.
        made_by: see ``core.provenance.provenance``.

    Raises:
        StoreError: a sweep could not be run to its end, or what is left is no longer true.
    """
    sweeps = {folder: [trained(one) for one in asked.values()] for folder, asked in folders.items()}
    for folder, own in sweeps.items():
        shutil.rmtree(folder, ignore_errors=True)  # what each sweep wrote when it ended
        left = standing[folder]
        left.copy(folder)
        every = sorted([*own, *left.sweeps], key=lambda sweep: sweep.name)
        origins = {
            sweep.name: origin(sweep, made_by, add_results(sweep, every, folder)) for sweep in own
        }
        write_stamp(folder, prepare_data(own[0].settings.data), left.origins | origins)
        left.check(folder)


def trained(asked: Words) -> FinishedSweep:
    """A sweep, trained or reused.

    Raises:
        StoreError: it could not be run to its end.
    """
    train_sweep(asked.multirun, build(asked.multirun.sweeper, "hydra.sweeper"), _say)
    sweep = open_words(asked)
    _check_finished(sweep)
    return sweep


def _say(line: str) -> None:
    """Print what a sweep says, but for where it wrote: into a folder that will have moved."""
    if not line.startswith("Written to"):
        print(line)
