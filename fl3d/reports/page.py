"""One HTML page that needs no network: sections of tables, figures and text; readable on a phone and on paper. Pure."""

from __future__ import annotations

import base64
import html
import io
from collections.abc import Sequence
from dataclasses import dataclass

from PIL import Image
from PIL.PngImagePlugin import PngImageFile

STYLE = """
:root {
  color-scheme: light dark;
  --ink: #1b1b1b; --paper: #fff; --faint: #555; --line: #bbb; --tint: #f4f4f4; --link: #0b57b0;
}
@media screen and (prefers-color-scheme: dark) {
  :root { --ink: #e4e4e4; --paper: #16181b; --faint: #a8a8a8; --line: #4a4d52; --tint: #22252a; --link: #8ab8f5; }
  figure img { background: #fff; padding: .5rem; border-radius: .4rem; filter: brightness(.9); }
}
* { box-sizing: border-box; }
body {
  font: 16px/1.5 system-ui, sans-serif; color: var(--ink); background: var(--paper);
  margin: 0 auto; max-width: 64rem; padding: 1rem; overflow-wrap: break-word;
}
a { color: var(--link); }
h1 { font-size: 1.6rem; line-height: 1.2; } h2 { margin-top: 2.5rem; border-bottom: 1px solid var(--line); }
nav { display: flex; flex-wrap: wrap; gap: .2rem .9rem; }
figure { margin: 1rem 0; } .scroll { overflow-x: auto; }
figure img { max-width: 100%; height: auto; display: block; margin: auto; }
figcaption { font-size: .9rem; margin: .4rem 0; }
table { border-collapse: collapse; font-size: .85rem; font-variant-numeric: tabular-nums; }
thead { border-top: 2px solid; border-bottom: 1px solid; } tbody { border-bottom: 2px solid; }
th, td { padding: .15rem .5rem; text-align: left; white-space: nowrap; }
.number { text-align: right; } .group { text-align: center; }
#table-claims td { white-space: normal; min-width: 7rem; vertical-align: top; }
.note { font-size: .8rem; color: var(--faint); margin: .3rem 0; } code, pre { font-size: .85rem; }
pre { overflow-x: auto; background: var(--tint); padding: .6rem; } summary { cursor: pointer; margin: .5rem 0; }
@media screen and (max-width: 40rem) {  /* letters of a figure stay legible: it is moved sideways as tables are */
  figure .scroll img { max-width: none; width: 40rem; }
}
@media print {
  body { max-width: none; font-size: 10pt; padding: 0; } nav, summary { display: none; }
  table { font-size: 7pt; } th, td { padding: .05rem .25rem; white-space: normal; } figure, tr { break-inside: avoid; }
  #table-claims td { min-width: 0; overflow-wrap: anywhere; }
  h2, summary { break-after: avoid; } .scroll { overflow: visible; } pre { white-space: pre-wrap; }
  a { color: inherit; text-decoration: none; }
}
"""
OPEN_ON_PAPER = (
    "onbeforeprint = () => document.querySelectorAll('details').forEach(d => d.open = true)"
)


@dataclass(frozen=True)
class Section:
    """A part of the page.

    Args:
        title: its heading.
        parts: HTML, one after the other.
    """

    title: str
    parts: tuple[str, ...]

    @property
    def anchor(self) -> str:
        """Where links to it point."""
        return "".join(c if c.isalnum() else "-" for c in self.title.lower())


def picture(image: bytes, caption: str, small: bytes | None = None) -> str:
    """A picture within the page, made small; every browser since 2020 shows WebP.

    Args:
        image: a PNG.
        caption: below it, and what is read out in its place.
        small: the same as ``made_small`` makes it; None: it is made now.
    """
    pixels = PngImageFile(io.BytesIO(image))
    data = base64.b64encode(made_small(image) if small is None else small).decode("ascii")
    text = html.escape(caption)
    size = (
        f"width='{pixels.width}' height='{pixels.height}'"  # the page stands still while it loads
    )
    return (
        f"<figure><div class='scroll'><img alt='{text}' {size} decoding='async' "
        f"src='data:image/webp;base64,{data}'></div>"
        f"<figcaption>{text}</figcaption></figure>"
    )


def made_small(image: bytes) -> bytes:
    """A PNG as WebP: a drawing to the bit; what holds photographs nearly so, where that halves it."""
    pixels: Image.Image = PngImageFile(io.BytesIO(image)).convert("RGB")
    drawing, photograph = io.BytesIO(), io.BytesIO()
    pixels.save(drawing, "WEBP", lossless=True, quality=40, method=2)
    pixels.save(photograph, "WEBP", quality=85, method=2)
    is_photograph = 2 * photograph.tell() < drawing.tell()
    return (photograph if is_photograph else drawing).getvalue()


def folded(title: str, part: str) -> str:
    """A part that is opened by a click, and open on paper."""
    return f"<details><summary>{html.escape(title)}</summary>{part}</details>"


def paragraph(text: str) -> str:
    """A paragraph of plain text."""
    return f"<p>{html.escape(text)}</p>"


def listing(items: Sequence[str]) -> str:
    """Items of plain text."""
    return "<ul>" + "".join(f"<li>{html.escape(item)}</li>" for item in items) + "</ul>"


def preformatted(text: str) -> str:
    """Text as it is."""
    return f"<pre>{html.escape(text)}</pre>"


def link(address: str, text: str) -> str:
    """A paragraph that is a link."""
    return f"<p><a href='{html.escape(address, quote=True)}'>{html.escape(text)}</a></p>"


def page(title: str, lead: str, sections: Sequence[Section]) -> str:
    """The whole document."""
    contents = "".join(
        f"<a href='#{section.anchor}'>{html.escape(section.title)}</a>" for section in sections
    )
    body = "\n".join(
        f"<section id='{section.anchor}'><h2>{html.escape(section.title)}</h2>\n"
        + "\n".join(section.parts)
        + "</section>"
        for section in sections
    )
    return (
        f"<!doctype html><html lang='en'><head><meta charset='utf-8'><title>{html.escape(title)}</title>"
        f"<meta name='viewport' content='width=device-width, initial-scale=1'><style>{STYLE}</style></head>\n"
        f"<body><h1>{html.escape(title)}</h1><p>{html.escape(lead)}</p><nav>{contents}</nav>\n{body}\n"
        f"<script>{OPEN_ON_PAPER}</script></body></html>\n"
    )
