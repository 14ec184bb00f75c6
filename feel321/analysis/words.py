"""How names and numbers are written, so that text, tables and figures agree; sentences are in the templates.

Templates are rendered here too, with style sheet, drawings and script inside one HTML file.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from feel321.types import MetricInfo

if TYPE_CHECKING:
    from jinja2 import Environment

TEMPLATES = Path(__file__).parent / "templates"
MINUS = "\N{MINUS SIGN}"
ABSENT = "\N{EN DASH}"  # Written where a number is not defined
# Digits behind the point, per kind of number.
PLACES = {"correlation": 2, "slope": 2, "rating": 1, "df": 1, "count": 0, "p": 3}
# Below this a probability is written as smaller; from here on a number is written with its power of ten.
SMALLEST_P, UNWIELDY = 0.001, 1e6
# Spaces at which no line may break: of a percent sign, and of a small probability with its name.
TORN = re.compile("(?<=[0-9]) (?=%)|(?<=\\bp) (?=\\(Holm\\))| (?=<\N{NO-BREAK SPACE})")
ABBREVIATED = re.compile(r"\b(?:mushra|abx)\b")  # Names of scales that are abbreviations
# Suffix of a metric's name in a model -> how it is written.
PARTS = {"_w": " within recordings", "_b": " between recordings", None: ""}
# What the metrics of the report that is being written declare: names are put into words in many places, most of which
# take them from a table's cell, and a report is written as a whole.
_DECLARED = ContextVar[Mapping[str, MetricInfo]]("declared", default=MappingProxyType({}))
# Axis label of each metric; another metric is labelled by its name.
METRIC_AXES = {
    "spectral_match": "Spectral match (1 = identical energy)",
    "temporal_match": "Temporal match (1 = same waveform as all axes)",
    "spectral_match_bounded": "Bounded spectral match (1 = identical energy)",
}
# Scales that do not rate a stimulus by itself -> what they measure.
MEASURES = {"dissimilarity": "dissimilarity from the reference", "abx": "percentage correct"}
# Kinds of intervals, and how they are described.
INTERVALS: Mapping[str, str] = MappingProxyType({
    "two-way": "95 % two-way bootstrap interval, over participants and recordings",
    "people": "95 % bootstrap interval over participants only: these stimuli as the only ones",
    "student": "95 % t interval over participants, for these recordings",
    "satterthwaite": "95 % t interval, Satterthwaite's degrees of freedom",
})
CONFIRMATORY, EXPLORATORY = "confirmatory", "exploratory"  # Declared before the ratings, or not


@contextmanager
def declaring(info: Mapping[str, MetricInfo]) -> Iterator[None]:
    """Call metrics by the labels that they declare, while a report is written."""
    token = _DECLARED.set(info)
    try:
        yield
    finally:
        _DECLARED.reset(token)


def format_name(name: str) -> str:
    """Turn a column or scale name into words."""
    plain = name.replace("spectral_match_bounded", "bounded_spectral_match").replace("_", " ")
    plain = ABBREVIATED.sub(lambda match: match[0].upper(), plain)
    info = _DECLARED.get().get(name)
    return plain if info is None or info.label == name else info.label


def format_note(note: str, names: Iterable[str]) -> str:
    """Put the names that a note holds into words."""

    def put(match: re.Match[str]) -> str:
        _, name, part = match.groups()
        return format_name(name) + PARTS[part] if part or "_" in name else match[0]

    raw = "|".join(re.escape(name) for name in sorted(set(names), key=len, reverse=True))
    words = re.sub(rf"(?<![\w./])('?)({raw})(_[wb])?\1(?!\w)", put, note) if raw else note
    return words.replace("(Intercept)", "the intercept")


def format_method(name: str) -> str:
    """Name a kind of correlation."""
    kind = (name.removeprefix("within").strip("_") or "pearson").capitalize()
    return f"{kind} within recordings" if name.startswith("within") else kind


def format_measure(scale: str) -> str:
    """Say what the points of a scale measure."""
    return MEASURES.get(scale.casefold(), f"{format_name(scale)} rating")


def format_axis(metric: str) -> str:
    """Label an axis by its metric, with its unit, and where lower is better."""
    if metric in METRIC_AXES:
        return METRIC_AXES[metric]
    info, name = _DECLARED.get().get(metric), capitalise(format_name(metric))
    if info is None:
        return name
    more = ", ".join(filter(None, (info.unit, "lower is better" * (info.higher == "worse"))))
    return f"{name} ({more})" if more else name


def format_level(level: str) -> str:
    """Name a level behind a scale; nothing where there is only one, which is given as ""."""
    return f" (level {format_name(level)})" if level else ""


def capitalise(text: str) -> str:
    """Begin a sentence, leaving all but its first letter as it is."""
    return text[:1].upper() + text[1:]


def keep_together(value: object) -> object:
    """Let no line break at the spaces of `TORN`; markup, a subclass of str, was made elsewhere."""
    return TORN.sub("\N{NO-BREAK SPACE}", value) if type(value) is str else value


def join_words(names: Sequence[str], last: str = "and") -> str:
    """List names in a sentence: a, b and c."""
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def name_some(names: Sequence[str], most: int = 3) -> str:
    """List the first names, and count the others: a, b, c and 2 more."""
    more = len(names) - most
    return f"{', '.join(names[:most])} and {more} more" if more > 0 else join_words(names)


def format_count(count: float, name: str) -> str:
    """Write how many of something there are: 1 participant, 3 sources."""
    return f"{count:.0f} {name}{'s' * (count != 1)}"


def format_span(counts: Iterable[int]) -> str:
    """Write a count, or its range where it differs from case to case."""
    found = sorted(set(counts))
    return f"{found[0]}" if len(found) == 1 else f"{found[0]}–{found[-1]}"


def format_number(value: float, *, kind: str = "correlation") -> str:
    """Write a number as the report shows it; a dash where it is not defined."""
    if not math.isfinite(value):
        return ABSENT
    if kind == "p" and value < SMALLEST_P:
        return f"<\N{NO-BREAK SPACE}{SMALLEST_P}"
    if kind != "count" and abs(value) >= UNWIELDY:
        return _write_power(value)
    places = PLACES[kind]
    return f"{round(value, places) + 0.0:.{places}f}".replace("-", MINUS)


def _write_power(value: float) -> str:
    return f"{value:.1e}".replace("-", MINUS)


def format_interval(low: float, high: float, *, kind: str = "correlation") -> str:
    """Write an interval as the report shows it; a dash where it is not defined."""
    if not math.isfinite(low + high):
        return ABSENT
    return f"{format_number(low, kind=kind)} to {format_number(high, kind=kind)}"


def format_estimate(
    value: float, low: float, high: float, *, kind: str = "correlation"
) -> tuple[str, str]:
    """Write an estimate and its interval as the report shows them, both in powers of ten where all would read 0."""
    ends, nothing = (value, low, high), format_number(0.0, kind=kind)
    if any(ends) and all(format_number(one, kind=kind) == nothing for one in ends):
        # Of a metric that runs over hundreds, +0.1 is next to nothing, and yet not 0.
        return _write_power(value), f"{_write_power(low)} to {_write_power(high)}"
    return format_number(value, kind=kind), format_interval(low, high, kind=kind)


def format_p(p: float) -> str:
    """Write a probability behind its name."""
    told = format_number(p, kind="p")
    return f"p {told if told.startswith('<') else f'= {told}'}"


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
    return tuple(str(keep_together(part)) for part in tidy if part)


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
        finalize=keep_together if escape else None,
    )
    environment.filters |= FILTERS
    environment.tests["number"] = lambda value: isinstance(value, float) and math.isfinite(value)
    return environment


def _write_estimate(
    ends: Mapping[str, float], kind: str = "correlation", lead: str = "95 % CI "
) -> str:
    """Write a value with its interval behind it, in brackets."""
    value, interval = format_estimate(ends["value"], ends["low"], ends["high"], kind=kind)
    return value if interval == ABSENT else f"{value} ({lead}{interval})"


# Filters of all templates: names and numbers as `feel321.analysis.words` writes them
FILTERS: Mapping[str, Any] = {
    "words": format_name,
    "start": capitalise,
    "list": list,
    "named": lambda names, last="and": join_words([format_name(str(one)) for one in names], last),
    "join_words": lambda names, last="and": join_words([str(one) for one in names], last),
    "some": lambda names, most=3: name_some([str(one) for one in names], most),
    "count": format_count,
    "num": lambda value, kind="correlation": format_number(float(value), kind=kind),
    "ends": lambda low, high, kind="correlation": format_interval(low, high, kind=kind),
    "estimate": _write_estimate,
    "p": format_p,
    "level": format_level,
    "percent": lambda share: f"{format_number(100 * share, kind='count')} %",
}
