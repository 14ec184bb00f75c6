"""What the answers to a trial are worth, and whether they are those of someone who has understood."""

from __future__ import annotations

from math import prod
from typing import TYPE_CHECKING

from protocols.registry import PROTOCOLS
from protocols.trial import RATING_RANGE

if TYPE_CHECKING:
    from collections.abc import Mapping

    from protocols.trial import Trial


def score_trial(trial: Trial, values: Mapping[str, float | str]) -> dict[str, float]:
    """Turn the answers to a trial into points.

    Parameters
    ----------
    trial : Trial
        The trial.
    values : mapping of str to float or str
        The answer to each of its judgements, by the part that is judged.

    Returns
    -------
    dict of str to float
        Points, 0 to 100, by the part that is judged, in the trial's order.

    Raises
    ------
    KeyError
        If a judgement has no answer.
    """
    protocol = PROTOCOLS[trial.protocol]
    parts = {part.name: part.stimulus_id for part in trial.parts}
    return {judgement.part: protocol.score(judgement, values[judgement.part], parts) for judgement in trial.judgements}


def is_as_expected(trial: Trial, values: Mapping[str, float | str]) -> bool | None:
    """Tell whether the answers lie where those of someone who has understood do.

    Parameters
    ----------
    trial : Trial
        The trial.
    values : mapping of str to float or str
        The answer to each of its judgements, by the part that is judged.

    Returns
    -------
    bool or None
        Whether all do; None where nothing is expected.
    """
    points = score_trial(trial, values)
    met = [
        judgement.expected[0] <= points[judgement.part] <= judgement.expected[1]
        for judgement in trial.judgements
        if judgement.expected is not None
    ]
    return all(met) if met else None


def measure_chance(trial: Trial) -> float:
    """Tell how often someone who guesses answers as expected.

    Parameters
    ----------
    trial : Trial
        A trial of which something is expected.

    Returns
    -------
    float
        Share of guesses: one of the choices, or anywhere on each slider of which something is expected.
    """
    if choices := PROTOCOLS[trial.protocol].choices:
        return 1 / len(choices)
    low, high = RATING_RANGE
    known = [judgement.expected for judgement in trial.judgements if judgement.expected]
    return prod((most - least) / (high - low) for least, most in known)
