"""Screens as pure geometry: a view in, boxes of pixels out; pages, and texts that are too long for a screen."""

from collections.abc import Collection, Iterable

from feel321.protocols.questions import Question
from feel321.protocols.trial import Page, Scale
from feel321.study.screen.asking import add_question, find_question_overflows
from feel321.study.screen.drawing import Box, Sheet, Text, measure
from feel321.study.screen.rating import add_trial, find_scale_overflows
from feel321.study.screen.view import (
    BODY,
    DIM,
    LINE,
    ORANGE,
    PANEL,
    SMALL,
    TITLE,
    Button,
    ScreenTexts,
    View,
    add_buttons,
    split_key,
)
from feel321.study.session.ports import Place

COLUMN = 108.0  # width of a page's text, in units: some 65 letters

TEXT_SIZES = (1.1 * BODY, BODY, SMALL)
"""Sizes of a page's text in units, the first that fits; below the last nobody could read it at 1 m."""

TIGHTEST = (1920, 1080)
"""The screen that has the least room for its letters: as wide as it needs to be, and no higher."""


def compose(view: View, texts: ScreenTexts, *, size: tuple[int, int]) -> Sheet:
    """Lay out a screen of a size in pixels."""
    sheet, place = Sheet(*size), view.place
    # Trials that do not count, and the pages before those that do, are no progress.
    if place.done > 0 or (view.trial is not None and view.trial.phase == "main"):
        bar, share = Box(0, 0, sheet.width, 0.8 * sheet.unit), place.done / max(place.total, 1)
        sheet.fill(bar, PANEL)
        sheet.fill(Box(0, 0, max(sheet.width * share, 1.0), bar.height), LINE)
        words = texts.prompts["trial"].format(done=place.done, total=place.total)
        sheet.write(sheet.find_strip("top"), words, SMALL, color=DIM, align="right")
    if view.notice:
        _add_notice(sheet, view.notice)
    if view.question is not None:
        add_question(sheet, view, view.question, texts=texts)
    elif view.page is not None:
        _add_page(sheet, view, view.page, texts=texts)
    elif view.trial is not None:
        add_trial(sheet, view, texts)
    return sheet


def find_overflows(
    texts: ScreenTexts,
    scales: Iterable[Scale],
    questions: Iterable[Question] = (),
    *,
    together: Collection[str] = (),
) -> list[str]:
    """Find texts that are too long for a screen; together: names of scales that share one."""
    problems = []
    for key in texts.pages:
        sheet, page = Sheet(*TIGHTEST), Page(key)
        body = sheet.find_strip("body")
        _add_text(sheet, View("page", "reading", 0, Place(999, 999), page=page), page, texts=texts)
        lines = [item for item in sheet.items if isinstance(item, Text)]
        share = (max(line.box.bottom for line in lines) - body.top) / body.height
        if share > 1:
            problems.append(
                f"page {key!r}: its text must fit on one screen, got {share:.1f} screens; shorten it"
            )
        problems += [
            f"page {key!r}: got {line.words!r}, which fits on no line; break it"
            for line in lines
            if measure(line.words, line.size, bold=line.bold) > line.box.width
        ]
    for scale in scales:
        sheet = Sheet(*TIGHTEST)
        problems += find_scale_overflows(scale, sheet, is_shared=scale.name in together)
    for asked in questions:
        problems += find_question_overflows(asked, Sheet(*TIGHTEST))
    return problems


def _add_notice(sheet: Sheet, words: str) -> None:
    unit, strip = sheet.unit, sheet.find_strip("notice")
    lines = sheet.wrap(words, strip.width - 6 * unit, BODY, bold=True)
    height = sheet.find_height(len(lines), BODY)
    mark = Box(strip.left, strip.top + strip.height / 2 - height / 2, 0.8 * unit, height)
    box = Box(mark.right + 2 * unit, mark.top, strip.width - 4 * unit, height)
    sheet.fill(mark, ORANGE)
    sheet.write(box, lines, BODY, color=ORANGE, bold=True)


# Pages.


def _add_page(sheet: Sheet, view: View, page: Page, *, texts: ScreenTexts) -> None:
    _add_text(sheet, view, page, texts=texts)
    leave = [Button(texts.keys["leave"], "pause")] if view.can_leave else []
    if page.by == "experimenter":
        strip, words = sheet.find_strip("buttons"), texts.prompts["experimenter"]
        sheet.write(strip, words, SMALL, color=DIM, align="right")
        add_buttons(sheet, leave, [])
        return
    key, share = texts.keys["confirm"], 0.0
    if view.left_s:
        # The number stands where the key's name will: a key that does nothing yet is not named.
        key = f"{texts.prompts['wait'].format(seconds=view.left_s)}  {split_key(key)[1]}"
        share = max(1 - view.left_s / page.least_s, 0.0) if page.least_s else 0.0
    go_on = Button(key, "confirm", is_main=True, is_ready=not view.left_s, share=share)
    add_buttons(sheet, leave, [go_on])


def _add_text(sheet: Sheet, view: View, page: Page, *, texts: ScreenTexts) -> None:
    """Set title and text as a column, smaller where it is long."""
    text, body, unit = texts.pages[page.key], sheet.find_strip("body"), sheet.unit
    width = min(COLUMN * unit, body.width)
    left = (sheet.width - width) / 2
    # Not by `format`: a lab's own consent may hold braces of its own.
    words = text.text.replace("{done}", str(view.place.done))
    paragraphs = words.replace("{total}", str(view.place.total)).strip().splitlines()
    heading = sheet.wrap(text.title, width, TITLE, bold=True)
    title_height = sheet.find_height(len(heading), TITLE)
    for size in TEXT_SIZES:
        blocks = [sheet.wrap(paragraph, width, size) for paragraph in paragraphs]
        heights = [sheet.find_height(len(block), size) for block in blocks]
        gap = 0.73 * size * unit
        height = title_height + sum(gap + block for block in heights)
        if height <= body.height:
            break
    top = body.top + max(0.0, body.height - height) * 0.4
    sheet.write(Box(left, top, width, 0), heading, TITLE, bold=True)
    top += title_height + gap
    for block, block_height in zip(blocks, heights, strict=True):
        sheet.write(Box(left, top, width, 0), block, size)
        top += block_height + gap
