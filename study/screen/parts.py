"""What is felt, as a row of fields: which ones there are, which one is on, which were felt to their ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.screen.fonts import measure
from study.screen.grid import BODY
from study.screen.shapes import BLUE, DIM, GROUND, INK, LINE, PANEL, Area, Box, Target, Text

if TYPE_CHECKING:
    from study.screen.grid import Grid
    from study.screen.shapes import Item
    from study.screen.views import View
    from study.screen.wording import ScreenTexts

FELT = "✓"


def name_part(name: str, texts: ScreenTexts) -> str:
    """Tell what people call a part.

    Parameters
    ----------
    name : str
        Its name within the trial.
    texts : ScreenTexts
        What parts are called.

    Returns
    -------
    str
        The text for it; parts that are numbered are called by their numbers.
    """
    return texts.parts.get(name, name)


def lay_parts(view: View, texts: ScreenTexts, *, grid: Grid, top: float) -> tuple[list[Item], list[Target]]:
    """Set the parts of a trial beside each other.

    Parameters
    ----------
    view : View
        What is on the screen.
    texts : ScreenTexts
        What parts are called.
    grid : Grid
        The screen.
    top : float
        Where they begin, in pixels.

    Returns
    -------
    items : list of Item
        What to draw.
    targets : list of Target
        What can be clicked: where parts are felt again at will, all of them.
    """
    if view.trial is None:
        return [], []
    unit, size = grid.unit, BODY * grid.unit
    # A reference that is stroked is called by what it is.
    parts = [(part, name_part("surface" if part.surface else part.name, texts)) for part in view.trial.parts]
    # Wide enough that a tick stands apart from the name, which stays in the middle.
    width = max(measure(name, size, bold=True) for _, name in parts) + 14 * unit
    left = (grid.width - len(parts) * width - (len(parts) - 1) * 2 * unit) / 2
    boxes = [Box(left + place * (width + 2 * unit), top, width, 7 * unit) for place in range(len(parts))]
    items = [
        item
        for box, (part, name) in zip(boxes, parts, strict=True)
        for item in draw_part(box, name, size=size, is_on=part.name == view.playing, is_felt=part.name in view.felt)
    ]
    can_feel = view.state == "answering" and view.trial.timing != "strict"
    targets = [Target(box, "feel", part.name) for box, (part, _) in zip(boxes, parts, strict=True) if can_feel]
    return items, targets


def draw_part(box: Box, name: str, *, size: float, is_on: bool, is_felt: bool) -> list[Item]:
    """Draw a part: filled while it is on, ticked once it was felt.

    Parameters
    ----------
    box : Box
        Where.
    name : str
        What it is called.
    size : float
        Height of its letters (em), in pixels.
    is_on : bool
        Whether it is felt now.
    is_felt : bool
        Whether it was felt to its end.

    Returns
    -------
    list of Item
        What to draw.
    """
    ink = GROUND if is_on else INK if is_felt else DIM
    tick_width = measure(FELT, size, bold=True)
    inner = Box(box.left + 1.6 * tick_width, box.top, box.width - 3.2 * tick_width, box.height)
    items: list[Item] = [
        Area(box, fill=BLUE if is_on else PANEL, line="" if is_on else LINE, round_px=size / 2.5, line_px=size / 12),
        Text(inner, name, size, ink, bold=True, align="center"),
    ]
    if is_felt:
        tick = Box(box.right - 1.5 * tick_width, box.top, tick_width, box.height)
        items.append(Text(tick, FELT, size, ink, bold=True))
    return items
