"""The classic tests of two correlations that share a variable: for comparison with the literature."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from feel321.analysis.arrays import PERFECT, find_p, fisher_interval
from feel321.records import Result

FEWEST = 4
"""Cases that Fisher's z and Williams' t need at least: both divide by n - 3."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Dependent(Result):
    """Four comparisons of the correlation of j with k to that of j with h.

    Parameters
    ----------
    difference : float
        r_jk - r_jh.
    williams_t, williams_df, williams_p : float
        Williams' t, its n - 3 degrees of freedom, two-sided p.
    steiger_z, steiger_p : float
        Steiger's modification of Dunn and Clark's z, with the averaged correlation; two-sided p.
    meng_z, meng_p : float
        Meng, Rosenthal and Rubin's z; two-sided p.
    zou_low, zou_high : float
        Zou's 95 % interval of the difference.
    notes : tuple of str
        Why anything is NaN, one sentence each.
    """

    difference: float
    williams_t: float
    williams_df: int
    williams_p: float
    steiger_z: float
    steiger_p: float
    meng_z: float
    meng_p: float
    zou_low: float
    zou_high: float
    notes: tuple[str, ...] = ()


class _Triple(NamedTuple):
    """The correlations of j with k and with h, of k with h, and the number of cases."""

    first: float
    second: float
    between: float
    n: int

    @property
    def determinant(self) -> float:
        """Of the three variables' correlation matrix; negative where no three variables correlate so."""
        squares = self.first**2 + self.second**2 + self.between**2
        return 1 - squares + 2 * self.first * self.second * self.between


def compare_dependent(r_jk: float, r_jh: float, r_kh: float, n: int) -> Dependent:  # noqa: PLR0917 - the order of cocor
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
    Dependent
        Williams' t, Steiger's and Meng's z, and Zou's interval.

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
        Zou       low  = r1 - r2 - √((r1 - l1)² + (u2 - r2)² - 2 c (r1 - l1)(u2 - r2))
                  high = r1 - r2 + √((u1 - r1)² + (r2 - l2)² - 2 c (u1 - r1)(r2 - l2))
                  (l, u) Fisher's intervals,
                  c = ((r12 - r1 r2/2)(1 - r1² - r2² - r12²) + r12³) / ((1 - r1²)(1 - r2²))

    **Not for conclusions in this field.** Stimuli of one recording are not independent: with equal true
    correlations these tests find a difference in 19 to 36 % of studies. Use `compare_metrics`. A perfect
    correlation has no Fisher's z, and only Williams' t is given then.

    References
    ----------
    Williams (1959), J. R. Stat. Soc. B 21, 396-399, doi 10.1111/j.2517-6161.1959.tb00346.x.
    Steiger (1980), Psychological Bulletin 87, 245-251, doi 10.1037/0033-2909.87.2.245.
    Meng, Rosenthal & Rubin (1992), Psychological Bulletin 111, 172-175, doi 10.1037/0033-2909.111.1.172.
    Zou (2007), Psychological Methods 12, 399-413, doi 10.1037/1082-989X.12.4.399.
    Diedenhofen & Musch (2015), PLoS ONE 10, e0121945, doi 10.1371/journal.pone.0121945.

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

    given = _Triple(float(r_jk), float(r_jh), float(r_kh), int(n) if np.isfinite(n) else 0)
    _check_triple(given, n)
    williams = _williams(given)
    steiger = meng = zou_low = zou_high = float("nan")
    notes = []
    if max(abs(given.first), abs(given.second)) < PERFECT:
        steiger, meng = _steiger(given), _meng(given)
        zou_low, zou_high = _zou(given)
    else:
        notes.append("A perfect correlation has no Fisher's z: no Steiger, Meng or Zou.")
    if np.isnan(williams):
        notes.append("Williams' t is not defined: the three variables determine each other.")
    return Dependent(
        given.first - given.second, williams, given.n - 3, float(2 * t.sf(abs(williams), given.n - 3)),
        steiger, find_p(steiger), meng, find_p(meng), zou_low, zou_high, tuple(notes),
    )  # fmt: skip


def _check_triple(given: _Triple, n: float) -> None:
    for name, value in (("r_jk", given.first), ("r_jh", given.second), ("r_kh", given.between)):
        if not abs(value) <= 1:
            raise ValueError(f"{name} must be -1 to 1, got {value}")
    if n != given.n or given.n < FEWEST:
        raise ValueError(f"n must be a whole number of cases, {FEWEST} or more, got {n}")
    if given.between >= PERFECT:
        raise ValueError(
            f"r_kh must be below 1, got {given.between}: the two variables compared are one; leave one out"
        )
    if given.determinant < PERFECT - 1:
        raise ValueError(
            f"r_kh must be possible with r_jk {given.first} and r_jh {given.second}, got {given.between}: no three "
            f"variables correlate like that (determinant {given.determinant:.3g}); take all three from the same cases"
        )


def _williams(given: _Triple) -> float:
    n, mean = given.n, (given.first + given.second) / 2
    spread = (
        2 * (n - 1) / (n - 3) * max(given.determinant, 0.0) + mean**2 * (1 - given.between) ** 3
    )
    if spread <= 1 - PERFECT:
        return float("nan")
    return float((given.first - given.second) * np.sqrt((n - 1) * (1 + given.between) / spread))


def _subtract_z(given: _Triple) -> float:
    return float(np.arctanh(given.first) - np.arctanh(given.second))


def _steiger(given: _Triple) -> float:
    r12, square = given.between, ((given.first + given.second) / 2) ** 2
    covariance = r12 * (1 - 2 * square) - square * (1 - 2 * square - r12**2) / 2
    spread = 2 - 2 * covariance / (1 - square) ** 2
    return _subtract_z(given) * float(np.sqrt((given.n - 3) / spread))


def _meng(given: _Triple) -> float:
    square = (given.first**2 + given.second**2) / 2
    f = min(1.0, (1 - given.between) / (2 * (1 - square)))
    h = (1 - f * square) / (1 - square)
    return _subtract_z(given) * float(np.sqrt((given.n - 3) / (2 * (1 - given.between) * h)))


def _zou(given: _Triple) -> tuple[float, float]:
    r1, r2, r12, n = given
    (low1, high1), (low2, high2) = (fisher_interval(r, n - 3) for r in (r1, r2))
    c = ((r12 - r1 * r2 / 2) * (1 - r1**2 - r2**2 - r12**2) + r12**3) / ((1 - r1**2) * (1 - r2**2))

    def reach(first: float, second: float) -> float:
        # max: rounding may push a vanishing sum of squares below 0
        return float(np.sqrt(max(0.0, first**2 + second**2 - 2 * c * first * second)))

    return r1 - r2 - reach(r1 - low1, high2 - r2), r1 - r2 + reach(high1 - r1, r2 - low2)
