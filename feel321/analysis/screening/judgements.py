"""A tidy table of ratings, prepared for screening, and expertise measured against a permutation null.

In the manner of Report ITU-R BS.2300 (Methods for assessor screening); the measures below are defined here, because
the data need not be balanced.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.table.sheet import NAMING
from feel321.protocols.tasks import PROTOCOLS

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame, Index, Series

    Values = NDArray[np.float64]

# What a rule found of each participant.


def tell_shares(
    bad: Series, participant: Series, *, participants: Index, limit: float
) -> DataFrame:
    """Count how often each participant did what a rule forbids, and compare the share with its limit.

    Returns indexed by participant: count, n, share (NaN without judgements), limit, hit.
    """
    grouped = bad.groupby(participant.to_numpy(), observed=True)
    count = grouped.sum().reindex(participants, fill_value=0)
    n = grouped.size().reindex(participants, fill_value=0)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def tell_values(
    count: Series,
    n: Series,
    share: Series,
    *,
    limit: float | NDArray[np.float64],
    below: bool = False,
) -> DataFrame:
    """Compare a value of each participant with its limit.

    count, n, share: a share that is NaN hits nobody; limit: (n_participants,).
    """
    import pandas as pd

    values, limits = (
        share.to_numpy(np.float64),
        np.broadcast_to(np.asarray(limit, dtype=np.float64), share.shape),
    )
    # 3 of 20 is 15 %, not more; a hair of rounding must not tell otherwise.
    clear = np.abs(values - limits) > 1e-12  # noqa: PLR2004 - rounding of one division
    hit = clear & ((values < limits) if below else (values > limits))
    columns = {
        "count": count.astype(int),
        "n": n.astype(int),
        "share": values,
        "limit": limits,
        "hit": hit,
    }
    return pd.DataFrame(columns, index=share.index)


# A tidy table of ratings, prepared for screening.

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
    """Ratings with what a rule needs to know of each."""

    rows: DataFrame
    participants: Index
    excerpts: DataFrame
    items: Series
    notes: tuple[str, ...] = ()

    def of_protocols(self, names: Sequence[str]) -> Judgements:
        """Select the judgements of some protocols."""
        return replace(self, rows=self.rows[self.rows["protocol"].isin(names)]) if names else self

    def of_kind(self, kind: str) -> DataFrame:
        """Select the judgements of one kind."""
        return self.rows[self.rows["kind"] == kind]

    def means(self) -> DataFrame:
        """Average repeats of test stimuli.

        Returns naN where there is no rating.
        """
        tests = self.of_kind("test")
        return tests.pivot_table("rating", "participant", "item", observed=True).reindex(
            self.participants
        )

    def first_two(self) -> DataFrame:
        """Pair the first and the second rating of every test stimulus rated twice."""
        import pandas as pd

        tests = self.of_kind("test")
        turn = tests.groupby(["participant", "item"], observed=True).cumcount()
        one, two = (tests[turn == number].set_index(["participant", "item"]) for number in (0, 1))
        pairs = pd.DataFrame({"first": one["rating"], "second": two["rating"], "step": one["step"]})
        return pairs.dropna().reset_index("item", drop=True).reset_index()

    def rounding(self) -> Series:
        """Mean variance that the steps of the scale add to each participant's ratings of test stimuli."""
        tests = self.of_kind("test")
        added = (
            (tests["step"] ** 2 / 12).groupby(tests["participant"].to_numpy(), observed=True).mean()
        )
        return added.reindex(self.participants, fill_value=0.0)


def make_judgements(ratings: DataFrame, *, assumed: str = "") -> Judgements:
    """Prepare a tidy table."""
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
    names = (
        ratings[excerpt]
        .assign(number=numbers)
        .drop_duplicates("number")
        .set_index("number")
        .sort_index()
    )
    first = (
        ratings[item]
        .assign(number=rows["item"].to_numpy())
        .drop_duplicates("number")
        .set_index("number")
    )
    items = first.astype(str).agg("/".join, axis=1)
    # Numbers and words cannot be compared with each other; each kind keeps its own order.
    everyone = sorted(rows["participant"].unique(), key=lambda name: (isinstance(name, str), name))
    return Judgements(rows, pd.Index(everyone, name="participant"), names, items, notes)


def key_stimulus(ratings: DataFrame) -> list[str]:
    """List the columns that together name what was judged against what; the level too, where there are several."""
    named = (
        ["stimulus_id"]
        if "stimulus_id" in ratings
        else [name for name in NAMING if name in ratings]
    )
    arms = ["level"] if "level" in ratings and len(ratings["level"].unique()) > 1 else []
    return list(
        dict.fromkeys([*named, *arms, *(["reference_id"] if "reference_id" in ratings else [])])
    )


def _check_columns(ratings: DataFrame) -> list[str]:
    named = (
        ["stimulus_id"]
        if "stimulus_id" in ratings
        else [name for name in NAMING if name in ratings]
    )
    needed = ("participant", "rating", *(named or ["stimulus_id"]))
    missing = ", ".join(name for name in needed if name not in ratings)
    if missing:
        raise ValueError(
            f"ratings: column {missing} is missing; got {', '.join(map(str, ratings.columns))}"
        )
    if ratings.empty:
        raise ValueError("ratings: got no row; there is nobody to screen")
    return named


def _check_rows(ratings: DataFrame, named: Sequence[str]) -> None:
    for name in ("participant", *named):
        nameless = int(ratings[name].isna().sum())
        if nameless:
            raise ValueError(
                f"ratings: got {nameless} rows without a {name}; name it or leave them out"
            )
    values = ratings["rating"].to_numpy(np.float64)
    bad = values[~((values >= LOWEST) & (values <= HIGHEST))]
    if len(bad):
        raise ValueError(
            f"ratings: got {len(bad)} ratings such as {bad[0]:g}; allowed is 0 to 100, leave others out"
        )


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
        told = (
            ratings["protocol"]
            .astype(object)
            .where(ratings["protocol"].notna(), "")
            .astype(str)
            .to_numpy(object)
        )
    scales = (
        ratings["scale"].astype(str).map(of_scale).fillna("").to_numpy(object)
        if "scale" in ratings
        else told
    )
    by_scale, unknown = (told == "") & (scales != ""), (told == "") & (scales == "")
    notes = []
    if by_scale.any():
        names = ", ".join(sorted(set(scales[by_scale])))
        notes.append(
            f"No protocol is given for {by_scale.sum()} ratings: assumed from their scale ({names})."
        )
    if unknown.any() and assumed:
        notes.append(
            f"No protocol is given for {unknown.sum()} ratings: assumed {assumed}, with a reference in sight."
        )
    return np.where(by_scale, scales, np.where(unknown, assumed, told)), tuple(notes)


def _find_steps(ratings: DataFrame) -> np.ndarray:
    """Find the points between two ratings of a scale of few steps; 0 where a slider was used."""
    steps = np.zeros(len(ratings))
    scales = (
        ratings["scale"].astype(str).to_numpy() if "scale" in ratings else np.zeros(len(ratings))
    )
    values = ratings["rating"].to_numpy(np.float64)
    for scale in np.unique(scales):
        own = scales == scale
        found = np.unique(values[own])
        gap = float(np.diff(found).min()) if len(found) > 1 else 0.0
        if gap > SAME_POINTS and len(found) <= MOST_STEPS and own.sum() >= FULL * len(found):
            steps[own] = gap
    return steps


# Expertise of raters: discrimination, reliability and agreement, each against a permutation null.

MEASURES = ("discrimination", "reliability", "agreement")

PERMUTATIONS = 499

FLOOR = 0.95
"""Share of permutations that an expert's measure exceeds."""


class _Trials(NamedTuple):
    """One rater's judgements of test stimuli, and what the panel made of the same stimuli."""

    item: NDArray[np.intp]
    rating: Values
    others: Values
    """Mean of the other raters per item; NaN where there is none."""
    panel_square: float
    """Mean square between items of the average rater."""


def gauge_raters(
    judgements: Judgements, *, permutations: int = PERMUTATIONS, rng: np.random.Generator
) -> DataFrame:
    """Measure how expert each rater is.

    Returns %.

    Notes
    -----
    From one rater's one-way analysis of variance, items against repeats, with mean squares M_items and M_repeats:
    discrimination is M_items / M_repeats (do stimuli differ for this rater beyond the rater's own noise?), reliability
    is the panel's average M_items / M_repeats (is the noise small against what there is to hear or feel?), agreement
    is Pearson's r with the mean of the others over items. Shuffling ratings over trials keeps how a rater uses the
    scale and destroys everything else. Rarely use it to exclude: raters who differ are not thereby wrong.

    References
    ----------
    Lorho, Le Ray & Zacharov (2010), eGauge: a measure of assessor expertise in audio quality evaluations, AES 38th
    International Conference.
    """
    import pandas as pd

    tests = judgements.of_kind("test")
    means = judgements.means()
    panel_square = _average_square(judgements)
    rows = []
    for participant, own in tests.groupby("participant", observed=True):
        items = range(int(tests["item"].max()) + 1)
        others = means.drop(index=participant).mean().reindex(items).to_numpy()
        trials = _Trials(own["item"].to_numpy(), own["rating"].to_numpy(), others, panel_square)
        rows += [
            {"participant": participant, **row} for row in _gauge(trials, permutations, rng=rng)
        ]
    return pd.DataFrame(rows, columns=["participant", "measure", "value", "floor", "p"])


def judge_expertise(gauge: DataFrame, judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who are no better than their own shuffled ratings."""
    defined = gauge[gauge["value"].notna()]
    failed = (defined["p"] > 1 - FLOOR).groupby(defined["participant"].to_numpy())
    count = failed.sum().reindex(judgements.participants, fill_value=0)
    n = failed.size().reindex(judgements.participants, fill_value=0)
    return tell_values(count, n, count / n.where(n > 0), limit=limit)


def _average_square(judgements: Judgements) -> float:
    tests = judgements.of_kind("test")
    squares = [
        _mean_squares(own["item"].to_numpy(), own["rating"].to_numpy()[None])[0][0]
        for _, own in tests.groupby("participant", observed=True)
    ]
    return float(np.nanmean(squares)) if np.isfinite(squares).any() else float("nan")


def _gauge(
    trials: _Trials, permutations: int, *, rng: np.random.Generator
) -> list[dict[str, object]]:
    shuffled = rng.permuted(
        np.broadcast_to(trials.rating, (permutations, len(trials.rating))), axis=1
    )
    measured = _measure(trials, np.vstack([trials.rating, shuffled]))
    rows: list[dict[str, object]] = []
    for name, values in zip(MEASURES, measured, strict=True):
        null = values[1:][~np.isnan(values[1:])]
        defined = not np.isnan(values[0]) and len(null) > 0
        rows.append({
            "measure": name,
            "value": float(values[0]),
            "floor": float(np.quantile(null, FLOOR, method="higher")) if defined else float("nan"),
            "p": (1 + int((null >= values[0]).sum())) / (1 + len(null))
            if defined
            else float("nan"),
        })
    return rows


def _measure(trials: _Trials, ratings: Values) -> tuple[Values, Values, Values]:
    """Discrimination, reliability and agreement of every row of ratings."""
    between, within = _mean_squares(trials.item, ratings)
    with np.errstate(invalid="ignore", divide="ignore"):
        return between / within, trials.panel_square / within, _agree(trials, ratings)


def _mean_squares(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values]:
    means, counts, place = _average_items(item, ratings)
    n_items, spare = len(counts), len(item) - len(counts)
    nothing = np.full(len(ratings), np.nan)
    if n_items < 2 or not spare:  # noqa: PLR2004 - a variance needs two
        return nothing, nothing
    grand = ratings.mean(axis=1, keepdims=True)
    between = (counts * (means - grand) ** 2).sum(axis=1) / (n_items - 1)
    within = ((ratings - means[:, place]) ** 2).sum(axis=1) / spare
    constant = np.ptp(ratings, axis=1) == 0
    return np.where(constant, np.nan, between), np.where(constant, np.nan, within)


def _average_items(
    item: NDArray[np.intp], ratings: Values
) -> tuple[Values, Values, NDArray[np.intp]]:
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    sums = np.add.reduceat(ratings[:, np.argsort(place, kind="stable")], starts, axis=1)
    return sums / counts, counts.astype(np.float64), place


def _agree(trials: _Trials, ratings: Values) -> Values:
    means = _average_items(trials.item, ratings)[0]
    others = trials.others[np.unique(trials.item)]
    shared = np.isfinite(others)
    if shared.sum() < 3:  # noqa: PLR2004 - two points always lie on a line
        return np.full(len(ratings), np.nan)
    own = means[:, shared] - means[:, shared].mean(axis=1, keepdims=True)
    other = others[shared] - others[shared].mean()
    scale = np.sqrt((own**2).sum(axis=1) * (other**2).sum())
    r: Values = np.divide(
        (own * other).sum(axis=1), scale, out=np.full(len(own), np.nan), where=scale > 0
    )
    return r
