"""The least sufficient reducer of a scene: the first, by simplicity, that is equivalent to the best within tolerance.

The best is looked for among all reducers, whether the context has room for them or not: a budget takes candidates away,
it does not make what is left any better. Where nothing that is left suffices, that is the answer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.advise.axes import list_axes
from analysis.tradeoff.advise.draws import SEGMENTS, Candidate, score_scene
from analysis.tradeoff.advise.measures import find_gains, measure
from analysis.tradeoff.advise.scene import ANY, SHORTEST_S
from analysis.tradeoff.advise.simplicity import find_cost, list_windows
from analysis.tradeoff.advise.verdict import Shortfall, Verdict, compare
from analysis.tradeoff.advise.wording import tell_choice, tell_closest, tell_doubt
from stimuli.perception import felt_level
from stimuli.reduce import REDUCERS
from stimuli.spectrum import LOWEST_HZ

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from analysis.tradeoff.advise.draws import Draw
    from analysis.tradeoff.advise.scene import Context, Scene
    from analysis.tradeoff.advise.simplicity import Cost
    from analysis.tradeoff.advise.verdict import Rated
    from stimuli.reduce import Reducer

SAME = 1e-9
"""Shortfalls this close are equal but for rounding."""


@dataclass(frozen=True, slots=True)
class Advice:
    """What a scene needs.

    Parameters
    ----------
    scene : Scene
        The scene.
    verdicts : tuple of Verdict
        Every reducer, the simplest first.
    answer : str or None
        The simplest sufficient one; None if there is none in the budget.
    closest : str or None
        The answer, or where there is none the one that gives up least; None for a scene without vibration.
    runner_up : str or None
        The next simplest sufficient one.
    ties : tuple of str
        Reducers that are as simple and as good as the answer, or as the closest.
    margin : float
        Share of the tolerance that the answer, or the closest, leaves; negative if it does not suffice.
    reason : str
        Why, in one sentence.
    close : bool
        Whether another take of the scene might have given another answer.
    """

    scene: Scene
    verdicts: tuple[Verdict, ...]
    answer: str | None
    closest: str | None
    runner_up: str | None
    ties: tuple[str, ...]
    margin: float
    reason: str
    close: bool = False

    @property
    def line(self) -> str:
        """All of it in one line."""
        tied = f" (tied with {', '.join(self.ties)})" if self.ties else ""
        if self.closest is None:
            return f"{self.scene.name}: no advice, {self.reason}"
        if self.answer is None:
            return f"{self.scene.name}: nothing suffices, closest {self.closest}{tied}: {self.reason}"
        place = f"runner-up {self.runner_up or 'none'}, margin {100 * self.margin:.0f} %"
        return f"{self.scene.name}: {self.answer}{tied}, {place}: {self.reason}"


def advise_scene(
    scene: Scene,
    context: Context,
    *,
    seed: int = 0,
    reducers: Mapping[str, Reducer] = REDUCERS,
    ratings: Mapping[str, Rated] | None = None,
) -> Advice:
    """Find the simplest sufficient reducer of a scene.

    Parameters
    ----------
    scene : Scene
        The scene.
    context : Context
        Where the reducer is to run, and what is good enough.
    seed : int
        Of the sensor noise that steadiness is tried with.
    reducers : Mapping of str to callable
        Candidates by name; their order does not matter.
    ratings : Mapping of str to Rated, optional
        What people said of the scene, by reducer.

    Returns
    -------
    Advice
        The answer and what it rests on.

    Raises
    ------
    ValueError
        If nothing is recorded of a reducer's cost.

    Examples
    --------
    >>> from analysis.tradeoff.advise.scene import Context, split_recording
    >>> from stimuli.synthesis import make_scene
    >>> (scene,) = split_recording(make_scene("constrained_drag", duration_s=1.0))
    >>> advise_scene(scene, Context()).answer
    'pca321'
    >>> advise_scene(scene, Context(online=True, latency_ms=20)).answer
    'pca321_adaptive@10ms'
    """
    if problem := _find_problem(scene):
        return Advice(scene, (), None, None, None, (), float("nan"), problem)
    candidates = dict(_list_candidates(scene, context, reducers))
    named = {cost.name: candidate for cost, candidate in candidates.items()}
    compared = partial(compare, gains_db=find_gains(list(named.values())), tolerance=context.tolerance)
    scored = score_scene(scene.recording, named, compared, any_mounting=context.mounting == ANY, seed=seed)
    return choose(scene, judge(candidates, scored, context, ratings=ratings), context)


def judge(
    candidates: Mapping[Cost, Candidate],
    scored: tuple[list[Draw], NDArray[np.float64]],
    context: Context,
    *,
    ratings: Mapping[str, Rated] | None = None,
) -> list[Verdict]:
    """Judge reducers against the best of them, by the draw that decides.

    Parameters
    ----------
    candidates : Mapping of Cost to Candidate
        All reducers, in any order.
    scored : tuple of (list of Draw, ndarray)
        What `draws.score_scene` gave of them.
    context : Context
        Budget and tolerance.
    ratings : Mapping of str to Rated, optional
        What people said, by reducer.

    Returns
    -------
    list of Verdict
        The simplest first; of equally simple ones the better, of equally good ones by alphabet.
    """
    rated, (draws, scores) = ratings or {}, scored
    shortfalls = compare(scores, find_gains(list(candidates.values())), context.tolerance)
    best = np.fmax.reduce(scores[..., 1:3], axis=0)
    verdicts = []
    for row, (cost, candidate) in enumerate(candidates.items()):
        decides, suits = find_deciding(draws, shortfalls[row].max(axis=-1))
        verdicts.append(Verdict(
            cost, measure(candidate, draws[decides], scores[row, decides]),
            Shortfall(*shortfalls[row, decides].tolist()), in_budget=cost.latency_ms <= context.room_ms,
            rated=rated.get(cost.name), needs_ratings=bool(rated), best_spectrum=float(best[decides, 0]),
            best_time=float(best[decides, 1]), suits=sum(suits), segments=len(suits),
        ))  # fmt: skip
    return sorted(verdicts, key=lambda verdict: _place(verdict, context))


def find_deciding(draws: Sequence[Draw], worst: NDArray[np.float64]) -> tuple[int, list[bool]]:
    """Find the draw that decides: the worst mounting of the worst segment, or of that at the 90th percentile.

    Parameters
    ----------
    draws : sequence of Draw
        The draws.
    worst : ndarray, shape (n_draws,)
        Largest shortfall of a reducer in each; NaN where it was not tried.

    Returns
    -------
    decides : int
        Which draw.
    suits : list of bool
        By segment, whether the reducer is within tolerance whatever the mounting.
    """
    known = np.where(np.isnan(worst), -np.inf, worst)
    places: dict[int, list[int]] = {}
    for place, draw in enumerate(draws):
        places.setdefault(id(draw.segment), []).append(place)
    of_segments = [max(own, key=lambda place: known[place]) for own in places.values()]
    ordered = sorted(of_segments, key=lambda place: known[place])
    return ordered[math.ceil(SEGMENTS * len(ordered) - SAME) - 1], [bool(known[place] <= 1) for place in of_segments]


def choose(scene: Scene, verdicts: Sequence[Verdict], context: Context) -> Advice:
    """Choose the first that is sufficient.

    Parameters
    ----------
    scene : Scene
        The scene.
    verdicts : sequence of Verdict
        The simplest first; one at least is in the budget.
    context : Context
        Decides which are equally simple.

    Returns
    -------
    Advice
        With its reason.
    """
    running = [verdict for verdict in verdicts if verdict.in_budget]
    sufficient = [verdict for verdict in running if verdict.is_sufficient]
    best = sufficient[0] if sufficient else min(running, key=_find_lag)
    rivals = sufficient if sufficient else running
    ties = tuple(sorted(other.name for other in rivals if other is not best and _ties(best, other, context)))
    further = (other.name for other in sufficient[1:] if other.name not in ties)
    tell = tell_choice if sufficient else tell_closest
    return Advice(
        scene=scene, verdicts=tuple(verdicts), answer=best.name if sufficient else None, closest=best.name,
        runner_up=next(further, None), ties=ties, margin=best.margin, reason=tell(best, verdicts),
        close=bool(tell_doubt(best, verdicts)),
    )  # fmt: skip


def find_common(advices: Sequence[Advice]) -> tuple[str, ...]:
    """Find the reducers that suffice in every scene that has vibration.

    Parameters
    ----------
    advices : sequence of Advice
        Of one context.

    Returns
    -------
    tuple of str
        The simplest first, by the first of the scenes.
    """
    judged = [advice.verdicts for advice in advices if advice.verdicts]
    serving = [{each.name for each in verdicts if each.in_budget and each.is_sufficient} for verdicts in judged]
    return tuple(each.name for each in (judged[0] if judged else ()) if all(each.name in names for names in serving))


def _list_candidates(
    scene: Scene, context: Context, reducers: Mapping[str, Reducer]
) -> Iterator[tuple[Cost, Candidate]]:
    n_samples, rate_hz = scene.recording.n_samples, scene.recording.rate_hz
    for name, reducer in reducers.items():
        for label, window_s in list_windows(name, reducer, longest_ms=context.room_ms):
            cost = find_cost(name, reducer, n_samples=n_samples, rate_hz=rate_hz, window_s=window_s)
            chosen = {} if label == name else {"window_s": window_s}
            yield replace(cost, name=label), Candidate(name, partial(reducer, **chosen))
    yield from list_axes(context.axes, n_samples)


def _find_problem(scene: Scene) -> str:
    recording = scene.recording
    if recording.duration_s < SHORTEST_S:
        return f"it lasts {recording.duration_s:.3f} s and 20 Hz need {SHORTEST_S} s"
    if recording.rate_hz < 2 * LOWEST_HZ or not felt_level(recording.acceleration, recording.rate_hz) > 0:
        return "it is silent from 20 to 1000 Hz"
    return ""


def _place(verdict: Verdict, context: Context) -> tuple[object, ...]:
    # Rounded, so that what differs by rounding only goes by alphabet.
    return (*verdict.cost.rank(online=context.online), round(verdict.shortfall.worst / SAME), verdict.name)


def _find_lag(verdict: Verdict) -> tuple[bool, bool, bool, float]:
    """Order reducers that do not suffice: people's word first, then the metrics'; of equals the simpler stays first.

    What people were asked about comes before what they were not.
    """
    unknown = verdict.needs_ratings and verdict.rated is None
    agreed = verdict.rated.suffices if verdict.rated else not verdict.needs_ratings
    return not agreed, not verdict.fits, unknown, round(verdict.shortfall.worst / SAME) * SAME


def _ties(best: Verdict, other: Verdict, context: Context) -> bool:
    alike = best.cost.rank(online=context.online) == other.cost.rank(online=context.online)
    same_word = _find_lag(best)[:-1] == _find_lag(other)[:-1]
    return alike and same_word and abs(best.shortfall.worst - other.shortfall.worst) <= 2 * SAME
