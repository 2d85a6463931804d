"""Files of data and of a store, spoilt one at a time; COPY stands for the folder that holds all of them."""

from __future__ import annotations

import os
import pickle
import sqlite3
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

SMALL = (
    *("profile=tiny", "data.generate=false", "data.root=COPY/data", "schedule.frames_per_epoch=8"),
    *("schedule.epochs.warmup=2", "schedule.epochs.focal=2", "detector=fcn3d"),
    *("store.root=COPY/runs", "results=COPY/results"),
)
GRID = (*SMALL, "loss.gamma=0,2", "sweep.name=grid")
RESUME = ["-m", *GRID, "hydra/launcher=inline"]
SEARCH = [
    *("-m", *SMALL, "hydra/sweeper=optuna", "loss.gamma=choice(0,2)", "hydra/launcher=inline"),
    *("hydra.sweeper.n_trials=2", "sweep.name=search"),
]
NEW = ["-m", *GRID[:-1], "sweep.name=new", "store.root=COPY/new", "hydra/launcher=inline"]
LABELS, RESULTS = "COPY/data/training/label_2", "COPY/exp/0/seed0/epoch_5/data"
EVALUATE = ["evaluate", LABELS, RESULTS]
CHECK = ["check", "COPY/data", "--picture", "COPY/check.png"]
COMPARE = ["compare", LABELS, f"a={RESULTS}", "b=COPY/exp/1/seed0/epoch_5/data"]
IMPORT = ["import", "COPY/list.csv", *SMALL[:3], *SMALL[7:], "sweep.name=theirs"]
FRAME = "000008"  # of the validation split
TRAINING = "000002"


@dataclass(frozen=True)
class Spoilt:
    """A file that is spoilt, and a command that meets it.

    Args:
        name: of the case.
        spoil: spoils a file below a folder; returns its path.
        words: behind ``python -m fl3d``.
        codes: exit codes that will do; 0 where the file can be made again.
        names: what the answer may name, instead of the file.
    """

    name: str
    spoil: Callable[[Path], Path]
    words: list[str]
    codes: tuple[int, ...] = (2,)
    names: tuple[str, ...] = ()


def _write(pattern: str, content: bytes) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
        return path

    return spoil


def _torn(pattern: str, part: float = 0.5) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        content = path.read_bytes()
        path.write_bytes(content[: int(len(content) * part)])
        return path

    return spoil


def _added(pattern: str, content: bytes) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        path.write_bytes(path.read_bytes() + content)
        return path

    return spoil


def _replaced(pattern: str, old: bytes, new: bytes) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        content = path.read_bytes()
        assert old in content, (path, old)
        path.write_bytes(content.replace(old, new, 1))
        return path

    return spoil


def _gone(pattern: str) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        path.unlink()
        return path

    return spoil


def _folder(pattern: str) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = _one(folder, pattern)
        path.unlink(missing_ok=True)
        path.mkdir()
        return path

    return spoil


def _sql(statement: str) -> Callable[[Path], Path]:
    def spoil(folder: Path) -> Path:
        path = folder / "runs" / "mlflow.db"
        connection = sqlite3.connect(path)
        connection.execute(statement)
        connection.commit()
        connection.close()
        return path

    return spoil


def _one(folder: Path, pattern: str) -> Path:
    """The last file that fits, or the file that would have that name."""
    found = sorted(folder.glob(pattern))
    return found[-1] if found else folder / pattern


def _each(
    kind: str,
    pattern: str,
    contents: dict[str, bytes],
    words: list[str],
    codes: tuple[int, ...] = (2,),
    names: tuple[str, ...] = (),
) -> list[Spoilt]:
    return [
        Spoilt(f"{kind}, {name}: {words[0]}", _write(pattern, content), words, codes, names)
        for name, content in contents.items()
    ]


class _Evil:
    """Runs a command where it is unpickled without care."""

    def __reduce__(self) -> tuple[Callable[[str], int], tuple[str]]:
        return os.system, ("touch evil",)


BINARY = bytes(range(256)) * 3
LABEL = b"Car 0.00 0 1.55 614.24 181.78 727.31 284.77 1.57 1.73 4.15 1.00 1.75 13.22 1.62"
LABEL_PATH, VAL_LABEL = (
    f"data/training/label_2/{TRAINING}.txt",
    f"data/training/label_2/{FRAME}.txt",
)
CALIB_PATH = f"data/training/calib/{FRAME}.txt"
CLOUD_PATH = f"data/training/velodyne/{FRAME}.bin"
RESULT_PATH = f"exp/0/seed0/epoch_5/data/{FRAME}.txt"
MARKER, WEIGHTS = "runs/stages/*focal*/checkpoints/*.json", "runs/stages/*focal*/checkpoints/*.pt"
PLAN, SPEC = "runs/plans/grid*.json", "runs/stages/*focal*/stage.json"
DETECTIONS = "runs/stages/*focal*/detections/*.parquet"
SCORES = "runs/stages/*focal*/scores/*/*.json"
JOURNAL = "runs/studies/*.log"
DATABASE = "runs/mlflow.db"
PREDICT = ["predict", "COPY/stage", "COPY/data", "--out", "COPY/out"]

LABELS_ODD = {
    "few fields": b"Car 0.00 0\n",
    "a word for a number": LABEL.replace(b"1.55", b"tall") + b"\n",
    "NaN": LABEL.replace(b"13.22", b"nan") + b"\n",
    "infinite": LABEL.replace(b"13.22", b"inf") + b"\n",
    "binary": BINARY,
    "negative size": LABEL.replace(b"1.73", b"-1.73") + b"\n",
    "a result file": LABEL + b" 0.9 0.1 7\n",
    "commas": LABEL.replace(b" ", b",") + b"\n",
    "UTF-16": (LABEL + b"\n").decode().encode("utf-16"),
}
TAKEN = ("negative size", "a result file")  # by KITTI's own evaluator too, as they are
RESULTS_ODD = {
    "no score": LABEL + b"\n",
    "NaN score": LABEL + b" nan\n",
    "a word as score": LABEL + b" high\n",
    "binary": BINARY,
    "html": b"<html><body>404</body></html>\n",
    "JSON": b'{"boxes": []}\n',
}
CALIBS_ODD = {
    "empty": b"",
    "binary": BINARY,
    "no P2": b"P0: 1 0 0 0 0 1 0 0 0 0 1 0\n",
    "short": b"P2: 1 2 3\nR0_rect: 1 0 0\nTr_velo_to_cam: 1 0\n",
    "words": b"P2: a b c d e f g h i j k l\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n",
    "NaN": b"P2: nan 0 0 0 0 1 0 0 0 0 1 0\nR0_rect: 1 0 0 0 1 0 0 0 1\nTr_velo_to_cam: 0 -1 0 0 0 0 -1 0 1 0 0 0\n",
    "zeros": b"P2: 0 0 0 0 0 0 0 0 0 0 0 0\nR0_rect: 0 0 0 0 0 0 0 0 0\nTr_velo_to_cam: 0 0 0 0 0 0 0 0 0 0 0 0\n",
}
CLOUDS_ODD = {
    "13 bytes": b"thirteen byte",
    "text": b"1.0 2.0 3.0 0.5\n" * 7 + b"x",
    "npy inside": b"\x93NUMPY\x01\x00v\x00{'descr': '<f4'}",
}
SPLITS_ODD = {
    "empty": b"",
    "no such frame": b"123456\n",
    "words": b"not an id\n",
    "binary": BINARY,
    "a path": b"../../etc/passwd\n",
    "twice": b"000008\n000008\n000009\n",
    "other frames too": b"000008\n000009\nseven\n",
}
JSON_ODD = {
    "empty": b"",
    "torn": b'{"a": [1, 2',
    "list": b"[1, 2]\n",
    "number": b"3\n",
    "other keys": b'{"foo": 1}\n',
    "binary": BINARY,
    "null": b"null\n",
}
CSV_ODD = {
    "empty": b"",
    "no folder": b"level,seed,epoch,folder\n",
    "other columns": b"a,b\n1,2\n",
    "a word as seed": b"level,seed,epoch,folder\n0,x,5,exp/0/seed0/epoch_5/data\n",
    "missing": b"level,seed,epoch,folder\n0,0,5,nothing\n",
    "short": b"level,seed,epoch,folder\n0,0\n",
    "binary": BINARY,
    "twice": b"level,seed,epoch,folder\n0,0,5,exp/0/seed0/epoch_5/data\n1,0,5,exp/0/seed0/epoch_5/data\n",
    "one level": b"level,seed,epoch,folder\nnan,-1,5,exp/0/seed0/epoch_5/data\n",
}
CHECKPOINTS_ODD = {
    "empty": b"",
    "text": b"not a checkpoint",
    "binary": BINARY,
    "pickle that runs a command": pickle.dumps(_Evil()),
    "pickled dict": pickle.dumps({"model": {}}),
}
MADE_AGAIN = (0, 1, 2)

FILES: list[Spoilt] = [
    *_each("label", VAL_LABEL, {k: LABELS_ODD[k] for k in LABELS_ODD if k not in TAKEN}, EVALUATE),
    *_each("label", VAL_LABEL, {k: LABELS_ODD[k] for k in TAKEN}, EVALUATE, (0, 2)),
    *_each(
        "label", LABEL_PATH, {k: LABELS_ODD[k] for k in LABELS_ODD if k not in TAKEN[1:]}, CHECK
    ),
    *_each(
        "label",
        LABEL_PATH,
        {k: LABELS_ODD[k] for k in ("few fields", "NaN", "binary")},
        NEW,
        (1, 2),
    ),
    *_each("result", RESULT_PATH, RESULTS_ODD, EVALUATE),
    *_each("result", RESULT_PATH, {"17 fields": LABEL + b" 0.9 1\n"}, EVALUATE, (0, 2)),
    *_each("result", RESULT_PATH, {k: RESULTS_ODD[k] for k in ("no score", "html")}, COMPARE),
    *_each("calibration", CALIB_PATH, CALIBS_ODD, CHECK),
    *_each("calibration", CALIB_PATH, {k: CALIBS_ODD[k] for k in ("empty", "NaN")}, NEW, (1, 2)),
    *_each("cloud", CLOUD_PATH, CLOUDS_ODD, CHECK),
    *_each("cloud", CLOUD_PATH, {"13 bytes": CLOUDS_ODD["13 bytes"]}, NEW, (1, 2)),
    *_each("split", "data/ImageSets/val.txt", SPLITS_ODD, NEW, names=("ImageSets", "123456")),
    *_each(
        "split",
        "data/ImageSets/val.txt",
        {"binary": BINARY, "a path": SPLITS_ODD["a path"]},
        CHECK,
        names=("ImageSets",),
    ),
    *_each("list of results", "list.csv", CSV_ODD, IMPORT, names=("exp", "nothing")),
    *_each("plan", PLAN, JSON_ODD, ["gains", *GRID]),
    *_each("plan", PLAN, {k: JSON_ODD[k] for k in ("torn", "list")}, RESUME, (0, 2)),
    *_each(
        "plan",
        PLAN,
        {k: JSON_ODD[k] for k in ("torn", "number")},
        ["clean", "store.root=COPY/runs", "--orphans", "--yes"],
    ),
    *_each("spec", SPEC, JSON_ODD, ["verify", *GRID, "--from-weights"]),
    *_each("spec", SPEC, {k: JSON_ODD[k] for k in ("torn", "list")}, RESUME, (0, 2)),
    *_each(
        "spec",
        SPEC,
        {k: JSON_ODD[k] for k in ("torn", "null")},
        ["clean", "store.root=COPY/runs"],
        (0, 2),
    ),
    *_each("marker", MARKER, JSON_ODD, RESUME, MADE_AGAIN),
    *_each(
        "marker", MARKER, {k: JSON_ODD[k] for k in ("torn", "number")}, ["verify", *GRID], (0, 2)
    ),
    *_each(
        "marker",
        MARKER,
        {k: JSON_ODD[k] for k in ("torn", "number")},
        ["why", "last", "gamma=2", "3d/moderate", *GRID[:-2], "loss.gamma=0,2", "sweep.name=grid"],
    ),
    *_each("detections", DETECTIONS, {"empty": b"", "text": b"not parquet"}, ["verify", *GRID]),
    *_each("detections", DETECTIONS, {"empty": b"", "text": b"not parquet"}, ["gains", *GRID]),
    *_each(
        "detections",
        DETECTIONS,
        {"text": b"not parquet"},
        ["rescore", *GRID, "score_threshold=0,0.5"],
    ),
    Spoilt("detections, torn: verify", _torn(DETECTIONS), ["verify", *GRID]),
    *_each(
        "scores",
        SCORES,
        {k: JSON_ODD[k] for k in ("torn", "number", "other keys")},
        ["tables", *GRID],
        (0, 2),
    ),
    *_each(
        "journal",
        JOURNAL,
        {
            "empty": b"",
            "text": b"hello\n",
            "binary": BINARY,
            "list": b"[1]\n",
            "other keys": b'{"op_code": 99}\n',
        },
        SEARCH,
        (0, 2),
    ),
    Spoilt("journal, torn at its end: -m", _torn(JOURNAL, 0.95), SEARCH, (0, 2)),
    Spoilt("journal, rubbish at its end: -m", _added(JOURNAL, b'{"op_co'), SEARCH, (0, 2)),
    *_each(
        "database",
        DATABASE,
        {"text": b"hello", "binary": BINARY, "zeros": bytes(8192)},
        ["gains", *GRID],
        (0, 2),
    ),
    *_each(
        "database", DATABASE, {"text": b"hello", "binary": BINARY, "zeros": bytes(8192)}, RESUME
    ),
    Spoilt("database, torn: -m", _torn(DATABASE), RESUME),
    Spoilt("database, torn: gains", _torn(DATABASE), ["gains", *GRID], (0, 2)),
    Spoilt("database, a folder: -m", _folder(DATABASE), RESUME),
    Spoilt(
        "database, of another version: -m",
        _sql("UPDATE alembic_version SET version_num = 'abcdef'"),
        RESUME,
    ),
    Spoilt("database, a table dropped: -m", _sql("DROP TABLE metrics"), RESUME),
    Spoilt("database, a run deleted: -m", _sql("DELETE FROM runs"), RESUME, (0, 2)),
    *_each(
        "checkpoint",
        "stage.pt",
        CHECKPOINTS_ODD,
        ["predict", "COPY/stage.pt", "COPY/data", "--out", "COPY/out"],
    ),
    *_each("lease", "runs/plans/grid-simulated-tiny.lease", JSON_ODD, RESUME, (0,)),
    *_each("progress", "runs/stages/*focal*/progress.json", JSON_ODD, ["plan", *GRID], (0,)),
    *_each("look at the data", "runs/checks/*.json", JSON_ODD, RESUME, (0, 2)),
    *_each("end of a stage", "runs/stages/*focal*/done.json", JSON_ODD, RESUME, (0, 2)),
    *_each(
        "picture",
        f"data/training/image_2/{FRAME}.png",
        {"text": b"no picture", "empty": b"", "torn": b"\x89PNG\r\n\x1a\n"},
        CHECK,
        (0, 2),
    ),
    *_each(
        "2D detections",
        "data/rgb_detections/rgb_detection_val.txt",
        {
            "words": b"a b c\n",
            "binary": BINARY,
            "few": b"training/image_2/000008.png 2\n",
            "NaN": b"training/image_2/000008.png 2 nan 0 0 1 1\n",
        },
        [*NEW, "detector=fconvnet"],
        (1, 2),
    ),
    Spoilt("label, a folder: evaluate", _folder(VAL_LABEL), EVALUATE),
    Spoilt("label, gone: evaluate", _gone(VAL_LABEL), EVALUATE),
    Spoilt("calibration, gone: check", _gone(CALIB_PATH), CHECK),
    Spoilt("cloud, gone: check", _gone(CLOUD_PATH), CHECK),
    Spoilt("cloud, gone: -m", _gone(CLOUD_PATH), NEW, (1, 2)),
    Spoilt("cloud, a folder: -m", _folder(CLOUD_PATH), NEW, (1, 2)),
    Spoilt("split, gone: -m", _gone("data/ImageSets/val.txt"), NEW, names=("ImageSets",)),
    Spoilt("split, a folder: -m", _folder("data/ImageSets/val.txt"), NEW, names=("ImageSets",)),
    Spoilt(
        "weights, torn: predict",
        _torn("runs/stages/*focal*/checkpoints/*.pt"),
        ["predict", "SPOILT", "COPY/data", "--out", "COPY/out"],
    ),
]
