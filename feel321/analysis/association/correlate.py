"""Correlations of ratings with metrics over items, with two-way intervals.

Stimuli are a sample too: metrics vary only between stimuli, and stimuli cluster in recordings. An interval
over participants alone treats these recordings as the only ones there will ever be; it covers the truth about
half the time. Conclusions therefore come from the two-way interval, for which participants and recordings are
both drawn anew; the narrower one is reported beside it, by name, for comparison with the literature.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.agreement.reliability import SMALLEST, find_ceiling
from feel321.analysis.contrasts.equivalence import (
    participant_means,
    profile_reducers,
    stimulus_means,
)
from feel321.analysis.resampling import (
    FEWEST_ITEMS,
    METHODS,
    MOST_UNDEFINED,
    PERFECT,
    STILL,
    bootstrap_margin,
    count_scarcest,
    draw_intervals,
    fisher_z,
    measure_lean,
)
from feel321.analysis.table.items import make_items
from feel321.analysis.table.sheet import APART, PAIR

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.resampling import Draws
    from feel321.analysis.table.items import Items
    from feel321.analysis.table.reading import Table

# Why a correlation or its interval is not defined, or less than it seems, told in sentences.


def explain_size(items: Items) -> list[str]:
    """Say what was left out, what cells are missing, and which interval one of a kind does not allow."""
    notes = list(items.notes)
    if items.n_missing:
        cells = items.ratings.size
        notes.append(f"{items.n_missing} of {cells} participant x stimulus cells hold no rating.")
    if items.n_participants < SMALLEST:
        notes.append("One participant only: no interval, the spread between people is unknown.")
    if items.n_recordings < SMALLEST:
        notes.append(
            "One recording only: no two-way interval, the spread between recordings is unknown."
        )
    elif items.n_sources < SMALLEST:
        notes.append(
            "All recordings come from one source: no two-way interval, the spread between sources is unknown."
        )
    elif items.n_sources < items.n_recordings:
        notes.append(
            f"Two-way intervals draw the {items.n_sources} sources of the {items.n_recordings} recordings."
        )
    return notes


def explain_value(items: Items, drawn: Draws, metrics: tuple[str, ...]) -> list[str]:
    """Say why a correlation is not defined, or what it rests on."""
    notes = []
    for row, metric in enumerate(metrics):
        if drawn.of_recordings.size:
            notes += _explain_recordings(drawn.of_recordings[row], metric)
        elif np.isnan(drawn.point[row]):
            notes.append(_explain_undefined(items, metric, row=row))
        if abs(drawn.point[row]) >= PERFECT:
            notes.append(
                f"No interval: the correlation with '{metric}' is perfect, and Fisher's z of that infinite."
            )
    return notes


def _explain_recordings(correlations: NDArray[np.float64], metric: str) -> list[str]:
    """Say which recordings a correlation within recordings does not rest on, or not as they are."""
    n, defined = len(correlations), int(np.isfinite(correlations).sum())
    perfect = int((np.abs(correlations) >= PERFECT).sum())
    why = f"where it takes three rated stimuli that differ in mean rating and in '{metric}'"
    if not defined:
        return [f"No correlation within any of {n} recordings, {why}."]
    notes = [f"{n - defined} of {n} recordings are left out {why}."] if defined < n else []
    if defined < SMALLEST <= n:
        notes.append("One recording only has a correlation within: no two-way interval.")
    if 0 < perfect < n:
        notes.append(
            f"In {perfect} of {n} recordings the correlation with '{metric}' is perfect: Fisher's z is held."
        )
    return notes


def explain_draws(drawn: Draws) -> list[str]:
    """Say how many draws of one metric gave no correlation, both ways of drawing."""
    if np.isnan(drawn.point[0]):
        return []
    two_way = explain_undrawn(drawn.two_way[0], "two-way")
    return [*two_way, *explain_undrawn(drawn.participants[0], "participants-only")]


def explain_undrawn(drawn: NDArray[np.float64], kind: str) -> list[str]:
    """Say how many draws gave no result, or that all gave the same.

    drawn: (draws,), naN where there is none.
    """
    undefined = int(np.isnan(drawn).sum())
    if not undefined:
        same = np.ptp(drawn) <= STILL
        return (
            [f"All {drawn.size} {kind} draws gave the same: no interval without spread."]
            if same
            else []
        )
    why = "fewer than three stimuli, a constant, or all points on a line"
    note = f"{undefined} of {drawn.size} {kind} draws gave no correlation ({why}) and are left out"
    return [
        f"{note}: too many for an interval."
        if undefined > MOST_UNDEFINED * drawn.size
        else f"{note}."
    ]


def _explain_undefined(items: Items, metric: str, *, row: int = 0) -> str:
    if items.n_items < FEWEST_ITEMS:
        return f"No correlation: it needs {FEWEST_ITEMS} test stimuli, got {items.n_items}."
    if np.ptp(items.metrics[row]) == 0:
        return f"No correlation: '{metric}' is the same for every stimulus."
    return "No correlation: the mean rating is the same for every stimulus."


# Does a metric go with what people feel? Item-level correlations with intervals that may be believed.


@dataclass(frozen=True, slots=True)
class Association:
    """How a metric goes with mean ratings over stimuli.

    Parameters
    ----------
    value : float
        Correlation of the stimuli's mean ratings with the metric; NaN where it is not defined.
    low, high : float
        95 % two-way bootstrap interval, over participants and recordings: the one to conclude from. NaN where
        more than a tenth of the draws are undefined.
    n_items : int
        Number of stimuli.
    ceiling : float
        Noise ceiling, sqrt(ICC(C,k)): what a perfect metric would reach with ratings as noisy as these; for the
        within methods, that of differences within recordings. NaN where fewer than half of the stimuli were rated
        by everyone.
    disattenuated : float
        value / ceiling; may exceed 1 by chance. NaN for ranks, whose ceiling this is not, and where the
        ceiling rests on fewer stimuli than the value.
    draws : int
        Two-way draws in which the correlation was defined.
    participants_low, participants_high : float
        95 % bootstrap interval over participants only: it treats these stimuli as the only ones.
    n_participants, n_recordings, n_sources, n_missing : int
        Size of the data; sources are what is independent among recordings, as many as these unless several come from
        one; participant x stimulus cells without a rating.
    metric, method : str
        What was correlated, and how.
    notes : tuple of str
        Why anything is NaN or reduced, one sentence each.
    """

    value: float
    low: float
    high: float
    n_items: int
    ceiling: float
    disattenuated: float
    draws: int
    participants_low: float
    participants_high: float
    n_participants: int
    n_recordings: int
    n_sources: int
    n_missing: int
    metric: str
    method: str
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Difference:
    """How much better one metric goes with mean ratings than another.

    Parameters
    ----------
    value : float
        Correlation with the first metric minus correlation with the second.
    low, high : float
        95 % two-way bootstrap interval of the difference of Fisher's z, expressed as a difference of
        correlations about the same mean z; covers 0 exactly if that does.
    z_value, z_low, z_high : float
        The same as a difference of Fisher's z.
    first_value, second_value : float
        The two correlations.
    n_items, n_participants, n_recordings, n_sources, n_missing : int
        Size of the data, as of `Association`.
    draws : int
        Two-way draws in which the difference was defined.
    first, second, method : str
        What was compared, and how.
    notes : tuple of str
        Why anything is NaN or reduced, one sentence each.
    """

    value: float
    low: float
    high: float
    z_value: float
    z_low: float
    z_high: float
    first_value: float
    second_value: float
    n_items: int
    n_participants: int
    n_recordings: int
    n_sources: int
    n_missing: int
    draws: int
    first: str
    second: str
    method: str
    notes: tuple[str, ...] = ()


def correlate(
    ratings: DataFrame,
    metric: str,
    *,
    method: str = "pearson",
    draws: int = 2000,
    rng: np.random.Generator,
) -> Association:
    """Correlate mean ratings with a metric over test stimuli.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table of one scale, one row per judgement: participant, recording, rating, the metric's column,
        and stimulus_id or reducer (and level). Rows whose role is not ``test`` are left out.
    metric : str
        Column to correlate with.
    method : str
        ``pearson``, ``spearman`` or ``kendall`` (tau-b) over all stimuli; ``within``, ``within_spearman`` or
        ``within_kendall`` within each recording, averaged over Fisher's z.
    draws : int
        Number of bootstrap draws, at least 2; 2000 or more for results to be published.
    rng : Generator
        Source of randomness; the same state gives the same result to the last bit.

    Returns
    -------
    Association
        The correlation, its intervals, and its ceiling.

    Raises
    ------
    ValueError
        If the table lacks a column, mixes scales or holds values that are not finite, or an argument is not
        allowed.

    Notes
    -----
    A stimulus's rating is the mean over participants of each participant's mean over repeats. With R
    recordings, T the correlation and T* its bootstrap draws, the interval is tanh(atanh T ± t(.975, R - 1)
    sqrt(R / (R - 1)) SD(atanh T*)). Averaging the stimuli first keeps the many rows of one stimulus from
    posing as independent evidence. Missing cells are allowed; a stimulus then rests on the participants who
    rated it.

    With P participants, fewer than R, P takes the place of R. The formula with R was made for studies with
    more people than recordings; two or three people know their spread on P - 1 degrees of freedom only, and
    with R in both places the interval covered the truth in 67 % (P = 2) and 76 % (P = 3) of simulated studies.

    A draw is undefined, and left out, if it has fewer than three different stimuli, a constant, or all points
    on one line.

    Which method: ``pearson`` asks how straight the relation is, ``spearman`` and ``kendall`` how monotone. All three
    also count that a recording with a higher metric is rated higher, whatever the reason. The within methods compare
    stimuli of the same recording only: with z_r = atanh of the correlation in recording r, tanh(Σ z_r / R), over the
    recordings in which it is defined (three stimuli, neither constant); that is the claim about a metric of reducers.
    With few stimuli per recording single z_r are noisy, and by ranks perfect ones are common: see
    `average_recordings`. The mean z leans to the far side by about r / (2 (n_r - 1)); the intervals of
    ``within`` are drawn about the mean z less that, or they would cover 91 % at six stimuli a recording (sim).

    References
    ----------
    Silver & Dunlap (1987), Averaging correlation coefficients, Journal of Applied Psychology 72, 146-148, doi
    10.1037/0021-9010.72.1.146.
    Owen (2007), The pigeonhole bootstrap, Annals of Applied Statistics 1, 386-411, doi 10.1214/07-AOAS122.

    Examples
    --------
    >>> import pandas as pd
    >>> tidy = pd.DataFrame({"participant": list("aaaabbbb"), "recording": list("rrssrrss"),
    ...     "reducer": ["mag321", "dft321"] * 4, "spectral_match": [0.2, 1, 0.4, 1] * 2,
    ...     "rating": [20, 70, 35, 90, 25, 80, 30, 75]})
    >>> result = correlate(tidy, "spectral_match", rng=np.random.default_rng(1))
    >>> round(result.value, 2), result.n_items
    (0.99, 4)
    """
    _check_request(method, draws)
    items, how = make_items(ratings, [metric]), METHODS[method]
    drawn = draw_intervals(items, method, draws=draws, rng=rng)
    value = float(drawn.point[0])
    middle = float(fisher_z(drawn.point)[0] - measure_lean(items, method, drawn)[0])
    low, high = _interval(middle, drawn.two_way[0], n_units=count_scarcest(items, drawn))
    narrow_low, narrow_high = _interval(middle, drawn.participants[0], n_units=items.n_participants)
    ceiling, more_notes = find_ceiling(items, within=how.within)
    notes = [
        *explain_size(items),
        *explain_value(items, drawn, (metric,)),
        *explain_draws(drawn),
        *more_notes,
    ]
    divisible = not how.ranked and not items.n_missing
    return Association(
        value=value, low=low, high=high, n_items=items.n_items, ceiling=ceiling,
        disattenuated=value / ceiling if divisible else float("nan"), draws=int(np.isfinite(drawn.two_way[0]).sum()),
        participants_low=narrow_low, participants_high=narrow_high,
        n_participants=items.n_participants, n_recordings=items.n_recordings, n_sources=items.n_sources,
        n_missing=items.n_missing, metric=metric, method=method, notes=tuple(notes),
    )  # fmt: skip


def compare_metrics(
    ratings: DataFrame,
    first: str,
    second: str,
    *,
    method: str = "pearson",
    draws: int = 2000,
    rng: np.random.Generator,
) -> Difference:
    """Compare two metrics by how strongly mean ratings go with each.

    Parameters
    ----------
    ratings : DataFrame
        Tidy table of one scale, as for `correlate`.
    first, second : str
        Columns to compare.
    method : str
        As for `correlate`.
    draws : int
        Number of bootstrap draws, at least 2.
    rng : Generator
        Source of randomness.

    Returns
    -------
    Difference
        The first correlation minus the second, with the two-way interval.

    Raises
    ------
    ValueError
        If the table lacks a column, mixes scales or holds values that are not finite, or an argument is not
        allowed.

    Notes
    -----
    Both correlations are recomputed in every draw, so their dependence is accounted for. With d = atanh r1 -
    atanh r2, the interval is d ± t(.975, R - 1) sqrt(R / (R - 1)) SD(d*), P in the place of R as for
    `correlate`. It is told as a difference of
    correlations by d -> tanh(m + d / 2) - tanh(m - d / 2), m the mean of the two z.
    """
    _check_request(method, draws)
    if first == second:
        raise ValueError(f"second: got {second!r} twice, allowed is another metric than the first")
    items = make_items(ratings, [first, second])
    drawn = draw_intervals(items, method, draws=draws, rng=rng)
    z_first, z_second = fisher_z(drawn.point)
    differences = np.subtract(*drawn.two_way)
    notes = [*explain_size(items), *explain_value(items, drawn, (first, second))]
    if np.isfinite(drawn.point).all():
        notes += explain_undrawn(differences, "two-way")
    z, margin = z_first - z_second, bootstrap_margin(differences, count_scarcest(items, drawn))
    z_range = z - np.subtract(*measure_lean(items, method, drawn)) + np.array([-margin, margin])
    middle = (z_first + z_second) / 2
    low, high = np.tanh(middle + z_range / 2) - np.tanh(middle - z_range / 2)
    return Difference(
        value=float(drawn.point[0] - drawn.point[1]), low=float(low), high=float(high),
        z_value=float(z), z_low=float(z_range[0]), z_high=float(z_range[1]),
        first_value=float(drawn.point[0]), second_value=float(drawn.point[1]),
        n_items=items.n_items, n_participants=items.n_participants, n_recordings=items.n_recordings,
        n_sources=items.n_sources, n_missing=items.n_missing, draws=int(np.isfinite(differences).sum()),
        first=first, second=second, method=method, notes=tuple(notes),
    )  # fmt: skip


def _check_request(method: str, draws: int) -> None:
    if method not in METHODS:
        raise ValueError(f"method: got {method!r}, allowed is one of {', '.join(METHODS)}")
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(
            f"draws: got {draws}, allowed is 2 or more; use 2000 for results to be published"
        )


def _interval(z: float, drawn: NDArray[np.float64], *, n_units: int) -> tuple[float, float]:
    margin = bootstrap_margin(drawn, n_units)
    return float(np.tanh(z - margin)), float(np.tanh(z + margin))


# Everything that is computed from a table of ratings, before a word or a picture is made of it.


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Findings on the test stimuli of one scale and one level."""

    scale: str
    level: str
    associations: tuple[Association, ...]
    differences: tuple[Difference, ...]
    stimuli: DataFrame


@dataclass(frozen=True, slots=True, eq=False)
class Findings:
    """Everything computed from a table."""

    panels: tuple[Panel, ...]
    profile: DataFrame
    participants: DataFrame
    scales: tuple[str, ...]


def analyse(table: Table, *, draws: int, rng: np.random.Generator) -> Findings:
    """Compute everything that a report shows."""
    rows = table.rows
    refuse_untested(table)
    rated = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    groups = rated.groupby(["scale", "level"], observed=True)
    panels = tuple(make_panel(part, table.metrics, draws=draws, rng=rng) for _, part in groups)
    single = rows[rows["role"] != PAIR]
    return Findings(
        panels,
        profile_reducers(single),
        participant_means(single),
        tuple(sorted(rows["scale"].unique())),
    )


def refuse_untested(table: Table) -> None:
    """Refuse ratings of references and anchors alone."""
    if not table.rows["role"].isin(["test", PAIR]).any():
        raise ValueError("ratings: got none of a stimulus with role 'test'; at least one is needed")


def make_panel(
    part: DataFrame, metrics: tuple[str, ...], *, draws: int, rng: np.random.Generator
) -> Panel:
    """Correlate the ratings of one scale and one level with every metric, by every method."""
    # The same draws for every metric and method: a further metric changes nothing, and metrics that say the same get
    # the same intervals.
    seed = int(rng.integers(2**63))
    one = [(metric, method) for metric in metrics for method in METHODS]
    two = [
        (first, second, method) for first, second in combinations(metrics, 2) for method in METHODS
    ]
    of_stimuli = part.drop_duplicates("stimulus_id").set_index("stimulus_id")[list(metrics)]
    return Panel(
        scale=str(part["scale"].iloc[0]),
        level=str(part["level"].iloc[0]),
        associations=tuple(
            correlate(part, metric, method=method, draws=draws, rng=np.random.default_rng(seed))
            for metric, method in one
        ),
        differences=tuple(
            compare_metrics(
                part, first, second, method=method, draws=draws, rng=np.random.default_rng(seed)
            )
            for first, second, method in two
        ),
        stimuli=stimulus_means(part).join(of_stimuli, on="stimulus_id"),
    )


def stack_records(panels: Sequence[Panel], kind: str) -> DataFrame:
    """Lay associations or differences out as a table to be written."""
    import pandas as pd

    return pd.DataFrame([
        {
            "scale": panel.scale,
            "level": panel.level,
            **asdict(record),
            "notes": " ".join(record.notes),
        }
        for panel in panels
        for record in getattr(panel, kind)
    ])
