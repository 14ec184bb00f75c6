from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.names import MATCHES
from feel321.stimuli.match import (
    WeberSmoothing,
    energy_spectrum,
    linear_grid,
    spectral_match,
    temporal_match,
    temporal_match_details,
)
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


def test_every_metric_has_a_counterpart_of_its_name() -> None:
    # Invariant itself.
    assert list(INVARIANTS) == [name for name in MATCHES if name != "spectral_match_bounded"]
    for counterpart in INVARIANTS.values():
        assert isinstance(counterpart(noise(3, 400), noise(400), RATE), float)


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


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, n=st.integers(2, 300))
def test_bounds_between_the_papers_temporal_match_and_its_counterpart(seed: int, n: int) -> None:
    acceleration, reduced = uneven(n, seed), noise(n, seed=seed)
    paper, own = (
        temporal_match(acceleration, reduced),
        temporal_match_invariant(acceleration, reduced),
    )
    correlations = np.array(temporal_match_details(acceleration, reduced).correlations)
    shares = (acceleration**2).sum(axis=1) / (acceleration**2).sum()
    assert own == pytest.approx(np.sqrt(shares @ correlations**2), rel=1e-9)
    assert correlations.min() - 1e-9 <= own <= correlations.max() + 1e-9
    assert own <= 3 * paper + 1e-9
    assert paper * np.sqrt(3 * shares.min()) <= own + 1e-9


def test_a_whisper_on_one_axis_does_not_count_as_much_as_the_motion() -> None:
    wave, whisper = noise(2, 5000)
    acceleration = np.array([wave, 1e-3 * whisper, 1e-3 * whisper])
    assert temporal_match(acceleration, whisper) > 0.6
    assert temporal_match_invariant(acceleration, whisper) < 0.05


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


def test_it_is_one_where_the_papers_is_and_equals_it_for_a_loss_alike_everywhere() -> None:
    acceleration = noise(3, 3000) + 1e6  # a large offset must not cost accuracy
    reduced = REDUCERS["dft321"](acceleration, RATE)
    assert spectral_match_energy_weighted(acceleration, reduced, RATE) == pytest.approx(
        1.0, abs=1e-9
    )
    weaker = spectral_match(acceleration, 0.6 * reduced, RATE)
    assert spectral_match_energy_weighted(acceleration, 0.6 * reduced, RATE) == pytest.approx(
        weaker, abs=1e-9
    )


def test_an_offset_alone_is_silence() -> None:
    offset = np.outer((0.1, 9.81, 0.3), np.ones(4001))
    assert np.isnan(spectral_match_energy_weighted(offset, REDUCERS["dft321"](offset, RATE), RATE))
    assert spectral_match_energy_weighted(offset, offset[1] + 0.01 * noise(4001), RATE) < 1e-6


@pytest.mark.parametrize("counterpart", INVARIANTS.values(), ids=list(INVARIANTS))
@pytest.mark.parametrize(
    ("acceleration", "reduced", "message"),
    [
        (np.ones((3, 5)), np.ones(4), r"shape \(5,\), .*got \(4,\)"),
        (np.ones((2, 3, 5)), np.ones(5), "one recording at a time"),
        (np.ones((3, 5)), np.array([1, 2, np.nan, 4, 5]), "reduced must be finite, got 1 values"),
        (np.full((3, 5), np.inf), np.ones(5), "acceleration must be finite, got 15 values"),
        (np.ones((2, 5)), np.ones(5), "three axes"),
    ],
)
def test_bad_pairs_are_refused(
    counterpart: object, acceleration: np.ndarray, reduced: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        counterpart(acceleration, reduced, RATE)
    with pytest.raises(ValueError, match="rate_hz"):
        counterpart(np.ones((3, 5)), np.ones(5), 0.0)
