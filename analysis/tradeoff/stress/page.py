"""The stress test's page: one self-contained HTML file whose red cells lead to their explanations."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.figures.style import new_canvas
from analysis.report.page import TEMPLATES, inline_svg
from analysis.report.pictures import Picture
from analysis.tradeoff.stress.battery import BATTERY
from analysis.tradeoff.stress.limits import MEASURES
from analysis.tradeoff.stress.reasons import tell_reason
from analysis.tradeoff.stress.result import FIGURES
from analysis.tradeoff.stress.signs import SIGNS
from analysis.words import ABSENT, MINUS, keep_together

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from analysis.tradeoff.stress.cells import Cell
    from analysis.tradeoff.stress.metrics import MetricRow
    from analysis.tradeoff.stress.result import StressResult
    from analysis.tradeoff.stress.signs import Diagnosis

CAPTION = (
    "Where reducers fail. Each cell: perturbation gain of a reducer (column) on a scene (row) and the letters of the "
    "other measures that it fails by. A cell in which something fails leads to its explanation."
)


@dataclass(frozen=True, slots=True)
class Shown:
    """A figure as a table shows it.

    Parameters
    ----------
    text : str
        The figure.
    grade : str
        Its class in the page.
    link : str
        Where its explanation stands; empty if nothing fails.
    """

    text: str
    grade: str = ""
    link: str = ""


@dataclass(frozen=True, slots=True)
class Explained:
    """What a reducer fails by on a scene.

    Parameters
    ----------
    anchor : str
        Where it stands.
    reducer : str
        Its name.
    lines : tuple of str
        One per measure.
    """

    anchor: str
    reducer: str
    lines: tuple[str, ...]


def render_page(result: StressResult, *, figures: Path) -> str:
    """Render the page.

    Parameters
    ----------
    result : StressResult
        What was measured.
    figures : Path
        Folder that holds the heat map's SVG file.

    Returns
    -------
    str
        HTML that needs neither network nor script.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, finalize=keep_together,
    )  # fmt: skip
    picture = Picture(FIGURES[0], "heat map", CAPTION, new_canvas(1))
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

    Parameters
    ----------
    scene, reducer : str
        Names.

    Returns
    -------
    str
        The id.

    Examples
    --------
    >>> name_anchor("anti_phase", "dft321")
    'stress-anti_phase-dft321'
    """
    return f"{FIGURES[0]}-{scene}-{reducer}"


def tell_figure(value: float, unit: str = "") -> str:
    """Write a figure for the page.

    Parameters
    ----------
    value : float
        The figure.
    unit : str
        Its unit; a figure in dB has a sign.

    Returns
    -------
    str
        Three digits at most; what is rounding is 0.

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
    link = f"#{name_anchor(cell.recording, cell.reducer)}" if linked and cell.grade == "fails" else ""
    return Shown(_tell_spread(cell), cell.grade, link)


def _tell_spread(cell: Cell) -> str:
    """Median, and the 90th percentile and the worst where they differ from it."""
    unit = MEASURES[cell.measure].unit
    told = [tell_figure(cell.value, unit), tell_figure(cell.p90), tell_figure(cell.worst)]
    return told[0] if math.isnan(cell.p90) or (told[1] == told[2] and told[1] in told[0]) else " / ".join(told)


def _list_rows(result: StressResult, measure: str) -> Iterator[tuple[str, list[Shown]]]:
    for scene, entry in BATTERY.items():
        row = [_show(cell) for cell in result.cells if (cell.recording, cell.measure) == (scene, measure)]
        if any(shown.grade != "undefined" for shown in row):
            yield entry.title, row


def _explain(result: StressResult, scene: str) -> Iterator[Explained]:
    for reducer in result.reducers:
        lines = tuple(
            _tell_failure(cell) for cell in result.failures if (cell.recording, cell.reducer) == (scene, reducer)
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
    return f"{measure.title} {value} ({', '.join(notes)}): {tell_reason(cell.measure, cell.reducer)}"


def _show_recording(diagnosis: Diagnosis) -> tuple[str, list[Shown]]:
    near = set(diagnosis.near_signs)
    values = [
        Shown(sign.tell(diagnosis.figures[name]), "caution" if sign in near else "") for name, sign in SIGNS.items()
    ]
    return diagnosis.recording, values


def _list_gains(result: StressResult) -> Iterator[tuple[str, Sequence[Shown]]]:
    for diagnosis in result.diagnoses:
        own = [cell for cell in result.gains if cell.recording == diagnosis.recording]
        yield diagnosis.recording, [_show(cell, linked=False) for cell in own]


def _show_metrics(row: MetricRow) -> tuple[str, list[Shown]]:
    title = BATTERY[row.recording].title if row.recording in BATTERY else row.recording
    low, high, still = (tell_figure(value) for value in (row.temporal_low, row.temporal_high, row.invariant_high))
    moved = tell_figure(row.invariant_high - row.invariant_low)
    return title, [
        Shown(f"{low}–{high}", "fails" if row.moves else "good"),
        Shown(f"{still} (moves by {moved})"),
        Shown(tell_figure(row.spectral), "fails" if row.explodes else "good"),
        Shown(row.worst_reducer or ABSENT),
        Shown(tell_figure(row.spectral_bounded)),
        Shown(tell_figure(row.spectral_energy_weighted)),
    ]
