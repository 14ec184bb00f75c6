"""Mixed models against R, against the likelihood written out, and at their boundaries."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.mixed.design import build_design
from feel321.analysis.mixed.model import MixedFit, find_uncertainty, fit_mixed
from feel321.analysis.mixed.optimum import Profile, find_optimum

HERE = Path(__file__).parent
ORACLES = HERE.parents[2] / "shared" / "oracles"
FITS = [
    (folder, fit)
    for folder in ("classic", "crossed")
    for fit in json.loads((HERE / folder / "expected.json").read_text(encoding="utf-8"))["fits"]
]
"""Fits of lme4; expected.json names the R call. Classic data, and simulated ones with gaps, repeats, nesting, effects
correlated by .999 and spreads near zero: 91 fits, 44 of them singular."""

FULL = "y ~ a + b + (1 + a + b || who) + (1 | scene) + (1 | scene:kind) + (1 | who:scene)"
WHOLE = f"{FULL} + (1 | kind) + (1 | who:kind)"


def find_oracle(name: str, model: str) -> tuple[pd.DataFrame, dict[str, Any], dict[str, float]]:
    folder = ORACLES / name
    if not folder.is_dir():
        pytest.skip(f"NO ORACLE: {folder} is missing, this comparison with R did not run")
    expected = json.loads((folder / "expected.json").read_text(encoding="utf-8"))
    return pd.read_csv(folder / "data.csv"), expected[model], expected["tol"]


def make_study(
    seed: int, *, spread: float = 1.0, people: int = 6, scenes: int = 5, kinds: int = 4
) -> pd.DataFrame:
    rng = np.random.default_rng(seed)
    levels, names = [range(people), range(scenes), range(kinds)], ["who", "scene", "kind"]
    table = pd.MultiIndex.from_product(levels, names=names).to_frame(index=False)
    item = table["scene"] * kinds + table["kind"]
    metrics = rng.normal(size=(2, scenes * kinds))
    table["a"], table["b"] = metrics[0][item], metrics[1][item]
    table["y"] = 50 + 3 * table["a"] + rng.normal(0, 5, len(table))
    both = table["who"] * scenes + table["scene"]
    sds = ((table["who"], 6), (table["scene"], 3), (item, 2 * spread), (both, spread))
    for index, sd in sds:
        table["y"] += sd * rng.normal(size=index.max() + 1)[index]
    table["y"] += spread * rng.normal(size=people)[table["who"]] * table["a"]
    return table


@pytest.fixture(scope="module")
def fit() -> MixedFit:
    return fit_mixed(FULL, make_study(1))


@pytest.mark.parametrize(
    ("name", "model"),
    [
        *(("lmm_crossed_study", model) for model in ("A_intercepts_only", "B_full")),
        *(("lmm_sleepstudy", f"{model}correlated_{how}") for model, how in (("", "reml"), ("un", "reml"), ("", "ml"))),
    ],
)  # fmt: skip
def test_shared_oracles(name: str, model: str) -> None:
    data, expected, tolerance = find_oracle(name, model)
    fit = fit_mixed(expected["formula"], data, reml=expected["method"] == "REML")
    columns = {"estimate": "fixef", "se": "se", "df": "df_satterthwaite"}
    for column, key in columns.items():
        near = tolerance[f"{key.split('_')[0]}_rel"]
        assert fit.fixed[column].to_dict() == pytest.approx(expected[key], rel=near)
    assert fit.criterion == pytest.approx(expected["criterion"], abs=tolerance["criterion_abs"])
    assert fit.residual_sd == pytest.approx(expected["sigma"], rel=tolerance["sd_rel"])
    assert fit.singular is expected["singular"]
    spreads = [row for row in expected["varcomp"] if row["var2"] is None]
    wanted = {(row["grp"].split(".")[0], row["var1"]): row["sdcor"] for row in spreads}
    got = fit.variances.set_index(["group", "term"])["sd"].to_dict()
    wanted = {key: sd for key, sd in wanted.items() if key in got}
    assert wanted == pytest.approx(got, rel=tolerance["sd_rel"])
    ties = [row["sdcor"] for row in expected["varcomp"] if row["var2"] is not None]
    assert fit.correlations["correlation"].tolist() == pytest.approx(ties, rel=0.01)


def name_fit(one: Any) -> str:
    return one if isinstance(one, str) else f"{one['data']}: {one['formula']} {one['reml']}"


@pytest.mark.parametrize(("folder", "expected"), FITS, ids=name_fit)
def test_against_lme4(folder: str, expected: dict[str, Any]) -> None:
    data = pd.read_csv(HERE / folder / f"{expected['data']}.csv")
    fit = fit_mixed(expected["formula"], data, reml=expected["reml"])
    assert fit.fixed.index.tolist() == expected["terms"]
    assert fit.criterion <= expected["criterion"] + 1e-5
    # Lme4 had not found the minimum: cake with a curve and slopes.
    if fit.criterion < expected["criterion"] - 0.01:
        assert "I(temp^2)" in expected["formula"]
        return
    close = 1e-4 if folder == "classic" else 1e-5
    assert fit.criterion == pytest.approx(expected["criterion"], abs=close)
    # Some effects are nought: their standard error is the yardstick.
    errors = (fit.fixed["estimate"] - expected["estimate"]) / fit.fixed["se"]
    assert errors.abs().max() < 1e-4
    assert fit.fixed["se"].tolist() == pytest.approx(expected["se"], rel=5e-4)
    assert fit.fixed["df"].tolist() == pytest.approx(expected["df"], rel=2e-3)
    if "p" in expected:
        assert fit.fixed["p"].tolist() == pytest.approx(expected["p"], rel=5e-3, abs=1e-12)
    assert fit.residual_sd == pytest.approx(expected["residual_sd"], rel=1e-4)
    assert fit.singular is expected["singular"]
    got = fit.variances.set_index(["group", "term"])["sd"].to_dict()
    groups = {group for group, _ in got}
    if folder == "crossed":
        assert set(got) == {(group, term) for group, term, _ in expected["spreads"]}
    # What its intercept takes, its levels lack: only the sum is known.
    if "(f||p)" in expected["formula"]:
        return
    near = 5e-3 if folder == "classic" else 2e-3 * fit.residual_sd
    for group, term, sd in expected["spreads"]:
        name = group if group in groups else ":".join(reversed(group.split(":")))
        assert got[name, term] == pytest.approx(sd, rel=2e-3, abs=near)


def deviance_written_out(profile: Profile, theta: np.ndarray) -> float:
    """-2 log restricted likelihood by the covariance of all rows, as in any textbook."""
    design, n = profile.design, profile.n_rows
    covariance = np.eye(n)
    spreads = profile.find_spreads(profile.evaluate(theta))
    for block, own in zip(profile.blocks, spreads, strict=True):
        same = block.factor.index[:, None] == block.factor.index
        covariance += same * (block.factor.columns @ own @ block.factor.columns.T)
    inverse = np.linalg.inv(covariance)
    information = design.fixed.T @ inverse @ design.fixed
    effects = np.linalg.solve(information, design.fixed.T @ inverse @ design.response)
    rest = design.response - design.fixed @ effects
    scale = rest @ inverse @ rest / profile.freedom
    logs = np.linalg.slogdet(covariance)[1] + profile.reml * np.linalg.slogdet(information)[1]
    return float(logs + profile.freedom * (1 + np.log(2 * np.pi * scale)))


@pytest.mark.parametrize("kept", [1.0, 0.8])
@pytest.mark.parametrize("reml", [True, False])
@pytest.mark.parametrize("formula", [
    FULL, WHOLE, "y ~ a + (a + b | who) + (a | scene)", "y ~ 1 + (1 | who)", "y ~ a + (0 + a | who) + (b || scene)",
])  # fmt: skip
def test_deviance_and_slope_by_definition(formula: str, kept: float, reml: bool) -> None:
    """Of studies in which all people rated everything, and of those with gaps."""
    data = make_study(2).sample(frac=kept, random_state=1)
    profile = Profile(build_design(formula, data), reml=reml)
    theta = np.random.default_rng(3).uniform(0.2, 1.5, profile.diagonal.size)
    state = profile.evaluate(theta)
    assert profile.deviance(state) == pytest.approx(deviance_written_out(profile, theta), abs=1e-8)
    slope = [
        (deviance_written_out(profile, theta + s) - deviance_written_out(profile, theta - s)) / 2e-5
        for s in np.eye(profile.diagonal.size) * 1e-5
    ]
    assert profile.find_slope(state) == pytest.approx(np.array(slope), abs=1e-4)


def test_the_order_of_rows_and_the_names_of_levels_do_not_matter() -> None:
    data = make_study(1)
    names = data.assign(kind=np.random.default_rng(4).permutation(4)[data["kind"]])
    tables = (data, data.sample(frac=1, random_state=1), names)
    whole, *others = (fit_mixed(WHOLE, table) for table in tables)
    for other in others:
        assert other.criterion == pytest.approx(whole.criterion, abs=1e-7)
        assert other.fixed["df"].tolist() == pytest.approx(whole.fixed["df"].tolist(), rel=1e-4)


def test_units_with_the_same_rows_share_their_equations() -> None:
    data = make_study(1)
    gap = data.drop(index=data.index[data["who"] == 2][0])
    for table, kinds in ((data, 1), (data.sample(frac=1, random_state=1), 1), (gap, 2)):
        profile = Profile(build_design(WHOLE, table), reml=True)
        # A person's level, two slopes, 5 scenes and 4 kinds; everybody's 5 scenes, 20 stimuli and 4 kinds.
        assert (len(profile.counts), profile.own.size, profile.n_random) == (kinds, 12, 29)


def test_no_better_minimum_nearby_in_small_studies_most_of_them_singular() -> None:
    singular = 0
    for seed in range(12):
        profile = Profile(build_design(FULL, make_study(seed, spread=0.3)), reml=True)
        best = find_optimum(profile)
        singular += bool((best.theta == 0).any())
        lowest = profile.deviance(best)
        rng = np.random.default_rng(seed)
        for width in (0.01, 0.1, 1.0):
            others = np.abs(best.theta + rng.normal(0, width, (20, profile.diagonal.size)))
            found = [profile.deviance(profile.evaluate(other)) for other in others]
            assert min(found) > lowest - 1e-7
        free = best.theta > 0
        assert np.abs(profile.find_slope(best)[free]).max() < 1e-3
    assert singular >= 6


def test_balanced_one_way_has_the_textbook_answer() -> None:
    """Method of moments: the spread between groups is (MSB - MSW) / n, and the mean's df is groups - 1."""
    data = make_study(6)
    fit = fit_mixed("y ~ 1 + (1 | who)", data)
    groups = data.groupby("who")["y"]
    within, between = groups.var().mean(), 20 * groups.mean().var()
    assert fit.residual_sd**2 == pytest.approx(within, rel=1e-5)
    assert fit.variances["sd"][0] ** 2 == pytest.approx((between - within) / 20, rel=1e-5)
    assert fit.fixed["df"].iloc[0] == pytest.approx(5, rel=1e-4)
    assert fit.fixed["se"].iloc[0] == pytest.approx(np.sqrt(between / 120), rel=1e-5)
    shrunk = (groups.transform("mean") - data["y"].mean()) * (1 - within / between)
    assert fit.fitted - data["y"].mean() == pytest.approx(shrunk.to_numpy(), rel=1e-4)


def test_fit_hangs_together(fit: MixedFit) -> None:
    data = make_study(1)
    assert fit.fitted + fit.residuals == pytest.approx(data["y"].to_numpy())
    assert fit.n_rows == 120
    assert dict(fit.n_levels) == {"who": 6, "scene": 5, "scene:kind": 20, "who:scene": 30}
    groups = ["who", "who", "who", "scene", "scene:kind", "who:scene"]
    assert fit.variances["group"].tolist() == groups
    assert 0 < fit.marginal_r2 < fit.conditional_r2 < 1


@pytest.mark.parametrize(
    ("formula", "message"),
    [
        ("y a", "formula 'y a' cannot be fitted: write 'response ~ fixed + (effects | group)'"),
        ("y ~ a", "a random term such as (1 | group)"),
        ("y ~ a + 1 | who", "each bar in brackets of its own"),
        ("y ~ a + (1 | who", "each bar in brackets"),
        ('y ~ a * ""b + (1e12 + a || who)  + (\u2028 [[who:kind)', "cannot read"),
        ("y ~ a + (1 | who || kind) + (1 | who)", "each bar in brackets"),
        ("y ~ a + (1 | who) * 2", "each bar in brackets"),
        ("y ~ a + (1 | who):(1 | scene)", "each bar in brackets"),
        ("y ~ a + (1 | who + scene)", "groups such as a, a:b or a/b"),
        ("y ~ a - (1 | who)", "after a plus"),
        ("y ~ a + (1 | who) +", "cannot read 'a"),
        ("y ~ a + offset(b) + (1 | who)", "no . or offset"),
        ("y ~ . + (1 | who)", "no . or offset"),
        ("y ~ a ~ b + (1 | who)", "one ~"),
        ("y ~ a + (0 | who)", "0 + x"),
        ("y ~ 0 + (1 | who)", "a fixed effect"),
        ("y ~ zz + (1 | who)", "no column 'zz'; columns are who, scene, kind, a, b, y"),
        ("y ~ a + (1 | zz)", "no column 'zz'; columns are who, scene, kind, a, b, y"),
        ("y ~ a + (1 | who) + (a | who)", "each effect once per group"),
        ("y ~ a + I(2 * a) + (1 | who)", "'I(2 * a)', which is a sum"),
        ("y ~ a + (1 | who:scene:kind)", "got 120 rows for 120 levels"),
        ("factor(kind) ~ a + (1 | who)", "a response of numbers"),
        ("y ~ a + (0 + I(0 * a) | who)", "data vary in it, got I(0 * a) over who"),
    ],
)
def test_formula_refused(formula: str, message: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the message is compared below
        fit_mixed(formula, make_study(1))
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_a_column_may_be_called_anything() -> None:
    data = make_study(1)
    named = data.rename(columns={"a": "m(x)|z + 1", "who": "a person"})
    found = fit_mixed("y ~ `m(x)|z + 1` + (1 + `m(x)|z + 1` || `a person`)", named)
    plain = fit_mixed("y ~ a + (1 + a || who)", data)
    assert found.fixed["estimate"].tolist() == pytest.approx(plain.fixed["estimate"].tolist())


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"y": 1.0}, "one that is constant"),
        ({"who": "me"}, "levels of who, and more rows"),
        ({"a": np.nan}, "120 rows without 'a'"),
        ({"a": np.inf}, "must be finite, got 120 values"),
        ({"who": None}, "a level of who in every row"),
        ({"a": 2.0}, "'a', which is a sum"),
    ],
)
def test_data_refused(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        fit_mixed("y ~ a + (1 | who)", make_study(1).assign(**change))


@pytest.mark.parametrize("penalty", [(), ("kind",)])
def test_spreads_are_known_as_well_as_the_curvature_of_what_was_minimised_says(
    penalty: tuple[str, ...],
) -> None:
    profile = Profile(build_design(WHOLE, make_study(1)), reml=True, penalty=penalty)
    best = find_optimum(profile)
    free, size = np.flatnonzero(best.theta > 0), len(best.theta)
    start = np.append(best.theta, np.log(profile.find_sigma(best)))

    def find_target(point: np.ndarray) -> float:
        state, log_s = profile.evaluate(point[:-1]), point[-1]
        spreads = np.log(np.abs(point[:-1][profile.penalised]))
        constant = profile.freedom * (np.log(2 * np.pi) + 2 * log_s)
        deviance = state.log_random + state.log_fixed + constant + state.rss / np.exp(2 * log_s)
        return float(deviance - 2 * (spreads + log_s).sum())

    places = [*free, size]
    steps = 1e-3 * np.eye(size + 1)[places]
    signs = [(1, 1), (1, -1), (-1, 1), (-1, -1)]
    hessian = [
        [sum(i * j * find_target(start + i * a + j * b) for i, j in signs) / 4e-6 for a in steps]
        for b in steps
    ]
    unit = np.append(np.maximum(best.theta, 1), 1)[places]
    wanted = 2 * np.linalg.inv(np.array(hessian) * np.outer(unit, unit))
    known = find_uncertainty(profile, best)[1].parameters[np.ix_(places, places)]
    assert known == pytest.approx(wanted, rel=2e-2, abs=1e-4)


def test_penalised_spread_is_never_zero_and_vanishes_in_the_mass() -> None:
    data = make_study(4, spread=0.0)
    held = Profile(build_design(WHOLE, data), reml=True, penalty=("kind",))
    best = find_optimum(held)
    (place,) = np.flatnonzero(held.penalised)
    assert best.theta[place] > 0.02
    # The derivative of deviance - 2 log (theta s) is zero there, s following from rss / (freedom - 1).
    step = np.where(held.penalised, 1e-5, 0)

    def find_target(theta: np.ndarray) -> float:
        state = held.evaluate(theta)
        return held.deviance(state) - 2 * np.log(theta[place] * held.find_sigma(state))

    rise = (find_target(best.theta + step) - find_target(best.theta - step)) / 2e-5
    assert rise == pytest.approx(0, abs=1e-2)
    many = make_study(6, people=5, scenes=3, kinds=40)
    many["y"] += 3 * np.random.default_rng(2).normal(size=40)[many["kind"]]
    plain, pulled = (
        find_optimum(Profile(build_design(WHOLE, many), reml=True, penalty=which)).theta[place]
        for which in ((), ("kind",))
    )
    assert pulled == pytest.approx(plain, rel=0.05)


def test_scales_from_a_millionth_to_a_million_change_nothing() -> None:
    # lme4 itself stops 17 above the minimum on such columns, and calls it singular.
    data = make_study(7)
    hard = data.assign(a=data["a"] * 1e-6 + 3e-6, b=data["b"] * 1e6 + 5e6, y=data["y"] * 1e4)
    moved = data.assign(a=data["a"] + 3, b=data["b"] + 5)
    for formula in (FULL, *(f"y ~ a + b + ({one} | who) + (1 | scene)" for one in "ab")):
        plain, scaled = fit_mixed(formula, moved), fit_mixed(formula, hard)
        for column in ("t", "df"):
            got, wanted = scaled.fixed[column].tolist(), plain.fixed[column].tolist()
            assert got == pytest.approx(wanted, rel=2e-3)
        assert scaled.singular is plain.singular
