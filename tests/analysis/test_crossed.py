"""Mixed models in the notations and on the data that people bring: 91 fits against lme4, 44 of them singular.

crossed/expected.json names the R call. Simulated studies s2 to s4 (crossed, s3 with gaps and repeats, s2 and s4 mostly
singular), pupils in classes in schools, five groups of 1 to 10 rows, effects correlated by .999, a spread near zero.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321.analysis.mixed import optimum
from feel321.analysis.mixed.model import fit_mixed

HERE = Path(__file__).parent
FITS = json.loads((HERE / "crossed" / "expected.json").read_text(encoding="utf-8"))["fits"]
FULL = "y ~ a + b + (1 + a + b || who) + (1 | scene) + (1 | scene:kind) + (1 | who:scene)"


def make_study(seed: int) -> pd.DataFrame:
    """Six people, five scenes, four kinds."""
    rng = np.random.default_rng(seed)
    places = pd.MultiIndex.from_product(
        [range(6), range(5), range(4)], names=["who", "scene", "kind"]
    )
    table = places.to_frame(index=False)
    item = table["scene"] * 4 + table["kind"]
    table["a"], table["b"] = rng.normal(size=(2, 20))[:, item]
    table["y"] = 50 + 3 * table["a"] + rng.normal(0, 5, len(table)) + 2 * rng.normal(size=20)[item]
    for index, sd in (
        (table["who"], 6),
        (table["scene"], 3),
        (table["who"] * 5 + table["scene"], 1),
    ):
        table["y"] += sd * rng.normal(size=index.max() + 1)[index]
    table["y"] += rng.normal(size=6)[table["who"]] * table["a"]
    return table


@pytest.mark.parametrize(
    "expected", FITS, ids=lambda fit: f"{fit['data']}: {fit['formula']} {fit['reml']}"
)
def test_against_lme4(expected: dict[str, Any]) -> None:
    data = pd.read_csv(HERE / "crossed" / f"{expected['data']}.csv")
    fit = fit_mixed(expected["formula"], data, reml=expected["reml"])
    assert fit.fixed.index.tolist() == expected["terms"]
    assert fit.criterion == pytest.approx(expected["criterion"], abs=1e-5)
    errors = (fit.fixed["estimate"] - expected["estimate"]) / fit.fixed["se"]
    assert errors.abs().max() < 1e-4
    assert fit.fixed["se"].tolist() == pytest.approx(expected["se"], rel=5e-4)
    assert fit.fixed["df"].tolist() == pytest.approx(expected["df"], rel=2e-3)
    assert fit.fixed["p"].tolist() == pytest.approx(expected["p"], rel=5e-3, abs=1e-12)
    assert fit.residual_sd == pytest.approx(expected["residual_sd"], rel=1e-4)
    assert fit.singular is expected["singular"]
    got = fit.variances.set_index(["group", "term"])["sd"].to_dict()
    assert set(got) == {(group, term) for group, term, _ in expected["spreads"]}
    # What its intercept takes, its levels lack: only the sum is known.
    if "(f||p)" in expected["formula"]:
        return
    for group, term, sd in expected["spreads"]:
        assert got[group, term] == pytest.approx(sd, rel=2e-3, abs=2e-3 * fit.residual_sd)


def test_scales_from_a_millionth_to_a_million_change_nothing() -> None:
    # lme4 itself stops 17 above the minimum on such columns, and calls it singular.
    data = make_study(7)
    hard = data.assign(a=data["a"] * 1e-6 + 3e-6, b=data["b"] * 1e6 + 5e6, y=data["y"] * 1e4)
    moved = data.assign(a=data["a"] + 3, b=data["b"] + 5)
    for formula in (
        FULL,
        "y ~ a + b + (a | who) + (1 | scene)",
        "y ~ a + b + (b | who) + (1 | scene)",
    ):
        plain, scaled = fit_mixed(formula, moved), fit_mixed(formula, hard)
        for column in ("t", "df"):
            assert scaled.fixed[column].tolist() == pytest.approx(
                plain.fixed[column].tolist(), rel=2e-3
            )
        assert scaled.singular is plain.singular


@pytest.mark.parametrize("ratio", [10, 1e3, 1e4])
def test_large_spreads_keep_their_degrees_of_freedom(ratio: float) -> None:
    rng = np.random.default_rng(3)
    level, data = (
        rng.normal(size=10),
        pd.DataFrame({"who": np.repeat(range(10), 5), "x": np.tile(np.arange(5.0), 10)}),
    )
    data["y"] = ratio * level[data["who"]] + data["x"] + rng.normal(0, 1, 50)
    df = fit_mixed("y ~ x + (1 | who)", data).fixed["df"]
    # Balanced: people less one, and rows less people and the slope.
    assert df.tolist() == pytest.approx([9, 39], rel=0.01)


def test_any_index_and_any_name_in_quotes() -> None:
    data = make_study(5)
    plain = fit_mixed("y ~ a + (a | who)", data)
    moved = data.set_index(["who", "scene"], drop=False).rename(columns={"a": "a - b", "who": "w+"})
    quoted = fit_mixed("y ~ `a - b` + (`a - b` | `w+`)", moved)
    assert quoted.criterion == plain.criterion
    assert quoted.fixed.index.tolist() == ["(Intercept)", "a - b"]


def test_what_is_no_table_with_names_is_refused() -> None:
    data = make_study(5)
    with pytest.raises(TypeError, match="data must be a pandas DataFrame"):
        fit_mixed("y ~ a + (1 | who)", {"y": [1.0], "a": [1.0], "who": [1]})
    with pytest.raises(ValueError, match="each column once, got 'a' twice"):
        fit_mixed("y ~ a + (1 | who)", pd.concat([data, data[["a"]]], axis=1))


def test_a_double_bar_keeps_the_levels_of_a_category_together() -> None:
    data = make_study(4)
    data["kind"] = "k" + data["kind"].astype(str)
    fit = fit_mixed("y ~ kind + (kind || who)", data)
    assert fit.variances["term"].tolist() == ["(Intercept)", "kindk0", "kindk1", "kindk2", "kindk3"]
    assert len(fit.correlations) == 6
    with pytest.raises(ValueError, match="cannot read 'a b'"):
        fit_mixed("y ~ a + (a b || who)", data)


def test_names_are_those_of_r_whatever_pandas_keeps_the_columns_in() -> None:
    data = make_study(4)
    data["flag"], data["number"] = data["kind"] > 1, data["a"].astype(object)
    data["word"] = ("w" + (data["kind"] % 2).astype(str)).astype("string")
    fit = fit_mixed(
        "y ~ flag + word + number + as.factor(scene) + factor(scene):b + (flag | (who))", data
    )
    terms = [
        "(Intercept)",
        "flagTRUE",
        "wordw1",
        *(f"as.factor(scene){scene}" for scene in range(1, 5)),
        "number",
    ]
    assert sorted(fit.fixed.index) == sorted([
        *terms,
        *(f"factor(scene){scene}:b" for scene in range(5)),
    ])
    assert fit.variances["term"].tolist() == ["(Intercept)", "flagTRUE"]
    assert fit.n_levels == {"who": 6}


def test_double_bar_slash_and_backticks_are_short_for_what_they_say() -> None:
    data = make_study(8).rename(columns={"a": "my a"})
    short = fit_mixed("y ~ `my a` + (`my a` || who) + (1 | scene/kind)", data)
    long = fit_mixed(
        "y ~ `my a` + (1 | who) + (0 + `my a` | who) + (1 | scene) + (1 | scene:kind)", data
    )
    assert short.criterion == pytest.approx(long.criterion)
    assert short.variances["group"].tolist() == ["who", "who", "scene", "kind:scene"]
    assert short.variances["sd"].tolist() == pytest.approx(long.variances["sd"].tolist())


def test_equations_beyond_memory_are_refused_in_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(optimum, "MOST_LEVELS", 10)
    message = "at most 10 effects beside those of scene:kind, for memory, got 16; average"
    with pytest.raises(ValueError, match=message):
        fit_mixed("y ~ a + (1 + a || who) + (1 | scene:kind) + (1 | kind)", make_study(1))
