"""Why this reducer and no simpler one, in one sentence."""

from __future__ import annotations

from math import isinf, isnan
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.advise.verdict import Verdict

CLOSE = 0.1
"""Margins below this are close calls: another take of the scene may be on the other side."""


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
    parts = [_tell_kept(chosen), _tell_simpler([verdict for verdict in simpler if verdict.in_budget], verdicts)]
    parts += [f"{each.name} is simpler and would do, but {_tell_wait(each)}" for each in _list_barred(simpler)[:1]]
    parts += ["people agree" for _ in range(bool(chosen.rated))]
    parts += ["a close call" for _ in range(chosen.margin < CLOSE)]
    return "; ".join(parts)


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
    would = f"{barred[0].name} would do, but {_tell_wait(barred[0])}" if barred else alone
    return f"it {tell_fault(closest, verdicts)}; {would}"


def tell_fault(verdict: Verdict, verdicts: Sequence[Verdict]) -> str:
    """Say what is most wrong with a reducer's output.

    Parameters
    ----------
    verdict : Verdict
        One that does not suffice.
    verdicts : sequence of Verdict
        All, among them the best.

    Returns
    -------
    str
        What the reducer does, beginning with a verb.
    """
    if verdict.fits:
        return _tell_raters(verdict)
    measures = verdict.measures
    if verdict.shortfall.criterion == "level":
        return _tell_level(measures.level_db, measures.deviation_db)
    if verdict.shortfall.criterion == "spectrum":
        best = max(other.measures.spectrum for other in verdicts)
        return f"has {100 * measures.spectrum:.0f} % of the spectrum right, the best {100 * best:.0f} %"
    if verdict.shortfall.criterion == "time":
        best = max(other.measures.time for other in verdicts) ** 2
        return f"goes along with {100 * measures.time**2:.0f} % of the motion's energy, the best {100 * best:.0f} %"
    return f"changes by {100 * measures.change:.0f} % with sensor noise of -60 dB"


def _tell_kept(verdict: Verdict) -> str:
    measures = verdict.measures
    spectrum, motion = (f"{100 * share:.0f} %" for share in (measures.spectrum, measures.time**2))
    return f"keeps {spectrum} of the spectrum, {motion} of the motion, the level to {abs(measures.level_db):.1f} dB"


def _tell_level(level_db: float, deviation_db: float) -> str:
    if abs(level_db) < deviation_db:
        return f"makes up by its gain for {deviation_db:.1f} dB that it has lost"
    return f"is {abs(level_db):.1f} dB too {'weak' if level_db < 0 else 'strong'}"


def _tell_raters(verdict: Verdict) -> str:
    if verdict.rated is None:
        return "was not rated"
    if isnan(verdict.rated.p):
        return f"is not shown to feel like {verdict.rated.best}, because so few ratings leave no error to test with"
    return f"is not shown to feel like {verdict.rated.best} (p of equivalence {verdict.rated.p:.2g})"


def _tell_simpler(simpler: Sequence[Verdict], verdicts: Sequence[Verdict]) -> str:
    if not simpler:
        return "nothing is simpler"
    # Those that the metrics would let pass come first: people's word against them is the reason to be told.
    nearest = min(simpler, key=lambda verdict: (not verdict.fits, verdict.shortfall.worst))
    return f"the best of the simpler, {nearest.name}, {tell_fault(nearest, verdicts)}"


def _list_barred(verdicts: Sequence[Verdict]) -> list[Verdict]:
    return [verdict for verdict in verdicts if verdict.is_sufficient and not verdict.in_budget]


def _tell_wait(verdict: Verdict) -> str:
    wait = verdict.cost.latency_ms
    return "needs the whole recording" if isinf(wait) else f"needs {wait:.1f} ms"
