"""Where a trial stands on the screen: what is felt, what is asked, and where it is answered."""

from collections.abc import Sequence
from dataclasses import dataclass

from feel321.protocols.trial import RATING_RANGE, Scale, Trial
from feel321.study.screen.drawing import GROUND, INK, Box, Photo, Sheet, Target
from feel321.study.screen.view import (
    BLUE,
    BODY,
    DIM,
    FELT,
    LINE,
    LINES,
    LOOP,
    ORANGE,
    PANEL,
    QUESTION,
    SMALL,
    Button,
    ScreenTexts,
    View,
    add_buttons,
    add_hints,
)

BLOCK, BLOCK_TRACK, LEAST_PICTURE = 15.0, 4.0, 12.0
"""Heights, in units, of a slider where a trial has several, of its track, and of the least picture beside them."""

SOON_S = 3  # from when on the time that is left for an answer stands out

MARGIN, VALUE = 2.5, 9.0
"""Widths, in units, of what is free left of such a slider, and of the number at its right."""

HINTS = {
    "slider": ("move", "coarse_rows", "digits"),
    "rows": ("feel", "loop", "choose", "move", "coarse_rows"),
    "scales": ("move", "coarse_rows", "digits"),
    "choice": ("pick",),
}
"""The keys that have no button, by kind of screen."""

BELOW = 1.5  # free space under a picture, in units

ABOVE, TRACK, UNDER = 8.0, 4.5, 1.0
"""Heights of what stands over a slider's track, of the track, and of what is free under it, in units."""

ROW = 6.6  # largest height of a row, in units
LABEL = 0.45  # largest width of a slider's label, as a share of the track
LABEL_LINES = 2  # most lines of a slider's label


def _count_label_lines(scale: Scale, sheet: Sheet) -> int:
    """Count the lines that the longer label of a slider takes."""
    width = LABEL * _find_slider_width(sheet)
    labels = (scale.low_label, scale.high_label)
    return max(len(sheet.wrap(label, width, BODY)) for label in labels)


def _find_slider_width(sheet: Sheet) -> float:
    """Compute how wide a slider is that stands alone, in pixels."""
    return min(110 * sheet.unit, sheet.find_strip("body").width - 8 * sheet.unit)


def _add_track(sheet: Sheet, track: Box, *, is_ready: bool) -> None:
    """Draw a line with ends; none of its places stands out but these."""
    color = DIM if is_ready else LINE
    thick = max(2.0, 0.45 * sheet.unit)
    middle = track.top + track.height / 2
    sheet.fill(Box(track.left, middle - thick / 2, track.width, thick), color)
    top, height = track.top + track.height * 0.15, track.height * 0.7
    for x in (track.left, track.right):
        sheet.fill(Box(x - thick / 2, top, thick, height), color)


def _add_marker(sheet: Sheet, track: Box, value: float | None, *, color: str) -> None:
    """Draw a marker, if there is one."""
    if value is not None:
        low, high = RATING_RANGE
        x = track.left + (value - low) / (high - low) * track.width
        width = track.height * 0.36
        box = Box(x - width / 2, track.top, width, track.height)
        sheet.fill(box, color, round_px=width / 2)


def _label_anchors(sheet: Sheet, track: Box, scale: Scale, *, top: float) -> None:
    """Write the words between the ends of a scale where they belong."""
    count = len(scale.anchors)
    for place, word in enumerate(scale.anchors):
        width = sheet.measure(word, SMALL)
        x = track.left + track.width * (place / (count - 1) if count > 1 else 0.5)
        box = Box(x - width / 2, top, width, sheet.find_height(1, SMALL))
        sheet.write(box, word, SMALL, color=DIM, align="center")


def _label_inside(sheet: Sheet, below: Box, words: Sequence[str]) -> None:
    """Write words evenly along a slider, none of them beyond its ends."""
    for place, word in enumerate(words):
        width = sheet.measure(word, SMALL)
        share = place / (len(words) - 1) if len(words) > 1 else 0.5
        left = below.left + share * below.width - width / 2
        left = min(max(left, below.left), below.right - width)
        sheet.write(Box(left, below.top, width, below.height), word, SMALL, color=DIM)


def _add_bands(sheet: Sheet, grid: Box, scale: Scale) -> None:
    """Cut a list of sliders into equal bands, each with its word above: ITU-R BS.1534-3, attachment 1."""
    count, unit = len(scale.anchors), sheet.unit
    height = sheet.find_height(1, SMALL)
    for place, word in enumerate(scale.anchors):
        left, width = grid.left + place * grid.width / count, grid.width / count
        sheet.write(Box(left, grid.top, width, height), word, SMALL, color=DIM, align="center")
        if place:
            sheet.fill(Box(left - 0.1 * unit, grid.top, 0.2 * unit, grid.height), LINE)


@dataclass(frozen=True, slots=True)
class _TrialLayout:
    """Puts a trial on a sheet."""

    sheet: Sheet
    view: View
    texts: ScreenTexts
    trial: Trial
    scale: Scale

    def add(self) -> None:
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        body = sheet.find_strip("body")
        is_rows, top = view.kind == "rows", body.top
        if not is_rows:
            self.add_parts(top)
            top += 10.5 * unit
        is_list = view.kind == "scales" and view.state != "stroking"
        if not is_list:
            lines = sheet.wrap(self.find_question(), body.width, QUESTION, bold=True)
            box = Box(body.left, top, body.width, 0)
            sheet.write(box, lines, QUESTION, bold=True, align="center")
            top += sheet.find_height(len(lines), QUESTION) + (1.5 if is_rows else 3.0) * unit
        box = Box(body.left, top, body.width, body.bottom - top)
        if view.picture and not is_rows and not is_list:
            below = self.find_slider_height() if view.kind == "slider" else 0.0
            height = max(box.height - below - BELOW * unit, box.height / 3)
            sheet.items.append(Photo(Box(box.left, top, box.width, height), view.picture))
            top += height + BELOW * unit
            box = Box(box.left, top, box.width, body.bottom - top)
        self.add_answer(box)
        _add_left(sheet, view)
        add_buttons(sheet, [Button(self.texts.keys["pause"], "pause")], self.list_buttons())
        if view.can_answer:
            hints = [self.texts.keys[key] for key in HINTS[view.kind]]
            if view.kind == "scales":
                arrows = self.texts.keys["choose"].partition("  ")[0]
                hints.insert(0, f"{arrows}  {self.texts.questions['pick']}")
            add_hints(sheet, hints)

    def add_answer(self, box: Box) -> None:
        """Add what is answered."""
        (self.add_choice if self.view.kind == "choice" else self.add_slider)(box)

    def find_question(self) -> str:
        if self.view.state != "stroking":
            return self.scale.question
        prompt = self.texts.prompts["surface" if self.view.sample else "surface_unnamed"]
        return prompt.format(sample=self.view.sample)

    def list_buttons(self) -> list[Button]:
        keys, state = self.texts.keys, self.view.state
        is_open = state == "answering" or self.view.loops
        is_ready = state == "stroking" or (is_open and self.view.is_done)
        confirm = Button(
            keys["confirm"], "confirm", is_main=True, is_ready=is_ready, explains=is_open
        )
        if state == "feeling":
            return [Button(keys["stop"], "stop"), confirm]
        if self.trial.timing == "strict":
            return [confirm]
        return [Button(keys["again"], "again", is_ready=state == "answering"), confirm]

    def add_parts(self, top: float) -> None:
        sheet, unit = self.sheet, self.sheet.unit
        # A reference that is stroked is called by what it is.
        names = {
            part.name: self.texts.name_part("surface" if part.surface else part.name)
            for part in self.trial.parts
        }
        # Wide enough that a tick stands apart from the name, which stays in the middle.
        width = max(sheet.measure(name, BODY, bold=True) for name in names.values()) + 14 * unit
        left = (sheet.width - len(names) * width - (len(names) - 1) * 2 * unit) / 2
        can_feel = self.view.state == "answering" and self.trial.timing != "strict"
        for part, name in names.items():
            box = Box(left, top, width, 7 * unit)
            self.add_part(box, part, name, size=BODY)
            if can_feel:
                sheet.targets.append(Target(box, "feel", part))
            left += width + 2 * unit

    def add_part(self, box: Box, part: str, name: str, *, size: float) -> None:
        """Draw a part: filled while it is on, ticked once it was felt."""
        sheet, size_px = self.sheet, size * self.sheet.unit
        is_on, is_felt = part == self.view.playing, part in self.view.felt
        ink = GROUND if is_on else INK if is_felt else DIM
        tick = sheet.measure(FELT, size, bold=True)
        fill, line = (BLUE, "") if is_on else (PANEL, LINE)
        sheet.fill(box, fill, line=line, round_px=size_px / 2.5, line_px=size_px / 12)
        inner = Box(box.left + 1.6 * tick, box.top, box.width - 3.2 * tick, box.height)
        sheet.write(inner, name, size, color=ink, bold=True, align="center")
        if self.view.loops and is_on:
            left = Box(box.left + 0.5 * tick, box.top, tick, box.height)
            sheet.write(left, LOOP, size, color=ink, bold=True)
        if is_felt:
            right = Box(box.right - 1.5 * tick, box.top, tick, box.height)
            sheet.write(right, FELT, size, color=ink, bold=True)

    def find_slider_height(self) -> float:
        """Compute the height of a slider with the number over it and the words under it, in pixels."""
        lines = 1 + bool(self.scale.anchors) + _count_label_lines(self.scale, self.sheet)
        return (ABOVE + TRACK + UNDER) * self.sheet.unit + self.sheet.find_height(lines, BODY)

    def add_slider(self, box: Box) -> None:
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        part, width = self.trial.judgements[0].part, _find_slider_width(sheet)
        # Number, track and labels together stand in the middle of what is left.
        top = box.top + max(0.0, box.height - self.find_slider_height()) / 2
        track = Box((sheet.width - width) / 2, top + ABOVE * unit, width, TRACK * unit)
        is_ready, value = view.can_answer, view.markers.get(part)
        _add_track(sheet, track, is_ready=is_ready)
        self.label_ends(track)
        if view.typed or value is not None:
            at = 0.5 if view.typed or value is None else value / RATING_RANGE[1]
            words = f"{view.typed}_" if view.typed or value is None else f"{value:.0f}"
            number, size = sheet.measure("100_", QUESTION, bold=True), QUESTION * unit
            left = track.left + at * track.width - number / 2
            over = Box(left, track.top - 1.9 * size, number, sheet.find_height(1, QUESTION))
            sheet.write(over, words, QUESTION, bold=True, align="center")
        _add_marker(sheet, track, value, color=BLUE if is_ready else LINE)
        if is_ready:
            sheet.targets.append(Target(track.grow(2 * unit), "mark", part, track))

    def label_ends(self, track: Box) -> None:
        """Write the numbers and words of both ends under the track, and what stands in between."""
        sheet, scale = self.sheet, self.scale
        step, top = sheet.find_height(1, BODY), track.bottom + UNDER * sheet.unit
        if scale.anchors:
            _label_anchors(sheet, track, self.scale, top=top)
            top += step
        width = LABEL * track.width
        for number, label, align, left in (
            (RATING_RANGE[0], scale.low_label, "left", track.left),
            (RATING_RANGE[1], scale.high_label, "right", track.right - width),
        ):
            box = Box(left, top, width, step)
            sheet.write(box, f"{number:.0f}", SMALL, color=DIM, align=align)
            lines = sheet.wrap(label, width, BODY)
            sheet.write(Box(left, top + step, width, step), lines, BODY, align=align)

    def add_choice(self, box: Box) -> None:
        """Set what can be chosen side by side; what was chosen is framed and marked."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        count, names = len(self.scale.choices), map(self.texts.name_part, self.scale.choices)
        widest = max(sheet.measure(name, 2 * QUESTION, bold=True) for name in names)
        width, height = max(34 * unit, widest + 6 * unit), min(22 * unit, box.height)
        gap = 8 * unit
        left = (sheet.width - count * width - (count - 1) * gap) / 2
        top = box.top + (box.height - height) / 2
        for place, name in enumerate(self.scale.choices):
            field = Box(left + place * (width + gap), top, width, height)
            is_chosen = name == view.chosen
            ink = GROUND if is_chosen else INK if view.can_answer else DIM
            fill = BLUE if is_chosen else PANEL
            sheet.fill(field, fill, line=LINE, round_px=2 * unit, line_px=0.3 * unit)
            words = self.texts.name_part(name)
            sheet.write(field, words, 2 * QUESTION, color=ink, bold=True, align="center")
            if view.can_answer:
                sheet.targets.append(Target(field, "choose", name))


class _RowsLayout(_TrialLayout):
    """Puts a page of vibrations on a sheet, each with its slider."""

    __slots__ = ()

    def add_answer(self, box: Box) -> None:
        """Add the rows."""
        self.add_rows(box)

    def add_rows(self, box: Box) -> None:
        """Set the reference beside the words of the scale, and under them a row for each vibration."""
        sheet, unit = self.sheet, self.sheet.unit
        rated = [judgement.part for judgement in self.trial.judgements]
        names = {part.name: self.texts.name_part(part.name) for part in self.trial.parts}
        width = max(sheet.measure(name, SMALL, bold=True) for name in names.values()) + 9 * unit
        step = sheet.find_height(1, SMALL)
        left, head = box.left + width + 6 * unit, 2 * step + 1.2 * unit
        track = Box(left, box.top, box.right - 11 * unit - left, 0)
        row = min(ROW * unit, (box.height - head) / len(rated))
        half = track.width / 2
        sheet.write(Box(left, box.top, half, step), self.scale.low_label, SMALL)
        high = Box(left + half, box.top, half, step)
        sheet.write(high, self.scale.high_label, SMALL, align="right")
        grid = Box(track.left, box.top + step, track.width, step + 1.2 * unit + len(rated) * row)
        _add_bands(sheet, grid, self.scale)
        fields = {
            name: Box(box.left, box.top, width, 2 * step) for name in names if name not in rated
        }
        for place, name in enumerate(rated):
            line = Box(box.left, box.top + head + place * row, box.width, row)
            own = Box(track.left, line.top + 0.14 * row, track.width, 0.72 * row)
            self.add_row(name, line, own)
            target = Box(own.left - 2 * unit, line.top, own.width + 4 * unit, row)
            if self.view.can_rate(name):
                sheet.targets.append(Target(target, "mark", name, own))
            fields[name] = Box(box.left + unit, line.top + 0.04 * row, width - unit, 0.92 * row)
        for name, spot in fields.items():
            self.add_part(spot, name, names[name], size=SMALL)
            sheet.targets.append(Target(spot, "feel", name))

    def add_row(self, name: str, line: Box, track: Box) -> None:
        sheet, unit = self.sheet, self.sheet.unit
        is_selected, value = name == self.view.selected, self.view.markers.get(name)
        if is_selected:
            sheet.fill(line, "", line=LINE, line_px=0.2 * unit)
            sheet.fill(Box(line.left - 0.8 * unit, line.top, 0.8 * unit, line.height), BLUE)
        _add_track(sheet, track, is_ready=self.view.can_rate(name))
        _add_marker(sheet, track, value, color=BLUE if is_selected else INK)
        if value is not None:
            width = line.right - track.right - 4 * unit
            box = Box(track.right + 3 * unit, line.top, width, line.height)
            sheet.write(box, f"{value:.0f}", BODY, bold=True, align="right")


class _ScalesLayout(_TrialLayout):
    """Puts a trial with several scales on a sheet."""

    __slots__ = ()

    def add_answer(self, box: Box) -> None:
        """Add the sliders, once there is nothing to stroke."""
        if self.view.state != "stroking":
            self.add_scales(box)

    def add_scales(self, box: Box) -> None:
        """Set the sliders of several scales under each other, each with its question above and its ends below."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        keys = self.trial.judged
        height = min(19 * unit, box.height / len(keys))
        free = box.height - height * len(keys)
        top = box.top + free / 2
        room = box.height - BLOCK * unit * len(keys) - BELOW * unit
        if view.picture and room >= LEAST_PICTURE * unit:
            height = BLOCK * unit
            sheet.items.append(Photo(Box(box.left, box.top, box.width, room), view.picture))
            top = box.top + room + BELOW * unit
        for place, (key, judgement) in enumerate(zip(keys, self.trial.judgements, strict=True)):
            scale = self.scale.find(judgement.scale)
            line = Box(box.left, top + place * height, box.width, height)
            self.add_scale(key, scale, line, number=place + 1)

    def add_scale(self, key: str, scale: Scale, line: Box, *, number: int) -> None:
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        is_selected, value = key == view.selected, view.markers.get(key)
        left, width = line.left + MARGIN * unit, line.width - (2 * MARGIN + VALUE) * unit
        head = Box(left, line.top, width, sheet.find_height(1, BODY))
        ink = INK if view.can_answer else DIM
        sheet.write(head, f"{number}  {scale.question}", BODY, color=ink, bold=True)
        track = Box(left, head.bottom + 0.4 * unit, width, BLOCK_TRACK * unit)
        if is_selected:
            sheet.fill(Box(line.left, head.top, 0.8 * unit, track.bottom - head.top), BLUE)
        _add_track(sheet, track, is_ready=view.can_answer)
        _add_marker(sheet, track, value, color=BLUE if is_selected else INK)
        words = f"{view.typed}_" if view.typed and is_selected else ""
        words = words or ("" if value is None else f"{value:.0f}")
        beside = Box(track.right + unit, track.top, (MARGIN + VALUE - 1) * unit, track.height)
        sheet.write(beside, words, BODY, bold=True, align="right")
        below = Box(track.left, track.bottom + 0.2 * unit, track.width, sheet.find_height(1, SMALL))
        if scale.anchors:
            _label_inside(sheet, below, scale.anchors)
        else:
            sheet.write(below, scale.low_label, SMALL, color=DIM)
            sheet.write(below, scale.high_label, SMALL, color=DIM, align="right")
        if view.can_answer:
            target = Box(
                track.left - unit, head.top, track.width + 2 * unit, below.bottom - head.top
            )
            sheet.targets.append(Target(target, "mark", key, track))


def _add_left(sheet: Sheet, view: View) -> None:
    """Write how long an answer may still take, where that is limited."""
    if view.state == "answering" and view.left_s:
        color = ORANGE if view.left_s <= SOON_S else DIM
        sheet.write(sheet.find_strip("top"), f"{view.left_s} s", SMALL, color=color)


def find_scale_overflows(scale: Scale, sheet: Sheet, *, is_shared: bool) -> list[str]:
    """Find what of a scale is too long for a screen; is_shared: that it shares with others."""
    return _find_shared(scale, sheet) if is_shared else _find_alone(scale, sheet)


def _find_alone(scale: Scale, sheet: Sheet) -> list[str]:
    width = sheet.find_strip("body").width
    question = len(sheet.wrap(scale.question, width, QUESTION, bold=True))
    return [
        f"scale {scale.name!r}: its {name} must take at most {most} lines, got {count}; shorten it"
        for name, count, most in (
            ("question", question, LINES),
            ("longer label", _count_label_lines(scale, sheet), LABEL_LINES),
        )
        if count > most
    ]


def _find_shared(scale: Scale, sheet: Sheet) -> list[str]:
    width = sheet.find_strip("body").width - (2 * MARGIN + VALUE) * sheet.unit
    faults = []
    if sheet.measure(f"0  {scale.question}", BODY, bold=True) > width:
        faults.append("question must take one line")
    longest = max(sheet.measure(words, SMALL) for words in (scale.low_label, scale.high_label))
    if not scale.anchors and longest > LABEL * width:
        faults.append("longer label must take less than half a line")
    count = len(scale.anchors)
    if any(sheet.measure(word, SMALL) > width / count for word in scale.anchors):
        faults.append("anchors must fit side by side")
    return [
        f"scale {scale.name!r}: its {fault} where several scales are asked; shorten it"
        for fault in faults
    ]


def add_trial(sheet: Sheet, view: View, texts: ScreenTexts) -> None:
    """Put a trial on a sheet."""
    if view.trial is not None and view.scale is not None:
        layout = {"scales": _ScalesLayout, "rows": _RowsLayout}.get(view.kind, _TrialLayout)
        layout(sheet, view, texts, view.trial, view.scale).add()
