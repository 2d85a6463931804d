"""docs/your_training_code.md, done: a detector that knows nothing of fl3d, swept, killed, gone on with, to verdicts."""

import os
import re
import signal
import threading
import time
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from fl3d.api.training import train
from fl3d.config.compose import CONF, compose_config
from fl3d.config.places import search_also
from fl3d.core.leases import holder_of
from fl3d.runs.layout import RunFolder, StoreFolder
from fl3d.runs.plans import read_plan
from fl3d.sweep.sweepers.grid import Listed, point_of
from fl3d.training.command import OWN_PLACES, Command, command_of

ROOT = CONF.parent
EXAMPLE = ROOT / "examples" / "pillars"
PAGE = (ROOT / "docs" / "your_training_code.md").read_text()


def test_the_example_is_swept_killed_and_gone_on_with(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fl3d.config.places._OWN", [])
    monkeypatch.syspath_prepend(str(tmp_path))
    search_also(EXAMPLE)
    shared = [
        *("+sweep=pillars_gamma", "data.generate=false", f"data.root={simulated}", "profile=tiny"),
        *("schedule.epochs.warmup=6", "schedule.epochs.focal=1", "detector.settle_seconds=0.5"),
        *(f"store.root={tmp_path / 'runs'}", f"results={tmp_path / 'results'}"),
    ]
    words = [["loss.gamma=0"], ["loss.gamma=2"]]
    points = [point_of(word, compose_config([*shared, *word])) for word in words]
    store = StoreFolder(tmp_path / "runs")
    killer = threading.Thread(target=kill_the_first, args=(store,))
    killer.start()
    said: list[str] = []
    local = {"_target_": "fl3d.sweep.launchers.local.LocalLauncher", "slots": 1}
    train(Listed(points), local, shared, said.append)
    killer.join()
    plan = read_plan(store.plan("pillars_gamma-simulated-tiny"))
    assert len(plan.stages) == 3  # the warm-up is shared
    warmup = store.run(plan.trials[0].stages[0])
    assert "goes on after epoch" in warmup.command_log.read_text()
    assert len(warmup.command_exits.read_text().splitlines()) == 2
    assert warmup.steps()[-1] == 6
    (table,) = (line for line in said if "Last models of Pillars" in line)
    assert "| 2 | 1 |" in table
    assert any("Verdicts on Pillars" in line for line in said)


def kill_the_first(store: StoreFolder) -> None:
    """Kill the first stage as soon as its program has left a checkpoint of its own."""
    deadline = time.monotonic() + 300
    while time.monotonic() < deadline:
        for path in store.stages.glob("*"):
            folder = RunFolder(path)
            holder = holder_of(folder.lease)
            if (folder.work / "last.pt").exists() and holder is not None:
                os.kill(holder.pid, signal.SIGKILL)
                return
        time.sleep(0.05)


def test_the_example_is_short_and_knows_nothing_of_fl3d() -> None:
    text = (EXAMPLE / "train.py").read_text()
    assert "fl3d" not in text
    assert len(text.splitlines()) < 200


def test_the_page_names_every_place_and_every_key() -> None:
    for name in OWN_PLACES:
        assert f"{{{name}}}" in PAGE, name
    listed = (CONF / "detector" / "command.yaml").read_text()
    for key in (one.name for one in fields(Command)):
        assert key == "imported" or re.search(rf"^  {key}:", listed, re.MULTILINE), key


@pytest.mark.parametrize("number", range(4))
def test_every_yaml_of_the_page_is_a_command(number: int) -> None:
    text = re.findall(r"```yaml\n(.*?)```", PAGE, re.DOTALL)[number]
    content = yaml.safe_load(text)
    defaults = yaml.safe_load((CONF / "detector" / "command.yaml").read_text())["detector"]
    command = command_of({**defaults, **content["detector"]})
    command.check(["seed", "loss.gamma", "optimizer.lr"], "scratch", has_parent=False)
