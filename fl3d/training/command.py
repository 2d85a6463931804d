"""A detector that another program trains: what its config says, and what of it makes a stage the stage it is. Pure.

``docs/command_detector.md`` tells what a stage needs of a detector, and how a command gives it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Any, ClassVar

from fl3d.core.errors import ConfigError, options
from fl3d.core.records import Config
from fl3d.training.templates import Line, check_names, names_in, value_text

TARGET = "fl3d.training.command.Command"
# Places that fl3d gives values itself; all others are keys of the config.
OWN_PLACES = {
    "folder": "the stage's own folder",
    "program": "program.folder",
    "python": "the Python that runs fl3d",
    "key": "the stage's own key, which no other has",
    "stage": "the stage's name",
    "data_root": "the KITTI folder",
    "train_split": "a file of the training frames' ids",
    "val_split": "a file of the validation frames' ids",
    "epochs": "epochs of this stage",
    "start_epoch": "epochs of the stages before it",
    "end_epoch": "epochs of all of them",
    "parent": "folder of the stage that it goes on from",
    "parent_checkpoint": "the last file of that stage that fits `checkpoint`",
    "checkpoint": "the last file of this stage that fits `checkpoint`; in `resume` alone",
    "resume": "what `resume` says, or nothing where there is nothing to go on from; in `run` alone",
    "from_parent": "what `from_parent` says, or nothing; in `run` alone",
}
ADDED = ("from_parent", "resume")  # behind `run`, or where it names them
PLACES_OF_RESULTS = ("epoch", "key", "stage", "folder", "program")
PARENTS = ("parent", "parent_checkpoint")
# What decides what is trained. The others say how it is watched, read and started again.
TRAINS = ("run", "from_parent", "cwd", "env")
READS = ("results", "first_epoch", "counts_on", "numbers_per_epoch")


@dataclass(frozen=True, kw_only=True)
class Command:
    """A detector whose stages are a command each, see ``conf/detector/command.yaml`` for the keys.

    Args:
        name: as tables write it.
        run: the command: a list of arguments, or a text for bash.
        from_parent: added to it where the stage goes on from another.
        resume: added to it where ``checkpoint`` fits a file that an interrupted start has left.
        checkpoint: pattern of the program's own checkpoints below the stage's folder; None: fl3d need not know.
        cwd: folder that it runs in.
        env: added to its environment.
        program: ``folder``, and ``files`` in it (patterns) that are its code; no files: what git says of the folder.
        results: pattern of the folders of result files below the stage's folder, with one ``{epoch}``.
        first_epoch: number that the program gives the first epoch.
        counts_on: whether its numbers go on from those of the stage before.
        numbers_per_epoch: how many of its numbers make an epoch: 1, or its steps where it counts steps.
        progress: regular expression over a line of its output with a group ``epoch``, and perhaps ``step`` and
            ``steps`` within it; other groups are losses. None: progress is told by result folders alone.
        settle_seconds: for which result files must not change before they are read.
        grace_seconds: between asking it to end and ending it.
        imported: whether its results were there before, and nothing is run.
    """

    VERSION: ClassVar[int] = 1  # raised when the same config would be run as another command

    name: str
    run: Line
    from_parent: Line = ()
    resume: Line = ()
    checkpoint: str | None = None
    cwd: str = "{folder}"
    env: Mapping[str, str] = field(default_factory=dict)
    program: Mapping[str, Any] = field(default_factory=dict)
    results: str
    first_epoch: int = 1
    counts_on: bool = False
    numbers_per_epoch: int = 1
    progress: str | None = None
    settle_seconds: float = 5.0
    grace_seconds: float = 10.0
    imported: bool = False

    def lines(self, has_parent: bool) -> dict[str, Line]:
        """The texts that decide what a stage trains, by their keys."""
        parts: dict[str, Line] = {"run": self.run, "cwd": self.cwd}
        parts |= {"from_parent": self.from_parent} if has_parent else {}
        return parts | {f"env.{name}": text for name, text in self.env.items()}

    def places(self, has_parent: bool) -> list[str]:
        """Names of all places in them."""
        found: dict[str, None] = {}
        for key, line in self.lines(has_parent).items():
            found |= dict.fromkeys(names_in(line, f"detector.{key}"))
        return list(found)

    def check(self, keys: Sequence[str], stage: str, has_parent: bool) -> None:
        """Refuse a command that cannot be started as this stage.

        Args:
            keys: of the stage's config, dotted.
            stage: its name.
            has_parent: whether it goes on from another.

        Raises:
            ConfigError: names the key, the place, and what is possible.
        """
        if not self.run:
            raise ConfigError(
                "detector.run: no command; give a list of arguments, such as "
                "[python, train.py, --gamma, '{loss.gamma}', --out, '{folder}'], or a text for bash"
            )
        own = [name for name in OWN_PLACES if has_parent or name not in PARENTS]
        lines = self.lines(has_parent)
        for key, line in lines.items():
            hidden = ("checkpoint",) if key == "run" else ("checkpoint", *ADDED)
            known = [name for name in own if name not in hidden]
            check_names(line, f"detector.{key}", known, keys)
        check_names(
            self.resume, "detector.resume", [name for name in own if name not in ADDED], keys
        )
        self._check_added(has_parent)
        check_names(
            self.checkpoint or "", "detector.checkpoint", ["key", "stage", "program", *keys]
        )
        check_names(self.results, "detector.results", PLACES_OF_RESULTS, keys)
        if names_in(self.results, "detector.results").count("epoch") != 1:
            raise ConfigError(
                f"detector.results: '{self.results}' has no {{epoch}}; it is the place of the number that tells the "
                "program's result folders apart, such as results/epoch_{epoch}/data"
            )
        self._check_checkpoint(has_parent)
        if has_parent and not set(PARENTS) & set(self.places(has_parent)):
            raise ConfigError(
                f"detector.from_parent: stage '{stage}' goes on from another, but its command has neither {{parent}} "
                "nor {parent_checkpoint}; say how the program takes that up, such as "
                "from_parent: [--init, '{parent}/last.pt'], or use a schedule of one stage (schedule=from_scratch)"
            )

    def named(self) -> list[str]:
        """Those of ``from_parent`` and ``resume`` whose place ``run`` itself says."""
        return [name for name in names_in(self.run, "detector.run") if name in ADDED]

    def _check_added(self, has_parent: bool) -> None:
        """Refuse a text of several lines that something is added to without saying where."""
        given = {"resume": self.resume, "from_parent": self.from_parent if has_parent else ()}
        if "resume" in self.named() and not self.resume:
            raise ConfigError("detector.resume: run has {resume}, and there is none; give it")
        if not isinstance(self.run, str) or "\n" not in self.run.strip():
            return
        for name, line in given.items():
            if line and name not in self.named():
                raise ConfigError(
                    f"detector.{name}: run is a text of several lines, and it is not known to which of its commands "
                    f"this is added; write {{{name}}} there"
                )

    def _check_checkpoint(self, has_parent: bool) -> None:
        needed = [*names_in(self.resume, "detector.resume"), *self.places(has_parent)]
        asked = [name for name in needed if name in ("checkpoint", "parent_checkpoint")]
        if asked and self.checkpoint is None:
            raise ConfigError(
                f"detector.checkpoint: {{{asked[0]}}} needs the pattern of the program's checkpoints below {{folder}}, "
                "such as ckpt/*.pth"
            )
        if self.resume and self.checkpoint is None:
            raise ConfigError(
                "detector.resume: it is added where detector.checkpoint fits a file; give that too, such as ckpt/*.pth"
            )


def is_command(config: Config) -> bool:
    """Whether a config's detector is trained by a command."""
    return bool(config.get("detector", {}).get("_target_") == TARGET)


def command_of(section: Mapping[str, Any]) -> Command:
    """The command that a ``detector`` section describes.

    Raises:
        ConfigError: a key that there is not, or one that is missing.
    """
    own = {key: value for key, value in section.items() if key not in ("_target_", "places")}
    known = [one.name for one in fields(Command)]
    for key in own:
        if key not in known:
            raise ConfigError(f"detector.{key}: no key of a command. {options(key, known)}")
    for key in ("name", "results", "program"):
        if not own.get(key):
            raise ConfigError(
                f"detector.{key}: not given; conf/detector/command.yaml says what it is"
            )
    lines = {key: _as_line(own.get(key), key) for key in ("run", "from_parent", "resume")}
    given = own.get("env") or {}
    if not isinstance(given, Mapping):
        raise ConfigError(f"detector.env: {given}, but it holds variables by name")
    env = {name: value_text(value) for name, value in given.items()}
    command = Command(**{**own, **lines, "env": env})
    for key in ("from_parent", "resume"):
        if isinstance(lines[key], str) and not isinstance(command.run, str):
            raise ConfigError(
                f"detector.{key}: run is a list of arguments, so that this must be one too"
            )
    return command


def _as_line(value: Any, key: str) -> Line:
    if value is None or isinstance(value, str):
        return value or ()
    if not isinstance(value, Sequence):
        raise ConfigError(
            f"detector.{key}: {value}, but it is a list of arguments, or a line for bash"
        )
    return [value_text(item) for item in value]


def places_of(config: Config) -> list[str]:
    """Keys of a trial's config that the command of any of its stages names, and what fl3d gives itself left out.

    Args:
        config: of a trial, whose stages may change the ``detector`` section.
    """
    found: dict[str, None] = {}
    for number, own in enumerate(_stages(config)):
        section = {**config["detector"], **(own.get("set") or {}).get("detector", {})}
        found |= dict.fromkeys(command_of(section).places(has_parent=number > 0))
    return [name for name in found if name not in OWN_PLACES]


def _stages(config: Config) -> list[Mapping[str, Any]]:
    return [own for own in config["schedule"]["stages"].values() if own is not None]


def trained_part(section: Mapping[str, Any]) -> Config:
    """What of a ``detector`` section decides what a stage trains: the command, and the program's digest."""
    kept = {key: section[key] for key in TRAINS if section.get(key)}
    return {**kept, "program": section["program"]["digest"]}


def reading_part(section: Mapping[str, Any]) -> Config:
    """What of it decides which files its checkpoints are read from; imported ones are known by their digest."""
    if section.get("imported"):
        return {}
    return {key: section[key] for key in READS if key in section}
