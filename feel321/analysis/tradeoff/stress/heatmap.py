"""The map of a stress test: scenes down, reducers across, each cell coloured by the worst of its measures.

Reducers are ordered by the number of scenes that they fail on, so that the steadiest stand first. The page shows the
map as a table with links, results.json holds its counts, and a figure of it is for print.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

from feel321.analysis import words
from feel321.analysis.figures import style
from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.measures import MEASURES, StressCell

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.tradeoff.stress.measures import Grade

FIGURE = "stress"
ROW_CM, HEAD_CM, LABEL_CM, NAME_CM, LINE_CM = 0.56, 0.6, 4.3, 3.9, 0.4
"""Height of a row and of level names, width of scenes' titles, height of upright names and of a line of the key."""

FILLS = {"good": "#FFFFFF", "caution": "#F6D68F", "fails": "#B34700", "undefined": "#FFFFFF"}
"""White, pale orange and dark red: three steps of lightness, which a grey print keeps; white letters on the last."""

SEVERITY = {"undefined": -1, "good": 0, "caution": 1, "fails": 2}
ROOM = 3
"""Letters that a cell has room for."""

NAMED = 3
"""Reducers that a sentence names before it only counts them."""

CAPTION = (
    "Where reducers fail. Each cell has the grade of the worst measure of a reducer (column) on a scene (row), and the "
    "letters of the measures with that grade, worst first (+: more). Reducers failing on the fewest scenes come first."
)


@dataclass(frozen=True, slots=True)
class MapCell:
    """A reducer on a scene: its grade, the letters of the measures that have it, and both in words."""

    scene: str
    reducer: str
    grade: Grade
    letters: str
    label: str

    @property
    def shown(self) -> str:
        """The letters that a cell has room for, or a dash where no measure is defined."""
        if self.grade == "undefined":
            return words.ABSENT
        return self.letters if len(self.letters) <= ROOM else f"{self.letters[: ROOM - 1]}+"


def find_severity(cell: StressCell) -> tuple[int, float]:
    """Find how bad a measure is: its grade, then its share of the limit."""
    share = abs(cell.value) / MEASURES[cell.measure].fails
    return SEVERITY[cell.grade], 0.0 if math.isnan(share) else share


def build_map(
    cells: Sequence[StressCell], reducers: Sequence[str]
) -> dict[str, dict[str, MapCell]]:
    """Build the map: scene -> reducer -> cell, the reducers in its order."""
    found: dict[tuple[str, str], list[StressCell]] = {}
    for cell in cells:
        found.setdefault((cell.recording, cell.reducer), []).append(cell)
    ordered = list(count_failed_scenes(cells, reducers))
    return {scene: {name: _grade_cell(found[scene, name]) for name in ordered} for scene in BATTERY}


def _grade_cell(cells: Sequence[StressCell]) -> MapCell:
    ordered = sorted(cells, key=find_severity, reverse=True)
    grade, first = ordered[0].grade, ordered[0]
    worst = [cell for cell in ordered if cell.grade == grade] if SEVERITY[grade] > 0 else []
    letters = "".join(MEASURES[cell.measure].letter for cell in worst)
    shown = (
        f"{MEASURES[one.measure].title.lower()} {format_value(one.value, MEASURES[one.measure].unit)}"
        for one in worst
    )
    title = BATTERY[first.recording].title
    rest = "not defined" if grade == "undefined" else grade
    what = f"{grade}, {', '.join(shown)}" if worst else rest
    label = f"{first.reducer} on {title[0].lower() + title[1:] if title[1:2].islower() else title}: {what}"
    return MapCell(first.recording, first.reducer, grade, letters, label)


def count_failed_scenes(cells: Sequence[StressCell], reducers: Sequence[str]) -> dict[str, int]:
    """Count the scenes on which each reducer fails by any measure, the fewest first, the undefined last."""
    failed = {(cell.reducer, cell.recording) for cell in cells if cell.grade == "fails"}
    counts = {name: sum(one == name for one, _ in failed) for name in reducers}
    undefined = find_undefined(cells)
    return dict(sorted(counts.items(), key=lambda one: (one[0] in undefined, one[1])))


def find_undefined(cells: Sequence[StressCell]) -> dict[str, int]:
    """Find the reducers that have scenes without any measure, and the number of these scenes."""
    places = dict.fromkeys((cell.reducer, cell.recording) for cell in cells)
    known = {(cell.reducer, cell.recording) for cell in cells if cell.grade != "undefined"}
    return Counter(name for name, scene in places if (name, scene) not in known)


def describe_finding(counts: Mapping[str, int], undefined: Mapping[str, int] | None = None) -> str:
    """Describe in one sentence which reducers fail on the fewest scenes, and which on the most.

    undefined: reducer -> scenes without any measure; such a reducer is not compared with the others.
    """
    undefined = undefined or {}
    lacking = "; ".join(
        f"{name} is not defined on {_count(one)} of them" for name, one in undefined.items()
    )
    counts = {name: count for name, count in counts.items() if name not in undefined}
    if not counts:
        return f"No reducer can be judged on the {len(BATTERY)} stress scenes: {lacking}."
    found = _compare_counts(counts)
    return f"{found}; {lacking}." if lacking else f"{found}."


def _compare_counts(counts: Mapping[str, int]) -> str:
    least, most, of = min(counts.values()), max(counts.values()), len(BATTERY)
    first, last = ([name for name in counts if counts[name] == one] for one in (least, most))
    found = f"{_name(first)} on {_count(least)} of the {of} stress scenes"
    return found if least == most else f"{found}, the fewest; {_name(last)} on {_count(most)}"


def _count(count: int) -> str:
    return "all" if count == len(BATTERY) else str(count or "none")


def _name(names: Sequence[str]) -> str:
    shown = words.join_words(names) if len(names) <= NAMED else f"{len(names)} reducers"
    return f"{shown} fail{'s' if len(names) == 1 else ''}"


def format_value(value: float, unit: str = "") -> str:
    """Write a value for the page, with three digits at most.

    Examples
    --------
    >>> format_value(1389.6), format_value(1e-16), format_value(-4.77, "dB"), format_value(0.1234)
    ('1390', '0', '−4.8 dB', '0.123')
    """
    if math.isnan(value):
        return words.ABSENT
    if abs(value) < 5e-4:  # noqa: PLR2004 - less than the last digit shown
        return "0"
    if unit:
        return f"{value:+.1f} {unit}".replace("-", words.MINUS)
    text = f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:#.3g}"  # noqa: PLR2004 - where the digits change
    return text.replace("-", words.MINUS)


def describe_letters() -> str:
    """Explain the letters."""
    return "; ".join(
        f"{one.letter} {one.title.lower()} from {one.fails:g}{' ' if one.unit else ''}{one.unit}"
        for one in MEASURES.values()
    )


def draw_stress(cells: Sequence[StressCell], reducers: Sequence[str]) -> Figure:
    """Draw the map for print, two columns wide: reducers across, scenes down."""
    from matplotlib.figure import Figure

    found, wide = build_map(cells, reducers), 2 * style.COLUMN_CM
    names = list(next(iter(found.values())))
    text = f"Dark: a measure fails; pale: one comes near. Letters, the worst first: {describe_letters()}."
    key = style.fit_text(text, wide - 0.4, lines=5)
    rows, below = ROW_CM * len(found), LINE_CM * (key.count("\n") + 1) + 0.2
    height = NAME_CM + rows + below
    with style.print_style():
        figure = Figure(figsize=(wide / style.CM_PER_INCH, height / style.CM_PER_INCH))
        width = 1 - (LABEL_CM + 0.1) / wide
        axes = figure.add_axes((LABEL_CM / wide, below / height, width, rows / height))
        _label_map(axes, names, scenes=list(found))
        for (row, own), (column, name) in product(enumerate(found.values()), enumerate(names)):
            _draw_cell(axes, own[name], place=(column, row))
        figure.text(0.2 / wide, (below - 0.15) / height, key, va="top", linespacing=1.25)
    return figure


def _label_map(axes: Axes, names: Sequence[str], *, scenes: Sequence[str]) -> None:
    """Write the names of columns and rows."""
    axes.set(xlim=(0, len(names)), ylim=(len(scenes), 0))
    axes.xaxis.tick_top()
    columns, lines = ([place + 0.5 for place in range(len(own))] for own in (names, scenes))
    shown = [style.fit_text(one, NAME_CM, lines=1) for one in names]
    axes.set_xticks(columns, shown, rotation=90)
    axes.set_yticks(lines, [BATTERY[scene].title for scene in scenes])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _draw_cell(axes: Axes, cell: MapCell, *, place: tuple[int, int]) -> None:
    from matplotlib.patches import Rectangle

    fill, edge = FILLS[cell.grade], style.GREY
    axes.add_patch(Rectangle(place, 1, 1, facecolor=fill, edgecolor=edge, linewidth=style.THIN))
    ink = "#FFFFFF" if cell.grade == "fails" else style.BLACK
    middle = place[0] + 0.5, place[1] + 0.52
    axes.text(*middle, cell.shown, color=ink, ha="center", va="center", size=5)
