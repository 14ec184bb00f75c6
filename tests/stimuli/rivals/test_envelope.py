"""Envelope correlation and modulation spectrum, against the analytic signal at the full rate and hand numbers."""

import math
from itertools import pairwise

import numpy as np
import pytest

from feel321.stimuli.metrics import METRICS

RATE = 4000.0
TIME = np.arange(8000) / RATE
BANDS = np.geomspace(2, 50, 10)


def brute_envelope(signals: np.ndarray) -> np.ndarray:
    """Root of the summed squares of the band-passed analytic signals, with all samples."""
    n = signals.shape[-1]
    frequencies = np.fft.fftfreq(n, 1 / RATE)
    keep = 2.0 * ((frequencies >= 20) & (frequencies <= 1000))
    analytic = [np.fft.ifft(np.fft.fft(one) * keep) for one in np.atleast_2d(signals)]
    return np.sqrt(sum(np.abs(one) ** 2 for one in analytic))


def make_pair(seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    slow = 1 + 0.5 * np.cos(2 * np.pi * 4 * TIME) + 0.3 * np.cos(2 * np.pi * 25 * TIME)
    recording = slow * rng.standard_normal((3, TIME.size)) * [[1.0], [0.5], [0.2]]
    return recording, recording[0] + 0.5 * rng.standard_normal(TIME.size)


@pytest.mark.parametrize("seed", range(3))
def test_envelopes_against_the_full_rate(seed: int) -> None:
    recording, reduced = make_pair(seed)
    spectra, depths = [], []
    for signal in (recording, reduced):
        spectrum = np.fft.rfft(brute_envelope(signal))
        rates = np.arange(spectrum.size) / 2  # Hz: two seconds
        spectra.append(np.where((rates > 0) & (rates <= 50), spectrum, 0))
        depths.append([
            2 * math.sqrt(sum(abs(spectrum[(low <= rates) & (rates < high * (1 + 1e-9 * (high > 49)))]) ** 2))
            / abs(spectrum[0])
            for low, high in pairwise(BANDS)
        ])  # fmt: skip
    slow = [np.fft.irfft(spectrum, TIME.size) for spectrum in spectra]
    found = METRICS["envelope_correlation"](recording, reduced, RATE)
    # Ours samples the envelope, a root, at 1.96 kHz: what is faster folds back a little.
    assert found == pytest.approx(np.corrcoef(slow)[0, 1], abs=2e-3)
    expected = math.sqrt(np.mean(np.subtract(*depths) ** 2))
    found = METRICS["modulation_distance"](recording, reduced, RATE)
    assert found == pytest.approx(expected, rel=0.02, abs=1e-3)


def beat(rate_hz: float, depth: float, phase: float = 0.0) -> np.ndarray:
    return np.asarray(1 + depth * np.cos(2 * np.pi * rate_hz * TIME + phase))


def carry(envelope: np.ndarray, carrier_hz: float = 200) -> np.ndarray:
    return np.asarray(envelope * np.sin(2 * np.pi * carrier_hz * TIME))


def on_one_axis(signal: np.ndarray) -> np.ndarray:
    return np.stack([signal, 0 * signal, 0 * signal])


def test_envelope_correlation_is_that_of_cosines() -> None:
    recording = on_one_axis(carry(beat(10, 0.5)))
    correlate = METRICS["envelope_correlation"]
    for phase in (0.0, 1.0, 2.0, math.pi):
        found = correlate(recording, 5 * carry(beat(10, 0.9, phase), 333), RATE)
        assert found == pytest.approx(math.cos(phase), abs=1e-6)
    assert correlate(recording, carry(beat(7, 0.5)), RATE) == pytest.approx(0, abs=1e-6)
    assert correlate(recording, carry(beat(0, 0.0)), RATE) == 0.0
    assert np.isnan(correlate(on_one_axis(carry(beat(0, 0.0))), carry(beat(7, 0.5)), RATE))
    fast = on_one_axis(carry(beat(60, 0.5)))
    assert np.isnan(correlate(fast, carry(beat(60, 0.5)), RATE))


def test_modulation_distance_is_that_of_depths() -> None:
    """Of nine bands one differs by the difference of the depths, or two by one depth each."""
    measure = METRICS["modulation_distance"]
    recording = on_one_axis(carry(beat(10, 0.6)))
    for reduced, expected in (
        (beat(10, 0.6, 2.0), 0.0),
        (beat(10, 0.3), 0.3 / 3),
        (beat(0, 0.0), 0.6 / 3),
        (beat(30, 0.6), 0.6 * math.sqrt(2) / 3),
    ):
        assert measure(recording, carry(reduced, 300), RATE) == pytest.approx(expected, abs=1e-6)
    silent = measure(recording, np.zeros(TIME.size), RATE)
    assert silent == pytest.approx(math.sqrt((8 * 1.0 + 0.4**2) / 9), abs=1e-6)
