"""A device that is not there is refused in one line, before anything is planned or started."""

from pathlib import Path

import pytest
import torch

from fl3d.cli import main
from fl3d.core.errors import ConfigError
from fl3d.inference.devices import check_device


@pytest.mark.parametrize("device", ["gpu", "mps", "cuda:x", "cuda0", "", 0, None])
@pytest.mark.parametrize("is_here", [True, False])
def test_names_of_no_device_are_refused_everywhere(device: object, is_here: bool) -> None:
    with pytest.raises(ConfigError, match=f"device={device}: no such device. Possible: cpu"):
        check_device(device, "device=", is_here)


def test_a_card_that_is_not_here_may_be_elsewhere() -> None:
    check_device("cpu", "device=")
    check_device("cuda:99", "device=", is_here=False)
    with pytest.raises(ConfigError, match=r"device=cuda:99: .* here\. Possible: cpu"):
        check_device("cuda:99", "device=")


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is one")
def test_without_a_card_there_is_no_cuda() -> None:
    with pytest.raises(ConfigError, match=r"--device cuda: no CUDA device here\. Possible"):
        check_device("cuda", "--device ")


@pytest.mark.parametrize("launcher", ["inline", "local"])
@pytest.mark.parametrize("many", [[], ["-m"]])
def test_training_refuses_it_before_anything_is_written(
    simulated: Path, tmp_path: Path, launcher: str, many: list[str]
) -> None:
    words = [
        *("detector=voxelnet", "profile=tiny", "data.generate=false", f"data.root={simulated}"),
        *(f"store.root={tmp_path / 'runs'}", f"results={tmp_path / 'results'}"),
        *("device=cuda:99", f"hydra/launcher={launcher}", f"hydra.run.dir={tmp_path / 'hydra'}"),
    ]
    with pytest.raises(SystemExit, match=r"^fl3d: device=cuda:99: .* here\. Possible: cpu"):
        main([*many, *words])
    assert not (tmp_path / "runs").exists()
