"""Claims of papers: verdicts follow from intervals, every registered measure is there, exceptions are left out."""

import math
from dataclasses import replace

import pytest

from feel321.analysis import replication
from feel321.analysis.replication import ClaimValue, PaperClaim, describe_nearest, judge
from feel321.names import MEASURES

CLAIM = PaperClaim("one", "It is so", "ours", "slope")
NEAR = replace(CLAIM, expect="near", paper=(0.5, 0.4, 0.6))


def test_every_registered_measure_is_a_function() -> None:
    assert all(callable(getattr(replication, function)) for function in MEASURES.values())


@pytest.mark.parametrize(
    ("claim", "ends", "verdict"),
    [
        (CLAIM, (1, 0.5, 1.5), "agrees"),
        (CLAIM, (1, -0.5, 1.5), "open"),
        (CLAIM, (-1, -1.5, -0.5), "differs"),
        (CLAIM, (math.nan, math.nan, math.nan), "not_estimable"),
        (replace(CLAIM, expect="negative"), (-1, -1.5, -0.5), "agrees"),
        (replace(CLAIM, expect="negative"), (1, 0.5, 1.5), "differs"),
        (NEAR, (0.45, 0.1, 0.9), "agrees"),
        (NEAR, (0.8, 0.5, 1.1), "open"),
        (NEAR, (0.8, 0.7, 0.9), "differs"),
        (NEAR, (0.8, math.nan, math.nan), "differs"),
    ],
)
def test_a_verdict_follows_from_the_interval(
    claim: PaperClaim, ends: tuple[float, float, float], verdict: str
) -> None:
    assert judge(claim, ClaimValue(*ends)) == verdict


@pytest.mark.parametrize(
    ("gaps", "verdict"),
    [
        ({"b": (1, 0.5, 1.5), "c": (2, 1, 3)}, "agrees"),
        ({"b": (1, -0.5, 1.5), "c": (2, 1, 3)}, "open"),
        ({"b": (-1, -1.5, -0.5), "c": (2, 1, 3)}, "differs"),
        ({"b": (0.004, math.nan, math.nan), "c": (2, 1, 3)}, "open"),
        ({"b": (0.006, math.nan, math.nan), "c": (2, 1, 3)}, "agrees"),
        ({}, "not_estimable"),
    ],
)
def test_the_highest_is_above_all_others_and_the_lowest_below(
    gaps: dict[str, tuple[float, float, float]], verdict: str
) -> None:
    found = ClaimValue(5, 4, 6, beside=gaps)
    assert judge(replace(CLAIM, expect="highest"), found) == verdict
    turned = {name: (-value, -high, -low) for name, (value, low, high) in gaps.items()}
    assert judge(replace(CLAIM, expect="lowest"), replace(found, beside=turned)) == verdict


@pytest.mark.parametrize(
    ("gap", "told"),
    [
        ((0.31, 0.28, 0.35), "0.31 higher than that of b (0.28 to 0.35)"),
        ((-0.31, -0.35, -0.28), "0.31 lower than that of b (0.28 to 0.35)"),
        ((-0.001, math.nan, math.nan), "the same as that of b"),
    ],
)
def test_the_nearest_of_the_others_is_named_with_the_way_the_difference_goes(
    gap: tuple[float, float, float], told: str
) -> None:
    assert describe_nearest({"c": (2, 1, 3), "b": gap}, upward=True, kind="correlation") == told
