"""From what is on the screen to where it stands: pure geometry, pixels in and boxes out."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.protocols.trial import Page
from feel321.study.screen.drawing import (
    BODY,
    DIM,
    QUESTION,
    SMALL,
    TITLE,
    Box,
    Button,
    Composition,
    Grid,
    Picture,
    Text,
    find_height,
    lay_buttons,
    lay_hints,
    lay_lines,
    lay_notice,
    lay_progress,
    measure,
    split_key,
    wrap,
)
from feel321.study.screen.parts import (
    LABEL_LINES,
    View,
    count_label_lines,
    find_slider_height,
    lay_answer,
    lay_parts,
)
from feel321.study.session.ports import Place

if TYPE_CHECKING:
    from collections.abc import Iterable

    from feel321.protocols.trial import Scale
    from feel321.study.screen.drawing import Item, Target
    from feel321.study.screen.parts import ScreenTexts

HINTS = {
    "slider": ("move", "coarse", "digits"),
    "rows": ("choose", "move", "coarse_rows", "feel"),
    "choice": ("pick",),
}
"""The keys that have no button, by kind of screen."""

COLUMN = 108.0
"""How wide a page's text is, in units: some 65 letters."""


BELOW = 1.5
"""Free space under a picture, in units."""

TEXT_SIZES = (1.1 * BODY, BODY, SMALL)
"""Sizes of a page's text in units, the first that fits; below the last nobody could read it at 1 m."""

TIGHTEST = (1920, 1080)
"""The screen that has the least room for its letters: as wide as it needs to be, and no higher."""

LINES = 3
"""Most lines of a question."""


def compose(view: View, texts: ScreenTexts, *, size: tuple[int, int]) -> Composition:
    """Lay out a screen.

    size: width and height of the screen in pixels.
    """
    grid = Grid(*size)
    place = view.place
    words = (
        texts.prompts["trial"].format(done=place.done, total=place.total)
        if _is_counted(view)
        else ""
    )
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
        ask = Text(
            grid.buttons, texts.prompts["experimenter"], SMALL * grid.unit, DIM, align="right"
        )
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
    """Set title and text as a column, smaller where it is long."""
    text = texts.pages[page.key]
    width = min(COLUMN * grid.unit, grid.body.width)
    left = (grid.width - width) / 2
    # Not by `format`: a lab's own consent may hold braces of its own.
    words = text.text.replace("{done}", str(view.place.done)).replace(
        "{total}", str(view.place.total)
    )
    paragraphs = words.strip().splitlines()
    title_size = TITLE * grid.unit
    heading = wrap(text.title, width, size=title_size, bold=True)
    for size in (share * grid.unit for share in TEXT_SIZES):
        blocks = [wrap(paragraph, width, size=size) for paragraph in paragraphs]
        gap = 0.73 * size
        height = find_height(heading, title_size) + sum(
            gap + find_height(block, size) for block in blocks
        )
        if height <= grid.body.height:
            break
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
        below = (
            find_slider_height(view.scale, grid) if view.kind == "slider" and view.scale else 0.0
        )
        box, left_over = _split(left_over, below=below, gap=BELOW * grid.unit)
        items.append(Picture(box, view.picture))
    more_items, more_targets = lay_answer(view, texts, grid=grid, box=left_over)
    buttons, button_targets = lay_buttons(
        grid, [Button(texts.keys["pause"], "pause")], _list_buttons(view, texts)
    )
    hints = (
        lay_hints(grid, [texts.keys[key] for key in HINTS[view.kind]])
        if view.state == "answering"
        else []
    )
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
    items += lay_lines(
        Box(body.left, top, body.width, height),
        lines,
        size=QUESTION * unit,
        bold=True,
        align="center",
    )
    top += height + (1.5 if view.kind == "rows" else 3.0) * unit
    return items, targets, Box(body.left, top, body.width, body.bottom - top)


def find_overflows(texts: ScreenTexts, scales: Iterable[Scale]) -> list[str]:
    """Find texts that are too long for a screen."""
    grid = Grid(*TIGHTEST)
    problems = []
    for key in texts.pages:
        view = View("page", "reading", 0, Place(999, 999), page=Page(key))
        lines = [
            item
            for item in _lay_text(view, Page(key), texts=texts, grid=grid)
            if isinstance(item, Text)
        ]
        share = (max(line.box.bottom for line in lines) - grid.body.top) / grid.body.height
        if share > 1:
            problems.append(
                f"page {key!r}: its text takes {share:.1f} screens, allowed is one; shorten it"
            )
        wide = [
            line.words
            for line in lines
            if measure(line.words, line.size, bold=line.bold) > line.box.width
        ]
        problems += [
            f"page {key!r}: got {words!r}, which fits on no line; break it" for words in wide
        ]
    for scale in scales:
        question = len(wrap(scale.question, grid.body.width, size=QUESTION * grid.unit, bold=True))
        counts = (
            ("question", question, LINES),
            ("longer label", count_label_lines(scale, grid), LABEL_LINES),
        )
        problems += [
            f"scale {scale.name!r}: its {name} takes {count} lines, allowed: {most}; shorten it"
            for name, count, most in counts
            if count > most
        ]
    return problems


def find_question(view: View, texts: ScreenTexts) -> str:
    """Tell what the participant is asked, or asked to do."""
    if view.state == "stroking":
        return texts.prompts["surface" if view.sample else "surface_unnamed"].format(
            sample=view.sample
        )
    return view.scale.question if view.scale else ""


def _split(box: Box, *, below: float, gap: float) -> tuple[Box, Box]:
    height = max(box.height - below - gap, box.height / 3)
    upper = Box(box.left, box.top, box.width, height)
    return upper, Box(box.left, upper.bottom + gap, box.width, box.height - height - gap)


def _list_buttons(view: View, texts: ScreenTexts) -> list[Button]:
    timing = view.trial.timing if view.trial else ""
    buttons = []
    if view.state == "feeling":
        buttons.append(Button(texts.keys["stop"], "stop"))
    elif timing != "strict":
        buttons.append(Button(texts.keys["again"], "again", is_ready=view.state == "answering"))
    is_ready = view.state in {"answering", "stroking"}
    return [*buttons, Button(texts.keys["confirm"], "confirm", is_main=True, is_ready=is_ready)]
