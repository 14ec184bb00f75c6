"""Positions from triplets: a planted map is recovered, the gradient is right, and one reference is no map."""

from __future__ import annotations

from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import check_grad
from scipy.spatial import procrustes

from feel321 import analysis
from feel321.analysis.choices.embed import _weigh


def ask(
    positions: np.ndarray, *, n: int, seed: int = 0, references: int | None = None
) -> pd.DataFrame:
    """Triplets that follow stochastic triplet embedding."""
    rng = np.random.default_rng(seed)
    heads = range(len(positions))[:references]
    every = np.array([
        (head, *pair) for head in heads for pair in combinations(set(range(len(positions))) - {head}, 2)
    ])  # fmt: skip
    asked = every[rng.integers(len(every), size=n)]
    head, one, other = (positions[column] for column in asked.T)
    odds = ((head - other) ** 2 - (head - one) ** 2).sum(axis=1)
    other_wins = rng.random(n) > 1 / (1 + np.exp(-odds))
    asked[other_wins] = asked[other_wins][:, [0, 2, 1]]
    names = np.array([f"s{number:02}" for number in range(len(positions))])
    return pd.DataFrame(names[asked], columns=["reference", "chosen", "other"])


def draw_map(n_items: int, dimensions: int, seed: int = 3) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(n_items, dimensions))


@pytest.mark.parametrize("dimensions", [1, 2, 3])
def test_a_planted_map_is_recovered(dimensions: int) -> None:
    truth = draw_map(10, dimensions)
    found = analysis.embed_triplets(ask(truth, n=4000), dimensions=dimensions)
    assert found.names == tuple(f"s{number:02}" for number in range(10))
    disparity = procrustes(
        np.pad(truth, ((0, 0), (0, 1))), np.pad(found.positions, ((0, 0), (0, 1)))
    )[2]
    assert disparity < 0.02
    # One unit of squared distance is one unit of log odds: the size is recovered too.
    size = np.square(found.positions).sum() / np.square(truth - truth.mean(axis=0)).sum()
    assert 0.8 < size < 1.25
    assert found.held_out == pytest.approx(found.agreement, abs=0.03)


def test_a_dimension_that_is_missing_is_seen_in_what_was_held_out() -> None:
    triplets = ask(draw_map(8, 2), n=2000)
    flat, plane = (analysis.embed_triplets(triplets, dimensions=n) for n in (1, 2))
    assert plane.held_out > flat.held_out + 0.03
    assert plane.log_likelihood > flat.log_likelihood


def test_the_gradient_is_that_of_the_likelihood() -> None:
    rng = np.random.default_rng(2)
    codes = np.array([rng.choice(5, 3, replace=False) for _ in range(40)])
    for _ in range(5):
        start = rng.normal(size=10)
        error = check_grad(
            lambda x: _weigh(x, codes, (5, 2))[0], lambda x: _weigh(x, codes, (5, 2))[1], start
        )
        assert error < 1e-4


def test_positions_are_centred_on_their_principal_axes() -> None:
    found = analysis.embed_triplets(ask(draw_map(8, 2), n=1000))
    places = found.positions
    assert np.abs(places.mean(axis=0)).max() < 1e-9
    square = places.T @ places
    assert abs(square[0, 1]) < 1e-9 * square[0, 0]
    assert square[0, 0] >= square[1, 1]
    assert found.to_frame().columns.tolist() == ["stimulus", "axis_1", "axis_2"]


def test_the_same_seed_gives_the_same_map() -> None:
    triplets = ask(draw_map(6, 2), n=300)
    one, other = (analysis.embed_triplets(triplets, rng=5) for _ in range(2))
    assert (one.positions == other.positions).all()


def test_one_reference_gives_distances_and_says_so() -> None:
    truth = draw_map(7, 2)
    found = analysis.embed_triplets(ask(truth, n=1500, references=1))
    assert found.n_references == 1
    assert "a map of the others is not" in found.notes[0]
    known, wanted = (np.linalg.norm(x - x[0], axis=1)[1:] for x in (found.positions, truth))
    assert np.corrcoef(known, wanted)[0, 1] > 0.95


@pytest.mark.parametrize(
    ("rows", "options", "message"),
    [
        ([("a", "b", "b")], {}, "three different stimuli, got 1 rows with one twice"),
        ([("a", "b", None)], {}, "name three stimuli in every row"),
        ([], {}, "name three stimuli in every row"),
        ([("a", "b", "c")], {"dimensions": 3}, "dimensions must be from 1 to 2"),
    ],
)
def test_what_is_no_triplet_is_refused(
    rows: list[Any], options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        analysis.embed_triplets(
            pd.DataFrame(rows, columns=["reference", "chosen", "other"]), **options
        )
    with pytest.raises(ValueError, match="column other is missing"):
        analysis.embed_triplets(pd.DataFrame([("a", "b")], columns=["reference", "chosen"]))
