"""Power for choices: participants and pairs that show which of two metrics predicts choices better, by simulation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations, product
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from feel321.analysis.arrays import CONFIDENCE, Values, check_columns
from feel321.analysis.choices.predict import infer_difference, score_metrics
from feel321.analysis.choices.votes import Votes
from feel321.analysis.table.items import ROLE, STIMULUS, TEST
from feel321.doors import as_rng
from feel321.records import Result

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.types import Direction, Rng

    Codes = NDArray[np.intp]

LARGEST_WEIGHT = 20.0
CLOSE = 0.005
"""Shares must be reached to half a percent."""

NODES = 21


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class ChoicePower(Result):
    """Power to show that one metric predicts choices better than another.

    Parameters
    ----------
    table : DataFrame
        One row per size of study: ``participants``, ``recordings``, ``pairs`` of each recording, ``votes``, ``power``
        at 5 % two-sided, ``low`` and ``high``, its 95 % Wilson interval over simulated studies, and ``difference``, the
        mean difference of the shares.
    shares : tuple of float
        Shares of choices that the two metrics predict, as planted.
    weights : tuple of float
        Their weights: log odds per unit of root mean square difference.
    agreement : float
        Share of pairs on which the two metrics agree: what they disagree about is all that can show a difference.
    runs : int
        Simulated studies per row.
    """

    table: DataFrame
    shares: tuple[float, float]
    weights: tuple[float, float]
    agreement: float
    runs: int

    def to_frame(self) -> DataFrame:
        """Return the power by size of study.

        Returns
        -------
        DataFrame
            The columns of `table`.
        """
        return self.table


class _Pairs(NamedTuple):
    """All pairs within recordings: numbers of the recording, (n_pairs,), and scaled differences, (n_pairs, 2)."""

    recording: Codes
    differences: Values


def plan_choices(  # noqa: PLR0913 - a study has that many sizes
    stimuli: DataFrame,
    metrics: Sequence[str],
    *,
    shares: tuple[float, float],
    participants: Sequence[int] = (10, 20, 40),
    pairs: Sequence[int | None] = (None,),
    stimulus_sd: float = 0.5,
    lapse: float = 0.05,
    higher: Mapping[str, Direction] | None = None,
    runs: int = 300,
    rng: Rng = 0,
) -> ChoicePower:
    """Find by simulation of this study how many participants and pairs show which of two metrics predicts better.

    Parameters
    ----------
    stimuli : DataFrame
        The manifest: ``stimulus_id``, ``recording``, both metrics, and ``role`` and ``level`` where there are any; only
        test stimuli are compared.
    metrics : sequence of two str
        The metrics.
    shares : tuple of two float
        Share of choices that each predicts in truth, 0.5 to 1.
    participants : sequence of int
        Numbers of participants to try.
    pairs : sequence of int or None
        Numbers of pairs per recording that each participant judges once, drawn at random; None for all.
    stimulus_sd : float
        Standard deviation, in log odds, of what makes a stimulus be chosen besides both metrics, 0 or more.
    lapse : float
        Share of choices that rest on nothing felt, 0 to less than 0.5.
    higher : Mapping of str to {"better", "worse"}, optional
        Whether a larger value of a metric is better or worse; better if left out.
    runs : int
        Simulated studies per size, at least 2.
    rng : int or Generator
        Seed, or source of randomness.

    Returns
    -------
    ChoicePower
        Power by size.

    Raises
    ------
    ValueError
        If the metrics cannot have these shares in these stimuli: they differ in too few pairs.

    Notes
    -----
    Choices follow the model of `fit_choices` with the two metrics, their weights chosen so that the shares are those
    asked for, plus a quality of each stimulus that is drawn anew in every simulated study: more participants do not
    average it out, more recordings do. Each study is then evaluated as `predict_votes` does.

    Examples
    --------
    >>> import numpy as np
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> values = np.random.default_rng(0).random((40, 2))
    >>> stimuli = pd.DataFrame(values, columns=["new", "old"]).assign(
    ...     stimulus_id=[f"s{k}" for k in range(40)], recording=np.repeat(np.arange(8), 5))
    >>> power = analysis.plan_choices(stimuli, ["new", "old"], shares=(0.72, 0.55), participants=[4, 30], runs=40)
    >>> bool(power.table["power"].is_monotonic_increasing)
    True
    """
    limited = {"lapse": (lapse, 0.5), "stimulus_sd": (stimulus_sd, np.inf)}
    _check_plan(metrics, shares, limited=limited, runs=runs)
    met, stimulus = _list_pairs(stimuli, metrics, higher or {})
    weights = _find_weights(met.differences, shares, lapse=lapse, stimulus_sd=stimulus_sd)
    truth = _Truth(
        np.array(weights), stimulus, stimulus_sd, lapse, float(np.sign(shares[0] - shares[1]))
    )
    generator = as_rng(rng)
    rows = [
        _simulate(met, truth, size=(people, count), runs=runs, rng=generator)
        for people, count in product(participants, pairs)
    ]
    import pandas as pd

    alike = float((np.sign(met.differences).prod(axis=1) > 0).mean())
    return ChoicePower(pd.DataFrame(rows), (shares[0], shares[1]), weights, alike, runs)


def _check_plan(
    metrics: Sequence[str],
    shares: tuple[float, float],
    *,
    limited: Mapping[str, tuple[float, float]],
    runs: int,
) -> None:
    if isinstance(metrics, str) or len(metrics) != 2:  # noqa: PLR2004 - one against another
        raise ValueError(f"metrics must be two names, got {metrics!r}")
    if len(shares) != 2 or not all(0.5 <= share < 1 for share in shares):  # noqa: PLR2004 - of two metrics; chance
        raise ValueError(f"shares must be two numbers from 0.5 to less than 1, got {shares}")
    for name, (value, limit) in limited.items():
        if not 0 <= value < limit:
            raise ValueError(f"{name} must be from 0 to less than {limit:g}, got {value}")
    if runs < 2:  # noqa: PLR2004 - a share of runs
        raise ValueError(f"runs must be 2 or more, got {runs}; use 300 or more")


def _list_pairs(
    stimuli: DataFrame, metrics: Sequence[str], higher: Mapping[str, Direction]
) -> tuple[_Pairs, Codes]:
    """List all pairs of test stimuli of a recording and level; also the numbers of both stimuli, (n_pairs, 2)."""
    listed = stimuli.reset_index() if STIMULUS not in stimuli else stimuli
    check_columns(listed, [STIMULUS, "recording", *metrics], "stimuli")
    tests = listed[listed[ROLE] == TEST] if ROLE in listed else listed
    tests = tests[tests[list(metrics)].notna().all(axis=1)].reset_index(drop=True)
    arms = ["recording", *(["level"] if "level" in tests else [])]
    groups = (part.index.tolist() for _, part in tests.groupby(arms, sort=True))
    both = [pair for members in groups for pair in combinations(members, 2)]
    if not both:
        raise ValueError(
            "stimuli must hold two test stimuli of a recording or more, got none; build more reducers"
        )
    codes = np.array(both, dtype=np.intp)
    signs = np.array([-1.0 if higher.get(name) == "worse" else 1.0 for name in metrics])
    values = tests[list(metrics)].to_numpy(np.float64) * signs
    differences = values[codes[:, 0]] - values[codes[:, 1]]
    sizes = np.sqrt((differences**2).mean(axis=0))
    if not sizes.all():
        flat = metrics[int(sizes.argmin())]
        raise ValueError(f"metrics must differ between stimuli, got the same values of {flat!r}")
    recording = np.unique(tests["recording"].to_numpy()[codes[:, 0]], return_inverse=True)[1]
    return _Pairs(recording.astype(np.intp), differences / sizes), codes


def _find_weights(
    differences: Values, shares: tuple[float, float], *, lapse: float, stimulus_sd: float
) -> tuple[float, float]:
    """Find the weights with which the metrics predict these shares of choices."""
    from scipy.optimize import least_squares

    nodes, chances = np.polynomial.hermite_e.hermegauss(NODES)
    # The difference of two qualities.
    spread, chances = stimulus_sd * np.sqrt(2) * nodes, chances / chances.sum()

    def miss(weights: Values) -> Values:
        odds = (differences @ weights)[:, None] + spread
        chance = lapse / 2 + (1 - lapse) * (1 / (1 + np.exp(-odds))) @ chances
        sure = np.sign(differences) * (chance - 0.5)[:, None]
        return np.asarray(0.5 + sure.mean(axis=0) - shares, dtype=np.float64)

    found = least_squares(miss, np.zeros(2), bounds=(-LARGEST_WEIGHT, LARGEST_WEIGHT))
    if np.abs(found.fun).max() > CLOSE:
        reached = found.fun + shares
        raise ValueError(
            f"shares must be possible with these stimuli, got {shares[0]:g} and {shares[1]:g}; the nearest are "
            f"{reached[0]:.2f} and {reached[1]:.2f}; the metrics agree on too many pairs, or lapse and "
            "stimulus_sd leave too little"
        )
    return float(found.x[0]), float(found.x[1])


class _Truth(NamedTuple):
    """What choices follow in truth."""

    weights: Values
    stimulus: Codes
    stimulus_sd: float
    lapse: float
    sign: float


def _simulate(
    met: _Pairs, truth: _Truth, *, size: tuple[int, int | None], runs: int, rng: np.random.Generator
) -> dict[str, float]:
    people, count = size
    found = [_run_once(met, truth, size=size, rng=rng) for _ in range(runs)]
    shown = sum(p < 1 - CONFIDENCE and difference * truth.sign >= 0 for difference, p, _ in found)
    low, high = _wilson(shown, runs)
    n_recordings = len(np.unique(met.recording))
    return {
        "participants": people, "recordings": n_recordings,
        "pairs": len(met.recording) / n_recordings if count is None else count,
        "votes": float(np.mean([n for *_, n in found])), "power": shown / runs, "low": low, "high": high,
        "difference": float(np.mean([difference for difference, *_ in found])),
    }  # fmt: skip


def _run_once(
    met: _Pairs, truth: _Truth, *, size: tuple[int, int | None], rng: np.random.Generator
) -> tuple[float, float, int]:
    """Simulate a study and evaluate it; returns the difference of shares, its p, and the number of votes."""
    people, count = size
    quality = rng.normal(0, truth.stimulus_sd, truth.stimulus.max() + 1)[truth.stimulus]
    odds = met.differences @ truth.weights + quality[:, 0] - quality[:, 1]
    chance = truth.lapse / 2 + (1 - truth.lapse) / (1 + np.exp(-odds))
    asked = np.tile(np.arange(len(odds)), (people, 1))
    if count is not None:
        place = np.argsort(rng.random(asked.shape) + met.recording, axis=1)
        first = np.searchsorted(np.sort(met.recording), met.recording[place])
        asked = place[np.arange(asked.shape[1]) - first < count].reshape(people, -1)
    pair = asked.ravel()
    who = np.repeat(np.arange(people), asked.shape[1])
    votes = Votes(
        participant=who, source=met.recording[pair], pair=pair, turned=np.zeros(len(pair), dtype=bool),
        first=truth.stimulus[pair, 0], second=truth.stimulus[pair, 1], chose_first=rng.random(len(pair)) < chance[pair],
        names=(), metrics=("one", "other"), differences=met.differences[pair],
    )  # fmt: skip
    told = infer_difference(votes, score_metrics(votes))
    return told["difference"], told["p"], len(pair)


def _wilson(hits: int, n: int) -> tuple[float, float]:
    from scipy.stats import binomtest

    interval = binomtest(hits, n).proportion_ci(CONFIDENCE, method="wilson")
    return float(interval.low), float(interval.high)
