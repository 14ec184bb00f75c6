"""What the theme leaves out of its pages: levels of headings, names of landmarks, keys for what scrolls."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sphinx.application import Sphinx

MENDED = {
    'role="heading">': 'role="heading" aria-level="2">',
    '<aside class="sidebar-drawer">': '<aside class="sidebar-drawer" aria-label="Pages">',
    '<aside class="toc-drawer': '<aside aria-label="On this page" class="toc-drawer',
    ' role="doc-biblioentry"': "",
    '<div role="list" class="citation-list">': '<div class="citation-list">',
    "<pre>": '<pre tabindex="0">',
    '<div class="table-wrapper': '<div tabindex="0" class="table-wrapper',
}


def mend(app: Sphinx, error: Exception | None) -> None:
    """Mend every page; one that was not written again is as it should be already."""
    if error is None and app.builder.format == "html":
        for page in Path(app.outdir).rglob("*.html"):
            old = text = page.read_text(encoding="utf-8")
            for given, better in MENDED.items():
                text = text.replace(given, better)
            if text != old and 'aria-level="2"' not in old:
                page.write_text(text, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend pages when all are written."""
    app.connect("build-finished", mend)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
