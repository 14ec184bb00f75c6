"""What the answers to a trial are worth, and whether they are those of someone who has understood."""

from __future__ import annotations

from typing import TYPE_CHECKING

from protocols.registry import PROTOCOLS

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
