"""Does a conclusion depend on who was excluded? One estimate for every set of raters that screening rules leave.

Conventions: a combination of rules leaves out every rater whom at least one of them flags. A universe is a set of
raters: combinations that leave the same raters are one universe, not several that agree. The first is everyone.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.screening.screen import Screening, screen_raters
from feel321.analysis.table.items import Table, leave_rejected, open_ratings
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping

    from pandas import DataFrame

    from feel321.types import Rng

NONE = float("nan")

EVERYONE = "none"
"""Name of the universe without a rule."""

BETWEEN = "; "
"""Separates combinations that leave the same raters."""


class UniverseEstimate(NamedTuple):
    """What an estimator found; NaN where there is none."""

    value: float
    low: float = NONE
    high: float = NONE
    note: str = ""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Multiverse(Result):
    """An estimate in every universe.

    Parameters
    ----------
    table : DataFrame
        One row per distinct set of raters: universe (the smallest combination of rules that leaves it, names joined by
        ``+``), one column of flags per rule of it, n_combinations and combinations (all that leave it, parted by
        ``;``), n_excluded, excluded (tuple of participants), n_participants, value, low, high, note (why there is no
        value).
    screening : Screening
        Raters that each rule flagged, and why.
    n_combinations : int
        Combinations of rules, none at all among them.
    n_distinct : int
        Distinct sets of raters that they leave: universes. The estimator ran once for each.
    median, smallest, largest : float
        Of the values that are defined; NaN if none is.
    same_sign : float
        Share of the defined values with the sign of that of the first universe; NaN if that has none.
    beyond_zero : float
        Share of the defined intervals that exclude zero; NaN without intervals.
    notes : tuple of str
        Which universes have no value and which rules change nothing.
    """

    table: DataFrame
    screening: Screening
    n_combinations: int
    n_distinct: int
    median: float
    smallest: float
    largest: float
    same_sign: float
    beyond_zero: float
    notes: tuple[str, ...] = ()

    @property
    def curve(self) -> DataFrame:
        """Universes with a value, from the smallest to the largest: the specification curve."""
        defined = self.table[self.table["value"].notna()]
        return defined.sort_values("value", kind="stable").reset_index(drop=True)

    def to_frame(self) -> DataFrame:
        """Return the universes.

        Returns
        -------
        DataFrame
            As `table`.
        """
        return self.table


def run_multiverse(
    table: Table | DataFrame,
    estimator: Callable[[DataFrame], object],
    *,
    rules: Iterable[str] | Mapping[str, float] | None = None,
    together: int = 2,
    rng: Rng | None = None,
) -> Multiverse:
    """Run an estimator without exclusion, after each rule, and after combinations of rules.

    Parameters
    ----------
    table : Table or DataFrame
        Tidy table, as for `screen_raters` and for the estimator.
    estimator : callable
        DataFrame of ratings -> a number, (value, low, high), or a result with ``value``, ``low`` and ``high``. It
        should make its own generator from a fixed seed, so that universes differ by their raters only.
    rules : iterable of str, mapping of str to float, or None
        As for `screen_raters`.
    together : int
        Largest number of rules combined, 1 or more; all rules at once are always among the universes.
    rng : int, Generator or None
        For the rule ``expertise``.

    Returns
    -------
    Multiverse
        The table behind a specification curve, and its summary.

    Raises
    ------
    ValueError
        If the ratings or rules are not as they must be, or ``together`` is below 1.
    TypeError
        If the estimator returns something else.

    Notes
    -----
    Universes are not independent and not equally sensible: the shares describe how far the conclusion depends on the
    choice of rules, they are no test. Each distinct set of raters counts once, however many combinations leave it, so
    that rules which flag nobody do not add agreement. An estimator's ValueError in a universe becomes that row's note;
    any other error is a fault and is passed on. Where nobody is left, the estimator is not called.

    References
    ----------
    Steegen, Tuerlinckx, Gelman & Vanpaemel (2016), Perspectives on Psychological Science 11, 702-712, doi
    10.1177/1745691616658637. Simonsohn, Simmons & Nelson (2020), Specification curve analysis, Nature Human Behaviour
    4, 1208-1214, doi 10.1038/s41562-020-0912-z.

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> table = pd.DataFrame({"participant": ["ann"] * 10 + ["bob"] * 10, "recording": list("abcdefghij") * 2,
    ...     "reducer": "original", "role": "reference", "rating": [95] * 10 + [85] * 10})
    >>> result = analysis.run_multiverse(table, lambda part: part["rating"].mean(), rules=["hidden_reference"])
    >>> result.table[["universe", "n_excluded", "value"]]
               universe  n_excluded  value
    0              none           0   90.0
    1  hidden_reference           1   95.0
    """
    if together < 1:
        raise ValueError(f"together must be 1 or more rules in a combination, got {together}")
    screening = screen_raters(table, rules, rng=rng)
    return run_universes(table, estimator, screening, together=together)


def run_universes(
    table: Table | DataFrame,
    estimator: Callable[[DataFrame], object],
    screening: Screening,
    *,
    together: int = 2,
) -> Multiverse:
    """Run an estimator on every set of raters that a screening leaves."""
    import pandas as pd

    ratings, _ = leave_rejected(open_ratings(table))
    hits, sets = screening.hits, defaultdict(list)
    for chosen in _list_combinations(screening.rules, together):
        sets[frozenset(who for rule in chosen for who in hits[rule])].append(chosen)
    everyone = ratings["participant"].nunique()
    rows = []
    for excluded, leaving in sets.items():
        # Named by the first, which is the smallest, of the combinations that leave these raters.
        names = [" + ".join(chosen) or EVERYONE for chosen in leaving]
        rows.append({
            "universe": names[0],
            **{rule: rule in leaving[0] for rule in screening.rules},
            "n_combinations": len(names),
            "combinations": BETWEEN.join(names),
            "n_excluded": len(excluded),
            "excluded": tuple(sorted(excluded, key=str)),
            "n_participants": everyone - len(excluded),
            **_estimate(ratings, estimator, excluded)._asdict(),
        })
    universes = pd.DataFrame(rows)
    return Multiverse(
        table=universes, screening=screening, n_combinations=int(universes["n_combinations"].sum()),
        n_distinct=len(universes), **_summarise(universes), notes=_explain(universes, screening),
    )  # fmt: skip


def _list_combinations(rules: tuple[str, ...], together: int) -> Iterator[tuple[str, ...]]:
    """List no rule, each rule, each combination, all rules."""
    for size in range(min(together, len(rules)) + 1):
        yield from combinations(rules, size)
    if together < len(rules):
        yield rules


def _estimate(
    ratings: DataFrame, estimator: Callable[[DataFrame], object], excluded: frozenset[Hashable]
) -> UniverseEstimate:
    left = ratings[~ratings["participant"].isin(list(excluded))]
    if left.empty:
        return UniverseEstimate(NONE, note="every participant is excluded")
    try:
        result = estimator(left)
    except ValueError as error:
        return UniverseEstimate(NONE, note=str(error))
    return _read_estimate(result)


def _read_estimate(result: object) -> UniverseEstimate:
    """Take a number, three of them, or a result with value, low and high."""
    fields = [getattr(result, name, np.nan) for name in ("value", "low", "high")]
    given = fields if hasattr(result, "value") else result
    try:
        numbers = np.asarray(given, dtype=np.float64).ravel().tolist()
    except (TypeError, ValueError):
        numbers = []
    if len(numbers) not in {1, 3} or given is None:
        raise TypeError(
            f"estimator must give a number, (value, low, high), or a result with these; got {result!r}"
        )
    if np.isnan(numbers[0]):
        note = " ".join(getattr(result, "notes", ())) or "the estimator gave NaN"
        return UniverseEstimate(numbers[0], note=note)
    low, high = numbers[1:] or (NONE, NONE)
    return UniverseEstimate(numbers[0], low, high)


def _summarise(table: DataFrame) -> dict[str, float]:
    values = table["value"].to_numpy(np.float64)
    first, defined = values[0], values[np.isfinite(values)]
    bounded = table[table["low"].notna() & table["high"].notna()]
    beyond = (bounded["low"] > 0) | (bounded["high"] < 0)
    same = (np.sign(defined) == np.sign(first)).mean() if np.isfinite(first) else NONE
    return {
        "median": float(np.median(defined)) if len(defined) else NONE,
        "smallest": float(defined.min()) if len(defined) else NONE,
        "largest": float(defined.max()) if len(defined) else NONE,
        "same_sign": float(same),
        "beyond_zero": float(beyond.mean()) if len(bounded) else NONE,
    }


def _explain(table: DataFrame, screening: Screening) -> tuple[str, ...]:
    undefined = table.loc[~np.isfinite(table["value"].to_numpy(np.float64)), ["universe", "note"]]
    notes = [
        f"Universe '{name}' has no value: {note.rstrip('.')}."
        for name, note in undefined.to_numpy()
    ]
    idle = [rule for rule, hit in screening.hits.items() if not hit]
    if idle:
        notes.append(f"Rules that flagged nobody, and so change nothing: {', '.join(idle)}.")
    return (*notes, *screening.notes)
