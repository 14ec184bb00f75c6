"""The report's page: one self-contained HTML file that shows nothing but what ``results.json`` holds."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.report.section import Cell
from feel321.analysis.words import COUNT, keep_together, start, tell_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from markupsafe import Markup

    from feel321.analysis.report.folder import Results
    from feel321.analysis.report.section import Picture, Section
    from feel321.analysis.words import Line

TEMPLATES = Path(__file__).parent / "templates"


def render_page(results: Results, sections: Sequence[Section], *, figures: Path) -> str:
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
    environment.filters |= {"words": tell_name, "start": start}
    sizes = {
        number.name: Cell(number, COUNT)
        for number in results.numbers
        if number.name.startswith("size.")
    }
    drawings = {
        picture.name: inline_svg(picture, figures / f"{picture.name}.svg")
        for section in sections
        for picture in section.pictures
    }
    style = (TEMPLATES / "report.css").read_text(encoding="utf-8")
    return environment.get_template("report.html").render(
        results=results,
        sections=sections,
        answer=group_lines(sections),
        drawings=drawings,
        sizes=sizes,
        style=style,
    )


def group_lines(sections: Sequence[Section]) -> dict[str, list[Line]]:
    """Put together what opens the page about the same ratings."""
    lines = list(dict.fromkeys(line for section in sections for line in section.verdict))
    subjects = sorted(
        dict.fromkeys(line.subject for line in lines), key=lambda subject: not subject
    )
    return {subject: [line for line in lines if line.subject == subject] for subject in subjects}


def inline_svg(picture: Picture, path: Path) -> Markup:
    """Make a figure part of a page."""
    from markupsafe import Markup, escape

    text = path.read_text(encoding="utf-8")
    body = re.sub(r"<!--.*?-->", "", text[text.index("<svg") :], flags=re.DOTALL)
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{picture.name}-", body)
    body = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", body, count=1)
    body = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", body, count=1)
    label = f'<svg role="img" aria-label="{escape(picture.caption)}"'
    return Markup(body.strip().replace("<svg", label, 1))  # noqa: S704 - our own drawing, its caption escaped
