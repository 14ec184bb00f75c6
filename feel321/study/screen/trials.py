"""Where a trial stands on the screen: what is felt, what is asked, and where it is answered."""

from collections.abc import Sequence
from dataclasses import dataclass

from feel321.protocols.trial import RATING_RANGE, Scale, Trial
from feel321.study.screen import sheet as ui
from feel321.study.screen.sheet import GROUND, INK, Box, Button, Photo, Sheet, Target
from feel321.study.screen.view import LOOP, ScreenTexts, View

FELT = "✓"

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
QUESTION_LINES, LABEL_LINES = 3, 2


def add_trial(sheet: Sheet, view: View, texts: ScreenTexts) -> None:
    """Put a trial on a sheet."""
    if view.trial is not None and view.scale is not None:
        _TrialLayout(sheet, view, texts, view.trial, view.scale).add()
    if view.state == "answering" and view.left_s:
        color = ui.ORANGE if view.left_s <= SOON_S else ui.DIM
        sheet.write(sheet.find_strip("top"), f"{view.left_s} s", ui.SMALL, color=color)


@dataclass(frozen=True, slots=True)
class _TrialLayout:
    """Puts a trial on a sheet."""

    sheet: Sheet
    view: View
    texts: ScreenTexts
    trial: Trial
    scale: Scale

    def add(self) -> None:
        """Add parts, question, picture, answer, buttons and hints."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        body, keys = sheet.find_strip("body"), self.texts.keys
        is_rows, is_stroking, top = view.kind == "rows", view.state == "stroking", body.top
        if not is_rows:
            self.add_parts(top)
            top += 10.5 * unit
        is_list = view.kind == "scales" and not is_stroking
        if not is_list:
            question = self.scale.question
            if is_stroking:
                prompt = self.texts.prompts["surface" if view.sample else "surface_unnamed"]
                question = prompt.format(sample=view.sample)
            box = Box(body.left, top, body.width, 0)
            most = QUESTION_LINES
            top += sheet.write_lines(box, question, ui.QUESTION, most=most, what="question")
            top += (1.5 if is_rows else 3.0) * unit
        if view.picture and not is_rows and not is_list:
            below = self.find_slider_height() if view.kind == "slider" else 0.0
            room = body.bottom - top
            height = max(room - below - BELOW * unit, room / 3)
            sheet.items.append(Photo(Box(body.left, top, body.width, height), view.picture))
            top += height + BELOW * unit
        box = Box(body.left, top, body.width, body.bottom - top)
        if not (view.kind == "scales" and is_stroking):
            layouts = {"slider": self.add_slider, "rows": self.add_rows, "scales": self.add_scales}
            layouts.get(view.kind, self.add_choices)(box)
        sheet.add_buttons([Button(keys["pause"], "pause")], self.list_buttons())
        if view.can_answer:
            hints = [keys[key] for key in HINTS[view.kind]]
            if view.kind == "scales":
                arrows = keys["choose"].partition("  ")[0]
                hints.insert(0, f"{arrows}  {self.texts.questions['pick']}")
            sheet.add_hints(hints)

    def list_buttons(self) -> list[Button]:
        """List the buttons at the right."""
        keys, view = self.texts.keys, self.view
        is_open = view.state == "answering" or view.loops
        is_ready = view.state == "stroking" or (is_open and view.is_done)
        confirm = Button(
            keys["confirm"], "confirm", is_main=True, is_ready=is_ready, explains=is_open
        )
        if view.state == "feeling":
            return [Button(keys["stop"], "stop"), confirm]
        if self.trial.timing == "strict":
            return [confirm]
        return [Button(keys["again"], "again", is_ready=view.state == "answering"), confirm]

    # What is felt.

    def add_parts(self, top: float) -> None:
        """Set the parts side by side."""
        sheet, unit = self.sheet, self.sheet.unit
        # A reference that is stroked is called by what it is.
        names = {
            part.name: self.texts.name_part("surface" if part.surface else part.name)
            for part in self.trial.parts
        }
        # Wide enough that a tick stands apart from the name, which stays in the middle.
        width = max(sheet.measure(name, ui.BODY, bold=True) for name in names.values()) + 14 * unit
        left = (sheet.width - len(names) * width - (len(names) - 1) * 2 * unit) / 2
        can_feel = self.view.state == "answering" and self.trial.timing != "strict"
        for part, name in names.items():
            box = Box(left, top, width, 7 * unit)
            self.add_part(box, part, name, size=ui.BODY)
            if can_feel:
                sheet.targets.append(Target(box, "feel", part))
            left += width + 2 * unit

    def add_part(self, box: Box, part: str, name: str, *, size: float) -> None:
        """Draw a part: filled while it is on, ticked once it was felt."""
        sheet, size_px = self.sheet, size * self.sheet.unit
        is_on, is_felt = part == self.view.playing, part in self.view.felt
        ink = GROUND if is_on else INK if is_felt else ui.DIM
        tick = sheet.measure(FELT, size, bold=True)
        fill, line = (ui.BLUE, "") if is_on else (ui.PANEL, ui.LINE)
        sheet.fill(box, fill, line=line, round_px=size_px / 2.5, line_px=size_px / 12)
        inner = Box(box.left + 1.6 * tick, box.top, box.width - 3.2 * tick, box.height)
        sheet.write(inner, name, size, color=ink, bold=True, align="center")
        if self.view.loops and is_on:
            left = Box(box.left + 0.5 * tick, box.top, tick, box.height)
            sheet.write(left, LOOP, size, color=ink, bold=True)
        if is_felt:
            right = Box(box.right - 1.5 * tick, box.top, tick, box.height)
            sheet.write(right, FELT, size, color=ink, bold=True)

    # What is answered.

    def add_track(self, track: Box, value: float | None, *, is_ready: bool, color: str) -> None:
        """Draw a line with ends, of whose places no other stands out, and the marker if there is one."""
        sheet, (low, high) = self.sheet, RATING_RANGE
        ink = ui.DIM if is_ready else ui.LINE
        thick = max(2.0, 0.45 * sheet.unit)
        middle = track.top + track.height / 2
        sheet.fill(Box(track.left, middle - thick / 2, track.width, thick), ink)
        top, height = track.top + track.height * 0.15, track.height * 0.7
        for x in (track.left, track.right):
            sheet.fill(Box(x - thick / 2, top, thick, height), ink)
        if value is not None:
            x = track.left + (value - low) / (high - low) * track.width
            width = track.height * 0.36
            box = Box(x - width / 2, track.top, width, track.height)
            sheet.fill(box, color, round_px=width / 2)

    def find_slider_width(self) -> float:
        """Compute how wide a slider is that stands alone, in pixels."""
        return min(110 * self.sheet.unit, self.sheet.find_strip("body").width - 8 * self.sheet.unit)

    def wrap_labels(self) -> list[list[str]]:
        """Break the words of both ends into lines."""
        width, labels = (
            LABEL * self.find_slider_width(),
            (self.scale.low_label, self.scale.high_label),
        )
        return [self.sheet.wrap(label, width, ui.BODY) for label in labels]

    def find_slider_height(self) -> float:
        """Compute the height of a slider with the number over it and the words under it, in pixels."""
        lines = 1 + bool(self.scale.anchors) + max(map(len, self.wrap_labels()))
        return (ABOVE + TRACK + UNDER) * self.sheet.unit + self.sheet.find_height(lines, ui.BODY)

    def add_slider(self, box: Box) -> None:
        """Set one slider with its number over it; they and the labels together stand in the middle of the box."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        part, width = self.trial.judgements[0].part, self.find_slider_width()
        top = box.top + max(0.0, box.height - self.find_slider_height()) / 2
        track = Box((sheet.width - width) / 2, top + ABOVE * unit, width, TRACK * unit)
        is_ready, value = view.can_answer, view.markers.get(part)
        self.label_ends(track)
        if view.typed or value is not None:
            is_typing = bool(view.typed) or value is None
            at = 0.5 if is_typing or value is None else value / RATING_RANGE[1]
            words = f"{view.typed}_" if is_typing else f"{value:.0f}"
            number, size = sheet.measure("100_", ui.QUESTION, bold=True), ui.QUESTION * unit
            left = track.left + at * track.width - number / 2
            over = Box(left, track.top - 1.9 * size, number, sheet.find_height(1, ui.QUESTION))
            sheet.write(over, words, ui.QUESTION, bold=True, align="center")
        self.add_track(track, value, is_ready=is_ready, color=ui.BLUE if is_ready else ui.LINE)
        if is_ready:
            sheet.targets.append(Target(track.grow(2 * unit), "mark", part, track))

    def label_ends(self, track: Box) -> None:
        """Write the numbers and words of both ends under the track, and over them what stands in between."""
        sheet, scale = self.sheet, self.scale
        step, top = sheet.find_height(1, ui.BODY), track.bottom + UNDER * sheet.unit
        if scale.anchors:
            self.write_along(track, top, scale.anchors, align="center")
            top += step
        width = LABEL * track.width
        ends = (("left", track.left), ("right", track.right - width))
        for number, lines, (align, left) in zip(
            RATING_RANGE, self.wrap_labels(), ends, strict=True
        ):
            box = Box(left, top, width, step)
            sheet.write(box, f"{number:.0f}", ui.SMALL, color=ui.DIM, align=align)
            sheet.write(Box(left, top + step, width, step), lines, ui.BODY, align=align)
            sheet.limit_lines(len(lines), most=LABEL_LINES, what="longer label")

    def write_along(self, track: Box, top: float, words: Sequence[str], *, align: str) -> None:
        """Write words evenly along a slider, each over its place; aligned left, none goes beyond its ends."""
        sheet = self.sheet
        for place, word in enumerate(words):
            width = sheet.measure(word, ui.SMALL)
            share = place / (len(words) - 1) if len(words) > 1 else 0.5
            left = track.left + share * track.width - width / 2
            if align == "left":
                left = min(max(left, track.left), track.right - width)
                if width > track.width / len(words):
                    sheet.faults.append("its anchors must fit side by side; shorten them")
            box = Box(left, top, width, sheet.find_height(1, ui.SMALL))
            sheet.write(box, word, ui.SMALL, color=ui.DIM, align=align)

    def add_choices(self, box: Box) -> None:
        """Set what can be chosen side by side; what was chosen is framed and marked."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        count, names = len(self.scale.choices), map(self.texts.name_part, self.scale.choices)
        widest = max(sheet.measure(name, 2 * ui.QUESTION, bold=True) for name in names)
        width, height = max(34 * unit, widest + 6 * unit), min(22 * unit, box.height)
        gap = 8 * unit
        left = (sheet.width - count * width - (count - 1) * gap) / 2
        top = box.top + (box.height - height) / 2
        for place, name in enumerate(self.scale.choices):
            field = Box(left + place * (width + gap), top, width, height)
            is_chosen = name == view.chosen
            ink = GROUND if is_chosen else INK if view.can_answer else ui.DIM
            fill = ui.BLUE if is_chosen else ui.PANEL
            sheet.fill(field, fill, line=ui.LINE, round_px=2 * unit, line_px=0.3 * unit)
            words = self.texts.name_part(name)
            sheet.write(field, words, 2 * ui.QUESTION, color=ink, bold=True, align="center")
            if view.can_answer:
                sheet.targets.append(Target(field, "choose", name))

    def add_rows(self, box: Box) -> None:
        """Set the reference beside the words of the scale, and under them a row for each vibration."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        rated = [judgement.part for judgement in self.trial.judgements]
        names = {part.name: self.texts.name_part(part.name) for part in self.trial.parts}
        width = max(sheet.measure(name, ui.SMALL, bold=True) for name in names.values()) + 9 * unit
        step = sheet.find_height(1, ui.SMALL)
        left, head = box.left + width + 6 * unit, 2 * step + 1.2 * unit
        row = min(ROW * unit, (box.height - head) / len(rated))
        grid = Box(
            left, box.top + step, box.right - 11 * unit - left, head - step + len(rated) * row
        )
        low = Box(left, box.top, grid.width / 2, step)
        sheet.write(low, self.scale.low_label, ui.SMALL)
        high = Box(low.right, box.top, low.width, step)
        sheet.write(high, self.scale.high_label, ui.SMALL, align="right")
        self.add_bands(grid)
        spots = {
            name: Box(box.left, box.top, width, 2 * step) for name in names if name not in rated
        }
        for place, name in enumerate(rated):
            line = Box(box.left, box.top + head + place * row, box.width, row)
            track = Box(left, line.top + 0.14 * row, grid.width, 0.72 * row)
            self.add_row(name, line, track)
            if view.can_rate(name):
                target = Box(left - 2 * unit, line.top, grid.width + 4 * unit, row)
                sheet.targets.append(Target(target, "mark", name, track))
            spots[name] = Box(box.left + unit, line.top + 0.04 * row, width - unit, 0.92 * row)
        for name, spot in spots.items():
            self.add_part(spot, name, names[name], size=ui.SMALL)
            sheet.targets.append(Target(spot, "feel", name))

    def add_bands(self, grid: Box) -> None:
        """Cut a list of sliders into equal bands, each with its word above: ITU-R BS.1534-3, attachment 1."""
        sheet, unit, count = self.sheet, self.sheet.unit, len(self.scale.anchors)
        height = sheet.find_height(1, ui.SMALL)
        for place, word in enumerate(self.scale.anchors):
            band = Box(grid.left + place * grid.width / count, grid.top, grid.width / count, height)
            sheet.write(band, word, ui.SMALL, color=ui.DIM, align="center")
            if place:
                line = Box(band.left - 0.1 * unit, grid.top, 0.2 * unit, grid.height)
                sheet.fill(line, ui.LINE)

    def add_row(self, name: str, line: Box, track: Box) -> None:
        """Draw the slider of a vibration and its number; the selected one is framed and marked."""
        sheet, unit = self.sheet, self.sheet.unit
        is_selected, value = name == self.view.selected, self.view.markers.get(name)
        if is_selected:
            sheet.fill(line, "", line=ui.LINE, line_px=0.2 * unit)
            sheet.fill(Box(line.left - 0.8 * unit, line.top, 0.8 * unit, line.height), ui.BLUE)
        color = ui.BLUE if is_selected else INK
        self.add_track(track, value, is_ready=self.view.can_rate(name), color=color)
        if value is not None:
            width = line.right - track.right - 4 * unit
            box = Box(track.right + 3 * unit, line.top, width, line.height)
            sheet.write(box, f"{value:.0f}", ui.BODY, bold=True, align="right")

    def add_scales(self, box: Box) -> None:
        """Set the sliders of several scales under each other, each with its question above and its ends below."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        keys = self.trial.judged
        height = min(19 * unit, box.height / len(keys))
        top = box.top + (box.height - height * len(keys)) / 2
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
        """Draw one of several sliders, with its number, its question and its ends."""
        sheet, view, unit = self.sheet, self.view, self.sheet.unit
        is_selected, value = key == view.selected, view.markers.get(key)
        left, width = line.left + MARGIN * unit, line.width - (2 * MARGIN + VALUE) * unit
        head = Box(left, line.top, width, sheet.find_height(1, ui.BODY))
        ink = INK if view.can_answer else ui.DIM
        sheet.write(head, f"{number}  {scale.question}", ui.BODY, color=ink, bold=True)
        track = Box(left, head.bottom + 0.4 * unit, width, BLOCK_TRACK * unit)
        if is_selected:
            sheet.fill(Box(line.left, head.top, 0.8 * unit, track.bottom - head.top), ui.BLUE)
        color = ui.BLUE if is_selected else INK
        self.add_track(track, value, is_ready=view.can_answer, color=color)
        words = "" if value is None else f"{value:.0f}"
        words = f"{view.typed}_" if view.typed and is_selected else words
        beside = Box(track.right + unit, track.top, (MARGIN + VALUE - 1) * unit, track.height)
        sheet.write(beside, words, ui.BODY, bold=True, align="right")
        top, half = track.bottom + 0.2 * unit, LABEL * width
        labels = (scale.low_label, scale.high_label)
        # As large as where there is one slider, if they fit.
        fits = max(sheet.measure(label, ui.BODY) for label in labels) <= half
        size = ui.BODY if fits and not scale.anchors else ui.SMALL
        step = sheet.find_height(1, size)
        if scale.anchors:
            self.write_along(track, top, scale.anchors, align="left")
        else:
            sheet.write(Box(left, top, half, step), labels[0], size)
            sheet.write(Box(track.right - half, top, half, step), labels[1], size, align="right")
        if view.can_answer:
            target = Box(left - unit, head.top, width + 2 * unit, top + step - head.top)
            sheet.targets.append(Target(target, "mark", key, track))
