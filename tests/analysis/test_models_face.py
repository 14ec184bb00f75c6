"""Models as a scientist meets them: short in a notebook, whole in a frame, the same again in R and from a pickle."""

import json
import pickle

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis import space
from feel321.records import Result

METRICS = ["sm", "tm"]


@pytest.fixture(scope="module")
def rows() -> pd.DataFrame:
    rng = np.random.default_rng(2)
    who, item = (part.ravel() for part in np.meshgrid(range(6), range(24), indexing="ij"))
    sm, tm = rng.uniform(0, 1, (2, 24))
    rating = 30 + 40 * sm[item] + rng.normal(0, 5, 6)[who] + rng.normal(0, 8, len(who))
    return pd.DataFrame({
        "participant": who, "recording": item // 4, "reducer": np.array(list("wxyz"))[item % 4], "item": item,
        "sm": sm[item], "tm": tm[item], "rating": rating.clip(0, 100), "scale": "realism", "role": "test",
    })  # fmt: skip


@pytest.fixture(scope="module")
def both(rows: pd.DataFrame) -> pd.DataFrame:
    other = rows.assign(scale="similarity", rating=100 - rows["rating"])
    return pd.concat([rows, other], ignore_index=True)


@pytest.fixture(scope="module")
def results(rows: pd.DataFrame, both: pd.DataFrame) -> dict[str, Result]:
    fit = analysis.fit_mixed("rating ~ sm + reducer + (1 | participant)", rows)
    uneven = np.random.default_rng(3).uniform(1, 9, (3, 5, 5))
    maps = (uneven + uneven.transpose(0, 2, 1)) * (1 - np.eye(5))
    return {
        "primary": analysis.fit_primary(rows, METRICS),
        "primaries": analysis.fit_attributes(both, METRICS),
        "fit": fit,
        "contrast": analysis.contrast(fit, {"reducerx": 1, "reducery": -1}),
        "screening": analysis.screen_raters(rows, rng=1),
        "association": analysis.correlate(rows, "sm", draws=20),
        "difference": analysis.compare_metrics(rows, *METRICS, draws=20),
        "reducers": analysis.compare_reducers(rows, "x", "y", margin=5),
        "repeated": analysis.repeated_measures_correlation(rows, "sm"),
        "dependent": analysis.compare_dependent(1.0, 0.2, 0.2, 20),
        "intraclass": analysis.intraclass(rows),
        "p1401": analysis.p1401(rows, "sm"),
        "equivalence": analysis.equivalence(1, 1, 9, low=-3, high=3),
        "discrimination": analysis.discriminate(24, 24),
        "bradley_terry": analysis.bradley_terry(
            pd.DataFrame({"winner": list("aabbcc"), "loser": list("bcacab")})
        ),
        "space": space.fit_space(maps, draws=3),
        "alignment": space.align_spaces(maps[0], maps[1], permutations=9),
    }


NAMES = [
    "primary", "primaries", "fit", "contrast", "screening", "association", "difference",
    "reducers", "repeated", "dependent", "intraclass", "p1401", "equivalence",
    "discrimination", "bradley_terry", "space", "alignment",
]  # fmt: skip


@pytest.mark.parametrize("name", NAMES)
def test_results_are_short_whole_and_keep(results: dict[str, Result], name: str) -> None:
    result = results[name]
    assert len(repr(result)) <= 200
    assert "\n" not in repr(result)
    assert len(result.to_frame()) >= 1
    assert result.summary()
    again = pickle.loads(pickle.dumps(result))  # noqa: S301 - what was written just now
    assert again == result
    assert hash(again) == hash(result)
    assert json.loads(json.dumps(result.to_dict(), allow_nan=False)) == result.to_dict()


def test_every_scale_at_every_level(both: pd.DataFrame) -> None:
    found = analysis.fit_attributes(both, METRICS)
    assert list(found) == ["realism", "similarity"]
    frame = found.to_frame()
    assert (frame["p_holm"].notna() == frame["estimable"]).all()
    assert frame["estimable"].any()
    levels = pd.concat([both.assign(level=name) for name in ("as_is", "equal_intensity")])
    assert list(analysis.fit_attributes(levels, METRICS)) == [
        "realism, as_is",
        "realism, equal_intensity",
        "similarity, as_is",
        "similarity, equal_intensity",
    ]


def test_contrasts_name_terms_of_the_model(rows: pd.DataFrame) -> None:
    fit = analysis.fit_mixed("rating ~ sm + tm + (1 | participant)", rows)
    with pytest.raises(ValueError, match=r"of the model .*got .*zm"):
        analysis.contrast(fit, {"sm": 1, "zm": -1})
    with pytest.raises(TypeError, match="weights must be a mapping of terms to numbers, got"):
        analysis.contrast(fit, "sm - tm")  # type: ignore[arg-type]
