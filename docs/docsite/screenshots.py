"""`make screenshots`: the pictures of the participant's screens and of the report, made by the program itself.

Needs a display (Xvfb) and Chromium. The pictures are kept in the checkout, so that GitHub shows them too.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from PIL import Image

DOCS = Path(__file__).parents[1]
sys.path.insert(0, str(DOCS.parent / "tests" / "study" / "screen"))

from gallery import capture, make_views  # noqa: E402 - the views that the layout's tests look at

SCREEN = (960, 600)
VIEWS = {"realism": "realism answered", "mushra": "mushra of five"}
"""File in docs/screens -> view."""


def save(path: Path, made: Path, *, colours: int = 32) -> None:
    """Save a picture with few colours: screens have few, and the checkout stays small."""
    with Image.open(made) as picture:
        picture.convert("RGB").quantize(colours, Image.Quantize.MAXCOVERAGE).save(
            path, optimize=True
        )


def save_screens(folder: Path) -> None:
    """Save a picture of every task's screen."""
    from feel321.protocols.texts import read_scales, read_texts
    from feel321.study.screen.input import make_screen_texts
    from feel321.study.screen.layout import compose
    from feel321.study.screen.window import open_screen

    folder.mkdir(exist_ok=True)
    texts = read_texts("en")
    views = make_views(read_scales("en"), texts)
    with (
        open_screen(clock=time.perf_counter, windowed=True, size=SCREEN) as window,
        tempfile.TemporaryDirectory() as made,
    ):
        for name, view in VIEWS.items():
            window.show(compose(views[view], make_screen_texts(texts), size=window.size).items)
            capture(window, Path(made) / "screen.png")
            save(folder / f"{name}.png", Path(made) / "screen.png", colours=16)


MARKED = (
    "h2.headline",
    ".card:nth-of-type(1) li:nth-of-type(1) .verdict > span",
    ".card:nth-of-type(1) li:nth-of-type(1) .points",
    ".card:nth-of-type(1) li:nth-of-type(1) .strip + .faint",
    ".lead figcaption",
    "h2#predict",
)
"""What docs/reading-the-report.md explains, in the order of its numbers."""

BADGE = (
    'content: "{}"; display: inline-block; width: 1.5em; margin-right: .4em; border-radius: 50%; text-align: center;'
    " line-height: 1.5em; font-size: 15px; font-weight: 700; color: #fff; background: #b34700;"
)


def mark(page: str) -> str:
    """Put a number before each thing that is explained."""
    rules = (f"{found}::before {{ {BADGE.format(n)} }}" for n, found in enumerate(MARKED, start=1))
    return page.replace("</head>", f"<style>{' '.join(rules)}</style></head>", 1)


def save_report(folder: Path) -> None:
    """Save the first screen of the bundled study's report, as it is and with what is explained numbered."""
    with tempfile.TemporaryDirectory() as made:
        demo = Path(made) / "demo"
        subprocess.run(
            [Path(sys.executable).with_name("feel321"), "demo", "--out", demo], check=True
        )
        save_pages((demo / "report" / "index.html").read_text(encoding="utf-8"), folder, Path(made))


def save_pages(text: str, folder: Path, made: Path) -> None:
    """Save the pictures of a report's page."""
    page, shot = made / "page.html", made / "report.png"
    options = ["--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1440,1000"]
    for name, body in (("report", text), ("report-explained", mark(text))):
        page.write_text(body, encoding="utf-8")
        subprocess.run(["chromium", *options, f"--screenshot={shot}", page.as_uri()], check=True)
        save(folder / f"{name}.png", shot, colours=256)


if __name__ == "__main__":
    save_screens(DOCS / "screens")
    save_report(DOCS)
