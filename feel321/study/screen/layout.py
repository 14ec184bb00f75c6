"""Screens as pure geometry: a view in, boxes of pixels out; pages, questions, and texts that are too long."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import replace

from feel321.protocols.texts import MOST_LETTERS, Question
from feel321.protocols.trial import Judgement, Page, Part, Scale, Trial
from feel321.study.keys import label_key
from feel321.study.screen import sheet as ui
from feel321.study.screen.sheet import Box, Button, Sheet, split_key
from feel321.study.screen.trials import add_trial
from feel321.study.screen.view import ScreenTexts, View
from feel321.study.session.ports import Place

COLUMN = 108.0  # width of texts and options, in units: some 65 letters

TEXT_SIZES = (1.1 * ui.BODY, ui.BODY, ui.SMALL)
"""Sizes of a page's text in units, the first that fits; below the last nobody could read it at 1 m."""

CHOSEN, OPEN = "●", "○"
"""Marks of the options, which colour alone must not tell apart."""

FIELD = 40.0  # width of the field of a number, in units
ROW, POINT = 6.6, 15.0  # heights of an option and of a Likert point, in units
POINT_LINES = 3  # most lines of the word of a point
ENDS = 2  # words of a Likert item that names no other point

TIGHTEST = (1920, 1080)
"""The screen that has the least room for its letters: as wide as it needs to be, and no higher."""


def compose(view: View, texts: ScreenTexts, *, size: tuple[int, int]) -> Sheet:
    """Lay out a screen of a size in pixels."""
    sheet, place = Sheet(*size), view.place
    # Trials that do not count, and the pages before those that do, are no progress.
    if place.done > 0 or (view.trial is not None and view.trial.phase == "main"):
        bar, share = Box(0, 0, sheet.width, 0.8 * sheet.unit), place.done / max(place.total, 1)
        sheet.fill(bar, ui.PANEL)
        sheet.fill(Box(0, 0, max(sheet.width * share, 1.0), bar.height), ui.LINE)
        words = texts.prompts["trial"].format(done=place.done, total=place.total)
        sheet.write(sheet.find_strip("top"), words, ui.SMALL, color=ui.DIM, align="right")
    if view.notice:
        _add_notice(sheet, view.notice)
    if view.question is not None:
        _add_question(sheet, view, view.question, texts=texts)
    elif view.page is not None:
        _add_page(sheet, view, view.page, texts=texts)
    elif view.trial is not None:
        add_trial(sheet, view, texts)
    return sheet


def _add_notice(sheet: Sheet, words: str) -> None:
    unit, strip = sheet.unit, sheet.find_strip("notice")
    lines = sheet.wrap(words, strip.width - 6 * unit, ui.BODY, bold=True)
    height = sheet.find_height(len(lines), ui.BODY)
    mark = Box(strip.left, strip.top + strip.height / 2 - height / 2, 0.8 * unit, height)
    box = Box(mark.right + 2 * unit, mark.top, strip.width - 4 * unit, height)
    sheet.fill(mark, ui.ORANGE)
    sheet.write(box, lines, ui.BODY, color=ui.ORANGE, bold=True)


# Pages to read.


def _add_page(sheet: Sheet, view: View, page: Page, *, texts: ScreenTexts) -> None:
    """Set title and text as a column, smaller where it is long, over the buttons."""
    text, body = texts.pages[page.key], sheet.find_strip("body")
    # Not by `format`: a lab's own consent may hold braces of its own.
    words = text.text.replace("{done}", str(view.place.done))
    paragraphs = words.replace("{total}", str(view.place.total)).strip().splitlines()
    column = _find_column(sheet)
    heading = sheet.wrap(text.title, column.width, ui.TITLE, bold=True)
    title_height = sheet.find_height(len(heading), ui.TITLE)
    for size in TEXT_SIZES:
        blocks = [sheet.wrap(paragraph, column.width, size) for paragraph in paragraphs]
        heights = [sheet.find_height(len(block), size) for block in blocks]
        gap = 0.73 * size * sheet.unit
        height = title_height + sum(gap + block for block in heights)
        if height <= body.height:
            break
    _limit_height(sheet, height)
    top = body.top + max(0.0, body.height - height) * 0.4
    sheet.write(replace(column, top=top), heading, ui.TITLE, bold=True)
    top += title_height + gap
    for block, block_height in zip(blocks, heights, strict=True):
        sheet.write(replace(column, top=top), block, size)
        top += block_height + gap
    leave = [Button(texts.keys["leave"], "pause")] if view.can_leave else []
    if page.by == "experimenter":
        strip, words = sheet.find_strip("buttons"), texts.prompts["experimenter"]
        sheet.write(strip, words, ui.SMALL, color=ui.DIM, align="right")
        sheet.add_buttons(leave, [])
        return
    key, share = texts.keys["confirm"], 0.0
    if view.left_s:
        # The number stands where the key's name will: a key that does nothing yet is not named.
        key = f"{texts.prompts['wait'].format(seconds=view.left_s)}  {split_key(key)[1]}"
        share = max(1 - view.left_s / page.least_s, 0.0) if page.least_s else 0.0
    go_on = Button(key, "confirm", is_main=True, is_ready=not view.left_s, share=share)
    sheet.add_buttons(leave, [go_on])


def _find_column(sheet: Sheet) -> Box:
    """Find the column of a page's text, without a height."""
    body = sheet.find_strip("body")
    width = min(COLUMN * sheet.unit, body.width)
    return Box((sheet.width - width) / 2, body.top, width, 0)


def _limit_height(sheet: Sheet, height: float) -> None:
    """Note what takes more than the body of a screen."""
    screens = height / sheet.find_strip("body").height
    if screens > 1 + 1e-9:
        sheet.faults.append(f"it must fit on one screen, got {screens:.1f} screens; shorten it")


# Pages to answer.


def _add_question(sheet: Sheet, view: View, question: Question, *, texts: ScreenTexts) -> None:
    """Set the question, what is answered under it, and the buttons."""
    body, unit, column = sheet.find_strip("body"), sheet.unit, _find_column(sheet)
    if question.kind == "likert":
        column = Box(body.left, body.top, body.width, 0)
    lines = sheet.wrap(question.question, column.width, ui.QUESTION, bold=True)
    height = sheet.find_height(len(lines), ui.QUESTION) + 3 * unit
    needed = height + _find_height(sheet, question, column.width)
    _limit_height(sheet, needed)
    top = body.top + max(0.0, body.height - needed) * 0.4
    sheet.write(replace(column, top=top), lines, ui.QUESTION, bold=True)
    box = Box(column.left, top + height, column.width, body.bottom - top - height)
    if question.kind == "likert":
        _add_points(sheet, view, question, box=box)
    elif question.choices:
        _add_options(sheet, view, question, box=box)
    elif question.kind == "number":
        _add_number(sheet, view, question, box=box)
    else:
        _add_letters(sheet, view, replace(box, height=needed - height))
    if not question.required:
        optional = texts.questions["optional"]
        sheet.write(sheet.find_strip("top"), optional, ui.SMALL, color=ui.DIM)
    leave, is_ready = Button(texts.keys["leave"], "pause"), question.name in view.felt
    line = texts.keys["confirm" if question.choices else "confirm_typed"]
    go_on = Button(line, "confirm", is_main=True, is_ready=is_ready, explains=True)
    sheet.add_buttons([leave], [go_on])
    sheet.add_hints([*_list_hints(question, texts)])


def _find_height(sheet: Sheet, question: Question, width: float) -> float:
    """Find the height of what is answered, in pixels."""
    unit = sheet.unit
    if question.kind == "likert":
        return POINT * unit + sheet.find_height(POINT_LINES, ui.SMALL)
    if question.kind == "text":
        letters = sheet.measure("n" * MOST_LETTERS, ui.BODY)
        return sheet.find_height(letters // (width - 6 * unit) + 2, ui.BODY)
    return (len(question.options) or 1.5) * ROW * unit


def _add_options(sheet: Sheet, view: View, question: Question, *, box: Box) -> None:
    """Set the options under each other; what was chosen is filled and marked."""
    unit = sheet.unit
    row = min(ROW * unit, box.height / len(question.options))
    for place, option in enumerate(question.options):
        field = Box(box.left, box.top + place * row, box.width, row - 0.8 * unit)
        is_chosen = view.chosen == str(place)
        ink = sheet.add_choice(field, str(place), is_chosen=is_chosen)
        mark = Box(field.left + 2 * unit, field.top, 3 * unit, field.height)
        sheet.write(mark, CHOSEN if is_chosen else OPEN, ui.BODY, color=ink)
        words = Box(mark.right + 1.5 * unit, field.top, field.width - 10 * unit, field.height)
        sheet.write(words, option, ui.BODY, color=ink, bold=is_chosen)


def _add_points(sheet: Sheet, view: View, question: Question, *, box: Box) -> None:
    """Set the points of a Likert item side by side, from low to high, with their words below."""
    unit, count = sheet.unit, len(question.options)
    named = sum(bool(text.strip()) for text in question.options)
    step = box.width / count
    # Where only the ends have words, these stand over several points.
    room = step - unit if named > ENDS else 0.45 * box.width
    for place, text in enumerate(question.options):
        field = Box(box.left + place * step, box.top, step - 1.2 * unit, (POINT - 3) * unit)
        is_chosen = view.chosen == str(place)
        ink = sheet.add_choice(field, str(place), is_chosen=is_chosen)
        upper = Box(field.left, field.top, field.width, field.height * 0.62)
        lower = Box(field.left, upper.bottom, field.width, field.height * 0.38)
        sheet.write(upper, str(place + 1), ui.QUESTION, color=ink, bold=True, align="center")
        mark = CHOSEN if is_chosen else OPEN
        sheet.write(lower, mark, ui.SMALL, color=ink, align="center")
        align, left = "center", field.left + field.width / 2 - room / 2
        if room > step:
            align = "left" if place == 0 else "right"
            left = field.left if place == 0 else field.right - room
        lines = sheet.wrap(text, room, ui.SMALL)
        sheet.write(Box(left, field.bottom + unit, room, 0), lines, ui.SMALL, align=align)
        sheet.limit_lines(len(lines), most=POINT_LINES, what=f"option {text!r}")


def _add_number(sheet: Sheet, view: View, question: Question, *, box: Box) -> None:
    """Draw a field with the digits that were typed and a cursor, beside it the numbers that are answers."""
    unit = sheet.unit
    field = Box(box.left, box.top, FIELD * unit, 1.5 * ROW * unit)
    sheet.fill(field, ui.PANEL, line=ui.BLUE, round_px=unit, line_px=0.3 * unit)
    inner = Box(field.left + 3 * unit, field.top, field.width - 6 * unit, field.height)
    sheet.write(inner, f"{view.typed}_", ui.QUESTION, bold=True)
    beside = Box(field.right + 3 * unit, field.top, box.right - field.right, field.height)
    if question.low is not None or question.high is not None:
        sheet.write(beside, question.describe_range(), ui.BODY, color=ui.DIM)


def _add_letters(sheet: Sheet, view: View, field: Box) -> None:
    """Draw a field with the last lines of what was typed, and a cursor; words without an end are cut."""
    unit, room = sheet.unit, field.width - 6 * sheet.unit
    sheet.fill(field, ui.PANEL, line=ui.BLUE, round_px=unit, line_px=0.3 * unit)
    pieces: list[str] = []
    for line in sheet.wrap(f"{view.typed}_", room, ui.BODY):
        pieces.append("")
        for letter in line:
            if pieces[-1] and sheet.measure(pieces[-1] + letter, ui.BODY) > room:
                pieces.append("")
            pieces[-1] += letter
    most = max(1, int((field.height - 2 * unit) // sheet.find_height(1, ui.BODY)))
    sheet.write(Box(field.left + 3 * unit, field.top + unit, room, 0), pieces[-most:], ui.BODY)


def _list_hints(question: Question, texts: ScreenTexts) -> Iterator[str]:
    """List the keys that have no button."""
    prompts, keys = texts.questions, texts.own_keys
    if not question.choices:
        yield f"0–9 {'. -' if question.kind == 'number' else 'A–Z'}  {prompts['type']}"
        yield f"⌫  {prompts['delete']}"
        return
    actions = ("left", "right") if question.kind == "likert" else ("up", "down")
    arrows = " ".join(label_key(keys.find_key(action), {}) for action in actions)
    yield f"{arrows}  {prompts['pick']}"
    if keys.type_values:
        yield f"1–{len(question.choices)}  {prompts['pick']}"


# Texts that are too long.


def find_overflows(
    texts: ScreenTexts,
    scales: Iterable[Scale],
    questions: Iterable[Question] = (),
    *,
    together: Collection[str] = (),
) -> list[str]:
    """Find texts that are too long for a screen; together: names of scales that share one."""
    views = {
        f"page {key!r}": View("page", "reading", 0, Place(999, 999), page=Page(key))
        for key in texts.pages
    }
    views |= {f"scale {one.name!r}": _show_scale(one, together=together) for one in scales}
    views |= {
        f"question {one.name!r}": View(
            "page", "reading", 0, Place(0, 0), page=Page(one.key), question=one
        )
        for one in questions
    }
    return [
        f"{name}: {fault}"
        for name, view in views.items()
        for fault in dict.fromkeys(compose(view, texts, size=TIGHTEST).faults)
    ]


def _show_scale(scale: Scale, *, together: Collection[str]) -> View:
    """Show a trial that is answered on a scale, alone or as one of several."""
    parts, judgements = (Part("test", ""),), (Judgement("test", "", scale=scale.name),)
    trial = Trial(0, 0, 0, "", "", "replay", "", parts, judgements)
    kind = "choice" if scale.choices else "scales" if scale.name in together else "slider"
    return View(kind, "answering", 0, Place(0, 0), trial=trial, scale=scale)
