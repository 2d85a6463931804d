"""What is called from Python finds the user's own YAMLs, as the commands do under ``--config-dir``."""

from pathlib import Path

import pytest

import fl3d
from tests.support import SMALL


def test_a_folder_of_ones_own_yamls_is_searched_from_python_too(
    simulated: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("fl3d.config.places._OWN", [])
    own = tmp_path / "own"
    (own / "loss").mkdir(parents=True)
    (own / "loss" / "mine.yaml").write_text("gamma: 1.5\n")
    places = [f"data.root={simulated}", f"store.root={tmp_path / 'runs'}"]
    words = [*SMALL, *places, f"results={tmp_path / 'results'}", "detector=voxelnet"]
    words += ["hydra/launcher=inline", "loss=mine"]
    with pytest.raises(fl3d.Fl3dError, match="no such folder"):
        fl3d.open_sweep(*words, config_dir=tmp_path / "none")
    trained = fl3d.run(*words, say=lambda line: None, config_dir=own)
    opened = fl3d.open_sweep(*words, config_dir=str(own))  # the same folder again
    assert list(opened.trials["trial"]) == list(trained.trials["trial"])
    (planned,) = opened.finished.plan.trials
    assert planned.config["loss.gamma"] == 1.5
    other = tmp_path / "other"
    other.mkdir()
    with pytest.raises(fl3d.Fl3dError, match=f"this process has one already, {own}"):
        fl3d.run(*words, config_dir=other)
