"""Golden test: a store filled with the paper's own numbers gives its Tables II, III and IV back, cell by cell."""

import csv
import io
from pathlib import Path

import pandas as pd
import pytest

from fl3d.errors import ConfigError, StoreError
from fl3d.reports.published import published_table
from fl3d.reports.render import to_csv, to_latex, to_markdown
from fl3d.reports.selection import select
from fl3d.reports.table import AP_COLUMNS, Table
from fl3d.reports.tables import format_lr, make_tables
from fl3d.reports.write import NAMED, read_scores, scores_path, tidy, write_results
from fl3d.store.tracking import Scored, Store

LAST_STEP, FORK = 222_720, 111_360
STEPS = {"126k": 126_208, "137k": 137_344, "134k": 133_632, "215k": 215_296}  # whole epochs of 3712 steps
GAMMA = ("II", "III", "IV")
BASE_LR = {"3D-FCN": 0.01, "VoxelNet": 0.0001}


def aps(row: pd.Series) -> dict[str, float]:
    return {metric: float(row[column]) for column, metric in AP_COLUMNS.items()}


@pytest.fixture(scope="module")
def papers_store(tmp_path_factory: pytest.TempPathFactory) -> Store:
    """Every published last model at its last step; every published best model at its own."""
    store = Store(tmp_path_factory.mktemp("paper"))
    store.open()
    experiment = store.experiment("gamma-kitti-paper", "")
    last = pd.concat([published_table("II"), published_table("III")])
    best = published_table("IV")
    for _, row in last.iterrows():
        detector, gamma = row["detector"], row["gamma"]
        tags = {"detector": detector, "fl3d.first_own_step": str(FORK)}
        params = {"seed": 0, "optimizer.lr": BASE_LR[detector], "loss.gamma": gamma}
        params |= {"loss.alpha": 1, "loss.beta": 5, "loss.eta": 10, "loss.normalize": True}
        run = store.run(experiment, f"{detector}-{gamma}", "paper-x", f"{detector} {gamma}", tags, params)
        store.log(run, Scored(LAST_STEP, 1, {**aps(row), "epoch": 60}))
        store.log(run, Scored(3712, 1, {**dict.fromkeys(AP_COLUMNS.values(), 99.0), "epoch": 1}))  # in the warm-up
        for _, found in best[(best["detector"] == detector) & (best["gamma"] == gamma)].iterrows():
            store.log(run, Scored(STEPS[found["step"]], 1, {**aps(found), "epoch": 34}))
    return store


@pytest.fixture(scope="module")
def scores(papers_store: Store) -> pd.DataFrame:
    return tidy(papers_store.read("gamma-kitti-paper", list(NAMED)))


@pytest.fixture(scope="module")
def tables(scores: pd.DataFrame) -> dict[str, Table]:
    return {table.number: table for table in make_tables(scores)}


@pytest.mark.parametrize("number", ["II", "III", "IV"])
def test_the_papers_numbers_give_the_papers_table(tables: dict[str, Table], number: str) -> None:
    published, table = published_table(number), tables[number]
    assert len(table.rows) == len(published)
    for row, (_, expected) in zip(table.rows, published.iterrows(), strict=True):
        cells = dict(zip([column.key for column in table.columns], row, strict=True))
        for column in AP_COLUMNS:
            assert cells[column].text == expected[column]
            assert cells[column].bold == (expected[f"{column}_bold"] == "1"), (expected["gamma"], column)
        for column in set(cells) - set(AP_COLUMNS):
            assert cells[column].text == expected[column]


def test_csv_has_the_documented_columns_and_plain_numbers(tables: dict[str, Table]) -> None:
    ap_columns = "bev_easy,bev_moderate,bev_hard,3d_easy,3d_moderate,3d_hard"
    assert to_csv(tables["II"]).splitlines()[0] == f"gamma,{ap_columns}"
    rows = list(csv.DictReader(io.StringIO(to_csv(tables["IV"]))))
    assert list(rows[0]) == ["detector", "lr", "step", "gamma", *ap_columns.split(",")]
    assert (rows[0]["lr"], rows[0]["step"]) == ("0.01", "126208")


def test_markdown_sets_bold_and_order_as_the_paper(tables: dict[str, Table]) -> None:
    text = to_markdown(tables["IV"])
    assert "| Detector | γ | lr | Step | BEV Easy |" in text
    assert "| 3D-FCN | 2 | 1e-2 | 137k | **53.19** |" in text
    assert "| **58.39** | 57.60 |" in text


def test_latex_has_the_papers_heads(tables: dict[str, Table]) -> None:
    text = to_latex(tables["III"])
    assert r"\multicolumn{3}{c}{3D Detection AP (\%)}" in text
    assert r"0.1 & \textbf{85.93} &" in text
    assert text.count(r"\\") == 2 + 7
    assert text.count("{") == text.count("}")


def test_last_is_the_final_step_and_best_ignores_the_shared_warmup(scores: pd.DataFrame) -> None:
    assert set(select(scores, "last")["step"]) == {LAST_STEP}
    assert (select(scores, "best")["step"] > FORK).all()
    assert set(select(scores, "best", stages="all")["step"]) == {3712}


def test_the_earliest_of_equals_is_best() -> None:
    frame = pd.DataFrame({"trial": ["a"] * 3, "step": [3, 1, 2], "first_own_step": 0})
    for metric in AP_COLUMNS.values():
        frame[metric] = [5.0, 4.0, 5.0]
    assert select(frame, "best")["step"].tolist() == [2]


def test_equal_is_not_better() -> None:
    frame = twins(gamma=[0.0, 1.0])
    for metric in AP_COLUMNS.values():
        frame[metric] = [50.0, 50.001]  # prints alike
    table = make_tables(frame)[0]
    assert not any(cell.bold for row in table.rows for cell in row)


def twins(**columns: object) -> pd.DataFrame:
    """Two trials of VoxelNet with gamma = 0."""
    plain = {"trial": ["a", "b"], "step": [800, 1000], "first_own_step": 0, "detector": "VoxelNet", "gamma": 0.0}
    frame = pd.DataFrame(plain | {"seed": 0, "lr": 0.1, "alpha": 1.0, "beta": 1.0, "eta": 1.0} | columns)
    for metric in AP_COLUMNS.values():
        frame[metric] = [1.0, 2.0]
    return frame


def test_seeds_are_averaged() -> None:
    tables = make_tables(twins(seed=[0, 1]))
    assert [cell.text for cell in tables[0].rows[0]] == ["0", *["1.50"] * 6]
    assert tables[1].column("step")[0].text == "800/1000"


def test_twins_are_refused_by_what_they_differ_in() -> None:
    with pytest.raises(ConfigError, match="differ in alpha"):
        make_tables(twins(alpha=[1.0, 2.0]))


def test_unknown_rules_are_named(scores: pd.DataFrame) -> None:
    with pytest.raises(ConfigError, match=r"selection\.rule.*best, last"):
        select(scores, "final")


@pytest.mark.parametrize(("value", "text"), [(0.01, "1e-2"), (0.0001, "1e-4"), (0.0025, "2.5e-3"), (1.0, "1e0")])
def test_learning_rates_print_as_in_the_paper(value: float, text: str) -> None:
    assert format_lr(value) == text


def test_a_results_folder_makes_its_tables_again_from_its_scores(scores: pd.DataFrame, tmp_path: Path) -> None:
    _, first = write_results(scores, tmp_path / "a", "gamma", GAMMA, "last", ("a note",))
    again = read_scores(scores_path(tmp_path / "a", "gamma"))
    _, second = write_results(again, tmp_path / "b", "gamma", GAMMA, "last", ("a note",))
    assert len(first) == len(second) > 10
    for a, b in zip(first, second, strict=True):
        assert a.read_bytes() == b.read_bytes(), a.name


def test_figures_carry_their_data(scores: pd.DataFrame, tmp_path: Path) -> None:
    write_results(scores, tmp_path, "gamma", GAMMA, "last", ())
    data = pd.read_csv(tmp_path / "figures" / "ap_over_gamma.csv")
    assert len(data) == 14
    assert data["ap_3d/moderate"].max() == pytest.approx(58.28)


def test_a_folder_shows_one_set_of_scores(scores: pd.DataFrame, tmp_path: Path) -> None:
    write_results(scores, tmp_path, "gamma", GAMMA, "last", ())
    (tmp_path / "tables" / "table_III_intervals.md").touch()  # of the scores before
    write_results(scores[scores["detector"] == "VoxelNet"], tmp_path, "gamma", GAMMA, "last", ())
    assert sorted(path.name for path in (tmp_path / "tables").glob("*.md")) == ["table_III.md", "table_IV.md"]


def test_missing_scores_say_what_to_do(tmp_path: Path) -> None:
    with pytest.raises(StoreError, match="run the sweep first"):
        read_scores(tmp_path / "scores.csv")
