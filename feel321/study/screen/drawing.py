"""Drawing: texts, boxes and pictures in pixels, fonts, and the grid they are set on.

matplotlib brings the file, so participants of every lab see the same letters whatever fonts are installed.

From top to bottom: progress, the body, a notice, buttons, what the keys do. A unit is a hundredth of the screen's
height, less on screens that are not wide: then the width decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from math import cos, pi, sin
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.ft2font import FT2Font

# What a screen is made of: texts of one line, areas and pictures in boxes of pixels, and what can be clicked.

LEADING = 1.3
"""Height of a line of text, in heights of its letters (em)."""

# Light on dark tires less in a dim room. The three hues are Okabe and Ito's, told apart by every kind of colour vision;
# none of them is the only sign of anything.
GROUND = "#14171c"
PANEL = "#20252d"
LINE = "#4a515c"
DIM = "#b3b8c0"
INK = "#f4f4f2"
BLUE = "#56b4e9"
ORANGE = "#e69f00"


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle on the screen.

    left, top: its upper left corner, in pixels from that of the screen; width, height: its size in
    pixels.
    """

    left: float
    top: float
    width: float
    height: float

    @property
    def right(self) -> float:
        """Its right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Its lower edge."""
        return self.top + self.height

    def contains(self, x: float, y: float) -> bool:
        """Tell whether a point lies in it.

        x, y: the point, in pixels from the upper left corner of the screen.
        """
        return self.left <= x < self.right and self.top <= y < self.bottom

    def grow(self, by: float) -> Box:
        """Move every edge out.

        by: by how many pixels.
        """
        return Box(self.left - by, self.top - by, self.width + 2 * by, self.height + 2 * by)


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text, in the middle of its box's height.

    size: height of the letters (em), in pixels.
    """

    box: Box
    words: str
    size: float
    color: str = INK
    bold: bool = False
    align: str = "left"


@dataclass(frozen=True, slots=True)
class Area:
    """A filled rectangle or its outline, with rounded corners."""

    box: Box
    fill: str = ""
    line: str = ""
    round_px: float = 0.0
    line_px: float = 0.0


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as large as its box allows."""

    box: Box
    path: Path


@dataclass(frozen=True, slots=True)
class Target:
    """Something to click or drag on."""

    box: Box
    name: str
    part: str = ""
    track: Box | None = None


@dataclass(frozen=True, slots=True)
class Composition:
    """A whole screen."""

    items: tuple[Text | Area | Picture, ...]
    targets: tuple[Target, ...] = ()


Item = Text | Area | Picture


def round_corners(box: Box, radius: float, *, steps: int = 8) -> list[tuple[float, float]]:
    """Draw a rectangle with rounded corners as a polygon.

    radius: radius of its corners, in pixels.

    Examples
    --------
    >>> round_corners(Box(0, 0, 2, 1), 0.0)
    [(2, 0), (2, 1), (0, 1), (0, 0)]
    """
    if radius <= 0:
        return [
            (box.right, box.top),
            (box.right, box.bottom),
            (box.left, box.bottom),
            (box.left, box.top),
        ]
    inner = box.grow(-min(radius, box.width / 2, box.height / 2))
    reach = inner.left - box.left
    right, left, top, bottom = inner.right, inner.left, inner.top, inner.bottom
    corners = ((right, top), (right, bottom), (left, bottom), (left, top))
    return [
        (x + reach * sin(angle), y - reach * cos(angle))
        for turn, (x, y) in enumerate(corners)
        for angle in (pi / 2 * (turn + step / steps) for step in range(steps + 1))
    ]


# The font of the screen, and how wide its words are.

FONT = "DejaVu Sans"
FONT_FILES = ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf")
SLACK = 1.04
"""How much wider the window's own text engine sets a line at most: it rounds letters to whole pixels."""


def find_font_files() -> tuple[Path, Path]:
    """Find the files of the font."""
    folder = Path(str(files("matplotlib"))) / "mpl-data" / "fonts" / "ttf"
    regular, bold = (folder / name for name in FONT_FILES)
    return regular, bold


def measure(words: str, size: float, *, bold: bool = False) -> float:
    """Measure a line of text.

    size: height of its letters (em), in pixels; returns its width in pixels.

    Examples
    --------
    >>> round(measure("Continue", 100.0))
    468
    """
    return _measure_em(words, bold=bold) * size * SLACK


@cache
def _measure_em(words: str, *, bold: bool) -> float:
    font = _open_face(bold=bold)
    font.set_text(words, 0.0)
    width, _ = font.get_width_height()
    return float(width) / 64 / 1000


@cache
def _open_face(*, bold: bool) -> FT2Font:
    from matplotlib.ft2font import FT2Font

    font = FT2Font(str(find_font_files()[bold]))
    font.set_size(1000.0, 72.0)
    return font


def wrap(words: str, width: float, *, size: float, bold: bool = False) -> list[str]:
    """Break a text into lines; line breaks of its author stay.

    width: how wide lines may be, in pixels; size: height of the letters (em), in pixels.

    Examples
    --------
    >>> wrap("one two three", 70.0, size=10.0)
    ['one two', 'three']
    """
    lines: list[str] = []
    for paragraph in words.strip().splitlines():
        lines.append("")
        for word in paragraph.split():
            longer = f"{lines[-1]} {word}".strip()
            if lines[-1] and measure(longer, size, bold=bold) > width:
                lines.append(word)
            else:
                lines[-1] = longer
    return lines


def find_height(lines: list[str], size: float) -> float:
    """Tell how high lines of text are.

    size: height of the letters (em), in pixels; returns their height in pixels.
    """
    return len(lines) * size * LEADING


# The parts of the screen that every page and trial shares, and the unit that all sizes are counted in.

WIDE = 1.58
"""Screens at least this wide for their height are measured by their height."""

BODY = 3.0
SMALL = 2.8
QUESTION = 4.0
TITLE = 5.6
"""Sizes of letters (em) in units; at 1 m nothing may be smaller than 2.2 % of the screen's height."""


@dataclass(frozen=True, slots=True)
class Grid:
    """A screen's size and how it is divided.

    width, height: of the screen, in pixels.
    """

    width: float
    height: float

    @property
    def unit(self) -> float:
        """What all sizes are counted in, in pixels."""
        return min(self.height, self.width / WIDE) / 100

    @property
    def body(self) -> Box:
        """Where a page or a trial stands."""
        unit = self.unit
        return self._cut(9 * unit, self.height - 24 * unit)

    @property
    def notice(self) -> Box:
        """Where the participant is told something that passes."""
        unit = self.unit
        return self._cut(self.height - 23 * unit, self.height - 14.5 * unit)

    @property
    def buttons(self) -> Box:
        """Where the buttons stand."""
        unit = self.unit
        return self._cut(self.height - 13.5 * unit, self.height - 6.5 * unit)

    @property
    def hints(self) -> Box:
        """Where it says what the keys do."""
        unit = self.unit
        return self._cut(self.height - 5.5 * unit, self.height - 1.5 * unit)

    @property
    def top(self) -> Box:
        """Where it says how far the session has come."""
        unit = self.unit
        return self._cut(2.5 * unit, 7 * unit)

    def _cut(self, top: float, bottom: float) -> Box:
        width = min(self.width - 8 * self.unit, 150 * self.unit)
        return Box((self.width - width) / 2, top, width, bottom - top)


@dataclass(frozen=True, slots=True)
class Button:
    """A button.

    share: how much of the time until it does has gone by, from 0 to 1.
    """

    text: str
    name: str
    part: str = ""
    is_main: bool = False
    is_ready: bool = True
    share: float = 0.0


def split_key(text: str) -> tuple[str, str]:
    """Take apart a key and what it does.

    Examples
    --------
    >>> split_key("Esc twice  pause")
    ('Esc twice', 'Pause')
    """
    key, _, action = text.partition("  ")
    return key, action[:1].upper() + action[1:]


def lay_progress(grid: Grid, words: str, share: float) -> list[Item]:
    """Say how far the session has come, in words and by a thin bar.

    share: how far, from 0 to 1.
    """
    if not words:
        return []
    unit = grid.unit
    bar = Box(0, 0, grid.width, 0.8 * unit)
    return [
        Area(bar, fill=PANEL),
        Area(Box(0, 0, max(grid.width * share, 1.0), bar.height), fill=LINE),
        Text(grid.top, words, SMALL * unit, DIM, align="right"),
    ]


def lay_notice(grid: Grid, words: str) -> list[Item]:
    """Tell the participant something that passes."""
    if not words:
        return []
    size = BODY * grid.unit
    lines = wrap(words, grid.notice.width - 6 * grid.unit, size=size, bold=True)
    height = find_height(lines, size)
    middle = grid.notice.top + grid.notice.height / 2
    mark = Box(grid.notice.left, middle - height / 2, 0.8 * grid.unit, height)
    box = Box(mark.right + 2 * grid.unit, mark.top, grid.notice.width - 4 * grid.unit, height)
    return [Area(mark, fill=ORANGE), *lay_lines(box, lines, size=size, color=ORANGE, bold=True)]


def lay_lines(
    box: Box,
    lines: Sequence[str],
    *,
    size: float,
    color: str = INK,
    bold: bool = False,
    align: str = "left",
) -> list[Item]:
    """Set lines of text under each other.

    size: height of the letters (em), in pixels.
    """
    step = size * LEADING
    return [
        Text(Box(box.left, box.top + place * step, box.width, step), line, size, color, bold, align)
        for place, line in enumerate(lines)
        if line
    ]


def lay_hints(grid: Grid, texts: Sequence[str]) -> list[Item]:
    """Say in one line what keys do that have no button."""
    size, gap = SMALL * grid.unit, 1.0 * grid.unit
    pairs = [text.partition("  ")[::2] for text in texts]
    widths = [(measure(key, size, bold=True), measure(action, size)) for key, action in pairs]
    between = 4.5 * grid.unit
    left = (
        grid.width - sum(key + gap + action for key, action in widths) - between * (len(pairs) - 1)
    ) / 2
    items: list[Item] = []
    for (key, action), (key_width, action_width) in zip(pairs, widths, strict=True):
        items.append(
            Text(Box(left, grid.hints.top, key_width, grid.hints.height), key, size, DIM, bold=True)
        )
        left += key_width + gap
        items.append(
            Text(Box(left, grid.hints.top, action_width, grid.hints.height), action, size, DIM)
        )
        left += action_width + between
    return items


def lay_buttons(
    grid: Grid, left: Sequence[Button], right: Sequence[Button]
) -> tuple[list[Item], list[Target]]:
    """Put buttons at both ends of their line."""
    items: list[Item] = []
    targets: list[Target] = []
    line, gap = grid.buttons, 2 * grid.unit
    start = line.right - sum(find_width(grid, button) for button in right) - gap * (len(right) - 1)
    for place, buttons in ((line.left, left), (start, right)):
        for button in buttons:
            box = Box(place, line.top, find_width(grid, button), line.height)
            items += draw_button(grid, button, box)
            if button.is_ready:
                targets.append(Target(box, button.name, button.part))
            place = box.right + gap  # noqa: PLW2901 - walks along the line
    return items, targets


def find_width(grid: Grid, button: Button) -> float:
    """Tell how wide a button is.

    Returns its width in pixels.
    """
    key, action = split_key(button.text)
    size = SMALL * grid.unit
    return measure(action, size, bold=True) + measure(key, size) + 6.5 * grid.unit


def draw_button(grid: Grid, button: Button, box: Box) -> list[Item]:
    """Draw a button: what it does, then the key that does the same."""
    unit, size = grid.unit, SMALL * grid.unit
    key, action = split_key(button.text)
    filled = button.is_main and button.is_ready
    ink = GROUND if filled else INK if button.is_ready or button.share else DIM
    words = Box(box.left + 2.5 * unit, box.top, measure(action, size, bold=True), box.height)
    cap = Box(words.right + 1.5 * unit, box.top, measure(key, size), box.height)
    frame = Area(
        box,
        fill=BLUE if filled else PANEL,
        line="" if filled else LINE,
        round_px=1.2 * unit,
        line_px=0.25 * unit,
    )
    gone = Box(box.left, box.top, box.width * button.share, box.height)
    return [
        frame,
        *([Area(gone, fill=LINE, round_px=1.2 * unit)] if button.share else []),
        Text(words, action, size, ink, bold=True),
        Text(cap, key, size, GROUND if filled else INK if button.share else DIM),
    ]
