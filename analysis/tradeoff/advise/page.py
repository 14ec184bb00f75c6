"""The page: what each scene needs, why, and the record behind the order."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.report.page import TEMPLATES, inline_svg
from analysis.report.pictures import Picture
from analysis.words import keep_together

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

CAPTION = (
    "Which reducers suffice for which scenes; reducers from the simplest on. Filled circle: the simplest sufficient "
    "one. Pale circle: sufficient too. Cross: not sufficient. Open diamond: the closest where none suffices. Dash: "
    "beyond the latency budget."
)


def render_page(content: Mapping[str, Any], drawing: Path) -> str:
    """Render the page.

    Parameters
    ----------
    content : Mapping
        What ``results.json`` holds.
    drawing : Path
        The figure's SVG file.

    Returns
    -------
    str
        HTML that needs neither network nor script.
    """
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from matplotlib.figure import Figure

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES), autoescape=True, undefined=StrictUndefined,
        trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True, finalize=keep_together,
    )  # fmt: skip
    style = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    picture = inline_svg(Picture("advice", "advice", CAPTION, Figure()), drawing)
    first = content["measures"][0]["scene"] if content["measures"] else None
    records = [row for row in content["measures"] if row["scene"] == first]
    return environment.get_template("advise.html").render(
        content=content, picture=picture, caption=CAPTION, records=records, style=style
    )
