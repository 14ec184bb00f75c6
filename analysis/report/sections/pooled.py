"""Where correlations over all stimuli pooled, another question, point elsewhere than the primary model."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from analysis.primary.influence import NOT_ESTIMABLE, OPEN, PREDICTS
from analysis.words import start, tell_ends, tell_name

if TYPE_CHECKING:
    from collections.abc import Sequence

    from analysis.association.correlate import Association, Difference
    from analysis.findings import Panel
    from analysis.report.lines import Claim

HIGHER, POOLED = "higher", "pearson"


def name_subject(panel: Panel, *, several: bool) -> str:
    """Name what a panel's lines stand under on the page.

    Parameters
    ----------
    panel : Panel
        Correlations of one scale and level.
    several : bool
        Whether there are several levels.

    Returns
    -------
    str
        Its scale, and the level where there are several.
    """
    return start(tell_name(panel.scale) + (f" (level {tell_name(panel.level)})" if several else ""))


def reconcile(panel: Panel, claims: Sequence[Claim]) -> str:
    """Say where correlations over all stimuli pooled, another question, point elsewhere than the primary model.

    Parameters
    ----------
    panel : Panel
        Correlations of the same ratings.
    claims : sequence of Claim
        What the primary model shows of them.

    Returns
    -------
    str
        One sentence; empty where they agree.
    """
    place = panel.scale, panel.level
    own = [claim for claim in claims if (claim.scale, claim.level) == place and claim.verdict != NOT_ESTIMABLE]
    verdicts = {claim.metric: claim for claim in own}
    told = [
        _contrast(one)
        for one in panel.associations
        if one.method == POOLED and one.metric in verdicts and _disagrees(one, verdicts[one.metric])
    ]
    told += [
        f"{tell_name(stronger)} correlates more (difference in r {' ('.join(tell_ends(two.value, two.low, two.high))})"
        for two in panel.differences
        if two.method == POOLED and (stronger := _find_stronger(two)) and {two.first, two.second} <= set(verdicts)
        and ({two.first, two.second} - {stronger}).isdisjoint(verdicts[stronger].better_than)
    ]
    if not told:
        return ""
    return (
        f"over all stimuli pooled, {'; '.join(told)}. That is another question: it also counts differences between "
        "recordings, and each metric alone."
    )


def _find_stronger(two: Difference) -> str:
    """Find which of two metrics correlates more strongly; empty where that is open."""
    if math.isnan(two.low) or two.low <= 0 <= two.high:
        return ""
    return two.first if abs(two.first_value) > abs(two.second_value) else two.second


def _disagrees(one: Association, claim: Claim) -> bool:
    if math.isnan(one.low):
        return False
    if one.low <= 0 <= one.high:
        return claim.verdict == PREDICTS
    return claim.verdict == OPEN or (claim.direction == HIGHER) != (one.value > 0)


def _contrast(one: Association) -> str:
    told, interval = tell_ends(one.value, one.low, one.high)
    zero = ", which covers zero" if one.low <= 0 <= one.high else ""
    return f"mean ratings correlate with {tell_name(one.metric)} at r = {told} (95 % CI {interval}{zero})"
