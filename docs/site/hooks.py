"""What the site is made of: pages lie where they lie in the repository, so that their links hold in both places.

MkDocs looks for pages in one folder. Here it is given the README, ``docs/``, and the other pages that these link to,
with the pictures and files beside them. Reference pages have a mark, which gives way to what ``reference`` makes of the
code.
"""

from __future__ import annotations

import re
from pathlib import Path

import reference
from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files
from mkdocs.structure.pages import Page

ROOT = Path(__file__).resolve().parent.parent.parent
SHOWN = (
    *("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "LICENSE"),
    *("docs/*.md", "docs/*.png", "docs/*.py"),
    *("benchmarks/README.md", "benchmarks/*.png"),
    *("results/README.md", "results/*/figures/*.png"),
    *("conf/*/*.yaml", "conf/hydra/launcher/*.yaml", "sweeps/*.yaml"),
    *("examples/*.ipynb", "examples/*/*.py", "examples/*/*/*.yaml"),
)
STYLE = "docs/site/extra.css"
MARK = re.compile(r"<!-- generated: (\w+) -->")


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The theme's own files, and those of the repository that are shown."""
    theirs = [file for file in files if file.src_dir != config.docs_dir]
    shown = {path for pattern in SHOWN for path in ROOT.glob(pattern)} | {ROOT / STYLE}
    ours = [file_of(path, config) for path in sorted(shown)]
    return Files([*theirs, *ours])


def file_of(path: Path, config: MkDocsConfig) -> File:
    """A file of the repository, at the same place in the site."""
    return File(
        path.relative_to(ROOT).as_posix(),
        src_dir=str(ROOT),
        dest_dir=config.site_dir,
        use_directory_urls=config.use_directory_urls,
    )


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """A page with what the code says in place of its mark."""
    return MARK.sub(lambda match: reference.PARTS[match[1]](), markdown)
