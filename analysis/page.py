"""The report's page: one self-contained HTML file that shows nothing but what ``results.json`` holds."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from analysis.results import name_path
from analysis.table import ROLES, order_reducers
from analysis.words import tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from markupsafe import Markup
    from pandas import DataFrame

    from analysis.findings import Findings
    from analysis.pictures import Picture
    from analysis.results import Number, Results

TEMPLATES = Path(__file__).parent / "templates"


def render_page(results: Results, findings: Findings, *, pictures: Sequence[Picture], figures: Path) -> str:
    """Render the page.

    Parameters
    ----------
    results : Results
        Every number and sentence that may be shown.
    findings : Findings
        Which rows the tables have; their numbers are looked up in `results`.
    pictures : sequence of Picture
        The figures and their captions.
    figures : Path
        Folder that holds the SVG file of each.

    Returns
    -------
    str
        HTML that needs neither network nor script.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True,
    )  # fmt: skip
    environment.filters["words"] = tell_name
    environment.filters["path"] = lambda parts: name_path(*parts)
    cells = _Cells({number.name: number for number in results.numbers})
    drawings = [(picture, inline_svg(picture, figures / f"{picture.name}.svg")) for picture in pictures]
    style = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html").render(
        results=results, findings=findings, profile=sort_profile(findings.profile),
        drawings=drawings, cells=cells, style=style, differ=any(panel.differences for panel in findings.panels),
    )  # fmt: skip


def inline_svg(picture: Picture, path: Path) -> Markup:
    """Make a figure part of a page.

    Parameters
    ----------
    picture : Picture
        Its name, which leads its ids, and its caption.
    path : Path
        The SVG file; it may use the same ids as others.

    Returns
    -------
    Markup
        The drawing without prolog, comments and fixed size, with ids of its own and its caption as alternative text.
    """
    from markupsafe import Markup, escape

    text = path.read_text(encoding="utf-8")
    body = re.sub(r"<!--.*?-->", "", text[text.index("<svg") :], flags=re.DOTALL)
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{picture.name}-", body)
    body = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", body, count=1)
    body = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", body, count=1)
    label = f'<svg role="img" aria-label="{escape(picture.caption)}"'
    return Markup(body.strip().replace("<svg", label, 1))  # noqa: S704 - our own drawing, its caption escaped


def sort_profile(profile: DataFrame) -> list[dict[Hashable, Any]]:
    """Put the rows of a profile into the figure's order.

    Parameters
    ----------
    profile : DataFrame
        What `profile_reducers` returns.

    Returns
    -------
    list of dict
        Per scale and level: tests, reference, anchors; reducers in the order of `REDUCERS`.
    """
    order = order_reducers(profile["reducer"])

    def place(row: dict[Hashable, Any]) -> tuple[str, str, int, int]:
        return row["scale"], row["level"], ROLES.index(row["role"]), order.index(row["reducer"])

    return sorted(profile.to_dict("records"), key=place)


@dataclass(frozen=True, slots=True)
class _Cells:
    """Numbers by name, written for a table's cell."""

    numbers: Mapping[str, Number]

    def value(self, name: str, kind: str) -> str:
        """Write the value."""
        return tell_number(self.numbers[name].value, kind=kind)

    def interval(self, name: str, kind: str) -> str:
        """Write the interval."""
        number = self.numbers[name]
        return tell_range(number.low, number.high, kind=kind)
