"""How names and numbers are told to a reader: one place, so that text, tables and figures agree."""

from __future__ import annotations

import math
import re
import textwrap
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MINUS = "\N{MINUS SIGN}"
ABSENT = "\N{EN DASH}"
"""What stands where a number is not defined."""

PLACES = {"correlation": 2, "slope": 2, "rating": 1, "df": 1, "count": 0, "p": 3}
"""Digits behind the point, per kind of number."""

SMALLEST_P = 0.001
"""Below this a probability is told as smaller."""

UNWIELDY = 1e6
"""From here on a number is told by its power of ten."""

TORN = re.compile("(?<=[0-9]) (?=%)|(?<=\\bp) (?=\\(Holm\\))| (?=<\N{NO-BREAK SPACE})")
"""Spaces at which no line may break."""

PARTS = {"_w": " within recordings", "_b": " between recordings", None: ""}
"""What a term of a model adds to a metric's name -> how it is told."""

METRIC_AXES = {
    "spectral_match": "Spectral match (1 = identical energy)",
    "temporal_match": "Temporal match (1 = same waveform as all axes)",
    "spectral_match_bounded": "Bounded spectral match (1 = identical energy)",
}
"""Axis label of each metric; another metric is labelled by its name."""


def tell_name(name: str) -> str:
    """Turn a column or scale name into words.

    Parameters
    ----------
    name : str
        Such as ``spectral_match``.

    Returns
    -------
    str
        Such as ``spectral match``.

    Examples
    --------
    >>> tell_name("equal_intensity"), tell_name("spectral_match_bounded_delivered")
    ('equal intensity', 'bounded spectral match delivered')
    """
    return name.replace("spectral_match_bounded", "bounded_spectral_match").replace("_", " ")


def keep_together(value: object) -> object:
    r"""Keep the percent sign with its number, and a small probability with its name, where a line may break.

    Parameters
    ----------
    value : object
        What a page is to show; only text is changed.

    Returns
    -------
    object
        The same, with no-break spaces there.

    Examples
    --------
    >>> keep_together("95 % interval"), keep_together(95)
    ('95\xa0% interval', 95)
    """
    # A subclass of str is markup that was made elsewhere.
    return TORN.sub("\N{NO-BREAK SPACE}", value) if type(value) is str else value


def tell_note(note: str, names: Iterable[str]) -> str:
    """Put the names that a note holds into words.

    Parameters
    ----------
    note : str
        A sentence.
    names : iterable of str
        Scales, levels, metrics or whatever else may stand in it, in quotation marks or not.

    Returns
    -------
    str
        The sentence without their underscores and quotation marks, and with a model's terms in words.

    Examples
    --------
    >>> tell_note("realism, as_is: 'spectral_match' is the same everywhere.", ["as_is", "spectral_match"])
    'realism, as is: spectral match is the same everywhere.'
    >>> tell_note("The spread of spectral_match_w is zero.", ["spectral_match"])
    'The spread of spectral match within recordings is zero.'
    """
    raw = "|".join(re.escape(name) for name in sorted(set(names), key=len, reverse=True))
    told = re.sub(rf"(?<![\w./])('?)({raw})(_[wb])?\1(?!\w)", _tell_found, note) if raw else note
    return told.replace("(Intercept)", "the intercept")


def _tell_found(match: re.Match[str]) -> str:
    _, name, part = match.groups()
    return tell_name(name) + PARTS[part] if part or "_" in name else match[0]


def tell_ratings(subject: str) -> str:
    """Call ratings by their scale and level.

    Parameters
    ----------
    subject : str
        The scale, and the level in brackets where there are several.

    Returns
    -------
    str
        The same with the word after the scale.

    Examples
    --------
    >>> tell_ratings("realism"), tell_ratings("realism (level as is)")
    ('realism ratings', 'realism ratings (level as is)')
    """
    name, bracket, level = subject.partition(" (level ")
    return f"{name} ratings{bracket}{level}"


def tell_method(name: str) -> str:
    """Name a kind of correlation.

    Parameters
    ----------
    name : str
        A name of `analysis.resampling.bootstrap.METHODS`.

    Returns
    -------
    str
        After whom it is named, and whether it is within recordings.

    Examples
    --------
    >>> tell_method("spearman"), tell_method("within"), tell_method("within_kendall")
    ('Spearman', 'Pearson within recordings', 'Kendall within recordings')
    """
    kind = (name.removeprefix("within").strip("_") or "pearson").capitalize()
    return f"{kind} within recordings" if name.startswith("within") else kind


def start(text: str) -> str:
    """Begin a sentence.

    Parameters
    ----------
    text : str
        Its words.

    Returns
    -------
    str
        The first letter large.

    Examples
    --------
    >>> start("realism ratings")
    'Realism ratings'
    """
    return text[:1].upper() + text[1:]


def wrap_name(name: str, width: int, *, lines: int = 2) -> str:
    """Break a name into lines for a figure, where it must not run off.

    Parameters
    ----------
    name : str
        Any text.
    width : int
        Letters per line.
    lines : int
        How many lines at most; what does not fit is cut out of the last, whose end stays: it tells names apart.

    Returns
    -------
    str
        Lines parted by a line break; an ellipsis stands for what was cut.

    Examples
    --------
    >>> wrap_name("a rather long name of a reducer", 12).splitlines()
    ['a rather', 'long…educer']
    """
    found, half = textwrap.wrap(name, width), width // 2
    if len(found) > lines:
        found[lines - 1 :] = [f"{found[lines - 1][: half - 1].rstrip()}…{name[-half:].lstrip()}"]
    return "\n".join(found)


def tell_axis(metric: str) -> str:
    """Label an axis by its metric.

    Parameters
    ----------
    metric : str
        Name of the metric.

    Returns
    -------
    str
        Its name and what 1 means.
    """
    words = tell_name(metric)
    return METRIC_AXES.get(metric, words[:1].upper() + words[1:])


def list_words(names: Sequence[str], last: str = "and") -> str:
    """List names in a sentence.

    Parameters
    ----------
    names : sequence of str
        One or more.
    last : str
        What joins the last one.

    Returns
    -------
    str
        The names.

    Examples
    --------
    >>> list_words(["a"]), list_words(["a", "b", "c"])
    ('a', 'a, b and c')
    """
    return f" {last} ".join(filter(None, (", ".join(names[:-1]), names[-1])))


def tell_span(counts: Iterable[int]) -> str:
    """Write how many there are where that differs from case to case.

    Parameters
    ----------
    counts : iterable of int
        At least one.

    Returns
    -------
    str
        The number, or the smallest and the largest.

    Examples
    --------
    >>> tell_span([6, 6]), tell_span([6, 4, 5])
    ('6', '4–6')
    """
    found = sorted(set(counts))
    return f"{found[0]}" if len(found) == 1 else f"{found[0]}–{found[-1]}"


def tell_number(value: float, *, kind: str = "correlation") -> str:
    """Write a number as the report shows it.

    Parameters
    ----------
    value : float
        The number; NaN gives a dash.
    kind : str
        A name of `PLACES`.

    Returns
    -------
    str
        With a real minus sign, and none before a zero.

    Examples
    --------
    >>> tell_number(-0.256), tell_number(-0.001), tell_number(71.26, kind="rating"), tell_number(-1e200)
    ('−0.26', '0.00', '71.3', '−1.0e+200')
    """
    if not math.isfinite(value):
        return ABSENT
    places = PLACES[kind]
    if kind == "p" and value < SMALLEST_P:
        return f"<\N{NO-BREAK SPACE}{SMALLEST_P}"
    if kind != "count" and abs(value) >= UNWIELDY:
        return f"{value:.1e}".replace("-", MINUS)
    text = f"{round(value, places) + 0.0:.{places}f}"
    return text.replace("-", MINUS)


def tell_range(low: float, high: float, *, kind: str = "correlation") -> str:
    """Write an interval as the report shows it.

    Parameters
    ----------
    low, high : float
        Its ends; NaN gives a dash.
    kind : str
        A name of `PLACES`.

    Returns
    -------
    str
        Low to high, in words.

    Examples
    --------
    >>> tell_range(-0.1, 0.734)
    '−0.10 to 0.73'
    """
    if not math.isfinite(low + high):
        return ABSENT
    return f"{tell_number(low, kind=kind)} to {tell_number(high, kind=kind)}"


def tell_ends(value: float, low: float, high: float, *, kind: str = "correlation") -> tuple[str, str]:
    """Write an estimate and its interval as the report shows them, both in powers of ten where all would read 0.

    Parameters
    ----------
    value, low, high : float
        The estimate and the ends of its interval; NaN gives a dash.
    kind : str
        A name of `PLACES`.

    Returns
    -------
    tuple of two str
        The estimate; and low to high, in words.

    Examples
    --------
    >>> tell_ends(0.3, 0.1, 0.5), tell_ends(2e-4, -1e-3, 2e-3)
    (('0.30', '0.10 to 0.50'), ('2.0e−04', '−1.0e−03 to 2.0e−03'))
    """
    ends, nothing = (value, low, high), tell_number(0.0, kind=kind)
    if any(ends) and all(tell_number(one, kind=kind) == nothing for one in ends):
        # Of a metric that runs over hundreds, +0.1 is next to nothing, and yet not 0.
        told, *limits = (f"{one:.1e}".replace("-", MINUS) for one in ends)
        return told, " to ".join(limits)
    return tell_number(value, kind=kind), tell_range(low, high, kind=kind)
