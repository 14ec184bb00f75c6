"""Estimates of mixed models as numbers and cells, the same in every section."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.numbers import SATTERTHWAITE, make_interval, make_number
from analysis.primary.model import FEW, fit_primary
from analysis.report.sections.section import INTERVAL, Cell
from analysis.table.sources import find_sources
from analysis.words import tell_ends, tell_number

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping, Sequence

    from pandas import DataFrame

    from analysis.numbers import Number
    from analysis.primary.model import Primary

SIGNIFICANCE = 0.05


def fit_rest(rows: DataFrame, metrics: Sequence[str], *, people: int) -> Primary:
    """Fit the primary model to the raters whom a rule leaves.

    Parameters
    ----------
    rows : DataFrame
        As for `fit_primary`, of those who are left.
    metrics : sequence of str
        One or more.
    people : int
        How many there were before.

    Returns
    -------
    Primary
        The model, without what would settle it.

    Raises
    ------
    ValueError
        If one of several raters is left, or there is no model for them.
    """
    left = rows["participant"].nunique()
    if left == 1 < people:
        raise ValueError(f"One rater of {people} is left: an interval would not know how people differ.")
    return fit_primary(rows, metrics, explain=False)


def name_estimate(name: str, row: Mapping[Hashable, Any], method: str, *, n: int, prefix: str = "") -> Number:
    """Name an estimate with its t interval.

    Parameters
    ----------
    name : str
        Its path.
    row : Mapping
        The estimate under `prefix` (or ``estimate``), and its ends.
    method : str
        How it was computed.
    n : int
        Rows that the model rests on.
    prefix : str
        Of another unit's columns, such as ``tenth``.

    Returns
    -------
    Number
        With the interval.
    """
    lead = f"{prefix}_" if prefix else ""
    number = make_number(name, row[prefix or "estimate"], method, n=n)
    return make_interval(number, row[f"{lead}low"], row[f"{lead}high"], uncertainty=SATTERTHWAITE)


def name_tests(name: str, row: Mapping[Hashable, Any], *, n: int) -> tuple[Number, ...]:
    """Name the degrees of freedom and the probabilities of an estimate.

    Parameters
    ----------
    name : str
        Path of the estimate.
    row : Mapping
        df, p, and p_holm.
    n : int
        Rows that the model rests on.

    Returns
    -------
    tuple of Number
        df, p, p_holm.
    """
    return (
        make_number(f"{name}.df", row["df"], "Satterthwaite's degrees of freedom", n=n),
        make_number(f"{name}.p", row["p"], "two-sided t test", n=n),
        make_number(f"{name}.p_holm", row["p_holm"], "two-sided t test, Holm's adjustment over its table", n=n),
    )


def lay_estimate(number: Number, kind: str) -> tuple[Cell, Cell]:
    """Lay an estimate and its interval out.

    Parameters
    ----------
    number : Number
        The estimate.
    kind : str
        A name of `analysis.words.PLACES`.

    Returns
    -------
    tuple of Cell
        Value and interval.
    """
    return Cell(number, kind), Cell(number, kind, INTERVAL)


def tell_estimate(number: Number, *, kind: str) -> str:
    """Tell an estimate and its interval in words.

    Parameters
    ----------
    number : Number
        The estimate.
    kind : str
        A name of `analysis.words.PLACES`.

    Returns
    -------
    str
        Such as ``1.83 points, 95 % interval 1.75 to 1.92``.
    """
    value, interval = tell_ends(number.value, number.low, number.high, kind=kind)
    return f"{value} points, 95 % interval {interval}"


def tell_reach(sizes: Mapping[str, int], *, claimed: bool = True) -> str:
    """Say what a claim does not reach, or hardly.

    Parameters
    ----------
    sizes : Mapping of str to int
        What was drawn -> how many.
    claimed : bool
        Whether anything is claimed; if not, there is no hint to weaken.

    Returns
    -------
    str
        To be added to a sentence; empty where there are enough.

    Examples
    --------
    >>> tell_reach({"participant": 1, "recording": 9}), tell_reach({"participant": 9, "recording": 4})
    (', about this one participant only', ', a hint rather than a result with so few recordings')
    """
    alone = [name for name, count in sizes.items() if count == 1]
    few = [f"{name}s" for name, count in sizes.items() if 1 < count < FEW]
    told = f", about this one {' and this one '.join(alone)} only" if alone else ""
    return f"{told}, a hint rather than a result with so few {' and '.join(few)}" if few and claimed else told


def count_units(rows: DataFrame) -> dict[str, int]:
    """Count what is independent of each other: participants, and recordings or their sources.

    Parameters
    ----------
    rows : DataFrame
        Judgements: participant, recording, source.

    Returns
    -------
    dict of str to int
        For `tell_reach`.
    """
    sources = find_sources(rows)
    scene = "recording" if sources.is_unique else "source"
    return {"participant": rows["participant"].nunique(), scene: sources.nunique()}


def tell_p(p: float) -> str:
    """Tell a probability in words.

    Parameters
    ----------
    p : float
        Adjusted by Holm.

    Returns
    -------
    str
        Such as ``p (Holm) = 0.012``.
    """
    told = tell_number(p, kind="p")
    return f"p (Holm) {told if told.startswith('<') else f'= {told}'}"
