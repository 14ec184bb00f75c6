"""Judgements of two stimuli: choices that metrics predict, ABX trials, and dissimilarities against identical pairs.

Choices: a row is one choice, about the stimulus that was felt first (``stimulus_id``); ``other_id`` is the second one;
the rating is 100 where the first was chosen and 0 where the second was. Differences of metrics are first minus second,
turned so that a positive difference speaks for the first: a metric of which a larger value is worse is negated. A
metric is asked only about pairs of test stimuli whose reference is the recording itself or the real surface, which is
what metrics compare with; the recording itself and the anchors are far from everything and would flatter every metric.

Dissimilarities: an identical pair is noise, a reduction beside its original is signal; both are rated on the same
slider, so that whoever cannot feel a difference rates both alike. Each participant is compared with himself or herself.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from types import MappingProxyType
from typing import overload

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pandas import DataFrame, MultiIndex, factorize
from scipy.optimize import brentq
from scipy.special import expit, logit
from scipy.stats import binomtest, norm, t

from feel321.analysis.arrays import CONFIDENCE, UPPER, Values, check_columns
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.table.columns import order_reducers
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Table, open_ratings
from feel321.analysis.table.schema import ANSWERED, CHOSEN, HIGHEST, PAIRED
from feel321.arguments import as_names, check_name
from feel321.records import Statistic
from feel321.types import REDUCER_NAMES

Codes = NDArray[np.intp]
CHANCE = 0.5  # Share of choices that a metric predicts, or of answers that are right, by guessing
FEWEST = 3  # Participants and recordings below which the share of choices has no interval
LEAST = 2  # Participants that an interval over participants needs
EVERY = "all reducers"
LARGEST = 12.0  # From here on a d' is perfect to rounding: an error in 10^6 trials or fewer
# Observer's model -> divisor of d' in the second factor of the share correct; the first is always √2
SPREADS: Mapping[str, float] = MappingProxyType({
    "independent": 2.0, "differencing": float(np.sqrt(6)),
})  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class Votes:
    """Votes as arrays, (n_votes,): numbers of participants, sources and pairs, and whether the first was chosen.

    source: recordings, or what they were made from where several come from one. pair: the two stimuli and their
    reference, whichever came first. turned: whether the first is the second of its pair by name. differences:
    (n_votes, n_metrics).
    """

    participant: Codes
    source: Codes
    pair: Codes
    turned: NDArray[np.bool_]
    chose_first: NDArray[np.bool_]
    metrics: tuple[str, ...]
    differences: Values
    notes: tuple[str, ...] = ()

    def count(self, codes: Codes) -> int:
        """Count the participants, sources or pairs."""
        return int(codes.max(initial=-1)) + 1

    @property
    def n_units(self) -> int:
        """Participants or sources, whichever are fewer: intervals know no more than the scarcer of the two."""
        return min(self.count(self.participant), self.count(self.source))


def gather_votes(table: Table, metrics: Sequence[str] = ()) -> Votes:
    """Gather the votes of one scale; with metrics, those that the metrics are asked about."""
    if table.stimuli is None:
        raise ValueError("table must be one of read_table, got one without stimuli")
    rows = table.rows[table.rows["scale"].isin(CHOSEN)]
    listed, names = table.stimuli, as_names(metrics, "metrics")
    if len(several := sorted(rows["scale"].unique())) > 1:
        got = f"got {', '.join(several)}; name one"
        raise ValueError(f"scale must be given where there are several, {got}")
    if rows.empty:
        raise ValueError("table must hold a choice between two stimuli or more, got none")
    notes: list[str] = []
    if names:
        check_columns(listed, names, "stimuli")
        both = [rows[name] for name in (STIMULUS, OTHER)]
        is_test = np.logical_and(*(ids.map(listed[ROLE]).to_numpy() == TEST for ids in both))
        is_known = listed[list(names)].notna().all(axis=1)
        kept = is_test & rows["matched"].to_numpy(bool)
        kept &= np.logical_and(*(ids.map(is_known).to_numpy(bool) for ids in both))
        if lost := int((is_test & ~kept).sum()):
            why = "have another reference than the recording, or a stimulus without a value of some metric"
            notes.append(f"{lost} choices {why}: no metric is tested on them.")
        if not kept.any():
            raise ValueError(notes[0] if notes else "No choice is between two test stimuli.")
        rows = rows[kept]
    one, other = (rows[name].astype(str).to_numpy() for name in (STIMULUS, OTHER))
    known, codes = np.unique(np.concatenate([one, other]), return_inverse=True)
    first, second = np.split(codes.astype(np.intp), 2)
    reference = rows["reference_id"].fillna("").to_numpy()
    ends = [np.minimum(first, second), np.maximum(first, second), reference]
    worse = [name in table.info and table.info[name].higher == "worse" for name in names]
    values = listed.loc[known, list(names)].to_numpy(np.float64) * np.where(worse, -1.0, 1.0)
    return Votes(
        participant=factorize(rows["participant"])[0], source=factorize(rows[STIMULUS].map(listed["source"]))[0],
        pair=factorize(MultiIndex.from_arrays(ends))[0], turned=first > second,
        chose_first=(rows["rating"] == HIGHEST).to_numpy(), metrics=names,
        differences=values[first] - values[second], notes=tuple(notes),
    )  # fmt: skip


def predict(votes: Votes) -> Statistic:
    """Count how many votes each metric predicts: the one for the stimulus with its better value.

    ``shares``, indexed by metric: ``share`` of votes predicted, a tie counting half, its 95 % two-way interval ``low
    high``, ``p`` against chance (0.5), ``p_holm`` and ``n_ties``; ``differences`` of two metrics' shares, likewise;
    ``others others_low others_high``, the share that the majority of the other participants made of the same pair, and
    ``majority``, that of all: the ceiling from both sides (Nili et al. 2014, doi 10.1371/journal.pcbi.1003553).

    Intervals hold for other people and other recordings: the variance is that of clustering by participants and by
    recordings (Cameron, Gelbach & Miller 2011, doi 10.1198/jbes.2010.07136), V_P + V_R - V_PR, each part multiplied by
    G / (G - 1) for G groups, and never less than V_P or V_R; 95 % t intervals with U - 1 degrees of freedom, U the
    smaller number of the two, of shares on the scale of log odds. Below 3 participants or recordings there is none.
    A bootstrap of both counts the noise of choices three times: in 300 simulated studies of a metric without effect it
    found one in 0 to 2 %, this variance in 1 to 5 % (nominal 5 %).
    """
    # 1 predicted, 0 not, 0.5 where the metric of the two is the same.
    hits = (1 + np.sign(votes.differences) * np.where(votes.chose_first, 1.0, -1.0)[:, None]) / 2
    others, majority = agree_with_others(votes)
    names = pd.Index(votes.metrics, name="metric")
    shares = DataFrame([infer_share(votes, column) for column in hits.T], index=names)
    shares = shares.assign(n_ties=(hits == CHANCE).sum(axis=0))
    compared = []
    for one, two in combinations(range(len(names)), 2):
        each = hits[:, one] - hits[:, two]
        value = float(each.mean())
        margin, p = _infer(votes, value, (each - value) / len(each))
        compared.append((names[one], names[two], value, value - margin, value + margin, p))
    columns = ["first", "second", "difference", "low", "high", "p"]
    differences = DataFrame(compared, columns=columns)
    is_known = np.isfinite(others).mean() >= CHANCE
    lacks = {
        "Below 3 participants or 3 recordings there is no interval.": votes.n_units < FEWEST,
        "Fewer than half of the choices were also made by somebody else: how well people agree cannot be "
        "estimated.": not is_known,
    }
    alike = infer_share(votes, others if is_known else np.full(len(votes.pair), np.nan))
    return Statistic(
        "VotePrediction",
        shares=shares.assign(p_holm=adjust_holm(shares["p"].tolist())),
        differences=differences.assign(p_holm=adjust_holm(differences["p"].tolist())),
        others=alike["share"], others_low=alike["low"], others_high=alike["high"],
        majority=float(majority.mean()) if is_known else np.nan,
        n_votes=len(votes.pair), n_participants=votes.count(votes.participant), n_recordings=votes.count(votes.source),
        n_pairs=votes.count(votes.pair), notes=(*votes.notes, *(lack for lack, holds in lacks.items() if holds)),
    )  # fmt: skip


def agree_with_others(votes: Votes) -> tuple[Values, Values]:
    """Score every vote by the majority on its pair, of the other participants (NaN for none), and of all; draws 0.5."""
    # Votes for the stimulus of each pair that is first by name.
    voted = votes.chose_first != votes.turned
    for_low, cast = np.bincount(votes.pair, voted)[votes.pair], np.bincount(votes.pair)[votes.pair]
    both = np.stack([votes.pair, votes.participant])
    own = np.unique(both, axis=1, return_inverse=True)[1].ravel()
    rest, n_rest = for_low - np.bincount(own, voted)[own], cast - np.bincount(own)[own]
    side = np.where(voted, 1, -1)
    others = np.where(n_rest > 0, (1 + np.sign(2 * rest - n_rest) * side) / 2, np.nan)
    return others, (1 + np.sign(2 * for_low - cast) * side) / 2


def infer_share(votes: Votes, scores: Values) -> dict[str, float]:
    """Give the mean of scores, (n_votes,), its interval on the scale of log odds, and p; NaN scores are left out."""
    known = np.isfinite(scores)
    share = float(scores[known].mean()) if known.any() else np.nan
    if not 0 < share < 1:
        return {"share": share, "low": np.nan, "high": np.nan, "p": np.nan}
    influence = np.where(known, scores - share, 0.0) / known.sum() / (share * (1 - share))
    centre = float(logit(share))
    margin, p = _infer(votes, centre, influence)
    low, high = float(expit(centre - margin)), float(expit(centre + margin))
    return {"share": share, "low": low, "high": high, "p": p}


def _infer(votes: Votes, value: float, influence: Values) -> tuple[float, float]:
    """Give the margin of the 95 % interval, and p of no effect, from the influence of each vote, (n_votes,)."""
    cells, parts = votes.participant * votes.count(votes.source) + votes.source, []
    for groups in (votes.participant, votes.source, cells):
        sums = np.bincount(np.unique(groups, return_inverse=True)[1], influence)
        # G / (G - 1) for G groups
        parts.append(float(sums @ sums) * len(sums) / max(len(sums) - 1, 1))
    one, other, both = parts
    error, units = float(np.sqrt(max(one + other - both, one, other))), votes.n_units
    if units < FEWEST or not error > 0:
        return np.nan, np.nan
    margin = float(t.ppf(UPPER, units - 1)) * error
    return margin, float(2 * t.sf(abs(value) / error, units - 1))


@overload
def discriminate(n_correct: int, n_trials: int) -> Statistic: ...


@overload
def discriminate(n_correct: Table | DataFrame) -> DataFrame: ...


def discriminate(
    n_correct: int | Table | DataFrame, n_trials: int | None = None
) -> Statistic | DataFrame:
    """Evaluate ABX trials.

    Parameters
    ----------
    n_correct : int, Table or DataFrame
        Trials of one pair of stimuli answered correctly; or ratings, whose ABX answers are taken per level and reducer,
        each against its reference.
    n_trials : int, optional
        Trials, at least 1; half of them with X = A, so that no bias for a button can pose as discrimination.

    Returns
    -------
    Statistic or DataFrame
        ``share`` correct, its 95 % intervals ``wilson_low wilson_high`` and ``exact_low exact_high``
        (Clopper-Pearson); ``p`` of as many or more by guessing; d' under two models of the observer,
        ``d_independent`` and ``d_differencing``, each with ``_low`` and ``_high``; ``n_correct n_trials notes``. Of
        ratings, a row per level and reducer.

    Notes
    -----
    Model: an unbiased observer, A and B normal with equal spread and d' apart. With Φ the normal distribution
    function the share correct is ::

        independent observations   Φ(d'/√2) Φ(d'/2)  + Φ(-d'/√2) Φ(-d'/2)
        differencing               Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6)

    Which of the two people use is not known from shares alone; with A and B fixed over many trials the first is likely,
    when the pair roves the second. Ends of the interval of d' are the d' of the ends of Wilson's interval. Trials are
    taken for independent: pooled over people, the interval is about these people. A share below .5 has d' 0.

    References
    ----------
    Macmillan & Creelman (2005), Detection Theory: A User's Guide, 2nd ed., chapter 9, table A5.3; Hautus & Meng
    (2002), doi 10.3758/BF03194559; Wilson (1927), doi 10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> from feel321 import analysis
    >>> result = analysis.discriminate(18, 24)
    >>> round(result.share, 2), round(result.p, 4), round(result.d_independent, 2), round(result.d_differencing, 2)
    (0.75, 0.0113, 1.79, 2.02)
    >>> round(result.wilson_low, 3), round(result.wilson_high, 3)
    (0.551, 0.88)
    """
    if not isinstance(n_correct, int | float | np.number):
        rows = open_ratings(n_correct)
        check_columns(rows, ["scale", "level", "reducer", "role", "rating"], "ratings")
        answers = rows[(rows["scale"] == ANSWERED) & (rows["role"] != "reference")]
        return DataFrame([
            {"level": level, "reducer": reducer}
            | dict(discriminate(int((part["rating"] == HIGHEST).sum()), len(part)))
            for (level, reducer), part in answers.groupby(["level", "reducer"], observed=True)
        ])
    n_trials = 0 if n_trials is None else n_trials
    whole = all(float(count).is_integer() for count in (n_correct, n_trials))
    if not whole or not 0 <= n_correct <= n_trials or n_trials < 1:
        got = f"got {n_correct} of {n_trials}"
        raise ValueError(f"n_correct must be 0 to n_trials, of 1 or more trials, {got}")
    test = binomtest(int(n_correct), int(n_trials), CHANCE, alternative="greater")
    both = binomtest(int(n_correct), int(n_trials), CHANCE)
    wilson, exact = (both.proportion_ci(CONFIDENCE, method) for method in ("wilson", "exact"))
    share = n_correct / n_trials
    ends = {"": share, "_low": float(wilson.low), "_high": float(wilson.high)}
    each = [(model, end) for model in SPREADS for end in ends]
    d_primes = {f"d_{model}{end}": abx_d_prime(ends[end], model=model) for model, end in each}
    notes = ["All are correct: d' is unbounded, only its lower end is known."] * (share == 1)
    if share < CHANCE:
        notes = ["Fewer than half are correct: d' is 0; chance, or answers mixed up."]
    return Statistic(
        "Discrimination", share=share, wilson_low=ends["_low"], wilson_high=ends["_high"],
        exact_low=float(exact.low), exact_high=float(exact.high), p=float(test.pvalue), **d_primes,
        n_correct=int(n_correct), n_trials=int(n_trials), notes=tuple(notes),
    )  # fmt: skip


def abx_d_prime(share: float, *, model: str = "independent") -> float:
    """Find d' at which an unbiased observer reaches a share correct in ABX trials; 0 for .5 or less, infinity for 1."""
    check_name(model, SPREADS, "model")
    if not 0 <= share <= 1:
        raise ValueError(f"share must be 0 to 1, got {share}")

    def surplus(d_prime: float) -> float:
        scaled = d_prime / np.array([np.sqrt(2), SPREADS[model]])
        return float(norm.cdf(scaled).prod() + norm.cdf(-scaled).prod()) - share

    if share <= CHANCE:
        return 0.0
    if surplus(LARGEST) <= 0:
        return float("inf")
    return float(brentq(surplus, 0, LARGEST, xtol=1e-12))


def compare_with_original(rows: DataFrame) -> DataFrame:
    """Compare every reducer's dissimilarities from the original with identical pairs; a row per reducer, all last."""
    paired = rows[rows["scale"] == PAIRED]
    is_same = paired["reducer"] == paired["reference_reducer"]
    same = paired[(paired["role"] == "reference") & is_same]
    whole = (paired["reference_reducer"] != "") & ~paired["reference_reducer"].isin(REDUCER_NAMES)
    apart = paired[(paired["role"] == TEST) & whole]
    if same.empty or apart.empty:
        lack = "identical pairs" if same.empty else "pairs with the original"
        must = "dissimilarities must hold pairs with the original and identical ones"
        raise ValueError(f"{must}, got no {lack}")
    names = order_reducers(apart["reducer"])
    told = {name: tell_apart(apart[apart["reducer"] == name], same) for name in names}
    holm = adjust_holm([one["p"] for one in told.values()])
    found = [{"reducer": k, **told[k], "p_holm": p} for k, p in zip(names, holm, strict=True)]
    if len(found) > 1:
        every = tell_apart(apart, same)
        found.append({"reducer": EVERY, **every, "p_holm": every.p})
    return DataFrame(found)


def tell_apart(apart: DataFrame, same: DataFrame) -> Statistic:
    """Compare ratings of different pairs with those of identical ones, participant by participant.

    difference: mean dissimilarity from the original less that of identical pairs, in points, over participants, with a
    95 % t interval, t, df and two-sided p. area: chance that a participant rates a pair with the original above an
    identical one (ties count half), mean over participants, with a t interval cut to 0..1; d_prime: √2 Φ⁻¹(area)
    (Macmillan & Creelman 2005, chapter 3), and what the interval translates to; infinite for an area of 1.
    """
    people = sorted(set(apart["participant"]) & set(same["participant"]))
    if len(people) < LEAST:
        must = f"a comparison with identical pairs needs {LEAST} participants who rated both"
        raise ValueError(f"{must}, got {len(people)}")
    gaps, areas = [], []
    for who in people:
        rated = (part.loc[part["participant"] == who, "rating"] for part in (apart, same))
        far, near = (ratings.to_numpy(np.float64) for ratings in rated)
        gaps.append(far.mean() - near.mean())
        # The area under the ROC curve: the chance that one of far is above one of near.
        areas.append(0.5 + np.sign(far[:, None] - near[None, :]).mean() / 2)
    mean, error, reach, p = infer_mean(gaps)
    area, spread, _, _ = infer_mean(areas)
    low, high = max(0.0, area - reach * spread), min(1.0, area + reach * spread)
    d_prime, d_low, d_high = (float(math.sqrt(2) * norm.ppf(end)) for end in (area, low, high))
    statistic = mean / error if error else math.copysign(math.inf, mean) if mean else math.nan
    return Statistic(
        "ToldApart", difference=mean, low=mean - reach * error, high=mean + reach * error, t=statistic,
        df=float(len(people) - 1), p=p, area=area, area_low=low, area_high=high, d_prime=d_prime, d_prime_low=d_low,
        d_prime_high=d_high, n_participants=len(people), n_judgements=len(apart), n_identical=len(same),
    )  # fmt: skip


def infer_mean(values: Sequence[float]) -> tuple[float, float, float, float]:
    """Average over units: mean, standard error, their number in a 95 % interval, p of a mean of 0."""
    n = len(values)
    mean = float(np.mean(values)) if n else math.nan
    if n < LEAST:
        return mean, math.nan, math.nan, math.nan
    error = float(np.std(values, ddof=1)) / math.sqrt(n)
    p = float(2 * t.sf(abs(mean) / error, n - 1)) if error else float(mean == 0)
    return mean, error, float(t.ppf(UPPER, n - 1)), p
