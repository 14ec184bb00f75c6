"""The least sufficient reducer of a scene: the simplest that is equivalent to the best within tolerance.

The best is looked for among all reducers, whether the context has room for them or not: a budget takes candidates away,
it does not make what is left any better. Where nothing that is left suffices, that is the answer.

No reducer is needed then, but one may still be enough: a vibration along one line needs one axis of the actuator,
whatever it can move besides. The measures of one axis carry over: level and spectrum are those of the energies' sum,
and the share of the motion's energy that goes along with the output is the share that is kept.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isinf, isnan
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.advise.draws import SEGMENTS, Candidate, score_scene
from feel321.analysis.tradeoff.advise.measures import (
    COVARIANCE,
    MEAN,
    PROJECTION,
    Cost,
    find_cost,
    find_gains,
    list_windows,
    measure,
)
from feel321.analysis.tradeoff.advise.scene import (
    ALL_AXES,
    ANY,
    SHORTEST_S,
    Shortfall,
    Verdict,
    compare,
)
from feel321.stimuli.match import LOWEST_HZ
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.anchors import felt_level

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from feel321.analysis.tradeoff.advise.draws import Draw
    from feel321.analysis.tradeoff.advise.measures import Measures
    from feel321.analysis.tradeoff.advise.scene import Context, Rated, Scene
    from feel321.stimuli.reducers.registry import Reducer

# Why this reducer and no simpler one, in one sentence.

CLOSE = 0.2
"""A reducer that is nearer to the limit than this share of the tolerance makes a close call. In eight takes of every
bundled scene (4 s each, other seeds) the shortfall of reducers near the limit has a standard deviation of 0.1; this is
twice that. A simpler reducer that suffices in some segments only makes one too."""

NAMED = 2
"""So many of them are named, the nearest first."""


def tell_choice(chosen: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say why a reducer is the simplest sufficient one."""
    simpler = verdicts[: list(verdicts).index(chosen)]
    parts = [
        _tell_kept(chosen),
        _tell_simpler([verdict for verdict in simpler if verdict.in_budget]),
    ]
    parts += [
        f"{each.name} is simpler and would do, but {_tell_wait(each)}"
        for each in _list_barred(simpler)[:1]
    ]
    if chosen.rated:
        parts.append("simulated participants agree" if chosen.rated.simulated else "people agree")
    return "; ".join(filter(None, [*parts, tell_doubt(chosen, verdicts)]))


def tell_closest(closest: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say why nothing suffices, and what would."""
    barred = _list_barred(verdicts)
    alone = "no reducer is within tolerance of the best in everything"
    if any(verdict.fits and verdict.in_budget for verdict in verdicts):
        alone = "none of those within tolerance by the metrics is shown by ratings to feel like the best"
    would = f"{barred[0].name} would do, but {_tell_wait(barred[0])}" if barred else alone
    return "; ".join(
        filter(None, [f"it {tell_fault(closest)}", would, tell_doubt(closest, verdicts)])
    )


def tell_doubt(answer: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say whether another take of the scene might have given another answer."""
    simpler = verdicts[: list(verdicts).index(answer)]
    running = [each for each in (*simpler, answer) if each.in_budget]
    near = sorted(
        (each for each in running if abs(each.margin) < CLOSE), key=lambda each: abs(each.margin)
    )
    told = [
        f"{one.name} {'passes' if one.fits else 'misses'} by {abs(100 * one.margin):.0f} %"
        for one in near[:NAMED]
    ]
    told[-1:] = [f"{last} of the tolerance" for last in told[-1:]]
    partly = [each for each in running if each.suits_partly and each not in near]
    told += [
        f"{each.name} suffices in {each.suits} of {each.segments} segments" for each in partly[-1:]
    ]
    return f"a close call, another take may go the other way: {', '.join(told)}" if told else ""


def tell_fault(verdict: Verdict) -> str:
    """Say what is most wrong with a reducer's output."""
    if verdict.fits:
        return _tell_raters(verdict)
    measures = verdict.measures
    if verdict.shortfall.criterion == "level":
        return _tell_level(measures)
    if verdict.shortfall.criterion == "spectrum":
        best = verdict.best_spectrum
        return f"has {100 * measures.spectrum:.0f} % of the spectrum right, the best {100 * best:.0f} %"
    if verdict.shortfall.criterion == "time":
        best = verdict.best_time**2
        return f"goes along with {100 * measures.time**2:.0f} % of the motion's energy, the best {100 * best:.0f} %"
    return f"changes by {100 * measures.change:.0f} % with sensor noise of -60 dB"


def _tell_kept(verdict: Verdict) -> str:
    measures = verdict.measures
    spectrum, motion = (f"{100 * share:.0f} %" for share in (measures.spectrum, measures.time**2))
    return f"keeps {spectrum} of the spectrum, {motion} of the motion, the level to {abs(measures.level_db):.1f} dB"


def _tell_level(measures: Measures) -> str:
    level_db, deviation_db = measures.level_db, measures.deviation_db
    if abs(level_db) < deviation_db:
        return f"loses {deviation_db:.1f} dB, which its gain hides (a sum of three axes is √3, 4.8 dB, louder)"
    return f"is {abs(level_db):.1f} dB too {'weak' if level_db < 0 else 'strong'}"


def _tell_raters(verdict: Verdict) -> str:
    if verdict.rated is None:
        return "was not rated"
    if isnan(verdict.rated.p):
        return f"is not shown to feel like {verdict.rated.best}, because so few ratings leave no error to test with"
    return (
        f"is not shown to feel like {verdict.rated.best} (p of equivalence {verdict.rated.p:.2g})"
    )


def _tell_simpler(simpler: Sequence[Verdict]) -> str:
    if not simpler:
        return "nothing is simpler"
    # Prefer those that pass the metrics but fail the ratings: that disagreement is the interesting reason.
    nearest = min(
        simpler,
        key=lambda verdict: (not verdict.fits, verdict.rated is None, verdict.shortfall.worst),
    )
    return f"the best of the simpler, {nearest.name}, {tell_fault(nearest)}"


def _list_barred(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.is_sufficient and not verdict.in_budget]


def _tell_wait(verdict: Verdict) -> str:
    wait = verdict.cost.latency_ms
    return "needs the whole recording" if isinf(wait) else f"needs {wait:.1f} ms"


# What an actuator of several axes can play instead of a reduced signal: the strongest two axes, or the recording.

TWO, THREE = "two_principal_axes", "three_axes"
"""Their names: the two leading principal axes, and the recording as it is."""


def list_axes(axes: int, n_samples: int) -> Iterator[tuple[Cost, Candidate]]:
    """List what an actuator of several axes can play."""
    if axes > 1:
        work = MEAN + COVARIANCE + 2 * PROJECTION
        yield Cost(TWO, 2, 3.0 * n_samples, inf, work, 0), Candidate(TWO, _keep_two)
    if axes == ALL_AXES:
        yield Cost(THREE, 3, 0.0, 0.0, 0.0, 0), Candidate(THREE, lambda samples, _: samples)


def _keep_two(samples: NDArray[np.float64], rate_hz: float) -> NDArray[np.float64]:
    """Leave out the motion along the weakest principal axis."""
    del rate_hz
    weakest = np.linalg.eigh(np.einsum("...in,...jn->...ij", samples, samples))[1][..., :, 0]
    along = np.einsum("...i,...in->...n", weakest, samples)
    return np.asarray(samples - weakest[..., :, None] * along[..., None, :])


# The least sufficient reducer of a scene: the first, by simplicity, that is equivalent to the best within tolerance.

SAME = 1e-9
"""Shortfalls this close are equal but for rounding."""


@dataclass(frozen=True, slots=True)
class Advice:
    """What a scene needs."""

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
            return (
                f"{self.scene.name}: nothing suffices, closest {self.closest}{tied}: {self.reason}"
            )
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

    Examples
    --------
    >>> from feel321.analysis.tradeoff.advise.scene import Context, split_recording
    >>> from feel321.stimuli.synthesis import make_scene
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
    compared = partial(
        compare, gains_db=find_gains(list(named.values())), tolerance=context.tolerance
    )
    scored = score_scene(
        scene.recording, named, compared, any_mounting=context.mounting == ANY, seed=seed
    )
    return choose(scene, judge(candidates, scored, context, ratings=ratings), context)


def judge(
    candidates: Mapping[Cost, Candidate],
    scored: tuple[list[Draw], NDArray[np.float64]],
    context: Context,
    *,
    ratings: Mapping[str, Rated] | None = None,
) -> list[Verdict]:
    """Judge reducers against the best of them, by the draw that decides."""
    rated, (draws, scores) = ratings or {}, scored
    shortfalls = compare(scores, find_gains(list(candidates.values())), context.tolerance)
    best = np.fmax.reduce(scores[..., 1:3], axis=0)
    verdicts = []
    for row, (cost, candidate) in enumerate(candidates.items()):
        decides, suits = find_deciding(draws, shortfalls[row].max(axis=-1))
        verdicts.append(
            Verdict(
                cost,
                measure(candidate, draws[decides], scores[row, decides]),
                Shortfall(*shortfalls[row, decides].tolist()),
                in_budget=cost.latency_ms <= context.room_ms,
                rated=rated.get(cost.name),
                needs_ratings=bool(rated),
                best_spectrum=float(best[decides, 0]),
                best_time=float(best[decides, 1]),
                suits=sum(suits),
                segments=len(suits),
            )
        )
    return sorted(verdicts, key=lambda verdict: _place(verdict, context))


def find_deciding(draws: Sequence[Draw], worst: NDArray[np.float64]) -> tuple[int, list[bool]]:
    """Find the draw that decides: the worst mounting of the worst segment, or of that at the 90th percentile.

    worst: (n_draws,), naN where it was not tried.
    """
    known = np.where(np.isnan(worst), -np.inf, worst)
    places: dict[int, list[int]] = {}
    for place, draw in enumerate(draws):
        places.setdefault(id(draw.segment), []).append(place)
    of_segments = [max(own, key=lambda place: known[place]) for own in places.values()]
    ordered = sorted(of_segments, key=lambda place: known[place])
    return ordered[math.ceil(SEGMENTS * len(ordered) - SAME) - 1], [
        bool(known[place] <= 1) for place in of_segments
    ]


def choose(scene: Scene, verdicts: Sequence[Verdict], context: Context) -> Advice:
    """Choose the first that is sufficient.

    verdicts: one at least is in the budget.
    """
    running = [verdict for verdict in verdicts if verdict.in_budget]
    sufficient = [verdict for verdict in running if verdict.is_sufficient]
    best = sufficient[0] if sufficient else min(running, key=_find_lag)
    rivals = sufficient if sufficient else running
    ties = tuple(
        sorted(other.name for other in rivals if other is not best and _ties(best, other, context))
    )
    further = (other.name for other in sufficient[1:] if other.name not in ties)
    tell = tell_choice if sufficient else tell_closest
    return Advice(
        scene=scene,
        verdicts=tuple(verdicts),
        answer=best.name if sufficient else None,
        closest=best.name,
        runner_up=next(further, None),
        ties=ties,
        margin=best.margin,
        reason=tell(best, verdicts),
        close=bool(tell_doubt(best, verdicts)),
    )


def find_common(advices: Sequence[Advice]) -> tuple[str, ...]:
    """Find the reducers that suffice in every scene that has vibration."""
    judged = [advice.verdicts for advice in advices if advice.verdicts]
    serving = [
        {each.name for each in verdicts if each.in_budget and each.is_sufficient}
        for verdicts in judged
    ]
    return tuple(
        each.name
        for each in (judged[0] if judged else ())
        if all(each.name in names for names in serving)
    )


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
    if (
        recording.rate_hz < 2 * LOWEST_HZ
        or not felt_level(recording.acceleration, recording.rate_hz) > 0
    ):
        return "it is silent from 20 to 1000 Hz"
    return ""


def _place(verdict: Verdict, context: Context) -> tuple[object, ...]:
    # Rounded, so that what differs by rounding only goes by alphabet.
    return (
        *verdict.cost.rank(online=context.online),
        round(verdict.shortfall.worst / SAME),
        verdict.name,
    )


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
