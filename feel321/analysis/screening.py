"""Screening of raters: rules with limits, and lists of the raters that they flag.

Nothing here removes anybody: a flag is a reason to look, and a deletion needs a documented error. Rules without a
standard as their source are extensions, with limits by convention.

Sources: Tukey, Exploratory Data Analysis (1977), of hinges and fences; Pfister et al. (2013), doi
10.3389/fpsyg.2013.00700, of the bimodality coefficient; Recommendation ITU-R BS.1534-3 (2015), on post-screening.
"""

from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import partial
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike
from pandas import DataFrame, Series

from feel321.analysis.agreement import FLOOR, SMALLEST, gauge_raters, intraclass, krippendorff_alpha
from feel321.analysis.arrays import FLAT, Values, check_columns, read_numbers
from feel321.analysis.resampling import weighted_pearson
from feel321.analysis.table.items import (
    STIMULUS,
    Table,
    leave_rejected,
    name_stimuli,
    open_ratings,
    refuse_unnamed,
)
from feel321.analysis.table.schema import HIGHEST, LOWEST
from feel321.arguments import as_rng, check_name
from feel321.protocols.tasks import PROTOCOLS
from feel321.records import Statistic
from feel321.types import Rng

FEWEST_JUDGEMENTS = 8  # With fewer judgements, or pairs of them, a habit cannot be told from chance
REACH = 1.5  # Fences stand this many hinge spreads outside the hinges
FEWEST_RATERS = 5  # With fewer values no fence can leave one out, or a shape be seen
UNIMODAL = 5 / 9  # Multimodality of evenly spread values; above it there may be several peaks
ALL_BUT = 0.95  # Share of ratings at one step from which on nobody is taken to have used the scale
ONE_SIDED = 1.6448536269514722  # 95 % point of the normal distribution
FASTEST_S = 0.5  # Nobody feels, weighs and answers in less
EXCELLENT = 90.0  # The hidden reference is to be rated so at least, the mid anchor at most
MIDDLE = 50.0  # The low anchor at most, in the extension
MOST_RATERS = 0.25  # If more of the raters put the mid anchor above 90, it was hardly degraded
MOST_STEPS = 11  # Different ratings up to which a scale may be one of few steps
FULL = 5  # Ratings per step from which on a slider would show
SAME_POINTS = 2.0  # Ratings of a slider that lie no farther apart than this are at the same place
ANCHORS = ("mid", "low")  # Kinds of anchor: the reducer or stimulus has the word in its name
# Protocols that show the reference beside the stimuli. Limits near the end of the scale presuppose that: somebody who
# rates realism by itself, or a similarity from memory, has no reason to put the original at 90 or above.
SIGHTED = ("mushra",)
FIGURES = ("icc_a_1", "icc_a_k", "icc_c_1", "icc_c_k", "alpha")


def tukey_fences(values: ArrayLike, *, step: float = 0.0) -> tuple[float, float]:
    """Find where outlying begins: 1.5 hinge spreads, or steps of a coarse scale, outside the hinges.

    Hinges are the medians of the lower and the upper half; for odd n the median belongs to both.
    """
    ordered = np.sort(read_numbers(values, what="values").ravel())
    if not len(ordered) or not np.isfinite(ordered).all():
        got = f"got {len(ordered)}, not all finite"
        raise ValueError(f"values must be one or more finite numbers, {got}")
    half = (len(ordered) + 1) // 2
    low, high = float(np.median(ordered[:half])), float(np.median(ordered[-half:]))
    reach = REACH * max(high - low, step)
    return low - reach, high + reach


def multimodality(values: ArrayLike) -> float:
    """Measure whether values may have more than one peak: above 5/9; NaN for fewer than 4, and constants.

    (g² + 1) / (k + 3 (n - 1)² / ((n - 2)(n - 3))), g the skewness and k the excess kurtosis, corrected for n.
    With fewer than some 20 raters it scatters widely.
    """
    given = pd.Series(read_numbers(values, what="values").ravel())
    n, bad = len(given), int((~np.isfinite(given)).sum())
    if bad:
        raise ValueError(f"values must be finite, got {bad} of {n} that are not; leave them out")
    flat = float(((given - given.mean()) ** 2).sum()) <= FLAT * float((given**2).sum())
    if n < 4 or flat:  # noqa: PLR2004 - divides by n - 3
        return float("nan")
    skew, kurtosis = given.agg(["skew", "kurt"]).to_numpy(np.float64)
    return float((skew**2 + 1) / (kurtosis + 3 * (n - 1) ** 2 / ((n - 2) * (n - 3))))


def _prepare(ratings: DataFrame, *, assumed: str) -> tuple[DataFrame, list[str]]:
    """Prepare a tidy table; ratings that name no protocol are taken to be of the one assumed, if any.

    Participants are categories, all of them, so that whoever has no rating of a kind is counted with 0.
    """
    check_columns(ratings, ["participant", "rating", STIMULUS], "ratings")
    if ratings.empty:
        raise ValueError("ratings must hold a row per judgement, got no row")
    refuse_unnamed(ratings, ["participant", STIMULUS])
    values = read_numbers(ratings["rating"], what="ratings, 'rating'")
    bad = values[~((values >= LOWEST) & (values <= HIGHEST))]
    if len(bad):
        got = f"got {len(bad)} ratings such as {bad[0]:g}; leave others out"
        raise ValueError(f"ratings must lie between 0 and 100, {got}")
    ratings = ratings.assign(rating=values)
    if "repeat" in ratings:
        # As text 10 comes before 2; what is no number keeps its place in the table, behind all numbers.
        turns = pd.to_numeric(ratings["repeat"], errors="coerce")
        ratings = ratings.loc[turns.sort_values(kind="stable").index]
    naming, scale = key_stimulus(ratings), [name for name in ("scale",) if name in ratings]
    excerpt = [name for name in ("scale", "recording", "level") if name in ratings] or naming
    item, excerpts = (
        ratings.groupby(keys, observed=True, dropna=False).ngroup()
        for keys in ([*scale, *naming], excerpt)
    )
    names = ratings.loc[~item.duplicated(), [*scale, *naming]].astype(str)
    labels = names.agg("/".join, axis=1).set_axis(item[names.index])
    # Numbers and words cannot be compared with each other; each kind keeps its own order.
    whose = ratings["participant"]
    everyone = sorted(whose.unique(), key=lambda name: (isinstance(name, str), name))
    protocols, notes = _find_protocols(ratings, assumed)
    # An anchor has its kind; two test stimuli are judged as one is.
    kinds = ratings.get("role", pd.Series("test", ratings.index)).replace({"pair": "test"})
    called = ratings["reducer" if "reducer" in ratings else STIMULUS].astype(str)
    for kind in ANCHORS:
        kinds = kinds.mask((kinds == "anchor") & called.str.contains(kind, case=False), kind)
    rows = pd.DataFrame({
        "participant": pd.Categorical(whose, everyone), "item": item, "excerpt": excerpts,
        "label": item.map(labels), "kind": kinds, "protocol": protocols,
        "step": _find_steps(ratings), "rating": ratings["rating"], "time": ratings.get("response_time_s", np.nan),
    })  # fmt: skip
    return rows.reset_index(drop=True), notes


def key_stimulus(ratings: DataFrame) -> list[str]:
    """List the columns that together name what was judged against what; the level too, where there are several."""
    several = "level" in ratings and len(ratings["level"].unique()) > 1
    return [STIMULUS, *["level"] * several, *["reference_id"] * ("reference_id" in ratings)]


def _find_protocols(ratings: DataFrame, assumed: str) -> tuple[Series, list[str]]:
    """Name the protocol of every judgement: as its column says, else as its scale is called, else what is assumed."""
    none = pd.Series("", ratings.index, dtype=object)
    given = ratings.get("protocol", none).astype(object).fillna("").astype(str)
    scales = ratings.get("scale", none).astype(str)
    scales = scales.where(scales.isin(list(PROTOCOLS)), "")
    by_scale, unknown = (given == "") & (scales != ""), (given == "") & (scales == "")
    lead, notes = "No protocol is given for", []
    if by_scale.any():
        names = ", ".join(sorted(set(scales[by_scale])))
        notes.append(f"{lead} {by_scale.sum()} ratings: assumed from their scale ({names}).")
    if unknown.any() and assumed:
        how = f"assumed {assumed}, with a reference in sight"
        notes.append(f"{lead} {unknown.sum()} ratings: {how}.")
    return given.mask(by_scale, scales).mask(unknown, assumed), notes


def _find_steps(ratings: DataFrame) -> Series:
    """Find the points between two ratings of a scale of few steps; 0 where a slider was used."""

    def find_step(own: Series) -> float:
        found = np.unique(own)
        gap = float(np.diff(found).min()) if len(found) > 1 else 0.0
        few = len(found) <= MOST_STEPS and len(own) >= FULL * len(found)
        return gap if few and gap > SAME_POINTS else 0.0

    scales = ratings.get("scale", pd.Series("", ratings.index)).astype(str)
    return ratings["rating"].groupby(scales).transform(find_step)


def _tests(rows: DataFrame) -> DataFrame:
    return rows[rows["kind"] == "test"]


def _average(rows: DataFrame) -> DataFrame:
    """Average repeats of test stimuli, participants x items; NaN where there is no rating."""
    means = _tests(rows).pivot_table("rating", "participant", "item", observed=True)
    return means.reindex(rows["participant"].cat.categories)


def _pair(rows: DataFrame) -> DataFrame:
    """Pair the first and the second rating of every test stimulus rated twice."""
    tests = _tests(rows)
    turn = tests.groupby(["participant", "item"], observed=True).cumcount()
    one, two = (tests[turn == number].set_index(["participant", "item"]) for number in (0, 1))
    pairs = pd.DataFrame({"first": one["rating"], "second": two["rating"]}).dropna().reset_index()
    whose = pd.Categorical(pairs["participant"], rows["participant"].cat.categories)
    return pairs.assign(participant=whose)


def _round(rows: DataFrame) -> Series:
    """Average the variance that the steps of the scale add to each participant's ratings of test stimuli."""
    tests = _tests(rows)
    added = (tests["step"] ** 2 / 12).groupby(tests["participant"], observed=False)
    return added.mean().fillna(0.0)


def _count(rows: DataFrame) -> Series:
    return rows.groupby("participant", observed=False).size()


def _compare(
    count: Series, n: Series, share: Series, *, limit: float | Values | Series, below: bool = False
) -> DataFrame:
    """Compare a value of each participant with its limit; NaN, without judgements, flags nobody."""
    values = share.to_numpy(np.float64)
    limits = np.broadcast_to(np.asarray(limit, dtype=np.float64), share.shape)
    # 3 of 20 is 15 %, not more; a hair of rounding must not decide otherwise.
    clear = np.abs(values - limits) > 1e-12  # noqa: PLR2004 - rounding of one division
    hit = clear & ((values < limits) if below else (values > limits))
    columns = {"count": count.astype(int), "n": n.astype(int), "share": values}
    return pd.DataFrame({**columns, "limit": limits, "hit": hit}, index=share.index)


def _count_beyond(
    rows: DataFrame, limit: float, *, column: str, end: float, below: bool = False
) -> DataFrame:
    """Count how often a column of each participant is beyond an end, and compare the share with its limit."""
    known = rows[rows[column].notna()]
    bad = known[column] < end if below else known[column] > end
    count, n = _count(known[bad]), _count(known)
    return _compare(count, n, count / n.where(n > 0), limit=limit)


def _rate_anchor(rows: DataFrame, limit: float, *, kind: str, end: float) -> DataFrame:
    """Count hidden references below an end, or anchors above it, of excerpts that count."""
    judged = rows[rows["kind"] == kind]
    if kind != "low":
        mid = rows[rows["kind"] == "mid"]
        means = mid.groupby(["excerpt", "participant"], observed=True)["rating"].mean()
        shares = (means > EXCELLENT).groupby("excerpt").mean()
        judged = judged[~judged["excerpt"].isin(shares.index[shares > MOST_RATERS])]
    return _count_beyond(judged, limit, column="rating", end=end, below=kind == "reference")


def _outliers(rows: DataFrame, limit: float) -> DataFrame:
    """Find raters outside the fences of too many items."""
    means = _average(rows)
    means = means.loc[:, means.notna().sum() >= FEWEST_RATERS]
    steps = rows.groupby("item")["step"].max().reindex(means.columns)
    fences = [tukey_fences(means[item].dropna(), step=step) for item, step in steps.items()]
    low, high = np.array(fences).reshape(-1, 2).T
    outside = means.lt(low, axis=1) | means.gt(high, axis=1)
    count, n = outside.sum(axis=1), means.notna().sum(axis=1)
    return _compare(count, n, count / n.where(n > 0), limit=limit)


def _reversed_scale(rows: DataFrame, limit: float) -> DataFrame:
    """Correlate with the mean of the others; NaN for fewer than 8 items and for constant ratings."""
    means = _average(rows)
    n_others = (means.notna().sum() - means.notna()).replace(0, np.nan)
    others = ((means.sum() - means.fillna(0.0)) / n_others).where(means.notna())
    n = others.notna().sum(axis=1)
    pair = (each.fillna(0.0).to_numpy(np.float64) for each in (means, others))
    r = pd.Series(weighted_pearson(*pair, weights=others.notna().to_numpy(float)), means.index)
    return _compare(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=limit, below=True)


def _straight_lining(rows: DataFrame, limit: float) -> DataFrame:
    """Find raters who leave the slider at one place; on a scale of few steps the limit is half as far from 1."""

    def count_densest(ratings: Series) -> int:
        ordered = np.sort(ratings.to_numpy(np.float64))
        after = np.searchsorted(ordered, ordered + SAME_POINTS, side="right")
        return int((after - np.arange(len(ordered))).max(initial=0))

    tests = _tests(rows)
    n = _count(tests)
    count = tests.groupby("participant", observed=True)["rating"].agg(count_densest)
    count = count.reindex(n.index, fill_value=0)
    share = count / n.where(n >= FEWEST_JUDGEMENTS)
    usual = tukey_fences(share.dropna())[1] if share.notna().any() else limit
    widened = max(limit, min(ALL_BUT, max((1 + limit) / 2, usual)))
    return _compare(count, n, share, limit=np.where(_round(rows) > 0, widened, limit))


def _test_retest(rows: DataFrame, limit: float) -> DataFrame:
    """Correlate second ratings with first ones; NaN for fewer than 8 pairs, and where either are all the same."""
    pairs = _pair(rows)
    whose, times, n = pairs["participant"], pairs[["first", "second"]], _count(pairs)
    centred = times - times.groupby(whose, observed=True).transform("mean")
    products = (centred**2).assign(both=centred["first"] * centred["second"])
    sums = products.groupby(whose, observed=False).sum()
    constant = sums[["first", "second"]].min(axis=1) <= FLAT * HIGHEST**2 * n
    r = (sums["both"] / (sums["first"] * sums["second"]).mask(constant) ** 0.5).clip(-1, 1)
    variance = (sums[["first", "second"]].mean(axis=1) / n.where(n > 0)).mask(constant)
    left = (1 - _round(rows) / variance).clip(0, 1).fillna(1.0)
    shown = np.tanh(ONE_SIDED / np.sqrt(n.clip(lower=FEWEST_JUDGEMENTS) - 3))
    floor = np.minimum(limit, shown) * (left if limit > 0 else 1.0)
    return _compare(n, n, r.where(n >= FEWEST_JUDGEMENTS), limit=floor, below=True)


def _repeat_sd(rows: DataFrame, limit: float) -> DataFrame:
    """Find raters who rate the same stimulus far apart: random clicking."""
    pairs = _pair(rows)
    squares = (pairs["first"] - pairs["second"]) ** 2
    n = _count(pairs)
    share = np.sqrt(squares.groupby(pairs["participant"], observed=False).mean() / 2) / HIGHEST
    widened = np.sqrt(limit**2 + _round(rows) / HIGHEST**2)
    return _compare(n, n, share.where(n >= FEWEST_JUDGEMENTS), limit=widened)


class Rule(NamedTuple):
    """A rule about raters; find: prepared ratings, or the gauge for expertise, and limit -> table by participant."""

    says: str
    source: str
    limit: float
    find: Callable[[DataFrame, float], DataFrame]
    needs: str
    protocols: tuple[str, ...] = ()


STANDARD, EXTENSION = "ITU-R BS.1534-3", "extension"
EXPERTISE = "expertise"  # The rule that needs a source of randomness
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
        EXTENSION, 0.15, partial(_count_beyond, column="time", end=FASTEST_S, below=True), "column 'response_time_s'",
    ),
    "outliers": Rule(
        "outside Tukey's fences on more than {limit:.0%} of test stimuli",
        EXTENSION, 0.15, _outliers, "test stimuli that 5 raters rated",
    ),
    EXPERTISE: Rule(
        "more than {limit:.0%} of discrimination, reliability and agreement no better than shuffled ratings",
        "in the manner of Report ITU-R BS.2300", 0.5, partial(_count_beyond, column="p", end=1 - FLOOR),
        "test stimuli rated twice or by others too",
    ),
})  # fmt: skip
"""Name -> rule, in the order of reports."""


def _choose_limits(rules: Iterable[str] | None, *, random: bool) -> dict[str, float]:
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


def screen_raters(
    table: Table | DataFrame,
    rules: Iterable[str] | Mapping[str, float] | None = None,
    *,
    rng: Rng | None = None,
) -> Statistic:
    """Apply every screening rule to every rater. Nobody is removed.

    Parameters
    ----------
    table : Table or DataFrame
        One row per judgement: participant, rating (0 to 100), and stimulus_id or recording and reducer (and level);
        role, scale, protocol, repeat and response_time_s where there are any; rejected ones are left out. Anchors are
        known by ``mid`` or ``low`` in their reducer's name.
    rules : iterable of str, mapping of str to float, or None
        Names of `RULES`, or names with limits of one's own; None for all (``expertise`` with an rng only).
    rng : int, Generator or None
        Source of randomness for the permutations of ``expertise``.

    Returns
    -------
    Statistic
        ``table``, a row per rater and rule: participant, rule, count, n, share (count / n, or the value that the rule
        compares with its limit, a correlation or a standard deviation; NaN where the rule does not apply), limit, hit.
        ``count share limit hit``, the same as participants x rules; ``hits``, the raters that each rule flagged.
        ``stimuli``, per test stimulus: n raters, Tukey fences, outliers, multimodality coefficient, multimodal (above
        5/9). ``gauge``, of the rule ``expertise``: participant, measure, value, floor and p of its permutation null.
        ``panel``: reliability per scale, of everyone and without those flagged. ``limits`` asked for; ``rules notes``.

    Notes
    -----
    ITU-R BS.1534-3 excludes a rater whose hidden reference is below 90 on more than 15 % of items, or whose mid anchor
    is above 90 on more than 15 %; an item (here: scale, recording and level) whose mid anchor more than 25 % of raters
    put above 90 does not count for either. These rules, and that about the low anchor, are for MUSHRA, where the
    reference is in sight: on realism or similarity they flagged 11 of 16 ordinary raters. Ratings without a protocol
    are of the protocol that their scale is named after; others count as MUSHRA only if such a rule is asked by name.

    All other rules are extensions: state them before the data are seen, and report results with and without the
    flagged raters, who should be followed up, not automatically excluded. A scale with 11 steps or fewer is recognised
    by its ratings, and no rule flags a rater for what rounding to its steps does.

    References
    ----------
    Recommendation ITU-R BS.1534-3 (2015). Report ITU-R BS.2300-0 (2014).

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> table = pd.DataFrame({"participant": ["ann"] * 10 + ["bob"] * 10, "recording": list("abcdefghij") * 2,
    ...     "reducer": "original", "role": "reference", "rating": [95] * 9 + [80] + [95] * 8 + [80] * 2})
    >>> analysis.screen_raters(table, ["hidden_reference"]).hits
    {'hidden_reference': ('bob',)}
    """
    limits = _choose_limits(rules, random=rng is not None)
    ratings, left_out = leave_rejected(name_stimuli(open_ratings(table)))
    rows, notes = _prepare(ratings, assumed="" if rules is None else SIGHTED[0])
    measured = _tests(rows) if EXPERTISE in limits else rows.iloc[:0]
    gauge = gauge_raters(measured, _average(rows), rng=as_rng(0 if rng is None else rng))
    found, people = {}, pd.Index(rows["participant"].cat.categories, name="participant")
    for name, limit in limits.items():
        own = RULES[name].protocols
        meant = rows[rows["protocol"].isin(own)] if own else rows
        part = RULES[name].find(gauge if name == EXPERTISE else meant, limit)
        found[name] = part.set_axis(people)
    parts = [part.reset_index().assign(rule=name) for name, part in found.items()]
    screened = pd.concat(parts, ignore_index=True)
    screened = screened[["participant", "rule", "count", "n", "share", "limit", "hit"]]
    hits = {name: tuple(part.index[part["hit"]]) for name, part in found.items()}
    flagged = {who for whom in hits.values() for who in whom}
    return Statistic(
        "Screening", table=screened, hits=hits, rules=tuple(limits), limits=limits,
        stimuli=_describe_items(rows), gauge=gauge.astype({"participant": people.dtype}),
        panel=_describe_panel(ratings, flagged), notes=(*left_out, *_explain(rows, notes, found)),
        **{
            what: pd.DataFrame({name: part[what] for name, part in found.items()}).rename_axis(columns="rule")
            for what in ("count", "share", "limit", "hit")
        },
    )  # fmt: skip


def _describe_panel(ratings: DataFrame, hit: set[object]) -> DataFrame:
    """Measure the reliability of ratings of test stimuli per scale, with and without the raters that a rule flagged."""
    tests = ratings
    if "role" in ratings:
        tests = ratings[~ratings["role"].isin(["reference", "anchor"])]
    tests = tests if "scale" in tests else tests.assign(scale="")
    left, rows = tests[~tests["participant"].isin(list(hit))], []
    for scale in sorted(tests["scale"].unique()):
        for name, part in (("everyone", tests), ("without hits", left)):
            own = part[part["scale"] == scale]
            keys = key_stimulus(own)
            votes = own.pivot_table("rating", keys, "participant", observed=True).to_numpy(float)
            complete = votes[np.isfinite(votes).all(axis=1)]
            figures: dict[str, object] = dict.fromkeys(FIGURES, float("nan"))
            if min(complete.shape) >= SMALLEST:
                icc = intraclass(complete)
                figures |= {figure: getattr(icc, figure) for figure in FIGURES[:-1]}
            if (np.isfinite(votes).sum(axis=1) >= SMALLEST).sum() >= SMALLEST:
                figures["alpha"] = krippendorff_alpha(votes)
            rows.append((scale, name, votes.shape[1], len(votes), len(complete), *figures.values()))
    columns = ["scale", "panel", "n_participants", "n_items", "n_complete", *FIGURES]
    return pd.DataFrame(rows, columns=columns)


def _describe_items(rows: DataFrame) -> DataFrame:
    """Describe the raters' means of each test stimulus: fences, outliers, and whether they have several peaks."""
    tests, means, found = _tests(rows).groupby("item"), _average(rows), []
    for item, label, step in zip(means, tests["label"].first(), tests["step"].max(), strict=True):
        own = means[item].dropna().to_numpy(np.float64)
        low, high = tukey_fences(own, step=step)
        outliers = int(((own < low) | (own > high)).sum())
        found.append((label, len(own), low, high, outliers, multimodality(own)))
    columns = ["item", "n", "low_fence", "high_fence", "outliers", "multimodality"]
    described = pd.DataFrame(found, columns=columns)
    return described.assign(multimodal=described["multimodality"] > UNIMODAL)


def _explain(rows: DataFrame, assumed: list[str], found: Mapping[str, DataFrame]) -> Iterator[str]:
    """Name the protocol that was assumed, the rules that are not meant for what was rated, and those without data."""
    bound = [name for name in found if RULES[name].protocols]
    unsighted = not rows["protocol"].isin(SIGHTED).any()
    yield from assumed if bound else ()
    if bound and unsighted:
        known = " and ".join(sorted(set(rows["protocol"]) - {""}))
        of = f"these are of {known}" if known else "a column protocol that says so is missing"
        names = f"Rule{'' if len(bound) == 1 else 's'} {', '.join(map(repr, bound))}"
        yield f"{names} not applied: for MUSHRA ratings, where the reference is in sight; {of}."
    for name, part in found.items():
        silent = int(part["share"].isna().sum())
        if silent and not (name in bound and unsighted):
            whom = "" if silent == len(part) else f" to {silent} of {len(part)} participants"
            yield f"Rule '{name}' not applied{whom}: it needs {RULES[name].needs}."
