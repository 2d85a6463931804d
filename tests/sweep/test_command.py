"""A stage that is a command: planned, run, scored, ended, resumed and refused, by a program of the tests' own."""

import contextlib
import json
import os
import re
import signal
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml

import tests.example_program
from fl3d.config.compose import compose_config
from fl3d.config.places import search_also
from fl3d.core.errors import ConfigError, StageFailed
from fl3d.core.leases import holder_of, leased
from fl3d.evaluation.detections import read_detections
from fl3d.evaluation.results import Results, results_digest
from fl3d.runs.checkpoints import read_marker
from fl3d.runs.layout import RunFolder
from fl3d.runs.spec import Spec, read_spec, write_spec
from fl3d.sweep.cost import Costs
from fl3d.sweep.launchers.local import LocalLauncher
from fl3d.sweep.plan import Plan
from fl3d.sweep.progress import Progress
from fl3d.sweep.setup import Prepared, machine, prepare_sweep
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training import guard
from fl3d.training.command_run import CommandRun
from fl3d.training.process import read_exits, wait_for_earlier
from tests.support import run_small

PROGRAM = Path(tests.example_program.__file__)
RUN = [
    *("{python}", "{program}/example_program.py", "--data={data_root}", "--val={val_split}"),
    *("--out={folder}", "--epochs={epochs}", "--gamma={loss.gamma}", "--seed={seed}"),
]
EXTRA: dict[str, object] = {"note": "", "flags": []}  # keys that some tests' commands read
Make = Callable[..., Prepared]


@pytest.fixture
def make(simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    """A sweep over a detector of the user's own; keys of its ``detector`` section may be given."""
    monkeypatch.setattr("fl3d.config.places._OWN", [])
    monkeypatch.syspath_prepend(str(tmp_path))
    own = tmp_path / "own"
    (own / "detector").mkdir(parents=True)
    search_also(own)

    def made(
        points: list[list[str]] = [["loss.gamma=0"], ["loss.gamma=2"]],  # noqa: B006
        *words: str,
        schedule: str = "two_phase",
        **section: object,
    ) -> Prepared:
        detector = {
            "name": "Fake",
            "run": RUN,
            "from_parent": ["--init={parent}/last.json"],
            "program": {"folder": str(PROGRAM.parent), "files": [PROGRAM.name]},
            "results": "results/epoch_{epoch}/data",
            "settle_seconds": 0.2,
            "grace_seconds": 2,
            **section,
        }
        content = {
            "defaults": ["command", {"override /schedule": schedule}, "_self_"],
            "detector": detector,
            "loss": {"gamma": 0.0},
        }
        used = [f"{{extra.{name}}}" in f"{section} {words}" for name in EXTRA]
        extra = {name: EXTRA[name] for name, is_used in zip(EXTRA, used, strict=True) if is_used}
        content |= {"extra": extra} if extra else {}  # a key that nothing reads is refused
        text = "# @package _global_\n" + yaml.safe_dump(content, sort_keys=False)
        (own / "detector" / "fake.yaml").write_text(text)
        shared = [
            *("detector=fake", "profile=tiny", "data.generate=false", f"data.root={simulated}"),
            "schedule.epochs={warmup: 2, focal: 1, scratch: 2}",
            *(f"store.root={tmp_path / 'runs'}", f"results={tmp_path / 'results'}", *words),
        ]
        listed = [point_of(point, compose_config([*shared, *point])) for point in points]
        return prepare_sweep(Listed(listed))

    return made


def only(sweep: Prepared) -> RunFolder:
    """The folder of a sweep's one stage."""
    (key,) = sweep.plan.stages
    return sweep.layout.run(key)


def keys(plan: Plan) -> list[str]:
    return [key for trial in plan.trials for key in trial.stages]


# Planning


def test_levels_share_the_stage_whose_command_does_not_tell_them_apart(make: Make) -> None:
    plan = make().plan
    assert len(plan.trials) == 2
    assert len(plan.stages) == 3
    assert [stage.steps for stage in plan.stages.values()] == [2, 1, 1]


def test_a_key_that_a_stages_command_does_not_name_changes_no_key(make: Make) -> None:
    before = keys(make().plan)
    note = [*RUN, "--note={extra.note}"]
    focal = "+schedule.stages.focal.set.detector.run=" + json.dumps(note)
    a = make([["loss.gamma=0"], ["loss.gamma=2"]], focal, "extra.note=a").plan
    b = make([["loss.gamma=0"], ["loss.gamma=2"]], focal, "extra.note=b").plan
    assert keys(a)[0] == keys(b)[0] == before[0]
    assert not set(keys(a)[1:]) & set(keys(b)[1:]) - {before[0]}
    assert keys(make(progress="epoch (?P<epoch>.)", grace_seconds=9).plan) == before
    assert keys(make([["loss.gamma=0"], ["loss.gamma=2"]], "workers=2").plan) == before


def test_another_program_is_another_stage(make: Make, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / PROGRAM.name).write_text(PROGRAM.read_text())
    asked = {"folder": str(copy), "files": "*.py"}
    assert keys(make(program=asked).plan) == keys(make().plan)  # wherever it lies
    (copy / "more.py").write_text("")
    assert not set(keys(make(program={"folder": str(copy), "files": "*.py*"}).plan)) & set(
        keys(make().plan)
    )


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (
            {"run": [*RUN, "{loss.gama}"]},
            r"no placeholder \{loss.gama\}. Did you mean 'loss.gamma'",
        ),
        ({"run": [*RUN, "{checkpoint}"]}, r"no placeholder \{checkpoint\}"),
        ({"run": None}, "detector.run: no command"),
        ({"from_parent": []}, r"stage 'focal' goes on from another.*\{parent\}"),
        ({"results": "results/data"}, r"has no \{epoch\}"),
        ({"resume": ["--resume"]}, "give that too, such as ckpt"),
        ({"run": [*RUN, "{resume}"]}, r"run has \{resume\}, and there is none"),
        (
            {"run": "a\nb\n"},
            r"from_parent: run is a text of several lines.*write \{from_parent\}",
        ),
        (
            {"run": "a {from_parent}\nb\n", "resume": ["--go-on"], "checkpoint": "*.pt"},
            r"resume: run is a text of several lines.*write \{resume\}",
        ),
        ({"env": {"X": "{resume}"}}, r"detector.env.X: no placeholder \{resume\}"),
        (
            {"run": "echo ${{HOME}}"},
            r"detector.run: .*write \\\$\{ where .* and \\\$\{\{NAME\}\} for",
        ),
        ({"run": 3}, "detector.run: 3, but it is a list"),
        ({"env": "A=1"}, "detector.env: A=1, but it holds"),
        ({"progress": "epoch (.)"}, "has no group named epoch"),
        ({"results_folder": "x"}, "results_folder: no key of a command. Did you mean 'results'"),
        (
            {"program": {"folder": str(PROGRAM.parent), "files": ["train.py"]}},
            "'train.py' fits no file .*example_program.py",
        ),
        ({"program": {"folder": "/nowhere/at/all"}}, "no such folder"),
        ({"program": {}}, "detector.program"),
        ({"name": None}, "detector.name: not given"),
    ],
)
def test_what_cannot_be_started_is_refused_when_it_is_planned(
    make: Make, section: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make(**section)


def test_swept_values_that_no_command_is_given_are_refused(make: Make) -> None:
    without = [word for word in RUN if "seed" not in word]
    with pytest.raises(ConfigError, match=r"seed: swept, but no stage's command has \{seed\}"):
        make([["seed=0"], ["seed=1"]], run=without)


# Running


def test_a_sweep_of_commands_has_scores_logs_and_exits(make: Make, simulated: Path) -> None:
    sweep = make(progress=r"epoch (?P<epoch>\d+) loss (?P<loss>\S+)")
    ran = run_small(sweep)
    assert len(ran.outcome.trained) == 3
    assert all(len(ran.recorder.store.logged_steps(run)) == 3 for run in ran.recorder.runs)
    folder = sweep.layout.run(sweep.plan.trials[1].key)
    (step,) = folder.steps()
    marker = read_marker(folder, step)
    assert (step, marker.epoch) == (3, 3)
    assert marker.losses == {"loss": pytest.approx(1 / 3, abs=1e-3)}
    source = folder.work / "results" / "epoch_1" / "data"
    assert marker.made_by["results.sha256"] == results_digest(source, sweep.data.val_ids)
    assert isinstance(read_detections(folder.detections(step)), Results)
    (end,) = [json.loads(line) for line in folder.command_exits.read_text().splitlines()]
    assert (end["code"], end["by_fl3d"]) == (0, False)
    assert '"--gamma=2"' in folder.command_log.read_text()
    again = run_small(make())
    assert not again.outcome.trained


def test_what_a_command_takes_is_known_once_one_has_run(
    make: Make, capsys: pytest.CaptureFixture[str]
) -> None:
    run = [*RUN, "--slow=0.3"]
    new = make([["seed=1"]], schedule="from_scratch", run=run)
    stages = list(new.plan.stages.values())
    costs = Costs(new.layout.stages, len(new.data.val_ids))
    progress = Progress("x", new.layout, costs, 1)
    progress._renew(new.plan, stages, ())
    assert "0/2 steps, ? left: Fake scratch" in capsys.readouterr().err
    progress._renew(new.plan, stages * 6, ())  # a line stays a line on two hundred slots
    assert capsys.readouterr().err.endswith("Fake scratch, Fake scratch and 2 more\n")
    assert not costs.cost(stages[0]).is_known
    before = make([["seed=0"]], schedule="from_scratch", run=run)
    run_small(before)
    costs.learn(before.plan.stages)
    progress._renew(new.plan, stages, ())
    assert "? left" not in capsys.readouterr().err
    assert costs.cost(stages[0]).seconds > 0.5  # two epochs of 0.3 seconds


def test_a_store_may_be_told_by_a_relative_path(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["store.root=here", "results=there"]
    more = {"checkpoint": "last.json", "resume": ["--note={checkpoint}"]}
    sweep = make(
        [["seed=0"]], *words, schedule="from_scratch", run=[*RUN, "--fail-after=1"], **more
    )
    with pytest.raises(StageFailed, match="ended with code 3"):
        run_small(sweep)
    sweep = make(
        [["seed=0"]], *words, schedule="from_scratch", run=[*RUN, "--fail-after=1"], **more
    )
    run_small(sweep)
    work = tmp_path / "here" / "stages" / only(sweep).key / "work"
    assert f"note: {work}/last.json" in only(sweep).command_log.read_text()


def test_blanks_and_quotes_reach_the_program_as_they_are(make: Make) -> None:
    note = "a  'b' \"c\" $HOME {d}"
    word = f"extra.note={json.dumps(note)}"
    for run in (
        [*RUN, "--note={extra.note}"],
        " ".join(RUN) + " --note={extra.note}",
    ):
        sweep = make([["seed=0"]], word, run=run, schedule="from_scratch", from_parent=[])
        run_small(sweep)
        assert f"\nnote: {note}\n" in only(sweep).command_log.read_text()
    word = "extra.flags=[--note,'x y']"
    sweep = make([["seed=0"]], word, run=[*RUN, "{extra.flags}"], schedule="from_scratch")
    run_small(sweep)
    assert "\nnote: x y\n" in only(sweep).command_log.read_text()


TWO_COMMANDS = """
note=(--note "it's {seed}")
{python} {program}/example_program.py --data={data_root} --val={val_split} --out={folder} --epochs={epochs} \\
  "\\${{note[@]}}" --fail-after=1 {resume}
echo "and then \\${{#note[@]}} words"
"""


@pytest.mark.parametrize(
    ("run", "resume"),
    [
        (TWO_COMMANDS, ["--note={checkpoint}"]),
        (TWO_COMMANDS, "--note={checkpoint}"),
        ([*RUN, "--note=it's 0", "{resume}", "--fail-after=1"], ["--note={checkpoint}"]),
        (" ".join([*RUN, "--fail-after=1 --note=it\\'s\\ 0\n"]), ["--note={checkpoint}"]),
    ],
)
def test_what_is_added_of_an_interrupted_start_comes_where_it_is_named_or_behind(
    make: Make, run: object, resume: object
) -> None:
    section = {"run": run, "checkpoint": "last.json", "resume": resume, "from_parent": []}
    with pytest.raises(StageFailed, match="ended with code 3"):
        run_small(make([["seed=0"]], schedule="from_scratch", **section))
    sweep = make([["seed=0"]], schedule="from_scratch", **section)
    run_small(sweep)
    notes = re.findall(r"^note: (.*)$", only(sweep).command_log.read_text(), re.MULTILINE)
    assert notes == ["it's 0", str(only(sweep).work / "last.json")]
    log = only(sweep).command_log.read_text()
    assert ("\nand then 2 words\n" in log) == (run is TWO_COMMANDS)


def test_a_start_that_fails_says_which_checkpoint_it_was_to_go_on_from(make: Make) -> None:
    section = {"run": [*RUN, "--fail-after=1"], "checkpoint": "last.json", "resume": ["--no-such"]}
    with pytest.raises(StageFailed, match=r"code 3; all .*command\.log$"):
        run_small(make([["seed=0"]], schedule="from_scratch", **section))
    with pytest.raises(
        StageFailed, match=r"code 2; .* go on from .*work/last.json: if that is broken"
    ):
        run_small(make([["seed=0"]], schedule="from_scratch", **section))


@pytest.mark.parametrize(
    ("section", "message"),
    [
        ({"run": [*RUN, "--fail-after=1"]}, r"(?s)out of luck.*the command ended with code 3"),
        ({"run": ["{folder}/nothing"]}, r"(?s)No such file.*the command ended with code 127"),
        ({"results": "out/{epoch}"}, r"no folder fits detector.results.*there is .*results/"),
        ({"results": "results/epoch_{epoch}/final"}, r"no folder fits .*there is epoch_1/, epoch_2/"),
        ({"run": [*RUN, "--leave-out=1"]}, "has no file of 1 of the 4 validation frames: 00"),
        ({"run": [*RUN, "--add=000000", "--add=999999"]}, "files of 2 frames that are no validation frames: .*999999"),
        ({"run": [*RUN, "--first=0"]}, "is of epoch 0, but the stage has epochs 1 to 2; detector.first_epoch"),
        ({"run": [word.replace("{epochs}", "1") for word in RUN]}, "the stage's last epoch, 2: .*epochs 1;"),
    ],
)  # fmt: skip
def test_what_goes_wrong_is_said(make: Make, section: dict[str, object], message: str) -> None:
    sweep = make([["seed=0"]], schedule="from_scratch", **section)
    with pytest.raises(StageFailed):
        run_small(sweep)
    assert re.search(message, only(sweep).error.read_text()), only(sweep).error.read_text()
    assert not only(sweep).is_done


def test_a_pattern_is_mended_without_training_again(make: Make) -> None:
    sweep = make([["seed=0"]], schedule="from_scratch", results="out/{epoch}")
    with pytest.raises(StageFailed):
        run_small(sweep)
    mended = make([["seed=0"]], schedule="from_scratch")
    run_small(mended)
    assert only(mended).path == only(sweep).path
    assert len(only(mended).command_exits.read_text().splitlines()) == 1
    with pytest.raises(ConfigError, match="were read by results/epoch_"):
        run_small(make([["seed=0"]], schedule="from_scratch", results="other/{epoch}"))


def test_epochs_may_be_counted_otherwise(make: Make) -> None:
    """From 0 in the warm-up; a program that counts on numbers its second stage's first epoch 3."""
    sweep = make(
        [["seed=0"]],
        "+schedule.stages.focal.set.detector.run=" + json.dumps([*RUN, "--first=2"]),
        run=[*RUN, "--first=0"],
        first_epoch=0,
        counts_on=True,
    )
    run_small(sweep)
    assert [sweep.layout.run(key).steps() for key in sweep.plan.trials[0].stages] == [[1, 2], [3]]


# Ending and going on


def running(folder: RunFolder) -> list[int]:
    """Processes whose command line names a stage's work folder."""
    found = []
    for path in Path("/proc").glob("[0-9]*/cmdline"):
        try:
            if str(folder.work).encode() in path.read_bytes():
                found.append(int(path.parent.name))
        except OSError:
            continue
    return found


def until(condition: Callable[[], object], seconds: float = 60) -> None:
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_stage_that_is_killed_takes_its_program_along_and_goes_on(make: Make) -> None:
    slow = [*RUN, "--slow=0.7"]
    words = ["schedule.epochs.scratch=6"]
    sweep = make([["seed=0"]], *words, schedule="from_scratch", run=slow)
    folder = only(sweep)
    gone: list[bool] = []

    def kill() -> None:
        until(lambda: len(folder.steps()) >= 1 and holder_of(folder.lease))
        holder = holder_of(folder.lease)
        assert holder is not None
        programs = running(folder)
        os.kill(holder.pid, signal.SIGKILL)
        until(lambda: not set(programs) & set(running(folder)))
        gone.append(bool(programs))

    killer = threading.Thread(target=kill)
    killer.start()
    run_small(sweep, LocalLauncher(slots=1))
    killer.join()
    assert gone == [True]
    assert "goes on after epoch" in folder.command_log.read_text()
    ends = [json.loads(line) for line in folder.command_exits.read_text().splitlines()]
    assert [end["by_fl3d"] for end in ends] == [True, False]
    assert folder.steps()[-1] == 6
    assert not running(folder)


def test_a_program_that_does_not_listen_is_killed_with_all_it_started(
    make: Make, tmp_path: Path
) -> None:
    deaf = f"trap '' TERM; (trap '' TERM; echo {{folder}} >/dev/null; sleep 300) & touch {tmp_path}/up; wait; sleep 300"
    sweep = make([["seed=0"]], schedule="from_scratch", run=deaf, grace_seconds=0.5)
    folder = only(sweep)

    class Run(CommandRun):
        def _steps(self) -> float:
            if (tmp_path / "up").exists():
                raise KeyboardInterrupt
            return 0.0

    write_spec(folder, Spec(sweep.plan.stages[folder.key], machine(sweep)))
    with leased(folder.lease) as lease, pytest.raises(KeyboardInterrupt):
        Run(folder, lease, read_spec(folder)).run()
    assert not running(folder)
    (end,) = [json.loads(line) for line in folder.command_exits.read_text().splitlines()]
    assert (end["code"], end["by_fl3d"]) == (-signal.SIGKILL, True)


def test_a_program_that_changes_while_it_runs_is_refused(make: Make, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / PROGRAM.name).write_text(PROGRAM.read_text())
    run = " ".join(RUN) + " && echo >> {program}/example_program.py"
    asked = {"folder": str(copy), "files": ["*.py"]}
    sweep = make([["seed=0"]], schedule="from_scratch", run=run, program=asked, from_parent=[])
    with pytest.raises(StageFailed, match="the program has changed while its command ran"):
        run_small(sweep)


def test_results_behind_which_a_program_went_on_are_whole(make: Make) -> None:
    """It goes on from the checkpoint that it saved after them, and never writes them again."""
    sweep = make([["seed=0"]], schedule="from_scratch", run=[*RUN, "--fail-after=1"])
    folder = only(sweep)
    with pytest.raises(StageFailed):
        run_small(sweep)
    assert not folder.steps()  # the program had ended with code 3, within the settling time
    run_small(make([["seed=0"]], schedule="from_scratch", run=[*RUN, "--fail-after=1"]))
    assert folder.steps() == [1, 2]
    assert not list(folder.work.rglob("*.unfinished-*"))


def test_what_an_interrupted_start_may_have_left_half_written_is_put_aside(make: Make) -> None:
    """The last file is the newest of all: the program had nothing behind it, and writes all of them again."""
    sweep = make([["seed=0"]], schedule="from_scratch", run=[*RUN, "--fail-after=1"])
    folder = only(sweep)
    with pytest.raises(StageFailed):
        run_small(sweep)
    (folder.work / "last.json").unlink()  # as if it was killed before it had saved that
    results = folder.work / "results" / "epoch_1" / "data"
    last = sorted(results.glob("*.txt"))[-1]
    whole = last.read_text()
    last.write_text(whole[: len(whole) // 2])
    with pytest.raises(StageFailed):  # after epoch 1 once more
        run_small(make([["seed=0"]], schedule="from_scratch", run=[*RUN, "--fail-after=1"]))
    run_small(make([["seed=0"]], schedule="from_scratch", run=[*RUN, "--fail-after=1"]))
    assert folder.steps() == [1, 2]
    assert last.read_text() == whole
    assert len(list(results.parent.glob("data.unfinished-*"))) == 1


def test_a_command_whose_guard_was_killed_is_ended_and_run_again(
    make: Make, tmp_path: Path
) -> None:
    """It would write on beside the next start of it."""
    sweep = make([["loss.gamma=0"]], schedule="from_scratch", run=[*RUN, "--slow=0.5"])
    folder = only(sweep)
    running = folder.command_exits.with_name("exits.jsonl.running")
    groups: list[int] = []

    def kill_guard() -> None:
        deadline = time.monotonic() + 120
        while not groups and time.monotonic() < deadline:
            with contextlib.suppress(OSError, ValueError):
                groups.append(json.loads(running.read_text())["group"])
            time.sleep(0.01)
        status = Path(f"/proc/{groups[0]}/stat").read_text().rpartition(")")[2].split()
        os.kill(int(status[1]), signal.SIGKILL)

    killer = threading.Thread(target=kill_guard)
    killer.start()
    with pytest.raises(StageFailed, match="signal 9"):
        run_small(sweep)
    killer.join()
    assert guard.began(groups[0]) == "" or is_zombie(groups[0])
    assert not running.exists()
    (end,) = read_exits(folder.command_exits)
    assert (end.code, end.by_fl3d) == (-signal.SIGKILL, True)
    run_small(sweep)
    assert folder.steps()[-1] == 2


def test_a_line_that_a_killed_guard_has_half_written_is_passed_over(tmp_path: Path) -> None:
    records = tmp_path / "exits.jsonl"
    whole = {"started": 1.0, "ended": 2.0, "code": 0, "by_fl3d": False}
    records.write_text(json.dumps(whole) + '\n{"started": 3.0, "en')
    assert [end.code for end in read_exits(records)] == [0]


def is_zombie(pid: int) -> bool:
    return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "Z"


def test_a_command_that_a_killed_guard_and_starter_left_is_ended_by_the_next_start(
    tmp_path: Path,
) -> None:
    records = tmp_path / "exits.jsonl"
    left = subprocess.Popen(["sleep", "600"], start_new_session=True)
    stranger = subprocess.Popen(["sleep", "600"], start_new_session=True)
    running = tmp_path / "exits.jsonl.running"
    try:
        running.write_text(json.dumps({"group": left.pid, "began": guard.began(left.pid)}))
        wait_for_earlier(records, 10)
        assert left.wait(timeout=60) == -signal.SIGKILL
        # Its number may be somebody else's by now.
        running.write_text(json.dumps({"group": stranger.pid, "began": "12"}))
        wait_for_earlier(records, 10)
        assert stranger.poll() is None
        assert not running.exists()
    finally:
        for process in (left, stranger):
            process.kill()
            process.wait()
