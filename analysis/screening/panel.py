"""How far a panel of raters agrees, with and without those whom a rule hit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.agreement.alpha import krippendorff_alpha
from analysis.agreement.reliability import SMALLEST, intraclass
from analysis.screening.judgements import key_stimulus

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pandas import DataFrame

FIGURES = ("icc_a_1", "icc_a_k", "icc_c_1", "icc_c_k", "alpha")


def describe_panel(ratings: DataFrame, hit: Iterable[object]) -> DataFrame:
    """Reliability of the ratings of test stimuli, per scale.

    Parameters
    ----------
    ratings : DataFrame
        As for `screen_raters`.
    hit : iterable
        Participants to be left out of the second row.

    Returns
    -------
    DataFrame
        scale, panel (``everyone``, ``without hits``), n_participants, n_items, n_complete (items that all of them
        rated, which the intraclass correlations rest on), icc_a_1, icc_a_k, icc_c_1, icc_c_k, and Krippendorff's
        alpha of interval ratings, repeats averaged. NaN where fewer than two raters or two items are left.
    """
    import pandas as pd

    tests = ratings[~ratings["role"].isin(["reference", "anchor"])] if "role" in ratings else ratings
    tests = tests if "scale" in tests else tests.assign(scale="")
    hit = list(hit)
    panels = {"everyone": tests, "without hits": tests[~tests["participant"].isin(hit)]}
    rows = [
        {"scale": scale, "panel": name, **_describe(part[part["scale"] == scale])}
        for scale in sorted(tests["scale"].unique())
        for name, part in panels.items()
    ]
    return pd.DataFrame(rows, columns=["scale", "panel", "n_participants", "n_items", "n_complete", *FIGURES])


def _describe(tests: DataFrame) -> dict[str, object]:
    table = tests.pivot_table("rating", key_stimulus(tests), "participant", observed=True).to_numpy(np.float64)
    complete = table[np.isfinite(table).all(axis=1)]
    figures = dict.fromkeys(FIGURES, float("nan"))
    if min(complete.shape) >= SMALLEST:
        icc = intraclass(complete)
        figures |= {name: getattr(icc, name) for name in FIGURES[:-1]}
    if (np.isfinite(table).sum(axis=1) >= SMALLEST).sum() >= SMALLEST:
        figures["alpha"] = krippendorff_alpha(table)
    return {"n_participants": table.shape[1], "n_items": len(table), "n_complete": len(complete), **figures}
