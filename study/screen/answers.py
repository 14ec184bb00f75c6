"""Where answers are given: one slider, rows of sliders, or a choice."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.trial import RATING_RANGE
from study.screen.fonts import measure, wrap
from study.screen.grid import BODY, QUESTION, SMALL, lay_lines
from study.screen.parts import draw_part, name_part
from study.screen.shapes import BLUE, DIM, GROUND, INK, LEADING, LINE, PANEL, Area, Box, Target, Text

if TYPE_CHECKING:
    from protocols.trial import Scale
    from study.screen.grid import Grid
    from study.screen.shapes import Item
    from study.screen.views import View
    from study.screen.wording import ScreenTexts

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
    """Lay out where the answer is given.

    Parameters
    ----------
    view : View
        What is on the screen.
    texts : ScreenTexts
        What it says.
    grid : Grid
        The screen.
    box : Box
        What is left of the body.

    Returns
    -------
    items : list of Item
        What to draw.
    targets : list of Target
        What can be clicked.
    """
    if view.kind == "rows":
        return _lay_rows(view, texts, grid=grid, box=box)
    if view.kind == "choice":
        return _lay_choice(view, texts, grid=grid, box=box)
    return _lay_slider(view, grid=grid, box=box)


def find_points(track: Box, x: float) -> float:
    """Tell which value a place on a slider stands for.

    Parameters
    ----------
    track : Box
        The slider's track.
    x : float
        The place, in pixels from the left of the screen.

    Returns
    -------
    float
        Whole points; the ends where the place lies beyond them.

    Examples
    --------
    >>> find_points(Box(100, 0, 200, 10), 250.0), find_points(Box(100, 0, 200, 10), 0.0)
    (75.0, 0.0)
    """
    low, high = RATING_RANGE
    return float(round(min(max(low + (x - track.left) / track.width * (high - low), low), high)))


def find_slider_width(grid: Grid) -> float:
    """Tell how wide a slider that stands alone is.

    Parameters
    ----------
    grid : Grid
        The screen.

    Returns
    -------
    float
        Its width in pixels.
    """
    return min(110 * grid.unit, grid.body.width - 8 * grid.unit)


def count_label_lines(scale: Scale, grid: Grid) -> int:
    """Count the lines that the longer label of a slider takes.

    Parameters
    ----------
    scale : Scale
        What is answered on it.
    grid : Grid
        The screen.

    Returns
    -------
    int
        The lines.
    """
    width = LABEL * find_slider_width(grid)
    return max(len(wrap(label, width, size=BODY * grid.unit)) for label in (scale.low_label, scale.high_label))


def find_slider_height(scale: Scale, grid: Grid) -> float:
    """Tell how much height a slider takes with the number over it and the words under it.

    Parameters
    ----------
    scale : Scale
        What is answered on it.
    grid : Grid
        The screen.

    Returns
    -------
    float
        Its height in pixels.
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
    items = [*_draw_track(track, is_ready=is_ready, unit=unit), *_label_ends(track, scale, grid=grid)]
    if view.typed:
        items.append(_write_over(track, view.typed + "_", at=0.5, size=QUESTION * unit))
    elif value is not None:
        items.append(_write_over(track, f"{value:.0f}", at=value / RATING_RANGE[1], size=QUESTION * unit))
    if value is not None:
        items += _draw_marker(track, value, color=BLUE if is_ready else LINE)
    return items, [Target(track.grow(2 * unit), "mark", part, track)] if is_ready else []


def _write_over(track: Box, words: str, *, at: float, size: float) -> Text:
    width = measure("100_", size, bold=True)
    box = Box(track.left + at * track.width - width / 2, track.top - 1.9 * size, width, size * LEADING)
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
        items.append(Text(Box(left, top, width, step), f"{number:.0f}", SMALL * unit, DIM, align=align))
        lines = wrap(label, width, size=size)
        items += lay_lines(Box(left, top + step, width, step), lines, size=size, align=align)
    return items


def _label_anchors(track: Box, scale: Scale, *, top: float, size: float) -> list[Item]:
    count = len(scale.anchors)
    items: list[Item] = []
    for place, word in enumerate(scale.anchors):
        width = measure(word, size)
        x = track.left + track.width * (place / (count - 1) if count > 1 else 0.5)
        items.append(Text(Box(x - width / 2, top, width, size * LEADING), word, size, DIM, align="center"))
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
    spots = {name: Box(box.left, box.top, field, head - 1.2 * unit) for name in names if name not in judged}
    for place, name in enumerate(judged):
        line = Box(box.left, box.top + head + place * row, box.width, row)
        own = Box(track.left, line.top + 0.14 * row, track.width, 0.72 * row)
        items += _draw_row(view, name, line=line, track=own, unit=unit)
        targets.append(Target(Box(own.left - 2 * unit, line.top, own.width + 4 * unit, row), "mark", name, own))
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
        number = Box(track.right + 3 * unit, line.top, line.right - track.right - 4 * unit, line.height)
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
            Area(field, fill=BLUE if is_chosen else PANEL, line=LINE, round_px=2 * unit, line_px=0.3 * unit),
            Text(field, name_part(name, texts), 2 * QUESTION * unit, ink, bold=True, align="center"),
        ]
        if view.can_answer:
            targets.append(Target(field, "choose", name))
    return items, targets
