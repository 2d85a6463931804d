"""The page needs no network, and fits a phone."""

import re
import shutil
import subprocess
from pathlib import Path

import pytest

from fl3d.reports.page import Section, folded, link, listing, page, paragraph, picture, preformatted
from fl3d.reports.render import to_html
from fl3d.reports.table import APS, Cell, Column, Table

DOT = bytes.fromhex("89504e470d0a1a0a")


def wide_table() -> Table:
    return Table(
        "II",
        "a long caption " * 10,
        APS,
        tuple((Cell("75.07 [69.9, 79.1]"),) * 6 for _ in range(3)),
    )


def sentences() -> Table:
    columns = tuple(Column(f"c{n}", f"column {n}") for n in range(6))
    return Table("claims", "Claims", columns, ((Cell("a sentence of some length"),) * 6,) * 3)


def a_page() -> str:
    sections = [
        Section("In short", (listing(["a & b"]), paragraph("1 < 2"))),
        Section("Tables", (to_html(wide_table()), folded("more", to_html(wide_table())))),
        Section("Claims of the paper", (to_html(sentences()), picture(DOT, "a dot"))),
        Section("Plan", (preformatted("python -m fl3d\n" + "x" * 300),)),
    ]
    return page("gamma: <simulated>", "Does it?", sections)


def test_the_page_is_self_contained_and_its_links_lead_somewhere() -> None:
    text = a_page()
    assert not re.findall(r"(?:src|href)='(?!data:|#)", text)
    anchors = re.findall(r"href='#([^']+)'", text)
    assert len(anchors) == 4
    for anchor in anchors:
        assert f"id='{anchor}'" in text
    assert "gamma: &lt;simulated&gt;" in text
    assert "a &amp; b" in text
    assert "1 &lt; 2" in text
    assert "viewport" in text


def test_a_link_cannot_end_its_own_address() -> None:
    assert link("http://x/'y", "z < 1") == "<p><a href='http://x/&#x27;y'>z &lt; 1</a></p>"


@pytest.mark.slow
@pytest.mark.skipif(shutil.which("chromium") is None, reason="no chromium here")
def test_nothing_is_wider_than_a_phone(tmp_path: Path) -> None:
    (tmp_path / "inner.html").write_text(a_page())
    frame = (
        "<iframe id=f src=inner.html style='width:360px;height:700px;border:0'></iframe>"
        "<script>onload=()=>{"
        "document.title=document.getElementById('f').contentDocument.documentElement.scrollWidth}"
        "</script>"
    )
    (tmp_path / "outer.html").write_text(frame)
    command = ["chromium", "--headless", "--no-sandbox", "--disable-gpu"]
    command += ["--allow-file-access-from-files", "--dump-dom"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", f"file://{tmp_path / 'outer.html'}"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    (width,) = re.findall(r"<title>(\d+)</title>", done.stdout)
    assert 300 <= int(width) <= 360
