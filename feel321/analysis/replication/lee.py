"""Measures of Lee et al. 2022 (doi:10.1109/TOH.2022.3174229): one axis against three, and what the axes of maps mean.

Both take dissimilarities as they were rated: a claim's options name the scale "dissimilarity".
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis import maps
from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original
from feel321.analysis.replication.claims import ClaimValue
from feel321.analysis.table.schema import PAIRED
from feel321.doors import check_name

if TYPE_CHECKING:
    from feel321.analysis.replication.claims import PaperClaim
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

LIMIT = 0.05
"""Where permutations cannot give a p below, nothing is estimated."""


def measure_told_apart(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:  # noqa: ARG001 - every measure has this form
    """Take the reducer that is least clearly told from the original; option: reducer, for one alone.

    That all are told apart is shown where this one is, so that no adjustment for their number is needed.
    """
    found = compare_with_original(table.rows)
    single = found[found["reducer"] != EVERY].set_index("reducer")
    if reducer := claim.options.get("reducer"):
        single = single.loc[[check_name(str(reducer), sorted(single.index), "reducer")]]
    name = str(single["low"].idxmin())
    row = single.loc[name].to_dict()
    more = f"of {len(single)} reducers" if len(single) > 1 else ""
    d_prime = f"d' {row['d_prime']:.1f}" if row["area"] < 1 else "d' unbounded"
    return ClaimValue(
        row["difference"], row["low"], row["high"], "rating", "points", int(row["n_participants"]),
        f"dissimilarity of {name} from the original less that of identical pairs", "95 % t interval over participants",
        note=f"This is {name}, the least clear {more}".rstrip() + f" ({d_prime}).",
    )  # fmt: skip


def measure_attribute(table: Table, claim: PaperClaim, choices: Choices) -> ClaimValue:
    """Take R² of an attribute on the axes of the maps, above that of permuted stimuli; option: attribute.

    The interval holds the middle 90 % of permutations: it excludes zero where p (one-sided) is below 0.05.
    """
    attribute = str(claim.options.get("attribute", maps.DIRECTIONS))
    rows = table.rows[table.rows["scale"] == PAIRED]
    if rows.empty:
        raise ValueError(f'no dissimilarity was rated; name options.scale = "{PAIRED}"')
    rng = choices.make_rng("lee", claim.name)
    whole = maps.map_all(rows, rng=rng)
    points = maps.gather_points(rows, table.stimuli, whole, rng=rng)
    check_name(attribute, sorted(points.attributes), "attribute")
    draws = min(choices.draws, 1000)
    (row,) = maps.regress_points(points.select(attribute), draws=draws, rng=rng)
    if row["p_least"] >= LIMIT:
        raise ValueError(
            f"permutations of {len(points.stimuli)} stimuli give no p below {row['p_least']:.2f} for {attribute}"
        )
    return ClaimValue(
        row["r2"] - row["chance"], row["r2"] - row["chance_high"], row["r2"] - row["chance_low"], "correlation",
        "of the variance above chance", row["n"],
        f"R² of {attribute} on the axes of the maps within recordings, less that of permuted stimuli",
        "90 % of permutations", note=f"R² is {row['r2']:.2f}, permutation p = {row['p']:.3f}.",
    )  # fmt: skip
