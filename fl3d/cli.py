"""The command line: hands what was typed to the command that it names, and all else to Hydra's."""

from __future__ import annotations

import errno
import importlib
import os
import signal
import sys
from collections.abc import Sequence
from pathlib import Path

from fl3d.commands.parsing import COMMANDS, overview
from fl3d.config.places import search_also
from fl3d.config.seeds import spell_out_seeds
from fl3d.core import interrupts, streams
from fl3d.core.errors import (
    FAULTY,
    FULL,
    ConfigError,
    Fl3dError,
    StageFailed,
    TrainingError,
    Unwritable,
    options,
)
from fl3d.core.extras import lacking
from fl3d.core.loading import uncollected

# One thread a process: two processes of one thread are faster than one of two. The libraries read
# this when they are loaded, so it is set before any command is imported.
for _name in ("OMP_NUM_THREADS", "MKL_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

CONFIG_DIR = ("--config-dir", "-cd")
MISTAKE = 2  # exit code of what was asked or given wrongly, as argparse's own
FAILED = 1  # of what failed while it ran
FAILURES = (StageFailed, TrainingError)
# What the system refuses of a place that the user chose: it is full, read-only, somebody else's, or none.
REFUSALS = (
    *FULL,
    errno.EROFS,
    errno.EACCES,
    errno.EPERM,
    errno.ENOTDIR,
    errno.ENAMETOOLONG,
)
TRAIN = "train"  # what runs where no command is named
RESUMING = (TRAIN, "import", "simulate", "stage")  # what was interrupted goes on where it was
HELP = (["--help"], ["-h"])
# Hydra's options.
MULTIRUN = {"-m", "--multirun"}
LOOKS = {"--help", "-h", "--hydra-help", "--cfg", "-c", "--info", "-i"}  # nothing is trained


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command; what does not begin with the name of one trains a trial or a sweep.

    Args:
        arguments: as typed behind ``python -m fl3d``; None: those of this process.
    """
    typed = list(sys.argv[1:] if arguments is None else arguments)
    with interrupts.heard(), streams.kept() as printed:
        try:
            _run(typed)
        except SystemExit as end:  # argparse's, of --help or of a slip
            if end.code:
                raise
        if printed.lost is not None:
            raise ended(*streams.loss(printed.lost))


def _run(typed: list[str]) -> None:
    """Run a command; its errors become exits.

    Raises:
        SystemExit: it has failed, or was interrupted.
    """
    name = TRAIN
    try:
        typed = _with_config_dir(typed)
        if typed in HELP:  # of fl3d itself; Hydra's has its words
            print(overview())
            return
        name, rest = _split(typed)
        rest = _with_detectors(_with_seeds(name, rest))
        with uncollected():
            command = importlib.import_module(f"fl3d.commands.{name}")
        command.run(rest)  # which loads what it computes with
    except Fl3dError as error:
        raise ended(f"fl3d: {error}", FAILED if isinstance(error, FAILURES) else MISTAKE) from None
    except ModuleNotFoundError as error:
        why = lacking(error)
        if why is None:
            raise
        raise ended(f"fl3d: {name} {why}", MISTAKE) from None
    except KeyboardInterrupt as error:
        number = error.number if isinstance(error, interrupts.Interrupted) else signal.SIGINT
        again = "run the same command " + ("to resume" if name in RESUMING else "again")
        lead = "\n" if streams.is_terminal(sys.stderr) else ""  # below what it shows of Ctrl-C
        said = lead + interrupts.text(number, again)
        raise ended(said, interrupts.code(number)) from None
    except OSError as error:
        if error.errno not in (*REFUSALS, *FAULTY):
            raise
        place = error.filename or "a file"
        if error.errno in FAULTY:
            said = f"{place}: {error.strerror}; when the disk answers again, run the same command again"
            raise ended(f"fl3d: {said}", FAILED) from None
        if error.errno in FULL:
            said = str(Unwritable(error.errno, error.strerror, place))
        else:
            said = f"{place}: {error.strerror}"
        raise ended(f"fl3d: {said}", MISTAKE) from None


def _with_config_dir(typed: list[str]) -> list[str]:
    """The arguments without ``--config-dir FOLDER``, which any command may have: the user's own YAMLs and modules.

    Raises:
        ConfigError: it names no folder, or there are two.
    """
    rest: list[str] = []
    words = iter(typed)
    given = ""
    for word in words:
        option, _, folder = word.partition("=")
        if option not in CONFIG_DIR:
            rest.append(word)
            continue
        folder = folder or next(words, "")
        if not folder:
            raise ConfigError(
                f"{word}: which folder? It holds your own detector/NAME.yaml and the like"
            )
        if given:
            raise ConfigError(f"--config-dir {given} and {folder}: one folder alone can be given")
        given = folder
        search_also(Path(folder))
    return rest


def ended(message: str, code: int) -> SystemExit:
    """An exit that says its message on the error stream, if there is one, and has a code of its own."""
    if message:
        print(message, file=sys.stderr)
    error = SystemExit(message)
    error.code = code
    return error


def _split(typed: list[str]) -> tuple[str, list[str]]:
    """The command's name, and its arguments.

    Raises:
        ConfigError: the first word is no command, and nothing that Hydra reads.
    """
    if not typed:
        return TRAIN, typed
    first = typed[0]
    if first in COMMANDS:
        return first, typed[1:]
    is_hydras = first.startswith(("-", "~")) or "=" in first
    if not is_hydras:
        raise ConfigError(
            f"'{first}' is neither KEY=VALUE nor a command. {options(first, COMMANDS)}"
        )
    return TRAIN, typed


def _with_detectors(rest: list[str]) -> list[str]:
    """The arguments with ``detector=3D-FCN``, as tables write it, as the config's ``detector=fcn3d``."""
    if not any(word.startswith("detector=") for word in rest):
        return rest
    names = importlib.import_module("fl3d.config.detector_names")  # late: it brings Hydra along
    return list(names.spell_out_detectors(rest))


def _with_seeds(name: str, rest: list[str]) -> list[str]:
    """The arguments with ``seeds=5`` spelled out, for whatever command.

    Raises:
        ConfigError: seeds that cannot be told, or of a single trial.
    """
    spelled = spell_out_seeds(rest)
    if name != TRAIN or spelled == rest:
        return spelled
    if LOOKS & set(rest):  # at the config of one trial
        return [word for word in rest if word in spelled]
    if not MULTIRUN & set(rest):
        raise ConfigError(
            "seeds=... trains a trial for each seed, which is a sweep: python -m fl3d -m ...; "
            "a single trial has one, such as seed=3"
        )
    return spelled
