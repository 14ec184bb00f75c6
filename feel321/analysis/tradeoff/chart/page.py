"""The chart's page, with points to explore, and its files."""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.figures.style import save_figure
from feel321.analysis.report.folder import list_files, replace_report
from feel321.analysis.report.page import TEMPLATES, inline_svg
from feel321.analysis.report.section import Picture, make_slug, number_pictures
from feel321.analysis.table.sheet import tell_measure
from feel321.analysis.tradeoff.chart.axes import CUT, look_up, merge_equal
from feel321.analysis.tradeoff.chart.drawing import draw_cost, draw_latency, draw_rated
from feel321.analysis.tradeoff.chart.records import MEASURES
from feel321.analysis.words import keep_together, tell_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from feel321.analysis.tradeoff.chart.records import Chart

MARKS = (
    "A marker is the median over scenes of the mean over random sensor orientations, a small dot one scene, the "
    f"vertical line their span; what lies below {CUT:g} stands at the edge."
)
FRONT = (
    "The horizontal line is the quartiles of the cost. Dashed: the Pareto front; edged in black: what no other "
    "reducer clearly beats in both. Averaged over sensor orientations the three single axes are equal by "
    "construction: they are one point, sax/say/saz321, as are their matched and running forms."
)


def write_chart(chart: Chart, folder: Path | str) -> tuple[str, ...]:
    """Write a chart.

    Parameters
    ----------
    chart : Chart
        What was measured.
    folder : Path or str
        Where to. The files of a former chart, which its ``results.json`` lists, are replaced; all others stay.

    Returns
    -------
    tuple of str
        The files, relative to the folder: ``results.json``, ``index.html``, figures and tables.

    Raises
    ------
    OSError
        If a file cannot be written, or would replace one that is not of a former chart.
    """
    from feel321.analysis.tradeoff.chart.tables import tell_answers, write_tables

    target = Path(folder)
    rated = (
        _picture_rated(chart, *place)
        for place in dict.fromkeys((row.scale, row.level) for row in chart.rated)
    )
    pictures = tuple(number_pictures(chain(_list_pictures(chart), rated)))
    tables = write_tables(chart)
    files = list_files([picture.name for picture in pictures], tables)
    target.parent.mkdir(parents=True, exist_ok=True)
    # Everything is written beside its place first: an interrupted run leaves the former chart as it was.
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as name:
        place = Path(name)
        for part in ("tables", "figures"):
            (place / part).mkdir()
        for table, text in tables.items():
            _write(place / "tables" / f"{table}.csv", text)
        for picture in pictures:
            save_figure(picture.figure, place / "figures" / picture.name)
        captions = {picture.name: picture.caption for picture in pictures}
        _write(
            place / "results.json",
            chart.to_json(files=files, answers=tell_answers(chart), figures=captions),
        )
        _write(place / "index.html", render_page(chart, pictures, figures=place / "figures"))
        replace_report(place, target, files=files)
    return files


def render_page(chart: Chart, pictures: Sequence[Picture], *, figures: Path) -> str:
    """Render the page that a reader explores."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    from feel321.analysis.tradeoff.chart.explore import dump_data, list_choices
    from feel321.analysis.tradeoff.chart.tables import list_sheets, tell_answers

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=keep_together,
    )
    choices = list_choices(chart)
    return environment.get_template("chart.html").render(
        chart=chart,
        answers=tell_answers(chart),
        axes=[asdict(choice) for choice in choices],
        looks=look_up(merge_equal(chart)),
        pictures=pictures,
        drawings={
            picture.name: inline_svg(picture, figures / f"{picture.name}.svg")
            for picture in pictures
        },
        grids=list_sheets(chart),
        data=dump_data(chart, choices),
        style="".join(
            (TEMPLATES / name).read_text(encoding="utf-8") for name in ("report.css", "chart.css")
        ),
        script=(TEMPLATES / "chart.js").read_text(encoding="utf-8"),
    )


def _list_pictures(chart: Chart) -> Iterator[Picture]:
    from feel321.analysis.tradeoff.chart.drawing_cost import draw_blocks, draw_growth, draw_rates

    paper, bounded = MEASURES[:2], MEASURES[2:]
    yield Picture(
        "cost",
        f"Both of the paper's metrics against cost. {MARKS} {FRONT}",
        draw_cost(chart, paper),
    )
    yield Picture(
        "cost_invariant",
        f"Their bounded counterparts, which no orientation of the sensor changes, against cost. {MARKS} {FRONT}",
        draw_cost(chart, bounded),
    )  # fmt: skip
    yield Picture(
        "latency",
        "Both of the paper's metrics against algorithmic latency, windowed reducers with windows of 10 to 200 ms. A "
        f"vertical line spans the scenes; what lies below {CUT:g} stands at the edge. Markers stand aside of each "
        "other.",
        draw_latency(chart, paper),
    )  # fmt: skip
    yield Picture(
        "growth",
        "Time of one call (median, shaded: quartiles) and the most memory that it holds beside its input, against the "
        "length of the signal.",
        draw_growth(chart),
    )  # fmt: skip
    yield Picture(
        "blocks",
        "Cost of streaming against the samples per call (median, shaded: quartiles); reducers that need the whole "
        "signal cannot stream.",
        draw_blocks(chart),
    )  # fmt: skip
    yield Picture(
        "rates",
        "Both of the paper's metrics and speed against the sampling rate: medians over scenes of the means over "
        f"orientations; what lies below {CUT:g} stands at the edge.",
        draw_rates(chart, paper),
    )  # fmt: skip


def _picture_rated(chart: Chart, scale: str, level: str) -> Picture:
    caption = (
        f"Mean {tell_measure(scale)} (level {tell_name(level)}) against cost. Thick: 95 % t "
        "interval over participants, "
        "for these recordings; thin: 95 % bootstrap interval over participants and recordings."
    )
    return Picture(make_slug("rated", scale, level), caption, draw_rated(chart, scale, level))


def _write(path: Path, text: str) -> None:
    path.write_text(text, encoding="utf-8", newline="")
