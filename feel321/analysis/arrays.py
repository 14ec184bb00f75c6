"""Arrays of numbers from whatever was given: which cells are missing, and what is refused."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from pandas import DataFrame

Values: TypeAlias = NDArray[np.float64]

CONFIDENCE = 0.95
UPPER = (1 + CONFIDENCE) / 2  # Quantile of the upper end of a two-sided interval
FLAT = 1e-24  # Share of a sum of squares below which its centred part is rounding error
PERFECT = 1 - 1e-12  # From here on a correlation is perfect to rounding error


def read_numbers(given: object, *, what: str) -> Values:
    """Read numbers; NaN where one is missing."""
    from pandas import isna

    try:
        return np.asarray(given, dtype=np.float64)
    except (TypeError, ValueError):
        pass
    try:
        cells = np.asarray(given, dtype=object)
        return np.where(isna(cells), np.nan, cells).astype(np.float64)
    except (TypeError, ValueError) as error:
        do = "leave names out, as of rows or columns"
        raise ValueError(f"{what} must hold numbers: {error}; {do}") from error


def read_array(given: object, *, what: str, axes: Sequence[str], missing: bool = False) -> Values:
    """Read numbers, all finite, or NaN where one may be missing; axes: what each counts: ("items", "raters")."""
    values = read_numbers(given, what=what)
    if values.ndim != len(axes):
        form = ", ".join(axes) + ("," if len(axes) == 1 else "")
        raise ValueError(f"{what} must have shape ({form}), got shape {values.shape}")
    bad = np.argwhere(np.isinf(values) if missing else ~np.isfinite(values))
    if len(bad):
        kind, do = ("infinite", "use NaN for a missing one") if missing else ("", "leave them out")
        got = f"got {len(bad)} {kind or 'missing or infinite'} values, first in row {bad[0][0]}"
        raise ValueError(f"{what} must be finite, {got}; {do}")
    return values


def check_labels(first: object, second: object, *, what: str) -> None:
    """Refuse two pandas tables or columns with the same labels in another order: rows go together by place."""
    from pandas import DataFrame, Series

    if not (isinstance(first, DataFrame | Series) and isinstance(second, DataFrame | Series)):
        return
    one, other = first.index, second.index
    if one.is_unique and other.is_unique and not one.equals(other) and set(one) == set(other):
        got = "got the same labels in another order; reindex it"
        raise ValueError(f"{what} must have its labels in the order of the other, {got}")


def read_groups(
    given: object, *, n: int, what: str, of: str = "group", sort: bool = True
) -> tuple[NDArray[np.intp], list[object]]:
    """Find the number of the group of each target or item, (n,); also the distinct names."""
    from pandas import factorize

    names, rule = np.asarray(given), f"{of}s must hold one {of} per {what}"
    if names.shape != (n,):
        raise ValueError(f"{rule}, got shape {names.shape} for {n} {what}s")
    number, distinct = factorize(names, sort=sort)
    if unnamed := int((number < 0).sum()):
        raise ValueError(f"{rule}, got {unnamed} {what}s without a {of}; name it or leave them out")
    return number, distinct.tolist()


def check_columns(table: DataFrame, names: Sequence[str], what: str) -> None:
    """Refuse a table that lacks a column."""
    if missing := [name for name in dict.fromkeys(names) if name not in table]:
        got = ", ".join(map(str, table.columns))
        raise ValueError(f"{what}: column {', '.join(missing)} is missing; got {got}")


def check_draws(draws: int, *, usual: int = 2000) -> None:
    """Refuse fewer bootstrap draws than have a spread."""
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        do = f"use {usual} for results to be published"
        raise ValueError(f"draws must be 2 or more, got {draws}; {do}")
