"""Parts of the screen: stimuli, sliders, choices and buttons, and the words on them."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from feel321.protocols.texts import PageText
from feel321.protocols.trial import RATING_RANGE
from feel321.study.screen.drawing import (
    BLUE,
    BODY,
    DIM,
    GROUND,
    INK,
    LEADING,
    LINE,
    PANEL,
    QUESTION,
    SMALL,
    Area,
    Box,
    Target,
    Text,
    lay_lines,
    measure,
    wrap,
)

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from feel321.protocols.trial import Page, Scale, Trial
    from feel321.study.screen.drawing import Grid, Item
    from feel321.study.session.ports import Place

# What is on the screen, as a record: the layout draws it, tests read it, and a simulated participant watches it.

KINDS = ("page", "slider", "rows", "choice")
"""Kinds of screens: a page to read; one slider; a row with a slider for each vibration; a choice between parts."""

STATES = ("reading", "feeling", "stroking", "answering")
"""What the participant is to do: read a page, feel a vibration (or await it), stroke the real surface, answer."""

LAST_PAGE = "end"
"""The page after which there is nothing."""


@dataclass(frozen=True, slots=True)
class View:
    """Everything that is on the screen in one frame."""

    kind: str
    state: str
    screen: int
    place: Place
    page: Page | None = None
    trial: Trial | None = None
    scale: Scale | None = None
    playing: str = ""
    felt: frozenset[str] = frozenset()
    markers: Mapping[str, float] = field(default_factory=dict)
    selected: str = ""
    chosen: str = ""
    typed: str = ""
    left_s: int = 0
    notice: str = ""
    picture: Path | None = None
    sample: str = ""

    @property
    def can_answer(self) -> bool:
        """Whether the answer can be changed: once all was felt, or at once where parts are felt at will."""
        if self.trial is None:
            return False
        has_felt = self.felt.issuperset(part.name for part in self.trial.parts)
        return self.state == "answering" or self.trial.timing == "free" or has_felt

    @property
    def can_leave(self) -> bool:
        """Whether there is anything to pause or to end: not on the last page."""
        return self.page is None or self.page.key != LAST_PAGE


class Hand:
    """Whoever watches the screen frame by frame and presses keys: nobody, unless a simulated participant does."""

    def watch(self, view: View) -> None:
        """Look at what is on the screen."""


# The texts that the screen shows, as records.


@dataclass(frozen=True, slots=True)
class ScreenTexts:
    """What participants read besides the scales, in their language."""

    pages: Mapping[str, PageText]
    refusals: Mapping[str, str]
    prompts: Mapping[str, str]
    parts: Mapping[str, str]
    keys: Mapping[str, str]


def make_screen_texts(tables: Mapping[str, Any]) -> ScreenTexts:
    """Pick the screen's texts from those of a language.

    Examples
    --------
    >>> from feel321.protocols.texts import read_texts
    >>> make_screen_texts(read_texts("de")).pages["pause"].title
    'Pause'
    """
    pages = {key: PageText(key, **entry) for key, entry in tables["pages"].items()}
    return ScreenTexts(
        pages, tables["refusals"], tables["prompts"], tables["parts"], tables["keys"]
    )


# What is felt, as a row of fields: which ones there are, which one is on, which were felt to their ends.

FELT = "✓"


def name_part(name: str, texts: ScreenTexts) -> str:
    """Tell what people call a part."""
    return texts.parts.get(name, name)


def lay_parts(
    view: View, texts: ScreenTexts, *, grid: Grid, top: float
) -> tuple[list[Item], list[Target]]:
    """Set the parts of a trial beside each other.

    top: where they begin, in pixels.
    """
    if view.trial is None:
        return [], []
    unit, size = grid.unit, BODY * grid.unit
    # A reference that is stroked is called by what it is.
    parts = [
        (part, name_part("surface" if part.surface else part.name, texts))
        for part in view.trial.parts
    ]
    # Wide enough that a tick stands apart from the name, which stays in the middle.
    width = max(measure(name, size, bold=True) for _, name in parts) + 14 * unit
    left = (grid.width - len(parts) * width - (len(parts) - 1) * 2 * unit) / 2
    boxes = [
        Box(left + place * (width + 2 * unit), top, width, 7 * unit) for place in range(len(parts))
    ]
    items = [
        item
        for box, (part, name) in zip(boxes, parts, strict=True)
        for item in draw_part(
            box, name, size=size, is_on=part.name == view.playing, is_felt=part.name in view.felt
        )
    ]
    can_feel = view.state == "answering" and view.trial.timing != "strict"
    targets = [
        Target(box, "feel", part.name)
        for box, (part, _) in zip(boxes, parts, strict=True)
        if can_feel
    ]
    return items, targets


def draw_part(box: Box, name: str, *, size: float, is_on: bool, is_felt: bool) -> list[Item]:
    """Draw a part: filled while it is on, ticked once it was felt.

    size: height of its letters (em), in pixels.
    """
    ink = GROUND if is_on else INK if is_felt else DIM
    tick_width = measure(FELT, size, bold=True)
    inner = Box(box.left + 1.6 * tick_width, box.top, box.width - 3.2 * tick_width, box.height)
    items: list[Item] = [
        Area(
            box,
            fill=BLUE if is_on else PANEL,
            line="" if is_on else LINE,
            round_px=size / 2.5,
            line_px=size / 12,
        ),
        Text(inner, name, size, ink, bold=True, align="center"),
    ]
    if is_felt:
        tick = Box(box.right - 1.5 * tick_width, box.top, tick_width, box.height)
        items.append(Text(tick, FELT, size, ink, bold=True))
    return items


# Where answers are given: one slider, rows of sliders, or a choice.

Laid = tuple[list["Item"], list[Target]]

ABOVE, TRACK, UNDER = 8.0, 4.5, 1.0
"""Heights of what stands over a slider's track, of the track, and of what is free under it, in units."""

ROW = 6.6
"""Most height of a row, in units."""


LABEL = 0.45
"""Most width of a slider's label, as a share of the track."""

LABEL_LINES = 2
"""Most lines of a slider's label."""


def lay_answer(view: View, texts: ScreenTexts, *, grid: Grid, box: Box) -> Laid:
    """Lay out where the answer is given."""
    if view.kind == "rows":
        return _lay_rows(view, texts, grid=grid, box=box)
    if view.kind == "choice":
        return _lay_choice(view, texts, grid=grid, box=box)
    return _lay_slider(view, grid=grid, box=box)


def find_points(track: Box, x: float) -> float:
    """Tell which value a place on a slider stands for.

    x: the place, in pixels from the left of the screen.

    Examples
    --------
    >>> find_points(Box(100, 0, 200, 10), 250.0), find_points(Box(100, 0, 200, 10), 0.0)
    (75.0, 0.0)
    """
    low, high = RATING_RANGE
    return float(round(min(max(low + (x - track.left) / track.width * (high - low), low), high)))


def find_slider_width(grid: Grid) -> float:
    """Tell how wide a slider that stands alone is.

    Returns its width in pixels.
    """
    return min(110 * grid.unit, grid.body.width - 8 * grid.unit)


def count_label_lines(scale: Scale, grid: Grid) -> int:
    """Count the lines that the longer label of a slider takes."""
    width = LABEL * find_slider_width(grid)
    return max(
        len(wrap(label, width, size=BODY * grid.unit))
        for label in (scale.low_label, scale.high_label)
    )


def find_slider_height(scale: Scale, grid: Grid) -> float:
    """Tell how much height a slider takes with the number over it and the words under it.

    Returns its height in pixels.
    """
    lines = 1 + bool(scale.anchors) + count_label_lines(scale, grid)
    return (ABOVE + TRACK + UNDER + lines * BODY * LEADING) * grid.unit


def _lay_slider(view: View, *, grid: Grid, box: Box) -> Laid:
    unit, scale = grid.unit, view.scale
    if view.trial is None or scale is None:
        return [], []
    part = view.trial.judgements[0].part
    width = find_slider_width(grid)
    # Number, track and labels together stand in the middle of what is left.
    top = box.top + max(0.0, box.height - find_slider_height(scale, grid)) / 2
    track = Box((grid.width - width) / 2, top + ABOVE * unit, width, TRACK * unit)
    is_ready = view.can_answer
    value = view.markers.get(part)
    items = [
        *_draw_track(track, is_ready=is_ready, unit=unit),
        *_label_ends(track, scale, grid=grid),
    ]
    if view.typed:
        items.append(_write_over(track, view.typed + "_", at=0.5, size=QUESTION * unit))
    elif value is not None:
        items.append(
            _write_over(track, f"{value:.0f}", at=value / RATING_RANGE[1], size=QUESTION * unit)
        )
    if value is not None:
        items += _draw_marker(track, value, color=BLUE if is_ready else LINE)
    return items, [Target(track.grow(2 * unit), "mark", part, track)] if is_ready else []


def _write_over(track: Box, words: str, *, at: float, size: float) -> Text:
    width = measure("100_", size, bold=True)
    box = Box(
        track.left + at * track.width - width / 2, track.top - 1.9 * size, width, size * LEADING
    )
    return Text(box, words, size, INK, bold=True, align="center")


def _draw_track(track: Box, *, is_ready: bool, unit: float) -> list[Item]:
    """Draw a line with ends; none of its places stands out but these."""
    color = DIM if is_ready else LINE
    middle = track.top + track.height / 2
    thick = max(2.0, 0.45 * unit)
    line = Box(track.left, middle - thick / 2, track.width, thick)
    top, height = track.top + track.height * 0.15, track.height * 0.7
    ends = [Box(x - thick / 2, top, thick, height) for x in (track.left, track.right)]
    return [Area(line, fill=color), *(Area(end, fill=color) for end in ends)]


def _draw_marker(track: Box, value: float, *, color: str) -> list[Item]:
    low, high = RATING_RANGE
    x = track.left + (value - low) / (high - low) * track.width
    width = track.height * 0.36
    box = Box(x - width / 2, track.top, width, track.height)
    return [Area(box, fill=color, round_px=width / 2)]


def _label_ends(track: Box, scale: Scale, *, grid: Grid) -> list[Item]:
    """Write the numbers and words of both ends under the track, and what stands in between."""
    unit, size = grid.unit, BODY * grid.unit
    low, high = RATING_RANGE
    step = size * LEADING
    top = track.bottom + UNDER * unit
    items: list[Item] = []
    if scale.anchors:
        items += _label_anchors(track, scale, top=top, size=SMALL * unit)
        top += step
    width = LABEL * track.width
    for number, label, align, left in (
        (low, scale.low_label, "left", track.left),
        (high, scale.high_label, "right", track.right - width),
    ):
        items.append(
            Text(Box(left, top, width, step), f"{number:.0f}", SMALL * unit, DIM, align=align)
        )
        lines = wrap(label, width, size=size)
        items += lay_lines(Box(left, top + step, width, step), lines, size=size, align=align)
    return items


def _label_anchors(track: Box, scale: Scale, *, top: float, size: float) -> list[Item]:
    count = len(scale.anchors)
    items: list[Item] = []
    for place, word in enumerate(scale.anchors):
        width = measure(word, size)
        x = track.left + track.width * (place / (count - 1) if count > 1 else 0.5)
        items.append(
            Text(Box(x - width / 2, top, width, size * LEADING), word, size, DIM, align="center")
        )
    return items


def _lay_rows(view: View, texts: ScreenTexts, *, grid: Grid, box: Box) -> Laid:
    """Set the reference beside the words of the scale, and under them a row for each vibration."""
    if view.trial is None or view.scale is None:
        return [], []
    unit, small = grid.unit, SMALL * grid.unit
    judged = [judgement.part for judgement in view.trial.judgements]
    names = {part.name: name_part(part.name, texts) for part in view.trial.parts}
    field = max(measure(name, small, bold=True) for name in names.values()) + 9 * unit
    left, margin = box.left + field + 12 * unit, 12 * unit
    track = Box(left, box.top, box.right - margin - left, 0)
    head = 2 * LEADING * small + 1.2 * unit
    row = min(ROW * unit, (box.height - head) / len(judged))
    items = _label_rows(track, view.scale, top=box.top, size=small)
    targets: list[Target] = []
    spots = {
        name: Box(box.left, box.top, field, head - 1.2 * unit)
        for name in names
        if name not in judged
    }
    for place, name in enumerate(judged):
        line = Box(box.left, box.top + head + place * row, box.width, row)
        own = Box(track.left, line.top + 0.14 * row, track.width, 0.72 * row)
        items += _draw_row(view, name, line=line, track=own, unit=unit)
        targets.append(
            Target(Box(own.left - 2 * unit, line.top, own.width + 4 * unit, row), "mark", name, own)
        )
        spots[name] = Box(box.left + unit, line.top + 0.04 * row, field - unit, 0.92 * row)
    for name, spot in spots.items():
        items += draw_part(
            spot, names[name], size=small, is_on=name == view.playing, is_felt=name in view.felt
        )
        targets.append(Target(spot, "feel", name))
    return items, targets


def _label_rows(track: Box, scale: Scale, *, top: float, size: float) -> list[Item]:
    step, half = size * LEADING, track.width / 2
    return [
        Text(Box(track.left, top, half, step), scale.low_label, size, INK),
        Text(Box(track.left + half, top, half, step), scale.high_label, size, INK, align="right"),
        *_label_anchors(track, scale, top=top + step, size=size),
    ]


def _draw_row(view: View, name: str, *, line: Box, track: Box, unit: float) -> list[Item]:
    items: list[Item] = []
    is_selected = name == view.selected
    if is_selected:
        edge = Box(line.left - 0.8 * unit, line.top, 0.8 * unit, line.height)
        items += [Area(line, fill=PANEL), Area(edge, fill=BLUE)]
    items += _draw_track(track, is_ready=True, unit=unit)
    value = view.markers.get(name)
    if value is not None:
        items += _draw_marker(track, value, color=BLUE if is_selected else INK)
        number = Box(
            track.right + 3 * unit, line.top, line.right - track.right - 4 * unit, line.height
        )
        items.append(Text(number, f"{value:.0f}", BODY * unit, INK, bold=True, align="right"))
    return items


def _lay_choice(view: View, texts: ScreenTexts, *, grid: Grid, box: Box) -> Laid:
    """Set what can be chosen side by side; what was chosen is framed and marked."""
    if view.scale is None:
        return [], []
    unit = grid.unit
    count = len(view.scale.choices)
    width, height, gap = 34 * unit, min(22 * unit, box.height), 8 * unit
    left = (grid.width - count * width - (count - 1) * gap) / 2
    top = box.top + (box.height - height) / 2
    items: list[Item] = []
    targets: list[Target] = []
    for place, name in enumerate(view.scale.choices):
        field = Box(left + place * (width + gap), top, width, height)
        is_chosen = name == view.chosen
        ink = GROUND if is_chosen else INK if view.can_answer else DIM
        items += [
            Area(
                field,
                fill=BLUE if is_chosen else PANEL,
                line=LINE,
                round_px=2 * unit,
                line_px=0.3 * unit,
            ),
            Text(
                field, name_part(name, texts), 2 * QUESTION * unit, ink, bold=True, align="center"
            ),
        ]
        if view.can_answer:
            targets.append(Target(field, "choose", name))
    return items, targets
