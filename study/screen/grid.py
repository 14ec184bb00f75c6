"""The parts of the screen that every page and trial shares, and the unit that all sizes are counted in.

From top to bottom: progress, the body, a notice, buttons, what the keys do. A unit is a hundredth of the screen's
height, less on screens that are not wide: then the width decides.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from study.screen.fonts import find_height, measure, wrap
from study.screen.shapes import BLUE, DIM, GROUND, INK, LEADING, LINE, ORANGE, PANEL, Area, Box, Target, Text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from study.screen.shapes import Item

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

    Parameters
    ----------
    width, height : float
        Of the screen, in pixels.
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

    Parameters
    ----------
    text : str
        The key that does the same, two spaces, what it does, as in the catalogue.
    name : str
        Name of its target.
    part : str
        Part of its target.
    is_main : bool
        Whether it is what comes next: filled.
    is_ready : bool
        Whether it does something now.
    share : float
        How much of the time until it does has gone by, from 0 to 1.
    """

    text: str
    name: str
    part: str = ""
    is_main: bool = False
    is_ready: bool = True
    share: float = 0.0


def split_key(text: str) -> tuple[str, str]:
    """Take apart a key and what it does.

    Parameters
    ----------
    text : str
        Text of the catalogue.

    Returns
    -------
    key : str
        The key.
    action : str
        What it does, with a capital.

    Examples
    --------
    >>> split_key("Esc twice  pause")
    ('Esc twice', 'Pause')
    """
    key, _, action = text.partition("  ")
    return key, action[:1].upper() + action[1:]


def lay_progress(grid: Grid, words: str, share: float) -> list[Item]:
    """Say how far the session has come, in words and by a thin bar.

    Parameters
    ----------
    grid : Grid
        The screen.
    words : str
        How far, in words; empty before the first trial that counts.
    share : float
        How far, from 0 to 1.

    Returns
    -------
    list of Item
        What to draw.
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
    """Tell the participant something that passes.

    Parameters
    ----------
    grid : Grid
        The screen.
    words : str
        What; may be empty.

    Returns
    -------
    list of Item
        What to draw.
    """
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
    box: Box, lines: Sequence[str], *, size: float, color: str = INK, bold: bool = False, align: str = "left"
) -> list[Item]:
    """Set lines of text under each other.

    Parameters
    ----------
    box : Box
        Where; the lines begin at its top.
    lines : sequence of str
        The lines.
    size : float
        Height of the letters (em), in pixels.
    color : str
        Their colour.
    bold : bool
        Whether they are bold.
    align : str
        `left`, `center` or `right`.

    Returns
    -------
    list of Item
        What to draw.
    """
    step = size * LEADING
    return [
        Text(Box(box.left, box.top + place * step, box.width, step), line, size, color, bold, align)
        for place, line in enumerate(lines)
        if line
    ]


def lay_hints(grid: Grid, texts: Sequence[str]) -> list[Item]:
    """Say in one line what keys do that have no button.

    Parameters
    ----------
    grid : Grid
        The screen.
    texts : sequence of str
        Texts of the catalogue.

    Returns
    -------
    list of Item
        What to draw.
    """
    size, gap = SMALL * grid.unit, 1.0 * grid.unit
    pairs = [text.partition("  ")[::2] for text in texts]
    widths = [(measure(key, size, bold=True), measure(action, size)) for key, action in pairs]
    between = 4.5 * grid.unit
    left = (grid.width - sum(key + gap + action for key, action in widths) - between * (len(pairs) - 1)) / 2
    items: list[Item] = []
    for (key, action), (key_width, action_width) in zip(pairs, widths, strict=True):
        items.append(Text(Box(left, grid.hints.top, key_width, grid.hints.height), key, size, DIM, bold=True))
        left += key_width + gap
        items.append(Text(Box(left, grid.hints.top, action_width, grid.hints.height), action, size, DIM))
        left += action_width + between
    return items


def lay_buttons(grid: Grid, left: Sequence[Button], right: Sequence[Button]) -> tuple[list[Item], list[Target]]:
    """Put buttons at both ends of their line.

    Parameters
    ----------
    grid : Grid
        The screen.
    left, right : sequence of Button
        The buttons at the left end and at the right end, each from left to right.

    Returns
    -------
    items : list of Item
        What to draw.
    targets : list of Target
        What can be clicked: the buttons that are ready.
    """
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

    Parameters
    ----------
    grid : Grid
        The screen.
    button : Button
        The button.

    Returns
    -------
    float
        Its width in pixels.
    """
    key, action = split_key(button.text)
    size = SMALL * grid.unit
    return measure(action, size, bold=True) + measure(key, size) + 6.5 * grid.unit


def draw_button(grid: Grid, button: Button, box: Box) -> list[Item]:
    """Draw a button: what it does, then the key that does the same.

    Parameters
    ----------
    grid : Grid
        The screen.
    button : Button
        The button.
    box : Box
        Where.

    Returns
    -------
    list of Item
        What to draw.
    """
    unit, size = grid.unit, SMALL * grid.unit
    key, action = split_key(button.text)
    filled = button.is_main and button.is_ready
    ink = GROUND if filled else INK if button.is_ready or button.share else DIM
    words = Box(box.left + 2.5 * unit, box.top, measure(action, size, bold=True), box.height)
    cap = Box(words.right + 1.5 * unit, box.top, measure(key, size), box.height)
    frame = Area(
        box, fill=BLUE if filled else PANEL, line="" if filled else LINE, round_px=1.2 * unit, line_px=0.25 * unit
    )
    gone = Box(box.left, box.top, box.width * button.share, box.height)
    return [
        frame,
        *([Area(gone, fill=LINE, round_px=1.2 * unit)] if button.share else []),
        Text(words, action, size, ink, bold=True),
        Text(cap, key, size, GROUND if filled else INK if button.share else DIM),
    ]
