"""`python -m fl3d compare`, called in this process."""

import csv
from pathlib import Path

import pytest

from fl3d.cli import main
from tests.analysis.result_files import car, runs, write_labels_of, write_results

Printed = pytest.CaptureFixture[str]


def compare(capsys: Printed, *words: object) -> tuple[int | str | None, str, str]:
    """Exit code, stdout and stderr of the command."""
    code: int | str | None = 0
    try:
        main(["compare", *map(str, words)])
    except SystemExit as stop:
        code = stop.code
    out, err = capsys.readouterr()
    return code, out, err


def rows_of(out: str) -> list[list[str]]:
    lines = [line for line in out.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in lines]


@pytest.fixture
def three(tmp_path: Path) -> list[str]:
    """Labels, a detector of three runs, and one that finds twice as much and has an awkward name."""
    few, many = runs(tmp_path, "few", [10, 10, 10]), runs(tmp_path, "many", [20, 20, 20])
    words = [",".join(map(str, one.folders)) for one in (few, many)]
    return [
        str(write_labels_of(tmp_path)),
        f"few={words[0]}",
        rf"50% $m$ <b>_{{ours}}^2~\x={words[1]}",
    ]


def test_tables_fit_a_terminal_and_can_be_pasted(tmp_path: Path, capsys: Printed) -> None:
    labels = write_labels_of(tmp_path)
    folders = [write_results(tmp_path / name, n) for name, n in (("few", 10), ("a" * 40, 20))]
    code, out, _ = compare(capsys, labels, *folders)
    assert code == 0
    assert max(map(len, out.splitlines())) <= 100
    rows = rows_of(out)
    assert rows[0] == ["", "objects", "detector", "R40", "gain in R40", "R11"]
    assert rows[2] == ["3D easy", "20", "few", "22.50", "baseline", "27.27"]
    assert rows[3][2:4] == ["aaaaaaa…aaaaaaa", "47.50"]
    assert rows[3][4].startswith("+25.00 [")
    assert rows[-1][-1] == "frames only, not training"
    assert "One run of each says what these two would do on other such frames" in " ".join(
        out.split()
    )
    assert "taken as independent" in out


def test_a_misspelt_class_is_warned_of(three: list[str], capsys: Printed) -> None:
    code, _, err = compare(capsys, *three, "--overlaps", "Cra=0.5,0.5,0.5")
    assert code == 0
    assert err == (
        "fl3d: warning: no label or result is of class Cra, so its overlaps change nothing. Did you mean 'Car'? "
        "There are: Car\n"
    )


def test_a_folder_without_a_mapping_is_refused(
    three: list[str], tmp_path: Path, capsys: Printed
) -> None:
    code, out, err = compare(capsys, *three, "--mapping", tmp_path)
    assert (code, out) == (2, "")
    assert f"{tmp_path}: holds no mapping of frames to drives" in err
    assert "train_rand.txt and train_mapping.txt" in err


def test_three_runs_have_a_verdict(three: list[str], capsys: Printed) -> None:
    labels, few, many = three
    code, out, _ = compare(capsys, labels, few, "--classes", "Car", many)  # in any order
    assert code == 0
    assert rows_of(out)[-1][-1] == "**better**"
    assert rows_of(out)[3][4].endswith(r"\*")  # all cells at once


def test_the_folder_holds_tables_of_three_kinds_and_a_page(
    three: list[str], tmp_path: Path, capsys: Printed
) -> None:
    out = tmp_path / "out"
    code, printed, err = compare(capsys, *three, "--out", out)
    assert code == 0, err
    assert f"Written to {out / 'compare.html'}" in printed
    latex = (out / "compare.tex").read_text()
    name = r"50\% \$m\$ $<$b$>$\_\{ours\}\textasciicircum{}2\textasciitilde{}\textbackslash{}x"
    assert name in latex
    assert r"\textbf{47.50}\textsuperscript{*}" in latex
    assert "| few | 22.50 | 22.50 | 22.50 |" in (out / "compare.md").read_text()
    with (out / "compare.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["detector"] != "few"]
    assert len(rows) == 18  # three metrics, three difficulties, two averages
    assert {float(row["gain"]) for row in rows if row["average"] == "R40"} == {25.0}
    page = (out / "compare.html").read_text()
    assert "<b>_" not in page
    assert "&lt;b&gt;_{ours}" in page
    assert "src='http" not in page
    for title in ("Verdict", "AP", "Precision and recall", "Where they differ", "Frames"):
        assert f"<h2>{title}</h2>" in page
    assert page.count("data:image/webp;base64,") == 4  # forest, curves, parts, frames gained
    figures = {path.stem for path in (out / "figures").iterdir()}
    assert figures == {"forest", "precision_recall", "found_car", "frames_car_1_more"}


def test_clouds_and_pictures_come_onto_the_page(
    simulated: Path, tmp_path: Path, capsys: Printed
) -> None:
    training = simulated / "training"
    folders = []
    for number, every in ((0, 1), (1, 2)):
        folder = tmp_path / f"d{number}"
        folder.mkdir()
        for path in (training / "label_2").iterdir():
            lines = [
                f"{line} 0.{9 - i % 9}" for i, line in enumerate(path.read_text().splitlines())
            ]
            (folder / path.name).write_text("".join(f"{line}\n" for line in lines[::every]))
        folders.append(folder)
    clouds = ("--clouds", training / "velodyne")
    out = tmp_path / "out"
    code, _, err = compare(capsys, training / "label_2", *folders, "--out", out, *clouds)
    assert code == 0, err
    assert "points on it,from 500" in (out / "figures" / "found_car.csv").read_text()
    code, _, err = compare(capsys, training / "label_2", *folders, *clouds)
    assert (code, "--out" in err) == (2, True)
    (tmp_path / "none").mkdir()
    wrong = ("--out", out, "--clouds", tmp_path / "none")
    code, _, err = compare(capsys, training / "label_2", *folders, *wrong)
    assert code == 2
    assert "10 of 10 frames have no clouds here" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["few={root}/few0"], "a comparison needs two detectors"),
        (["few={root}/few0", "few={root}/many0"], "two detectors are named 'few'"),
        (["few={root}/few0", "x={root}/gone"], "gone: no such folder"),
        (["few={root}/few0", "{root}/many0,{root}/many1"], "need its name"),
        (["few={root}/few0", "m={root}/many0", "--baseline", "n"], "Possible: few, m"),
        (["few={root}/few0", "m={root}/many0", "--classes", "Truck"], "Possible: Car, Cyclist"),
        (["few={root}/few0", "m={root}/many0", "--margin", "-1"], "not a number of AP above 0"),
        (["few={root}/few0", "m={root}/many0", "--split", "{root}/gone"], "gone: no such file"),
        (["few={root}/few0", "m={root}/many0", "--protocol", "voc"], "invalid choice: 'voc'"),
        (["few={root}/few0", "m={root}/many0", "--out", "/proc/nowhere"], "cannot be written"),
    ],
)
def test_a_mistake_is_one_sentence(
    words: list[str], message: str, three: list[str], tmp_path: Path, capsys: Printed
) -> None:
    code, _, err = compare(capsys, three[0], *(word.format(root=tmp_path) for word in words))
    assert code == 2
    assert message in err
    assert len(err.splitlines()) == 1 or err.startswith("usage:")


def test_false_alarms_are_drawn_where_a_detector_loses(tmp_path: Path, capsys: Printed) -> None:
    """In ten frames it sees a second car that is not there."""
    labels = write_labels_of(tmp_path)
    good, bad = write_results(tmp_path / "good", 20), write_results(tmp_path / "bad", 20)
    for number in range(10):
        path = bad / f"{number:06d}.txt"
        path.write_text(f"{path.read_text()}{car(x=8.0)} 0.95\n")
    out = tmp_path / "out"
    assert compare(capsys, labels, good, bad, "--out", out)[0] == 0
    assert (out / "figures" / "frames_car_1_less.png").exists()
    assert not (out / "figures" / "frames_car_1_more.png").exists()
