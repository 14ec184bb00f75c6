"""Pages: HTML in one file, from a template, with style sheet, drawings and script inside."""

from __future__ import annotations

import json
import re
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.figures.style import PAGE_COLOURS
from feel321.analysis.words import capitalise, format_name, keep_together

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jinja2 import Environment
    from markupsafe import Markup

TEMPLATES = Path(__file__).parent / "templates"


def render_template(name: str, *, styles: Sequence[str] = (), **values: object) -> str:
    """Render a template, which finds the style sheets as `style` and the filters `words` and `start`."""
    style = "".join(
        (TEMPLATES / sheet).read_text(encoding="utf-8") for sheet in ("page.css", *styles)
    )
    return _open_templates().get_template(name).render(style=style, **values)


@lru_cache(maxsize=1)
def _open_templates() -> Environment:
    """Open the templates, once."""
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
    environment.filters |= {"words": format_name, "start": capitalise}
    return environment


def write_script_data(value: object) -> Markup:
    r"""Write JSON to stand in a script element, which no text in it can end or leave open.

    Examples
    --------
    >>> print(write_script_data(["<!--<script"]))
    ["\u003c!--\u003cscript"]
    """
    from markupsafe import Markup

    text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    return Markup(text.replace("<", "\\u003c"))  # noqa: S704 - no < is left in it


def inline_svg(name: str, caption: str, path: Path) -> Markup:
    """Make a figure's SVG file part of a page, in the page's colours; its ids begin with the figure's name."""
    from markupsafe import Markup, escape

    body = path.read_text(encoding="utf-8")
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", body)
    for size in ("width", "height"):
        body = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", body, count=1)
    for colour, variable in PAGE_COLOURS.items():
        body = re.sub(rf"(?<=[:\"]){colour}\b", f"var(--{variable})", body, flags=re.IGNORECASE)
    body = body.replace(' target="_blank"', "")  # links lead down the page, not to another one
    label = f'<svg role="img" aria-label="{escape(caption)}" fill="currentColor"'
    return Markup(body.replace("<svg", label, 1))  # noqa: S704 - our own drawing, its caption escaped
