"""Screens as pure geometry: a view in, boxes of pixels out; pages, questions, trials, and texts that are too long."""

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace

from feel321.protocols.texts import MOST_LETTERS, Question
from feel321.protocols.trial import RATING_RANGE, Judgement, Page, Part, Scale, Trial
from feel321.study.keys import label_key
from feel321.study.screen import sheet as ui
from feel321.study.screen.input import LOOP, ScreenTexts, View
from feel321.study.screen.sheet import GROUND, INK, Box, Button, Photo, Sheet, Target, split_key
from feel321.study.session.ports import Place

COLUMN, FIELD = 108.0, 40.0  # widths in units: of texts (some 65 letters), of a number's field
TEXT_SIZES = (1.1 * ui.BODY, ui.BODY, ui.SMALL)  # of a page; less is illegible at 1 m
CHOSEN, OPEN, FELT = "●", "○", "✓"  # colour alone must not tell them apart
ROW, POINT = 6.6, 15.0  # heights of an option or a row, and of a Likert point, in units
POINT_LINES, QUESTION_LINES, LABEL_LINES = 3, 3, 2  # most lines of each
ENDS = 2  # words of a Likert item that names no other point
LABEL = 0.45  # largest width of a slider's label, as a share of the track
SOON_S = 3  # from when on the time that is left for an answer stands out
BELOW = 1.5  # free space under a picture, in units
TIGHTEST = (1920, 1080)  # the screen with the least room for its letters: as wide as it needs to be
# In units: over a slider's track, its height, and free under it. Where a trial has several: the height of each, of its
# track, and of the least picture beside them; the widths of what is free at its left, and of the number at its right.
ABOVE, TRACK, UNDER = 8.0, 4.5, 1.0
BLOCK, BLOCK_TRACK, LEAST_PICTURE = 15.0, 4.0, 12.0
MARGIN, VALUE = 2.5, 9.0

HINTS = {  # the keys that have no button, by kind of screen
    "slider": ("move", "coarse_rows", "digits"),
    "rows": ("feel", "loop", "choose", "move", "coarse_rows"),
    "scales": ("move", "coarse_rows", "digits"),
    "choice": ("pick",),
}


def compose(view: View, texts: ScreenTexts, *, size: tuple[int, int]) -> Sheet:
    """Lay out a screen of a size in pixels."""
    sheet, place = Sheet(*size), view.place
    unit = sheet.unit
    # Trials that do not count, and the pages before those that do, are no progress.
    if place.done > 0 or (view.trial is not None and view.trial.phase == "main"):
        bar, share = Box(0, 0, sheet.width, 0.8 * unit), place.done / max(place.total, 1)
        sheet.fill(bar, ui.PANEL)
        sheet.fill(bar._replace(width=max(sheet.width * share, 1.0)), ui.LINE)
        words = texts.prompts["trial"].format(done=place.done, total=place.total)
        sheet.write(sheet.find_strip("top"), words, ui.SMALL, color=ui.DIM, align="right")
    if view.notice:
        strip = sheet.find_strip("notice")
        lines = sheet.wrap(view.notice, strip.width - 6 * unit, ui.BODY, bold=True)
        height = sheet.find_height(len(lines), ui.BODY)
        mark = Box(strip.left, strip.top + strip.height / 2 - height / 2, 0.8 * unit, height)
        sheet.fill(mark, ui.ORANGE)
        box = mark._replace(left=mark.right + 2 * unit, width=strip.width - 4 * unit)
        sheet.write(box, lines, ui.BODY, color=ui.ORANGE, bold=True)
    if view.question is not None:
        _add_question(sheet, view, view.question, texts=texts)
    elif view.page is not None:
        _add_page(sheet, view, view.page, texts=texts)
    elif view.trial is not None and view.scale is not None:
        _TrialLayout(sheet, view, texts, view.trial, view.scale).add()
    return sheet


def _add_page(sheet: Sheet, view: View, page: Page, *, texts: ScreenTexts) -> None:
    """Set title and text as a column, smaller where it is long, over the buttons and what to press."""
    text, column = texts.pages[page.key], sheet.find_strip("body", width=COLUMN)
    # Not by `format`: a lab's own consent may hold braces of its own.
    words = text["text"].replace("{answered}", str(view.place.answered))
    paragraphs = words.replace("{total}", str(view.place.total)).strip().splitlines()
    heading = sheet.wrap(text["title"], column.width, ui.TITLE, bold=True)
    for size in TEXT_SIZES:
        gap = 0.73 * size * sheet.unit
        blocks = [sheet.wrap(paragraph, column.width, size) for paragraph in paragraphs]
        heights = [sheet.find_height(len(block), size) for block in blocks]
        heights.insert(0, sheet.find_height(len(heading), ui.TITLE))
        height = sum(heights) + gap * len(blocks)
        if height <= column.height:
            break
    column = column._replace(top=_find_top(sheet, height))
    sheet.write(column, heading, ui.TITLE, bold=True)
    for block, above in zip(blocks, heights, strict=False):
        column = column._replace(top=column.top + above + gap)
        sheet.write(column, block, size)
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
    else:
        strip = sheet.find_strip("hints")
        sheet.write(strip, texts.prompts["go_on"], ui.BODY, align="center")
    go_on = Button(key, "confirm", is_main=True, is_ready=not view.left_s, share=share)
    sheet.add_buttons(leave, [go_on])


def _find_top(sheet: Sheet, height: float) -> float:
    """Find where what is so high begins, and note what is too high."""
    body = sheet.find_strip("body")
    if (screens := height / body.height) > 1 + 1e-9:
        sheet.faults.append(f"it must fit on one screen, got {screens:.1f} screens; shorten it")
    return body.top + max(0.0, body.height - height) * 0.4


def _add_question(sheet: Sheet, view: View, question: Question, *, texts: ScreenTexts) -> None:
    unit, is_likert = sheet.unit, question.kind == "likert"
    column = sheet.find_strip("body", width=ui.WIDEST if is_likert else COLUMN)
    needed, bottom = (len(question.options) or 1.5) * ROW * unit, column.bottom
    if is_likert:
        needed = POINT * unit + sheet.find_height(POINT_LINES, ui.SMALL)
    elif question.kind == "text":
        letters = sheet.measure("n" * MOST_LETTERS, ui.BODY)
        needed = sheet.find_height(letters // (column.width - 6 * unit) + 2, ui.BODY)
    lines = sheet.wrap(question.question, column.width, ui.QUESTION, bold=True)
    height = sheet.find_height(len(lines), ui.QUESTION) + 3 * unit
    column = column._replace(top=_find_top(sheet, height + needed))
    sheet.write(column, lines, ui.QUESTION, bold=True)
    top = column.top + height
    box = column._replace(top=top, height=bottom - top)
    if is_likert:
        _add_points(sheet, view, question.options, box=box)
    elif question.choices:
        _add_options(sheet, view, question.options, box=box)
    else:
        _add_field(sheet, view, question, box=box._replace(height=needed))
    prompts, keys = texts.questions, texts.own_keys
    if not question.required:
        sheet.write(sheet.find_strip("top"), prompts["optional"], ui.SMALL, color=ui.DIM)
    line = texts.keys["confirm" if question.choices else "confirm_typed"]
    is_ready = question.name in view.felt
    go_on = Button(line, "confirm", is_main=True, is_ready=is_ready, explains=True)
    sheet.add_buttons([Button(texts.keys["leave"], "pause")], [go_on])
    signs = ". -" if question.kind == "number" else "A–Z"
    hints = [f"0–9 {signs}  {prompts['type']}", f"⌫  {prompts['delete']}"]
    if question.choices:
        actions = ("left", "right") if is_likert else ("up", "down")
        arrows = " ".join(label_key(keys.find_key(action), {}) for action in actions)
        hints = [f"{arrows}  {prompts['pick']}"]
        hints += [f"1–{len(question.choices)}  {prompts['pick']}"] if keys.type_values else []
    sheet.add_hints(hints)


def _add_options(sheet: Sheet, view: View, options: Sequence[str], *, box: Box) -> None:
    unit, row = sheet.unit, min(ROW * sheet.unit, box.height / len(options))
    for place, option in enumerate(options):
        field = Box(box.left, box.top + place * row, box.width, row - 0.8 * unit)
        is_chosen = view.chosen == str(place)
        ink = sheet.add_choice(field, str(place), is_chosen=is_chosen)
        mark = field._replace(left=field.left + 2 * unit, width=3 * unit)
        sheet.write(mark, CHOSEN if is_chosen else OPEN, ui.BODY, color=ink)
        words = field._replace(left=mark.right + 1.5 * unit, width=field.width - 10 * unit)
        sheet.write(words, option, ui.BODY, color=ink, bold=is_chosen)


def _add_points(sheet: Sheet, view: View, options: Sequence[str], *, box: Box) -> None:
    """Set the points of a Likert item side by side, from low to high, with their words below."""
    unit, step = sheet.unit, box.width / len(options)
    # Where only the ends have words, these stand over several points.
    is_named = sum(bool(text.strip()) for text in options) > ENDS
    room = step - unit if is_named else 0.45 * box.width
    for place, text in enumerate(options):
        field = Box(box.left + place * step, box.top, step - 1.2 * unit, (POINT - 3) * unit)
        is_chosen = view.chosen == str(place)
        ink = sheet.add_choice(field, str(place), is_chosen=is_chosen)
        upper = field._replace(height=field.height * 0.62)
        lower = field._replace(top=upper.bottom, height=field.height * 0.38)
        sheet.write(upper, str(place + 1), ui.QUESTION, color=ink, bold=True, align="center")
        sheet.write(lower, CHOSEN if is_chosen else OPEN, ui.SMALL, color=ink, align="center")
        align, left = "center", field.left + field.width / 2 - room / 2
        if room > step:
            align = "left" if place == 0 else "right"
            left = field.left if place == 0 else field.right - room
        lines = sheet.wrap(text, room, ui.SMALL)
        sheet.write(Box(left, field.bottom + unit, room), lines, ui.SMALL, align=align)
        sheet.limit_lines(len(lines), most=POINT_LINES, what=f"option {text!r}")


def _add_field(sheet: Sheet, view: View, question: Question, *, box: Box) -> None:
    """Draw a field with what was typed: of a text its last lines, in which words without an end are cut."""
    unit, typed, is_number = sheet.unit, f"{view.typed}_", question.kind == "number"
    field = box._replace(width=FIELD * unit) if is_number else box
    sheet.fill(field, ui.PANEL, line=ui.BLUE, round_px=unit, line_px=0.3 * unit)
    inner = field._replace(left=field.left + 3 * unit, width=field.width - 6 * unit)
    if is_number:
        sheet.write(inner, typed, ui.QUESTION, bold=True)
        if (question.low, question.high) != (None, None):
            beside = field._replace(left=field.right + 3 * unit, width=box.right - field.right)
            sheet.write(beside, question.describe_range(), ui.BODY, color=ui.DIM)
        return
    pieces: list[str] = []
    for line in sheet.wrap(typed, inner.width, ui.BODY):
        pieces.append("")
        for letter in line:
            if pieces[-1] and sheet.measure(pieces[-1] + letter, ui.BODY) > inner.width:
                pieces.append("")
            pieces[-1] += letter
    most = max(1, int((field.height - 2 * unit) // sheet.find_height(1, ui.BODY)))
    sheet.write(inner._replace(top=field.top + unit), pieces[-most:], ui.BODY)


@dataclass(frozen=True, slots=True)
class _TrialLayout:
    """Puts on a sheet what is felt in a trial, what is asked, and where it is answered."""

    sheet: Sheet
    view: View
    texts: ScreenTexts
    trial: Trial
    scale: Scale

    def add(self) -> None:
        sheet, view = self.sheet, self.view
        box = sheet.find_strip("body")
        if view.kind != "rows":
            self.add_parts(box.top)
            box = box.lower(10.5 * sheet.unit)
        if view.kind == "scales" and view.state != "stroking":
            self.add_scales(box)
        else:
            ways = {"rows": self.add_rows, "slider": self.add_slider, "choice": self.add_choices}
            box = self.add_question(box)
            if view.kind in ways:
                ways[view.kind](box)
        self.add_keys()
        if view.state == "answering" and view.left_s:
            color = ui.ORANGE if view.left_s <= SOON_S else ui.DIM
            sheet.write(sheet.find_strip("top"), f"{view.left_s} s", ui.SMALL, color=color)

    def add_question(self, box: Box) -> Box:
        """Add what is asked, and the picture of the surface; returns what is free below."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        is_rows, question = view.kind == "rows", self.scale.question
        if view.state == "stroking":
            prompt = self.texts.prompts["surface" if view.sample else "surface_unnamed"]
            question = prompt.format(sample=view.sample)
        lines = sheet.wrap(question, box.width, ui.QUESTION, bold=True)
        sheet.write(box, lines, ui.QUESTION, bold=True, align="center")
        sheet.limit_lines(len(lines), most=QUESTION_LINES, what="question")
        height = sheet.find_height(len(lines), ui.QUESTION)
        box = box.lower(height + (1.5 if is_rows else 3.0) * unit)
        if view.picture and not is_rows:
            below = self.measure_slider()[2] if view.kind == "slider" else 0.0
            height = max(box.height - below - BELOW * unit, box.height / 3)
            sheet.items.append(Photo(box._replace(height=height), view.picture))
            box = box.lower(height + BELOW * unit)
        return box

    def add_keys(self) -> None:
        keys, view = self.texts.keys, self.view
        is_open = view.state == "answering" or view.loops
        is_answered = bool(view.chosen) or view.markers.keys() >= set(self.trial.judged)
        is_ready = view.state == "stroking" or (is_open and not view.unfelt and is_answered)
        state = {"is_main": True, "is_ready": is_ready, "explains": is_open}
        right = [Button(keys["confirm"], "confirm", **state)]
        if view.state == "feeling":
            right.insert(0, Button(keys["stop"], "stop"))
        elif self.trial.timing != "strict":
            right.insert(0, Button(keys["again"], "again", is_ready=view.state == "answering"))
        self.sheet.add_buttons([Button(keys["pause"], "pause")], right)
        if view.can_answer:
            hints = [keys[key] for key in HINTS[view.kind]]
            if view.kind == "scales":
                arrows = keys["choose"].partition("  ")[0]
                hints.insert(0, f"{arrows}  {self.texts.questions['pick']}")
            self.sheet.add_hints(hints)

    def add_parts(self, top: float) -> None:
        sheet, unit, name_part = self.sheet, self.sheet.unit, self.texts.name_part
        # A reference that is stroked is called by what it is.
        parts = self.trial.parts
        names = {p.name: name_part("surface" if p.surface else p.name) for p in parts}
        # Wide enough that a tick stands apart from the name, which stays in the middle.
        width = max(sheet.measure(name, ui.BODY, bold=True) for name in names.values()) + 14 * unit
        boxes = sheet.line_up([width] * len(names), 2 * unit, Box(0, top, sheet.width, 7 * unit))
        for part, box in zip(names, boxes, strict=True):
            self.add_part(box, part, names[part], size=ui.BODY)
            if self.view.state == "answering" and self.trial.timing != "strict":
                sheet.targets.append(Target(box, "feel", part))

    def add_part(self, box: Box, part: str, name: str, *, size: float) -> None:
        """Draw a part: filled while it is on, ticked once it was felt."""
        sheet, size_px = self.sheet, size * self.sheet.unit
        is_on, is_felt = part == self.view.playing, part in self.view.felt
        ink = GROUND if is_on else INK if is_felt else ui.DIM
        tick = sheet.measure(FELT, size, bold=True)
        fill, line = (ui.BLUE, "") if is_on else (ui.PANEL, ui.LINE)
        sheet.fill(box, fill, line=line, round_px=size_px / 2.5, line_px=size_px / 12)
        inner = box._replace(left=box.left + 1.6 * tick, width=box.width - 3.2 * tick)
        sheet.write(inner, name, size, color=ink, bold=True, align="center")
        if self.view.loops and is_on:
            left = box._replace(left=box.left + 0.5 * tick, width=tick)
            sheet.write(left, LOOP, size, color=ink, bold=True)
        if is_felt:
            right = box._replace(left=box.right - 1.5 * tick, width=tick)
            sheet.write(right, FELT, size, color=ink, bold=True)

    def add_track(self, track: Box, value: float | None, *, is_ready: bool, color: str) -> None:
        """Draw a line with ends, of whose places no other stands out, and the marker if there is one."""
        sheet, (low, high) = self.sheet, RATING_RANGE
        ink, thick = ui.DIM if is_ready else ui.LINE, max(2.0, 0.45 * sheet.unit)
        middle = track.top + track.height / 2
        sheet.fill(Box(track.left, middle - thick / 2, track.width, thick), ink)
        for x in (track.left, track.right):
            end = Box(x - thick / 2, track.top + track.height * 0.15, thick, track.height * 0.7)
            sheet.fill(end, ink)
        if value is not None:
            x, width = track.left + (value - low) / (high - low) * track.width, track.height * 0.36
            box = track._replace(left=x - width / 2, width=width)
            sheet.fill(box, color, round_px=width / 2)

    def measure_slider(self) -> tuple[float, list[list[str]], float]:
        """Compute the width of a slider, the lines of its labels, and its height with the number and the words."""
        sheet, scale, unit = self.sheet, self.scale, self.sheet.unit
        width = min(110 * unit, sheet.find_strip("body").width - 8 * unit)
        words = (scale.low_label, scale.high_label)
        labels = [sheet.wrap(label, LABEL * width, ui.BODY) for label in words]
        lines = 1 + bool(scale.anchors) + max(map(len, labels))
        height = (ABOVE + TRACK + UNDER) * unit + sheet.find_height(lines, ui.BODY)
        return width, labels, height

    def add_slider(self, box: Box) -> None:
        """Set one slider with its number over it and numbers and words of its ends under it, in the middle of a box."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        part, (width, labels, height) = self.trial.judgements[0].part, self.measure_slider()
        top = box.top + max(0.0, box.height - height) / 2
        track = Box((sheet.width - width) / 2, top + ABOVE * unit, width, TRACK * unit)
        is_ready, value = view.can_answer, view.markers.get(part)
        step, top = sheet.find_height(1, ui.BODY), track.bottom + UNDER * unit
        if self.scale.anchors:
            self.write_along(track, top, self.scale.anchors)
            top += step
        for number, lines, at in zip(RATING_RANGE, labels, (0, 1), strict=True):
            align, width = ("left", "right")[at], LABEL * track.width
            end = Box(track.left + at * (track.width - width), top, width, step)
            sheet.write(end, f"{number:.0f}", ui.SMALL, color=ui.DIM, align=align)
            sheet.write(end.lower(step), lines, ui.BODY, align=align)
            sheet.limit_lines(len(lines), most=LABEL_LINES, what="longer label")
        if view.typed or value is not None:
            is_typing = bool(view.typed) or value is None
            share = 0.5 if is_typing or value is None else value / RATING_RANGE[1]
            words = f"{view.typed}_" if is_typing else f"{value:.0f}"
            number, size = sheet.measure("100_", ui.QUESTION, bold=True), ui.QUESTION * unit
            left, height = track.left + share * track.width, sheet.find_height(1, ui.QUESTION)
            over = Box(left - number / 2, track.top - 1.9 * size, number, height)
            sheet.write(over, words, ui.QUESTION, bold=True, align="center")
        self.add_track(track, value, is_ready=is_ready, color=ui.BLUE if is_ready else ui.LINE)
        if is_ready:
            sheet.targets.append(Target(track.grow(2 * unit), "mark", part, track))

    def write_along(self, track: Box, top: float, words: Sequence[str]) -> None:
        sheet, last = self.sheet, max(len(words) - 1, 1)
        for place, word in enumerate(words):
            width = sheet.measure(word, ui.SMALL)
            share = place / last if len(words) > 1 else 0.5
            left = track.left + share * track.width - width / 2
            box = Box(left, top, width, sheet.find_height(1, ui.SMALL))
            sheet.write(box, word, ui.SMALL, color=ui.DIM, align="center")

    def add_choices(self, box: Box) -> None:
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        names = {name: self.texts.name_part(name) for name in self.scale.choices}
        widest = max(sheet.measure(name, 2 * ui.QUESTION, bold=True) for name in names.values())
        width, height = max(34 * unit, widest + 6 * unit), min(22 * unit, box.height)
        strip = Box(0, box.top + (box.height - height) / 2, sheet.width, height)
        fields = sheet.line_up([width] * len(names), 8 * unit, strip)
        for (name, words), field in zip(names.items(), fields, strict=True):
            is_chosen = name == view.chosen
            ink = GROUND if is_chosen else INK if view.can_answer else ui.DIM
            fill = ui.BLUE if is_chosen else ui.PANEL
            sheet.fill(field, fill, line=ui.LINE, round_px=2 * unit, line_px=0.3 * unit)
            sheet.write(field, words, 2 * ui.QUESTION, color=ink, bold=True, align="center")
            if view.can_answer:
                sheet.targets.append(Target(field, "choose", name))

    def add_rows(self, box: Box) -> None:
        """Set the reference and a slider per vibration, in equal bands (ITU-R BS.1534-3, attachment 1)."""
        sheet, scale, view, unit = self.sheet, self.scale, self.view, self.sheet.unit
        rated = [judgement.part for judgement in self.trial.judgements]
        names = {part.name: self.texts.name_part(part.name) for part in self.trial.parts}
        width = max(sheet.measure(name, ui.SMALL, bold=True) for name in names.values()) + 9 * unit
        step = sheet.find_height(1, ui.SMALL)
        left, head = box.left + width + 6 * unit, 2 * step + 1.2 * unit
        row = min(ROW * unit, (box.height - head) / len(rated))
        height = head - step + len(rated) * row
        grid = Box(left, box.top + step, box.right - 11 * unit - left, height)
        low = Box(left, box.top, grid.width / 2, step)
        sheet.write(low, scale.low_label, ui.SMALL)
        sheet.write(low._replace(left=low.right), scale.high_label, ui.SMALL, align="right")
        for place, word in enumerate(scale.anchors):
            wide = grid.width / len(scale.anchors)
            band = Box(grid.left + place * wide, grid.top, wide, step)
            sheet.write(band, word, ui.SMALL, color=ui.DIM, align="center")
            if place:
                sheet.fill(Box(band.left - 0.1 * unit, grid.top, 0.2 * unit, grid.height), ui.LINE)
        spots = {k: Box(box.left, box.top, width, 2 * step) for k in names if k not in rated}
        for place, name in enumerate(rated):
            value, color = view.markers.get(name), INK
            line = Box(box.left, box.top + head + place * row, box.width, row)
            track = Box(left, line.top + 0.14 * row, grid.width, 0.72 * row)
            if name == view.selected:
                color = ui.BLUE
                sheet.fill(line, "", line=ui.LINE, line_px=0.2 * unit)
                sheet.fill(line._replace(left=line.left - 0.8 * unit, width=0.8 * unit), ui.BLUE)
            self.add_track(track, value, is_ready=view.can_rate(name), color=color)
            if value is not None:
                room = line.right - track.right - 4 * unit
                beside = line._replace(left=track.right + 3 * unit, width=room)
                sheet.write(beside, f"{value:.0f}", ui.BODY, bold=True, align="right")
            if view.can_rate(name):
                target = line._replace(left=track.left - 2 * unit, width=track.width + 4 * unit)
                sheet.targets.append(Target(target, "mark", name, track))
            spots[name] = Box(box.left + unit, line.top + 0.04 * row, width - unit, 0.92 * row)
        for name, spot in spots.items():
            self.add_part(spot, name, names[name], size=ui.SMALL)
            sheet.targets.append(Target(spot, "feel", name))

    def add_scales(self, box: Box) -> None:
        """Set the sliders of several scales under each other, each with its question above and its ends below."""
        sheet, view, unit, judged = self.sheet, self.view, self.sheet.unit, self.trial.judgements
        height = min(19 * unit, box.height / len(judged))
        top = box.top + (box.height - height * len(judged)) / 2
        room = box.height - BLOCK * unit * len(judged) - BELOW * unit
        if view.picture and room >= LEAST_PICTURE * unit:
            height = BLOCK * unit
            sheet.items.append(Photo(box._replace(height=room), view.picture))
            top = box.top + room + BELOW * unit
        for place, judgement in enumerate(judged):
            line = Box(box.left, top + place * height, box.width, height)
            key, scale = judgement.key, self.scale.find(judgement.scale)
            is_selected, value = key == view.selected, view.markers.get(key)
            left, width = line.left + MARGIN * unit, line.width - (2 * MARGIN + VALUE) * unit
            head = Box(left, line.top, width, sheet.find_height(1, ui.BODY))
            ink, color = INK if view.can_answer else ui.DIM, ui.BLUE if is_selected else INK
            sheet.write(head, f"{place + 1}  {scale.question}", ui.BODY, color=ink, bold=True)
            track = Box(left, head.bottom + 0.4 * unit, width, BLOCK_TRACK * unit)
            if is_selected:
                sheet.fill(Box(line.left, head.top, 0.8 * unit, track.bottom - head.top), ui.BLUE)
            self.add_track(track, value, is_ready=view.can_answer, color=color)
            words = "" if value is None else f"{value:.0f}"
            words = f"{view.typed}_" if view.typed and is_selected else words
            beside = track._replace(left=track.right + unit, width=(MARGIN + VALUE - 1) * unit)
            sheet.write(beside, words, ui.BODY, bold=True, align="right")
            low = Box(left, track.bottom + 0.2 * unit, LABEL * width, head.height)
            sheet.write(low, scale.low_label, ui.BODY)
            high = low._replace(left=track.right - low.width)
            sheet.write(high, scale.high_label, ui.BODY, align="right")
            # Its words stand between the ends; the first and the last say what the labels do.
            if middle := scale.anchors[1:-1]:
                labels = (scale.low_label, scale.high_label)
                room = width - 2 * max(sheet.measure(label, ui.BODY) for label in labels)
                self.write_along(track, low.top, ["", *middle, ""])
                if sheet.measure("  ".join(middle), ui.SMALL) > room:
                    sheet.faults.append("its anchors must fit between its labels; shorten them")
            if view.can_answer:
                target = Box(left - unit, head.top, width + 2 * unit, low.bottom - head.top)
                sheet.targets.append(Target(target, "mark", key, track))


def find_overflows(
    texts: ScreenTexts,
    scales: Iterable[Scale],
    questions: Iterable[Question] = (),
    *,
    together: Collection[str] = (),
) -> list[str]:
    """Find texts that are too long for a screen; together: names of scales that share one."""
    reading = View("page", "reading", 0, Place(999, 999))
    views = {f"page {key!r}": replace(reading, page=Page(key)) for key in texts.pages}
    for scale in scales:
        parts, asked = (Part("test", ""),), (Judgement("test", "", scale=scale.name),)
        trial = Trial(0, 0, 0, "", "", "replay", "", parts, asked)
        kind = "scales" if scale.name in together else "slider"
        kind = "choice" if scale.choices else kind
        view = View(kind, "answering", 0, Place(0, 0), trial=trial, scale=scale)
        views[f"scale {scale.name!r}"] = view
    for one in questions:
        views[f"question {one.name!r}"] = replace(reading, page=Page(one.key), question=one)
    return [
        f"{name}: {fault}"
        for name, view in views.items()
        for fault in dict.fromkeys(compose(view, texts, size=TIGHTEST).faults)
    ]
