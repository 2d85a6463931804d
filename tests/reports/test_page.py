"""The page needs no network, fits a phone, and what choosing the best is worth is reckoned by hand."""

import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from fl3d.reports.claims import best_claim, claims_table, gain_claims, published_last, step_claims
from fl3d.reports.honest import best_of_k, honest_table, split_half
from fl3d.reports.page import Section, folded, listing, page, picture
from fl3d.reports.published import published_table
from fl3d.reports.render import to_html, to_markdown
from fl3d.reports.table import AP_COLUMNS, APS, Cell, Table


def wide_table() -> Table:
    return Table("II", "a long caption " * 10, APS, tuple((Cell("75.07 [69.9, 79.1]"),) * 6 for _ in range(3)))


def a_page(tmp_path: Path) -> str:
    dot = tmp_path / "dot.png"
    dot.write_bytes(bytes.fromhex("89504e470d0a1a0a"))
    sections = [
        Section("In short", (listing(["a & b"]),)),
        Section("Tables", (to_html(wide_table()), folded("more", to_html(wide_table())))),
        Section("Claims of the paper", (to_html(claims_table(step_claims())), picture(dot, "a dot"))),
    ]
    return page("gamma: <simulated>", "Does it?", sections)


def test_the_page_is_self_contained_and_its_links_lead_somewhere(tmp_path: Path) -> None:
    text = a_page(tmp_path)
    assert not re.findall(r"(?:src|href)='(?!data:|#)", text)
    for anchor in re.findall(r"href='#([^']+)'", text):
        assert f"id='{anchor}'" in text
    assert "gamma: &lt;simulated&gt;" in text
    assert "a &amp; b" in text
    assert "viewport" in text


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium here")
def test_nothing_is_wider_than_a_phone(tmp_path: Path) -> None:
    inner = a_page(tmp_path)
    (tmp_path / "inner.html").write_text(inner)
    frame = (
        "<iframe id=f src=inner.html style='width:360px;height:700px;border:0'></iframe><script>onload=()=>{"
        "document.title=document.getElementById('f').contentDocument.documentElement.scrollWidth}</script>"
    )
    (tmp_path / "outer.html").write_text(frame)
    command = [
        "chromium",
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--allow-file-access-from-files",
        "--dump-dom",
    ]
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"file://{tmp_path / 'outer.html'}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    (width,) = re.findall(r"<title>(\d+)</title>", done.stdout)
    assert 300 <= int(width) <= 360


def test_the_papers_own_cells_give_its_claims() -> None:
    ours = {detector: published_last(detector) for detector in ("3D-FCN", "VoxelNet")}
    found = {(claim.text, claim.printed): claim for claim in gain_claims(ours)}
    largest = found["largest gain of 3D-FCN for 0 < γ ≤ 2", "11.2"]
    assert (largest.recomputed, largest.ours) == ("11.21", "11.21")
    assert largest.verdict == "printed correctly; higher in ours too"
    assert found["smallest gain of 3D-FCN for 0 < γ ≤ 2", "0.3"].recomputed == "0.38"
    assert found["largest loss of VoxelNet for γ = 0.2, 2", "2.7"].recomputed == "2.71"
    assert found["largest loss of VoxelNet for γ = 5", ""].recomputed == "7.21"


def test_a_store_without_a_detector_has_no_number_for_it() -> None:
    assert {claim.ours for claim in gain_claims({})} == {""}
    only = pd.DataFrame({column: [1.0] for column in AP_COLUMNS}, index=[2.0])  # no gamma = 0
    assert {claim.ours for claim in gain_claims({"VoxelNet": only})} == {""}


def test_not_all_metrics_of_the_best_models_improve() -> None:
    printed = published_table("IV").rename(columns=AP_COLUMNS)
    claim = best_claim(printed)
    assert (claim.recomputed, claim.ours) == ("11 of 12", "11 of 12")


def test_the_best_of_k_by_hand() -> None:
    """Of 1, 2, 3: mean 2; the best of two is 2, 3 and 3; of all three 3."""
    np.testing.assert_allclose(best_of_k(np.array([3.0, 1.0, 2.0])), [2, 8 / 3, 3])


def test_a_half_chooses_and_the_other_reports() -> None:
    means = np.array([[[1.0, 2.0]], [[5.0, 4.0]]])  # the first side chooses checkpoint 1, the second 0
    scores = np.array([[[10.0, 20.0]], [[30.0, 40.0]]])
    assert split_half(means, scores) == ((20 + 30) / 2, (40 + 10) / 2)


def test_last_best_and_honest_best_stand_side_by_side() -> None:
    rows = []
    for step, ap in ((10, 50.0), (20, 70.0), (30, 60.0)):
        plain = {"trial": "a", "detector": "VoxelNet", "gamma": 0.0, "seed": 0, "step": step, "first_own_step": 5}
        rows.append(plain | dict.fromkeys(AP_COLUMNS.values(), ap))
    halved = pd.DataFrame([{"trial": "a", "chosen": 72.0, "other": 66.0}])
    table = honest_table(pd.DataFrame(rows), halved, "last")
    assert [cell.text for cell in table.rows[0]] == [
        "VoxelNet",
        "0",
        "60.00",
        "60.00",
        "70.00",
        "72.00",
        "66.00",
        "+6.00",
    ]
    assert to_markdown(table).startswith("Last, best and honest best")
