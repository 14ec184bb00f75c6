"""The stress test's figures and page."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.analysis.figures.style import (
    BLACK,
    CM_PER_INCH,
    COLUMN_CM,
    GREY,
    THIN,
    fit_text,
    new_canvas,
    print_style,
)
from feel321.analysis.report.page import TEMPLATES, inline_svg
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS
from feel321.analysis.tradeoff.stress.measures import MEASURES
from feel321.analysis.tradeoff.stress.result import FIGURES, tell_reason
from feel321.analysis.words import ABSENT, MINUS, keep_together

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from feel321.analysis.tradeoff.stress.cells import Cell, MetricRow
    from feel321.analysis.tradeoff.stress.diagnosis import Diagnosis
    from feel321.analysis.tradeoff.stress.result import StressResult

# The heat map: reducers across, scenes down, and in every cell the perturbation gain and what else fails.

WIDTH_CM = 2 * COLUMN_CM + 0.8
ROW_CM, HEAD_CM, KEY_CM, LABEL_CM, MARGIN_CM = 0.66, 1.2, 1.3, 3.7, 0.1
FILLS = {"good": "#FFFFFF", "caution": "#F6D68F", "fails": "#D55E00", "undefined": "#E6E6E6"}
"""White, Okabe and Ito's orange made paler, and their vermilion: three steps of lightness, so that grey prints tell."""

NARROW_CM, UPRIGHT_CM = 1.2, 3.4
"""Columns narrower than this have upright names, which need so much height."""

LETTERS = {"good": BLACK, "caution": BLACK, "fails": "#FFFFFF", "undefined": BLACK}
VALUE_SIZE, MARK_SIZE, KEY_SIZE, HEAD_LINES = 6.5, 5.5, 6.0, 3


def draw_stress(result: StressResult) -> Figure:
    """Draw the heat map, two columns wide."""
    from matplotlib.figure import Figure

    wide = (WIDTH_CM - LABEL_CM - MARGIN_CM) / max(len(result.reducers), 1)
    upright = wide < NARROW_CM
    names = [
        name if upright else fit_text(name, wide, lines=HEAD_LINES, size=VALUE_SIZE)
        for name in result.reducers
    ]
    head = UPRIGHT_CM if upright else HEAD_CM
    height = head + ROW_CM * len(BATTERY) + KEY_CM
    with print_style():
        figure = Figure(figsize=(WIDTH_CM / CM_PER_INCH, height / CM_PER_INCH))
        left, bottom = LABEL_CM / WIDTH_CM, KEY_CM / height
        axes = figure.add_axes((
            left,
            bottom,
            1 - left - MARGIN_CM / WIDTH_CM,
            ROW_CM * len(BATTERY) / height,
        ))
        _prepare(axes, names, rotation=90 if upright else 0)
        grouped = _group(result.cells)
        for row, scene in enumerate(BATTERY):
            for column, reducer in enumerate(result.reducers):
                _draw_cell(axes, grouped[scene, reducer], place=(column, row))
        key = "\n".join(
            fit_text(line, WIDTH_CM - 4 * MARGIN_CM, lines=3, size=KEY_SIZE) for line in _tell_key()
        )
        place = (MARGIN_CM / WIDTH_CM, (KEY_CM - 0.2) / height)
        figure.text(*place, key, va="top", fontsize=KEY_SIZE, linespacing=1.25)
    return figure


def _prepare(axes: Axes, names: Sequence[str], *, rotation: int) -> None:
    axes.set(xlim=(0, len(names)), ylim=(len(BATTERY), 0))
    axes.xaxis.tick_top()
    axes.set_xticks(
        [column + 0.5 for column in range(len(names))],
        names,
        fontsize=VALUE_SIZE,
        rotation=rotation,
    )
    axes.set_yticks(
        [row + 0.5 for row in range(len(BATTERY))], [scene.title for scene in BATTERY.values()]
    )
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_cell(axes: Axes, cells: Mapping[str, Cell], *, place: tuple[int, int]) -> None:
    from matplotlib.patches import Rectangle

    column, row = place
    gain = cells["gain"]
    others = "".join(
        MEASURES[key].letter
        for key, cell in cells.items()
        if key != "gain" and cell.grade == "fails"
    )
    box = Rectangle(place, 1, 1, facecolor=FILLS[gain.grade], edgecolor=GREY, linewidth=THIN)
    if others or gain.grade == "fails":
        box.set_url(f"#{gain.recording}-{gain.reducer}")
    axes.add_patch(box)
    weight = "bold" if gain.grade == "fails" else "normal"
    look: dict[str, Any] = {"color": LETTERS[gain.grade], "ha": "center", "va": "center"}
    high = row + (0.32 if others else 0.5)
    axes.text(column + 0.5, high, tell_gain(gain.value), size=VALUE_SIZE, weight=weight, **look)
    axes.text(column + 0.5, row + 0.74, others, size=MARK_SIZE, **look)


def tell_gain(gain: float) -> str:
    """Write a gain so that it fits a cell.

    Examples
    --------
    >>> [tell_gain(gain) for gain in (0.578, 3.04, 16.6, 1390.2)]
    ['0.58', '3.0', '17', '1390']
    """
    if math.isnan(gain):
        return ABSENT
    digits = 2 if gain < 0.995 else 1 if gain < 9.95 else 0  # noqa: PLR2004 - where rounding adds a digit
    return f"{gain:.{digits}f}"


def _group(cells: Sequence[Cell]) -> dict[tuple[str, str], dict[str, Cell]]:
    grouped: dict[tuple[str, str], dict[str, Cell]] = {}
    for cell in cells:
        grouped.setdefault((cell.recording, cell.reducer), {})[cell.measure] = cell
    return grouped


def _tell_key() -> tuple[str, ...]:
    gain, *others = MEASURES.values()
    marks = "; ".join(
        f"{one.letter} {one.brief} ≥ {one.fails:g}{' ' * bool(one.unit)}{one.unit}"
        for one in others
    )
    return (
        f"Number and colour: median perturbation gain at −60 dB noise; white below {gain.caution:g}, pale from "
        f"{gain.caution:g}, dark and bold from {gain.fails:g} (1414: the output is all noise).",
        f"Letters: what else fails. {marks}.",
    )


# The stress test's page: one self-contained HTML file whose red cells lead to their explanations.

CAPTION = (
    "Where reducers fail. Each cell: perturbation gain of a reducer (column) on a scene (row) and the letters of the "
    "other measures that it fails by. A cell in which something fails leads to its explanation."
)


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure as a table shows it."""

    text: str
    grade: str = ""
    link: str = ""


@dataclass(frozen=True, slots=True)
class Explained:
    """What a reducer fails by on a scene."""

    anchor: str
    reducer: str
    lines: tuple[str, ...]


def render_page(result: StressResult, *, figures: Path) -> str:
    """Render the page."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=keep_together,
    )
    picture = Picture(FIGURES[0], CAPTION, new_canvas(1))
    return environment.get_template("stress.html").render(
        result=result,
        style=(TEMPLATES / "report.css").read_text(encoding="utf-8"),
        # matplotlib's links open a window of their own; these lead down the page.
        drawing=inline_svg(picture, figures / f"{FIGURES[0]}.svg").replace(' target="_blank"', ""),
        caption=CAPTION,
        battery=BATTERY,
        measures=MEASURES,
        signs=SIGNS,
        grids={measure: list(_list_rows(result, measure)) for measure in MEASURES},
        explained={scene: list(_explain(result, scene)) for scene in BATTERY},
        near={scene: result.find_near(scene) for scene in BATTERY},
        recordings=[_show_recording(diagnosis) for diagnosis in result.diagnoses],
        gains=list(_list_gains(result)),
        metrics=[_show_metrics(row) for row in result.metrics],
    )


def name_anchor(scene: str, reducer: str) -> str:
    """Name the place of an explanation; the heat map's links get their picture's name in front, as all its ids do.

    Examples
    --------
    >>> name_anchor("anti_phase", "dft321")
    'stress-anti_phase-dft321'
    """
    return f"{FIGURES[0]}-{scene}-{reducer}"


def tell_figure(value: float, unit: str = "") -> str:
    """Write a figure for the page.

    Returns three digits at most.

    Examples
    --------
    >>> tell_figure(1389.6), tell_figure(1e-16), tell_figure(-4.77, "dB"), tell_figure(0.1234)
    ('1390', '0', '−4.8 dB', '0.123')
    """
    if math.isnan(value):
        return ABSENT
    if abs(value) < 5e-4:  # noqa: PLR2004 - less than the last digit shown
        return "0"
    if unit:
        return f"{value:+.1f} {unit}".replace("-", MINUS)
    text = f"{value:.0f}" if 100 <= abs(value) < 1e6 else f"{value:#.3g}"  # noqa: PLR2004 - where the digits change
    return text.replace("-", MINUS)


def _show(cell: Cell, *, linked: bool = True) -> Shown:
    link = (
        f"#{name_anchor(cell.recording, cell.reducer)}" if linked and cell.grade == "fails" else ""
    )
    return Shown(_tell_spread(cell), cell.grade, link)


def _tell_spread(cell: Cell) -> str:
    """Median, and the 90th percentile and the worst where they differ from it."""
    unit = MEASURES[cell.measure].unit
    told = [tell_figure(cell.value, unit), tell_figure(cell.p90), tell_figure(cell.worst)]
    return (
        told[0]
        if math.isnan(cell.p90) or (told[1] == told[2] and told[1] in told[0])
        else " / ".join(told)
    )


def _list_rows(result: StressResult, measure: str) -> Iterator[tuple[str, list[Shown]]]:
    for scene, entry in BATTERY.items():
        row = [
            _show(cell)
            for cell in result.cells
            if (cell.recording, cell.measure) == (scene, measure)
        ]
        if any(shown.grade != "undefined" for shown in row):
            yield entry.title, row


def _explain(result: StressResult, scene: str) -> Iterator[Explained]:
    for reducer in result.reducers:
        lines = tuple(
            _tell_failure(cell)
            for cell in result.failures
            if (cell.recording, cell.reducer) == (scene, reducer)
        )
        if lines:
            yield Explained(name_anchor(scene, reducer), reducer, lines)


def _tell_failure(cell: Cell) -> str:
    measure = MEASURES[cell.measure]
    value = tell_figure(cell.value, measure.unit)
    upper = zip(("90 %", "95 %", "worst"), (cell.p90, cell.p95, cell.worst), strict=True)
    notes = [f"limit {measure.fails:g}", *(f"{name} {tell_figure(at)}" for name, at in upper)]
    if not math.isnan(cell.up_to_phase):
        notes.append(f"{tell_figure(cell.up_to_phase)} up to a constant phase")
    return (
        f"{measure.title} {value} ({', '.join(notes)}): {tell_reason(cell.measure, cell.reducer)}"
    )


def _show_recording(diagnosis: Diagnosis) -> tuple[str, list[Shown]]:
    near = set(diagnosis.near_signs)
    values = [
        Shown(sign.tell(diagnosis.figures[name]), "caution" if sign in near else "")
        for name, sign in SIGNS.items()
    ]
    return diagnosis.recording, values


def _list_gains(result: StressResult) -> Iterator[tuple[str, Sequence[Shown]]]:
    for diagnosis in result.diagnoses:
        own = [cell for cell in result.gains if cell.recording == diagnosis.recording]
        yield diagnosis.recording, [_show(cell, linked=False) for cell in own]


def _show_metrics(row: MetricRow) -> tuple[str, list[Shown]]:
    title = BATTERY[row.recording].title if row.recording in BATTERY else row.recording
    low, high, still = (
        tell_figure(value) for value in (row.temporal_low, row.temporal_high, row.invariant_high)
    )
    moved = tell_figure(row.invariant_high - row.invariant_low)
    return title, [
        Shown(f"{low}–{high}", "fails" if row.moves else "good"),
        Shown(f"{still} (moves by {moved})"),
        Shown(tell_figure(row.spectral), "fails" if row.explodes else "good"),
        Shown(row.worst_reducer or ABSENT),
        Shown(tell_figure(row.spectral_bounded)),
        Shown(tell_figure(row.spectral_energy_weighted)),
    ]
