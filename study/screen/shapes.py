"""What a screen is made of: texts of one line, areas and pictures in boxes of pixels, and what can be clicked."""

from __future__ import annotations

from dataclasses import dataclass
from math import cos, pi, sin
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pathlib import Path

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

    Parameters
    ----------
    left, top : float
        Its upper left corner, in pixels from that of the screen.
    width, height : float
        Its size in pixels.
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

        Parameters
        ----------
        x, y : float
            The point, in pixels from the upper left corner of the screen.

        Returns
        -------
        bool
            Whether it does.
        """
        return self.left <= x < self.right and self.top <= y < self.bottom

    def grow(self, by: float) -> Box:
        """Move every edge out.

        Parameters
        ----------
        by : float
            By how many pixels.

        Returns
        -------
        Box
            The larger rectangle; a smaller one where the number is negative.
        """
        return Box(self.left - by, self.top - by, self.width + 2 * by, self.height + 2 * by)


@dataclass(frozen=True, slots=True)
class Text:
    """One line of text, in the middle of its box's height.

    Parameters
    ----------
    box : Box
        Where it is to fit in.
    words : str
        What it says.
    size : float
        Height of the letters (em), in pixels.
    color : str
        Its colour.
    bold : bool
        Whether it is bold.
    align : str
        `left`, `center` or `right` in its box.
    """

    box: Box
    words: str
    size: float
    color: str = INK
    bold: bool = False
    align: str = "left"


@dataclass(frozen=True, slots=True)
class Area:
    """A filled rectangle or its outline, with rounded corners.

    Parameters
    ----------
    box : Box
        Where.
    fill, line : str
        Colours of its inside and its outline; empty for none.
    round_px : float
        Radius of its corners.
    line_px : float
        Width of its outline.
    """

    box: Box
    fill: str = ""
    line: str = ""
    round_px: float = 0.0
    line_px: float = 0.0


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture as large as its box allows.

    Parameters
    ----------
    box : Box
        Where.
    path : Path
        The file.
    """

    box: Box
    path: Path


@dataclass(frozen=True, slots=True)
class Target:
    """Something to click or drag on.

    Parameters
    ----------
    box : Box
        Where.
    name : str
        What it does: `confirm`, `again`, `stop`, `pause`, `feel`, `mark` or `choose`.
    part : str
        The part that it does it to; empty if to none.
    track : Box or None
        The slider's track, where it is one.
    """

    box: Box
    name: str
    part: str = ""
    track: Box | None = None


@dataclass(frozen=True, slots=True)
class Composition:
    """A whole screen.

    Parameters
    ----------
    items : tuple of Text, Area or Picture
        What is drawn, from back to front.
    targets : tuple of Target
        What can be clicked.
    """

    items: tuple[Text | Area | Picture, ...]
    targets: tuple[Target, ...] = ()


Item = Text | Area | Picture


def round_corners(box: Box, radius: float, *, steps: int = 8) -> list[tuple[float, float]]:
    """Draw a rectangle with rounded corners as a polygon.

    Parameters
    ----------
    box : Box
        The rectangle.
    radius : float
        Radius of its corners, in pixels.
    steps : int
        Sides of each corner.

    Returns
    -------
    list of tuple of float
        Its corners, from the top right clockwise.

    Examples
    --------
    >>> round_corners(Box(0, 0, 2, 1), 0.0)
    [(2, 0), (2, 1), (0, 1), (0, 0)]
    """
    if radius <= 0:
        return [(box.right, box.top), (box.right, box.bottom), (box.left, box.bottom), (box.left, box.top)]
    inner = box.grow(-min(radius, box.width / 2, box.height / 2))
    reach = inner.left - box.left
    right, left, top, bottom = inner.right, inner.left, inner.top, inner.bottom
    corners = ((right, top), (right, bottom), (left, bottom), (left, top))
    return [
        (x + reach * sin(angle), y - reach * cos(angle))
        for turn, (x, y) in enumerate(corners)
        for angle in (pi / 2 * (turn + step / steps) for step in range(steps + 1))
    ]
