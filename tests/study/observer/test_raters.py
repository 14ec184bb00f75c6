from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, norm

from feel321.study.observer import KINDS, ObserverModel, Rater, draw_rater, expect_rating


def vary(model: ObserverModel, **changes: object) -> ObserverModel:
    return ObserverModel(**{**model.model_dump(), **changes})


MODEL = ObserverModel()
CAREFUL = Rater(kind="normal", bias=0.0, gain=1.0, noise_sd=8.0, lapse_rate=0.0, favourite=0.3)


def draw_many(model: ObserverModel, n: int = 2000) -> list[Rater]:
    return [draw_rater(model, np.random.default_rng([7, number])) for number in range(n)]


def rate_many(rater: Rater, percept: float, *, n: int = 4000) -> np.ndarray:
    rng = np.random.default_rng(3)
    return np.array([rater.rate(percept, rng) for _ in range(n)])


def share_correct(rater: Rater, distance: float, *, n: int = 20_000) -> float:
    rng = np.random.default_rng(11)
    chosen = [rater.choose({"a": distance, "b": 0.0}, rng) for _ in range(n)]
    return chosen.count("b") / n


def test_participants_differ_as_the_model_says() -> None:
    raters = draw_many(MODEL)
    assert np.std([r.bias for r in raters]) == pytest.approx(6.0, rel=0.05)
    assert np.std(np.log([r.gain for r in raters])) == pytest.approx(0.15, rel=0.05)
    noise = np.log([r.noise_sd for r in raters])
    assert np.exp(np.median(noise)) == pytest.approx(8.0, rel=0.03)
    assert np.std(noise) == pytest.approx(0.25, rel=0.05)


def test_bad_raters_come_in_the_shares_that_were_asked_for() -> None:
    model = vary(MODEL, straight_liners=0.1, random_clickers=0.2, scale_reversers=0.3)
    kinds = Counter(rater.kind for rater in draw_many(model))
    shares = [kinds[kind] / 2000 for kind in KINDS]
    assert shares == pytest.approx([0.4, 0.1, 0.2, 0.3], abs=0.03)
    assert {rater.kind for rater in draw_many(MODEL)} == {"normal"}
    everyone = vary(MODEL, straight_liners=0.33, random_clickers=0.56, scale_reversers=0.11)
    assert "normal" not in {rater.kind for rater in draw_many(everyone)}


def test_what_is_out_of_range_is_refused() -> None:
    shares = ["lapse_rate", "straight_liners", "random_clickers", "scale_reversers"]
    sizes = ["bias_sd", "gain_sd", "noise_sd", "noise_spread"]
    wrong = [(name, -0.1) for name in shares + sizes] + [(name, 1.1) for name in shares]
    for name, value in [*wrong, *((name, float("nan")) for name in shares + sizes)]:
        with pytest.raises(ValueError, match=name):
            vary(MODEL, **{name: value})
    with pytest.raises(ValueError, match=r"scale_reversers must be at most 1 together, got 1.2"):
        vary(MODEL, straight_liners=0.4, random_clickers=0.4, scale_reversers=0.4)
    with pytest.raises(ValueError, match="must be one of spectral_match_bounded, spectral_match"):
        vary(MODEL, spectral_metric="mine")


def test_a_rating_is_bias_gain_percept_and_noise() -> None:
    exact = replace(CAREFUL, bias=-4.0, gain=1.5, noise_sd=0.0)
    assert rate_many(exact, 40.0, n=2).tolist() == [56.0, 56.0]
    assert exact.rate(40.0, np.random.default_rng(), sure=100.0) == 100 - 90 - 4
    ratings = rate_many(CAREFUL, 50.0)
    assert ratings.mean() == pytest.approx(50, abs=0.6)
    assert ratings.std() == pytest.approx(8, rel=0.04)


@pytest.mark.parametrize("lapse_rate", [0.0, 0.05, 0.3])
def test_lapses_are_as_frequent_as_planted_and_uniform(lapse_rate: float) -> None:
    ratings = rate_many(replace(CAREFUL, noise_sd=0.0, lapse_rate=lapse_rate), 50.0, n=20_000)
    lapses = ratings[ratings != 50.0]
    # One uniform rating in a thousand hits 50.0 itself.
    assert lapses.size / ratings.size == pytest.approx(lapse_rate * 0.999, abs=0.006)
    if lapse_rate:
        assert kstest(lapses, "uniform", args=(0, 100)).pvalue > 0.001


def test_a_straight_liner_stays_in_place_whatever_is_felt() -> None:
    ratings = np.concatenate([
        rate_many(replace(CAREFUL, kind="straight_liner"), p, n=500) for p in (0.0, 50.0, 100.0)
    ])
    assert ratings.mean() == pytest.approx(30.0, abs=0.1)
    assert ratings.std() == pytest.approx(1.0, rel=0.1)


def test_a_random_clicker_answers_anything_and_fast() -> None:
    clicker = replace(CAREFUL, kind="random_clicker")
    assert kstest(rate_many(clicker, 90.0), "uniform", args=(0, 100)).pvalue > 0.001
    rng = np.random.default_rng(1)
    fast, slow = (np.median([r.draw_time(rng) for _ in range(2000)]) for r in (clicker, CAREFUL))
    assert (fast, slow) == (pytest.approx(0.5, rel=0.05), pytest.approx(2.0, rel=0.05))


def test_a_scale_reverser_mirrors_what_the_same_hand_would_rate() -> None:
    straight, reversed_ = (
        rate_many(replace(CAREFUL, kind=kind), 70.0) for kind in ("normal", "scale_reverser")
    )
    assert reversed_ == pytest.approx(100.0 - straight, abs=0.051)


def differencing(d_prime: float) -> float:
    two, six = d_prime / np.sqrt(2), d_prime / np.sqrt(6)
    return float(norm.cdf(two) * norm.cdf(six) + norm.cdf(-two) * norm.cdf(-six))


@pytest.mark.parametrize("distance", [0.0, 4.0, 8.0, 16.0, 32.0])
@pytest.mark.parametrize(("bias", "gain"), [(0.0, 1.0), (9.0, 1.4)])
def test_choices_follow_the_differencing_model_whatever_the_hand_does_on_a_slider(
    distance: float, bias: float, gain: float
) -> None:
    measured = share_correct(replace(CAREFUL, bias=bias, gain=gain), distance)
    assert measured == pytest.approx(differencing(distance / 8.0), abs=0.012)


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        ({"lapse_rate": 0.2}, 0.9),
        ({"kind": "random_clicker"}, 0.5),
        ({"kind": "scale_reverser"}, 1.0),  # a choice has no ends
        ({"kind": "straight_liner", "favourite": 0.3}, 0.0),
        ({"kind": "straight_liner", "favourite": 0.7}, 1.0),
    ],
)
def test_who_chooses_how_when_the_difference_is_plain(
    change: dict[str, str | float], expected: float
) -> None:
    assert share_correct(replace(CAREFUL, **change), 200.0) == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("lapse_rate", [0.0, 0.3])
def test_the_expected_rating_is_the_mean_of_many_people(lapse_rate: float) -> None:
    model = vary(MODEL, lapse_rate=lapse_rate)
    percepts = [5.0, 50.0, 95.0]
    rng = np.random.default_rng(5)
    raters = draw_many(model, 4000)
    given = np.array([[r.rate(p, rng) for p in percepts] for r in raters])
    error = given.std(axis=0) / np.sqrt(len(given))
    assert np.all(np.abs(given.mean(axis=0) - expect_rating(model, percepts)) < 5 * error)


@pytest.mark.parametrize("apart", [0.0, 6.0, 12.0])
def test_the_more_real_is_preferred_as_thurstone_says(apart: float) -> None:
    rng = np.random.default_rng(5)
    percepts = {"a": 40.0 + apart, "b": 40.0}
    chosen = [CAREFUL.prefer(percepts, rng) for _ in range(20_000)]
    expected = norm.cdf(apart / (CAREFUL.noise_sd * np.sqrt(2)))
    assert chosen.count("a") / len(chosen) == pytest.approx(expected, abs=0.015)
