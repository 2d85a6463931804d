"""The page needs no network, and fits a phone."""

import base64
import io
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from fl3d.reports.page import (
    Section,
    folded,
    link,
    listing,
    made_small,
    page,
    paragraph,
    picture,
    preformatted,
)
from fl3d.reports.render import to_html
from fl3d.reports.table import APS, Cell, Column, Table


def png(pixels: NDArray[np.uint8]) -> bytes:
    held = io.BytesIO()
    Image.fromarray(pixels).save(held, "PNG")
    return held.getvalue()


DOT = png(np.zeros((3, 5, 3), np.uint8))


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


def shown(image: bytes) -> NDArray[np.uint8]:
    """What a browser makes of a picture on the page."""
    (data,) = re.findall(r"src='data:image/webp;base64,([^']+)'", picture(image, ""))
    with Image.open(io.BytesIO(base64.b64decode(data))) as opened:
        return np.asarray(opened.convert("RGB"))


def test_a_drawing_is_shown_to_the_bit_and_a_photograph_nearly_and_small() -> None:
    drawing = np.full((60, 90, 3), 255, np.uint8)
    drawing[20:22, 10:80] = (31, 95, 191)
    assert np.array_equal(shown(png(drawing)), drawing)
    rng = np.random.default_rng(0)
    smooth = np.linspace(0, 200, 120)[:, None, None] + np.linspace(0, 40, 160)[None, :, None]
    photograph = (smooth + rng.normal(0, 3, (120, 160, 3))).clip(0, 255).astype(np.uint8)
    seen = shown(png(photograph))
    assert not np.array_equal(seen, photograph)
    assert np.abs(seen.astype(int) - photograph).mean() < 5
    assert len(picture(png(photograph), "")) < len(png(photograph))


def test_a_picture_that_was_made_small_before_is_the_same() -> None:
    assert picture(DOT, "a dot", made_small(DOT)) == picture(DOT, "a dot")


def test_a_picture_keeps_its_place_while_the_page_loads() -> None:
    assert "width='5' height='3'" in picture(DOT, "a dot")


def test_the_page_has_colours_for_the_dark_and_none_of_them_on_paper() -> None:
    text = a_page()
    assert "color-scheme: light dark" in text
    assert "@media screen and (prefers-color-scheme: dark)" in text


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
