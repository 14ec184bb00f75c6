"""The rater model: planted bias and inconsistency are recovered, bad raters stand apart, honest ones do not."""

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.agreement import find_apart, rater_model

PEOPLE = [f"p{number:02d}" for number in range(20)]


def make_votes(
    seed: int, *, spread: object = 8.0, bias: object = 0.0, items: int = 60, repeats: int = 1
) -> pd.DataFrame:
    """Make ratings of honest people: quality plus bias plus noise of each person's own spread."""
    rng = np.random.default_rng(seed)
    quality = rng.uniform(20, 80, items)
    who, what, _ = (axis.ravel() for axis in np.indices((len(PEOPLE), items, repeats)))
    noise = rng.normal(0, np.broadcast_to(spread, len(PEOPLE))[who])
    rating = quality[what] + np.broadcast_to(bias, len(PEOPLE))[who] + noise
    columns = {"stimulus_id": what, "rating": rating, "quality": quality[what]}
    return pd.DataFrame({"participant": np.array(PEOPLE)[who], **columns})


def test_planted_raters_and_qualities_are_recovered() -> None:
    rng = np.random.default_rng(2)
    spread, bias = np.exp(rng.normal(2.2, 0.25, len(PEOPLE))), rng.normal(0, 6, len(PEOPLE))
    rows = make_votes(3, spread=spread, bias=bias - bias.mean(), repeats=2)
    model = rater_model(rows)
    raters, truth = model.raters, pd.Series(spread, index=PEOPLE)
    # Standardised errors of 20 raters: five in a thousand panels have one beyond 4.
    assert (((raters["bias"] - (bias - bias.mean())) / raters["bias_se"]).abs() < 4).all()
    assert (((raters["inconsistency"] - truth) / raters["inconsistency_se"]).abs() < 4).all()
    assert abs(raters["bias"].sum()) < 1e-9
    planted = rows.groupby(rows["stimulus_id"].astype(str))["quality"].first()
    errors = (model.stimuli["quality"] - planted[model.stimuli.index]) / model.stimuli["se_raters"]
    assert 0.7 < errors.std() < 1.3
    # Weighted by consistency, qualities are nearer to the truth than plain means.
    plain = rows.groupby(rows["stimulus_id"].astype(str))["rating"].mean()
    assert (model.stimuli["quality"] - planted).std() < (plain - planted).std()


def test_scales_and_shifts_of_the_votes_carry_over() -> None:
    rows = make_votes(4, spread=np.linspace(4, 12, 20))
    one, other = rater_model(rows), rater_model(rows.assign(rating=3 * rows["rating"] - 40))
    names = ["bias", "inconsistency"]
    pd.testing.assert_frame_equal(other.raters[names], 3 * one.raters[names], rtol=1e-6)
    np.testing.assert_allclose(other.stimuli["quality"], 3 * one.stimuli["quality"] - 40, rtol=1e-6)
    assert other.apart == one.apart


@pytest.mark.parametrize("n_bad", [1, 2, 4])
def test_those_who_click_at_random_stand_apart_and_nobody_else(n_bad: int) -> None:
    found = 0
    for seed in range(20):
        rows, rng = make_votes(100 + seed), np.random.default_rng(seed)
        bad = rows["participant"].isin(PEOPLE[:n_bad])
        rows.loc[bad, "rating"] = rng.uniform(0, 100, int(bad.sum()))
        found += set(rater_model(rows).apart) == set(PEOPLE[:n_bad])
    assert found >= 18  # one panel in twenty may name an honest rater besides


@pytest.mark.parametrize("heterogeneity", [0.0, 0.3])
def test_honest_panels_are_left_in_peace(heterogeneity: float) -> None:
    alarms = 0
    for seed in range(150):
        rng = np.random.default_rng([9, seed])
        panel = 8 * np.exp(rng.normal(0, heterogeneity, 20)) * np.sqrt(rng.chisquare(59, 20) / 59)
        alarms += find_apart(panel)[0].any()
    assert alarms <= 15  # of 150 at 5 %: more than 15 in 4 of 1000 runs


def test_a_bias_is_nothing_to_stand_apart_by() -> None:
    bias = np.zeros(20)
    bias[5] = 25
    model = rater_model(make_votes(8, bias=bias))
    assert model.apart == ()
    assert model.raters["bias"].idxmax() == "p05"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda rows: rows[rows["participant"].isin(PEOPLE[:2])], "3 raters or more, got 2"),
        (lambda rows: rows[rows["stimulus_id"] < 2], "3 stimuli or more, got 2"),
        (lambda rows: rows.assign(rating=5.0), "must be finite and differ"),
        (
            lambda rows: rows[(rows["participant"] != "p07") | (rows["stimulus_id"] < 2)],
            "3 ratings or more, got fewer of p07",
        ),
        (lambda rows: rows.assign(level=rows["stimulus_id"] % 2), "must be of one level"),
    ],
)
def test_ratings_that_say_too_little_are_refused(
    change: Callable[[pd.DataFrame], pd.DataFrame], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        rater_model(change(make_votes(1)))


def test_the_ratings_of_one_do_not_become_the_qualities() -> None:
    """With few raters the likelihood grows without bound towards one of them."""
    collapsed = 0
    for seed in range(20):
        rows = make_votes(seed, spread=12.0, items=24)
        rows = rows[rows["participant"].isin(PEOPLE[:4])]
        model = rater_model(rows)
        assert model.raters["weight"].max() < 0.5
        assert model.raters["inconsistency"].min() > 3
        collapsed += any("count alike" in note for note in model.notes)
    assert collapsed
