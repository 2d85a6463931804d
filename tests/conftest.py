"""Fixtures. Real data are found by environment variable and never copied into the repository."""

import os
from pathlib import Path

import pytest
import torch
from hypothesis import settings

torch.set_num_threads(1)
settings.register_profile(
    "fl3d", deadline=None, derandomize=True
)  # compilation is slow once; CI must repeat
settings.load_profile("fl3d")
ROOT = Path(__file__).resolve().parent.parent


def _data(variable: str, default: str) -> Path:
    path = Path(os.environ.get(variable, ROOT / default))
    if not path.is_dir():
        message = f"{path} is not there; set {variable} to the folder"
        if os.environ.get("FL3D_REQUIRE_DATA"):
            pytest.fail(message)
        pytest.skip(message)
    return path


@pytest.fixture(scope="session")
def kitti_sample() -> Path:
    """Real KITTI: all labels and calibrations, 32 clouds."""
    return _data("FL3D_KITTI_SAMPLE", "../shared/kitti")


@pytest.fixture(scope="session")
def eval_cases() -> Path:
    """Real detections with their true AP."""
    return _data("FL3D_EVAL_CASES", "../shared/eval_cases")


@pytest.fixture(scope="session")
def odd_inputs() -> Path:
    """Small inputs as people bring them, one a folder: of other forms than KITTI's, or broken."""
    return _data("FL3D_ODD_INPUTS", "../shared/odd")


@pytest.fixture(scope="session")
def simulated(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A small simulated KITTI folder: 6 training and 4 validation frames."""
    from fl3d.simulator.generate import Settings, generate

    return generate(tmp_path_factory.mktemp("simulated"), Settings(6, 4, seed=3))
