"""The least sufficient reducer of a scene: the simplest that is equivalent to the best within tolerance.

The best is looked for among all reducers, whether the context has room for them or not: a budget takes contenders away,
it does not make those that are left any better. Where none that is left suffices, that is the answer.

An actuator of several axes needs no reducer, but one may still be enough: a vibration along one line needs one axis,
whatever the actuator can move besides. The measures of one axis carry over: level and spectrum are those of the
energies' sum, and the share of the motion's energy that the output carries is the share that is kept.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from math import inf, isinf, isnan
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.tradeoff.advise import measures
from feel321.analysis.tradeoff.advise.scene import (
    ALL_AXES,
    ANY,
    SHORTEST_S,
    AdviceScene,
    Context,
    Rated,
    Shortfall,
    Verdict,
    compare,
)
from feel321.analysis.tradeoff.stress.diagnosis import eigenvalue_ratio
from feel321.stimuli.match import LOWEST_HZ
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.anchors import felt_level
from feel321.types import Reducer, Samples

if TYPE_CHECKING:
    from feel321.stimuli.recording import Recording

CLOSE = 0.2
"""A reducer that is nearer to the limit than this share of the tolerance makes a close call. In eight takes of every
bundled scene (4 s each, other seeds) the shortfall of reducers near the limit has a standard deviation of 0.1; this is
twice that. A simpler reducer that suffices in some segments only makes one too."""

NO_LEADER = 0.95
"""From this ratio of the second to the first eigenvalue on, as in circular motion and near many motors, no direction
leads: which one comes out as the principal axis is chance, and with it what reducers on that axis keep."""

NAMED = 2
"""So many of them are named, the nearest first."""

SAME = 1e-9
"""Shortfalls this close are equal but for rounding."""

SEGMENTS = 0.9
"""Share of the segments in which a reducer must suffice: all of them, where they are fewer than ten."""

TWO, THREE = "two_principal_axes", "three_axes"
"""What an actuator of several axes can play: the two leading principal axes, and the recording as it is."""


def list_axes(
    axes: int, n_samples: int
) -> Iterator[tuple[measures.Complexity, measures.Contender]]:
    """List what an actuator of several axes can play instead of a reduced signal."""
    if axes > 1:
        work = measures.MEAN + measures.COVARIANCE + 2 * measures.PROJECTION
        yield (
            measures.Complexity(TWO, 2, 3.0 * n_samples, inf, work, 0),
            measures.Contender(TWO, _keep_two),
        )
    if axes == ALL_AXES:
        yield (
            measures.Complexity(THREE, 3, 0.0, 0.0, 0.0, 0),
            measures.Contender(THREE, lambda samples, _: samples),
        )


def _keep_two(samples: Samples, rate_hz: float) -> Samples:
    """Leave out the motion along the weakest principal axis."""
    del rate_hz
    weakest = np.linalg.eigh(np.einsum("...in,...jn->...ij", samples, samples))[1][..., :, 0]
    along = np.einsum("...i,...in->...n", weakest, samples)
    return np.asarray(samples - weakest[..., :, None] * along[..., None, :])


@dataclass(frozen=True, slots=True)
class SceneAdvice:
    """What a scene needs: the simplest sufficient reducer, or the closest where none suffices, and why.

    reason: in full; why: in a few words.
    """

    scene: AdviceScene
    verdicts: tuple[Verdict, ...] = ()
    answer: str | None = None
    closest: str | None = None
    runner_up: str | None = None
    ties: tuple[str, ...] = ()
    margin: float = math.nan
    reason: str = ""
    why: str = ""
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
    scene: AdviceScene,
    context: Context,
    *,
    seed: int = 0,
    reducers: Mapping[str, Reducer] | None = None,
    ratings: Mapping[str, Rated] | None = None,
) -> SceneAdvice:
    """Find the simplest sufficient reducer of a scene.

    reducers: feel321's own if left out.
    """
    reducers = REDUCERS if reducers is None else reducers
    if problem := _find_problem(scene.recording):
        return SceneAdvice(scene, reason=problem, why=problem)
    listed = dict(_list_contenders(scene, context, reducers))
    named = {cost.name: contender for cost, contender in listed.items()}
    gains_db = np.array([[contender.gain_db] for contender in named.values()])
    judge = partial(compare, gains_db=gains_db, tolerance=context.tolerance)
    mounted, scores = measures.score_scene(
        scene.recording, named, judge, any_mounting=context.mounting == ANY, seed=seed
    )
    shortfalls, best = judge(scores), np.fmax.reduce(scores[..., 1:3], axis=0)
    verdicts = []
    for row, (cost, contender) in enumerate(listed.items()):
        decides, suits = find_deciding(mounted, shortfalls[row].max(axis=-1))
        best_spectrum, best_time = best[decides].tolist()
        verdicts.append(Verdict(
            cost,
            measures.complete_scores(contender, mounted[decides], scores[row, decides]),
            Shortfall(*shortfalls[row, decides].tolist()),
            in_budget=cost.latency_ms <= context.room_ms,
            rated=(ratings or {}).get(cost.name), needs_ratings=bool(ratings),
            best_spectrum=best_spectrum, best_time=best_time,
            suits=sum(suits), segments=len(suits),
        ))  # fmt: skip

    def order(one: Verdict) -> tuple[object, ...]:
        # Rounded, so that reducers that differ by rounding only are ordered by name.
        worst = round(one.shortfall.worst / SAME)
        return *one.cost.rank(online=context.online), worst, one.name

    return choose(scene, sorted(verdicts, key=order), context)


def _find_problem(recording: Recording) -> str:
    if recording.duration_s < SHORTEST_S:
        return f"it lasts {recording.duration_s:.3f} s and 20 Hz need {SHORTEST_S} s"
    fast = recording.rate_hz >= 2 * LOWEST_HZ
    felt = fast and felt_level(recording.acceleration, recording.rate_hz) > 0
    return "" if felt else "it is silent from 20 to 1000 Hz"


def _list_contenders(
    scene: AdviceScene, context: Context, reducers: Mapping[str, Reducer]
) -> Iterator[tuple[measures.Complexity, measures.Contender]]:
    n, rate_hz = scene.recording.n_samples, scene.recording.rate_hz
    for name, reducer in reducers.items():
        for label, window_s in measures.list_windows(name, reducer, longest_ms=context.room_ms):
            cost = measures.find_complexity(
                name, reducer, n_samples=n, rate_hz=rate_hz, window_s=window_s
            )
            chosen = {} if label == name else {"window_s": window_s}
            yield replace(cost, name=label), measures.Contender(name, partial(reducer, **chosen))
    yield from list_axes(context.axes, n)


def find_deciding(
    mounted: Sequence[measures.MountedSegment], worst: Samples
) -> tuple[int, list[bool]]:
    """Find what decides: the worst mounting of the worst segment, or of that at the 90th percentile.

    worst: the shortfall in each mounted segment, NaN where it was not tried; returns also whether each segment passes.
    """
    known = np.where(np.isnan(worst), -np.inf, worst)
    places: dict[int, list[int]] = {}
    for place, each in enumerate(mounted):
        places.setdefault(id(each.segment), []).append(place)
    of_segments = [max(own, key=lambda place: known[place]) for own in places.values()]
    ordered = sorted(of_segments, key=lambda place: known[place])
    decides = ordered[math.ceil(SEGMENTS * len(ordered) - SAME) - 1]
    return decides, [bool(known[place] <= 1) for place in of_segments]


def choose(scene: AdviceScene, verdicts: Sequence[Verdict], context: Context) -> SceneAdvice:
    """Choose the first, by simplicity, that is sufficient; at least one is in the budget."""
    running = [verdict for verdict in verdicts if verdict.in_budget]
    sufficient = [verdict for verdict in running if verdict.is_sufficient]
    best = sufficient[0] if sufficient else min(running, key=_order_failing)
    rivals = sufficient or running
    ties = sorted(each.name for each in rivals if each is not best and _ties(best, each, context))
    further = (each.name for each in sufficient[1:] if each.name not in ties)
    explain = explain_choice if sufficient else explain_closest
    doubt = describe_doubt(best, verdicts, eigenvalue_ratio(scene.recording))
    return SceneAdvice(
        scene=scene,
        verdicts=tuple(verdicts),
        answer=best.name if sufficient else None,
        closest=best.name,
        runner_up=next(further, None),
        ties=tuple(ties),
        margin=best.margin,
        reason="; ".join(filter(None, (explain(best, verdicts), doubt))),
        why=explain_briefly(best, verdicts),
        close=bool(doubt),
    )


def _order_failing(verdict: Verdict) -> tuple[bool, bool, bool, float]:
    """Order reducers that do not suffice: ratings first, then metrics; of equals the simpler stays first.

    A reducer that was rated comes before one that was not.
    """
    unknown = verdict.needs_ratings and verdict.rated is None
    worst = round(verdict.shortfall.worst / SAME) * SAME
    return not verdict.passes_ratings, not verdict.fits, unknown, worst


def _ties(best: Verdict, other: Verdict, context: Context) -> bool:
    alike = best.cost.rank(online=context.online) == other.cost.rank(online=context.online)
    same_order = _order_failing(best)[:-1] == _order_failing(other)[:-1]
    return alike and same_order and abs(best.shortfall.worst - other.shortfall.worst) <= 2 * SAME


def find_common(advices: Sequence[SceneAdvice]) -> tuple[str, ...]:
    """Find the reducers that suffice in every scene that has vibration, the simplest first."""
    serving = [
        [each.name for each in advice.verdicts if each.in_budget and each.is_sufficient]
        for advice in advices
        if advice.verdicts
    ]
    first = next(iter(serving), [])
    return tuple(one for one in first if all(one in names for names in serving))


def explain_choice(chosen: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Explain why a reducer is the simplest sufficient one."""
    simpler, measures = verdicts[: list(verdicts).index(chosen)], chosen.measures
    spectrum, motion = (f"{100 * share:.0f} %" for share in (measures.spectrum, measures.time**2))
    level = f"{abs(measures.level_db):.1f} dB"
    parts = [
        f"keeps {spectrum} of the spectrum, {motion} of the motion, the level to {level}",
        _explain_simpler([verdict for verdict in simpler if verdict.in_budget]),
    ]
    parts += [
        f"{each.name} is simpler and would suffice, but {_describe_wait(each)}"
        for each in _list_barred(simpler)[:1]
    ]
    if chosen.rated:
        parts.append("simulated participants agree" if chosen.rated.simulated else "people agree")
    return "; ".join(filter(None, parts))


def explain_closest(closest: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Explain why nothing suffices, and what would."""
    barred = _list_barred(verdicts)
    if barred:
        why = f"{barred[0].name} would suffice, but {_describe_wait(barred[0])}"
    elif any(verdict.fits and verdict.in_budget for verdict in verdicts):
        why = "the ratings show for no reducer within the tolerances of the metrics that it feels like the best"
    else:
        why = "no reducer is within tolerance of the best in everything"
    return f"it {describe_fault(closest)}; {why}"


def explain_briefly(answer: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Explain in a few words what is wrong with the best simpler reducer, or with the closest where none suffices."""
    if not answer.is_sufficient:
        return f"it {describe_fault(answer)}"
    simpler = [one for one in verdicts[: list(verdicts).index(answer)] if one.in_budget]
    if not simpler:
        return "nothing is simpler"
    nearest = find_nearest(simpler)
    return f"the simpler {nearest.name} {describe_fault(nearest).split(', which')[0]}"


def describe_doubt(answer: Verdict, verdicts: Sequence[Verdict], ratio: float) -> str:
    """Describe why another take of the scene might give another answer; empty if nothing does.

    ratio: of the second to the first eigenvalue of the motion's covariance.
    """
    simpler = verdicts[: list(verdicts).index(answer)]
    running = [each for each in (*simpler, answer) if each.in_budget]
    near = [each for each in running if abs(each.margin) < CLOSE]
    near.sort(key=lambda each: abs(each.margin))
    shown = [
        f"{one.name} {'passes' if one.fits else 'misses'} by {abs(100 * one.margin):.0f} %"
        for one in near[:NAMED]
    ]
    shown[-1:] = [f"{last} of the tolerance" for last in shown[-1:]]
    partly = [each for each in running if each.suits_partly and each not in near]
    shown += [
        f"{each.name} suffices in {each.suits} of {each.segments} segments" for each in partly[-1:]
    ]
    if ratio > NO_LEADER:
        shown.append(f"no direction leads (λ₂ / λ₁ is {ratio:.2f})")
    return f"a close call, another take could reverse it: {', '.join(shown)}" if shown else ""


def describe_fault(verdict: Verdict) -> str:
    """Describe what is most wrong with a reducer's output."""
    measures, criterion = verdict.measures, verdict.shortfall.criterion
    if verdict.fits:
        return _describe_ratings(verdict.rated)
    if criterion == "level":
        level_db, deviation_db = measures.level_db, measures.deviation_db
        if abs(level_db) < deviation_db:
            return f"loses {deviation_db:.1f} dB, which its gain hides (a sum of three axes is √3, 4.8 dB, louder)"
        return f"is {abs(level_db):.1f} dB too {'weak' if level_db < 0 else 'strong'}"
    if criterion == "spectrum":
        kept, best = 100 * measures.spectrum, 100 * verdict.best_spectrum
        return f"gets {kept:.0f} % of the spectrum right, the best {best:.0f} %"
    if criterion == "time":
        kept, best = 100 * measures.time**2, 100 * verdict.best_time**2
        return f"carries {kept:.0f} % of the motion's energy, the best {best:.0f} %"
    change, envelope = 100 * measures.change, 100 * measures.envelope
    return {
        "change": f"changes by {change:.0f} % with sensor noise of -60 dB",
        "envelope": f"smears the envelope: the depth of its modulation is off by {envelope:.0f} %",
    }[criterion]


def _describe_ratings(rated: Rated | None) -> str:
    if rated is None:
        return "was not rated"
    why = f" (p of equivalence {rated.p:.2g})"
    if isnan(rated.p):
        why = ": too few ratings leave no error to test with"
    return f"is not shown to feel like {rated.best}{why}"


def _explain_simpler(simpler: Sequence[Verdict]) -> str:
    if not simpler:
        return "nothing is simpler"
    nearest = find_nearest(simpler)
    return f"the best simpler one, {nearest.name}, {describe_fault(nearest)}"


def find_nearest(simpler: Sequence[Verdict]) -> Verdict:
    """Find the best of the simpler reducers: first of those that pass the metrics but fail the ratings."""
    return min(simpler, key=lambda one: (not one.fits, one.rated is None, one.shortfall.worst))


def _list_barred(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.is_sufficient and not verdict.in_budget]


def _describe_wait(verdict: Verdict) -> str:
    wait = verdict.cost.latency_ms
    return "needs the whole recording" if isinf(wait) else f"needs {wait:.1f} ms"
