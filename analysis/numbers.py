"""A number of a report, with its name, uncertainty, method and n."""

from __future__ import annotations

import math
from dataclasses import dataclass

TWO_WAY = "95 % two-way bootstrap interval, over participants and recordings"
ONE_WAY = "95 % bootstrap interval over participants only: these stimuli as the only ones"
STUDENT = "95 % t interval over participants, for these recordings"
SATTERTHWAITE = "95 % t interval, Satterthwaite's degrees of freedom"
NONE = ""

COUNT = "count"


@dataclass(frozen=True, slots=True)
class Number:
    """A number and all that is needed to judge it.

    Parameters
    ----------
    name : str
        Dotted path, unique in a report.
    value : float
        The number; NaN where it is not defined.
    low, high : float
        Ends of the interval; NaN where there is none.
    uncertainty : str
        What kind of interval that is; empty where there is none.
    method : str
        How the value was computed.
    n : int
        How many stimuli, participants or judgements the value rests on.
    """

    name: str
    value: float
    low: float
    high: float
    uncertainty: str
    method: str
    n: int


def name_path(*parts: str) -> str:
    """Join names to the dotted path of a number.

    Parameters
    ----------
    *parts : str
        Names, some of them chosen by users.

    Returns
    -------
    str
        The path; a dot in a name is written ``%2E``, so that no two lists of names give the same path.

    Examples
    --------
    >>> name_path("profile", "v1.0", "as_is")
    'profile.v1%2E0.as_is'
    """
    return ".".join(part.replace("%", "%25").replace(".", "%2E") for part in parts)


def make_number(name: str, value: float, method: str, *, n: int) -> Number:
    """Name a number that has no interval.

    Parameters
    ----------
    name : str
        Its path.
    value : float
        The number.
    method : str
        How it was computed.
    n : int
        What it rests on.

    Returns
    -------
    Number
        Without an interval; infinite values count as not defined.
    """
    known = float(value) if math.isfinite(value) else math.nan
    return Number(name, known, math.nan, math.nan, NONE, method, int(n))


def make_interval(number: Number, low: float, high: float, *, uncertainty: str) -> Number:
    """Give a number its interval.

    Parameters
    ----------
    number : Number
        Without one.
    low, high : float
        Its ends; a single one that is not finite leaves the number without.
    uncertainty : str
        What kind it is.

    Returns
    -------
    Number
        The same number with the interval.
    """
    if not math.isfinite(low + high):
        return number
    return Number(number.name, number.value, float(low), float(high), uncertainty, number.method, number.n)


def count_number(name: str, value: int, *, n: int) -> Number:
    """Name a count.

    Parameters
    ----------
    name : str
        Its path.
    value : int
        How many.
    n : int
        Of how many.

    Returns
    -------
    Number
        Without an interval.
    """
    return Number(name, int(value), math.nan, math.nan, NONE, COUNT, int(n))
