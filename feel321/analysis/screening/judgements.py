"""Ratings prepared for screening, and the expertise of raters: discrimination, reliability and agreement.

Expertise is judged against a permutation null, in the manner of Report ITU-R BS.2300 (Methods for assessor
screening); the measures are defined here, because the data need not be balanced.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from feel321.analysis.resampling import FEWEST_ITEMS
from feel321.analysis.table.schema import HIGHEST, LOWEST, NAMING
from feel321.protocols.tasks import PROTOCOLS

if TYPE_CHECKING:
    from pandas import DataFrame, Index, Series

    from feel321.analysis.arrays import Values

MOST_STEPS = 11
"""Different ratings up to which a scale may be one of few steps."""

FULL = 5
"""Ratings per step from which on a slider would have been left at other places, too."""

SAME_POINTS = 2.0
"""Ratings of a slider that lie no farther apart than this are at the same place."""

FLOOR = 0.95
"""Share of permutations that an expert's measure exceeds."""

ANCHORS = ("mid", "low")
"""Kinds of anchor, known by the name of their reducer or stimulus containing the word."""


@dataclass(frozen=True, slots=True, eq=False)
class Judgements:
    """Ratings with what a rule needs to know of each."""

    rows: DataFrame
    participants: Index
    excerpts: DataFrame
    items: Series
    given: DataFrame
    notes: tuple[str, ...] = ()

    def of_protocols(self, names: Sequence[str]) -> Judgements:
        """Select the judgements of some protocols; all of them if none is named."""
        return replace(self, rows=self.rows[self.rows["protocol"].isin(names)]) if names else self

    def of_kind(self, kind: str) -> DataFrame:
        """Select the judgements of one kind."""
        return self.rows[self.rows["kind"] == kind]

    def means(self) -> DataFrame:
        """Average repeats of test stimuli, participants x items; NaN where there is no rating."""
        tests = self.of_kind("test")
        means = tests.pivot_table("rating", "participant", "item", observed=True)
        return means.reindex(self.participants)

    def first_two(self) -> DataFrame:
        """Pair the first and the second rating of every test stimulus rated twice."""
        tests = self.of_kind("test")
        turn = tests.groupby(["participant", "item"], observed=True).cumcount()
        one, two = (tests[turn == number].set_index(["participant", "item"]) for number in (0, 1))
        pairs = pd.DataFrame({"first": one["rating"], "second": two["rating"]})
        return pairs.dropna().reset_index("item", drop=True).reset_index()

    def rounding(self) -> Series:
        """Average the variance that the steps of the scale add to each participant's ratings of test stimuli."""
        tests = self.of_kind("test")
        whose = tests["participant"].to_numpy()
        added = (tests["step"] ** 2 / 12).groupby(whose, observed=True).mean()
        return added.reindex(self.participants, fill_value=0.0)


def make_judgements(ratings: DataFrame, *, assumed: str = "") -> Judgements:
    """Prepare a tidy table; ratings that name no protocol are taken to be of the one assumed, if any."""
    named = _check_ratings(ratings)
    if "repeat" in ratings:
        # As text 10 comes before 2; what is no number keeps its place in the table, behind all numbers.
        ratings = ratings.sort_values(
            "repeat", kind="stable", key=lambda turns: pd.to_numeric(turns, errors="coerce")
        )
    excerpt = [name for name in ("scale", "recording", "level") if name in ratings] or named
    item = ["scale", *key_stimulus(ratings)] if "scale" in ratings else key_stimulus(ratings)
    excerpts, items = (
        ratings.groupby(keys, observed=True, dropna=False).ngroup().to_numpy()
        for keys in (excerpt, item)
    )
    protocols, notes = _find_protocols(ratings, assumed)
    rows = pd.DataFrame({
        "participant": ratings["participant"].to_numpy(),
        "item": items,
        "excerpt": excerpts,
        "kind": _find_kinds(ratings),
        "protocol": protocols,
        "step": _find_steps(ratings),
        "rating": ratings["rating"].to_numpy(np.float64),
    })
    if "response_time_s" in ratings:
        rows["response_time_s"] = ratings["response_time_s"].to_numpy(np.float64)
    # Numbers and words cannot be compared with each other; each kind keeps its own order.
    everyone = sorted(rows["participant"].unique(), key=lambda name: (isinstance(name, str), name))
    names = _name_groups(ratings[excerpt], excerpts).sort_index()
    labels = _name_groups(ratings[item], items).astype(str).agg("/".join, axis=1)
    who = pd.Index(everyone, name="participant")
    return Judgements(rows, who, names, labels, ratings, notes)


def _name_groups(keys: DataFrame, numbers: np.ndarray) -> DataFrame:
    return keys.assign(number=numbers).drop_duplicates("number").set_index("number")


def key_stimulus(ratings: DataFrame) -> list[str]:
    """List the columns that together name what was judged against what; the level too, where there are several."""
    arms = ["level"] if "level" in ratings and len(ratings["level"].unique()) > 1 else []
    reference = ["reference_id"] if "reference_id" in ratings else []
    return list(dict.fromkeys([*_list_naming(ratings), *arms, *reference]))


def _list_naming(ratings: DataFrame) -> list[str]:
    single = ["stimulus_id"] if "stimulus_id" in ratings else []
    return single or [name for name in NAMING if name in ratings]


def _check_ratings(ratings: DataFrame) -> list[str]:
    named = _list_naming(ratings)
    needed = ("participant", "rating", *(named or ["stimulus_id"]))
    missing = ", ".join(name for name in needed if name not in ratings)
    if missing:
        raise ValueError(
            f"ratings: column {missing} is missing, a table must have {', '.join(needed)}; got "
            f"{', '.join(map(str, ratings.columns))}"
        )
    if ratings.empty:
        raise ValueError("ratings must hold a row per judgement, got no row")
    for name in ("participant", *named):
        nameless = int(ratings[name].isna().sum())
        if nameless:
            raise ValueError(
                f"ratings must all be named, got {nameless} rows without a {name}; name it or leave them out"
            )
    values = ratings["rating"].to_numpy(np.float64)
    bad = values[~((values >= LOWEST) & (values <= HIGHEST))]
    if len(bad):
        raise ValueError(
            f"ratings must lie between 0 and 100, got {len(bad)} ratings such as {bad[0]:g}; leave others out"
        )
    return named


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
    given = scales = np.full(len(ratings), "", dtype=object)
    if "protocol" in ratings:
        column = ratings["protocol"].astype(object)
        given = column.where(column.notna(), "").astype(str).to_numpy(object)
    if "scale" in ratings:
        scales = ratings["scale"].astype(str).map(of_scale).fillna("").to_numpy(object)
    by_scale, unknown = (given == "") & (scales != ""), (given == "") & (scales == "")
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
    return np.where(by_scale, scales, np.where(unknown, assumed, given)), tuple(notes)


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


MEASURES = ("discrimination", "reliability", "agreement")

PERMUTATIONS = 499


class RaterTrials(NamedTuple):
    """One rater's judgements of test stimuli, and what the panel made of the same stimuli.

    others: mean of the other raters per item, NaN where there is none; panel_square: mean square between items of the
    average rater.
    """

    item: NDArray[np.intp]
    rating: Values
    others: Values
    panel_square: float


def gauge_raters(
    judgements: Judgements, *, permutations: int = PERMUTATIONS, rng: np.random.Generator
) -> DataFrame:
    """Measure how expert each rater is: participant, measure, value, floor (95 % of its null), p.

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
    tests, means = judgements.of_kind("test"), judgements.means()
    people = list(tests.groupby("participant", observed=True))
    between = [
        _mean_squares(ratings, _average_items(own["item"].to_numpy(), ratings))[0][0]
        for _, own in people
        for ratings in [own["rating"].to_numpy()[None]]
    ]
    panel_square = float(np.nanmean(between)) if np.isfinite(between).any() else float("nan")
    rows = []
    for participant, own in people:
        items = range(int(tests["item"].max()) + 1)
        others = means.drop(index=participant).mean().reindex(items).to_numpy()
        trials = RaterTrials(own["item"].to_numpy(), own["rating"].to_numpy(), others, panel_square)
        rows += [
            {"participant": participant, **row} for row in _gauge(trials, permutations, rng=rng)
        ]
    return pd.DataFrame(rows, columns=["participant", "measure", "value", "floor", "p"])


def _gauge(
    trials: RaterTrials, permutations: int, *, rng: np.random.Generator
) -> list[dict[str, object]]:
    shape = permutations, len(trials.rating)
    shuffled = rng.permuted(np.broadcast_to(trials.rating, shape), axis=1)
    ratings = np.vstack([trials.rating, shuffled])
    averages = _average_items(trials.item, ratings)
    between, within = _mean_squares(ratings, averages)
    with np.errstate(invalid="ignore", divide="ignore"):
        agreement = _agree(trials, averages[0])
        measured = between / within, trials.panel_square / within, agreement
    rows: list[dict[str, object]] = []
    for name, values in zip(MEASURES, measured, strict=True):
        value, null = float(values[0]), values[1:][~np.isnan(values[1:])]
        floor = p = float("nan")
        if not np.isnan(value) and len(null):
            floor = float(np.quantile(null, FLOOR, method="higher"))
            p = (1 + int((null >= value).sum())) / (1 + len(null))
        rows.append({"measure": name, "value": value, "floor": floor, "p": p})
    return rows


def _mean_squares(
    ratings: Values, averages: tuple[Values, Values, NDArray[np.intp]]
) -> tuple[Values, Values]:
    means, counts, place = averages
    n_items, spare = len(counts), len(place) - len(counts)
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


def _agree(trials: RaterTrials, means: Values) -> Values:
    others = trials.others[np.unique(trials.item)]
    shared = np.isfinite(others)
    if shared.sum() < FEWEST_ITEMS:
        return np.full(len(means), np.nan)
    own = means[:, shared] - means[:, shared].mean(axis=1, keepdims=True)
    other = others[shared] - others[shared].mean()
    scale = np.sqrt((own**2).sum(axis=1) * (other**2).sum())
    r: Values = np.divide(
        (own * other).sum(axis=1), scale, out=np.full(len(own), np.nan), where=scale > 0
    )
    return r
