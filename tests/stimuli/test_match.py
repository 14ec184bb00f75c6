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


def brute_spectral_match(acceleration: np.ndarray, reduced: np.ndarray, rate_hz: float) -> float:
    """Equation 1 with the smoothing window laid out bin by bin, one frequency after the other."""
    n = reduced.size
    original = (np.abs(np.fft.rfft(acceleration)) ** 2).sum(axis=0)
    kept = np.abs(np.fft.rfft(reduced)) ** 2
    bins = np.arange(original.size)
    deviations = []
    for k in bins:
        if not 20 <= k * rate_hz / n <= 1000:
            continue
        half = max(0.11 * k, 0.5)
        low, high = max(k + 0.5 - half, 0), min(k + 0.5 + half, original.size)
        covered = np.clip(np.minimum(bins + 1, high) - np.maximum(bins, low), 0, 1)
        deviations.append(abs(covered @ original - covered @ kept) / (covered @ original))
    return 1 - float(np.mean(deviations))


@pytest.mark.parametrize("n", [401, 2000, 3001])
@pytest.mark.parametrize("name", ["sax321", "soc321", "mag321", "pca321", "dft321_windowed"])
def test_spectral_match_against_brute_force(name: str, n: int) -> None:
    acceleration = noise(3, n, seed=n) * np.array([[1.0], [2.0], [0.3]])
    reduced = REDUCERS[name](acceleration, RATE)
    assert spectral_match(acceleration, reduced, RATE) == pytest.approx(
        brute_spectral_match(acceleration, reduced, RATE), abs=1e-12
    )


@pytest.mark.parametrize(
    ("axis", "expected"), [("sax321", 1 / 6), ("say321", 2 / 6), ("saz321", 3 / 6)]
)
def test_white_axes_with_energies_1_2_3(axis: str, expected: float) -> None:
    acceleration = noise(3, 100_000) * np.sqrt([[1.0], [2.0], [3.0]])
    assert spectral_match(acceleration, REDUCERS[axis](acceleration, RATE), RATE) == pytest.approx(
        expected, abs=0.01
    )


def test_anti_phase_axes_cancel_in_their_sum() -> None:
    wave = noise(5000)
    acceleration = np.array([wave, -wave, 0 * wave])
    assert spectral_match(acceleration, REDUCERS["soc321"](acceleration, RATE), RATE) == 0.0


def test_three_equal_axes_triple_in_their_sum() -> None:
    acceleration = np.tile(noise(5000), (3, 1))
    assert spectral_match(
        acceleration, REDUCERS["soc321"](acceleration, RATE), RATE
    ) == pytest.approx(-1.0, abs=1e-12)


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


@settings(max_examples=40)
@given(gain=st.floats(0, 3))
def test_spectral_match_of_a_gain_is_known(gain: float) -> None:
    """A reduced signal with g squared times the energy everywhere scores 1 - |1 - g squared|."""
    acceleration = noise(3, 2000)
    reduced = gain * REDUCERS["dft321"](acceleration, RATE)
    assert spectral_match(acceleration, reduced, RATE) == pytest.approx(
        1 - abs(1 - gain**2), abs=1e-9
    )


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


def test_temporal_match_identity_and_bounds() -> None:
    wave = noise(500)
    assert temporal_match([wave, -2 * wave, 5 * wave], 3 * wave) == pytest.approx(1.0, abs=1e-12)
    assert 0 <= temporal_match(noise(3, 500, seed=1), wave) <= 1


@pytest.mark.parametrize("size", [1e-280, 1e-100, 1e100, 1e280])
def test_temporal_match_takes_any_unit_of_either(size: float) -> None:
    acceleration, reduced = noise(3, 700), noise(700, seed=9)
    expected = temporal_match(acceleration, reduced)
    assert temporal_match(acceleration, size * reduced) == pytest.approx(expected, rel=1e-12)
    assert temporal_match(size * acceleration, reduced) == pytest.approx(expected, rel=1e-12)


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


def test_a_silent_axis_is_left_out_and_reported() -> None:
    wave, other = noise(2, 500)
    details = temporal_match_details([wave, 0 * wave, other], wave)
    assert details.silent_axes == (1,)
    assert np.isnan(details.correlations[1])
    assert details.value == pytest.approx((1 + details.correlations[2]) / 2)


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
