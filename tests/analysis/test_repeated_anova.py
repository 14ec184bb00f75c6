"""Repeated-measures ANOVA, Friedman's test and a mixed model's joint test, against sums of squares done by hand."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from feel321.analysis.contrasts.compare import fit_reducers
from feel321.analysis.contrasts.repeated import compare_repeated, compare_terms, find_epsilon


def make_cells(people: int = 9, *, seed: int = 3) -> np.ndarray:
    """Ratings of shape (participants, reducers, interactions)."""
    rng = np.random.default_rng(seed)
    cells = 50 + rng.normal(0, 8, (people, 1, 1)) + rng.normal(0, 4, (people, 4, 1))
    cells = cells + np.array([0, 3, 9, 12.0])[None, :, None] + np.array([0, 5.0])
    return np.asarray(cells + rng.normal(0, 3, (people, 4, 2)))


def tidy(cells: np.ndarray) -> pd.DataFrame:
    rows = [
        (f"p{who}", f"r{one}", f"i{two}", cells[who, one, two])
        for who, one, two in np.ndindex(cells.shape)
    ]
    return pd.DataFrame(rows, columns=["participant", "reducer", "interaction", "rating"])


def square(values: np.ndarray, times: int) -> float:
    return float((values**2).sum() * times)


def by_hand(cells: np.ndarray) -> dict[str, tuple[float, float, float]]:
    """F and both degrees of freedom of two crossed factors within people, from sums of squares."""
    people, ones, twos = cells.shape
    grand = cells.mean()
    who, one, two = (cells.mean(axis=axes) - grand for axes in ((1, 2), (0, 2), (0, 1)))
    who_one = cells.mean(axis=2) - grand - who[:, None] - one[None]
    who_two = cells.mean(axis=1) - grand - who[:, None] - two[None]
    both = cells.mean(axis=0) - grand - one[:, None] - two[None]
    rest = cells - grand - who[:, None, None] - one[None, :, None] - two[None, None]
    rest = rest - who_one[:, :, None] - who_two[:, None] - both[None]
    effects = {
        "reducer": (square(one, people * twos), ones - 1, square(who_one, twos)),
        "interaction": (square(two, people * ones), twos - 1, square(who_two, ones)),
        "reducer x interaction": (square(both, people), (ones - 1) * (twos - 1), square(rest, 1)),
    }
    return {
        name: ((own / df) / (error / (df * (people - 1))), df, df * (people - 1))
        for name, (own, df, error) in effects.items()
    }


def test_two_factors_are_those_of_sums_of_squares() -> None:
    cells = make_cells()
    tested = compare_repeated(tidy(cells), within=("reducer", "interaction"))
    found = {one.effect: one for one in tested if one.test == "anova"}
    for name, (f, df_1, df_2) in by_hand(cells).items():
        one = found[name]
        assert (one.df_1, one.df_2) == (df_1, df_2)
        assert one.statistic == pytest.approx(f)
        assert one.p_sphericity == pytest.approx(stats.f.sf(f, df_1, df_2))
    assert found["interaction"].epsilon == pytest.approx(1)
    assert found["reducer"].p >= found["reducer"].p_sphericity


def test_one_factor_and_friedman_take_means_over_recordings() -> None:
    cells = make_cells()
    anova, friedman = compare_repeated(tidy(cells))
    means = cells.mean(axis=2)
    assert anova.statistic == pytest.approx(by_hand(means[:, :, None].repeat(2, axis=2))["reducer"][0])  # fmt: skip
    ranks = np.apply_along_axis(stats.rankdata, 1, means)
    n, k = ranks.shape
    chi = 12 / (n * k * (k + 1)) * (ranks.sum(axis=0) ** 2).sum() - 3 * n * (k + 1)
    assert friedman.statistic == pytest.approx(chi)
    assert friedman.p == pytest.approx(stats.chi2.sf(chi, k - 1))


def test_epsilon_is_one_for_equal_variances_and_least_for_one_direction() -> None:
    levels = 4
    directions = np.eye(levels) - 1 / levels
    assert find_epsilon(np.vstack([directions, -directions])) == pytest.approx(1)
    line = np.outer([1.0, 2, 4], [0.0, 1, 3, 9])
    assert find_epsilon(line) == pytest.approx(1 / (levels - 1))
    # Its definition by the covariance's elements (Geisser & Greenhouse 1958), not by eigenvalues.
    spread = np.cov(make_cells().mean(axis=2), rowvar=False)
    upper = levels**2 * (np.trace(spread) / levels - spread.mean()) ** 2
    rows = (spread.mean(axis=1) ** 2).sum()
    lower = (levels - 1) * ((spread**2).sum() - 2 * levels * rows + levels**2 * spread.mean() ** 2)
    assert find_epsilon(make_cells().mean(axis=2)) == pytest.approx(upper / lower)


def test_who_lacks_a_cell_is_left_out_and_counted() -> None:
    rows = tidy(make_cells())
    gaps = rows[~((rows["participant"] == "p4") & (rows["reducer"] == "r2"))]
    found = compare_repeated(gaps)[0]
    assert (found.n_participants, found.n_left_out) == (8, 1)
    alone = compare_repeated(rows[rows["participant"] != "p4"])[0]
    assert found.statistic == pytest.approx(alone.statistic)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[rows["participant"] == "p0"], "2 participants or more must have rated every reducer"),
        (lambda rows: rows[rows["reducer"] == "r0"], "ratings must be of 2 levels or more of reducer"),
        (lambda rows: rows.assign(rating=50.0), "nothing is left to test against"),
        (lambda rows: rows.drop(columns="reducer"), "reducer"),
    ],
)  # fmt: skip
def test_what_cannot_be_tested_is_refused(change: object, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        compare_repeated(change(tidy(make_cells())))


def test_the_mixed_models_test_is_the_anovas_where_the_design_is_balanced() -> None:
    # One recording, no spread of stimuli: people, and people's own residual, are all that is random.
    rng = np.random.default_rng(5)
    means = 50 + rng.normal(0, 8, (12, 1)) + np.array([0, 2, 5, 3.0]) + rng.normal(0, 4, (12, 4))
    rows = tidy(means[:, :, None]).assign(recording="one")
    rows = rows.assign(item=rows["reducer"])
    fit, terms, _ = fit_reducers(rows, ["r0", "r1", "r2", "r3"])
    (anova,) = (one for one in compare_repeated(rows) if one.test == "anova")
    mixed = compare_terms(fit, list(terms.values()))
    assert mixed.df_1 == anova.df_1 == 3
    assert mixed.statistic == pytest.approx(anova.statistic, rel=1e-3)
    assert mixed.df_2 == pytest.approx(anova.df_2, rel=1e-2)
