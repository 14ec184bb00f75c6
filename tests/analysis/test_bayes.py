"""The Bayesian counterpart: its likelihood against the full normal density, its gates, and that it agrees with REML."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from feel321.analysis.primary import bayes, posterior
from feel321.analysis.primary.model import fit_slopes
from feel321.analysis.primary.plan import make_cells, plan_terms

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd

pytest.importorskip("numpyro", reason="NO NUMPYRO: the extra bayes is not installed")
PLANTED = 30.0
"""Slope on the spectral match in the synthetic study."""
METRICS = ["spectral_match", "temporal_match"]


@pytest.fixture
def uneven(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    """Four people; some rate stimuli twice, some not at all."""
    rows = tidy(participants=4, recordings=3, repeats=2, anchors=False)
    return rows.drop(index=[0, 5, 31, 32, 33])


@pytest.mark.soak  # a process that has once used JAX must not fork, as tests of kills beside this one do
def test_likelihood_is_the_normal_density_with_everything_integrated_out(
    uneven: pd.DataFrame,
) -> None:
    import jax

    cells = make_cells(uneven, METRICS)
    prepared = posterior.prepare(cells, plan_terms(cells, correlated=False, reducers=True))
    layout, table = prepared.layout, cells.table
    rng = np.random.default_rng(0)
    scales = rng.uniform(5, 30, layout.fixed.shape[1])
    items = table["item"].unique().tolist()
    place = table["item"].map(items.index).to_numpy()
    same = table["participant"].to_numpy()[:, None] == table["participant"].to_numpy()
    fixed = layout.fixed[place]
    counts = table.groupby(["participant", "item"])["rating"].size()
    found, wanted = [], []
    for seed in range(2):
        sds = np.random.default_rng(seed).uniform(2, 8, len(prepared.names))
        squares = sds**2
        own = np.tensordot(squares[: len(layout.own)], layout.own, 1)[np.ix_(place, place)] * same
        shared = np.tensordot(
            squares[len(layout.own) : -1], layout.shared, 1
        ) + posterior.JITTER * np.eye(len(items))
        spread = own + shared[np.ix_(place, place)] + squares[-1] * np.eye(len(table))
        spread += (fixed * scales**2) @ fixed.T
        centred = table["rating"].to_numpy() - posterior.MIDDLE
        constant = len(table) / 2 * np.log(2 * np.pi) + np.log(counts).sum() / 2
        wanted.append(multivariate_normal(cov=spread).logpdf(centred) + constant)
        with jax.enable_x64(True):
            found.append(float(posterior.log_likelihood(sds, layout, scales)))
            mean, covariance = map(np.asarray, posterior.find_fixed(sds, layout, scales))
        gain = scales[:, None] ** 2 * fixed.T @ np.linalg.inv(spread)
        assert np.allclose(mean, gain @ centred, rtol=1e-6, atol=1e-6)
        left = np.diag(scales**2) - gain @ fixed * scales**2
        assert np.allclose(covariance, left, rtol=1e-6, atol=1e-6)
    assert np.allclose(found, wanted, rtol=1e-9)


@pytest.mark.soak
def test_draws_hold_the_planted_slope(tidy: Callable[..., pd.DataFrame]) -> None:
    cells = make_cells(tidy(anchors=False), METRICS)
    prepared = posterior.prepare(cells, plan_terms(cells, correlated=False, reducers=True))
    scales = np.full(prepared.layout.fixed.shape[1], 50.0)
    sampler = posterior.Sampler(draws=100, chains=2, warmup=150)
    priors = np.full(len(prepared.names), 15.0)
    found = sampler.sample(prepared.layout, scales, priors, rng=np.random.default_rng(0))
    slopes = found.fixed[..., 1].ravel()  # of the first metric within recordings
    low, high = np.quantile(slopes, (0.005, 0.995))
    assert low < PLANTED < high
    assert low > 0
    assert found.sds.shape == (2, 100, len(priors))


@pytest.mark.parametrize(
    ("rhat", "ess", "divergences"),
    [(1.1, 900.0, 0), (1.0, 50.0, 0), (1.0, 900.0, 3), (1.0, 900.0, 0)],
)
def test_without_convergence_there_is_no_number(
    tidy: Callable[..., pd.DataFrame], rhat: float, ess: float, divergences: int
) -> None:
    cells = make_cells(tidy(anchors=False), METRICS)
    slopes = fit_slopes(cells)
    prepared = posterior.prepare(cells, slopes.terms)
    rng = np.random.default_rng(0)
    fixed = rng.normal(20, 2, (2, 100, prepared.layout.fixed.shape[1]))
    sampled = posterior.Sampled(
        np.ones((2, 100, len(prepared.names))), fixed, rhat, ess, divergences
    )
    found = bayes._gather(slopes, prepared, sampled, margin=5.0)
    good = (rhat, ess, divergences) == (1.0, 900.0, 0)
    assert found.converged is good
    assert found.slopes["estimate"].notna().all() == good
    assert any(one.startswith("Not estimable") for one in found.notes) is not good


def test_bad_input(tidy: Callable[..., pd.DataFrame]) -> None:
    with pytest.raises(ValueError, match="draws must be 100 or more, got 5"):
        bayes.fit_bayesian(tidy(), METRICS, draws=5)
    with pytest.raises(ValueError, match="width must be above 0, got 0"):
        bayes.fit_bayesian(tidy(), METRICS, width=0)


@pytest.mark.soak
def test_agrees_with_restricted_maximum_likelihood_where_there_is_much_to_see(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    rows = tidy(participants=16, recordings=8, anchors=False)
    found = bayes.fit_bayesian(rows, METRICS, margin=5.0)
    assert found.converged
    slopes = found.slopes
    error = (slopes["reml_high"] - slopes["reml_low"]) / 4
    assert (np.abs(slopes["quartile_effect"] - slopes["reml_effect"]) < error / 2).all()
    assert slopes["agrees"].all()
