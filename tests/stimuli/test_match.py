from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from feel321.names import MATCHES, METRIC_INFO
from feel321.stimuli.match import (
    spectral_match,
    spectral_match_details,
    temporal_match,
    temporal_match_details,
)
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.registry import REDUCERS

RATE = 4000.0


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


@settings(max_examples=40)
@given(
    exponent=st.integers(-900, 900), seed=st.integers(0, 99), name=st.sampled_from(list(REDUCERS))
)
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


def test_details_name_the_range_and_count_what_is_left_out() -> None:
    acceleration = noise(3, 4000)
    details = spectral_match_details(acceleration, acceleration[0], RATE)
    assert (details.lowest_hz, details.highest_hz) == (20.0, 1000.0)
    assert (details.n_frequencies, details.n_left_out) == (981, 0)
    low_rate = spectral_match_details(acceleration, acceleration[0], 1600.0)
    assert low_rate.highest_hz == 800.0


def test_bins_that_hold_only_rounding_are_left_out() -> None:
    time = np.arange(4000) / RATE
    tone = np.sin(2 * np.pi * 100 * time)  # a whole number of periods: all other bins are rounding
    acceleration = np.array([tone, 0.5 * tone, 0 * tone])
    details = spectral_match_details(acceleration, REDUCERS["dft321"](acceleration, RATE), RATE)
    assert details.value == pytest.approx(1.0, abs=1e-9)
    assert 90 <= details.lowest_hz < details.highest_hz <= 112.5
    assert details.n_left_out + details.n_frequencies == 981
    assert details.n_left_out > 900


def test_an_unknown_grid_is_refused() -> None:
    with pytest.raises(ValueError, match="grid must be one of linear, log; got 'octave'"):
        spectral_match(noise(3, 400), noise(400), RATE, grid="octave")


def test_log_grid_weighs_octaves_alike() -> None:
    """A reduced signal that is right below 200 Hz and silent above: more than half of a log grid is right."""
    acceleration = noise(3, 20_000)
    spectrum = np.fft.rfft(REDUCERS["dft321"](acceleration, RATE))
    spectrum[np.fft.rfftfreq(20_000, 1 / RATE) > 200] = 0
    reduced = np.fft.irfft(spectrum, 20_000)
    linear = spectral_match(acceleration, reduced, RATE)
    log = spectral_match(acceleration, reduced, RATE, grid="log")
    assert linear == pytest.approx((200 - 20) / (1000 - 20), abs=0.02)
    assert log == pytest.approx(np.log(200 / 20) / np.log(1000 / 20), abs=0.02)


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


@pytest.mark.parametrize("size", [1e145, 1e200])
def test_an_absurd_reduced_signal_is_refused_not_scored(size: float) -> None:
    with pytest.raises(ValueError, match="are they in the same unit"):
        spectral_match(noise(3, 400), size * noise(400), RATE)


@pytest.mark.parametrize(("size", "silent"), [(1e-9, ()), (1e-11, ()), (1e-13, (1,))])
def test_a_weak_axis_is_not_a_silent_one(size: float, silent: tuple[int, ...]) -> None:
    wave, other = noise(2, 500)
    assert temporal_match_details([wave, size * other, other], wave).silent_axes == silent


@pytest.mark.parametrize(("size", "counts"), [(2.8e-6, True), (3e-8, False)])
def test_a_tone_counts_from_a_share_of_1e_12_of_the_energy_per_bin(
    size: float, counts: bool
) -> None:
    # Spread over the 154 Hz around 700 Hz it has 13 size² times the mean energy per bin: 1e-10, and 1e-14.
    loud, weak = (np.sin(2 * np.pi * f * np.arange(4000) / RATE) for f in (100, 700))
    recording = np.array([loud + size * weak, 0 * loud, 0 * loud])
    assert (700 in spectral_match_details(recording, loud, RATE).frequencies_hz) == counts


def test_a_silent_reduced_signal_scores_zero_and_is_reported() -> None:
    details = temporal_match_details(noise(3, 50), np.zeros(50))
    assert details.value == 0.0
    assert details.silent_reduced
    assert details.reason == ""


@pytest.mark.parametrize("reduced", [np.zeros(50), np.ones(50)])
def test_a_silent_recording_has_no_temporal_match(reduced: np.ndarray) -> None:
    nothing = temporal_match_details(np.zeros((3, 50)), reduced)
    assert np.isnan(nothing.value)
    assert (nothing.silent_axes, nothing.reason) == (
        (0, 1, 2),
        "all three axes of the recording are silent",
    )


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
        (np.ones((3, 0)), np.ones(0), "n >= 1"),
        (np.ones((3, 5)), np.array([1, 2, np.nan, 4, 5]), "reduced must be finite, got 1 values"),
        (np.full((3, 5), np.inf), np.ones(5), "acceleration must be finite, got 15 values"),
        (np.ones((2, 5)), np.ones(5), "three axes"),
    ],
)
def test_bad_pairs_are_refused(
    metric: object, acceleration: np.ndarray, reduced: np.ndarray, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        metric(acceleration, reduced, RATE)
