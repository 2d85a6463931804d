"""Benchmarks measure what they say: parts of them that can be wrong by themselves."""

import re
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.all import BEGIN, END, HEAD, WITH, WITHOUT, read_rows, row_of, run, with_rows
from benchmarks.networks import NETWORKS, build, error, middle
from fl3d.data.kitti import KittiFolder
from tests.conftest import ROOT


@pytest.mark.parametrize("compute", ["dense", "sparse"])
def test_the_middle_layers_take_as_many_frames_as_a_batch_has(
    compute: str, simulated: Path
) -> None:
    """Also where the maps are dense from the start, so that the batch has no layout."""
    model = build("voxelnet", compute, "tiny").eval()
    folder = KittiFolder(simulated)
    frames = [folder.frame(frame_id) for frame_id in folder.split("train")[:2]]
    samples = [model.encode(frame, np.random.default_rng(0), training=True) for frame in frames]

    def features(*chosen: int) -> torch.Tensor:
        batch = model.collate([samples[i] for i in chosen])
        with torch.no_grad():
            voxels = model.feature_net(batch["rows"], batch["lengths"], batch.get("mask"))
            return middle(model, voxels, batch)

    torch.testing.assert_close(features(0, 1), torch.cat([features(0), features(1)]))


@pytest.mark.parametrize("network", NETWORKS)
def test_dense_and_sparse_networks_are_compared_as_the_same_function(
    network: str, simulated: Path
) -> None:
    frame = KittiFolder(simulated).split("train")[0]
    assert error(simulated, network, "tiny", frame) < 1e-9


@pytest.mark.slow
@pytest.mark.parametrize("name", WITHOUT)
def test_what_bench_runs_ends_well(name: str) -> None:
    row = run(name, WITHOUT[name], seconds=300)
    assert row is not None
    assert row.startswith(f"| `{name}.py` |")


TEXT = (
    f"# Benchmarks\n\nby hand\n\n{BEGIN}\n{HEAD}\n| `store.py` | 46 | 7 | here |\n{END}\n\nafter\n"
)


def test_a_table_is_written_between_its_marks_and_nowhere_else() -> None:
    rows = read_rows(TEXT)
    assert rows == {"store": "| `store.py` | 46 | 7 | here |"}
    told = {
        "benchmark": "input",
        "machine": "a CPU, 2 cores, Linux",
        "commit": "0123456789abcdef",
        "found": {"voxels ms": 0.34, "quick": {"forward": 2.0, "step": 1.5}},
    }
    text = with_rows(TEXT, {**rows, "input": row_of(told, 12.4)})
    row = (
        "| `input.py` | voxels ms 0.34; quick (forward 2.0, step 1.5) | 12 | "
        "a CPU, 2 cores, Linux; 0123456789 |"
    )
    assert text == TEXT.replace("| `store.py`", f"{row}\n| `store.py`")
    assert read_rows(text) == {**rows, "input": row}
    assert with_rows(text, read_rows(text)) == text


def test_what_bench_runs_is_there_and_ends_with_a_line_of_its_name() -> None:
    for name in {**WITHOUT, **WITH}:
        source = (ROOT / "benchmarks" / f"{name}.py").read_text(encoding="utf-8")
        assert re.search(rf'tell\(\s*"{name}",', source)
    read_rows((ROOT / "benchmarks" / "README.md").read_text(encoding="utf-8"))
