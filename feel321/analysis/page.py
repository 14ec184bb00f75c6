"""Pages and words: templates rendered, with style sheet, drawings and script inside one HTML file."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.figures import PAGE_COLOURS

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

Row = Mapping[str, float]
TEMPLATES = Path(__file__).parent / "templates"


def render_template(name: str, **values: object) -> str:
    """Render a page, which finds the style sheet as `style` and the filters of `FILTERS`."""
    style = (TEMPLATES / "page.css").read_text(encoding="utf-8")
    return _open_templates(escape=True).get_template(name).render(style=style, **values)


def render_words(name: str, macro: str = "lines", **facts: object) -> tuple[str, ...]:
    """Render the sentences of a section, ``templates/words/NAME.j2``: paragraphs, parted by empty lines.

    A line break and the spaces around it are a space; spaces before a point, comma or bracket are left out, so that a
    template may be laid out for reading.
    """
    template = _open_templates(escape=False).get_template(f"words/{name}.j2")
    text = str(getattr(template.module, macro)(**facts))
    paragraphs = (re.sub(r"[ \n\t]+", " ", part).strip() for part in re.split(r"\n[ \t]*\n", text))
    tidy = (re.sub(r" +(?=[,;.:)](?:\s|$|[,;.:)]))|(?<=\() +", "", part) for part in paragraphs)
    return tuple(str(words.keep_together(part)) for part in tidy if part)


@lru_cache(maxsize=2)
def _open_templates(*, escape: bool) -> Environment:
    """Open the templates, once for pages and once for words."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        autoescape=escape,  # noqa: S701 - words are escaped by the page that they stand on
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        finalize=words.keep_together if escape else None,
    )
    environment.filters |= FILTERS
    environment.tests["number"] = lambda value: isinstance(value, float) and math.isfinite(value)
    return environment


def _write_estimate(ends: Row, kind: str = "correlation", lead: str = "95 % CI ") -> str:
    """Write a value with its interval behind it, in brackets."""
    value, interval = words.format_estimate(ends["value"], ends["low"], ends["high"], kind=kind)
    return value if interval == words.ABSENT else f"{value} ({lead}{interval})"


FILTERS: Mapping[str, Any] = {
    "words": words.format_name,
    "start": words.capitalise,
    "list": list,
    "named": lambda names, last="and": words.join_words(
        [words.format_name(str(one)) for one in names], last
    ),
    "join_words": lambda names, last="and": words.join_words([str(one) for one in names], last),
    "some": lambda names, most=3: words.name_some([str(one) for one in names], most),
    "count": words.format_count,
    "num": lambda value, kind="correlation": words.format_number(float(value), kind=kind),
    "ends": lambda low, high, kind="correlation": words.format_interval(low, high, kind=kind),
    "estimate": _write_estimate,
    "p": words.format_p,
    "level": words.format_level,
    "percent": lambda share: f"{words.format_number(100 * share, kind='count')} %",
}
"""Filters of all templates: names and numbers as `feel321.analysis.words` writes them."""


UNWANTED = re.compile(
    r"^.*?(?=<svg)|<metadata>.*?</metadata>|<defs>\s*<style[^>]*>.*?</style>\s*</defs>", re.DOTALL
)
"""Of a drawing's file: its head, who made it, and a style sheet that would style the whole page."""


def inline_svg(name: str, caption: str, path: Path) -> Markup:
    """Make a figure's SVG file part of a page, in the page's colours; its ids begin with the figure's name."""
    from markupsafe import Markup, escape

    body = UNWANTED.sub("", path.read_text(encoding="utf-8"))
    body = re.sub(r'(\bid="|href="#|url\(#)', rf"\g<1>{name}-", body)
    body = re.sub(r"(\d+\.\d\d)\d+", r"\1", body)
    body = body.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    for size in ("width", "height"):
        body = re.sub(rf'(<svg[^>]*?) {size}="[^"]*"', r"\1", body, count=1)
    for colour, variable in PAGE_COLOURS.items():
        body = re.sub(rf"(?<=[:\" ]){colour}\b", f"var(--{variable})", body, flags=re.IGNORECASE)
    label = f'<svg role="img" aria-label="{escape(caption)}" fill="currentColor" stroke-linejoin="round"'
    return Markup(body.replace("<svg", label, 1))  # noqa: S704 - our own drawing, its caption escaped
