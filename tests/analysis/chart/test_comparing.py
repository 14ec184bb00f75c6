from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.analysis.contrasts.compare import profile_reducers
from feel321.analysis.tradeoff.chart.compute import draw_interval, rate_reducers
from feel321.analysis.tradeoff.chart.points import (
    MEASURES,
    is_clear,
    list_dominated,
    make_table,
    mark_front,
    place_points,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    import pandas as pd


def make_point(
    name: str,
    mean: float,
    cost: float,
    *,
    latency_s: float | None = 0.0,
    measure: str = "spectral_match",
    se: float = 0.001,
    spread: float = 0.1,
) -> dict[str, Any]:
    values = {"median": mean, "mean": mean, "lowest": mean, "highest": mean, "se": se}
    low, high = cost * (1 - spread), cost * (1 + spread)
    costs = {"ns_per_sample": cost, "low": low, "high": high, "latency_s": latency_s}
    return {"method": name, "reducer": name, "measure": measure, **values, **costs}


def make_accuracy(name: str, scene: str, measure: str, mean: float) -> dict[str, Any]:
    told = {"sweep": "reducer", "method": name, "reducer": name, "scene": scene, "measure": measure}
    return {**told, "rate_hz": 1e3, "as_mounted": mean, "mean": mean, "sd": 0.1, "rotations": 10}


def make_both(
    name: str, spectral: float, temporal: float, cost: float, **other: float | None
) -> list[dict[str, Any]]:
    metrics = ("spectral_match", spectral), ("temporal_match", temporal)
    return [make_point(name, mean, cost, measure=measure, **other) for measure, mean in metrics]


def test_one_scene_with_an_empty_band_does_not_decide() -> None:
    rows = [
        make_accuracy("dft321", f"scene {number}", measure, mean)
        for measure in MEASURES
        for number, mean in enumerate((0.9, 0.8, -300.0))
    ]
    cost = {"reducer": "dft321", "ns_per_sample": 1.0, "low": 0.9, "high": 1.1}
    accuracies, costs = make_table("accuracies", rows), make_table("costs", [cost])
    point = place_points(accuracies, costs, {"dft321": None}).iloc[0]
    assert (point["median"], point["lowest"], point["highest"]) == (0.8, -300.0, 0.9)
    assert point["mean"] == pytest.approx(-99.4333, abs=1e-3)
    assert point["se"] == pytest.approx(0.1 / np.sqrt(10))


def test_the_front_holds_what_nobody_clearly_beats() -> None:
    points = [
        make_point("cheap", 0.3, 1),
        make_point("same", 0.2999, 1.05),
        make_point("bad", 0.2, 5),
        make_point("good", 0.9, 10),
    ]
    assert [point["reducer"] for point in mark_front(points) if point["on_front"]] == [
        "cheap",
        "same",
        "good",
    ]


@pytest.mark.parametrize(
    ("winner", "expected"),
    [
        (make_point("x", 0.5, 1.0), False),
        (make_point("x", 0.5, 0.5), True),
        (make_point("x", 0.51, 1.0), True),
        (make_point("x", 0.5, 1.0, latency_s=0.0), False),
    ],
)
def test_an_advantage_is_clear_beyond_quartiles_or_two_standard_errors(
    winner: dict[str, Any], expected: bool
) -> None:
    assert is_clear([make_point("y", 0.5, 1.0)], [winner]) is expected


def test_no_latency_is_clearly_better_than_the_whole_signal() -> None:
    assert is_clear([make_point("y", 0.5, 1.0, latency_s=None)], [make_point("x", 0.5, 1.0)])


def test_the_dominated_are_named_with_their_scenes() -> None:
    points = [
        *make_both("poor", 0.4, 0.4, 10),
        *make_both("rich", 0.5, 0.5, 5),
        *make_both("late", 0.6, 0.6, 1, latency_s=None),
    ]
    means = {
        "poor": ((0.3, 0.4), (0.5, 0.4)),
        "rich": ((0.6, 0.6), (0.4, 0.4)),
        "late": ((0.6, 0.6), (0.6, 0.6)),
    }
    accuracies = [
        make_accuracy(name, f"scene {number}", measure, mean)
        for name, scenes in means.items()
        for number, both in enumerate(scenes)
        for measure, mean in zip(("spectral_match", "temporal_match"), both, strict=True)
    ]
    found = list_dominated(make_table("points", points), make_table("accuracies", accuracies))
    assert found.to_numpy().tolist() == [["poor", "rich", True, 1, 2]]


def test_ratings_are_those_of_the_profile_with_a_wider_interval_beside(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    ratings = tidy(seed=4, participants=10, recordings=5)
    found = {row["reducer"]: row for row in rate_reducers(ratings, seed=0, draws=500)}
    profile = profile_reducers(ratings)
    tests = profile[profile["role"] == "test"].set_index("reducer")
    assert set(found) == set(tests.index)
    for name, row in found.items():
        assert row["mean"] == pytest.approx(tests.loc[name, "mean"])
        assert (row["low"], row["high"]) == pytest.approx((
            tests.loc[name, "low"],
            tests.loc[name, "high"],
        ))
        assert row["two_way_low"] < row["mean"] < row["two_way_high"]
        assert (row["participants"], row["recordings"]) == (10, 5)
    assert rate_reducers(ratings, seed=0, draws=500) == list(found.values())


def test_one_participant_has_no_interval_over_participants(
    tidy: Callable[..., pd.DataFrame],
) -> None:
    rows = rate_reducers(tidy(participants=1), seed=0, draws=50)
    assert np.isnan([row["low"] for row in rows]).all()


def test_drawing_everything_once_gives_the_mean_of_participants_means() -> None:
    table = np.array([[10.0, 20.0, np.nan], [40.0, np.nan, np.nan], [np.nan, np.nan, np.nan]])
    low, high = draw_interval(table, np.ones((4, 3)), np.ones((4, 3)))
    assert low == high == pytest.approx((15 + 40) / 2)


def test_a_draw_without_any_rating_is_left_out() -> None:
    table = np.array([[10.0, np.nan]])
    people, scenes = np.ones((3, 1)), np.array([[2.0, 0.0], [0.0, 2.0], [1.0, 1.0]])
    assert draw_interval(table, people, scenes) == (10.0, 10.0)
