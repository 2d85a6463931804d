"""Tables VI and VII: layers and work of the networks, computed from what is built; the printed numbers beside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.metadata import version
from itertools import accumulate, groupby
from math import prod

from torch import nn

from fl3d.detectors.base import Detector
from fl3d.detectors.flops import LayerWork, layer_works
from fl3d.inference.load import build_detector
from fl3d.papers.base import Place
from fl3d.papers.focal_loss.full_size import full_size
from fl3d.papers.focal_loss.published_cells import ARXIV, published_table
from fl3d.reports.table import Cell, Column, Table
from fl3d.runs.drawn import plain
from fl3d.runs.kept import code_digest
from fl3d.runs.kept_tables import kept_table

DETECTORS = {"VI": "fcn3d", "VII": "voxelnet"}
BLOCKS = {
    "VI": {"body": "Body", "obj": "Head-PMap", "cor": "Head-RMap"},
    "VII": {
        "feature_net": "FeatureNet",
        "middle": "MiddleLayer",
        "rpn.prob": "Prob-Map",
        "rpn.reg": "Reg-Map",
    },
}
CAPTIONS = {"VI": "Layers of 3D-FCN and their work", "VII": "Layers of VoxelNet and their work"}
TOLERANCE = 0.06  # GFLOP: what one printed decimal may hide


# What decides layers and work: the networks, and how they are built and counted.
CODE = (
    *("core", "geometry", "data", "losses.py", "sparse", "points", "detectors", "config"),
    *("inference/load.py", "papers/focal_loss/layers.py"),
)


def still_tables(place: Place) -> list[Table]:
    """Tables I, VI and VII, that need no training: traits, layers and work of the networks.

    Args:
        place: see ``Paper``; what torch says of the networks is kept, for to load what it counts with takes seconds.
    """
    columns = (
        Column("property", ""),
        Column("image", "Image-based"),
        Column("fcn3d", "3D-FCN"),
        Column("voxelnet", "VoxelNet"),
    )
    rows = tuple(
        tuple(Cell(text) for text in row) for row in published_table("I").itertuples(index=False)
    )
    caption = "The two detectors beside image-based ones, as the paper describes them"
    tables = [Table("I", caption, columns, rows, title="Table I.")]
    for number, name in DETECTORS.items():
        config = full_size(name)
        made_of = {
            "table": number,
            "configs": {key: config[key] for key in ("detector", "loss", "classes")},
            "printed": [plain(published_table(n)) for n in (number, ARXIV.get(number)) if n],
            "code": code_digest(*CODE),
            "torch": version("torch"),
        }
        make = partial(layer_table, number, partial(build_detector, config))
        tables.append(kept_table(place(f"table_{number}"), made_of, make))
    return tables


@dataclass(frozen=True)
class _Row:
    front: tuple[Cell, ...]
    gflops: float
    first: LayerWork
    layers: int


def layer_table(number: str, make: Callable[[], Detector]) -> Table:
    """Table VI (3D-FCN) or VII (VoxelNet), with the journal's number beside ours, and what is wrong where they differ.

    Table VII shows the numbers of the first arXiv version (1809.06065v1) too, which differ; those of Table VI do not.
    Work is counted as the paper counts it: two operations for a multiply-add, and two more for each output value.

    Args:
        number: ``VI`` or ``VII``.
        make: builds the detector at full size.
    """
    rows = [_row(number, list(works)) for _, works in groupby(layer_works(make), key=_alike)]
    printed, arxiv = (
        _printed(number, rows, grouped=True),
        _printed(ARXIV.get(number, ""), rows, grouped=False),
    )
    cells = []
    for row, text, earlier in zip(rows, printed, arxiv, strict=True):
        wrong = _is_wrong(row, text)
        note = _explain(row.first, text) if wrong else ""
        others = (Cell(earlier, star=_is_wrong(row, earlier)),) if number in ARXIV else ()
        cells.append(
            (*row.front, Cell(f"{row.gflops:.1f}"), Cell(text, star=wrong), *others, Cell(note))
        )
    total = sum(row.gflops for row in rows)
    columns = (
        *(
            Column(key, key.capitalize())
            for key in ("block", "layer", "kernel", "strides", "filters")
        ),
        Column("gflops", "GFLOPs", "", True),
        Column("published", "printed", "", True),
        *((Column("arxiv", "arXiv", "", True),) if number in ARXIV else ()),
        Column("note", "why they differ"),
    )
    notes = (f"Sum: {total:.1f} GFLOP a frame.",)
    legend = "Star: the printed number is not the layer's"
    return Table(
        number, CAPTIONS[number], columns, tuple(cells), legend, notes, title=f"Table {number}."
    )


def _printed(name: str, rows: Sequence[_Row], grouped: bool) -> list[str]:
    """Each row's printed number; the arXiv version prints every layer, so its are summed. Empty: not known."""
    values = (
        [text for text in published_table(name)["gflops"] if text != "/"] if name else []
    )  # a reshape is no work
    layers = [1 if grouped else row.layers for row in rows]
    if sum(layers) != len(values):  # another network than the paper's
        return [""] * len(rows)
    parts = [
        values[end - count : end] for count, end in zip(layers, accumulate(layers), strict=True)
    ]
    return [part[0] if len(part) == 1 else f"{sum(map(float, part)):.1f}" for part in parts]


def _is_wrong(row: _Row, text: str) -> bool:
    return text != "" and abs(row.gflops - float(text.strip("<"))) > (
        0.1 if "<" in text else TOLERANCE
    )


def _alike(work: LayerWork) -> tuple[object, ...]:
    """Equal layers that follow each other share a row, as in the paper; 3D layers have rows of their own."""
    module = work.module
    if isinstance(module, nn.Conv2d):
        return type(module), module.kernel_size, module.stride, module.out_channels, work.outputs
    return (work.name,)


def _row(number: str, works: list[LayerWork]) -> _Row:
    first = works[0]
    block = next(
        (label for prefix, label in BLOCKS[number].items() if first.name.startswith(prefix)), "RPN"
    )
    kind, *rest = _kind(first)
    count = f" x {len(works)}" if len(works) > 1 else ""
    gflops = sum(work.flops + 2 * prod(work.outputs) for work in works) / 1e9
    return _Row(
        tuple(Cell(text) for text in (block, kind + count, *rest)), gflops, first, len(works)
    )


def _kind(work: LayerWork) -> tuple[str, str, str, str]:
    """Layer, kernel or units, strides and filters, as the paper writes them."""
    module = work.module
    if isinstance(module, nn.Linear):
        is_vfe = "vfe" in work.name  # half of an encoding layer's width is the voxel's maximum
        return (
            "vfe" if is_vfe else "fc",
            str(module.out_features * (2 if is_vfe else 1)),
            "N/A",
            "N/A",
        )
    assert isinstance(module, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d)
    kind = "deconv" if isinstance(module, nn.ConvTranspose2d) else f"conv{module.weight.dim() - 2}d"
    return kind, _list(module.kernel_size), _list(module.stride), str(module.out_channels)


def _list(values: tuple[int, ...]) -> str:
    return "[" + ",".join(str(value) for value in values) + "]"


def _explain(work: LayerWork, printed: str) -> str:
    """What was counted instead, where a count tried here gives the printed number."""
    module = work.module
    if isinstance(module, nn.Linear):
        return "counted without the voxels, whose number is open"
    assert isinstance(module, nn.Conv2d | nn.Conv3d | nn.ConvTranspose2d)
    deconv = isinstance(module, nn.ConvTranspose2d)
    taps = 9 if deconv else prod(module.kernel_size)
    outputs = module.out_channels * prod(work.inputs[2:])
    guess = 2 * outputs * (taps * module.in_channels + 1) / 1e9
    why = (
        "a 3 x 3 kernel at the input's size" if deconv else "at the input's size, before the stride"
    )
    return f"counted {why}: {guess:.1f}" if abs(guess - float(printed)) < 0.1 else ""
