"""From what is on the screen to where it stands: pure geometry, pixels in and boxes out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from study.screen.answers import lay_answer
from study.screen.fonts import find_height, wrap
from study.screen.grid import (
    BODY,
    QUESTION,
    SMALL,
    TITLE,
    Button,
    Grid,
    lay_buttons,
    lay_hints,
    lay_lines,
    lay_notice,
    lay_progress,
    split_key,
)
from study.screen.parts import lay_parts
from study.screen.shapes import DIM, Box, Composition, Picture, Text

if TYPE_CHECKING:
    from protocols.flow import Page
    from study.screen.shapes import Item, Target
    from study.screen.views import View
    from study.screen.wording import ScreenTexts

HINTS = {
    "slider": ("move", "coarse", "digits"),
    "rows": ("choose", "move", "coarse_rows", "feel"),
    "choice": ("pick",),
}
"""The keys that have no button, by kind of screen."""

COLUMN = 108.0
"""How wide a page's text is, in units: some 65 letters."""


ANSWER = 22.0
"""Height of what an answer takes under a picture, in units."""


def compose(view: View, texts: ScreenTexts, *, size: tuple[int, int]) -> Composition:
    """Lay out a screen.

    Parameters
    ----------
    view : View
        What is on it.
    texts : ScreenTexts
        What it says.
    size : tuple of int
        Width and height of the screen in pixels.

    Returns
    -------
    Composition
        What is drawn where, and what can be clicked.
    """
    grid = Grid(*size)
    place = view.place
    words = texts.prompts["trial"].format(done=place.done, total=place.total) if _is_counted(view) else ""
    items = lay_progress(grid, words, place.done / max(place.total, 1))
    items += lay_notice(grid, view.notice)
    body, targets = _lay_page(view, texts, grid) if view.page else _lay_trial(view, texts, grid)
    return Composition((*items, *body), tuple(targets))


def _is_counted(view: View) -> bool:
    """Trials that do not count, and the pages before those that do, are no progress."""
    return view.place.done > 0 or (view.trial is not None and view.trial.phase == "main")


def _lay_page(view: View, texts: ScreenTexts, grid: Grid) -> tuple[list[Item], list[Target]]:
    page = view.page
    if page is None:
        raise ValueError("got a view without a page, allowed is one with a page")
    items = _lay_text(view, page, texts=texts, grid=grid)
    leave = [Button(texts.keys["leave"], "pause")] if view.can_leave else []
    if page.by == "experimenter":
        ask = Text(grid.buttons, texts.prompts["experimenter"], SMALL * grid.unit, DIM, align="right")
        buttons, targets = lay_buttons(grid, leave, [])
        return [*items, ask, *buttons], targets
    key = texts.keys["confirm"]
    if view.left_s:
        # The number stands where the key's name will: a key that does nothing yet is not named.
        key = f"{texts.prompts['wait'].format(seconds=view.left_s)}  {split_key(key)[1]}"
    share = 1 - view.left_s / page.least_s if view.left_s and page.least_s else 0.0
    go_on = Button(key, "confirm", is_main=True, is_ready=not view.left_s, share=max(share, 0.0))
    buttons, targets = lay_buttons(grid, leave, [go_on])
    return items + buttons, targets


def _lay_text(view: View, page: Page, *, texts: ScreenTexts, grid: Grid) -> list[Item]:
    """Set title and text as a column."""
    text = texts.pages[page.key]
    width = min(COLUMN * grid.unit, grid.body.width)
    left = (grid.width - width) / 2
    paragraphs = text.text.format(done=view.place.done, total=view.place.total).strip().splitlines()
    size = 1.1 * BODY * grid.unit
    blocks = [wrap(paragraph, width, size=size) for paragraph in paragraphs]
    title_size = TITLE * grid.unit
    heading = wrap(text.title, width, size=title_size, bold=True)
    gap = 2.4 * grid.unit
    height = find_height(heading, title_size) + sum(gap + find_height(block, size) for block in blocks)
    top = grid.body.top + max(0.0, grid.body.height - height) * 0.4
    items = lay_lines(Box(left, top, width, title_size), heading, size=title_size, bold=True)
    top += find_height(heading, title_size) + gap
    for block in blocks:
        items += lay_lines(Box(left, top, width, size), block, size=size)
        top += find_height(block, size) + gap
    return items


def _lay_trial(view: View, texts: ScreenTexts, grid: Grid) -> tuple[list[Item], list[Target]]:
    items, targets, left_over = _lay_head(view, texts, grid)
    if view.picture and view.kind != "rows":
        box, left_over = _split(left_over, below=ANSWER * grid.unit)
        items.append(Picture(box, view.picture))
    more_items, more_targets = lay_answer(view, texts, grid=grid, box=left_over)
    buttons, button_targets = lay_buttons(grid, [Button(texts.keys["pause"], "pause")], _list_buttons(view, texts))
    hints = lay_hints(grid, [texts.keys[key] for key in HINTS[view.kind]]) if view.state == "answering" else []
    return [*items, *more_items, *buttons, *hints], [*targets, *more_targets, *button_targets]


def _lay_head(view: View, texts: ScreenTexts, grid: Grid) -> tuple[list[Item], list[Target], Box]:
    """Set what is felt and what is asked; the rest of the body is left over."""
    body, unit = grid.body, grid.unit
    items: list[Item] = []
    targets: list[Target] = []
    top = body.top
    if view.kind != "rows":
        items, targets = lay_parts(view, texts, grid=grid, top=top)
        top += 10.5 * unit
    lines = wrap(find_question(view, texts), body.width, size=QUESTION * unit, bold=True)
    height = find_height(lines, QUESTION * unit)
    items += lay_lines(Box(body.left, top, body.width, height), lines, size=QUESTION * unit, bold=True, align="center")
    top += height + (1.5 if view.kind == "rows" else 3.0) * unit
    return items, targets, Box(body.left, top, body.width, body.bottom - top)


def find_question(view: View, texts: ScreenTexts) -> str:
    """Tell what the participant is asked, or asked to do.

    Parameters
    ----------
    view : View
        What is on the screen.
    texts : ScreenTexts
        What it says.

    Returns
    -------
    str
        The words.
    """
    if view.state == "stroking":
        return texts.prompts["surface" if view.sample else "surface_unnamed"].format(sample=view.sample)
    return view.scale.question if view.scale else ""


def _split(box: Box, *, below: float) -> tuple[Box, Box]:
    height = max(box.height - below, box.height / 3)
    return Box(box.left, box.top, box.width, height), Box(box.left, box.top + height, box.width, box.height - height)


def _list_buttons(view: View, texts: ScreenTexts) -> list[Button]:
    timing = view.trial.timing if view.trial else ""
    buttons = []
    if view.state == "feeling":
        buttons.append(Button(texts.keys["stop"], "stop"))
    elif timing != "strict":
        buttons.append(Button(texts.keys["again"], "again", is_ready=view.state == "answering"))
    is_ready = view.state in {"answering", "stroking"}
    return [*buttons, Button(texts.keys["confirm"], "confirm", is_main=True, is_ready=is_ready)]
