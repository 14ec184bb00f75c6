"""How much each metric weighs in choices: logistic regression on differences of metrics, an order effect and lapses.

This is the Bradley-Terry model whose abilities are sums of weighted metrics.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.arrays import CONFIDENCE, Values
from feel321.analysis.choices.predict import FEWEST
from feel321.analysis.choices.votes import Votes, cluster_products, gather_votes
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

    from feel321.analysis.table.items import Table
    from feel321.types import Direction

ORDER = "order"
"""The term of being felt first."""

MOST_LAPSES = 0.5
"""Largest lapse rate that is tried; choices with more of them are hardly choices."""

EXTREME = 12.0
"""Log odds beyond which an estimate is running away: one choice in 160 000."""

STEPS, CLOSE = 100, 1e-10


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class ChoiceModel(Result):
    """Weights of metrics in choices between two stimuli.

    Parameters
    ----------
    fixed : DataFrame, indexed by term
        ``estimate``, log odds for the stimulus felt first per ``unit`` of difference between the two, ``se``, ``t``,
        ``p``, ``low`` and ``high``, the 95 % t interval; ``unit`` is the metric's root mean square difference. The last
        row ``order`` holds the log odds of the first against an equal.
    lapse : float
        Share of choices that rest on nothing felt.
    is_estimated : bool
        Whether the lapse rate was estimated.
    log_likelihood : float
        Bernoulli.
    df : int
        Degrees of freedom of the intervals: participants or recordings, whichever are fewer, less one.
    n_votes, n_participants, n_recordings : int
        Choices, people, and recordings (sources, where several come from one).
    notes : tuple of str
        What is to be read with care.
    """

    fixed: DataFrame
    lapse: float
    is_estimated: bool
    log_likelihood: float
    df: int
    n_votes: int
    n_participants: int
    n_recordings: int
    notes: tuple[str, ...] = ()

    def to_frame(self) -> DataFrame:
        """Return the weights as a table.

        Returns
        -------
        DataFrame
            A row per term, with the columns of `fixed`.
        """
        return self.fixed.rename_axis("term").reset_index()


def fit_choices(  # noqa: PLR0913 - which votes, and which model
    ratings: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    stimuli: DataFrame | None = None,
    scale: str | None = None,
    level: str | None = None,
    higher: Mapping[str, Direction] | None = None,
    order_effect: bool = True,
    lapse: float | None = None,
) -> ChoiceModel:
    """Fit the weights of metrics to choices between two stimuli.

    Parameters
    ----------
    ratings : Table or DataFrame
        Choices, as `predict_votes` takes them.
    metrics : sequence of str, optional
        Columns of the stimuli, all in one model; the declared ones of a Table if left out.
    stimuli : DataFrame, optional
        The stimuli and their metrics, with a DataFrame of choices.
    scale, level : str, optional
        Which choices; needed where there are several scales.
    higher : Mapping of str to {"better", "worse"}, optional
        Whether a larger value of a metric is better or worse; what a Table's metrics declare, else better.
    order_effect : bool
        Whether being felt first may help, equally for all.
    lapse : float, optional
        Share of choices that rest on nothing felt, from 0 to less than 0.5; estimated if left out.

    Returns
    -------
    ChoiceModel
        Weights with intervals that hold for other people and other recordings.

    Raises
    ------
    ValueError
        If there is nothing to fit, two metrics differ alike, or a metric predicts every choice.

    Notes
    -----
    Model: P(first) = λ/2 + (1 - λ) / (1 + exp(-(o + Σ β_m d_m / u_m))), d_m the difference of metric m, first minus
    second, positive where the first is better, and u_m its root mean square. Maximum likelihood: Fisher scoring for
    each λ, and λ by Brent's method from 0 to 0.5. Errors are robust to dependence within participants and within
    recordings [1]_, each of whose parts is multiplied by G / (G - 1), and never below those of one-way clustering.

    References
    ----------
    .. [1] Cameron, A. C., Gelbach, J. B., & Miller, D. L. (2011). Robust inference with multiway clustering. Journal of
       Business & Economic Statistics, 29(2), 238-249. doi:10.1198/jbes.2010.07136

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> stimuli = pd.DataFrame({"stimulus_id": [f"s{k}" for k in range(8)], "recording": list("aabbccdd"),
    ...     "match": rng.random(8)})
    >>> votes = pd.DataFrame({"participant": np.repeat(list("pqrst"), 40), "stimulus_id": ["s0", "s2", "s4", "s6"] * 50,
    ...     "other_id": ["s1", "s3", "s5", "s7"] * 50, "rating": rng.choice([0, 100], 200)})
    >>> model = analysis.fit_choices(votes, ["match"], stimuli=stimuli, lapse=0)
    >>> list(model.fixed.index), model.df
    (['match', 'order'], 3)
    """
    if lapse is not None and not 0 <= lapse < MOST_LAPSES:
        raise ValueError(f"lapse must be from 0 to less than {MOST_LAPSES}, or None, got {lapse}")
    votes = gather_votes(ratings, stimuli, scale=scale, level=level, metrics=metrics, higher=higher)
    return fit_votes(votes, order_effect=order_effect, lapse=lapse)


def fit_votes(
    votes: Votes, *, order_effect: bool = True, lapse: float | None = None
) -> ChoiceModel:
    """Fit the weights of metrics to votes."""
    units = np.sqrt((votes.differences**2).mean(axis=0))
    terms = [*votes.metrics, *[ORDER] * order_effect]
    if flat := [name for name, unit in zip(votes.metrics, units, strict=True) if not unit > 0]:
        raise ValueError(
            f"metrics must differ between the stimuli of some pair, but {flat[0]!r} never does; leave it out"
        )
    design = np.column_stack([votes.differences / units, np.ones((len(votes), int(order_effect)))])
    if not terms or np.linalg.matrix_rank(design) < design.shape[1]:
        raise ValueError(
            f"metrics must not be collinear, got {', '.join(votes.metrics) or 'none'}, of which one follows "
            "from the others; leave one out"
        )
    chose = votes.chose_first.astype(np.float64)
    rate = _find_lapse(design, chose) if lapse is None else lapse
    beta, log_likelihood = _maximise(design, chose, rate)
    if np.abs(design @ beta).max() > EXTREME:
        raise ValueError(
            "choices must not all follow the metrics, but they do: the weights have no finite estimate; name fewer "
            "metrics, or set a lapse such as 0.05"
        )
    free = lapse is None and rate > 0
    covariance = _estimate_covariance(votes, design, beta, rate=rate, free=free)[
        : len(beta), : len(beta)
    ]
    few = votes.n_units < FEWEST
    notes = [*votes.notes, *["Below 3 participants or 3 recordings there is no interval."] * few]
    if lapse is None and rate == 0:
        notes.append("The lapse rate was estimated as 0, and is taken for known.")
    errors = np.full(len(beta), np.nan) if few else np.sqrt(np.diag(covariance))
    return ChoiceModel(
        fixed=_tabulate(beta, errors, terms=terms, units=[*units, *[np.nan] * order_effect], df=votes.n_units - 1),
        lapse=float(rate), is_estimated=lapse is None, log_likelihood=log_likelihood, df=votes.n_units - 1,
        n_votes=len(votes), n_participants=votes.n_participants, n_recordings=votes.n_sources, notes=tuple(notes),
    )  # fmt: skip


def _find_lapse(design: Values, chose: Values) -> float:
    """Find the lapse rate of the highest likelihood, 0 among them."""
    from scipy.optimize import minimize_scalar

    found = minimize_scalar(
        lambda rate: -_maximise(design, chose, rate)[1], bounds=(0.0, MOST_LAPSES), method="bounded"
    )
    return float(found.x) if -found.fun > _maximise(design, chose, 0.0)[1] + CLOSE else 0.0


def _predict(design: Values, beta: Values, rate: float) -> tuple[Values, Values]:
    """Compute the chance of the first, and its derivative by the log odds."""
    felt = 1 / (1 + np.exp(-np.clip(design @ beta, -2 * EXTREME, 2 * EXTREME)))
    return rate / 2 + (1 - rate) * felt, (1 - rate) * felt * (1 - felt)


def _measure(chance: Values, chose: Values) -> float:
    return float(np.log(np.where(chose > 0, chance, 1 - chance)).sum())


def _maximise(design: Values, chose: Values, rate: float) -> tuple[Values, float]:
    """Maximise the likelihood by Fisher scoring; steps that lower it are halved."""
    beta = np.zeros(design.shape[1])
    best = _measure(_predict(design, beta, rate)[0], chose)
    for _ in range(STEPS):
        chance, slope = _predict(design, beta, rate)
        weight = slope / (chance * (1 - chance))
        curvature = design.T @ (design * (weight * slope)[:, None])
        step = np.linalg.lstsq(curvature, design.T @ (weight * (chose - chance)), rcond=None)[0]
        step /= max(1.0, np.abs(step).max() / 2)
        reached = -np.inf
        while reached < best and np.abs(step).max() > CLOSE:
            reached = _measure(_predict(design, beta + step, rate)[0], chose)
            step = step if reached >= best else step / 2
        if np.abs(step).max() <= CLOSE or np.abs(design @ beta).max() > 1.5 * EXTREME:
            break
        beta, best = beta + step, reached
    return beta, best


def _estimate_covariance(
    votes: Votes, design: Values, beta: Values, *, rate: float, free: bool
) -> Values:
    """Estimate the covariance of the weights, and of the lapse rate where it is free, by two-way clustering."""
    chance, slope = _predict(design, beta, rate)
    gradient = design * slope[:, None]
    if free:
        by_rate = CHANCE_OF_LAPSE - (chance - rate / 2) / (1 - rate)
        gradient = np.column_stack([gradient, by_rate])
    spread = (chance * (1 - chance))[:, None]
    bread = np.linalg.pinv(gradient.T @ (gradient / spread))
    scores = gradient / spread * (votes.chose_first - chance)[:, None]
    one, other, both = (bread @ part @ bread for part in cluster_products(votes, scores))
    joint: Values = one + other - both
    values, vectors = np.linalg.eigh(joint)
    two_way: Values = np.einsum("ij,j,kj->ik", vectors, np.maximum(values, 0), vectors)
    np.fill_diagonal(two_way, np.maximum.reduce([np.diag(two_way), np.diag(one), np.diag(other)]))
    return two_way


CHANCE_OF_LAPSE = 0.5
"""Chance of the first where nothing was felt."""


def _tabulate(
    beta: Values, errors: Values, *, terms: list[str], units: list[float], df: int
) -> DataFrame:
    import pandas as pd
    from scipy.stats import t

    margin = t.ppf((1 + CONFIDENCE) / 2, max(df, 1)) * errors
    fixed = pd.DataFrame({"estimate": beta, "se": errors, "t": beta / errors}, index=terms)
    fixed["p"] = 2 * t.sf(np.abs(fixed["t"]), max(df, 1))
    return fixed.assign(low=beta - margin, high=beta + margin, unit=units)
