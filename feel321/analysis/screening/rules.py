"""RULES: the one list of screening rules, with the source and the limit of each; and the measures behind them.

Rules without a standard as their source are extensions, with limits by convention. Expertise (discrimination,
reliability, agreement) is judged against a permutation null, in the manner of Report ITU-R BS.2300; the measures are
defined here, because the data need not be balanced.

References
----------
.. [1] J. W. Tukey, Exploratory Data Analysis, 1977: hinges and fences.
.. [2] R. Pfister et al., Good things peak in pairs: a note on the bimodality coefficient, Frontiers in Psychology 4,
   2013, 700. doi:10.3389/fpsyg.2013.00700
.. [3] Recommendation ITU-R BS.1534-3 (2015), Method for the subjective assessment of intermediate quality level of
   audio systems, on post-screening of assessors.
.. [4] Lorho, Le Ray & Zacharov (2010), eGauge: a measure of assessor expertise in audio quality evaluations, AES 38th
   International Conference.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.arrays import FLAT, check_columns, read_numbers
from feel321.analysis.resampling import FEWEST_ITEMS
from feel321.analysis.table.items import STIMULUS
from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.doors import check_name
from feel321.protocols.tasks import PROTOCOLS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from pandas import DataFrame, Index, Series

    from feel321.analysis.arrays import Values

FEWEST_JUDGEMENTS = 8  # With fewer judgements, or pairs of them, a habit cannot be told from chance
REACH = 1.5  # Fences stand this many hinge spreads outside the hinges
FEWEST_RATERS = 5  # With fewer values no fence can leave one out, or a shape be seen
UNIMODAL = 5 / 9
"""Multimodality coefficient of evenly spread values; above it, ratings may have more than one peak."""

ALL_BUT = 0.95  # Share of ratings at one step from which on nobody is taken to have used the scale
ONE_SIDED = 1.6448536269514722  # 95 % point of the normal distribution
FASTEST_S = 0.5  # Nobody feels, weighs and answers in less
EXCELLENT, MIDDLE = 90.0, 50.0
"""The hidden reference is to be rated at least 90, the mid anchor at most; the low anchor, in the extension, 50."""

MOST_RATERS = 0.25
"""If a larger share of raters puts the mid anchor above `EXCELLENT`, the excerpt was hardly degraded by it."""

MOST_STEPS, FULL = 11, 5
"""Different ratings up to which a scale may be one of few steps; ratings per step from which a slider would show."""

SAME_POINTS = 2.0  # Ratings of a slider that lie no farther apart than this are at the same place
FLOOR, PERMUTATIONS = 0.95, 499
"""Share of permutations that an expert's measure exceeds, and how many there are."""

MEASURES = ("discrimination", "reliability", "agreement")
GAUGED = ["participant", "measure", "value", "floor", "p"]
ANCHORS = ("mid", "low")
"""Kinds of anchor, known by the name of their reducer or stimulus containing the word."""


def tukey_hinges(values: ArrayLike) -> tuple[float, float]:
    """Medians of the lower and the upper half; for odd n the median belongs to both."""
    ordered = np.sort(read_numbers(values, what="values").ravel())
    if not len(ordered) or not np.isfinite(ordered).all():
        got = f"got {len(ordered)}, not all finite"
        raise ValueError(f"values must be one or more finite numbers, {got}")
    half = (len(ordered) + 1) // 2
    return float(np.median(ordered[:half])), float(np.median(ordered[-half:]))


def tukey_fences(values: ArrayLike, *, step: float = 0.0) -> tuple[float, float]:
    """Find where outlying begins: 1.5 hinge spreads, or steps of a coarse scale, outside the hinges."""
    low, high = tukey_hinges(values)
    reach = REACH * max(high - low, step)
    return low - reach, high + reach


def multimodality(values: ArrayLike) -> float:
    """Measure whether values may have more than one peak: above 5/9 [2]_; NaN for fewer than 4, and constants.

    (g² + 1) / (k + 3 (n - 1)² / ((n - 2)(n - 3))), g the skewness and k the excess kurtosis, corrected for n.
    With fewer than some 20 raters it scatters widely.
    """
    given = read_numbers(values, what="values").ravel()
    n = len(given)
    if not np.isfinite(given).all():
        bad = int((~np.isfinite(given)).sum())
        raise ValueError(f"values must be finite, got {bad} of {n} that are not; leave them out")
    centred = given - given.mean() if n else given
    if n < 4 or (centred**2).sum() <= FLAT * (given**2).sum():  # noqa: PLR2004 - divides by n - 3
        return float("nan")
    # SciPy's skew and kurtosis take a hundred times as long for so few values.
    square, cube, fourth = (float((centred**power).mean()) for power in (2, 3, 4))
    g = cube / square**1.5 * np.sqrt(n * (n - 1)) / (n - 2)
    k = ((n + 1) * (fourth / square**2 - 3) + 6) * (n - 1) / ((n - 2) * (n - 3))
    return float((g**2 + 1) / (k + 3 * (n - 1) ** 2 / ((n - 2) * (n - 3))))


# Ratings prepared for screening.


@dataclass(frozen=True, slots=True, eq=False)
class Judgements:
    """Ratings with what a rule needs to know of each; items: names of the items by number."""

    rows: DataFrame
    participants: Index
    items: Series
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

    def rounding(self) -> Values:
        """Average the variance that the steps of the scale add to each participant's ratings of test stimuli."""
        tests = self.of_kind("test")
        added = (tests["step"] ** 2 / 12).groupby(tests["participant"].to_numpy(), observed=True)
        return added.mean().reindex(self.participants, fill_value=0.0).to_numpy(np.float64)

    def count(self, whose: Series) -> Series:
        """Count rows by participant."""
        sizes = whose.groupby(whose.to_numpy(), observed=True).size()
        return sizes.reindex(self.participants, fill_value=0)


def key_stimulus(ratings: DataFrame) -> list[str]:
    """List the columns that together name what was judged against what; the level too, where there are several."""
    several = "level" in ratings and len(ratings["level"].unique()) > 1
    return [STIMULUS, *["level"] * several, *["reference_id"] * ("reference_id" in ratings)]


def make_judgements(ratings: DataFrame, *, assumed: str = "") -> Judgements:
    """Prepare a tidy table; ratings that name no protocol are taken to be of the one assumed, if any."""
    check_columns(ratings, ["participant", "rating", STIMULUS], "ratings")
    if ratings.empty:
        raise ValueError("ratings must hold a row per judgement, got no row")
    for name in ("participant", STIMULUS):
        if nameless := int(ratings[name].isna().sum()):
            got = f"got {nameless} rows without a {name}; name it or leave them out"
            raise ValueError(f"ratings must all be named, {got}")
    values = ratings["rating"].to_numpy(np.float64)
    bad = values[~((values >= LOWEST) & (values <= HIGHEST))]
    if len(bad):
        got = f"got {len(bad)} ratings such as {bad[0]:g}; leave others out"
        raise ValueError(f"ratings must lie between 0 and 100, {got}")
    if "repeat" in ratings:
        # As text 10 comes before 2; what is no number keeps its place in the table, behind all numbers.
        turns = pd.to_numeric(ratings["repeat"], errors="coerce")
        ratings = ratings.loc[turns.sort_values(kind="stable").index]
    naming, scale = key_stimulus(ratings), [name for name in ("scale",) if name in ratings]
    excerpt = [name for name in ("scale", "recording", "level") if name in ratings] or naming
    item = [*scale, *naming]
    excerpts, items = (
        ratings.groupby(keys, observed=True, dropna=False).ngroup().to_numpy()
        for keys in (excerpt, item)
    )
    protocols, notes = _find_protocols(ratings, assumed)
    times = ratings.get("response_time_s", pd.Series(np.nan, ratings.index))
    rows = pd.DataFrame({
        "participant": ratings["participant"].to_numpy(), "item": items, "excerpt": excerpts,
        "kind": _find_kinds(ratings), "protocol": protocols, "step": _find_steps(ratings),
        "rating": ratings["rating"].to_numpy(np.float64), "time": times.to_numpy(np.float64),
    })  # fmt: skip
    # Numbers and words cannot be compared with each other; each kind keeps its own order.
    everyone = sorted(rows["participant"].unique(), key=lambda name: (isinstance(name, str), name))
    names = ratings[item].assign(number=items).drop_duplicates("number").set_index("number")
    labels = names.astype(str).agg("/".join, axis=1)
    return Judgements(rows, pd.Index(everyone, name="participant"), labels, notes)


def _find_kinds(ratings: DataFrame) -> NDArray[np.object_]:
    if "role" not in ratings:
        return np.full(len(ratings), "test", dtype=object)
    # A pair of two test stimuli is a judgement like any other of test stimuli.
    kinds = ratings["role"].replace({"pair": "test"}).to_numpy(dtype=object, copy=True)
    names = ratings["reducer"] if "reducer" in ratings else ratings[STIMULUS]
    anchored = ratings["role"].eq("anchor").to_numpy()
    for kind in ANCHORS:
        kinds[anchored & names.astype(str).str.contains(kind, case=False).to_numpy()] = kind
    return kinds


def _find_protocols(
    ratings: DataFrame, assumed: str
) -> tuple[NDArray[np.object_], tuple[str, ...]]:
    """Name the protocol of every judgement: as its column says, else as its scale is called, else what is assumed."""
    of_scale = dict(zip(PROTOCOLS, PROTOCOLS, strict=True))
    given = scales = np.full(len(ratings), "", dtype=object)
    if "protocol" in ratings:
        given = ratings["protocol"].astype(object).fillna("").astype(str).to_numpy(object)
    if "scale" in ratings:
        scales = ratings["scale"].astype(str).map(of_scale).fillna("").to_numpy(object)
    by_scale, unknown = (given == "") & (scales != ""), (given == "") & (scales == "")
    lead, notes = "No protocol is given for", []
    if by_scale.any():
        names = f"assumed from their scale ({', '.join(sorted(set(scales[by_scale])))})"
        notes.append(f"{lead} {by_scale.sum()} ratings: {names}.")
    if unknown.any() and assumed:
        sight = f"assumed {assumed}, with a reference in sight"
        notes.append(f"{lead} {unknown.sum()} ratings: {sight}.")
    return np.where(by_scale, scales, np.where(unknown, assumed, given)), tuple(notes)


def _find_steps(ratings: DataFrame) -> Values:
    """Find the points between two ratings of a scale of few steps; 0 where a slider was used."""
    steps, values = np.zeros(len(ratings)), ratings["rating"].to_numpy(np.float64)
    scales = ratings["scale"].astype(str).to_numpy() if "scale" in ratings else steps.astype(str)
    for scale in np.unique(scales):
        own = scales == scale
        found = np.unique(values[own])
        gap = float(np.diff(found).min()) if len(found) > 1 else 0.0
        if gap > SAME_POINTS and len(found) <= MOST_STEPS and own.sum() >= FULL * len(found):
            steps[own] = gap
    return steps


# What each rule finds of every participant: a table of count, n, share (NaN without judgements), limit and hit.


def compare_values(
    count: Series, n: Series, share: Series, *, limit: float | Values, below: bool = False
) -> DataFrame:
    """Compare a value of each participant with its limit; NaN flags nobody."""
    values = share.to_numpy(np.float64)
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), share.shape)
    # 3 of 20 is 15 %, not more; a hair of rounding must not decide otherwise.
    clear = np.abs(values - limits) > 1e-12  # noqa: PLR2004 - rounding of one division
    hit = clear & ((values < limits) if below else (values > limits))
    columns = {"count": count.astype(int), "n": n.astype(int), "share": values}
    return pd.DataFrame({**columns, "limit": limits, "hit": hit}, index=share.index)


def _count_bad(judgements: Judgements, rows: DataFrame, bad: Series, *, limit: float) -> DataFrame:
    """Count how often each participant did what a rule forbids, and compare the share with its limit."""
    count, n = (judgements.count(part["participant"]) for part in (rows[bad], rows))
    return compare_values(count, n, count / n.where(n > 0), limit=limit)


def _rate_anchor(judgements: Judgements, limit: float, *, kind: str, end: float) -> DataFrame:
    """Count hidden references below an end, or anchors above it, of excerpts that count."""
    mid, rows = judgements.of_kind("mid"), judgements.of_kind(kind)
    if kind != "low":
        means = mid.groupby(["excerpt", "participant"], observed=True)["rating"].mean()
        shares = (means > EXCELLENT).groupby("excerpt").mean()
        rows = rows[~rows["excerpt"].isin(shares.index[shares > MOST_RATERS])]
    bad = rows["rating"] < end if kind == "reference" else rows["rating"] > end
    return _count_bad(judgements, rows, bad, limit=limit)


def _too_fast(judgements: Judgements, limit: float) -> DataFrame:
    timed = judgements.rows[judgements.rows["time"].notna()]
    return _count_bad(judgements, timed, timed["time"] < FASTEST_S, limit=limit)


def _outliers(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters outside the fences of too many items."""
    means = judgements.means()
    means = means.loc[:, means.notna().sum() >= FEWEST_RATERS]
    steps = judgements.rows.groupby("item")["step"].max().reindex(means.columns)
    pairs = zip(means, steps, strict=True)
    fences = [tukey_fences(means[item].dropna(), step=step) for item, step in pairs]
    low, high = np.array(fences).reshape(-1, 2).T
    outside = means.lt(low, axis=1) | means.gt(high, axis=1)
    count, n = outside.sum(axis=1), means.notna().sum(axis=1)
    return compare_values(count, n, count / n.where(n > 0), limit=limit)


def _reversed_scale(judgements: Judgements, limit: float) -> DataFrame:
    """Correlate with the mean of the others; NaN for fewer than 8 items and for constant ratings."""
    means = judgements.means()
    n_others = (means.notna().sum() - means.notna()).replace(0, np.nan)
    others = ((means.sum() - means.fillna(0.0)) / n_others).where(means.notna())
    n, found = others.notna().sum(axis=1), []
    for one, two in zip(means.to_numpy(), others.to_numpy(np.float64), strict=True):
        both = np.isfinite(one) & np.isfinite(two)
        few = both.sum() < FEWEST_JUDGEMENTS or 0 in {np.ptp(one[both]), np.ptp(two[both])}
        found.append(np.nan if few else float(np.corrcoef(one[both], two[both])[0, 1]))
    r = pd.Series(found, means.index, dtype=np.float64)
    return compare_values(n, n, r, limit=limit, below=True)


def _straight_lining(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who leave the slider at one place; on a scale of few steps the limit is half as far from 1."""

    def count_densest(ratings: Series) -> int:
        ordered = np.sort(ratings.to_numpy(np.float64))
        after = np.searchsorted(ordered, ordered + SAME_POINTS, side="right")
        return int((after - np.arange(len(ordered))).max())

    tests = judgements.of_kind("test")
    grouped = tests.groupby("participant", observed=True)["rating"]
    count = grouped.agg(count_densest).reindex(judgements.participants, fill_value=0)
    n = judgements.count(tests["participant"])
    share = count / n.where(n >= FEWEST_JUDGEMENTS)
    usual = tukey_fences(share.dropna())[1] if share.notna().any() else limit
    widened = max(limit, min(ALL_BUT, max((1 + limit) / 2, usual)))
    limits = np.where(judgements.rounding() > 0, widened, limit)
    return compare_values(count, n, share, limit=limits)


def _test_retest(judgements: Judgements, limit: float) -> DataFrame:
    """Correlate second ratings with first ones; NaN for fewer than 8 pairs, and where either are all the same."""
    pairs = judgements.first_two()
    whose, times = pairs["participant"], pairs[["first", "second"]]
    centred = times - times.groupby(whose, observed=True).transform("mean")
    products = (centred**2).assign(both=centred["first"] * centred["second"])
    sums = products.groupby(whose, observed=True).sum().reindex(judgements.participants)
    n = judgements.count(whose)
    constant = sums[["first", "second"]].min(axis=1) <= FLAT * HIGHEST**2 * n
    r = (sums["both"] / (sums["first"] * sums["second"]).mask(constant) ** 0.5).clip(-1, 1)
    variance = (sums[["first", "second"]].mean(axis=1) / n.where(n > 0)).mask(constant)
    left = (1 - pd.Series(judgements.rounding(), variance.index) / variance).clip(0, 1).fillna(1.0)
    shown = np.tanh(ONE_SIDED / np.sqrt(n.clip(lower=FEWEST_JUDGEMENTS).to_numpy() - 3))
    floor = np.minimum(limit, shown) * (left.to_numpy() if limit > 0 else 1.0)
    return compare_values(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=floor, below=True)


def _repeat_sd(judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who rate the same stimulus far apart: random clicking."""
    pairs = judgements.first_two()
    squares = ((pairs["first"] - pairs["second"]) ** 2).groupby(pairs["participant"], observed=True)
    n = judgements.count(pairs["participant"])
    share = np.sqrt(squares.mean().reindex(judgements.participants) / 2) / HIGHEST
    widened = np.sqrt(limit**2 + judgements.rounding() / HIGHEST**2)
    return compare_values(n, n, share.where(n >= FEWEST_JUDGEMENTS), limit=widened)


# Expertise of raters against their own shuffled ratings.


def check_expertise(gauge: DataFrame, judgements: Judgements, limit: float) -> DataFrame:
    """Find raters who are no better than their own shuffled ratings; gauge: as `gauge_raters` gives it."""
    defined = gauge[gauge["value"].notna()]
    return _count_bad(judgements, defined, defined["p"] > 1 - FLOOR, limit=limit)


def gauge_raters(
    judgements: Judgements, *, permutations: int = PERMUTATIONS, rng: np.random.Generator
) -> DataFrame:
    """Measure how expert each rater is: participant, measure, value, floor (95 % of its null), p.

    From one rater's one-way analysis of variance, items against repeats, with mean squares M_items and M_repeats:
    discrimination is M_items / M_repeats (do stimuli differ for this rater beyond the rater's own noise?), reliability
    is the panel's average M_items / M_repeats (is the noise small against what there is to hear or feel?), agreement
    is Pearson's r with the mean of the others over items. Shuffling ratings over trials keeps how a rater uses the
    scale and destroys everything else. Rarely use it to exclude: raters who differ are not thereby wrong. [4]_
    """
    tests, means = judgements.of_kind("test"), judgements.means()
    people = [
        (who, own["item"].to_numpy(), own["rating"].to_numpy())
        for who, own in tests.groupby("participant", observed=True)
    ]
    between = [_mean_squares(item, rating[None])[1][0] for _, item, rating in people]
    panel_square = float(np.nanmean(between)) if np.isfinite(between).any() else float("nan")
    rows: list[list[object]] = []
    for participant, item, rating in people:
        shuffled = rng.permuted(np.broadcast_to(rating, (permutations, len(rating))), axis=1)
        averages, square, within = _mean_squares(item, np.vstack([rating, shuffled]))
        others = means.drop(index=participant).mean().reindex(np.unique(item)).to_numpy()
        with np.errstate(invalid="ignore", divide="ignore"):
            measured = square / within, panel_square / within, _agree(averages, others)
        for name, values in zip(MEASURES, measured, strict=True):
            value, null = float(values[0]), values[1:][~np.isnan(values[1:])]
            told: list[object] = [participant, name, value, np.nan, np.nan]
            if not np.isnan(value) and len(null):
                told[3] = float(np.quantile(null, FLOOR, method="higher"))
                told[4] = (1 + int((null >= value).sum())) / (1 + len(null))
            rows.append(told)
    return pd.DataFrame(rows, columns=GAUGED)


def _mean_squares(item: NDArray[np.intp], ratings: Values) -> tuple[Values, Values, Values]:
    """Average each item, and take the mean squares between items and within; NaN for constants and without repeats."""
    _, place, counts = np.unique(item, return_inverse=True, return_counts=True)
    starts = np.cumsum(counts) - counts
    order = np.argsort(place, kind="stable")
    means = np.add.reduceat(ratings[:, order], starts, axis=1) / counts
    n_items, spare = len(counts), len(place) - len(counts)
    nothing = np.full(len(ratings), np.nan)
    if n_items < 2 or not spare:  # noqa: PLR2004 - a variance needs two
        return means, nothing, nothing
    grand = ratings.mean(axis=1, keepdims=True)
    between = (counts * (means - grand) ** 2).sum(axis=1) / (n_items - 1)
    within = ((ratings - means[:, place]) ** 2).sum(axis=1) / spare
    constant = np.ptp(ratings, axis=1) == 0
    return means, np.where(constant, np.nan, between), np.where(constant, np.nan, within)


def _agree(means: Values, others: Values) -> Values:
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


# The list.

STANDARD, EXTENSION = "ITU-R BS.1534-3", "extension"

EXPERTISE, EXPERTISE_LIMIT = "expertise", 0.5
"""The rule that needs a source of randomness: more than half of its measures are no better than chance."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule about raters; find: judgements and limit -> table by participant, None where it takes a gauge."""

    says: str
    source: str
    limit: float
    find: Callable[[Judgements, float], DataFrame] | None
    needs: str
    protocols: tuple[str, ...] = ()


SIGHTED = ("mushra",)
"""Protocols that show the reference beside the stimuli. Limits near the end of the scale presuppose that: somebody who
rates realism by itself, or a similarity from memory, has no reason to put the original at 90 or above."""

RULES: Mapping[str, Rule] = MappingProxyType({
    "hidden_reference": Rule(
        "hidden reference below 90 on more than {limit:.0%} of items", STANDARD, 0.15,
        partial(_rate_anchor, kind="reference", end=EXCELLENT), "MUSHRA ratings of a stimulus with role 'reference'",
        SIGHTED,
    ),
    "mid_anchor": Rule(
        "mid anchor above 90 on more than {limit:.0%} of items", STANDARD, 0.15,
        partial(_rate_anchor, kind="mid", end=EXCELLENT), "MUSHRA ratings of an anchor named mid", SIGHTED,
    ),
    "low_anchor": Rule(
        "low anchor above 50 on more than {limit:.0%} of items", EXTENSION, 0.15,
        partial(_rate_anchor, kind="low", end=MIDDLE), "MUSHRA ratings of an anchor named low", SIGHTED,
    ),
    "straight_lining": Rule(
        "more than {limit:.0%} of ratings within 2 points of each other",
        EXTENSION, 0.5, _straight_lining, "8 ratings of test stimuli",
    ),
    "test_retest": Rule(
        "correlation of first and second ratings below {limit:g}, or what so many pairs show to be above zero",
        EXTENSION, 0.3, _test_retest, "8 test stimuli rated twice, not all alike",
    ),
    "repeat_sd": Rule(
        "standard deviation of repeated ratings above {limit:.0%} of the scale",
        EXTENSION, 0.2, _repeat_sd, "8 test stimuli rated twice",
    ),
    "reversed_scale": Rule(
        "correlation with the mean of the others below {limit:g}",
        EXTENSION, -0.3, _reversed_scale, "8 test stimuli that others rated too, not all alike",
    ),
    "too_fast": Rule(
        "more than {limit:.0%} of answers within 0.5 s",
        EXTENSION, 0.15, _too_fast, "column 'response_time_s'",
    ),
    "outliers": Rule(
        "outside Tukey's fences on more than {limit:.0%} of test stimuli",
        EXTENSION, 0.15, _outliers, "test stimuli that 5 raters rated",
    ),
    EXPERTISE: Rule(
        "more than {limit:.0%} of discrimination, reliability and agreement no better than shuffled ratings",
        "in the manner of Report ITU-R BS.2300", EXPERTISE_LIMIT, None, "test stimuli rated twice or by others too",
    ),
})  # fmt: skip
"""Name -> rule, in the order of reports."""


def choose_limits(
    rules: Iterable[str] | Mapping[str, float] | None, *, random: bool
) -> dict[str, float]:
    """Settle which rules apply and their limits: name -> limit, in the order of `RULES`."""
    if rules is None:
        return {name: rule.limit for name, rule in RULES.items() if random or name != EXPERTISE}
    wanted = [rules] if isinstance(rules, str) else list(rules)
    if not wanted:
        raise ValueError(f"rules must name one or more of {', '.join(RULES)}; got no rule")
    for name in wanted:
        check_name(name, RULES, "rules")
    if EXPERTISE in wanted and not random:
        raise ValueError(f"rules must go without {EXPERTISE!r}, or with rng for its permutations")
    own = dict(rules) if isinstance(rules, Mapping) else {}
    for name, limit in own.items():
        if not -1 <= limit <= 1:
            got = f"got the limit {limit} for {name!r}"
            raise ValueError(f"rules must have limits from -1 to 1, a share, not per cent; {got}")
    return {name: float(own.get(name, RULES[name].limit)) for name in RULES if name in wanted}
