"""Words and numbers of a report: names, units, digits, lists, and the record of a number.

One place formats names and numbers for a reader, so that text, tables and figures agree.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from feel321.types import MetricInfo

MINUS = "\N{MINUS SIGN}"
ABSENT = "\N{EN DASH}"
"""Written where a number is not defined."""

PLACES = {"correlation": 2, "slope": 2, "rating": 1, "df": 1, "count": 0, "p": 3}
"""Digits behind the point, per kind of number."""

SMALLEST_P = 0.001
"""Below this a probability is written as smaller."""

UNWIELDY = 1e6
"""From here on a number is written with its power of ten."""

TORN = re.compile("(?<=[0-9]) (?=%)|(?<=\\bp) (?=\\(Holm\\))| (?=<\N{NO-BREAK SPACE})")
"""Spaces at which no line may break."""

ABBREVIATED = re.compile(r"\b(?:mushra|abx)\b")
"""Names of scales that are abbreviations."""

PARTS = {"_w": " within recordings", "_b": " between recordings", None: ""}
"""Suffix of a metric's name in a model -> how it is written."""

_DECLARED: ContextVar[Mapping[str, MetricInfo]] = ContextVar(
    "declared", default=MappingProxyType({})
)
"""What the metrics of the report that is being written declare. Not an argument: names are put into words in some
eighty places, most of which take what they name from a table's cell, and a report is written as a whole."""

METRIC_AXES = {
    "spectral_match": "Spectral match (1 = identical energy)",
    "temporal_match": "Temporal match (1 = same waveform as all axes)",
    "spectral_match_bounded": "Bounded spectral match (1 = identical energy)",
}
"""Axis label of each metric; another metric is labelled by its name."""

MEASURES = {"dissimilarity": "dissimilarity from the reference", "abx": "percentage correct"}
"""Scales that do not rate a stimulus by itself -> what they measure."""

TWO_WAY = "95 % two-way bootstrap interval, over participants and recordings"
ONE_WAY = "95 % bootstrap interval over participants only: these stimuli as the only ones"
STUDENT = "95 % t interval over participants, for these recordings"
SATTERTHWAITE = "95 % t interval, Satterthwaite's degrees of freedom"
NONE = ""

COUNT = "count"

CONFIRMATORY, EXPLORATORY = "confirmatory", "exploratory"
"""Whether a result was declared before the ratings were seen, or not."""


def format_name(name: str) -> str:
    """Turn a column or scale name into words.

    Examples
    --------
    >>> format_name("equal_intensity"), format_name("spectral_match_bounded_delivered"), format_name("mushra")
    ('equal intensity', 'bounded spectral match delivered', 'MUSHRA')
    """
    plain = name.replace("spectral_match_bounded", "bounded_spectral_match").replace("_", " ")
    plain = ABBREVIATED.sub(lambda match: match[0].upper(), plain)
    info = _DECLARED.get().get(name)
    return plain if info is None or info.label == name else info.label


Made = TypeVar("Made")


@contextmanager
def declaring(info: Mapping[str, MetricInfo]) -> Iterator[None]:
    """Call metrics by the labels that they declare, while a report is written."""
    token = _DECLARED.set(info)
    try:
        yield
    finally:
        _DECLARED.reset(token)


def make_declaring(info: Mapping[str, MetricInfo], make: Callable[[], Made]) -> Made:
    """Make a figure, perhaps in another process, in which metrics are called by the labels that they declare."""
    with declaring(info):
        return make()


def keep_together(value: object) -> object:
    r"""Keep the percent sign with its number, and a small probability with its name, where a line may break.

    Examples
    --------
    >>> keep_together("95 % interval"), keep_together(95)
    ('95\xa0% interval', 95)
    """
    # A subclass of str is markup that was made elsewhere.
    return TORN.sub("\N{NO-BREAK SPACE}", value) if type(value) is str else value


def format_note(note: str, names: Iterable[str]) -> str:
    """Put the names that a note holds into words.

    Examples
    --------
    >>> format_note("realism, as_is: 'spectral_match' is the same everywhere.", ["as_is", "spectral_match"])
    'realism, as is: spectral match is the same everywhere.'
    >>> format_note("The spread of spectral_match_w is zero.", ["spectral_match"])
    'The spread of spectral match within recordings is zero.'
    """

    def put(match: re.Match[str]) -> str:
        _, name, part = match.groups()
        return format_name(name) + PARTS[part] if part or "_" in name else match[0]

    raw = "|".join(re.escape(name) for name in sorted(set(names), key=len, reverse=True))
    words = re.sub(rf"(?<![\w./])('?)({raw})(_[wb])?\1(?!\w)", put, note) if raw else note
    return words.replace("(Intercept)", "the intercept")


def format_ratings(subject: str) -> str:
    """Name ratings by their scale and level.

    Examples
    --------
    >>> format_ratings("realism"), format_ratings("realism (level as is)")
    ('realism ratings', 'realism ratings (level as is)')
    """
    name, bracket, level = subject.partition(" (level ")
    return f"{name} ratings{bracket}{level}"


def format_method(name: str) -> str:
    """Name a kind of correlation.

    Examples
    --------
    >>> format_method("spearman"), format_method("within"), format_method("within_kendall")
    ('Spearman', 'Pearson within recordings', 'Kendall within recordings')
    """
    kind = (name.removeprefix("within").strip("_") or "pearson").capitalize()
    return f"{kind} within recordings" if name.startswith("within") else kind


def capitalise(text: str) -> str:
    """Begin a sentence, leaving all but its first letter as it is."""
    return text[:1].upper() + text[1:]


def wrap_name(name: str, width: int, *, lines: int = 2) -> str:
    """Break a name into a few lines for a figure, where it must not run off.

    Examples
    --------
    >>> wrap_name("a rather long name of a reducer", 12).splitlines()
    ['a rather', 'long…educer']
    """
    found, half = textwrap.wrap(name, width), width // 2
    if len(found) > lines:
        found[lines - 1 :] = [f"{found[lines - 1][: half - 1].rstrip()}…{name[-half:].lstrip()}"]
    return "\n".join(found)


def format_measure(scale: str) -> str:
    """Say what the points of a scale measure.

    Examples
    --------
    >>> format_measure("realism"), format_measure("ABX")
    ('realism rating', 'percentage correct')
    """
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
    """Name a level behind a scale; nothing where there is only one, which is given as "".

    Examples
    --------
    >>> format_level("as_is"), format_level("")
    (' (level as is)', '')
    """
    return f" (level {format_name(level)})" if level else ""


def join_words(names: Sequence[str], last: str = "and") -> str:
    """List names in a sentence.

    Examples
    --------
    >>> join_words(["a"]), join_words(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def format_count(count: float, name: str) -> str:
    """Write how many of something there are.

    Examples
    --------
    >>> format_count(1, "participant"), format_count(3, "source")
    ('1 participant', '3 sources')
    """
    return f"{count:.0f} {name}{'s' * (count != 1)}"


def format_span(counts: Iterable[int]) -> str:
    """Write a count, or its range where it differs from case to case.

    Examples
    --------
    >>> format_span([6, 6]), format_span([6, 4, 5])
    ('6', '4–6')
    """
    found = sorted(set(counts))
    return f"{found[0]}" if len(found) == 1 else f"{found[0]}–{found[-1]}"


def format_number(value: float, *, kind: str = "correlation") -> str:
    """Write a number as the report shows it; a dash where it is not defined.

    Examples
    --------
    >>> format_number(-0.256), format_number(-0.001), format_number(71.26, kind="rating"), format_number(-1e200)
    ('−0.26', '0.00', '71.3', '−1.0e+200')
    """
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
    """Write an interval as the report shows it; a dash where it is not defined.

    Examples
    --------
    >>> format_interval(-0.1, 0.734)
    '−0.10 to 0.73'
    """
    if not math.isfinite(low + high):
        return ABSENT
    return f"{format_number(low, kind=kind)} to {format_number(high, kind=kind)}"


def format_estimate(
    value: float, low: float, high: float, *, kind: str = "correlation"
) -> tuple[str, str]:
    """Write an estimate and its interval as the report shows them, both in powers of ten where all would read 0.

    Examples
    --------
    >>> format_estimate(0.3, 0.1, 0.5), format_estimate(2e-4, -1e-3, 2e-3)
    (('0.30', '0.10 to 0.50'), ('2.0e−04', '−1.0e−03 to 2.0e−03'))
    """
    ends, nothing = (value, low, high), format_number(0.0, kind=kind)
    if any(ends) and all(format_number(one, kind=kind) == nothing for one in ends):
        # Of a metric that runs over hundreds, +0.1 is next to nothing, and yet not 0.
        return _write_power(value), f"{_write_power(low)} to {_write_power(high)}"
    return format_number(value, kind=kind), format_interval(low, high, kind=kind)


@dataclass(frozen=True, slots=True)
class Number:
    """A number of a report, by its dotted path; NaN where it or an end of its interval is not defined.

    uncertainty: kind of interval; n: how many stimuli, participants or judgements the value rests on. statistic: what
    of its family it is; keys: what it is of (scale, level, metric, reducer, ...), in the order of the path.
    """

    name: str
    value: float
    low: float
    high: float
    uncertainty: str
    method: str
    n: int
    statistic: str
    keys: tuple[tuple[str, str], ...] = ()
    status: str = EXPLORATORY

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds of it: addressable without taking its name apart; NaN as None."""
        keys, family = dict(self.keys), self.name.split(".")[0]
        told = {name: keys.pop(name, None) for name in TIDY}
        numbers = {name: getattr(self, name) for name in ("value", "low", "high")}
        return {
            "name": self.name, "family": family, **told, "statistic": self.statistic, "keys": keys,
            **{name: None if math.isnan(value) else value for name, value in numbers.items()},
            "uncertainty": self.uncertainty, "method": self.method, "n": self.n, "status": self.status,
        }  # fmt: skip


TIDY = ("scale", "level", "metric")
"""Keys of numbers that have a field of their own in ``results.json``; null for a number that is not of one."""


def name_path(*parts: str) -> str:
    """Join names to the dotted path of a number.

    Examples
    --------
    >>> name_path("profile", "v1.0", "as_is")
    'profile.v1%2E0.as_is'
    """
    return ".".join(part.replace("%", "%25").replace(".", "%2E") for part in parts)


def make_number(name: str, value: float, method: str, *, n: int, keys: str = "") -> Number:
    """Name a number that has no interval; an infinite one counts as not defined.

    keys: what the parts of the name after its family are, such as "scale level"; the rest of it is the statistic.
    """
    known = float(value) if math.isfinite(value) else math.nan
    parts = [part.replace("%2E", ".").replace("%25", "%") for part in name.split(".")[1:]]
    own = tuple(zip(keys.split(), parts, strict=False))
    statistic = ".".join(parts[len(own) :]) or "value"
    return Number(name, known, math.nan, math.nan, NONE, method, int(n), statistic, own)


def make_interval(number: Number, low: float, high: float, *, uncertainty: str) -> Number:
    """Give a number its interval."""
    if not math.isfinite(low + high):
        return number
    return replace(number, low=float(low), high=float(high), uncertainty=uncertainty)


def count_number(name: str, value: int, *, n: int, keys: str = "") -> Number:
    """Name a count."""
    return replace(make_number(name, value, COUNT, n=n, keys=keys), value=int(value))


@dataclass(frozen=True, slots=True)
class Line:
    """One of the lines that open a report; clause: what the first sentence says of it, where no card does."""

    text: str
    subject: str = ""
    lead: str = ""
    clause: str = ""

    def __str__(self) -> str:
        """Write it as a sentence of its own."""
        about = ", ".join(filter(None, (self.subject, self.lead)))
        return f"{about}: {self.text}" if about else self.text


@dataclass(frozen=True, slots=True)
class Claim:
    """The conclusion about one metric, for a program to read.

    few: units, such as "4 reducers", of which there are so few that a finding is a hint, or that a slope is not
    estimable. reason: why it is not confirmatory.
    """

    scale: str
    level: str
    metric: str
    verdict: str
    direction: str
    number: str
    hinges_on: tuple[str, ...] = ()
    better_than: tuple[str, ...] = ()
    higher: str = "better"
    hinge: str = ""
    few: tuple[str, ...] = ()
    status: str = EXPLORATORY
    reason: str = ""
    beyond_level: str = ""
