import itertools
import math
from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.contrasts.bradley_terry import bradley_terry

ABILITIES = {"a": 0.0, "b": 0.6, "c": 1.2, "d": -0.5}


def make_trials(
    seed: int = 0, *, raters: int = 8, rounds: int = 3, order: float = 0.0, spread: float = 0.0
) -> pd.DataFrame:
    """Every rater meets every ordered pair, with abilities of their own about the planted ones."""
    rng = np.random.default_rng(seed)
    rows = []
    for rater in range(raters):
        own = {name: ability + rng.normal(0, spread) for name, ability in ABILITIES.items()}
        for (first, high), (second, low) in [*itertools.permutations(own.items(), 2)] * rounds:
            chance = 1 / (1 + math.exp(-(high - low + order)))
            rows.append((f"p{rater}", first, second, first if rng.uniform() < chance else second))
    return pd.DataFrame(rows, columns=["participant", "first", "second", "winner"])


def counts(*rows: Sequence[object]) -> pd.DataFrame:
    return pd.DataFrame(rows, columns=["one", "two", "wins_one", "wins_two"])


BASEBALL = """
Milwaukee - 4:3 4:2 4:3 6:1 4:2 6:0
Detroit 3:3 - 4:2 4:3 6:0 6:1 4:3
Toronto 2:5 4:3 - 2:4 4:3 4:2 6:0
NewYork 3:3 5:1 2:5 - 4:3 4:2 6:1
Boston 5:1 2:5 3:3 4:2 - 5:2 6:0
Cleveland 2:5 3:3 3:4 4:3 4:2 - 2:4
Baltimore 2:5 1:5 1:6 2:4 1:6 3:4 -
"""
"""Home and away wins of 1987, a row for each home team (Agresti 2002, Categorical Data Analysis, table 10.10)."""


def read_baseball() -> pd.DataFrame:
    lines = [line.split() for line in BASEBALL.split("\n") if line]
    rows = [
        (home, lines[place][0], *map(int, cell.split(":")))
        for home, *cells in lines
        for place, cell in enumerate(cells)
        if cell != "-"
    ]
    return pd.DataFrame(rows, columns=["home", "away", "home_wins", "away_wins"])


@pytest.mark.parametrize(
    ("home", "fit", "expected"),
    [
        (False, (44.0534612286, 36, -64.2593004953),
         {"Boston": (1.107697705, 0.333877908), "Detroit": (1.436408432, 0.339568187)}),
        (True, (38.642852144, 35, -61.553995953),
         {"Boston": (1.143802653, 0.337842189), "Milwaukee": (1.619554994, 0.347365306),
          "order": (0.302260656, 0.130943643)}),
    ],
)  # fmt: skip
def test_baseball_with_and_without_the_advantage_of_home(
    home: bool, fit: tuple[float, ...], expected: dict[str, tuple[float, float]]
) -> None:
    # R 4.2.2, BradleyTerry2 1.1-2, data(baseball): BTm(cbind(home.wins, away.wins), home.team, away.team,
    # id = "team"), and with formula = ~ team + at.home; Baltimore is the reference.
    result = bradley_terry(read_baseball(), reference="Baltimore", order_effect=home)
    assert (result.deviance, result.df, result.log_likelihood) == pytest.approx(fit, abs=1e-8)
    for name, (estimate, error) in expected.items():
        assert result.fixed.loc[name, "estimate"] == pytest.approx(estimate, abs=1e-6)
        assert result.fixed.loc[name, "se"] == pytest.approx(error, abs=1e-5)


def test_a_form_without_an_order_says_the_same() -> None:
    trials = make_trials(raters=3)
    lost = trials["first"].where(trials["winner"] == trials["second"], trials["second"])
    outcomes = pd.DataFrame({"winner": trials["winner"], "loser": lost})
    square = pd.crosstab(outcomes["winner"], outcomes["loser"])
    plain = bradley_terry(trials).fixed
    pairs = itertools.combinations("abcd", 2)
    met = counts(*[(one, two, square.loc[one, two], square.loc[two, one]) for one, two in pairs])
    result = bradley_terry(outcomes)
    pd.testing.assert_frame_equal(result.fixed, plain, rtol=1e-6)
    assert result.deviance == pytest.approx(bradley_terry(met).deviance)
    with pytest.raises(ValueError, match="order_effect needs pairs that say which was presented"):
        bradley_terry(outcomes, order_effect=True)


def test_planted_abilities_and_order_are_recovered() -> None:
    result = bradley_terry(make_trials(raters=150, order=0.4), order_effect=True)
    for name, ability in {**ABILITIES, "order": 0.4}.items():
        row = result.fixed.loc[name]
        assert abs(row["estimate"] - ability) <= 4 * row["se"] < 0.5
    assert list(result.fixed.index) == ["a", "b", "c", "d", "order"]


@pytest.mark.parametrize("tie", ["tie", None])
def test_ties_are_refused_or_count_half(tie: str | None) -> None:
    winners = ["a", "a", "a", "b", tie, tie]
    trials = pd.DataFrame({"first": "a", "second": "b", "winner": winners})
    with pytest.raises(ValueError, match="pairs must have a winner, got 2"):
        bradley_terry(trials)
    result = bradley_terry(trials, ties="half")
    assert result.fixed.loc["b", "estimate"] == pytest.approx(-math.log(4 / 2))
    assert (result.n_ties, result.notes) == (2, ("2 ties count half a win for each.",))


@pytest.mark.parametrize(
    "rows",
    [
        [("a", "b", 5, 0), ("b", "c", 3, 2)],
        [("a", "b", 5, 2), ("b", "c", 3, 0), ("a", "c", 4, 0)],
        [("a", "b", 5, 2), ("c", "d", 3, 1)],
    ],
)
def test_what_always_wins_or_never_meets_the_others_has_no_estimate(
    rows: list[tuple[object, ...]],
) -> None:
    with pytest.raises(ValueError, match="pairs must have no separation"):
        bradley_terry(counts(*rows))


def test_a_prior_makes_separated_abilities_finite() -> None:
    result = bradley_terry(counts(("a", "b", 5, 0)), prior=0.5)
    assert result.fixed.loc["b", "estimate"] == pytest.approx(-math.log(5.5 / 0.5))
    assert "0.5 wins are added" in result.notes[0]
    with pytest.raises(ValueError, match="prior must be 0 or more, got -1"):
        bradley_terry(counts(("a", "b", 5, 1)), prior=-1)


def test_raters_alike_give_walds_errors_and_raters_unlike_give_larger() -> None:
    rng = np.random.default_rng(1)
    alike = bradley_terry(make_trials(raters=40), by_rater=True, draws=400, rng=rng).fixed
    wald = bradley_terry(make_trials(raters=40)).fixed
    assert alike["estimate"].to_numpy() == pytest.approx(wald["estimate"].to_numpy())
    np.testing.assert_allclose(alike.loc["b":, "se"], wald.loc["b":, "se"], rtol=0.35)
    unlike = make_trials(raters=40, spread=1.0)
    wider = bradley_terry(unlike, by_rater=True, draws=400, rng=rng).fixed["se"]
    assert (wider / bradley_terry(unlike).fixed["se"])["d"] > 1.5


def test_draws_in_which_an_item_met_nobody_have_no_estimate() -> None:
    # Only one of four raters judged c: a draw without that rater knows nothing of it, which is not an ability of 0.
    rows = [(f"p{who}", "a", "b", "ab"[turn % 2]) for who in range(4) for turn in range(5 + who)]
    rows += [("p3", "b", "c", "bc"[turn % 2]) for turn in range(6)]
    trials = pd.DataFrame(rows, columns=["participant", "first", "second", "winner"])
    result = bradley_terry(
        trials, by_rater=True, reference="a", draws=400, rng=np.random.default_rng(0)
    )
    drawn = np.random.default_rng(0).multinomial(4, np.full(4, 0.25), size=400)
    assert f"In {(drawn[:, 3] == 0).sum()} of 400 draws" in result.notes[0]
    assert "too many draws have no estimate" in result.notes[1]
    assert result.fixed.loc[["b", "c"], "low"].isna().all()


def test_a_draw_is_a_fit_of_the_raters_drawn() -> None:
    trials = make_trials(raters=5, rounds=6, order=0.3)
    how = {"reference": "b", "order_effect": True}
    result = bradley_terry(trials, by_rater=True, draws=40, rng=np.random.default_rng(3), **how)
    weights = np.random.default_rng(3).multinomial(5, np.full(5, 0.2), size=40)
    own, drawn = [rows for _, rows in trials.groupby("participant")], []
    for row in weights:
        rows = pd.concat([own[rater] for rater in np.repeat(np.arange(5), row)])
        drawn.append(bradley_terry(rows, **how).fixed["estimate"])
    expected = pd.DataFrame(drawn).std(ddof=1) * math.sqrt(5 / 4)
    assert result.fixed["se"].to_numpy() == pytest.approx(expected.to_numpy(), abs=1e-6)
    assert result.fixed.loc["b", "se"] == 0


@pytest.mark.soak
def test_intervals_over_raters_cover_and_walds_do_not() -> None:
    # Averaged over raters who differ, log odds are smaller than a single rater's: the truth is that of a large panel.
    panel = make_trials(10_000, raters=3000, rounds=2, spread=0.7)
    truth = bradley_terry(panel).fixed.loc["c", "estimate"]
    covered = []
    for seed in range(400):
        trials, rng = (
            make_trials(seed, raters=15, rounds=2, spread=0.7),
            np.random.default_rng(seed),
        )
        fits = bradley_terry(trials, by_rater=True, draws=300, rng=rng), bradley_terry(trials)
        rows = [fit.fixed.loc["c"] for fit in fits]
        covered.append([row["low"] <= truth <= row["high"] for row in rows])
    by_rater, wald = np.mean(covered, axis=0)
    assert 0.92 < by_rater < 0.98
    assert wald < by_rater - 0.03
