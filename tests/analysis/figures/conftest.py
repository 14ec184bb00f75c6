"""What every figure must keep: as wide as all, readable, nothing outside, no words over words."""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import pytest
from matplotlib.axis import Tick
from matplotlib.text import Text

from feel321.analysis.figures.style import CM_PER_INCH, WIDTH_CM, print_style

if TYPE_CHECKING:
    from collections.abc import Callable

    from matplotlib.figure import Figure

SMALLEST_PT = 7
LONG = "a reducer named by its authors, its year, its variant and what not "
STEMS = ("short", LONG, LONG.replace(" ", "_"), "W" * 70)


def list_texts(figure: Figure) -> list[Text]:
    """List what is written; ticks outside of the axes exist without being drawn."""
    with print_style():
        figure.draw_without_rendering()
    ticks = {id(label) for tick in figure.findobj(Tick) for label in (tick.label1, tick.label2)}
    texts = [text for text in figure.findobj(Text) if id(text) not in ticks]
    axes = [axes for axes in figure.axes if axes.get_visible()]
    texts += [
        tick.label1
        for one in axes
        for axis in (one.xaxis, one.yaxis)
        for tick in axis._update_ticks()
    ]
    return [text for text in texts if text.get_visible() and text.get_text().strip()]


def find_faults(figure: Figure) -> list[str]:
    faults = []
    if abs(figure.get_figwidth() * CM_PER_INCH - WIDTH_CM) > 1e-6:
        faults.append(f"{figure.get_figwidth() * CM_PER_INCH} cm wide")
    texts = list_texts(figure)
    boxes = [text.get_window_extent() for text in texts]
    for text, box in zip(texts, boxes, strict=True):
        if text.get_fontsize() < SMALLEST_PT:
            faults.append(f"too small: {text.get_text()!r}")
        if (
            box.x0 < -0.5
            or box.y0 < -0.5
            or box.x1 > figure.bbox.x1 + 0.5
            or box.y1 > figure.bbox.y1 + 0.5
        ):
            faults.append(f"outside: {text.get_text()!r}")
    pairs = combinations(zip(texts, boxes, strict=True), 2)
    faults += [
        f"{one.get_text()!r} over {other.get_text()!r}"
        for (one, a), (other, b) in pairs
        if min(a.x1, b.x1) - max(a.x0, b.x0) > 0.5 and min(a.y1, b.y1) - max(a.y0, b.y0) > 0.5
    ]
    faults += [
        f"axes without room: {axes.bbox.bounds}"
        for axes in figure.axes
        if min(axes.bbox.width, axes.bbox.height) < 12
    ]
    return faults


@pytest.fixture
def faults() -> Callable[[Figure], list[str]]:
    """Look for what would be wrong with any figure."""
    return find_faults


@pytest.fixture
def said() -> Callable[[Figure], str]:
    """Read all words of a figure, line breaks as spaces."""
    return lambda figure: " ".join(" ".join(text.get_text().split()) for text in list_texts(figure))


@pytest.fixture(params=STEMS, ids=["short", "spaces", "underscores", "wide"])
def names(request: pytest.FixtureRequest) -> list[str]:
    """Name twelve reducers, from sensible to absurd."""
    return [f"{request.param}{number}" for number in range(12)]
