"""The short way to the deviance of a balanced design: the same function of the spreads as the general one."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.mixed.design import build_design
from feel321.analysis.mixed.model import estimate_sum, find_uncertainty
from feel321.analysis.mixed.optimum import (
    Balanced,
    Profile,
    find_balance,
    find_coefficients,
    find_optimum,
    find_sigma,
    find_slope,
)

if TYPE_CHECKING:
    from feel321.analysis.mixed.design import MixedDesign
    from feel321.analysis.mixed.model import Estimate

GROUPS = (
    "(1 + a + b || who) + (1 | scene) + (1 | item) + (1 | who:scene) + (1 | kind) + (1 | who:kind)"
)
FULL = f"y ~ a + b + c + {GROUPS}"


def make_study(
    seed: int, *, people: int = 7, scenes: int = 4, kinds: int = 4, spread: float = 1.0
) -> pd.DataFrame:
    """Ratings of a crossed study; with a spread of 0, most variances are estimated as zero."""
    rng = np.random.default_rng(seed)
    who, scene, kind = (axis.ravel() for axis in np.indices((people, scenes, kinds)))
    item = scene * kinds + kind
    a, b = rng.normal(size=(2, scenes * kinds))
    y = 50 + 2 * a[item] + rng.normal(0, 4, len(who))
    for group, sd in (
        (who, 5),
        (scene, 3),
        (item, 2),
        (kind, 3),
        (who * scenes + scene, 2),
        (who * kinds + kind, 2),
    ):
        y = y + spread * sd * rng.normal(size=group.max() + 1)[group]
    y += spread * rng.normal(0, 2, people)[who] * a[item]
    table = pd.DataFrame({
        "who": who,
        "scene": scene,
        "kind": kind,
        "item": item,
        "a": a[item],
        "b": b[item],
        "y": y,
    })
    return table.assign(c=rng.normal(size=scenes)[scene])


def pair_engines(
    design: MixedDesign, *, reml: bool = True, penalty: tuple[str, ...] = ()
) -> tuple[Profile, Balanced]:
    balance = find_balance(design)
    assert balance is not None
    return Profile(design, reml=reml, penalty=penalty), Balanced(
        design, balance, reml=reml, penalty=penalty
    )


def test_stimuli_cost_no_columns_whatever_their_order() -> None:
    table = make_study(3)
    _, quick = pair_engines(build_design(FULL, table))
    names = np.random.default_rng(4).permutation(table["item"].max() + 1)
    _, named = pair_engines(build_design(FULL, table.assign(item=names[table["item"]])))
    # A person's level, two slopes, 4 scenes and 4 kinds; everybody's 4 scenes and 4 kinds; none for the 16 stimuli.
    assert quick.n_random == named.n_random == 19
    theta = np.random.default_rng(5).uniform(0, 2, len(quick.diagonal))
    states = [profile.evaluate(theta) for profile in (quick, named)]
    np.testing.assert_allclose(quick.deviance(states[0]), named.deviance(states[1]), rtol=1e-12)


@pytest.mark.parametrize("reml", [True, False])
@pytest.mark.parametrize(
    "formula", [FULL, f"y ~ {GROUPS}", "y ~ a + (1 | who)", "y ~ a + (1 | who) + (1 | item)"]
)
def test_same_deviance_and_slope_at_any_spreads(formula: str, *, reml: bool) -> None:
    full, quick = pair_engines(build_design(formula, make_study(1)), reml=reml)
    rng = np.random.default_rng(2)
    for theta in rng.uniform(0, 2, (4, full.diagonal.size)):
        one, two = full.evaluate(theta), quick.evaluate(theta)
        assert quick.deviance(two) == pytest.approx(full.deviance(one), rel=1e-10)
        assert (two.log_random, two.log_fixed) == pytest.approx(
            (one.log_random, one.log_fixed), rel=1e-9, abs=1e-9
        )
        assert two.rss == pytest.approx(one.rss, rel=1e-9)
        for weight in (None, 55.0):
            assert find_slope(quick, two, weight) == pytest.approx(
                find_slope(full, one, weight), rel=1e-7, abs=1e-7
            )
        for ours, theirs in zip(
            find_coefficients(quick, two), find_coefficients(full, one), strict=True
        ):
            assert ours == pytest.approx(theirs, rel=1e-8, abs=1e-10)


def fit_terms(engine: Profile) -> tuple[float, float, list[Estimate]]:
    best = find_optimum(engine)
    uncertainty, (effects, _) = find_uncertainty(engine, best), find_coefficients(engine, best)
    terms = [estimate_sum(effects, weights, uncertainty) for weights in np.eye(len(effects))]
    return engine.deviance(best), find_sigma(engine, best), terms


@pytest.mark.parametrize("penalty", [(), ("kind",)])
@pytest.mark.parametrize(("seed", "spread"), [(1, 1.0), (2, 1.0), (3, 0.3), (4, 0.0), (5, 0.0)])
def test_same_fit_on_regular_and_singular_studies(
    seed: int, spread: float, penalty: tuple[str, ...]
) -> None:
    full, quick = pair_engines(build_design(FULL, make_study(seed, spread=spread)), penalty=penalty)
    (criterion, sigma, terms), (found, residual, others) = fit_terms(full), fit_terms(quick)
    assert found == pytest.approx(criterion, abs=1e-5)
    assert residual == pytest.approx(sigma, rel=1e-4)
    for one, two in zip(terms, others, strict=True):
        assert two.estimate == pytest.approx(one.estimate, rel=1e-4, abs=1e-4)
        assert two.se == pytest.approx(one.se, rel=1e-4)
        assert two.df == pytest.approx(one.df, rel=1e-3)


def test_means_that_lie_on_the_fixed_effects_leave_the_residual_of_what_deviates() -> None:
    who, x = (axis.ravel() for axis in np.indices((4, 3)))
    data = pd.DataFrame({"who": who, "x": x, "y": [1.0, 2, 3, 3, 5, 6, 2, 2, 4, 5, 7, 8]})
    full, quick = pair_engines(build_design("y ~ x + (1 | who)", data))
    (criterion, sigma, terms), (found, residual, others) = fit_terms(full), fit_terms(quick)
    assert (found, residual) == pytest.approx((criterion, sigma), rel=1e-6)
    assert others[1].df == pytest.approx(terms[1].df, rel=1e-4)


def test_order_of_rows_is_found_whatever_it_was() -> None:
    data = make_study(1)
    mixed = data.sample(frac=1, random_state=1)
    (full, _), (_, quick) = (pair_engines(build_design(FULL, table)) for table in (data, mixed))
    theta = np.linspace(0.2, 1.2, full.diagonal.size)
    assert quick.deviance(quick.evaluate(theta)) == pytest.approx(
        full.deviance(full.evaluate(theta)), rel=1e-10
    )


def test_designs_that_are_not_balanced_have_no_order() -> None:
    data = make_study(1)
    own = data.assign(a=data["a"] + 0.1 * data["who"])
    for formula, table in (
        (FULL, data.iloc[1:]),
        (FULL, own),
        (FULL.replace("||", "|"), data),
        (
            FULL,
            data.assign(
                kind=np.where(data["who"] == 0, data["kind"].to_numpy()[::-1], data["kind"])
            ),
        ),
    ):
        assert find_balance(build_design(formula, table)) is None


def test_penalised_spread_is_never_zero_and_vanishes_in_the_mass() -> None:
    data = make_study(4, spread=0.0)
    quick = pair_engines(build_design(FULL, data), penalty=("kind",))[1]
    best = find_optimum(quick)
    (place,) = np.flatnonzero(quick.penalised)
    assert best.theta[place] > 0.02
    # The derivative of deviance - 2 log (theta s) is zero there, s following from rss / (freedom - 1).
    step = np.where(quick.penalised, 1e-5, 0)

    def find_target(theta: np.ndarray) -> float:
        state = quick.evaluate(theta)
        return quick.deviance(state) - 2 * np.log(theta[place] * find_sigma(quick, state))

    rise = (find_target(best.theta + step) - find_target(best.theta - step)) / 2e-5
    assert rise == pytest.approx(0, abs=1e-2)
    many = make_study(6, people=5, scenes=3, kinds=40)
    plain, held = (
        find_optimum(pair_engines(build_design(FULL, many), penalty=which)[1])
        for which in ((), ("kind",))
    )
    assert held.theta[place] == pytest.approx(plain.theta[place], rel=0.05)


def test_spreads_are_known_as_well_as_the_curvature_of_what_was_minimised_says() -> None:
    quick = pair_engines(build_design(FULL, make_study(1)), penalty=("kind",))[1]
    best = find_optimum(quick)
    free = np.flatnonzero(best.theta > 0)
    start, size = np.append(best.theta, np.log(find_sigma(quick, best))), len(best.theta)

    def find_target(point: np.ndarray) -> float:
        state, log_s = quick.evaluate(point[:-1]), point[-1]
        deviance = (
            state.log_random + state.log_fixed + quick.freedom * (np.log(2 * np.pi) + 2 * log_s)
        )
        spread = float(np.log(np.abs(point[:-1][quick.penalised])).sum()) + log_s
        return float(deviance + state.rss / np.exp(2 * log_s) - 2 * spread)

    places = [*free, size]
    steps = 1e-3 * np.eye(size + 1)[places]
    hessian = [
        [
            (
                find_target(start + a + b)
                - find_target(start + a - b)
                - find_target(start - a + b)
                + find_target(start - a - b)
            )
            / 4e-6
            for a in steps
        ]
        for b in steps
    ]
    unit = np.append(np.maximum(best.theta, 1), 1)[places]
    wanted = 2 * np.linalg.inv(np.array(hessian) * np.outer(unit, unit))
    known = find_uncertainty(quick, best).parameters[np.ix_(places, places)]
    assert known == pytest.approx(wanted, rel=2e-2, abs=1e-4)


@pytest.mark.parametrize(
    ("penalty", "formula", "message"),
    [
        (["kin"], FULL, "groups of the formula .*got 'kin'"),
        (["who"], "y ~ a + (a | who)", "correlated"),
    ],
)
def test_penalties_refused(penalty: list[str], formula: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Profile(build_design(formula, make_study(1)), reml=True, penalty=penalty)


def test_a_level_for_every_row_takes_no_columns_in_whatever_order_rows_stand() -> None:
    for table in (make_study(1), make_study(1).sample(frac=1, random_state=1)):
        _, quick = pair_engines(build_design(FULL, table))
        assert quick.each is not None
        # Of one person: level, two slopes, 4 scenes, 4 kinds; of everybody: 4 scenes, 4 kinds; none for the 16 items.
        assert quick.n_random == 3 + 4 + 4 + 4 + 4
