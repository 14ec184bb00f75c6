"""A tidy table of ratings, prepared for screening."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.table.tidy import NAMING
from protocols.registry import PROTOCOLS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pandas import DataFrame, Index, Series

LOWEST, HIGHEST = 0.0, 100.0
"""The ends of the scale that every limit here presupposes."""

MOST_STEPS = 11
"""Different ratings up to which a scale may be one of few steps."""

FULL = 5
"""Ratings per step from which on a slider would have been left at other places, too."""

SAME_POINTS = 2.0
"""Ratings of a slider that lie no farther apart than this are at the same place."""

FEWEST_JUDGEMENTS = 8
"""With fewer judgements, or pairs of them, a habit cannot be told from chance."""

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
        ``low`` or ``anchor``), protocol (its name; empty where it is unknown), step (points between two ratings of
        a scale of few steps; 0 for a slider), rating, and response_time_s if there was one.
    participants : Index
        All of them, by alphabet.
    excerpts : DataFrame
        Names of the excerpts, by number.
    items : Series
        Names of the items, by number.
    notes : tuple of str
        What was assumed, one sentence each.
    """

    rows: DataFrame
    participants: Index
    excerpts: DataFrame
    items: Series
    notes: tuple[str, ...] = ()

    def of_protocols(self, names: Sequence[str]) -> Judgements:
        """Select the judgements of some protocols.

        Parameters
        ----------
        names : sequence of str
            Protocols; none for all.

        Returns
        -------
        Judgements
            The same participants, maybe without a row.
        """
        return replace(self, rows=self.rows[self.rows["protocol"].isin(names)]) if names else self

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
            participant, first, second, step; one row per participant and stimulus.
        """
        import pandas as pd

        tests = self.of_kind("test")
        turn = tests.groupby(["participant", "item"], observed=True).cumcount()
        one, two = (tests[turn == number].set_index(["participant", "item"]) for number in (0, 1))
        pairs = pd.DataFrame({"first": one["rating"], "second": two["rating"], "step": one["step"]})
        return pairs.dropna().reset_index("item", drop=True).reset_index()

    def rounding(self) -> Series:
        """Mean variance that the steps of the scale add to each participant's ratings of test stimuli.

        Returns
        -------
        Series
            By participant, in squared points: step² / 12 (Sheppard); 0 for a slider.
        """
        tests = self.of_kind("test")
        added = (tests["step"] ** 2 / 12).groupby(tests["participant"].to_numpy(), observed=True).mean()
        return added.reindex(self.participants, fill_value=0.0)


def make_judgements(ratings: DataFrame, *, assumed: str = "") -> Judgements:
    """Prepare a tidy table.

    Parameters
    ----------
    ratings : DataFrame
        One row per judgement: participant, rating, and stimulus_id or recording and reducer (and level); role, scale,
        repeat, protocol and response_time_s where there are any. Without roles every stimulus is a test stimulus.
    assumed : str
        Protocol of ratings that neither a column protocol nor the name of their scale tells.

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
    protocols, notes = _find_protocols(ratings, assumed)
    rows = pd.DataFrame({
        "participant": ratings["participant"].to_numpy(),
        "item": ratings.groupby(item, observed=True, dropna=False).ngroup().to_numpy(),
        "excerpt": numbers,
        "kind": _find_kinds(ratings),
        "protocol": protocols,
        "step": _find_steps(ratings),
        "rating": ratings["rating"].to_numpy(np.float64),
    })
    if "response_time_s" in ratings:
        rows["response_time_s"] = ratings["response_time_s"].to_numpy(np.float64)
    names = ratings[excerpt].assign(number=numbers).drop_duplicates("number").set_index("number").sort_index()
    first = ratings[item].assign(number=rows["item"].to_numpy()).drop_duplicates("number").set_index("number")
    items = first.astype(str).agg("/".join, axis=1)
    # Numbers and words cannot be compared with each other; each kind keeps its own order.
    everyone = sorted(rows["participant"].unique(), key=lambda name: (isinstance(name, str), name))
    return Judgements(rows, pd.Index(everyone, name="participant"), names, items, notes)


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


def _find_protocols(ratings: DataFrame, assumed: str) -> tuple[np.ndarray, tuple[str, ...]]:
    """Name the protocol of every judgement: as its column says, else as its scale is called, else what is assumed."""
    of_scale = {protocol.scale: name for name, protocol in PROTOCOLS.items()}
    told = np.full(len(ratings), "", dtype=object)
    if "protocol" in ratings:
        told = ratings["protocol"].astype(object).where(ratings["protocol"].notna(), "").astype(str).to_numpy(object)
    scales = ratings["scale"].astype(str).map(of_scale).fillna("").to_numpy(object) if "scale" in ratings else told
    by_scale, unknown = (told == "") & (scales != ""), (told == "") & (scales == "")
    notes = []
    if by_scale.any():
        names = ", ".join(sorted(set(scales[by_scale])))
        notes.append(f"No protocol is given for {by_scale.sum()} ratings: assumed from their scale ({names}).")
    if unknown.any() and assumed:
        notes.append(f"No protocol is given for {unknown.sum()} ratings: assumed {assumed}, with a reference in sight.")
    return np.where(by_scale, scales, np.where(unknown, assumed, told)), tuple(notes)


def _find_steps(ratings: DataFrame) -> np.ndarray:
    """Find the points between two ratings of a scale of few steps; 0 where a slider was used."""
    steps = np.zeros(len(ratings))
    scales = ratings["scale"].astype(str).to_numpy() if "scale" in ratings else np.zeros(len(ratings))
    values = ratings["rating"].to_numpy(np.float64)
    for scale in np.unique(scales):
        own = scales == scale
        found = np.unique(values[own])
        gap = float(np.diff(found).min()) if len(found) > 1 else 0.0
        if gap > SAME_POINTS and len(found) <= MOST_STEPS and own.sum() >= FULL * len(found):
            steps[own] = gap
    return steps
