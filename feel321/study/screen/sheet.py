"""What every screen is put on: boxes and texts in pixels, the font, colours and sizes, buttons and key hints.

matplotlib brings the font's file, so participants of every lab see the same letters whatever fonts are installed.
Sizes are counted in units: a unit is a hundredth of the screen's height.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from itertools import accumulate
from pathlib import Path
from typing import NamedTuple

from matplotlib.ft2font import FT2Font

from feel321.protocols.trial import RATING_RANGE

GROUND, INK = "#14171c", "#f4f4f2"  # light on dark tires less in a dim room
PANEL, LINE, DIM = "#20252d", "#4a515c", "#b3b8c0"
BLUE, ORANGE = "#56b4e9", "#e69f00"  # Okabe and Ito's hues, for every kind of colour vision
BODY, SMALL, QUESTION, TITLE = 3.0, 2.8, 4.0, 5.6  # letters (em) in units; at 1 m at least 2.2
FONT = "DejaVu Sans"
LEADING = 1.3  # height of a line of text, in heights of its letters (em)
SLACK = 1.04  # factor by which the window's text engine may set a line wider: whole pixels
WIDE = 1.58  # screens at least this wide for their height are measured by their height
WIDEST = 150.0  # width of strips, in units
SHOWN = 60  # letters of a text that are quoted where it is too long

STRIPS = {
    "top": (2.5, 7.0),
    "body": (9.0, -24.0),
    "notice": (-23.0, -14.5),
    "buttons": (-13.5, -6.5),
    "hints": (-5.5, -1.5),
}
"""Upper and lower edge of what is on every screen, in units from the screen's top, or from its bottom if negative:
progress, the page or trial, what passes, buttons, and what the keys do that have none."""


class Box(NamedTuple):
    """A rectangle on the screen, in pixels from the screen's upper left corner."""

    left: float
    top: float
    width: float
    height: float = 0.0

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

    def lower(self, by: float) -> "Box":
        """Move the upper edge down by so many pixels."""
        return self._replace(top=self.top + by, height=self.height - by)


class Text(NamedTuple):
    """One line of text, in the middle of its box's height; size: height of the letters (em), in pixels."""

    box: Box
    words: str
    size: float
    color: str = INK
    bold: bool = False
    align: str = "left"


class Area(NamedTuple):
    """A filled rectangle or its outline, with rounded corners."""

    box: Box
    fill: str = ""
    line: str = ""
    round_px: float = 0.0
    line_px: float = 0.0


class Photo(NamedTuple):
    """A picture as large as its box allows."""

    box: Box
    path: Path


Item = Text | Area | Photo


class Target(NamedTuple):
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


class Button(NamedTuple):
    """A button: its text and what it asks for."""

    text: str
    name: str
    is_main: bool = False
    is_ready: bool = True
    share: float = 0.0  # of the time until it is ready, which has gone by
    explains: bool = False  # it can be clicked before it is ready, to learn what is missing


def split_key(text: str) -> tuple[str, str]:
    """Split "Esc twice  pause" into the key and what it does."""
    key, _, action = text.partition("  ")
    return key, action[:1].upper() + action[1:]


def find_font_files() -> tuple[Path, Path]:
    """Find the files of the font, regular and bold."""
    folder = Path(str(files("matplotlib"))) / "mpl-data" / "fonts" / "ttf"
    return folder / "DejaVuSans.ttf", folder / "DejaVuSans-Bold.ttf"


@cache
def measure(words: str, size: float, *, bold: bool = False) -> float:
    """Measure the width of a line of text; size: height of its letters (em); both in pixels.

    The wider of that with letters pushed together, and that without, as the window's text engine does.
    """
    font, missing = _open_font(bold=bold), list_missing(words)
    advances = [font.load_char(ord(one)).linearHoriAdvance for one in words if one not in missing]
    # A box of an em stands for a letter that is missing.
    width = sum(advances) / 65536 / 1000 + len(words) - len(advances)
    if missing:
        return width * SLACK * size
    font.set_text(words, 0.0)
    return max(float(font.get_width_height()[0]) / 64 / 1000 * SLACK, width) * size


def list_missing(words: str) -> list[str]:
    """List the letters that the screen's font lacks."""
    font = _open_font(bold=False)
    return [letter for letter in dict.fromkeys(words) if not font.get_char_index(ord(letter))]


@cache
def _open_font(*, bold: bool) -> FT2Font:
    font = FT2Font(str(find_font_files()[bold]))
    font.set_size(1000.0, 72.0)
    return font


@dataclass(slots=True)
class Sheet:
    """A screen while it is composed. Sizes of letters and counts of units are in units, all else is in pixels."""

    width: float
    height: float
    items: list[Item] = field(default_factory=list)
    targets: list[Target] = field(default_factory=list)
    faults: list[str] = field(default_factory=list)

    @property
    def unit(self) -> float:
        """A hundredth of the screen's height, in pixels; less on screens that are not wide."""
        return min(self.height, self.width / WIDE) / 100

    def find_strip(self, name: str, *, width: float = WIDEST) -> Box:
        """Find one of the strips that a screen is divided into; width: in units, at most."""
        unit = self.unit
        top, bottom = (edge * unit + self.height * (edge < 0) for edge in STRIPS[name])
        width = min(self.width - 8 * unit, width * unit)
        return Box((self.width - width) / 2, top, width, bottom - top)

    def measure(self, words: str, size: float, *, bold: bool = False) -> float:
        """Measure the width of a line of text, in pixels."""
        return measure(words, size * self.unit, bold=bold)

    def find_height(self, n_lines: float, size: float) -> float:
        """Compute the height of lines of text."""
        return n_lines * size * self.unit * LEADING

    def wrap(self, words: str, width: float, size: float, *, bold: bool = False) -> list[str]:
        """Break a text into lines of at most a width; line breaks of its author stay."""
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
        """Write a line of text, or several under each other from the top of a box."""
        size_px, lines = size * self.unit, [words] if isinstance(words, str) else words
        row = box if lines is not words else box._replace(height=size_px * LEADING)
        for line in lines:
            if line:
                self.items.append(Text(row, line, size_px, color, bold, align))
            if missing := list_missing(line):
                letters = ", ".join(map(repr, missing))
                self.faults.append(f"the screen's font has no {letters}; write it without")
            if measure(line, size_px, bold=bold) > box.width + 0.5:
                short = line if len(line) <= SHOWN else f"{line[:SHOWN]}..."
                self.faults.append(f"got {short!r}, which is too long for its place; shorten it")
            row = row._replace(top=row.bottom)

    def limit_lines(self, count: int, *, most: int, what: str) -> None:
        """Note a text that takes too many lines."""
        if count > most:
            told = f"its {what} must take at most {most} lines, got {count}; shorten it"
            self.faults.append(told)

    def add_choice(self, box: Box, part: str, *, is_chosen: bool) -> str:
        """Draw an option, filled if it is chosen; returns the color of its letters."""
        fill = BLUE if is_chosen else PANEL
        self.fill(box, fill, line=LINE, round_px=self.unit, line_px=0.2 * self.unit)
        self.targets.append(Target(box, "choose", part))
        return GROUND if is_chosen else INK

    def line_up(
        self, widths: Sequence[float], gap: float, strip: Box, *, at: float = 0.5
    ) -> list[Box]:
        """Set boxes of some widths side by side in a strip; at: 0 at its left end, 1 at its right one."""
        left = strip.left + at * (strip.width - sum(widths) - gap * (len(widths) - 1))
        lefts = accumulate(widths, lambda before, width: before + width + gap, initial=left)
        return [
            Box(at, strip.top, own, strip.height) for at, own in zip(lefts, widths, strict=False)
        ]

    def add_buttons(self, left: Sequence[Button], right: Sequence[Button]) -> None:
        """Put buttons at both ends of their strip: what each does, then the key that does the same."""
        strip, unit = self.find_strip("buttons"), self.unit
        for at, buttons in enumerate((left, right)):
            words = [split_key(button.text) for button in buttons]
            actions = [self.measure(action, SMALL, bold=True) for _, action in words]
            keys = [self.measure(key, SMALL) for key, _ in words]
            widths = [own + other + 6.5 * unit for own, other in zip(actions, keys, strict=True)]
            boxes = self.line_up(widths, 2 * unit, strip, at=at)
            sizes = zip(actions, keys, strict=True)
            for button, box, (key, action), own in zip(buttons, boxes, words, sizes, strict=True):
                is_blue = button.is_main and button.is_ready
                fill, line = (BLUE, "") if is_blue else (PANEL, LINE)
                self.fill(box, fill, line=line, round_px=1.2 * unit, line_px=0.25 * unit)
                if button.share:
                    gone = box._replace(width=box.width * button.share)
                    self.fill(gone, LINE, round_px=1.2 * unit)
                is_dim = not (button.is_ready or button.share)
                place = box._replace(left=box.left + 2.5 * unit, width=own[0])
                color = GROUND if is_blue else DIM if is_dim else INK
                self.write(place, action, SMALL, color=color, bold=True)
                place = box._replace(left=place.right + 1.5 * unit, width=own[1])
                color = GROUND if is_blue else INK if button.share else DIM
                self.write(place, key, SMALL, color=color)
                if button.is_ready or button.explains:
                    self.targets.append(Target(box, button.name))

    def add_hints(self, texts: Sequence[str]) -> None:
        """Write in one line what keys do that have no button."""
        unit, strip = self.unit, self.find_strip("hints")
        words = [text.partition("  ")[::2] for text in texts]
        keys = [self.measure(key, SMALL, bold=True) + unit for key, _ in words]
        actions = [self.measure(action, SMALL) for _, action in words]
        boxes = self.line_up([*map(sum, zip(keys, actions, strict=True))], 4.5 * unit, strip)
        for (key, action), box, own, other in zip(words, boxes, keys, actions, strict=True):
            self.write(box._replace(width=own - unit), key, SMALL, color=DIM, bold=True)
            self.write(box._replace(left=box.left + own, width=other), action, SMALL, color=DIM)
