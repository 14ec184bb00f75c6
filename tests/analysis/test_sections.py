"""Sections of the report: their rows by hand, how far a claim reaches, and what they say they did not do."""

from collections.abc import Callable
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.contrasts.compare import equivalence
from feel321.analysis.primary.sensitivity import adjust_holm
from feel321.analysis.report import means, primary, raters
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import find_row
from feel321.analysis.resampling import Choices
from feel321.analysis.table.reading import Table, read_table
from feel321.analysis.words import render_words

METRICS = ("spectral_match", "temporal_match")
ARMS = ("as_is", "equal_intensity")
CHOICES = Choices(draws=2)


def pick(rows: list[dict[str, Any]], quantity: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["quantity"] == quantity]


# Reducers and levels against each other.


def test_contrasts_by_hand(tidy: Callable[..., pd.DataFrame]) -> None:
    rows, margin = tidy(1, participants=8, recordings=5), 4.0
    found = means.compute_contrasts(Table(rows, METRICS, ()), Choices(draws=2, margin=margin))
    contrasts = found.rows["contrasts"]
    differences, t = pick(contrasts, "difference"), pick(contrasts, "t")
    tests = rows[rows["role"] == "test"]
    # In a balanced study a contrast is the difference of two means, whatever the spreads.
    averages = tests.groupby("reducer")["rating"].mean()
    assert len(differences) == len(list(combinations(averages.index, 2)))
    for row in differences:
        assert row["value"] == pytest.approx(
            averages[row["reducer"]] - averages[row["second_reducer"]]
        )
    assert [row["p"] for row in differences] == pytest.approx(adjust_holm([row["p"] for row in t]))
    columns = [pick(contrasts, name) for name in ("df", "difference_90", "non_inferiority")]
    for row, one, df, tost, worse in zip(differences, t, *columns, strict=True):
        se = row["value"] / one["value"]
        wanted = equivalence(row["value"], se, df["value"], low=-margin, high=margin)
        assert (tost["low"], tost["p"]) == pytest.approx((wanted.low90, wanted.p))
        # Higher is better: the first, the simpler one, must not lie below the second by the margin.
        assert worse["p"] == pytest.approx(wanted.p_low)
    n_differ = find_row(found.rows["reducers_together"], "n_differ")["value"]
    assert n_differ == sum(row["p"] < 0.05 for row in differences) > 0


@pytest.mark.parametrize(
    ("people", "scenes", "hint"),
    [(6, 5, ""), (6, 1, "with 1 recording"), (1, 6, "with 1 participant"), (6, 3, "with 3 recordings")],
)  # fmt: skip
def test_what_is_said_of_reducers_reaches_as_far_as_the_study(
    tidy: Callable[..., pd.DataFrame], people: int, scenes: int, hint: str
) -> None:
    table = Table(tidy(1, participants=people, recordings=scenes, spectral=80.0), METRICS, ())
    (line,) = render_words("contrasts", **means.compute_contrasts(table, CHOICES).facts)
    assert line.endswith(f"; {hint}, a hint rather than a result." if hint else "tested.")


def make_arms(tidy: Callable[..., pd.DataFrame], **changes: object) -> pd.DataFrame:
    """At the first level ratings follow the spectral match by 30 points, at the second by none but lie 9 higher."""
    rows = tidy(2, levels=ARMS, anchors=False, **changes)
    second = rows["level"] == ARMS[1]
    rows["rating"] -= second * 30 * rows["spectral_match"].clip(0, 1)
    return rows.assign(rating=rows["rating"] + second * 24)


def test_levels_by_hand(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = make_arms(tidy, participants=8, recordings=6)
    found = means.compute_levels(Table(rows, METRICS, ()), CHOICES)
    levels = found.rows["levels"]
    differences = pick(levels, "difference")
    wanted = adjust_holm([row["p"] for row in pick(levels, "t")])
    assert [row["p"] for row in differences] == pytest.approx(wanted)
    averages = rows.groupby("level")["rating"].mean()
    rating, slope, _ = differences
    assert rating["value"] == pytest.approx(averages[ARMS[0]] - averages[ARMS[1]], abs=0.01)
    assert slope["low"] < 3 < slope["high"]
    assert slope["p"] < 0.01
    told = [
        line.replace("\N{NO-BREAK SPACE}", " ") for line in render_words("levels", **found.facts)
    ]
    assert told[0].startswith("Levels compared: 2 of 3 differences")
    assert told[1] == "Realism ratings are lower at as is than at equal intensity."
    assert told[2:] == [
        "For realism ratings the slope on spectral match is larger at as is than at equal intensity."
    ]


# Raters.


@pytest.fixture
def read(files: Callable[..., Any]) -> Callable[..., Table]:
    """Read ratings of which some participants do not know the hidden reference again."""

    def read(protocol: str, *, forgetful: tuple[str, ...], people: int = 6) -> Table:
        study = files(participants=people, recordings=3, scales=("comfort",))
        rows = pd.read_csv(study.ratings).assign(protocol=protocol)
        known = ~rows["participant"].isin(forgetful)
        rows.loc[rows["reducer"] == "original", "rating"] = known.map({True: 97.0, False: 60.0})
        rows.to_csv(study.ratings, index=False)
        return read_table(study.ratings, study.manifest)

    return read


def test_flagged_raters_are_counted_by_the_rules_that_apply(read: Callable[..., Table]) -> None:
    first = {}
    for protocol in ("mushra", "realism"):
        found = raters.compute(read(protocol, forgetful=("p01", "p02")), Choices(draws=10))
        first[protocol] = render_words("raters", **found.facts)[0]
        assert (
            find_row(found.rows["screening_rules"], "n_flagged", panel="any")["value"]
            == found.facts["flagged"]
        )
    assert "(2 of them by ITU-R BS.1534-3 rules). Nobody was removed." in first["mushra"]
    assert "the ITU-R BS.1534-3 rules do not apply to these ratings" in first["realism"]


def test_the_spread_of_repeats_by_hand(tidy: Callable[..., pd.DataFrame]) -> None:
    rows = tidy(1, participants=12, recordings=6, noise=5.0)
    found = raters.compute(Table(rows, METRICS, ()), Choices(draws=2))
    tests = rows[rows["role"] == "test"]
    for row in found.rows["repeats"]:
        own = tests[tests["scale"] == row["scale"]]
        # Of pairs, half the mean square of their difference.
        pairs = own.groupby(["participant", "stimulus_id"])["rating"].agg(np.ptp)
        assert row["value"] == pytest.approx(np.sqrt(np.square(pairs).mean() / 2))
        assert row["value"] == pytest.approx(5.0, abs=1.0)
    assert len(found.rows["repeats"]) == tests["scale"].nunique()


def test_one_rater_left_of_several_gives_no_slope(read: Callable[..., Table]) -> None:
    table = read("mushra", forgetful=("p01", "p02"), people=3)
    slopes = pick(raters.compute(table, Choices(draws=10)).rows["slopes_without_hits"], "slope")
    alone = [row for row in slopes if row["panel"] == raters.GROUPS["standard"]]
    assert [row["n"] for row in alone] == [1, 1]
    assert all(np.isnan(row["value"]) for row in alone)
    assert all(row["note"].startswith("One rater is left") for row in alone)
    everyone = [row for row in slopes if row["panel"] == "everyone"]
    assert not any(np.isnan(row["value"]) for row in everyone)


# What a section does not do, and says so.


@pytest.mark.parametrize(("module", "limit"), [(primary, "MOST_CELLS"), (parts, "MOST_DENSE")])
def test_ratings_too_many_to_be_varied_are_told(
    tidy: Callable[..., pd.DataFrame], monkeypatch: pytest.MonkeyPatch, module: object, limit: str
) -> None:
    monkeypatch.setattr(module, limit, 3)
    found = primary.compute_robustness(Table(tidy(), METRICS, ()), CHOICES)
    (note,) = found.notes
    assert note.endswith("no variants. 216 participant x stimulus cells are too many.")
    assert found.is_empty
