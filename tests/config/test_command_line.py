"""Hydra's options: what fl3d hands on, in which order, and what it refuses in a sentence."""

import contextlib
import io
from collections.abc import Sequence

import pytest

from fl3d.cli import MISTAKE, main
from fl3d.config.command_line import read_line
from fl3d.core.errors import ConfigError


def said(arguments: Sequence[str]) -> str:
    """What a command line prints that trains nothing."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        main(arguments)
    return out.getvalue()


@pytest.mark.parametrize(
    ("arguments", "options", "overrides"),
    [
        (["a=1", "-m", "b=1,2"], ("--multirun",), ("a=1", "b=1,2")),
        (
            ["-c", "job", "a=1", "-p", "loss", "~b"],
            ("--cfg", "job", "--package", "loss"),
            ("a=1", "~b"),
        ),
        (["--cfg=all", "--resolve"], ("--resolve", "--cfg", "all"), ()),
        (["--info", "config", "a=1"], ("--info", "config"), ("a=1",)),
        (["a=1", "-i"], ("--info", "all"), ("a=1",)),
        (["-sc", "install=bash"], ("--shell-completion",), ("install=bash",)),
        (["-h", "a=1"], ("--help",), ("a=1",)),
        (["--hydra-help"], ("--hydra-help",), ()),
    ],
    ids=lambda value: " ".join(value),
)
def test_options_and_overrides_are_told_apart_wherever_they_stand(
    arguments: list[str], options: tuple[str, ...], overrides: tuple[str, ...]
) -> None:
    line = read_line(arguments)
    assert (line.options, line.overrides) == (options, overrides)


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--cfg", "all", "-m"], "--cfg shows the config of one trial: leave -m"),
        (["--cfg=all", "-m"], "--cfg shows the config of one trial: leave -m"),
        (["--run", "-m"], "--run and --multirun: one of them alone"),
        (["--info", "-m"], "--multirun and --info: one of them alone"),
        (["-p", "loss"], "--package loss: which part --cfg job shows; give both"),
        (["--resolve"], "--resolve: how --cfg job shows a config"),
        (["--cfg", "jobs"], "invalid choice: 'jobs' .choose from 'job', 'hydra', 'all'"),
        (["--cfg"], "expected one argument"),
        (["--info", "foo"], "invalid choice: 'foo'"),
        (["-x"], "unrecognized arguments: -x"),
        (["-cn", "mine"], "--config-dir FOLDER"),
        (["-cp", "conf"], "--config-dir FOLDER"),
        (["--experimental-rerun", "job.pickle"], "the same words again resume"),
        (["-sc"], "--shell-completion nothing: Possible: install=bash"),
        (["-sc", "install=cmd"], "Possible: install=bash, install=fish, install=zsh"),
        (["-sc", "query=bash"], "COMP_LINE is not set"),
        (["-m", "tables"], "'tables' is neither KEY=VALUE nor a command"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_options_that_do_not_go_together_are_refused(
    arguments: list[str], says: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("COMP_LINE", raising=False)
    with pytest.raises(ConfigError, match=says):
        read_line(arguments)


def test_slips_in_options_end_in_one_line_with_the_code_of_a_mistake(
    capsys: pytest.CaptureFixture[str],
) -> None:
    for arguments in (["-x"], ["loss.gamma=1,2"], ["--cfg", "job", "--resolve", "seed=${no}"]):
        with pytest.raises(SystemExit) as ended:
            main(arguments)
        assert ended.value.code == MISTAKE
        told = capsys.readouterr().err
        assert told.startswith("fl3d: ")
        assert told.count("\n") == 1


def test_several_values_of_one_trial_are_told_how_to_be_typed() -> None:
    with pytest.raises(
        SystemExit, match=r"python -m fl3d -m .*loss.gamma=\[...\].*'loss.gamma=\"1,2\"'"
    ):
        main(["loss.gamma=1,2"])


def test_a_shell_learns_to_complete_the_installed_command(monkeypatch: pytest.MonkeyPatch) -> None:
    """Shells complete by a command's first word, which of ``python -m fl3d`` is python."""
    assert said(["-sc", "install=bash"]).rstrip().endswith("hydra_bash_completion fl3d")
    monkeypatch.setenv("COMP_LINE", "fl3d detector=p")
    assert said(["-sc", "query=bash"]).split() == ["detector=pointrcnn"]


def test_what_hydra_shows_is_shown() -> None:
    assert "gamma: 2" in said(["--cfg", "job", "-p", "loss", "loss.gamma=2"])
    assert "Config search path" in said(["--info", "searchpath"])
    assert "- override hydra/sweeper" not in said(["loss=null", "--info", "defaults"])
