"""ITU-T P.1401, correlations that share a variable, and those of repeated measures."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.stats import chi2, pearsonr, spearmanr, t

from feel321.analysis import repeated_measures_correlation
from feel321.analysis.classic import compare_dependent, fit_monotone_cubic, p1401

Values = NDArray[np.float64]


def make_votes(
    n_items: int = 40, n_raters: int = 12, *, seed: int = 0, noise: float = 8.0
) -> tuple[Values, Values]:
    rng = np.random.default_rng(seed)
    metric = rng.uniform(0, 1, n_items)
    return 30 + 40 * metric[:, None] + rng.normal(0, noise, (n_items, n_raters)), metric


def misfit(u: Values, y: Values) -> float:
    return float(((y - fit_monotone_cubic(u, y, span=(0, 1))(u)) ** 2).sum())


def brute_misfit(u: Values, y: Values, rng: np.random.Generator) -> float:
    """Minimise over the form of the Recommendation's slope, from many starts, without knowing its border."""
    best = math.inf
    for sign in (1, -1):

        def residuals(p: Values, sign: int = sign) -> Values:
            start, al, be, ga = p
            rise = al**2 * u + al * be * u**2 + be**2 * u**3 / 3 + ga**2 * (u**2 / 2 - u**3 / 3)
            return sign * y - start - rise

        close = {"xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}
        fits = [least_squares(residuals, rng.normal(0, 3, 4), **close) for _ in range(8)]
        best = min(best, *(2 * fit.cost for fit in fits))
    return best


@pytest.mark.parametrize("seed", range(6))
def test_monotone_cubic_is_the_best_of_its_form(seed: int) -> None:
    rng = np.random.default_rng(seed)
    u = np.concatenate([[0, 1], rng.uniform(size=10)])
    y = rng.normal(0, (0.1, 1, 3)[seed % 3], 12) + 2 * u + 3 * (seed % 2) * (u - 0.5) ** 2
    assert misfit(u, y) == pytest.approx(brute_misfit(u, y, rng), rel=1e-7)


@settings(deadline=None)  # the first call imports scipy.stats
@given(seed=st.integers(0, 100_000), n=st.integers(4, 25))
def test_mapping_never_turns_anywhere(seed: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    x = rng.uniform(-3, 5, n)
    mapping = fit_monotone_cubic(x, rng.normal(size=n), span=(x.min(), x.max()))
    steps = np.diff(mapping(np.linspace(x.min(), x.max(), 4001)))
    assert (steps >= -1e-12).all() or (steps <= 1e-12).all()


def test_a_monotone_cubic_is_recovered_exactly() -> None:
    x = np.linspace(-2, 3, 9)
    result = p1401(np.repeat((1 + 2 * x + 0.5 * x**3)[:, None], 3, axis=1), x)
    assert result.coefficients == pytest.approx((1, 2, 0, 0.5), abs=1e-10)
    assert (result.rmse, result.outlier_ratio) == (0, 0)
    assert result.plcc == pytest.approx(1)
    assert math.isnan(result.plcc_low)
    assert any("perfect" in note for note in result.notes)


def test_what_does_not_vary_correlates_with_nothing() -> None:
    result = p1401(np.full((9, 3), 60.0), np.arange(9.0), order=1)
    assert math.isnan(result.plcc)
    assert math.isnan(result.srocc)
    assert result.rmse == pytest.approx(0, abs=1e-9)


@pytest.mark.parametrize("order", [0, 1, 3])
def test_every_number_by_its_definition(order: int) -> None:
    votes, metric = make_votes()
    votes[::3, 0] = np.nan
    x = 40 + 30 * metric if order == 0 else metric
    result = p1401(votes, x, order=order)
    mos, predicted = np.nanmean(votes, axis=1), np.polynomial.Polynomial(result.coefficients)(x)
    if order:
        # The constraint is idle.
        assert predicted == pytest.approx(np.polynomial.Polynomial.fit(x, mos, order)(x))
    n = len(x)
    counts = np.isfinite(votes).sum(axis=1)
    spread = np.array([np.std(row[np.isfinite(row)], ddof=1) for row in votes])
    ci = t.ppf(0.975, counts - 1) * spread / np.sqrt(counts)
    error, spent = np.abs(mos - predicted), {0: 1, 1: 2, 3: 4}[order]
    assert result.rmse == pytest.approx(math.sqrt((error**2).sum() / (n - spent)))
    assert result.rmse_n1 == pytest.approx(math.sqrt((error**2).sum() / (n - 1)))
    star = sum(max(0.0, e - c) ** 2 for e, c in zip(error, ci, strict=True))
    assert result.rmse_star == pytest.approx(math.sqrt(star / (n - spent)))
    assert result.rmse_star_n1 == pytest.approx(math.sqrt(star / (n - 1)))
    assert result.outlier_ratio == np.mean(error > ci)
    ratio = result.outlier_ratio
    assert result.outlier_ratio_sd == pytest.approx(math.sqrt(ratio * (1 - ratio) / n))
    assert result.plcc == pytest.approx(pearsonr(mos, predicted)[0])
    reach = math.atanh(result.plcc_high) - math.atanh(result.plcc)
    assert reach == pytest.approx(1.96 / math.sqrt(n - 3))
    assert result.plcc_low < result.plcc
    assert result.srocc == pytest.approx(spearmanr(mos, x)[0])
    ends = result.rmse * np.sqrt((n - spent) / chi2.ppf([0.975, 0.025], n - spent))
    assert (result.rmse_low, result.rmse_high) == pytest.approx(tuple(ends))


@pytest.mark.parametrize(
    ("metric", "mos", "expected"),
    [
        (np.linspace(0, 1, 12), [10, 30, 38, 35, 33, 30, 34, 36, 35, 50, 70, 88],
         (4.891254728, 0.9787522463, 14.21469059, 141.0198056, -339.8681836, 273.0358367)),
        ([0.2, 0.25, 0.4, 0.41, 0.5, 0.55, 0.6, 0.7, 0.8, 0.95], [80, 82, 60, 66, 70, 58, 60, 40, 45, 10],
         (6.909899424, 0.9641179479, 117.5302337, -247.3667224, 417.8937218, -289.9717678)),
        (np.arange(11) / 10, [5, 20, 45, 60, 72, 80, 86, 84, 80, 76, 75],
         (5.451089954, 0.9859961295, 0.9284889487, 288.9124131, -347.365311, 139.214809)),
    ],
    ids=["touches inside", "falls freely", "stops at the end"],
)  # fmt: skip
def test_against_quadratic_programming_in_r(
    metric: object, mos: list[int], expected: tuple[float, ...]
) -> None:
    # R 4.2.2, quadprog 1.5-8: solve.QP(crossprod(X), crossprod(X, y), s * rbind(0, 1, 2 * g, 3 * g^2), 0), with
    # X = cbind(1, x, x^2, x^3), g 20001 points of the range, and the better of s = 1 and s = -1.
    votes = np.asarray(mos, dtype=float)[:, None] + np.array([-3, 3, 0, 1, -1])
    result = p1401(votes, metric)
    assert (result.rmse, result.plcc) == pytest.approx(expected[:2], rel=1e-7)
    # The grid lets a slope dip below 0 by a hair.
    assert result.coefficients == pytest.approx(expected[2:], rel=3e-4)


def test_out_of_fold_predicts_without_the_group() -> None:
    votes, metric = make_votes()
    groups = np.arange(40) % 5
    result = p1401(votes, metric, order=1, groups=groups)
    mos = votes.mean(axis=1)
    line = np.polynomial.Polynomial.fit(metric[groups != 2], mos[groups != 2], 1)
    assert result.mapped[groups == 2] == pytest.approx(line(metric[groups == 2]))
    assert result.held_out
    assert result.coefficients == pytest.approx(p1401(votes, metric, order=1).coefficients)
    assert result.rmse == pytest.approx(math.sqrt(((mos - result.mapped) ** 2).sum() / 39))


def test_a_left_out_edge_is_not_thrown_off() -> None:
    # One recording holds all the high values; without it a cubic, monotone or not, goes to -516 there.
    metric = np.concatenate([np.linspace(0, 0.4, 20), np.linspace(0.9, 1, 5)])
    votes = (50 + 20 * np.sin(9 * metric))[:, None] + np.array([-2.0, 0, 2])
    groups = np.where(metric > 0.5, "high", (np.arange(25) % 3).astype(str))
    result = p1401(votes, metric, groups=groups)
    assert result.mapped[metric > 0.5] == pytest.approx(result.mapped[metric > 0.5].mean())
    assert 40 < result.mapped.min() < result.mapped.max() < 70
    assert any("6 items lie beyond" in note for note in result.notes)


PRINTED = [
    # Zou (2007), overlapping correlations
    ((0.396, 0.179, 0.088, 66), {"zou_low": -0.093, "zou_high": 0.517}, 5e-4),
    # Steiger (1980), Psychological Bulletin 87, 245-251, case A; Meng et al. (1992)
    ((0.4, 0.5, 0.1, 103), {"steiger_z": -0.89}, 5e-3),
    ((0.63, -0.03, -0.19, 15), {"meng_z": 1.68}, 5e-3),
    # R's psych 2.2.9: r.test(n = 103, .4, .5, .1) and so on
    ((0.4, 0.5, 0.1, 103), {"williams_t": -0.8912799, "williams_p": 0.3749185}, 1e-7),
    ((0.9, -0.2, -0.3, 12), {"williams_t": 3.702096, "williams_p": 0.004904615}, 1e-6),
    ((0.396, 0.179, 0.088, 66), {"williams_t": 1.380949, "williams_p": 0.1721738}, 1e-6),
    ((0.5, 0.4, 0.3, 103), {"williams_t": 0.996900779735, "williams_p": 0.321218841518}, 1e-11),
    ((-0.3, 0.2, 0.1, 50), {"williams_t": -2.75917119688663, "williams_p": 0.00823268299379}, 1e-11),
    ((0.9, 0.7, 0.8, 20), {"williams_t": 2.95071533320257, "williams_p": 0.00894579777683}, 1e-11),
    # cocor 1.1 (doi 10.1371/journal.pone.0121945), in the documentation of R's rmcorr
    (
        (0.8065821, 0.2383, 0.2255, 177),
        {"williams_t": 9.3823, "williams_df": 174, "steiger_z": 8.5460, "meng_z": 8.3907, "zou_low": 0.4288,
         "zou_high": 0.7139},
        3e-4,
    ),
]  # fmt: skip


@pytest.mark.parametrize(("arguments", "printed", "digits"), PRINTED)
def test_printed_examples_of_dependent_correlations(
    arguments: tuple[float, float, float, int], printed: dict[str, float], digits: float
) -> None:
    result = compare_dependent(*arguments)
    assert {name: result[name] for name in printed} == pytest.approx(printed, abs=digits)


correlations = st.floats(-0.95, 0.95)


@settings(deadline=None)  # the first call imports scipy.stats
@given(r_jk=correlations, r_jh=correlations, r_kh=correlations, n=st.integers(4, 500))
def test_exchange_turns_every_sign(r_jk: float, r_jh: float, r_kh: float, n: int) -> None:
    if 1 - r_jk**2 - r_jh**2 - r_kh**2 + 2 * r_jk * r_jh * r_kh < 0:
        return
    there, back = compare_dependent(r_jk, r_jh, r_kh, n), compare_dependent(r_jh, r_jk, r_kh, n)
    for name in ("williams_t", "steiger_z", "meng_z", "difference"):
        assert getattr(there, name) == pytest.approx(-getattr(back, name), nan_ok=True)
    assert there.zou_low == pytest.approx(-back.zou_high)
    assert there.zou_low <= there.difference <= there.zou_high


def test_independent_items_hold_the_size() -> None:
    """Where its model is true, each test is: 5 % of trivariate normal samples with equal correlations."""
    rng = np.random.default_rng(2)
    corr = np.array([[1, 0.5, 0.5], [0.5, 1, 0.6], [0.5, 0.6, 1]])
    hits = np.zeros(4)
    for _ in range(600):
        r = np.corrcoef(rng.multivariate_normal(np.zeros(3), corr, 40).T)
        result = compare_dependent(r[0, 1], r[0, 2], r[1, 2], 40)
        p = np.array([result.williams_p, result.steiger_p, result.meng_p])
        hits += np.append(p < 0.05, not result.zou_low <= 0 <= result.zou_high)
    assert ((hits / 600 > 0.025) & (hits / 600 < 0.08)).all()


@pytest.mark.parametrize("place", range(3))
def test_a_correlation_that_is_missing_is_refused(place: int) -> None:
    values = [0.5, 0.3, 0.4]
    values[place] = float("nan")
    with pytest.raises(ValueError, match="r_jk, r_jh and r_kh must be -1 to 1"):
        compare_dependent(*values, 40)


def make_rows(
    seed: int = 0, n: int = 40, people: int = 5
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    participant = rng.permutation(np.arange(n) % people)
    x = rng.normal(size=n)
    return x, 0.8 * x + rng.normal(size=n) - 5 * participant, participant


def test_it_is_the_common_slope_of_an_analysis_of_covariance() -> None:
    import statsmodels.api as sm

    x, y, participant = make_rows()
    dummies = np.eye(5)[participant]
    fit = sm.OLS(y, np.column_stack([x, dummies])).fit()
    result = repeated_measures_correlation(x, y, participant)
    assert result.df == fit.df_resid
    assert result.p == pytest.approx(fit.pvalues[0])
    assert result.r == pytest.approx(fit.tvalues[0] / math.sqrt(fit.tvalues[0] ** 2 + fit.df_resid))


@pytest.mark.parametrize(("place", "name"), [(0, "x"), (1, "y")])
def test_no_variation_inside_is_said(place: int, name: str) -> None:
    rows = list(make_rows())
    rows[place] = 33.3 * rows[2]
    result = repeated_measures_correlation(*rows)
    assert math.isnan(result.r)
    assert math.isnan(result.p)
    assert result.notes == (f"No correlation: {name} does not vary within any participant.",)


def test_the_interval_has_two_degrees_of_freedom_less_than_cases() -> None:
    x, y = [0.1, 0.2, 0.4, 0.6, 0.7, 0.9], [60, 65, 75, 30, 38, 45]
    found = repeated_measures_correlation(x, y, list("aaabbb"))
    half = 1.959964 / math.sqrt(found.df - 1)
    ends = [math.tanh(math.atanh(found.r) + sign * half) for sign in (-1, 1)]
    assert [found.low, found.high] == pytest.approx(ends, rel=1e-6)
