"""Refined metrics: whether a weighted sum of metrics, or another shape of one, predicts better than each alone."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.agreement import find_ceiling
from feel321.analysis.arrays import Values, check_draws
from feel321.analysis.refined import candidates as search
from feel321.analysis.resampling import BLOCK, bootstrap_margin, draw_counts, fisher_z
from feel321.analysis.table.items import Items, Table, choose_info, choose_metrics, make_items
from feel321.doors import as_rng
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import MetricInfo, Rng

FEWEST_RECORDINGS, FEWEST_PEOPLE = 5, 3
"""One recording is judged, one chooses, and a weight needs more than two; people are split besides."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Refined(Result):
    """What a refined metric is worth on recordings and people that had no part in making it.

    Parameters
    ----------
    value, low, high : float
        Out-of-fold correlation of mean ratings with the refined metric, and its 95 % two-way bootstrap interval.
    rmse, rmse_low, rmse_high : float
        Out-of-fold root mean squared error of predicted mean ratings in points, and its interval.
    chosen : str
        Candidate that is chosen on all data.
    weights : DataFrame
        Of the chosen candidate: term, weight (points per standard deviation of the term over the stimuli), lowest
        and highest over the outer folds, per_unit (points per unit of the term;
        NaN for equal weights, a sum of standard deviations).
    candidates : DataFrame
        name, parameters, value and rmse out of fold if it had been the only candidate, and chosen: its share of the
        outer folds.
    gains : DataFrame
        Per plain metric: metric, plain (its correlation, nothing fitted), value low high (gain in correlation), z_value
        z_low z_high (in Fisher's z), rmse (of the plain metric, mapped out of fold).
    recommended : bool
        Whether the chosen candidate is no plain metric, and the gain over every plain metric is above zero with
        its whole interval.
    ceiling, share : float
        Noise ceiling, and value / ceiling; share is NaN where the ceiling rests on fewer stimuli than the value.
    within : bool
        Whether only differences within recordings count.
    n_participants, n_recordings, n_sources, n_items, n_folds : int
        Size of the data; sources are recordings that are not of one another; outer folds, recordings' times people's.
    draws : int
        Draws in which the correlation was defined.
    notes : tuple of str
        What is unusual, one sentence each.
    """

    value: float
    low: float
    high: float
    rmse: float
    rmse_low: float
    rmse_high: float
    chosen: str
    weights: DataFrame
    candidates: DataFrame
    gains: DataFrame
    recommended: bool
    ceiling: float
    share: float
    within: bool
    n_participants: int
    n_recordings: int
    n_sources: int
    n_items: int
    n_folds: int
    draws: int
    notes: tuple[str, ...]

    def to_frame(self) -> DataFrame:
        """Return the gains over the plain metrics.

        Returns
        -------
        DataFrame
            As `gains`.
        """
        return self.gains


def refine_metric(  # noqa: PLR0913 - one per choice
    table: Table | DataFrame,
    metrics: Sequence[str] | None = None,
    *,
    others: Sequence[str] = (),
    within: bool = True,
    draws: int = 400,
    rng: Rng = 0,
    info: Mapping[str, MetricInfo] | None = None,
) -> Refined:
    """Search a better metric among simple functions of metrics, by nested cross-validation.

    Parameters
    ----------
    table : Table or DataFrame
        Tidy table of one scale, one row per judgement: participant, recording, rating, the columns named, and
        stimulus_id or reducer (and level). Rows whose role is not ``test`` are left out.
    metrics : sequence of str, optional
        Metrics: what is to be improved upon; those of the Table if left out.
    others : sequence of str
        More columns that may enter a sum, such as the level in dB.
    within : bool
        Count differences between stimuli of the same recording only.
    draws : int
        Bootstrap draws, at least 2; every one repeats the whole search.
    rng : int or Generator
        Source of randomness: folds and draws.
    info : Mapping of str to MetricInfo, optional
        What metrics declare; a Table's own if left out. Of a metric of which lower is better, the distance below its
        upper bound takes the place, or below its largest value where it has none.

    Returns
    -------
    Refined
        What the search is worth, what it found, and whether that may be recommended.

    Raises
    ------
    ValueError
        If there are fewer than 5 recordings or 3 participants, no metric varies, or the table is not as `correlate`
        wants it.

    Notes
    -----
    **Candidates**, by number of parameters: each metric; the sum of all, each in standard deviations, with equal
    weights (1); each metric to the power 0.5 or 2, values below 0 counting as 0 (2); weighted sums of two
    terms (2), and of all terms where they are three or four. Weights are by least squares on mean ratings of stimuli.

    **Outer folds** leave out a recording (with all others of its source; a tenth of them where there are more than
    ten) together with a quarter of
    the participants. What is left chooses: **inner folds** leave out one more recording each, and the simplest
    candidate is taken whose squared error is within one standard error of the least (`choose`). It is fitted to
    all that is left, and gives each stimulus of the recording left out its value; ratings of the participants left out
    are set against it. So no rating is compared with a value that the same person's ratings, or ratings of
    the same recording, had a part in. Values are in standard deviations over all stimuli. With s the share of a
    stimulus's ratings that group g gave, y their mean and c the value, the correlation is
    Σ Σ s (y - ȳ)(c - c̄) over the root of Σ (ȳ_i - ȳ)² Σ Σ s (c - c̄)², with ȳ_i the stimulus's mean rating; for a
    metric that is fitted to nothing that is the ordinary one. The error is that of the stimuli's mean ratings.

    **Interval:** participants and recordings are drawn with replacement, the whole search is repeated, copies of a
    recording being left out together, and the interval is tanh(atanh T ± t(.975, U - 1) sqrt(U / (U - 1)) SD(atanh
    T*)), with U the smaller of both numbers; so for gains, whose plain metric is drawn along. The root mean squared
    error likewise on its logarithm.

    The interval is cautious, because a draw holds fewer different recordings to learn from: in simulated studies of
    10 people, 8 recordings and 6 reducers it covered the mean gain in 97 to 100 % of studies; a sum that gains 0.7 in
    Fisher's z over both metrics was recommended in two of three, one that gains 0.2 over the better one in 1 %. With
    the fits held as they are, it would cover as little as 67 %.

    A search among noise gains nothing: without any relation, the out-of-fold correlation was 0.00 ± 0.01 over 400
    simulated studies, and in none of 100 was anything recommended. Do not use it with few recordings to *find* a
    metric: it can show that a metric is enough, or that a refinement is worth a new study.

    References
    ----------
    Stone (1974), doi 10.1111/j.2517-6161.1974.tb00994.x; Varma & Simon (2006), doi 10.1186/1471-2105-7-91; Cawley &
    Talbot (2010), Journal of Machine Learning Research 11, 2079-2107; Breiman et al. (1984), Classification and
    regression trees, section 3.4.3 (one standard error); Owen (2007), doi 10.1214/07-AOAS122.

    Examples
    --------
    People feel the sum of two metrics; neither alone tells half of it:

    >>> import numpy as np, pandas as pd
    >>> from feel321 import analysis
    >>> rng = np.random.default_rng(1)
    >>> sm, tm = rng.uniform(0, 1, (2, 48))
    >>> rows = pd.DataFrame({"participant": np.repeat(np.arange(8), 48), "recording": np.tile(np.arange(48) // 6, 8),
    ...     "reducer": np.tile(np.arange(48) % 6, 8), "sm": np.tile(sm, 8), "tm": np.tile(tm, 8)})
    >>> rows["rating"] = 20 + 30 * rows["sm"] + 30 * rows["tm"] + rng.normal(0, 8, len(rows))
    >>> result = analysis.refine_metric(rows, ["sm", "tm"], draws=50, rng=rng)
    >>> result.chosen, round(result.value, 2), result.recommended
    ('equal weights', 0.98, True)
    """
    check_draws(draws, usual=400)
    names, rng = choose_metrics(table, metrics), as_rng(rng)
    items = make_items(table, tuple(dict.fromkeys([*names, *others])))
    items, worse = _turn(items, names, info or choose_info(table))
    data = _prepare(items, names, others, within=within, rng=rng)
    whole = search.score_draws(
        data, people=np.ones((1, items.n_participants)), recordings=np.ones((1, items.n_recordings))
    )
    drawn = _draw(data, draws=draws, rng=rng)
    n_units = min(items.n_participants, items.n_sources)
    z, drawn_z = fisher_z(whole.correlations[0])[0], fisher_z(drawn.correlations[0])
    low, high = _interval(z, drawn_z, n_units)
    with np.errstate(divide="ignore"):  # no error at all has no logarithm, and no interval
        log_low, log_high = _interval(np.log(whole.errors[0, 0]), np.log(drawn.errors[0]), n_units)
    chosen, fit = _choose_finally(data)
    ceiling, notes = find_ceiling(items, within=within)
    gains = _tabulate_gains(data.basis, whole, drawn, n_units=n_units)
    value = float(whole.correlations[0, 0])
    return Refined(
        value=value, low=float(np.tanh(low)), high=float(np.tanh(high)),
        rmse=float(whole.errors[0, 0]), rmse_low=float(np.exp(log_low)), rmse_high=float(np.exp(log_high)),
        chosen=data.basis.candidates[chosen].name,
        weights=_tabulate_weights(data.basis, whole, chosen, fit=fit, worse=worse),
        candidates=_tabulate_candidates(data.basis, whole), gains=gains,
        recommended=data.basis.candidates[chosen].name not in names and bool((gains["z_low"] > 0).all()),
        ceiling=ceiling, share=value / ceiling if not items.n_missing else float("nan"), within=within,
        n_participants=items.n_participants, n_recordings=items.n_recordings, n_sources=items.n_sources,
        n_items=items.n_items, n_folds=whole.chosen[0].size, draws=int(np.isfinite(drawn.correlations[0]).sum()),
        notes=(*data.basis.notes, *notes, *_explain(value, low)),
    )  # fmt: skip


def _turn(
    items: Items, names: Sequence[str], info: Mapping[str, MetricInfo]
) -> tuple[Items, list[str]]:
    """Turn metrics of which lower is better upside down: better is higher then, and not below 0. Also name them."""
    worse = [name for name in names if name in info and info[name].higher == "worse"]
    metrics = items.metrics.copy()
    for row, high in ((names.index(name), info[name].high) for name in worse):
        metrics[row] = (high if np.isfinite(high) else metrics[row].max()) - metrics[row]
    return replace(items, metrics=metrics), worse


def _prepare(
    items: Items,
    metrics: Sequence[str],
    others: Sequence[str],
    *,
    within: bool,
    rng: np.random.Generator,
) -> search.SearchData:
    for count, least, what in (
        (items.n_sources, FEWEST_RECORDINGS, "recordings of their own"),
        (items.n_participants, FEWEST_PEOPLE, "participants"),
    ):
        if count < least:
            raise ValueError(
                f"ratings must come from {least} {what} or more, got {count}; with fewer, a refined "
                "metric cannot be chosen and judged on different ones"
            )
    if np.nanstd(items.ratings) == 0:
        raise ValueError("ratings must differ, got the same rating everywhere")
    names = list(dict.fromkeys([*metrics, *others]))
    groups = items.recordings if within else None
    basis = search.make_basis(names, items.metrics, n_plain=len(metrics), groups=groups)
    if not basis.candidates:
        raise ValueError(
            f"metrics must vary between stimuli, got {', '.join(metrics)}, none of which varies"
        )
    return search.SearchData(items, basis, search.make_split(items, rng), within)


def _draw(data: search.SearchData, *, draws: int, rng: np.random.Generator) -> search.Searched:
    items, size = data.items, data.basis.columns.shape[1] + 2
    folds = int(data.split.items.max()) + 1
    cost = search.GROUPS * max(items.n_items, folds**2 * size**2)
    block = max(1, BLOCK // cost)
    found = []
    for start in range(0, draws, block):
        number = min(block, draws - start)
        people = draw_counts(items.n_participants, number, rng=rng)
        recordings = draw_counts(items.n_sources, number, rng=rng)[:, items.of_source]
        found.append(search.score_draws(data, people=people, recordings=recordings))
    return search.join_draws(found)


def _choose_finally(data: search.SearchData) -> tuple[int, Values]:
    """Choose on all data, everyone's ratings."""
    items, basis = data.items, data.basis
    everyone = data.split._replace(people=np.zeros(items.n_participants, dtype=np.intp))
    means = search.average_groups(
        items, everyone, np.ones((1, items.n_participants)), within=data.within
    )
    moments = search.sum_moments(
        basis.columns, means.own[0, 0], means.share[0, 0], folds=data.split.items
    )
    chosen = int(search.choose(moments, basis.candidates))
    return chosen, search.fit_candidate(moments.sum(axis=0), basis.candidates[chosen])


def _interval(middle: float, drawn: Values, n_units: int) -> tuple[float, float]:
    margin = bootstrap_margin(drawn, n_units)
    return middle - margin, middle + margin


def _explain(value: float, low: float) -> list[str]:
    none = "No correlation: mean ratings of stimuli do not differ, or the refined metric is the same for all."
    wide = (
        "No interval: the correlation is perfect, or undefined in more than a tenth of the draws."
    )
    return [none] if np.isnan(value) else [wide] if np.isnan(low) else []


def _tabulate_candidates(basis: search.Basis, whole: search.Searched) -> DataFrame:
    """List what might have been chosen."""
    import pandas as pd

    counts = np.bincount(whole.chosen.ravel(), minlength=len(basis.candidates))
    return pd.DataFrame({
        "name": [one.name for one in basis.candidates],
        "parameters": [one.parameters for one in basis.candidates],
        "value": whole.correlations[1:, 0],
        "rmse": whole.errors[1:, 0],
        "chosen": counts / counts.sum(),
    })


def _tabulate_gains(
    basis: search.Basis, whole: search.Searched, drawn: search.Searched, *, n_units: int
) -> DataFrame:
    """Compare the refined metric with each plain one."""
    import pandas as pd

    rows = []
    z, drawn_z = fisher_z(whole.correlations[0])[0], fisher_z(drawn.correlations[0])
    for place, name in _list_plain(basis):
        plain, drawn_plain = fisher_z(whole.as_it_is[place])[0], fisher_z(drawn.as_it_is[place])
        margin = bootstrap_margin(drawn_z - drawn_plain, n_units)
        gain = z - plain + np.array([0.0, -margin, margin])
        # As differences of correlations about the same mean z, as for `compare_metrics`.
        value, low, high = np.tanh((z + plain + gain) / 2) - np.tanh((z + plain - gain) / 2)
        rows.append({
            "metric": name,
            "plain": float(np.tanh(plain)),
            "value": value,
            "low": low,
            "high": high,
            **dict(zip(("z_value", "z_low", "z_high"), gain, strict=True)),
            "rmse": whole.errors[1 + place, 0],
        })
    return pd.DataFrame(rows)


def _tabulate_weights(
    basis: search.Basis,
    whole: search.Searched,
    chosen: int,
    *,
    fit: NDArray[np.float64],
    worse: Sequence[str],
) -> DataFrame:
    """List the weights of what was chosen, and how they change from fold to fold; fit: (n_columns + 2,)."""
    import pandas as pd

    columns = list(basis.candidates[chosen].columns)
    weights = fit[1:-1][columns]
    signs = np.where(np.isin([basis.names[column] for column in columns], worse), -1.0, 1.0)
    over_folds = whole.fits[chosen, 0][..., 1:-1][..., columns].reshape(-1, len(columns))
    return pd.DataFrame({
        "term": [basis.names[column] for column in columns],
        "weight": weights, "lowest": over_folds.min(axis=0), "highest": over_folds.max(axis=0),
        "per_unit": signs * weights / basis.scales[columns],
    })  # fmt: skip


def _list_plain(basis: search.Basis) -> list[tuple[int, str]]:
    single = [(place, one) for place, one in enumerate(basis.candidates) if one.parameters == 1]
    return [(place, one.name) for place, one in single if one.name != search.EQUAL]
