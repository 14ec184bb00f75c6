"""The stress test's heat map and page, whose red cells lead to their explanations."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from feel321.analysis.figures import style
from feel321.analysis.report.section import PageTable
from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS
from feel321.analysis.tradeoff.stress.measures import MEASURES, StressCell
from feel321.analysis.tradeoff.stress.result import MOVED, StressResult, count_failures, find_reason
from feel321.analysis.words import ABSENT, MINUS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

FIGURE = "stress"
WIDTH_CM = 2 * style.COLUMN_CM + 0.8
ROW_CM, HEAD_CM, KEY_CM, LABEL_CM, MARGIN_CM = 0.66, 1.2, 1.3, 3.7, 0.1
FILLS = {"good": "#FFFFFF", "caution": "#F6D68F", "fails": "#D55E00", "undefined": "#E6E6E6"}
"""White, Okabe and Ito's orange made paler, and their vermilion: three steps of lightness, which a grey print keeps."""

NARROW_CM, UPRIGHT_CM = 1.2, 3.4
"""Columns narrower than this have upright names, which need so much height."""

VALUE_SIZE, MARK_SIZE, KEY_SIZE, HEAD_LINES = 6.5, 5.5, 6.0, 3

CAPTION = (
    "Where reducers fail. Each cell: perturbation gain of a reducer (column) on a scene (row) and the letters of the "
    "other measures that it fails by. A cell in which something fails leads to its explanation."
)


class GradedText(str):
    """An entry of a table of a page; grade: the style class that colours it; link: where it leads."""

    __slots__ = ("grade", "link")
    grade: str
    link: str

    def __new__(cls, text: str, grade: str = "", link: str = "") -> GradedText:
        """Make the text and remember how it is shown."""
        made = super().__new__(cls, text)
        made.grade, made.link = grade, link
        return made


def draw_stress(result: StressResult) -> Figure:
    """Draw the heat map, two columns wide: reducers across, scenes down."""
    from matplotlib.figure import Figure

    wide = (WIDTH_CM - LABEL_CM - MARGIN_CM) / max(len(result.reducers), 1)
    upright = wide < NARROW_CM
    names = [
        name if upright else style.fit_text(name, wide, lines=HEAD_LINES, size=VALUE_SIZE)
        for name in result.reducers
    ]
    height = (UPRIGHT_CM if upright else HEAD_CM) + ROW_CM * len(BATTERY) + KEY_CM
    left, right = LABEL_CM / WIDTH_CM, MARGIN_CM / WIDTH_CM
    with style.print_style():
        figure = Figure(figsize=(WIDTH_CM / style.CM_PER_INCH, height / style.CM_PER_INCH))
        box = (left, KEY_CM / height, 1 - left - right, ROW_CM * len(BATTERY) / height)
        axes = figure.add_axes(box)
        _label(axes, names, rotation=90 if upright else 0)
        cells: dict[tuple[str, str], dict[str, StressCell]] = {}
        for cell in result.cells:
            cells.setdefault((cell.recording, cell.reducer), {})[cell.measure] = cell
        for row, scene in enumerate(BATTERY):
            for column, reducer in enumerate(result.reducers):
                _draw_cell(axes, cells[scene, reducer], place=(column, row))
        lines = (
            style.fit_text(line, WIDTH_CM - 4 * MARGIN_CM, lines=3, size=KEY_SIZE)
            for line in _describe_key()
        )
        place = (right, (KEY_CM - 0.2) / height)
        figure.text(*place, "\n".join(lines), va="top", fontsize=KEY_SIZE, linespacing=1.25)
    return figure


def _label(axes: Axes, names: Sequence[str], *, rotation: int) -> None:
    axes.set(xlim=(0, len(names)), ylim=(len(BATTERY), 0))
    axes.xaxis.tick_top()
    columns, rows = ([place + 0.5 for place in range(len(own))] for own in (names, BATTERY))
    axes.set_xticks(columns, names, fontsize=VALUE_SIZE, rotation=rotation)
    axes.set_yticks(rows, [scene.title for scene in BATTERY.values()])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def _draw_cell(axes: Axes, cells: Mapping[str, StressCell], *, place: tuple[int, int]) -> None:
    from matplotlib.patches import Rectangle

    gain, *further = cells.values()
    letters = "".join(MEASURES[cell.measure].letter for cell in further if cell.grade == "fails")
    failing = gain.grade == "fails"
    box = Rectangle(
        place, 1, 1, facecolor=FILLS[gain.grade], edgecolor=style.GREY, linewidth=style.THIN
    )
    if letters or failing:
        box.set_url(f"#{gain.recording}-{gain.reducer}")
    axes.add_patch(box)
    look: dict[str, Any] = {
        "color": "#FFFFFF" if failing else style.BLACK, "ha": "center", "va": "center",
    }  # fmt: skip
    x, y = place[0] + 0.5, place[1]
    weight = "bold" if failing else "normal"
    high = y + (0.32 if letters else 0.5)
    axes.text(x, high, format_gain(gain.value), size=VALUE_SIZE, weight=weight, **look)
    axes.text(x, y + 0.74, letters, size=MARK_SIZE, **look)


def _describe_key() -> tuple[str, str]:
    gain, *others = MEASURES.values()
    marks = (
        f"{one.letter} {one.brief} ≥ {one.fails:g}{' ' * bool(one.unit)}{one.unit}"
        for one in others
    )
    return (
        f"Number and colour: median perturbation gain at −60 dB noise; white below {gain.caution:g}, pale from "
        f"{gain.caution:g}, dark and bold from {gain.fails:g} (1414: the output is all noise).",
        f"Letters: what else fails. {'; '.join(marks)}.",
    )


def format_gain(gain: float) -> str:
    """Write a gain so that it fits a cell.

    Examples
    --------
    >>> [format_gain(gain) for gain in (0.578, 3.04, 16.6, 1390.2)]
    ['0.58', '3.0', '17', '1390']
    """
    if math.isnan(gain):
        return ABSENT
    digits = 2 if gain < 0.995 else 1 if gain < 9.95 else 0  # noqa: PLR2004 - where rounding adds a digit
    return f"{gain:.{digits}f}"


def format_value(value: float, unit: str = "") -> str:
    """Write a value for the page, with three digits at most.

    Examples
    --------
    >>> format_value(1389.6), format_value(1e-16), format_value(-4.77, "dB"), format_value(0.1234)
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


def build_page(result: StressResult) -> dict[str, object]:
    """Build what the page shows."""
    return {
        "result": result,
        "caption": CAPTION,
        "battery": BATTERY,
        "measures": MEASURES,
        "counts": _tabulate_counts(result),
        "grids": [_tabulate_measure(result, measure) for measure in MEASURES],
        "explained": _explain(result),
        "near": {scene: list(_list_near(result, scene)) for scene in BATTERY},
        "gains": _tabulate_gains(result),
        "recordings": _tabulate_recordings(result),
        "metrics": _tabulate_metrics(result),
    }


def name_anchor(scene: str, reducer: str) -> str:
    """Name the place of an explanation; the heat map's links get their picture's name in front, as all its ids do."""
    return f"{FIGURE}-{scene}-{reducer}"


def _list_near(result: StressResult, scene: str) -> Iterator[str]:
    """List the recordings that come near a scene, with their signs of it."""
    for one in result.diagnoses:
        signs = [sign for sign in one.near_signs if sign.name in BATTERY[scene].signs]
        shown = ", ".join(f"{sign.title} {sign.format(one.figures[sign.name])}" for sign in signs)
        if shown:
            yield f"{one.recording} ({shown})"


def _explain(result: StressResult) -> dict[str, dict[str, list[str]]]:
    """List what each reducer fails by on each scene, and why."""
    found: dict[str, dict[str, list[str]]] = {scene: {} for scene in BATTERY}
    for cell in result.failures:
        measure = MEASURES[cell.measure]
        upper = {"90 %": cell.p90, "95 %": cell.p95, "worst": cell.worst}
        notes = [f"limit {measure.fails:g}"]
        notes += [f"{name} {format_value(value)}" for name, value in upper.items()]
        if not math.isnan(cell.up_to_phase):
            notes.append(f"{format_value(cell.up_to_phase)} up to a constant phase")
        value, why = format_value(cell.value, measure.unit), find_reason(cell.measure, cell.reducer)
        line = f"{measure.title} {value} ({', '.join(notes)}): {why}"
        found[cell.recording].setdefault(cell.reducer, []).append(line)
    return found


def _show(cell: StressCell, *, linked: bool = True) -> GradedText:
    """Show the median, and the 90th percentile and the worst where they differ from it."""
    median = format_value(cell.value, MEASURES[cell.measure].unit)
    p90, worst = format_value(cell.p90), format_value(cell.worst)
    alone = math.isnan(cell.p90) or (p90 == worst and p90 in median)
    anchor = name_anchor(cell.recording, cell.reducer)
    link = f"#{anchor}" if linked and cell.grade == "fails" else ""
    return GradedText(median if alone else f"{median} / {p90} / {worst}", cell.grade, link)


def _tabulate_measure(result: StressResult, measure: str) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for scene, entry in BATTERY.items():
        own = [cell for cell in result.cells if (cell.recording, cell.measure) == (scene, measure)]
        if any(cell.grade != "undefined" for cell in own):
            rows.append((entry.title, *map(_show, own)))
    title, what = MEASURES[measure].title, MEASURES[measure].what
    caption = f"{title}: {what[0].lower()}{what[1:]}"
    return PageTable(caption, ("Scene", *result.reducers), tuple(rows))


def _tabulate_counts(result: StressResult) -> PageTable:
    counts = {key: count_failures(result, key) for key in MOVED}
    limit = f"{100 * MEASURES['rotation'].fails:.0f} %"
    return PageTable(
        f"Number of scenes, of {len(BATTERY)}, on which the output changes by {limit} or more (median takes).",
        ("Reducer", *MOVED.values()),
        tuple(
            (name, *(GradedText(str(own[name]), "caution" * bool(own[name])) for own in counts.values()))
            for name in result.reducers
        ),
    )  # fmt: skip


def _tabulate_gains(result: StressResult) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for one in result.diagnoses:
        own = (cell for cell in result.gains if cell.recording == one.recording)
        rows.append((one.recording, *(_show(cell, linked=False) for cell in own)))
    caption = f"Perturbation gain on each recording: median / 90 % / worst of {result.inputs['draws']} noises."
    return PageTable(caption, ("Recording", *result.reducers), tuple(rows))


def _tabulate_recordings(result: StressResult) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for one in result.diagnoses:
        near = one.near_signs
        shown = (
            GradedText(sign.format(one.figures[name]), "caution" if sign in near else "")
            for name, sign in SIGNS.items()
        )
        rows.append((one.recording, *shown))
    head = ("Recording", *(sign.title for sign in SIGNS.values()))
    caption = "Properties of the recordings that make reducers fail. Marked: beyond the limit."
    return PageTable(caption, head, tuple(rows))


def _tabulate_metrics(result: StressResult) -> PageTable:
    rows: list[tuple[str, ...]] = []
    for row in result.metrics:
        title = BATTERY[row.recording].title if row.recording in BATTERY else row.recording
        low, high, still, moved = map(
            format_value,
            (
                row.temporal_low,
                row.temporal_high,
                row.invariant_high,
                row.invariant_high - row.invariant_low,
            ),
        )
        rows.append((
            title,
            GradedText(f"{low}–{high}", "fails" if row.moves else "good"),
            f"{still} (moves by {moved})",
            GradedText(format_value(row.spectral), "fails" if row.explodes else "good"),
            row.worst_reducer or ABSENT,
            format_value(row.spectral_bounded),
            format_value(row.spectral_energy_weighted),
        ))
    head = (
        "Scene or recording", "Temporal match (eq. 2), lowest–highest", "Invariant counterpart",
        "Lowest spectral match (eq. 1)", "of", "Bounded", "Energy-weighted",
    )  # fmt: skip
    caption = (
        "Temporal match fails where it varies by more than 0.1 with the mounting; spectral match where it falls "
        "below −1."
    )
    return PageTable(caption, head, tuple(rows))
