"""The heat map: reducers across, scenes down, and in every cell the perturbation gain and what else fails."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from analysis.figures.style import BLACK, CM_PER_INCH, COLUMN_CM, GREY, THIN, print_style
from analysis.figures.text import fit_text
from analysis.tradeoff.stress.battery import BATTERY
from analysis.tradeoff.stress.limits import MEASURES
from analysis.words import ABSENT

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from analysis.tradeoff.stress.cells import Cell
    from analysis.tradeoff.stress.result import StressResult

WIDTH_CM = 2 * COLUMN_CM + 0.8
ROW_CM, HEAD_CM, KEY_CM, LABEL_CM, MARGIN_CM = 0.66, 1.2, 1.3, 3.7, 0.1
FILLS = {"good": "#FFFFFF", "caution": "#F6D68F", "fails": "#D55E00", "undefined": "#E6E6E6"}
"""White, Okabe and Ito's orange made paler, and their vermilion: three steps of lightness, so that grey prints tell."""

NARROW_CM, UPRIGHT_CM = 1.2, 3.4
"""Columns narrower than this have upright names, which need so much height."""

LETTERS = {"good": BLACK, "caution": BLACK, "fails": "#FFFFFF", "undefined": BLACK}
VALUE_SIZE, MARK_SIZE, KEY_SIZE, HEAD_LINES = 6.5, 5.5, 6.0, 3


def draw_stress(result: StressResult) -> Figure:
    """Draw the heat map, two columns wide.

    Parameters
    ----------
    result : StressResult
        What was measured.

    Returns
    -------
    Figure
        A cell per scene and reducer. In the SVG file, cells in which something fails are links to
        ``#scene-reducer``.
    """
    from matplotlib.figure import Figure

    wide = (WIDTH_CM - LABEL_CM - MARGIN_CM) / max(len(result.reducers), 1)
    upright = wide < NARROW_CM
    names = [name if upright else fit_text(name, wide, lines=HEAD_LINES, size=VALUE_SIZE) for name in result.reducers]
    head = UPRIGHT_CM if upright else HEAD_CM
    height = head + ROW_CM * len(BATTERY) + KEY_CM
    with print_style():
        figure = Figure(figsize=(WIDTH_CM / CM_PER_INCH, height / CM_PER_INCH))
        left, bottom = LABEL_CM / WIDTH_CM, KEY_CM / height
        axes = figure.add_axes((left, bottom, 1 - left - MARGIN_CM / WIDTH_CM, ROW_CM * len(BATTERY) / height))
        _prepare(axes, names, rotation=90 if upright else 0)
        grouped = _group(result.cells)
        for row, scene in enumerate(BATTERY):
            for column, reducer in enumerate(result.reducers):
                _draw_cell(axes, grouped[scene, reducer], place=(column, row))
        key = "\n".join(fit_text(line, WIDTH_CM - 4 * MARGIN_CM, lines=3, size=KEY_SIZE) for line in _tell_key())
        place = (MARGIN_CM / WIDTH_CM, (KEY_CM - 0.2) / height)
        figure.text(*place, key, va="top", fontsize=KEY_SIZE, linespacing=1.25)
    return figure


def _prepare(axes: Axes, names: Sequence[str], *, rotation: int) -> None:
    axes.set(xlim=(0, len(names)), ylim=(len(BATTERY), 0))
    axes.xaxis.tick_top()
    axes.set_xticks([column + 0.5 for column in range(len(names))], names, fontsize=VALUE_SIZE, rotation=rotation)
    axes.set_yticks([row + 0.5 for row in range(len(BATTERY))], [scene.title for scene in BATTERY.values()])
    axes.tick_params(length=0)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _draw_cell(axes: Axes, cells: Mapping[str, Cell], *, place: tuple[int, int]) -> None:
    from matplotlib.patches import Rectangle

    column, row = place
    gain = cells["gain"]
    others = "".join(MEASURES[key].letter for key, cell in cells.items() if key != "gain" and cell.grade == "fails")
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

    Parameters
    ----------
    gain : float
        The gain.

    Returns
    -------
    str
        Two digits, or whole numbers from 10 on.

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
    marks = "; ".join(f"{one.letter} {one.brief} ≥ {one.fails:g}{' ' * bool(one.unit)}{one.unit}" for one in others)
    return (
        f"Number and colour: median perturbation gain at −60 dB noise; white below {gain.caution:g}, pale from "
        f"{gain.caution:g}, dark and bold from {gain.fails:g} (1414: the output is all noise).",
        f"Letters: what else fails. {marks}.",
    )
