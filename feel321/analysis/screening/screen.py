"""Screen raters: apply the rules, one by one and to the panel as a whole."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.agreement import SMALLEST, intraclass, krippendorff_alpha
from feel321.analysis.arrays import read_numbers
from feel321.analysis.screening import rules as measures
from feel321.analysis.screening.rules import EXPERTISE, RULES, SIGHTED, Judgements
from feel321.analysis.table.items import Table, leave_rejected, name_stimuli, open_ratings
from feel321.doors import as_rng
from feel321.records import Statistic
from feel321.types import Rng

if TYPE_CHECKING:
    from pandas import DataFrame

FIGURES = ("icc_a_1", "icc_a_k", "icc_c_1", "icc_c_k", "alpha")


def screen_raters(
    table: Table | DataFrame,
    rules: Iterable[str] | Mapping[str, float] | None = None,
    *,
    rng: Rng | None = None,
) -> Statistic:
    """Apply every screening rule to every rater. Nobody is removed.

    Parameters
    ----------
    table : Table or DataFrame
        One row per judgement: participant, rating (0 to 100), and stimulus_id or recording and reducer (and level);
        role, scale, protocol, repeat and response_time_s where there are any; rejected ones are left out. Anchors are
        known by ``mid`` or ``low`` in their reducer's name.
    rules : iterable of str, mapping of str to float, or None
        Names of `RULES`, or names with limits of one's own; None for all (``expertise`` with an rng only).
    rng : int, Generator or None
        Source of randomness for the permutations of ``expertise``.

    Returns
    -------
    Statistic
        ``table``, a row per rater and rule: participant, rule, count, n, share, limit, hit. ``share`` is count / n, or
        the value that the rule compares with its limit (a correlation, a standard deviation); NaN where the rule does
        not apply. ``count share limit hit``, the same as participants x rules; ``hits``, the raters that each rule
        flagged. ``stimuli``, per test stimulus: n raters, Tukey fences, outliers, multimodality coefficient, multimodal
        (above 5/9). ``gauge``: participant, measure (discrimination, reliability, agreement), value, floor and p of its
        permutation null; empty without the rule ``expertise``. ``panel``: reliability of everyone, and of those whom
        no rule flagged, per scale. ``limits`` of each rule asked for; ``rules notes``.

    Raises
    ------
    ValueError
        If the table or a rule is not as it must be.

    Notes
    -----
    ITU-R BS.1534-3 excludes a rater whose hidden reference is below 90 on more than 15 % of items, or whose mid anchor
    is above 90 on more than 15 %; an item (here: scale, recording and level) whose mid anchor more than 25 % of raters
    put above 90 does not count for either. These rules, and that about the low anchor, are for MUSHRA, where the
    reference is in sight: on realism or similarity they flagged 11 of 16 ordinary raters. Ratings without a protocol
    are of the protocol that their scale is named after; others count as MUSHRA only if such a rule is asked by name.

    All other rules are extensions with limits by convention: state them before the data are seen, and report results
    with and without the flagged raters, who should be followed up, not automatically excluded. A scale with 11 steps or
    fewer is recognised by its ratings, and no rule flags a rater for what rounding to its steps does.

    References
    ----------
    Recommendation ITU-R BS.1534-3 (2015). Report ITU-R BS.2300-0 (2014).

    Examples
    --------
    >>> import pandas as pd
    >>> from feel321 import analysis
    >>> table = pd.DataFrame({"participant": ["ann"] * 10 + ["bob"] * 10, "recording": list("abcdefghij") * 2,
    ...     "reducer": "original", "role": "reference", "rating": [95] * 9 + [80] + [95] * 8 + [80] * 2})
    >>> result = analysis.screen_raters(table, ["hidden_reference"])
    >>> result.table[["participant", "count", "n", "share", "limit", "hit"]]
      participant  count   n  share  limit    hit
    0         ann      1  10    0.1   0.15  False
    1         bob      2  10    0.2   0.15   True
    """
    limits = measures.choose_limits(rules, random=rng is not None)
    ratings, left_out = leave_rejected(name_stimuli(open_ratings(table)))
    if "rating" in ratings:
        ratings = ratings.assign(rating=read_numbers(ratings["rating"], what="ratings, 'rating'"))
    judgements = measures.make_judgements(ratings, assumed="" if rules is None else SIGHTED[0])
    gauge = pd.DataFrame(columns=measures.GAUGED)
    if rng is not None and EXPERTISE in limits:
        gauge = measures.gauge_raters(judgements, rng=as_rng(rng))
    found = {}
    for name, limit in limits.items():
        find, meant = RULES[name].find, judgements.of_protocols(RULES[name].protocols)
        found[name] = (
            find(meant, limit) if find else measures.check_expertise(gauge, judgements, limit)
        )
    parts = [part.reset_index().assign(rule=name) for name, part in found.items()]
    screened = pd.concat(parts, ignore_index=True)
    screened = screened[["participant", "rule", "count", "n", "share", "limit", "hit"]]
    flagged = screened[screened["hit"]]
    hits = {name: tuple(flagged.loc[flagged["rule"] == name, "participant"]) for name in limits}

    def spread(what: str) -> DataFrame:
        wide = screened.pivot_table(what, "participant", "rule", aggfunc="first", dropna=False)
        return wide[list(limits)]

    bound = [name for name in limits if RULES[name].protocols]
    notes = [*left_out, *_explain_protocols(judgements, bound)]
    return Statistic(
        "Screening", table=screened, hits=hits, rules=tuple(limits), limits=limits,
        stimuli=_describe_items(judgements), gauge=gauge, panel=describe_panel(ratings, set(flagged["participant"])),
        notes=(*notes, *_explain_rules(found, judgements)),
        **{what: spread(what) for what in ("count", "share", "limit", "hit")},
    )  # fmt: skip


def describe_panel(ratings: DataFrame, hit: Iterable[object]) -> DataFrame:
    """Measure the reliability of ratings of test stimuli per scale, with and without the raters that a rule flagged."""
    tests = ratings
    if "role" in ratings:
        tests = ratings[~ratings["role"].isin(["reference", "anchor"])]
    tests = tests if "scale" in tests else tests.assign(scale="")
    left = tests[~tests["participant"].isin(list(hit))]
    rows = [
        {"scale": scale, "panel": name, **_measure_reliability(part[part["scale"] == scale])}
        for scale in sorted(tests["scale"].unique())
        for name, part in (("everyone", tests), ("without hits", left))
    ]
    columns = ["scale", "panel", "n_participants", "n_items", "n_complete", *FIGURES]
    return pd.DataFrame(rows, columns=columns)


def _measure_reliability(tests: DataFrame) -> dict[str, object]:
    pivot = tests.pivot_table("rating", measures.key_stimulus(tests), "participant", observed=True)
    votes = pivot.to_numpy(np.float64)
    complete = votes[np.isfinite(votes).all(axis=1)]
    figures = dict.fromkeys(FIGURES, float("nan"))
    if min(complete.shape) >= SMALLEST:
        icc = intraclass(complete)
        figures |= {name: getattr(icc, name) for name in FIGURES[:-1]}
    if (np.isfinite(votes).sum(axis=1) >= SMALLEST).sum() >= SMALLEST:
        figures["alpha"] = krippendorff_alpha(votes)
    sizes = {"n_participants": votes.shape[1], "n_items": len(votes), "n_complete": len(complete)}
    return {**sizes, **figures}


def _explain_protocols(judgements: Judgements, bound: Sequence[str]) -> Iterator[str]:
    """Name the protocol that was assumed, and the rules bound to another that are not meant for what was rated."""
    if not bound:
        return
    yield from judgements.notes
    if judgements.of_protocols(SIGHTED).rows.empty:
        known = " and ".join(sorted(set(judgements.rows["protocol"]) - {""}))
        of = f"these are of {known}" if known else "a column protocol that says so is missing"
        names = f"Rule{'' if len(bound) == 1 else 's'} {', '.join(map(repr, bound))}"
        yield f"{names} not applied: for MUSHRA ratings, where the reference is in sight; {of}."


def _explain_rules(found: Mapping[str, DataFrame], judgements: Judgements) -> Iterator[str]:
    for name, part in found.items():
        silent = int(part["share"].isna().sum())
        if silent and not judgements.of_protocols(RULES[name].protocols).rows.empty:
            whom = "" if silent == len(part) else f" to {silent} of {len(part)} participants"
            yield f"Rule '{name}' not applied{whom}: it needs {RULES[name].needs}."


def _describe_items(judgements: Judgements) -> DataFrame:
    steps, means = judgements.of_kind("test").groupby("item")["step"].max(), judgements.means()
    labels, rows = judgements.items.to_dict(), []
    for item, step in steps.to_dict().items():
        own = means[item].dropna().to_numpy(np.float64)
        low, high = measures.tukey_fences(own, step=step)
        outliers = int(((own < low) | (own > high)).sum())
        rows.append((labels[item], len(own), low, high, outliers, measures.multimodality(own)))
    columns = ["item", "n", "low_fence", "high_fence", "outliers", "multimodality"]
    described = pd.DataFrame(rows, columns=columns)
    return described.assign(multimodal=described["multimodality"] > measures.UNIMODAL)
