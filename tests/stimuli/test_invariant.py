import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.stimuli.match import WeberSmoothing, energy_spectrum, linear_grid
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import (
    INVARIANTS,
    random_rotations,
    spectral_match_energy_weighted,
    temporal_match_invariant,
)

RATE = 4000.0
SEEDS = st.integers(0, 2**32 - 1)


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def uneven(n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.standard_normal((3, 3)) @ (
        rng.standard_normal((3, n)) * rng.uniform(0.01, 3, (3, 1))
    )


def smoothed(acceleration: np.ndarray, reduced: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    n = reduced.size
    smooth = WeberSmoothing(linear_grid(n, RATE), RATE / n, n // 2 + 1)
    return smooth(energy_spectrum(acceleration, smooth.bins).sum(axis=0)), smooth(
        energy_spectrum(reduced, smooth.bins)
    )


@pytest.mark.parametrize("counterpart", INVARIANTS.values(), ids=list(INVARIANTS))
@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, n=st.integers(1, 600))
def test_turning_or_mirroring_the_sensor_changes_nothing(
    counterpart: object, seed: int, n: int
) -> None:
    acceleration, reduced = uneven(n, seed), noise(n, seed=seed)
    (turn,) = random_rotations(1, np.random.default_rng(seed))
    once = counterpart(acceleration, reduced, RATE)
    for way in (turn, -turn, np.diag([1, -1, 1]), np.eye(3)[[2, 0, 1]]):
        assert counterpart(way @ acceleration, reduced, RATE) == pytest.approx(
            once, abs=1e-9, nan_ok=True
        )


# --- temporal --------------------------------------------------------------------------------------------------------


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, n=st.integers(3, 300))
def test_the_leading_axis_reaches_the_upper_bound_and_nothing_passes_it(seed: int, n: int) -> None:
    acceleration = uneven(n, seed)
    values, axes = np.linalg.eigh(acceleration @ acceleration.T)
    bound = np.sqrt(values[-1] / values.sum())
    assert temporal_match_invariant(acceleration, axes[:, -1] @ acceleration) == pytest.approx(
        bound, abs=1e-9
    )
    for reducer in REDUCERS.values():
        assert temporal_match_invariant(acceleration, reducer(acceleration, RATE)) <= bound + 1e-9


# --- spectral --------------------------------------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, n=st.integers(400, 900), name=st.sampled_from(list(REDUCERS)))
def test_it_is_the_ratio_of_minima_to_maxima_and_obeys_its_bounds(
    seed: int, n: int, name: str
) -> None:
    acceleration = uneven(n, seed)
    reduced = REDUCERS[name](acceleration, RATE)
    own = spectral_match_energy_weighted(acceleration, reduced, RATE)
    there, kept = smoothed(acceleration, reduced)
    assert own == pytest.approx(
        np.minimum(there, kept).sum() / np.maximum(there, kept).sum(), abs=1e-9
    )
    assert own >= 1 - np.abs(there - kept).sum() / there.sum() - 1e-9
    assert own >= 1 - (np.abs(there - kept) / there).max() - 1e-9
    assert own <= min(there.sum(), kept.sum()) / max(there.sum(), kept.sum()) + 1e-9
