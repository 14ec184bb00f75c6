"""Question pages: the answer while it is given, by keys or mouse, and where everything stands on the screen."""

from dataclasses import dataclass, replace

from feel321.protocols.questions import MOST_LETTERS, Answer, Question
from feel321.study.keys import KeysTable, label_key
from feel321.study.screen import view as ui
from feel321.study.screen.drawing import GROUND, INK, Box, Sheet, Target
from feel321.study.screen.input import InputEvent
from feel321.study.screen.view import ScreenTexts, View

ENTER, BACKSPACE = "enter", "backspace"
NUMBER_SIGNS = frozenset("0123456789.,-")
MOST_DIGITS = 12

CHOSEN, OPEN = "●", "○"
"""Marks of the options, which colour alone must not tell apart."""

COLUMN, FIELD = 108.0, 40.0  # widths of options and texts, and of a number's field, in units
ROW, POINT = 6.6, 15.0  # heights of an option and of a Likert point, in units
POINT_LINES = 3  # most lines of the word of a point
ENDS = 2  # words of a Likert item that names no other point


class Form:
    """The answer to a question, and what keys and clicks do to it."""

    def __init__(self, question: Question, keys: KeysTable) -> None:
        self.question, self._keys = question, keys
        self.typed, self.chosen = "", ""

    @property
    def answer(self) -> Answer:
        """The answer as it stands; None where there is none, text where it is no number yet."""
        if self.question.choices:
            return self.question.choices[int(self.chosen)] if self.chosen else None
        text = self.typed.strip()
        if self.question.kind == "text" or not text:
            return text or None
        try:
            return float(text.replace(",", "."))
        except ValueError:
            return text

    def name_action(self, key: str) -> str:
        """Name what a key does besides answering: where an answer is typed, Enter and keys that write nothing."""
        is_typed = not self.question.choices
        if is_typed and key == ENTER:
            return "next"
        writes = len(key) == 1 or key in {"space", "comma", "period", "minus", "plus", "slash"}
        return "" if is_typed and writes else self._keys.name_action(key)

    def take(self, event: InputEvent, target: Target | None) -> None:
        """Do what an event asks for."""
        if event.kind == "click" and target is not None and target.name == "choose":
            self.chosen = target.part
        elif event.kind == "text" and not self.question.choices:
            self._type(event.key)
        elif event.kind == "press" and self.question.choices:
            self._choose(event.key)

    def _type(self, letters: str) -> None:
        if letters == BACKSPACE:
            self.typed = self.typed[:-1]
            return
        is_number = self.question.kind == "number"
        most = MOST_DIGITS if is_number else MOST_LETTERS
        allowed = [
            one for one in letters if one.isprintable() and (not is_number or one in NUMBER_SIGNS)
        ]
        self.typed = (self.typed + "".join(allowed))[:most]

    def _choose(self, key: str) -> None:
        last = len(self.question.choices) - 1
        action = self._keys.name_action(key)
        if action in {"", "type_values"}:
            if key.isdigit() and 0 < int(key) <= last + 1:
                self.chosen = str(int(key) - 1)
        elif (step := {"up": -1, "left": -1, "down": 1, "right": 1}.get(action)) is not None:
            place = (0 if step > 0 else last) if not self.chosen else int(self.chosen) + step
            self.chosen = str(min(max(place, 0), last))


def fill_in(view: View, form: Form) -> View:
    """Put the answer as it stands into a view."""
    is_done = not form.question.find_fault(form.answer)
    felt = frozenset({form.question.name}) if is_done else frozenset[str]()
    return replace(view, typed=form.typed, chosen=form.chosen, felt=felt)


def add_question(sheet: Sheet, view: View, question: Question, *, texts: ScreenTexts) -> None:
    """Put a question page on a sheet."""
    body, unit = sheet.find_strip("body"), sheet.unit
    width = body.width if question.kind == "likert" else min(COLUMN * unit, body.width)
    left = (sheet.width - width) / 2
    lines = sheet.wrap(question.question, width, ui.QUESTION, bold=True)
    height = sheet.find_height(len(lines), ui.QUESTION)
    needed = height + 3 * unit + _find_height(sheet, question, width)
    top = body.top + max(0.0, body.height - needed) * 0.4
    sheet.write(Box(left, top, width, 0), lines, ui.QUESTION, bold=True)
    top += height + 3 * unit
    box = Box(left, top, width, body.bottom - top)
    own = _QuestionLayout(sheet, view, question)
    if not question.choices:
        own.add_field(box)
    elif question.kind == "likert":
        own.add_points(box)
    else:
        own.add_options(box)
    if not question.required:
        strip = sheet.find_strip("top")
        sheet.write(strip, texts.questions["optional"], ui.SMALL, color=ui.DIM)
    leave = [ui.Button(texts.keys["leave"], "pause")]
    is_ready = question.name in view.felt
    go_on = ui.Button(
        texts.keys["confirm"], "confirm", is_main=True, is_ready=is_ready, explains=True
    )
    ui.add_buttons(sheet, leave, [go_on])
    ui.add_hints(sheet, _list_hints(question, texts))


def find_question_overflows(question: Question, sheet: Sheet) -> list[str]:
    """Find what of a question is too long for a screen."""
    body, unit = sheet.find_strip("body"), sheet.unit
    width = min(COLUMN * unit, body.width)
    lines = sheet.wrap(question.question, width, ui.QUESTION, bold=True)
    height = sheet.find_height(len(lines), ui.QUESTION) + 3 * unit
    height += _find_height(sheet, question, width)
    room = width - 10 * unit
    if question.kind == "likert":
        room = _find_point_width(sheet, question)
        words = [word for text in question.options for word in text.split()]
        too_wide = [word for word in words if sheet.measure(word, ui.SMALL) > room]
        wrapped = [sheet.wrap(text, room, ui.SMALL) for text in question.options]
        too_wide += [" ".join(block) for block in wrapped if len(block) > POINT_LINES]
    else:
        too_wide = [text for text in question.options if sheet.measure(text, ui.BODY) > room]
    faults = [f"its option {text!r} is too long for the screen; shorten it" for text in too_wide]
    if height > body.height:
        faults.append(
            f"it must fit on one screen, got {height / body.height:.1f} screens; shorten it"
        )
    return [f"question {question.name!r}: {fault}" for fault in faults]


def _find_height(sheet: Sheet, question: Question, width: float) -> float:
    """Find the height of what is answered, in pixels."""
    unit = sheet.unit
    if question.kind == "likert":
        return POINT * unit + sheet.find_height(POINT_LINES, ui.SMALL)
    if question.kind == "text":
        letters = sheet.measure("n" * MOST_LETTERS, ui.BODY)
        return sheet.find_height(letters // (width - 6 * unit) + 2, ui.BODY)
    return (len(question.options) or 1.5) * ROW * unit


def _find_point_width(sheet: Sheet, question: Question) -> float:
    """Find the width that the word of a point may take: more where only the ends have one."""
    width, count = sheet.find_strip("body").width, len(question.options)
    named = sum(bool(text.strip()) for text in question.options)
    return width / count - sheet.unit if named > ENDS else 0.45 * width


@dataclass(frozen=True, slots=True)
class _QuestionLayout:
    """Puts what is answered on a sheet."""

    sheet: Sheet
    view: View
    question: Question

    def add_options(self, box: Box) -> None:
        """Set the options under each other; what was chosen is filled and marked."""
        sheet, view, question, unit = self.sheet, self.view, self.question, self.sheet.unit
        row = min(ROW * unit, box.height / len(question.options))
        for place, option in enumerate(question.options):
            field = Box(box.left, box.top + place * row, box.width, row - 0.8 * unit)
            is_chosen = view.chosen == str(place)
            ink = GROUND if is_chosen else INK
            sheet.fill(
                field,
                ui.BLUE if is_chosen else ui.PANEL,
                line=ui.LINE,
                round_px=unit,
                line_px=0.2 * unit,
            )
            mark = Box(field.left + 2 * unit, field.top, 3 * unit, field.height)
            sheet.write(mark, CHOSEN if is_chosen else OPEN, ui.BODY, color=ink)
            words = Box(mark.right + 1.5 * unit, field.top, field.width - 10 * unit, field.height)
            sheet.write(words, option, ui.BODY, color=ink, bold=is_chosen)
            sheet.targets.append(Target(field, "choose", str(place)))

    def add_points(self, box: Box) -> None:
        """Set the points of a Likert item side by side, from low to high, with their words below."""
        sheet, view, question, unit = self.sheet, self.view, self.question, self.sheet.unit
        count = len(question.options)
        step, room = box.width / count, _find_point_width(sheet, question)
        for place, text in enumerate(question.options):
            field = Box(box.left + place * step, box.top, step - 1.2 * unit, (POINT - 3) * unit)
            is_chosen = view.chosen == str(place)
            sheet.fill(
                field,
                ui.BLUE if is_chosen else ui.PANEL,
                line=ui.LINE,
                round_px=unit,
                line_px=0.2 * unit,
            )
            ink = GROUND if is_chosen else INK
            upper = Box(field.left, field.top, field.width, field.height * 0.62)
            lower = Box(field.left, upper.bottom, field.width, field.height * 0.38)
            sheet.write(upper, str(place + 1), ui.QUESTION, color=ink, bold=True, align="center")
            mark = CHOSEN if is_chosen else OPEN
            sheet.write(lower, mark, ui.SMALL, color=ink, align="center")
            sheet.targets.append(Target(field, "choose", str(place)))
            align, left = "center", field.left + field.width / 2 - room / 2
            if room > step:  # the words of the ends stand over several points
                align = "left" if place == 0 else "right"
                left = field.left if place == 0 else field.right - room
            words = Box(left, field.bottom + unit, room, 0)
            sheet.write(
                words, sheet.wrap(text, room, ui.SMALL) if text else [], ui.SMALL, align=align
            )

    def add_field(self, box: Box) -> None:
        """Draw a field with what was typed, and a cursor."""
        sheet, view, question, unit = self.sheet, self.view, self.question, self.sheet.unit
        words = f"{view.typed}_"
        if question.kind == "number":
            field = Box(box.left, box.top, FIELD * unit, 1.5 * ROW * unit)
            sheet.fill(field, ui.PANEL, line=ui.BLUE, round_px=unit, line_px=0.3 * unit)
            inner = Box(field.left + 3 * unit, field.top, field.width - 6 * unit, field.height)
            sheet.write(inner, words, ui.QUESTION, bold=True)
            beside = Box(field.right + 3 * unit, field.top, box.right - field.right, field.height)
            if question.low is not None or question.high is not None:
                sheet.write(beside, question.describe_range(), ui.BODY, color=ui.DIM)
            return
        field = Box(box.left, box.top, box.width, _find_height(sheet, question, box.width))
        sheet.fill(field, ui.PANEL, line=ui.BLUE, round_px=unit, line_px=0.3 * unit)
        room = field.width - 6 * unit
        lines = [
            piece for line in sheet.wrap(words, room, ui.BODY) for piece in _cut(sheet, line, room)
        ]
        most = max(1, int((field.height - 2 * unit) // sheet.find_height(1, ui.BODY)))
        sheet.write(Box(field.left + 3 * unit, field.top + unit, room, 0), lines[-most:], ui.BODY)


def _cut(sheet: Sheet, line: str, room: float) -> list[str]:
    """Cut a line that holds no space where it is too wide."""
    pieces, piece = [], ""
    for letter in line:
        if piece and sheet.measure(piece + letter, ui.BODY) > room:
            pieces.append(piece)
            piece = ""
        piece += letter
    return [*pieces, piece]


def _list_hints(question: Question, texts: ScreenTexts) -> list[str]:
    """List the keys that have no button."""
    prompts, keys = texts.questions, texts.own_keys
    if not question.choices:
        return [
            f"0–9 {'. -' if question.kind == 'number' else 'A–Z'}  {prompts['type']}",
            f"⌫  {prompts['delete']}",
        ]
    actions = ("left", "right") if question.kind == "likert" else ("up", "down")
    arrows = " ".join(label_key(keys.find_key(action), {}) for action in actions)
    digits = f"1–{len(question.choices)}" if keys.type_values else ""
    return [f"{one}  {prompts['pick']}" for one in (arrows, digits) if one]
