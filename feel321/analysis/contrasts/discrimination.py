"""Can two stimuli be told apart? ABX trials: share correct, d' and the chance of guessing as well."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

CONFIDENCE = 0.95
GUESSING = 0.5
"""Share that comes out right by guessing."""

LARGEST = 12.0
"""From here on a d' is perfect to rounding: an error in 10^6 trials or fewer."""

SPREADS: Mapping[str, float] = MappingProxyType({
    "independent": 2.0,
    "differencing": float(np.sqrt(6)),
})
"""Observer's model -> divisor of d' in the second factor of the share correct; the first is always √2."""


@dataclass(frozen=True, slots=True)
class Discrimination:
    """How well two stimuli are told apart in ABX trials.

    Parameters
    ----------
    share : float
        Correct answers over trials.
    wilson_low, wilson_high : float
        95 % Wilson interval of the share.
    exact_low, exact_high : float
        95 % Clopper-Pearson interval of the share: never too narrow, usually wider than needed.
    p : float
        Chance of as many correct answers or more by guessing; exact, one-sided.
    d_independent, d_independent_low, d_independent_high : float
        d' of an observer who judges A, B and X each on its own, and what the Wilson interval translates to;
        0 for a share of .5 or less, infinity for 1.
    d_differencing, d_differencing_low, d_differencing_high : float
        d' of an observer who compares X with A and with B; larger for the same share.
    n_correct, n_trials : int
        What it rests on.
    notes : tuple of str
        What is to be read with care, one sentence each.
    """

    share: float
    wilson_low: float
    wilson_high: float
    exact_low: float
    exact_high: float
    p: float
    d_independent: float
    d_independent_low: float
    d_independent_high: float
    d_differencing: float
    d_differencing_low: float
    d_differencing_high: float
    n_correct: int
    n_trials: int
    notes: tuple[str, ...] = ()


def discriminate(n_correct: int, n_trials: int) -> Discrimination:
    """Evaluate ABX trials of one pair of stimuli.

    Parameters
    ----------
    n_correct : int
        Trials answered correctly.
    n_trials : int
        Trials, at least 1; half of them with X = A, so that no bias for a button can pose as hearing.

    Returns
    -------
    Discrimination
        Share, intervals, test and d' under two models of the observer.

    Raises
    ------
    ValueError
        If the counts are not whole, or not 0 <= n_correct <= n_trials with n_trials of 1 or more.

    Notes
    -----
    Model: an unbiased observer, A and B normal with equal spread and d' apart. With Φ the normal distribution
    function the share correct is ::

        independent observations   Φ(d'/√2) Φ(d'/2)  + Φ(-d'/√2) Φ(-d'/2)
        differencing               Φ(d'/√2) Φ(d'/√6) + Φ(-d'/√2) Φ(-d'/√6)

    Which of the two people use is not known from shares alone; with A and B fixed over many trials the first
    is likely, when the pair roves the second. Ends of the interval of d' are the d' of the ends of Wilson's
    interval. Trials are taken for independent: pooled over people, the interval is about these people. A
    share below .5 has d' 0: chance, or answers mixed up.

    References
    ----------
    Macmillan & Creelman (2005), Detection Theory: A User's Guide, 2nd ed., chapter 9, table A5.3.
    Hautus & Meng (2002), Perception & Psychophysics 64, 89-106, doi 10.3758/BF03194559.
    Wilson (1927), JASA 22, 209-212, doi 10.1080/01621459.1927.10502953.

    Examples
    --------
    >>> result = discriminate(18, 24)
    >>> round(result.share, 2), round(result.p, 4), round(result.d_independent, 2), round(result.d_differencing, 2)
    (0.75, 0.0113, 1.79, 2.02)
    >>> round(result.wilson_low, 3), round(result.wilson_high, 3)
    (0.551, 0.88)
    """
    from scipy.stats import binomtest

    whole = all(float(count).is_integer() for count in (n_correct, n_trials))
    if not whole or not 0 <= n_correct <= n_trials or n_trials < 1:
        raise ValueError(
            f"n_correct: got {n_correct} of {n_trials}, allowed is 0 to n_trials, of 1 or more trials"
        )
    test = binomtest(int(n_correct), int(n_trials), GUESSING, alternative="greater")
    both = binomtest(int(n_correct), int(n_trials), GUESSING)
    wilson, exact = (
        both.proportion_ci(CONFIDENCE, "wilson"),
        both.proportion_ci(CONFIDENCE, "exact"),
    )
    share = n_correct / n_trials
    shares = (share, float(wilson.low), float(wilson.high))
    alone = [abx_d_prime(value, model="independent") for value in shares]
    compared = [abx_d_prime(value, model="differencing") for value in shares]
    return Discrimination(
        share=share,
        wilson_low=shares[1],
        wilson_high=shares[2],
        exact_low=float(exact.low),
        exact_high=float(exact.high),
        p=float(test.pvalue),
        d_independent=alone[0],
        d_independent_low=alone[1],
        d_independent_high=alone[2],
        d_differencing=compared[0],
        d_differencing_low=compared[1],
        d_differencing_high=compared[2],
        n_correct=int(n_correct),
        n_trials=int(n_trials),
        notes=_explain(share),
    )


def discriminate_pairs(trials: DataFrame) -> dict[tuple[str, str] | None, Discrimination]:
    """Evaluate ABX trials pair by pair, and pooled.

    Parameters
    ----------
    trials : DataFrame
        One row per trial: ``first`` and ``second``, the two stimuli, in either order, and ``correct``, true
        or false (or 1 or 0).

    Returns
    -------
    dict
        Pair, in alphabetical order -> its result; None -> all trials pooled.

    Raises
    ------
    ValueError
        If a column is missing, there is no row, a stimulus is not named or paired with itself, or an answer
        is neither true nor false.

    Notes
    -----
    The pooled d' is that of the pooled share, which is smaller than the mean d' when pairs differ in
    difficulty.

    Examples
    --------
    >>> import pandas as pd
    >>> trials = pd.DataFrame({"first": ["a", "b", "a", "a"], "second": ["b", "a", "c", "c"],
    ...     "correct": [True, True, False, True]})
    >>> {pair: result.share for pair, result in discriminate_pairs(trials).items()}
    {('a', 'b'): 1.0, ('a', 'c'): 0.5, None: 0.75}
    """
    missing = [name for name in ("first", "second", "correct") if name not in trials]
    if missing:
        raise ValueError(
            f"trials: column {', '.join(missing)} is missing; needed are first, second, correct"
        )
    if trials.empty:
        raise ValueError("trials: got no row, allowed is one trial or more")
    unnamed = int(trials[["first", "second"]].isna().any(axis=1).sum())
    if unnamed:
        raise ValueError(
            f"trials: got {unnamed} rows without a first or second stimulus; name or leave them out"
        )
    names = np.sort(trials[["first", "second"]].astype(str).to_numpy(dtype=np.str_), axis=1)
    alike = names[names[:, 0] == names[:, 1]]
    if len(alike):
        raise ValueError(f"trials: got '{alike[0, 0]}' against itself; leave such rows out")
    if not trials["correct"].isin([True, False]).all():
        odd = trials["correct"][~trials["correct"].isin([True, False])].iloc[0]
        raise ValueError(
            f"trials: got {odd!r} in column 'correct', allowed is true or false; leave lapses out"
        )
    correct = trials["correct"].to_numpy().astype(np.int64)
    pairs, number = np.unique(names, axis=0, return_inverse=True)
    results: dict[tuple[str, str] | None, Discrimination] = {}
    for place, (first, second) in enumerate(pairs.tolist()):
        of_pair = correct[number.ravel() == place]
        results[first, second] = discriminate(int(of_pair.sum()), len(of_pair))
    results[None] = discriminate(int(correct.sum()), len(correct))
    return results


def abx_d_prime(share: float, *, model: str = "independent") -> float:
    """Distance in standard deviations at which an unbiased observer reaches a share correct in ABX trials.

    Parameters
    ----------
    share : float
        Share correct, 0 to 1.
    model : str
        ``independent`` observations or ``differencing``.

    Returns
    -------
    float
        d'; 0 for a share of .5 or less, infinity for 1.

    Raises
    ------
    ValueError
        If the share is not between 0 and 1, or the model is unknown.

    Examples
    --------
    An observer with hits .75 and false alarms .3, freed of bias:

    >>> from scipy.stats import norm
    >>> unbiased = norm.cdf((norm.ppf(0.75) - norm.ppf(0.3)) / 2)
    >>> round(abx_d_prime(unbiased), 2), round(abx_d_prime(unbiased, model="differencing"), 2)
    (1.66, 1.87)
    """
    from scipy.optimize import brentq

    if model not in SPREADS:
        raise ValueError(f"model: got {model!r}, allowed is one of {', '.join(SPREADS)}")
    if not 0 <= share <= 1:
        raise ValueError(f"share: got {share}, allowed is 0 to 1")
    if share <= GUESSING:
        return 0.0
    if share >= _share_correct(LARGEST, model):
        return float("inf")
    return float(brentq(lambda d: _share_correct(d, model) - share, 0, LARGEST, xtol=1e-12))


def _share_correct(d_prime: float, model: str) -> float:
    from scipy.stats import norm

    scaled = d_prime / np.array([np.sqrt(2), SPREADS[model]])
    return float(norm.cdf(scaled).prod() + norm.cdf(-scaled).prod())


def _explain(share: float) -> tuple[str, ...]:
    if share < GUESSING:
        return ("Fewer than half are correct: d' is 0; chance, or answers mixed up.",)
    return ("All are correct: d' is unbounded, only its lower end is known.",) if share == 1 else ()
