"""Scales that do not rate one stimulus by itself: what becomes of them, and what their points mean."""

from __future__ import annotations

from typing import TYPE_CHECKING

from analysis.words import tell_name
from protocols.abx import ABX
from protocols.dissimilarity import DISSIMILARITY

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

PAIRED, ANSWERED = DISSIMILARITY.scale, ABX.scale
APART = (PAIRED, ANSWERED)
"""Scales that enter no association: a metric speaks of one stimulus, and of more or less."""

PAIR = "pair"
"""Role of what is judged against another stimulus that is not the reference."""

SPACE = "Where a map of the dissimilarities can be made, it stands under The space of what was felt."
MEASURES = {PAIRED: "dissimilarity from the reference", ANSWERED: "percentage correct"}


def tell_measure(scale: str) -> str:
    """Say what the points of a scale measure.

    Parameters
    ----------
    scale : str
        Its name.

    Returns
    -------
    str
        Words that follow "mean".

    Examples
    --------
    >>> tell_measure("realism"), tell_measure("abx")
    ('realism rating', 'percentage correct')
    """
    return MEASURES.get(scale, f"{tell_name(scale)} rating")


def note_apart(rows: DataFrame) -> Iterator[str]:
    """Say which scales enter no association, and why.

    Parameters
    ----------
    rows : DataFrame
        Judgements: scale, role.

    Yields
    ------
    str
        One note per such scale.
    """
    counts = rows["scale"].value_counts()
    lead = "Scale '{}': none of its {} judgements enters an association, because"
    if PAIRED in counts:
        pairs = int((rows["role"] == PAIR).sum())
        yield (
            f"{lead.format(PAIRED, counts[PAIRED])} a metric speaks of one stimulus and they compare two. The profile "
            f"holds the {counts[PAIRED] - pairs} that compare with the reference, and leaves out {pairs}. {SPACE}"
        )
    if ANSWERED in counts:
        yield (
            f"{lead.format(ANSWERED, counts[ANSWERED])} they are right (100) or wrong (0). The profile holds the "
            "percentage correct; guessing gives 50."
        )
