"""RULES: the one list of screening rules, with where each comes from and where its limit stands."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING

from analysis.screening.anchors import judge_hidden_reference, judge_low_anchor, judge_mid_anchor
from analysis.screening.fences import judge_outliers, judge_reversed_scale
from analysis.screening.habits import judge_repeat_sd, judge_straight_lining, judge_test_retest, judge_too_fast
from protocols.mushra import MUSHRA

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from pandas import DataFrame

    from analysis.screening.judgements import Judgements

STANDARD, EXTENSION = "ITU-R BS.1534-3", "extension"

EXPERTISE = "expertise"
"""The rule that needs a source of randomness."""

EXPERTISE_LIMIT = 0.5
"""More than half of its measures, that is two of three, are no better than chance."""


@dataclass(frozen=True, slots=True)
class Rule:
    """A rule about raters.

    Parameters
    ----------
    says : str
        Whom it hits, with ``{limit}`` for its limit.
    source : str
        Where it comes from.
    limit : float
        Where hits begin unless told otherwise.
    judge : callable or None
        Judgements and limit -> table by participant; None for `EXPERTISE`, which is judged from its gauge.
    needs : str
        What the data must hold for it to be applied.
    protocols : tuple of str
        Protocols whose judgements it applies to; empty for all.
    """

    says: str
    source: str
    limit: float
    judge: Callable[[Judgements, float], DataFrame] | None
    needs: str
    protocols: tuple[str, ...] = ()


SIGHTED = (MUSHRA.name,)
"""Protocols that show the reference beside the stimuli. Limits near the end of the scale presuppose that: somebody who
rates realism by itself, or a similarity from memory, has no reason to put the original at 90 or above."""

RULES: Mapping[str, Rule] = MappingProxyType(
    {
        "hidden_reference": Rule(
            "hidden reference below 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, judge_hidden_reference, "MUSHRA ratings of a stimulus with role 'reference'", SIGHTED,
        ),
        "mid_anchor": Rule(
            "mid anchor above 90 on more than {limit:.0%} of items",
            STANDARD, 0.15, judge_mid_anchor, "MUSHRA ratings of an anchor named mid", SIGHTED,
        ),
        "low_anchor": Rule(
            "low anchor above 50 on more than {limit:.0%} of items",
            EXTENSION, 0.15, judge_low_anchor, "MUSHRA ratings of an anchor named low", SIGHTED,
        ),
        "straight_lining": Rule(
            "more than {limit:.0%} of ratings within 2 points of each other",
            EXTENSION, 0.5, judge_straight_lining, "8 ratings of test stimuli",
        ),
        "test_retest": Rule(
            "correlation of first and second ratings below {limit:g}, or what so many pairs show to be above zero",
            EXTENSION, 0.3, judge_test_retest, "8 test stimuli rated twice, not all alike",
        ),
        "repeat_sd": Rule(
            "standard deviation of repeated ratings above {limit:.0%} of the scale",
            EXTENSION, 0.2, judge_repeat_sd, "8 test stimuli rated twice",
        ),
        "reversed_scale": Rule(
            "correlation with the mean of the others below {limit:g}",
            EXTENSION, -0.3, judge_reversed_scale, "8 test stimuli that others rated too, not all alike",
        ),
        "too_fast": Rule(
            "more than {limit:.0%} of answers within 0.5 s",
            EXTENSION, 0.15, judge_too_fast, "column 'response_time_s'",
        ),
        "outliers": Rule(
            "outside Tukey's fences on more than {limit:.0%} of test stimuli",
            EXTENSION, 0.15, judge_outliers, "test stimuli that 5 raters rated",
        ),
        EXPERTISE: Rule(
            "more than {limit:.0%} of discrimination, reliability and agreement no better than shuffled ratings",
            "in the manner of Report ITU-R BS.2300", EXPERTISE_LIMIT, None, "test stimuli rated twice or by others too",
        ),
    }
)  # fmt: skip
"""Name -> rule, in the order of reports."""


def choose_limits(rules: Iterable[str] | Mapping[str, float] | None, *, random: bool) -> dict[str, float]:
    """Settle which rules apply, and where their limits stand.

    Parameters
    ----------
    rules : iterable of str, mapping of str to float, or None
        Names; or names with limits of one's own; or all.
    random : bool
        Whether there is a source of randomness; without, all means all but `EXPERTISE`.

    Returns
    -------
    dict of str to float
        Name -> limit, in the order of `RULES`.

    Raises
    ------
    ValueError
        If a rule is unknown, needs randomness that is not there, a limit is not from -1 to 1, or nothing is asked.

    Examples
    --------
    >>> choose_limits(["mid_anchor"], random=False), choose_limits({"mid_anchor": 0.2}, random=False)
    ({'mid_anchor': 0.15}, {'mid_anchor': 0.2})
    """
    if rules is None:
        return {name: rule.limit for name, rule in RULES.items() if random or name != EXPERTISE}
    wanted = [rules] if isinstance(rules, str) else list(rules)
    own = dict(rules) if isinstance(rules, dict | MappingProxyType) else {}
    unknown = [name for name in wanted if name not in RULES]
    if unknown or not wanted:
        got = repr(unknown[0]) if unknown else "no rule"
        raise ValueError(f"rules: got {got}, allowed are {', '.join(RULES)}")
    if EXPERTISE in wanted and not random:
        raise ValueError(f"rules: got {EXPERTISE!r} without rng, which its permutations need; give a numpy Generator")
    for name, limit in own.items():
        if not -1 <= limit <= 1:
            raise ValueError(f"rules: got the limit {limit} for {name!r}, allowed is -1 to 1; a share, not per cent")
    return {name: float(own.get(name, rule.limit)) for name, rule in RULES.items() if name in wanted}
