"""A tidy table of ratings, prepared for screening."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from analysis.table.tidy import NAMING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame, Index, Series

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of the scale that every limit here presupposes."""

ANCHORS = ("mid", "low")
"""Kinds of anchor, told by the name of their reducer or stimulus containing the word."""


@dataclass(frozen=True, slots=True, eq=False)
class Judgements:
    """Ratings with what a rule needs to know of each.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement, in the order given: participant, item (number of scale and stimulus), excerpt
        (number of scale, recording and level: what BS.1534 calls an item), kind (``test``, ``reference``, ``mid``,
        ``low`` or ``anchor``), rating, and response_time_s if there was one.
    participants : Index
        All of them, by alphabet.
    excerpts : DataFrame
        Names of the excerpts, by number.
    items : Series
        Names of the items, by number.
    """

    rows: DataFrame
    participants: Index
    excerpts: DataFrame
    items: Series

    def of_kind(self, kind: str) -> DataFrame:
        """Select the judgements of one kind.

        Parameters
        ----------
        kind : str
            A kind of stimulus.

        Returns
        -------
        DataFrame
            Rows of the same form; maybe none.
        """
        return self.rows[self.rows["kind"] == kind]

    def means(self) -> DataFrame:
        """Average repeats of test stimuli.

        Returns
        -------
        DataFrame
            Participants x items; NaN where there is no rating.
        """
        tests = self.of_kind("test")
        return tests.pivot_table("rating", "participant", "item", observed=True).reindex(self.participants)

    def first_two(self) -> DataFrame:
        """Pair the first and the second rating of every test stimulus rated twice.

        Returns
        -------
        DataFrame
            participant, first, second; one row per participant and stimulus.
        """
        import pandas as pd

        tests = self.of_kind("test")
        turn = tests.groupby(["participant", "item"], observed=True).cumcount()
        one, two = (tests[turn == number].set_index(["participant", "item"])["rating"] for number in (0, 1))
        return pd.DataFrame({"first": one, "second": two}).dropna().reset_index("item", drop=True).reset_index()


def make_judgements(ratings: DataFrame) -> Judgements:
    """Prepare a tidy table.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement: participant, rating, and stimulus_id or recording and reducer (and level); role, scale,
        repeat and response_time_s where there are any. Without roles every stimulus is a test stimulus.

    Returns
    -------
    Judgements
        The same, row by row; sorted by repeat within participant and stimulus if there is one.

    Raises
    ------
    ValueError
        If a column is missing, a name is missing, there is no row, or a rating is not a number from 0 to 100.
    """
    import pandas as pd

    named = _check_columns(ratings)
    _check_rows(ratings, named)
    if "repeat" in ratings:
        ratings = ratings.sort_values("repeat", kind="stable")
    excerpt = [name for name in ("scale", "recording", "level") if name in ratings] or named
    item = ["scale", *key_stimulus(ratings)] if "scale" in ratings else key_stimulus(ratings)
    numbers = ratings.groupby(excerpt, observed=True, dropna=False).ngroup().to_numpy()
    rows = pd.DataFrame({
        "participant": ratings["participant"].to_numpy(),
        "item": ratings.groupby(item, observed=True, dropna=False).ngroup().to_numpy(),
        "excerpt": numbers,
        "kind": _find_kinds(ratings),
        "rating": ratings["rating"].to_numpy(np.float64),
    })
    if "response_time_s" in ratings:
        rows["response_time_s"] = ratings["response_time_s"].to_numpy(np.float64)
    names = ratings[excerpt].assign(number=numbers).drop_duplicates("number").set_index("number").sort_index()
    first = ratings[item].assign(number=rows["item"].to_numpy()).drop_duplicates("number").set_index("number")
    items = first.astype(str).agg("/".join, axis=1)
    return Judgements(rows, pd.Index(sorted(rows["participant"].unique()), name="participant"), names, items)


def key_stimulus(ratings: DataFrame) -> list[str]:
    """List the columns that together name what was judged against what; the level too, where there are several.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement.

    Returns
    -------
    list of str
        Names of columns.
    """
    named = ["stimulus_id"] if "stimulus_id" in ratings else [name for name in NAMING if name in ratings]
    arms = ["level"] if "level" in ratings and len(ratings["level"].unique()) > 1 else []
    return list(dict.fromkeys([*named, *arms, *(["reference_id"] if "reference_id" in ratings else [])]))


def _check_columns(ratings: DataFrame) -> list[str]:
    named = ["stimulus_id"] if "stimulus_id" in ratings else [name for name in NAMING if name in ratings]
    needed = ("participant", "rating", *(named or ["stimulus_id"]))
    missing = ", ".join(name for name in needed if name not in ratings)
    if missing:
        raise ValueError(f"ratings: column {missing} is missing; got {', '.join(map(str, ratings.columns))}")
    if ratings.empty:
        raise ValueError("ratings: got no row; there is nobody to screen")
    return named


def _check_rows(ratings: DataFrame, named: Sequence[str]) -> None:
    for name in ("participant", *named):
        nameless = int(ratings[name].isna().sum())
        if nameless:
            raise ValueError(f"ratings: got {nameless} rows without a {name}; name it or leave them out")
    values = ratings["rating"].to_numpy(np.float64)
    bad = values[~((values >= LOWEST) & (values <= HIGHEST))]
    if len(bad):
        raise ValueError(f"ratings: got {len(bad)} ratings such as {bad[0]:g}; allowed is 0 to 100, leave others out")


def _find_kinds(ratings: DataFrame) -> np.ndarray:
    if "role" not in ratings:
        return np.full(len(ratings), "test", dtype=object)
    # A pair of two test stimuli is a judgement like any other of test stimuli.
    kinds = ratings["role"].replace({"pair": "test"}).to_numpy(dtype=object, copy=True)
    names = ratings["reducer"] if "reducer" in ratings else ratings["stimulus_id"]
    anchored = ratings["role"].eq("anchor").to_numpy()
    for kind in ANCHORS:
        kinds[anchored & names.astype(str).str.contains(kind, case=False).to_numpy()] = kind
    return kinds
