"""What every screen is put on: boxes and texts in pixels, the font, colours and sizes, buttons and key hints.

matplotlib brings the font's file, so participants of every lab see the same letters whatever fonts are installed.
Sizes are counted in units: a unit is a hundredth of the screen's height.
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
PANEL, LINE, DIM = "#20252d", "#4a515c", "#b3b8c0"
BLUE, ORANGE = "#56b4e9", "#e69f00"
"""Okabe and Ito's hues, which every kind of colour vision can distinguish; neither is the only sign of anything."""

BODY, SMALL, QUESTION, TITLE = 3.0, 2.8, 4.0, 5.6
"""Sizes of letters (em) in units; at 1 m nothing may be smaller than 2.2 % of the screen's height."""

FONT = "DejaVu Sans"
LEADING = 1.3  # height of a line of text, in heights of its letters (em)
SLACK = 1.04  # factor by which the window's text engine may set a line wider: whole pixels

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


Item = Text | Area | Photo


@dataclass(frozen=True, slots=True)
class Target:
    """Something to click or drag on; track: of a slider, along which its marker goes."""

    box: Box
    name: str
    part: str = ""
    track: Box | None = None

    def find_points(self, x: float) -> float:
        """Find the value that a place on the slider stands for."""
        track, (low, high) = self.track or self.box, RATING_RANGE
        points = low + (x - track.left) / track.width * (high - low)
        return float(round(min(max(points, low), high)))


@dataclass(frozen=True, slots=True)
class Button:
    """A button; share: how much of the time until it is ready has gone by, from 0 to 1.

    explains: whether it can be clicked before it is ready, to learn what is missing.
    """

    text: str
    name: str
    is_main: bool = False
    is_ready: bool = True
    share: float = 0.0
    explains: bool = False


def split_key(text: str) -> tuple[str, str]:
    """Split "Esc twice  pause" into the key and what it does."""
    key, _, action = text.partition("  ")
    return key, action[:1].upper() + action[1:]


def round_corners(box: Box, radius: float, *, steps: int = 8) -> list[tuple[float, float]]:
    """Make a polygon of a rectangle with rounded corners, whose radius is in pixels."""
    inner = box.grow(-min(radius, box.width / 2, box.height / 2)) if radius > 0 else box
    reach = inner.left - box.left
    right, left, top, bottom = inner.right, inner.left, inner.top, inner.bottom
    corners = ((right, top), (right, bottom), (left, bottom), (left, top))
    if radius <= 0:
        return list(corners)
    return [
        (x + reach * sin(angle), y - reach * cos(angle))
        for turn, (x, y) in enumerate(corners)
        for angle in (pi / 2 * (turn + step / steps) for step in range(steps + 1))
    ]


def find_font_files() -> tuple[Path, Path]:
    """Find the files of the font, regular and bold."""
    folder = Path(str(files("matplotlib"))) / "mpl-data" / "fonts" / "ttf"
    return folder / "DejaVuSans.ttf", folder / "DejaVuSans-Bold.ttf"


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
    return float(width) / 64 / 1000, sum(_measure_letter(letter, bold=bold) for letter in words)


@cache
def _measure_letter(letter: str, *, bold: bool) -> float:
    return _open_font(bold=bold).load_char(ord(letter)).linearHoriAdvance / 65536 / 1000


@cache
def _open_font(*, bold: bool) -> FT2Font:
    font = FT2Font(str(find_font_files()[bold]))
    font.set_size(1000.0, 72.0)
    return font


@dataclass(slots=True)
class Sheet:
    """A screen while it is composed: its size in pixels, what has been put on it, and what of that is too long."""

    width: float
    height: float
    items: list[Item] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

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
            if not line:
                continue
            row = Box(box.left, box.top + place * step, box.width, step)
            self.items.append(Text(row, line, size_px, color, bold, align))
            if measure(line, size_px, bold=bold) > box.width + 0.5:
                short = line if len(line) <= SHOWN else f"{line[:SHOWN]}..."
                self.faults.append(f"got {short!r}, which is too long for its place; shorten it")

    def limit_lines(self, count: int, *, most: int, what: str) -> None:
        """Note a text that takes too many lines."""
        if count > most:
            self.faults.append(
                f"its {what} must take at most {most} lines, got {count}; shorten it"
            )

    def add_choice(self, box: Box, part: str, *, is_chosen: bool) -> str:
        """Draw an option, filled if it is chosen; returns the color of its letters."""
        fill = BLUE if is_chosen else PANEL
        self.fill(box, fill, line=LINE, round_px=self.unit, line_px=0.2 * self.unit)
        self.targets.append(Target(box, "choose", part))
        return GROUND if is_chosen else INK

    def add_buttons(self, left: Sequence[Button], right: Sequence[Button]) -> None:
        """Put buttons at both ends of their strip: what each does, then the key that does the same."""
        strip, unit = self.find_strip("buttons"), self.unit
        gap = 2 * unit
        widths = {}
        for button in (*left, *right):
            key, action = split_key(button.text)
            words = self.measure(action, SMALL, bold=True) + self.measure(key, SMALL)
            widths[button] = words + 6.5 * unit
        start = strip.right - sum(widths[button] for button in right) - gap * (len(right) - 1)
        for place, buttons in ((strip.left, left), (start, right)):
            for button in buttons:
                box = Box(place, strip.top, widths[button], strip.height)
                self._add_button(button, box)
                if button.is_ready or button.explains:
                    self.targets.append(Target(box, button.name))
                place = box.right + gap  # noqa: PLW2901 - walks along the strip

    def _add_button(self, button: Button, box: Box) -> None:
        unit, (key, action) = self.unit, split_key(button.text)
        left, width = box.left + 2.5 * unit, self.measure(action, SMALL, bold=True)
        words = Box(left, box.top, width, box.height)
        cap = Box(words.right + 1.5 * unit, box.top, self.measure(key, SMALL), box.height)
        if button.is_main and button.is_ready:
            self.fill(box, BLUE, round_px=1.2 * unit, line_px=0.25 * unit)
            action_color = key_color = GROUND
        else:
            self.fill(box, PANEL, line=LINE, round_px=1.2 * unit, line_px=0.25 * unit)
            action_color = INK if button.is_ready or button.share else DIM
            key_color = INK if button.share else DIM
        if button.share:
            gone = Box(box.left, box.top, box.width * button.share, box.height)
            self.fill(gone, LINE, round_px=1.2 * unit)
        self.write(words, action, SMALL, color=action_color, bold=True)
        self.write(cap, key, SMALL, color=key_color)

    def add_hints(self, texts: Sequence[str]) -> None:
        """Write in one line what keys do that have no button."""
        unit, strip = self.unit, self.find_strip("hints")
        words = []
        for text in texts:
            key, _, action = text.partition("  ")
            words += [(key, True, 1.0 * unit), (action, False, 4.5 * unit)]
        widths = [self.measure(word, SMALL, bold=bold) for word, bold, _ in words]
        left = (self.width - sum(widths) - sum(gap for *_, gap in words[:-1])) / 2
        for (word, bold, gap), width in zip(words, widths, strict=True):
            box = Box(left, strip.top, width, strip.height)
            self.write(box, word, SMALL, color=DIM, bold=bold)
            left += width + gap


SHOWN = 60  # letters of a text that are quoted where it is too long
