"""The least sufficient reducer of a scene: the first, by simplicity, that is equivalent to the best within tolerance.

The best is looked for among all reducers, whether the context has room for them or not: a budget takes candidates away,
it does not make what is left any better. Where nothing that is left suffices, that is the answer.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.tradeoff.advise.axes import measure_axes
from analysis.tradeoff.advise.measures import make_trial, measure
from analysis.tradeoff.advise.scene import SHORTEST_S
from analysis.tradeoff.advise.simplicity import find_cost
from analysis.tradeoff.advise.verdict import Verdict, compare
from analysis.tradeoff.advise.wording import tell_choice, tell_closest, tell_doubt
from stimuli.perception import felt_level
from stimuli.reduce import REDUCERS
from stimuli.spectrum import LOWEST_HZ

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from analysis.tradeoff.advise.measures import Measures
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
    """
    if problem := _find_problem(scene):
        return Advice(scene, (), None, None, None, (), float("nan"), problem)
    verdicts = judge(list(_measure_all(scene, context, seed=seed, reducers=reducers)), context, ratings=ratings)
    return choose(scene, verdicts, context)


def judge(
    measured: Sequence[tuple[Cost, Measures]], context: Context, *, ratings: Mapping[str, Rated] | None = None
) -> list[Verdict]:
    """Judge reducers against the best of them.

    Parameters
    ----------
    measured : sequence of (Cost, Measures)
        All reducers, in any order.
    context : Context
        Budget and tolerance.
    ratings : Mapping of str to Rated, optional
        What people said, by reducer.

    Returns
    -------
    list of Verdict
        The simplest first; of equally simple ones the better, of equally good ones by alphabet.
    """
    rated = ratings or {}
    shortfalls = compare([measures for _, measures in measured], context.tolerance)
    verdicts = [
        Verdict(
            cost, measures, shortfall, in_budget=cost.latency_ms <= context.budget_ms,
            rated=rated.get(cost.name), needs_ratings=bool(rated),
        )
        for (cost, measures), shortfall in zip(measured, shortfalls, strict=True)
    ]  # fmt: skip
    return sorted(verdicts, key=lambda verdict: _place(verdict, context))


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


def _measure_all(
    scene: Scene, context: Context, *, seed: int, reducers: Mapping[str, Reducer]
) -> Iterator[tuple[Cost, Measures]]:
    recording = scene.recording
    trial = make_trial(recording, scene.name, seed=seed)
    for name, reducer in reducers.items():
        cost = find_cost(name, reducer, n_samples=recording.n_samples, rate_hz=recording.rate_hz)
        yield cost, measure(name, reducer, trial)
    yield from measure_axes(trial, axes=context.axes)


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
