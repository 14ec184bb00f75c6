"""Which refinements are tried: few, of few parameters, in order of simplicity."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    Values = NDArray[np.float64]

EXPONENTS = (0.5, 2.0)
"""Of metrics from 0 to 1, values below 0 counting as 0: differences near 0, or near 1, are made to count for more."""

MOST_COLUMNS = 4
"""Terms of the largest sum: with eight or so recordings, more weights than that are noise."""

EQUAL = "equal weights"
FLAT = 1e-10


@dataclass(frozen=True, slots=True)
class Candidate:
    """A way to make one metric of several.

    Parameters
    ----------
    name : str
        Such as ``spectral_match + temporal_match``.
    columns : tuple of int
        What it sums, as places in `Basis.columns`; each has a weight, fitted to ratings.
    parameters : int
        Numbers that the ratings decide: weights, and an exponent.
    """

    name: str
    columns: tuple[int, ...]
    parameters: int


@dataclass(frozen=True, slots=True, eq=False)
class Basis:
    """What candidates are sums of.

    Parameters
    ----------
    names : tuple of str
        Name of each column.
    columns : ndarray, shape (n_items, n_columns)
        Values, standardised over the stimuli, which no rating has a part in.
    scales : ndarray, shape (n_columns,)
        Standard deviation of each column before; NaN of the sum of equal weights, which has no unit.
    candidates : tuple of Candidate
        The simpler first; the first ones are the plain metrics.
    notes : tuple of str
        What is not among them, and why.
    """

    names: tuple[str, ...]
    columns: Values
    scales: Values
    candidates: tuple[Candidate, ...]
    notes: tuple[str, ...]


def make_basis(names: Sequence[str], values: Values, *, n_plain: int, groups: NDArray[np.intp] | None) -> Basis:
    """List the candidates that metrics of these values allow.

    Parameters
    ----------
    names : sequence of str
        Metrics, then whatever else may enter a sum.
    values : ndarray, shape (n_features, n_items)
        Their values.
    n_plain : int
        How many are metrics: those may stand alone, take an exponent, and enter the sum of equal weights.
    groups : ndarray of int, shape (n_items,), or None
        Recording of each item where only differences within recordings count.

    Returns
    -------
    Basis
        Columns and candidates; none where nothing varies.

    Examples
    --------
    >>> values = np.array([[0.1, 0.5, 0.9], [0.9, 0.2, 0.4]])
    >>> [one.name for one in make_basis(["a", "b"], values, n_plain=2, groups=None).candidates]
    ['a', 'b', 'equal weights', 'a ^ 0.5', 'a ^ 2', 'b ^ 0.5', 'b ^ 2', 'a + b']
    """
    columns = _list_columns(names, values, n_plain)
    centred = {name: _center(column, groups) for name, column in columns.items()}
    kept = {name: column for name, column in centred.items() if np.ptp(column) > FLAT * np.abs(columns[name]).max()}
    notes = tuple(f"'{name}' does not vary and is left out." for name in names if name not in kept)
    plain = [name for name in names[:n_plain] if name in kept]
    standard = {name: column / column.std() for name, column in kept.items()}
    if len(plain) > 1:
        standard[EQUAL] = np.sum([standard[name] for name in plain], axis=0)
    varying = [name for name in names if name in kept]
    candidates = tuple(_list_candidates(tuple(standard), plain, varying))
    scales = np.array([kept[name].std() if name in kept else np.nan for name in standard])
    stacked = np.array(list(standard.values())).T if standard else np.empty((values.shape[1], 0))
    return Basis(tuple(standard), stacked, scales, candidates, notes)


def _list_columns(names: Sequence[str], values: Values, n_plain: int) -> dict[str, Values]:
    columns = dict(zip(names, values, strict=True))
    for name in names[:n_plain]:
        for exponent in EXPONENTS:
            columns[f"{name} ^ {exponent:g}"] = np.clip(columns[name], 0, None) ** exponent
    return columns


def _center(column: Values, groups: NDArray[np.intp] | None) -> Values:
    groups = np.zeros(len(column), dtype=np.intp) if groups is None else groups
    means = np.bincount(groups, column) / np.bincount(groups)
    centred: Values = column - means[groups]
    return centred


def _list_candidates(columns: tuple[str, ...], plain: list[str], features: list[str]) -> Iterator[Candidate]:
    place = {name: number for number, name in enumerate(columns)}
    for name in plain:
        yield Candidate(name, (place[name],), 1)
    if EQUAL in place:
        yield Candidate(EQUAL, (place[EQUAL],), 1)
    for name in plain:
        powers = [f"{name} ^ {exponent:g}" for exponent in EXPONENTS]
        yield from (Candidate(power, (place[power],), 2) for power in powers if power in place)
    # Of sums of three and more, the one of everything is tried only: all of them would be a search.
    whole = [tuple(features)] if 2 < len(features) <= MOST_COLUMNS else []  # noqa: PLR2004 - pairs come before
    for terms in (*combinations(features, 2), *whole):
        if set(terms) & set(plain):
            yield Candidate(" + ".join(terms), tuple(place[name] for name in terms), len(terms))
