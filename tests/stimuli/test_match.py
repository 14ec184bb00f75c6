import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.stimuli.match import spectral_match, spectral_match_details, temporal_match
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.types import MATCHES, METRIC_INFO

RATE = 4000.0


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@settings(max_examples=40)
@given(exponent=st.integers(-90, 90), seed=st.integers(0, 99), name=st.sampled_from(list(REDUCERS)))
def test_scaling_a_recording_changes_neither_metric(exponent: int, seed: int, name: str) -> None:
    acceleration = noise(3, 500, seed=seed)
    scaled = np.ldexp(acceleration, exponent)
    for metric in map(METRICS.get, MATCHES):
        once = metric(acceleration, REDUCERS[name](acceleration, RATE), RATE)
        assert metric(scaled, REDUCERS[name](scaled, RATE), RATE) == pytest.approx(once, abs=1e-9)


def test_spectral_match_is_blind_to_time_and_temporal_match_to_gain() -> None:
    acceleration = noise(3, 3000)
    reduced = REDUCERS["dft321"](acceleration, RATE)
    assert spectral_match(acceleration, reduced[::-1], RATE) == pytest.approx(1.0, abs=1e-9)
    assert temporal_match(acceleration, reduced[::-1]) < 0.2
    assert temporal_match(acceleration, -7 * reduced) == pytest.approx(
        temporal_match(acceleration, reduced), rel=1e-12
    )


def test_bins_that_hold_only_rounding_are_left_out() -> None:
    time = np.arange(4000) / RATE
    tone = np.sin(2 * np.pi * 100 * time)  # a whole number of periods: all other bins are rounding
    acceleration = np.array([tone, 0.5 * tone, 0 * tone])
    details = spectral_match_details(acceleration, REDUCERS["dft321"](acceleration, RATE), RATE)
    assert details.value == pytest.approx(1.0, abs=1e-9)
    assert 90 <= details.lowest_hz < details.highest_hz <= 112.5
    assert details.n_left_out + details.n_frequencies == 981
    assert details.n_left_out > 900


@pytest.mark.parametrize("metric", METRICS.values(), ids=list(METRICS))
def test_nothing_to_match_is_no_number(metric: object) -> None:
    silence = np.zeros((3, 100))
    assert np.isnan(metric(silence, silence[0], RATE))


@pytest.mark.parametrize(
    ("acceleration", "reason"),
    [
        (np.zeros((3, 100)), "no energy from 20 to 1000 Hz"),
        (np.outer((0.0, 9.81, 1.0), np.ones(100)), "no energy from 20 to 1000 Hz"),
        (noise(3, 3), "too short, or its rate too low"),
    ],
)
def test_a_match_over_no_frequency_has_a_reason(acceleration: np.ndarray, reason: str) -> None:
    for reduced in (acceleration[1], REDUCERS["dft321"](acceleration, RATE)):
        details = spectral_match_details(acceleration, reduced, RATE)
        assert np.isnan([details.value, details.bounded, details.lowest_hz]).all()
        assert details.n_frequencies == 0
        assert reason in details.reason
    assert spectral_match_details(noise(3, 300), noise(300), RATE).reason == ""


def test_temporal_match_is_the_mean_absolute_correlation() -> None:
    acceleration, reduced = noise(3, 700), noise(700, seed=9)
    expected = np.mean([
        abs(axis @ reduced) / np.sqrt((axis @ axis) * (reduced @ reduced)) for axis in acceleration
    ])
    assert temporal_match(acceleration, reduced) == pytest.approx(expected, rel=1e-12)


def test_every_metric_is_called_alike() -> None:
    assert tuple(METRICS)[:3] == MATCHES
    assert list(METRIC_INFO) == list(METRICS)
    acceleration = noise(3, 400)
    for metric in METRICS.values():
        value = metric(acceleration, acceleration[0], RATE)
        assert isinstance(value, float)


@pytest.mark.parametrize("metric", METRICS.values(), ids=list(METRICS))
@pytest.mark.parametrize(
    ("acceleration", "reduced", "message"),
    [
        (np.ones((3, 5)), np.ones(4), r"shape \(5,\), .*got \(4,\)"),
        (np.ones((3, 5)), np.ones((3, 5)), "one axis"),
        (np.ones((2, 3, 5)), np.ones(5), "one recording at a time"),
        (np.ones((3, 5)), np.array([1, 2, np.nan, 4, 5]), "reduced must be finite, got 1 values"),
        (np.full((3, 5), np.inf), np.ones(5), "acceleration must be finite, got 15 values"),
    ],
)
def test_bad_pairs_are_refused(
    metric: object, acceleration: np.ndarray, reduced: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        metric(acceleration, reduced, RATE)


def test_a_wrong_name_of_a_metric_is_told_the_right_ones() -> None:
    with pytest.raises(KeyError, match=r"metric must be one of .*did you mean 'spectral_match'"):
        METRIC_INFO["spectral_macth"]
