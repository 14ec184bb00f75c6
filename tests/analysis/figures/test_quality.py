from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.figures.raters import draw_raters
from feel321.analysis.screening.rules import RULES
from feel321.analysis.screening.screen import Screening, screen_raters

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd
    from matplotlib.figure import Figure


@pytest.fixture
def screening(tidy: Callable[..., pd.DataFrame]) -> Screening:
    table = tidy(participants=20, recordings=2)
    table.loc[table["participant"] == "p03", "rating"] = 50.0
    return screen_raters(table, rng=np.random.default_rng(1))


def test_every_rater_stands_at_the_share_of_every_rule(
    screening: Screening, said: Callable[[Figure], str]
) -> None:
    figure = draw_raters(screening)
    (axes,) = figure.axes
    shares = screening.table["share"]
    drawn = np.concatenate([
        line.get_xdata() for line in axes.lines if line.get_marker() in {"o", "X"}
    ])
    np.testing.assert_array_equal(np.sort(drawn[np.isfinite(drawn)]), np.sort(shares.dropna()))
    crosses = [line.get_xdata() for line in axes.lines if line.get_marker() == "X"]
    assert sum(map(len, crosses)) == screening.table["hit"].sum() > 0
    limits = sorted(float(part.get_segments()[0][0, 0]) for part in axes.collections)
    assert limits == sorted(screening.table.groupby("rule")["limit"].first())
    assert axes.get_xlim()[0] <= min(0, shares.min())
    words = said(figure)
    assert "Screening, 20 participants, " in words
    assert "p03" in words
    assert "more than 15 % of items (ITU-R BS.1534-3)" in words
    # Of 18 pairs it is 0.3 itself; what a rater's number of pairs makes of it is no limit of the rule.
    assert "first and second ratings below 0.3, or" in " ".join(words.split())


def test_a_limit_of_ones_own_is_told(
    tidy: Callable[..., pd.DataFrame], said: Callable[[Figure], str]
) -> None:
    limits = {"test_retest": 0.25, "repeat_sd": 0.1}
    screening = screen_raters(tidy(participants=5, recordings=6), rules=limits)
    assert dict(screening.limits) == limits
    assert screening.rules == tuple(limits)
    words = " ".join(said(draw_raters(screening)).split())
    assert "first and second ratings below 0.25, or" in words
    assert "above 10 % of the scale" in words


def test_many_pairs_do_not_change_what_the_rule_says(
    tidy: Callable[..., pd.DataFrame], said: Callable[[Figure], str]
) -> None:
    screening = screen_raters(tidy(participants=5, recordings=8))
    assert screening.limit["test_retest"].max() < 0.3
    assert "first and second ratings below 0.3, or" in " ".join(
        said(draw_raters(screening)).split()
    )


def test_a_rule_that_says_nothing_says_why(
    screening: Screening, said: Callable[[Figure], str]
) -> None:
    assert screening.share["too_fast"].isna().all()
    assert f"Not applied: it needs {RULES['too_fast'].needs}." in said(draw_raters(screening))


def test_raters_without_a_share_are_counted(
    screening: Screening, said: Callable[[Figure], str]
) -> None:
    table = screening.table.copy()
    table.loc[
        (table["rule"] == "outliers") & table["participant"].isin(["p00", "p01"]), ["share", "hit"]
    ] = (np.nan, False)
    assert "not applied to 2" in said(draw_raters(replace(screening, table=table)))


def test_many_hits_are_counted_and_long_names_cut(
    screening: Screening,
    names: list[str],
    faults: Callable[[Figure], list[str]],
    said: Callable[[Figure], str],
) -> None:
    table = screening.table.assign(hit=True)
    table["participant"] = [names[0] + person for person in table["participant"]]
    figure = draw_raters(replace(screening, table=table))
    assert "and 16 more" in said(figure)
    assert faults(figure) == []
