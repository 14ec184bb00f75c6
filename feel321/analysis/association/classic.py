"""Classic tests, for comparison with the literature: two correlations that share a variable, and repeated measures."""

import numpy as np
from numpy.typing import ArrayLike

from feel321.analysis.arrays import (
    FLAT,
    PERFECT,
    check_labels,
    find_p,
    fisher_interval,
    read_array,
    read_groups,
)
from feel321.analysis.table.items import Table, is_tidy, open_tests
from feel321.records import Statistic

FEWEST = 4
"""Cases that Fisher's z and Williams' t need at least: both divide by n - 3."""


def compare_dependent(r_jk: float, r_jh: float, r_kh: float, n: int) -> Statistic:  # noqa: PLR0917 - the order of cocor
    """Compare two correlations of the same cases that share the variable j.

    Parameters
    ----------
    r_jk, r_jh : float
        The two correlations: of the ratings j with one metric k, and with another h.
    r_kh : float
        Correlation of the two metrics.
    n : int
        Number of cases, at least 4.

    Returns
    -------
    Statistic
        ``difference`` r_jk - r_jh; ``williams_t williams_df williams_p``, ``steiger_z steiger_p``, ``meng_z meng_p``,
        two-sided; ``zou_low zou_high``, the 95 % interval of the difference; ``notes``, why anything is NaN.

    Notes
    -----
    Model: n independent draws from a trivariate normal distribution. With r1 = r_jk, r2 = r_jh, r12 = r_kh,
    r̄ their mean, and z Fisher's transform::

        Williams  t(n - 3) = (r1 - r2) √((n - 1)(1 + r12) / (2 (n - 1)/(n - 3) |R| + r̄² (1 - r12)³))
                  |R| = 1 - r1² - r2² - r12² + 2 r1 r2 r12
        Steiger   Z = (z1 - z2) √(n - 3) / √(2 - 2c)
                  c = (r12 (1 - 2r̄²) - r̄² (1 - 2r̄² - r12²)/2) / (1 - r̄²)²
        Meng      Z = (z1 - z2) √((n - 3) / (2 (1 - r12) h)),  h = (1 - f q)/(1 - q)
                  q = (r1² + r2²)/2,  f = min(1, (1 - r12)/(2 (1 - q)))
        Zou       r1 - r2 ∓ √(a² + b² - 2 c a b), a and b the distances to Fisher's limits on that side,
                  c = ((r12 - r1 r2/2)(1 - r1² - r2² - r12²) + r12³) / ((1 - r1²)(1 - r2²))

    **Not for conclusions in this field.** Stimuli of one recording are not independent: with equal true
    correlations these tests find a difference in 19 to 36 % of studies. Use `compare_metrics`.

    References
    ----------
    Williams (1959), doi 10.1111/j.2517-6161.1959.tb00346.x; Steiger (1980), doi 10.1037/0033-2909.87.2.245; Meng,
    Rosenthal & Rubin (1992), doi 10.1037/0033-2909.111.1.172; Zou (2007), doi 10.1037/1082-989X.12.4.399.

    Examples
    --------
    Zou (2007), example of overlapping correlations:

    >>> from feel321 import analysis
    >>> result = analysis.compare_dependent(0.396, 0.179, 0.088, 66)
    >>> round(result.zou_low, 3), round(result.zou_high, 3)
    (-0.093, 0.517)
    >>> round(result.williams_t, 2), result.williams_df, round(result.meng_p, 2)
    (1.38, 63, 0.17)
    """
    from scipy.stats import t

    r1, r2, r12 = float(r_jk), float(r_jh), float(r_kh)
    # Of the three variables' correlation matrix; negative where no three variables correlate so.
    determinant = 1 - r1**2 - r2**2 - r12**2 + 2 * r1 * r2 * r12
    for name, value in (("r_jk", r1), ("r_jh", r2), ("r_kh", r12)):
        if not abs(value) <= 1:
            raise ValueError(f"{name} must be -1 to 1, got {value}")
    if not n >= FEWEST or n != np.floor(n) or np.isinf(n):
        raise ValueError(f"n must be a whole number of cases, {FEWEST} or more, got {n}")
    if r12 >= PERFECT or determinant < PERFECT - 1:
        raise ValueError(
            f"r_kh must be below 1 and possible with r_jk {r1} and r_jh {r2}, got {r12}: no three variables correlate "
            "like that; take all three from the same cases"
        )
    n, mean, nan = int(n), (r1 + r2) / 2, float("nan")
    spread = 2 * (n - 1) / (n - 3) * max(determinant, 0.0) + mean**2 * (1 - r12) ** 3
    williams, notes = nan, list[str]()
    if spread > 1 - PERFECT:
        williams = float((r1 - r2) * np.sqrt((n - 1) * (1 + r12) / spread))
    else:
        notes.append("Williams' t is not defined: the three variables determine each other.")
    steiger = meng = low = high = nan
    if max(abs(r1), abs(r2)) < PERFECT:
        steiger, meng, low, high = _compare_z(r1, r2, r12, n)
    else:
        notes.append("A perfect correlation has no Fisher's z: no Steiger, Meng or Zou.")
    return Statistic(
        "Dependent", difference=r1 - r2, williams_t=williams, williams_df=n - 3,
        williams_p=float(2 * t.sf(abs(williams), n - 3)), steiger_z=steiger, steiger_p=find_p(steiger),
        meng_z=meng, meng_p=find_p(meng), zou_low=low, zou_high=high, notes=tuple(notes),
    )  # fmt: skip


def _compare_z(r1: float, r2: float, r12: float, n: int) -> tuple[float, float, float, float]:  # noqa: PLR0917 - as in the formulas
    """Compute Steiger's and Meng's z, and the ends of Zou's interval."""
    apart, square = float(np.arctanh(r1) - np.arctanh(r2)), ((r1 + r2) / 2) ** 2
    covariance = r12 * (1 - 2 * square) - square * (1 - 2 * square - r12**2) / 2
    steiger = apart * float(np.sqrt((n - 3) / (2 - 2 * covariance / (1 - square) ** 2)))
    q = (r1**2 + r2**2) / 2
    f = min(1.0, (1 - r12) / (2 * (1 - q)))
    h = (1 - f * q) / (1 - q)
    meng = apart * float(np.sqrt((n - 3) / (2 * (1 - r12) * h)))
    (low1, high1), (low2, high2) = (fisher_interval(r, n - 3) for r in (r1, r2))
    c = ((r12 - r1 * r2 / 2) * (1 - r1**2 - r2**2 - r12**2) + r12**3) / ((1 - r1**2) * (1 - r2**2))
    # max: rounding may push a vanishing sum of squares below 0
    down, up = (
        float(np.sqrt(max(0.0, one**2 + other**2 - 2 * c * one * other)))
        for one, other in ((r1 - low1, high2 - r2), (high1 - r1, r2 - low2))
    )
    return steiger, meng, r1 - r2 - down, r1 - r2 + up


def repeated_measures_correlation(
    x: Table | ArrayLike, y: str | ArrayLike, participant: ArrayLike | None = None
) -> Statistic:
    """Correlate x and y within participants.

    Parameters
    ----------
    x : Table, DataFrame or array_like, shape (n,)
        Ratings of test stimuli; or the values of one variable, one row per judgement.
    y : str or array_like, shape (n,)
        The metric that ratings are correlated with; or the other variable.
    participant : array_like, shape (n,), optional
        Who each row belongs to, unless x holds ratings.

    Returns
    -------
    Statistic
        ``r``, NaN where x or y does not vary within any participant; ``df p``, two-sided; ``low high``, the 95 %
        interval; ``n n_participants notes``.

    Notes
    -----
    Model: y = a line with one common slope and an intercept per participant, plus independent errors of equal
    spread. r is the correlation of x and y, each with its participant's mean taken off; with N rows and P
    participants df = N - P - 1, t = r √(df / (1 - r²)), and the interval is tanh(atanh r ± 1.96 / √(df - 1)):
    Fisher's z with n = df + 2 (rmcorr from 0.5 on; earlier releases and the paper took n = df).

    **Its p is not for conclusions here.** Rows of one stimulus are taken for independent evidence on the
    metric; when they are not, this test finds a relation in half of the studies where there is none. Use
    `correlate`, or the mixed model.

    References
    ----------
    Bland & Altman (1995), doi 10.1136/bmj.310.6977.446; Bakdash & Marusich (2017), doi 10.3389/fpsyg.2017.00456.

    Examples
    --------
    Both participants rate better matches higher, though the one who felt the better matches rates lower overall:

    >>> x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    >>> from feel321 import analysis
    >>> result = analysis.repeated_measures_correlation(x, y, ["a", "a", "a", "b", "b", "b"])
    >>> round(result.r, 3), result.df, round(result.p, 4)
    (0.987, 3, 0.0018)
    """
    from scipy.stats import t

    if is_tidy(x) and isinstance(y, str):
        rows, _ = open_tests(x, (y,))
        x, y, participant = rows[y].to_numpy(), rows["rating"].to_numpy(), rows["participant"]
    check_labels(x, y, what="y")
    first, second = (read_array(one, what=name, axes=("n",)) for one, name in ((x, "x"), (y, "y")))
    names = np.asarray(participant).ravel()
    if not first.shape == second.shape == names.shape:
        raise ValueError(
            f"x, y and participant must have one length, got {len(first)}, {len(second)} and {names.size}"
        )
    number, people = read_groups(names, n=len(names), what="row", of="participant")
    df = len(first) - len(people) - 1
    if df < 1:
        raise ValueError(
            f"participant must have at least participants + 2 rows, got {len(first)} rows of {len(people)} participants"
        )
    rest, notes, r = [], list[str](), float("nan")
    for name, values in (("x", first), ("y", second)):
        rest.append(values - (np.bincount(number, values) / np.bincount(number))[number])
        if (rest[-1] ** 2).sum() <= FLAT * (values**2).sum():
            notes.append(f"No correlation: {name} does not vary within any participant.")
    one, other = rest
    if not notes:
        r = float(np.clip(one @ other / np.sqrt((one @ one) * (other @ other)), -1, 1))
    low, high = fisher_interval(r, df - 1)
    if np.isnan(low) and not notes:
        notes = [
            "No interval: the correlation is perfect, or fewer than 2 degrees of freedom are left."
        ]
    p = 0.0 if abs(r) >= PERFECT else float(2 * t.sf(abs(r) * np.sqrt(df / (1 - r**2)), df))
    return Statistic(
        "RepeatedMeasures", r=r, df=df, p=p, low=low, high=high, n=len(first), n_participants=len(people),
        notes=tuple(notes[:1]),
    )  # fmt: skip
