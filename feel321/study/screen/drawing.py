"""Drawing: texts, areas and pictures in pixels, the font, and the sheet that they are put on.

matplotlib brings the font's file, so participants of every lab see the same letters whatever fonts are installed.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from math import cos, pi, sin
from pathlib import Path

from matplotlib.ft2font import FT2Font

from feel321.protocols.trial import RATING_RANGE

GROUND, INK = "#14171c", "#f4f4f2"  # light on dark tires less in a dim room


@dataclass(frozen=True, slots=True)
class Box:
    """A rectangle on the screen, in pixels from the screen's upper left corner."""

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
        """Whether a point lies in it."""
        return self.left <= x < self.right and self.top <= y < self.bottom

    def grow(self, by: float) -> "Box":
        """Move every edge out by so many pixels."""
        return Box(self.left - by, self.top - by, self.width + 2 * by, self.height + 2 * by)


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text, in the middle of its box's height; size: height of the letters (em), in pixels."""

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
class Photo:
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


Item = Text | Area | Photo


def round_corners(box: Box, radius: float, *, steps: int = 8) -> list[tuple[float, float]]:
    """Make a polygon of a rectangle with rounded corners, whose radius is in pixels."""
    right, left, top, bottom = box.right, box.left, box.top, box.bottom
    if radius <= 0:
        return [(right, top), (right, bottom), (left, bottom), (left, top)]
    inner = box.grow(-min(radius, box.width / 2, box.height / 2))
    reach = inner.left - left
    right, left, top, bottom = inner.right, inner.left, inner.top, inner.bottom
    corners = ((right, top), (right, bottom), (left, bottom), (left, top))
    return [
        (x + reach * sin(angle), y - reach * cos(angle))
        for turn, (x, y) in enumerate(corners)
        for angle in (pi / 2 * (turn + step / steps) for step in range(steps + 1))
    ]


def find_points(track: Box, x: float) -> float:
    """Find the value that a place on a slider stands for."""
    low, high = RATING_RANGE
    return float(round(min(max(low + (x - track.left) / track.width * (high - low), low), high)))


# The font of the screen, and how wide its words are.

FONT = "DejaVu Sans"
FONT_FILES = ("DejaVuSans.ttf", "DejaVuSans-Bold.ttf")
LEADING = 1.3  # height of a line of text, in heights of its letters (em)
SLACK = 1.04  # factor by which the window's text engine may set a line wider: whole pixels


def find_font_files() -> tuple[Path, Path]:
    """Find the files of the font, regular and bold."""
    folder = Path(str(files("matplotlib"))) / "mpl-data" / "fonts" / "ttf"
    regular, bold = (folder / name for name in FONT_FILES)
    return regular, bold


def measure(words: str, size: float, *, bold: bool = False) -> float:
    """Measure the width of a line of text; size: height of its letters (em); both in pixels."""
    kerned, unkerned = _measure_em(words, bold=bold)
    return max(kerned * SLACK, unkerned) * size


@cache
def _measure_em(words: str, *, bold: bool) -> tuple[float, float]:
    """Measure a line with letters pushed together where they may be, and without, as the window's text engine does."""
    font = _open_font(bold=bold)
    font.set_text(words, 0.0)
    width, _ = font.get_width_height()
    advances = sum(font.load_char(ord(letter)).linearHoriAdvance for letter in words)
    return float(width) / 64 / 1000, advances / 65536 / 1000


@cache
def _open_font(*, bold: bool) -> FT2Font:
    from matplotlib.ft2font import FT2Font

    font = FT2Font(str(find_font_files()[bold]))
    font.set_size(1000.0, 72.0)
    return font


# What every page and trial is put on, and the unit that all its sizes are counted in.

WIDE = 1.58  # screens at least this wide for their height are measured by their height

STRIPS = {
    "top": (2.5, 7.0),
    "body": (9.0, -24.0),
    "notice": (-23.0, -14.5),
    "buttons": (-13.5, -6.5),
    "hints": (-5.5, -1.5),
}
"""Upper and lower edge of what is on every screen, in units from the screen's top, or from its bottom if negative:
progress, the page or trial, what passes, buttons, and what the keys do that have none."""


@dataclass(slots=True)
class Sheet:
    """A screen while it is composed: its size in pixels, and what has been put on it."""

    width: float
    height: float
    items: list[Item] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)

    @property
    def unit(self) -> float:
        """A hundredth of the screen's height, in pixels; less on screens that are not wide."""
        return min(self.height, self.width / WIDE) / 100

    def find_strip(self, name: str) -> Box:
        """Find one of the strips that a screen is divided into."""
        unit = self.unit
        top, bottom = (edge * unit + self.height * (edge < 0) for edge in STRIPS[name])
        width = min(self.width - 8 * unit, 150 * unit)
        return Box((self.width - width) / 2, top, width, bottom - top)

    def fill(
        self, box: Box, fill: str, *, line: str = "", round_px: float = 0.0, line_px: float = 0.0
    ) -> None:
        """Fill a box; line: the color of its outline."""
        self.items.append(Area(box, fill, line, round_px, line_px))

    def write(
        self,
        box: Box,
        words: str | Sequence[str],
        size: float,
        *,
        color: str = INK,
        bold: bool = False,
        align: str = "left",
    ) -> None:
        """Write a line of text, or several under each other from the top of a box; size: in units."""
        size_px = size * self.unit
        step = box.height if isinstance(words, str) else size_px * LEADING
        for place, line in enumerate([words] if isinstance(words, str) else words):
            if line:
                row = Box(box.left, box.top + place * step, box.width, step)
                self.items.append(Text(row, line, size_px, color, bold, align))

    def measure(self, words: str, size: float, *, bold: bool = False) -> float:
        """Measure the width of a line of text, in pixels; size: in units."""
        return measure(words, size * self.unit, bold=bold)

    def find_height(self, n_lines: float, size: float) -> float:
        """Compute the height of lines of text, in pixels; size: in units."""
        return n_lines * size * self.unit * LEADING

    def wrap(self, words: str, width: float, size: float, *, bold: bool = False) -> list[str]:
        """Break a text into lines of at most a width in pixels; line breaks of its author stay. size: in units."""
        lines: list[str] = []
        for paragraph in words.strip().splitlines():
            lines.append("")
            for word in paragraph.split():
                longer = f"{lines[-1]} {word}".strip()
                if lines[-1] and self.measure(longer, size, bold=bold) > width:
                    lines.append(word)
                else:
                    lines[-1] = longer
        return lines
