"""Tables from memory: the index means nothing, and what is not about one thing is not pooled."""

import inspect
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas as pd
import pytest

from feel321 import analysis
from feel321.analysis.contrasts import compare
from feel321.analysis.table.items import find_sources, open_ratings
from feel321.records import Statistic

METRICS = ["spectral_match", "temporal_match"]


def make_rng() -> np.random.Generator:
    return np.random.default_rng(5)


def make_trials(table: pd.DataFrame) -> pd.DataFrame:
    """Make pairs of reducers of which the one rated higher won, with the index of the table."""
    first, second = table["reducer"], np.roll(table["reducer"].to_numpy(), 1)
    won = table["rating"].to_numpy() >= np.roll(table["rating"].to_numpy(), 1)
    pairs = table[["participant"]].assign(
        first=first, second=second, correct=won, winner=np.where(won, first, second)
    )
    return pairs[(pairs["first"] != pairs["second"]).to_numpy()]


CALLS: dict[str, Callable[[pd.DataFrame], Any]] = {
    "bradley_terry": lambda table: analysis.bradley_terry(make_trials(table)[["first", "second", "winner"]]),
    "bradley_terry by rater": lambda table: analysis.bradley_terry(
        make_trials(table)[["participant", "first", "second", "winner"]], by_rater=True, draws=10
    ),
    "compare_metrics": lambda table: analysis.compare_metrics(table, *METRICS, draws=10, rng=make_rng()),
    "correlate": lambda table: analysis.correlate(table, METRICS[0], draws=10, rng=make_rng()),
    "compare_reducers": lambda table: analysis.compare_reducers(table, "dft321", "mag321", margin=5),
    "discriminate": lambda table: analysis.discriminate(
        table.assign(scale="abx", rating=100.0 * (table["rating"] > 50))
    ),
    "find_sources": lambda table: find_sources(table).to_frame(),
    "fit_attributes": lambda table: analysis.fit_attributes(table, METRICS)["realism"].slopes,
    "fit_mixed": lambda table: (analysis.fit_mixed("rating ~ spectral_match + (1 | participant)", table).fixed),
    "fit_primary": lambda table: analysis.fit_primary(table, METRICS).slopes,
    "profile_reducers": compare.profile_reducers,
    "rater_model": analysis.rater_model,
    "screen_raters": lambda table: analysis.screen_raters(table).table,
}  # fmt: skip

POOLED = ["compare_metrics", "compare_reducers", "correlate", "fit_primary"]
"""What is about one scale and one level."""

INDICES: dict[str, Callable[[pd.DataFrame], pd.DataFrame]] = {
    "put together": lambda table: table.set_axis(np.arange(len(table)) % 7),
    "out of order": lambda table: table.set_axis(np.random.default_rng(1).permutation(len(table))),
    "named as a column": lambda table: table.set_index("participant", drop=False),
}

OTHERS = {"bradley_terry by rater", "find_sources", "profile_reducers"}
"""Further forms, and functions that are not on the face."""

ELSEWHERE = {"advise_tradeoff", "read_table", "write_report"}
"""What is tried with ratings in `test_{people,table,notebook}`."""

PAIRS = {"bradley_terry by rater", "bradley_terry"}
"""What takes pairs, here made of neighbouring rows."""


@pytest.fixture
def rated(tidy: Callable[..., pd.DataFrame]) -> pd.DataFrame:
    table = tidy(participants=3, recordings=5, repeats=1)
    # As the manifest of a lab may have it; what is no test is left out.
    fill = table["role"] != "test"
    return table.assign(**{name: table[name].mask(fill, 0.5) for name in METRICS})


def flatten(result: Any) -> dict[str, Any]:
    """Take a result apart into numbers and words that can be compared."""
    if isinstance(result, pd.DataFrame):
        return {
            f"{name}.{row}": one
            for name, own in result.reset_index().items()
            for row, one in own.items()
        }
    if isinstance(result, list):
        return {
            f"{place}.{name}": value
            for place, one in enumerate(result)
            for name, value in flatten(one).items()
        }
    if not isinstance(result, Statistic):
        return {"": result}
    found = list(result.items())
    return {f"{name}.{key}": one for name, value in found for key, one in flatten(value).items()}


def check_equal(one: Any, other: Any) -> None:
    left, right = flatten(one), flatten(other)
    assert list(left) == list(right)
    for name, value in left.items():
        near = (
            pytest.approx(value, rel=1e-6, abs=1e-9, nan_ok=True)
            if isinstance(value, float)
            else value
        )
        assert right[name] == near, name


def test_every_public_function_of_a_table_is_tried() -> None:
    functions = {name: getattr(analysis, name) for name in analysis.__all__}
    takes = {
        name
        for name, function in functions.items()
        if inspect.isfunction(function)
        and any(
            re.search(r"\bDataFrame\b", str(text)) and "plot" not in name and name not in ELSEWHERE
            for place, text in function.__annotations__.items()
            if place != "return"
        )
    }
    assert takes == set(CALLS) - OTHERS


@pytest.mark.parametrize("name", CALLS)
def test_index_and_order_of_a_table_mean_nothing(name: str, rated: pd.DataFrame) -> None:
    plain = CALLS[name](rated)
    for how, change in INDICES.items():
        # Rows may come in any order, too, but where neighbours are made pairs.
        is_free = how == "out of order" and name not in PAIRS
        rows = rated.sample(frac=1, random_state=3) if is_free else change(rated)
        check_equal(CALLS[name](rows), plain)


@pytest.mark.parametrize("name", POOLED)
def test_levels_are_not_pooled(name: str, tidy: Callable[..., pd.DataFrame]) -> None:
    both = tidy(participants=2, recordings=4, levels=("as_is", "equal_intensity"), anchors=False)
    told = "must be of one level, got the levels as_is, equal_intensity"
    with pytest.raises(ValueError, match=told):
        CALLS[name](both)


@pytest.mark.parametrize("name", POOLED)
def test_scales_are_not_pooled(name: str, tidy: Callable[..., pd.DataFrame]) -> None:
    both = tidy(participants=2, recordings=4, scales=("realism", "similarity"), anchors=False)
    with pytest.raises(
        ValueError, match="must be of one scale, got the scales realism, similarity"
    ):
        CALLS[name](both)


def test_no_table_and_doubled_columns_are_refused(rated: pd.DataFrame) -> None:
    no_table: Any = {"rating": [1.0]}
    with pytest.raises(
        TypeError, match="ratings must be a Table or a DataFrame, one row per judgement, got dict"
    ):
        open_ratings(no_table)
    with pytest.raises(
        ValueError, match="ratings must have one column of each name, got two columns 'rating'"
    ):
        analysis.fit_primary(pd.concat([rated, rated[["rating"]]], axis=1), METRICS)
