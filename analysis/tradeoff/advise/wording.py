"""Why this reducer and no simpler one, in one sentence."""

from __future__ import annotations

from math import isinf, isnan
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.tradeoff.advise.measures import Measures
    from analysis.tradeoff.advise.verdict import Verdict

CLOSE = 0.2
"""A reducer that is nearer to the limit than this share of the tolerance makes a close call. In eight takes of every
bundled scene (4 s each, other seeds) the shortfall of reducers near the limit has a standard deviation of 0.1; this is
twice that. A simpler reducer that suffices in some segments only makes one too."""

NAMED = 2
"""So many of them are named, the nearest first."""


def tell_choice(chosen: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say why a reducer is the simplest sufficient one.

    Parameters
    ----------
    chosen : Verdict
        The answer.
    verdicts : sequence of Verdict
        All, the simplest first.

    Returns
    -------
    str
        One sentence, without a full stop.
    """
    simpler = verdicts[: list(verdicts).index(chosen)]
    parts = [_tell_kept(chosen), _tell_simpler([verdict for verdict in simpler if verdict.in_budget])]
    parts += [f"{each.name} is simpler and would do, but {_tell_wait(each)}" for each in _list_barred(simpler)[:1]]
    if chosen.rated:
        parts.append("simulated participants agree" if chosen.rated.simulated else "people agree")
    return "; ".join(filter(None, [*parts, tell_doubt(chosen, verdicts)]))


def tell_closest(closest: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say why nothing suffices, and what would.

    Parameters
    ----------
    closest : Verdict
        The one that gives up least.
    verdicts : sequence of Verdict
        All, the simplest first.

    Returns
    -------
    str
        One sentence, without a full stop.
    """
    barred = _list_barred(verdicts)
    alone = "no reducer is within tolerance of the best in everything"
    if any(verdict.fits and verdict.in_budget for verdict in verdicts):
        alone = "none of those within tolerance by the metrics is shown by ratings to feel like the best"
    would = f"{barred[0].name} would do, but {_tell_wait(barred[0])}" if barred else alone
    return "; ".join(filter(None, [f"it {tell_fault(closest)}", would, tell_doubt(closest, verdicts)]))


def tell_doubt(answer: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say whether another take of the scene might have given another answer.

    Parameters
    ----------
    answer : Verdict
        The answer, or the closest.
    verdicts : sequence of Verdict
        All, the simplest first.

    Returns
    -------
    str
        Who is within the noise of the limit, on which side; empty if nobody is who matters.
    """
    simpler = verdicts[: list(verdicts).index(answer)]
    running = [each for each in (*simpler, answer) if each.in_budget]
    near = sorted((each for each in running if abs(each.margin) < CLOSE), key=lambda each: abs(each.margin))
    told = [f"{one.name} {'passes' if one.fits else 'misses'} by {abs(100 * one.margin):.0f} %" for one in near[:NAMED]]
    told[-1:] = [f"{last} of the tolerance" for last in told[-1:]]
    partly = [each for each in running if each.suits_partly and each not in near]
    told += [f"{each.name} suffices in {each.suits} of {each.segments} segments" for each in partly[-1:]]
    return f"a close call, another take may go the other way: {', '.join(told)}" if told else ""


def tell_fault(verdict: Verdict) -> str:
    """Say what is most wrong with a reducer's output.

    Parameters
    ----------
    verdict : Verdict
        One that does not suffice.

    Returns
    -------
    str
        What the reducer does, beginning with a verb.
    """
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
    return f"is not shown to feel like {verdict.rated.best} (p of equivalence {verdict.rated.p:.2g})"


def _tell_simpler(simpler: Sequence[Verdict]) -> str:
    if not simpler:
        return "nothing is simpler"
    # Prefer those that pass the metrics but fail the ratings: that disagreement is the interesting reason.
    nearest = min(simpler, key=lambda verdict: (not verdict.fits, verdict.rated is None, verdict.shortfall.worst))
    return f"the best of the simpler, {nearest.name}, {tell_fault(nearest)}"


def _list_barred(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.is_sufficient and not verdict.in_budget]


def _tell_wait(verdict: Verdict) -> str:
    wait = verdict.cost.latency_ms
    return "needs the whole recording" if isinf(wait) else f"needs {wait:.1f} ms"
