"""The Bayesian counterpart of the primary model: a sensitivity analysis, with priors in points and gates.

The model is that of `fit_primary`, without its penalty. A fit whose chains do not agree gives no number.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.primary.model import Slopes, fit_slopes
from feel321.analysis.primary.plan import ITEM, WHO, make_cells
from feel321.analysis.table.items import Table, choose_arms, choose_metrics, open_ratings
from feel321.doors import as_rng
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.primary.posterior import Prepared, Sampled
    from feel321.types import Rng

LEVEL, EFFECT, SPREAD = 50.0, 20.0, 15.0
"""Scales of the priors, in points: intercept; effect from the lower to the upper quartile of a metric; spreads."""

HIGHEST_RHAT, LEAST_ESS = 1.02, 100
"""Gates: split R-hat at most, effective draws of a chain at least; and no divergence."""

PRIORS = (
    f"Intercept: normal(50, {LEVEL:g}) points.",
    f"Effect of a metric from its lower to its upper quartile within recordings: normal(0, {EFFECT:g}) points.",
    f"Standard deviations of people, recordings, stimuli, reducers, their combinations, the residual, and of people's "
    f"effects from quartile to quartile: half-normal({SPREAD:g}) points.",
)


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class BayesianSlopes(Result):
    """The posterior of the primary model's slopes.

    Parameters
    ----------
    slopes : DataFrame
        Indexed by ``metric``: posterior mean ``estimate``, ``low``, ``high`` (95 %) per unit of the metric;
        ``quartile_effect quartile_low quartile_high`` in points from the metric's lower to its upper quartile within
        recordings; ``direction``: probability of the more probable sign; ``negligible``: posterior share of effects
        within the margin; ``reml_effect reml_low reml_high`` in points, of the primary model from quartile to quartile;
        ``agrees``: whether both intervals say the same of zero. NaN where chains disagree or the primary slope
        is not estimable.
    spreads : DataFrame
        Posterior means of the standard deviations: term, sd.
    rhat, ess : float
        The worst split R-hat and effective number of draws.
    divergences : int
        Divergent transitions.
    converged : bool
        Whether the gates hold.
    margin : float
        Points that do not matter; NaN where none was given.
    priors : tuple of str
        In words.
    notes : tuple of str
        What is unusual.
    """

    slopes: DataFrame
    spreads: DataFrame
    rhat: float
    ess: float
    divergences: int
    converged: bool
    margin: float
    priors: tuple[str, ...]
    notes: tuple[str, ...]

    def to_frame(self) -> DataFrame:
        """Return the slopes.

        Returns
        -------
        DataFrame
            A row per metric: metric, and the columns of `slopes`.
        """
        return self.slopes.reset_index()


def fit_bayesian(  # noqa: PLR0913 - which rows, and how much is drawn
    table: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    scale: str | None = None,
    level: str | None = None,
    margin: float | None = None,
    width: float = 1.0,
    draws: int = 1000,
    rng: Rng = 0,
) -> BayesianSlopes:
    """Fit the primary model of one attribute with priors, as a sensitivity analysis.

    Parameters
    ----------
    table : Table or DataFrame
        As for `fit_primary`.
    metrics : sequence of str, optional
        One or more; those of the Table if left out.
    scale, level : str, optional
        Which ratings; needed where the table holds several scales or levels.
    margin : float, optional
        Effect in points, from quartile to quartile, that does not matter.
    width : float
        Factor on the scales of all priors but the intercept's: 2 and 0.5 tell how much they decide.
    draws : int
        Draws of each of two chains, after 500 for warming up; at least 100.
    rng : int or Generator
        Seed.

    Returns
    -------
    BayesianSlopes
        Slopes with 95 % intervals, and what the gates say.

    Raises
    ------
    ValueError
        As `fit_primary`; or if numpyro is not installed: ``pip install "feel321[bayes]"``.

    Notes
    -----
    Everything but the standard deviations is integrated out exactly; NUTS (numpyro) draws those. Unlike the primary
    analysis it averages over what is not known of the spreads. It is no second test: hypotheses are decided by the
    primary model.

    References
    ----------
    Hoffman & Gelman (2014), Journal of Machine Learning Research 15, 1593-1623; Vehtari, Gelman, Simpson, Carpenter &
    Bürkner (2021), doi 10.1214/20-BA1221; Gelman (2006), doi 10.1214/06-BA117A.

    Examples
    --------
    >>> from feel321 import analysis
    >>> print(analysis.fit_bayesian(analysis.read_table("oak-study")).summary())  # doctest: +SKIP
    """
    _check(draws, width, margin)
    require_numpyro()
    rows, names = choose_arms(table, scale, level), choose_metrics(table, metrics)
    found = fit_slopes(make_cells(open_ratings(rows), names))
    from threadpoolctl import threadpool_limits

    from feel321.analysis.primary import posterior

    prepared = posterior.prepare(found.cells, found.terms)
    scales, priors = _find_scales(found, prepared, width)
    # Two threads wait for each other in matrices this small.
    with threadpool_limits(limits=1, user_api="blas"):
        sampler = posterior.Sampler(draws=draws, chains=2)
        sampled = sampler.sample(prepared.layout, scales, priors, rng=as_rng(rng))
    return _gather(found, prepared, sampled, margin=margin)


def require_numpyro() -> None:
    """Refuse in one line where the extra is not installed."""
    if find_spec("numpyro") is None:
        raise ValueError(
            'the Bayesian counterpart needs numpyro, which is not installed: pip install "feel321[bayes]"'
        )


def _check(draws: int, width: float, margin: float | None) -> None:
    if draws < LEAST_ESS:
        raise ValueError(f"draws must be {LEAST_ESS} or more, got {draws}")
    if not 0 < width < np.inf:
        raise ValueError(f"width must be above 0, got {width}")
    if margin is not None and not 0 < margin < np.inf:
        raise ValueError(f"margin must be above 0, in points of the scale, or None; got {margin}")


def _find_spans(found: Slopes) -> dict[str, float]:
    """Find how far apart the quartiles of each fixed effect's column are, over stimuli."""
    items = found.cells.table.drop_duplicates(ITEM)
    spans = {}
    for name in found.terms.fixed:
        span = float(np.subtract(*np.percentile(items[name], [75, 25])))
        spans[name] = span if span > 0 else float(items[name].std())
    return spans


def _find_scales(
    found: Slopes, prepared: Prepared, width: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Turn priors in points into those of the coefficients, and of the standard deviations."""
    spans = _find_spans(found)
    scales = [LEVEL, *(width * EFFECT / spans[name] for name in found.terms.fixed)]
    slopes = {f"{WHO}:{name}": span for name, span in spans.items()}
    priors = [width * SPREAD / slopes.get(name, 1.0) for name in prepared.names]
    return np.array(scales), np.array(priors)


def _gather(
    found: Slopes, prepared: Prepared, sampled: Sampled, *, margin: float | None
) -> BayesianSlopes:
    """Put slopes, gates and notes together."""
    import pandas as pd

    good = sampled.rhat <= HIGHEST_RHAT and sampled.ess >= LEAST_ESS * len(sampled.sds)
    converged = bool(good and not sampled.divergences)
    points = np.nan if margin is None else float(margin)
    slopes = _tabulate(found, sampled, points, converged=converged)
    spreads = pd.DataFrame({"term": prepared.names, "sd": sampled.sds.mean(axis=(0, 1))})
    return BayesianSlopes(
        slopes, spreads, sampled.rhat, sampled.ess, sampled.divergences, converged, points, PRIORS,
        tuple(_list_notes(slopes, sampled, converged=converged)),
    )  # fmt: skip


def _tabulate(found: Slopes, sampled: Sampled, margin: float, *, converged: bool) -> DataFrame:
    """Describe every slope; those that are not estimable have the numbers of the primary model alone."""
    import pandas as pd

    fixed = sampled.fixed.reshape(-1, sampled.fixed.shape[-1])
    columns = dict(zip(found.terms.fixed, fixed[:, 1:].T, strict=True))
    rows = {
        name: _describe(columns[f"{name}_w"], found.table.loc[name].to_dict(), margin)
        for name in found.table.index
    }
    slopes = pd.DataFrame.from_dict(rows, orient="index").rename_axis("metric")
    blank = ~(found.table["estimable"].to_numpy(dtype=bool) & converged)
    own = [name for name in slopes.columns if not str(name).startswith("reml_")]
    slopes[own] = slopes[own].mask(np.repeat(blank[:, None], len(own), axis=1))
    return slopes


def _describe(
    draws: NDArray[np.float64], reml: Mapping[str, float], margin: float
) -> dict[str, object]:
    """Describe the posterior of a slope beside that of restricted maximum likelihood."""
    low, high = (float(one) for one in np.quantile(draws, (0.025, 0.975)))
    span, above = float(reml["quartile_span"]), float((draws > 0).mean())
    clear, former = low * high > 0, reml["low"] * reml["high"] > 0
    same_side = draws.mean() * reml["estimate"] > 0
    return {
        "estimate": float(draws.mean()), "low": low, "high": high,
        "quartile_effect": float(draws.mean()) * span, "quartile_low": low * span, "quartile_high": high * span,
        "direction": max(above, 1 - above),
        "negligible": float((np.abs(draws * span) <= margin).mean()) if np.isfinite(margin) else np.nan,
        "reml_effect": reml["estimate"] * span, "reml_low": reml["low"] * span, "reml_high": reml["high"] * span,
        "agrees": bool(clear == former and (same_side or not clear)),
    }  # fmt: skip


def _list_notes(slopes: DataFrame, sampled: Sampled, *, converged: bool) -> Iterator[str]:
    if not converged:
        yield (
            f"Not estimable: the chains have not converged (R-hat {sampled.rhat:.3f}, {sampled.ess:.0f} effective "
            f"draws, {sampled.divergences} divergences)."
        )
    for name in slopes.index[slopes["agrees"].eq(False)]:  # noqa: FBT003 - the value that is looked for
        yield f"The Bayesian interval of {name} and the primary one disagree on whether zero is in them."
