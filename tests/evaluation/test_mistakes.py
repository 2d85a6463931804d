"""Mistakes of converters are told by what they do to results, and honest results never are."""

import math
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import fl3d
from fl3d.cli import main
from fl3d.config.protocols import read_protocol
from fl3d.data.kitti import KittiFolder
from fl3d.data.label_table import LabelTable, read_table, table_from_labels
from fl3d.data.labels import labels_from_columns
from fl3d.evaluation.average_precision import compare
from fl3d.evaluation.mistakes import find_mistakes
from tests.evaluation.commanded import Printed, evaluate

# Columns of a result file behind the type, by KITTI's names.
X1, Y1, X2, Y2, H, W, L, X, Y, Z, RY, SCORE = range(3, 15)
Values = np.ndarray
Mistake = Callable[[Values], Values]
ALARMS = 6  # a frame


def written(*columns: tuple[int, int]) -> Mistake:
    """Columns that hold other columns: (which, what it holds)."""

    def convert(values: Values) -> Values:
        wrong = values.copy()
        for which, held in columns:
            wrong[:, which] = values[:, held]
        return wrong

    return convert


def changed(column: int | slice, of: Callable[[Values], Values]) -> Mistake:
    """A column, or several, made anew of the right ones."""

    def convert(values: Values) -> Values:
        wrong = values.copy()
        wrong[:, column] = of(values)
        return wrong

    return convert


def both(*mistakes: Mistake) -> Mistake:
    def convert(values: Values) -> Values:
        for mistake in mistakes:
            values = mistake(values)
        return values

    return convert


FLAT = changed(slice(X1, Y2 + 1), lambda v: np.zeros((len(v), 4)))
MILLIMETRES = changed(slice(H, Z + 1), lambda v: 1000 * v[:, H : Z + 1])
SIZES_BACK = written((H, L), (L, H))
TO_MIDDLE = changed(Y, lambda v: v[:, Y] - v[:, H] / 2)
TO_YAW = changed(RY, lambda v: -v[:, RY] - math.pi / 2)
TO_LIDAR = changed(slice(X, Z + 1), lambda v: np.column_stack([v[:, Z], -v[:, X], -v[:, Y]]))
AS_CORNER = changed(slice(X2, Y2 + 1), lambda v: v[:, X2 : Y2 + 1] - v[:, X1 : Y1 + 1])
AS_MIDDLE = changed(
    slice(X1, Y2 + 1),
    lambda v: np.column_stack(
        [
            (v[:, X1 : Y1 + 1] + v[:, X2 : Y2 + 1]) / 2,
            v[:, X2 : Y2 + 1] - v[:, X1 : Y1 + 1],
        ]
    ),
)
MISTAKES: dict[str, tuple[Mistake, str, str]] = {
    "h and l swapped": (SIZES_BACK, "sizes", "written as length, width, height"),
    "w and l swapped": (written((W, L), (L, W)), "sizes", "written as height, length, width"),
    "l h w": (
        written((H, L), (W, H), (L, W)),
        "sizes",
        "written as length, height, width",
    ),
    "y in the middle": (TO_MIDDLE, "heights", "seems to be the middle of the box"),
    "y below": (
        changed(Y, lambda v: v[:, Y] + v[:, H] / 2),
        "heights",
        "half a height below the bottom",
    ),
    "millimetres": (MILLIMETRES, "units", "sizes and places of Car are 1000 times"),
    "sizes in centimetres": (
        changed(slice(H, L + 1), lambda v: 100 * v[:, H : L + 1]),
        "units",
        "sizes of Car are 100 times those of their labels (centimetres?)",
    ),
    "x and z swapped": (written((X, Z), (Z, X)), "places", "written as z, y, x"),
    "the LiDAR's axes": (TO_LIDAR, "places", "written as z, -x, -y (the LiDAR's axes?)"),
    "from the ground": (changed(Y, lambda v: v[:, Y] - 2.5), "places", "by +0.00, -2.50, +0.00 m"),
    "a LiDAR's yaw": (TO_YAW, "headings", "a LiDAR's yaw"),
    "a quarter": (changed(RY, lambda v: v[:, RY] + math.pi / 2), "headings", "by a quarter"),
    "x1 and x2 swapped": (written((X1, X2), (X2, X1)), "picture", "when read as x2 y1 x1 y2"),
    "x y w h": (AS_CORNER, "picture", "when read as x y w h, x y the upper left corner"),
    "x y w h of the middle": (AS_MIDDLE, "picture", "when read as x y w h, x y the middle"),
    "half the picture": (
        changed(slice(X1, Y2 + 1), lambda v: v[:, X1 : Y2 + 1] / 2),
        "picture",
        "of pictures scaled by 0.5 x 0.5;",
    ),
    "another camera": (
        changed(slice(X1, Y2 + 1), lambda v: v[:, X1 : Y2 + 1] + 2000),
        "picture",
        "projected with another P2?",
    ),
    "scores negated": (changed(SCORE, lambda v: -v[:, SCORE]), "scores", "the wrong way round"),
    "no 2D boxes, h and l": (both(SIZES_BACK, FLAT), "sizes", "length, width, height"),
    "no 2D boxes, y": (both(TO_MIDDLE, FLAT), "heights", "the middle of the box"),
    "no 2D boxes, yaw": (both(TO_YAW, FLAT), "headings", "a LiDAR's yaw"),
    "no 2D boxes, millimetres": (both(MILLIMETRES, FLAT), "units", "1000 times"),
}
HONEST: dict[str, Mistake] = {
    "as they are": lambda v: v,
    "headings turned round": changed(RY, lambda v: v[:, RY] + math.pi),
    "the same boxes along their width": changed(
        slice(W, RY + 1),
        lambda v: np.column_stack([v[:, [L, W, X, Y, Z]], v[:, RY] + math.pi / 2]),
    ),
    "without 2D boxes": FLAT,
    "without 3D boxes": changed(slice(H, RY + 1), lambda v: np.full((len(v), 7), -1000.0)),
    "logarithms of scores": changed(SCORE, lambda v: np.log(v[:, SCORE])),
    "a metre off in depth, at random": changed(Z, lambda v: v[:, Z] + np.sin(1000 * v[:, X])),
    "all of one score": changed(SCORE, lambda v: np.ones(len(v))),
}


@pytest.fixture(scope="module")
def gt(simulated: Path) -> LabelTable:
    labels = simulated / "training" / "label_2"
    return read_table(labels, sorted(path.stem for path in labels.glob("*.txt")), scored=False)


@pytest.fixture(scope="module")
def det(gt: LabelTable) -> LabelTable:
    """Every car as it is labelled, and false alarms of lower scores where nothing is."""
    frames = []
    for frame in range(len(gt)):
        rows = slice(gt.offsets[frame], gt.offsets[frame + 1])
        cars = gt.values[rows][gt.of("Car")[rows]].copy()
        cars[:, SCORE] = 0.9 - 0.01 * np.arange(len(cars))
        alarms = np.zeros((ALARMS, 15))
        alarms[:, X1 : Y2 + 1] = [[20 * i, 5, 20 * i + 15, 25] for i in range(ALARMS)]  # the sky
        alarms[:, H : RY + 1] = [[1.5, 1.6, 3.9, 200 + 10 * i, 1.6, 300, 0] for i in range(ALARMS)]
        alarms[:, SCORE] = 0.3
        values = np.concatenate([cars, alarms])
        frames.append(labels_from_columns(["Car"] * len(values), values, scored=True))
    return table_from_labels(frames)


def told(gt: LabelTable, det: LabelTable, convert: Mistake, protocol: str = "kitti") -> list[str]:
    """Kind and text of what is found."""
    wrong = replace(det, values=np.ascontiguousarray(convert(det.values)))
    found = find_mistakes(compare(gt, wrong, read_protocol(protocol)))
    return [f"{one.kind}: {one.text}" for one in found]


def test_there_is_enough_to_tell_by(gt: LabelTable, det: LabelTable) -> None:
    assert gt.of("Car").sum() >= 30
    assert len(gt) * ALARMS >= 30


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_with_what_it_is(gt: LabelTable, det: LabelTable, name: str) -> None:
    convert, kind, text = MISTAKES[name]
    (line,) = told(gt, det, convert)
    assert line.startswith(f"{kind}: ")
    assert text in line
    assert "KITTI" in line or "P2" in line


@pytest.mark.parametrize("name", HONEST)
def test_honest_results_are_not_suspected(gt: LabelTable, det: LabelTable, name: str) -> None:
    for protocol in ("kitti", "lidar"):
        assert told(gt, det, HONEST[name], protocol) == []


def test_without_the_picture_2d_boxes_are_not_judged(gt: LabelTable, det: LabelTable) -> None:
    assert told(gt, det, AS_CORNER, "lidar") == []
    assert len(told(gt, det, both(AS_CORNER, TO_YAW), "lidar")) == 1


def test_two_mistakes_are_two_lines(gt: LabelTable, det: LabelTable) -> None:
    lines = told(gt, det, both(TO_MIDDLE, TO_YAW, changed(SCORE, lambda v: -v[:, SCORE])))
    assert [line.partition(":")[0] for line in lines] == ["heights", "headings", "scores"]


def test_results_that_all_stand_at_the_origin_are_no_error(gt: LabelTable, det: LabelTable) -> None:
    """Without 2D boxes either there are no pairs, and a median distance of 0 has no logarithm."""
    nowhere = changed(slice(X, Z + 1), lambda v: np.zeros((len(v), 3)))
    assert told(gt, det, both(FLAT, nowhere), "lidar") == []


def test_few_results_are_not_judged(gt: LabelTable, det: LabelTable) -> None:
    """Nine pairs; a median of them may be anything."""
    others = np.ones(len(det.values), dtype=bool)
    others[np.flatnonzero(det.scores > 0.5)[:9]] = False
    few = det.values.copy()
    few[others, H : RY + 1] = -1000.0
    assert told(gt, replace(det, values=few), SIZES_BACK) == []


def write(folder: Path, gt_ids: Sequence[str], det: LabelTable, convert: Mistake) -> Path:
    folder.mkdir(parents=True)
    values = convert(det.values)
    for frame, frame_id in enumerate(gt_ids):
        rows = values[det.offsets[frame] : det.offsets[frame + 1]]
        (folder / f"{frame_id}.txt").write_text(
            "".join("Car " + " ".join(f"{value:.9g}" for value in row) + "\n" for row in rows)
        )
    return folder


@pytest.fixture(scope="module")
def folders(
    simulated: Path, det: LabelTable, tmp_path_factory: pytest.TempPathFactory
) -> dict[str, Path]:
    """Labels, honest results, and those of two mistakes."""
    labels = simulated / "training" / "label_2"
    ids = sorted(path.stem for path in labels.glob("*.txt"))
    root = tmp_path_factory.mktemp("mistakes")
    results = {"honest": lambda v: v, "sizes": SIZES_BACK}
    results["swapped"] = written((X1, X2), (X2, X1))
    results["nearly"] = changed(SCORE, lambda v: v[:, SCORE] / 2)
    results["again"] = both(SIZES_BACK, results["nearly"])
    made = {name: write(root / name, ids, det, convert) for name, convert in results.items()}
    return {"labels": labels, **made}


def test_evaluate_warns_on_stderr(folders: dict[str, Path], capsys: Printed) -> None:
    code, out, err = evaluate(capsys, folders["labels"], folders["sizes"])
    assert code == 0
    assert "fl3d: warning: sizes of Car seem to be written as length, width, height: " in err
    assert "seem" not in out
    code, _, err = evaluate(capsys, folders["labels"], folders["honest"])
    assert "seem" not in err


def test_compare_warns_once_a_detector_and_before_it_refuses(
    folders: dict[str, Path], capsys: Printed
) -> None:
    words = f"theirs={folders['honest']},{folders['nearly']}"
    wrong = f"ours={folders['sizes']},{folders['again']}"
    main(["compare", str(folders["labels"]), words, wrong])
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("fl3d: warning: ours: sizes of Car seem to be written as length, width")
    assert line.endswith("(so in 2 of its runs)")
    alone = f"a={folders['swapped']}"
    with pytest.raises(SystemExit):  # no 2D box that is one: nothing can be compared
        main(["compare", str(folders["labels"]), alone, f"b={folders['honest']}"])
    err = capsys.readouterr().err
    assert "fl3d: warning: a: 2D boxes of" in err
    assert "nothing to compare" in err


def test_python_is_warned_too(folders: dict[str, Path]) -> None:
    """Of mistakes alone, in the line that calls; whoever gives ``warn`` is told what the command prints."""
    with pytest.warns(fl3d.ResultsWarning) as warned:
        found = fl3d.evaluate(folders["labels"], folders["sizes"])
    (one,) = warned
    assert str(one.message).startswith("sizes of Car seem to be written as")
    assert one.filename == __file__
    lines: list[str] = []
    fl3d.evaluate(folders["labels"], folders["sizes"], warn=lines.append)
    assert [line[:26] for line in lines] == [
        "no result is a Pedestrian ",
        "sizes of Car seem to be wr",
    ]
    assert [one.kind for one in found.mistakes] == ["sizes"]
    pair = {"ours": folders["sizes"], "theirs": folders["honest"]}
    with pytest.warns(fl3d.ResultsWarning, match="ours: sizes of Car seem to be written as"):
        compared = fl3d.compare(folders["labels"], pair)
    assert len(compared.held.warnings) == 1


def real_results(
    eval_cases: Path, kitti: Path, case: str, root: Path, ids: list[str]
) -> LabelTable:
    """A published detector's results on the validation split."""
    if case == "rgb2d_val":
        rows: dict[str, list[list[float]]] = {frame_id: [] for frame_id in ids}
        text = (kitti / "rgb_detections" / "rgb_detection_val.txt").read_text()
        for path, kind, score, *box in map(str.split, text.splitlines()):
            if kind == "2":
                values = [0, 0, -10, *map(float, box), *[0.0] * 7, float(score)]
                rows[Path(path).stem].append(values)
        return table_from_labels(
            [
                labels_from_columns(["Car"] * len(r), np.array(r).reshape(-1, 15), scored=True)
                for r in rows.values()
            ]
        )
    with zipfile.ZipFile(eval_cases / case / "detections.zip") as archive:
        archive.extractall(root)
    return read_table(next(root.rglob("*.txt")).parent, ids, scored=True)


@pytest.mark.parametrize("case", ["pointgnn_val", "m3drpn_val", "rgb2d_val"])
def test_published_detectors_are_not_suspected_and_their_mistakes_are_told(
    eval_cases: Path, kitti_sample: Path, tmp_path: Path, case: str
) -> None:
    ids = KittiFolder(kitti_sample).split("val")
    real = read_table(kitti_sample / "training" / "label_2", ids, scored=False)
    found = real_results(eval_cases, kitti_sample, case, tmp_path, ids)
    for convert in (HONEST["as they are"], FLAT):
        assert told(real, found, convert) == []
    negated = told(real, found, changed(SCORE, lambda v: -v[:, SCORE]))
    assert len(negated) == {"pointgnn_val": 1, "m3drpn_val": 3, "rgb2d_val": 1}[case]
    if case != "rgb2d_val":
        for name in ("h and l swapped", "y in the middle", "a LiDAR's yaw", "x y w h"):
            convert, kind, text = MISTAKES[name]
            first = told(real, found, convert)[0]
            assert first.startswith(f"{kind}: ")
            assert text in first


def test_real_labels_are_not_suspected_of_anything(kitti_sample: Path) -> None:
    folder = kitti_sample / "training" / "label_2"
    ids = sorted(path.stem for path in folder.glob("*.txt"))
    real = read_table(folder, ids, scored=False)
    assert told(real, real, HONEST["as they are"]) == []
    assert told(real, real, FLAT) == []
