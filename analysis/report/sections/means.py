"""Mean ratings as numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.numbers import STUDENT, make_interval, make_number

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from analysis.numbers import Number

MEAN = "rating, mean over participants of each participant's mean"


def name_mean(name: str, row: Mapping[Hashable, Any]) -> Number:
    """Name a mean over participants.

    Parameters
    ----------
    name : str
        Its path.
    row : Mapping
        mean, low, high, n_participants.

    Returns
    -------
    Number
        With its t interval, where there is one.
    """
    number = make_number(name, row["mean"], MEAN, n=row["n_participants"])
    return make_interval(number, row["low"], row["high"], uncertainty=STUDENT)
