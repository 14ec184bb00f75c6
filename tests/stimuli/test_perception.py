from __future__ import annotations

import numpy as np
import pytest

from stimuli.perception import acceleration_threshold, displacement_threshold, felt_level


def test_the_hand_is_most_sensitive_near_250_hz_with_12_db_per_octave_on_either_side() -> None:
    frequencies = np.geomspace(20, 1000, 2001)
    thresholds = displacement_threshold(frequencies)
    assert frequencies[np.argmin(thresholds)] == pytest.approx(250, rel=2e-3)
    assert thresholds.min() == pytest.approx(1e-7, rel=1e-4)
    octave_below, octave_above = displacement_threshold([10.0, 5.0]), displacement_threshold([4000.0, 8000.0])
    for near, far in (octave_below, octave_above):
        assert 20 * np.log10(far / near) == pytest.approx(12.04, abs=0.01)


def test_the_acceleration_threshold_is_flat_below_and_steep_above() -> None:
    low = acceleration_threshold([20.0, 40.0])
    assert low[1] / low[0] == pytest.approx(1.0, abs=0.01)
    assert low[0] == pytest.approx(0.5 * (2 * np.pi * 250) ** 2 * 1e-7, rel=1e-3)
    high = acceleration_threshold([4000.0, 8000.0])
    assert 20 * np.log10(high[1] / high[0]) == pytest.approx(24.08, abs=0.01)


@pytest.mark.parametrize("frequency", [20.0, 100.0, 250.0, 1000.0])
def test_a_tone_at_its_threshold_has_level_one(frequency: float) -> None:
    time = np.arange(8000) / 8000
    tone = acceleration_threshold(frequency) * np.sin(2 * np.pi * frequency * time)
    assert felt_level(tone, 8000.0) == pytest.approx(1.0, rel=1e-9)


def test_levels_scale_and_add_by_energy() -> None:
    wave = np.random.default_rng(0).standard_normal((2, 5000))
    one, two, both = (felt_level(w, 5000.0) for w in (wave[0], wave[1], wave))
    assert both == pytest.approx(np.hypot(one, two))
    assert felt_level(3 * wave[0], 5000.0) == pytest.approx(3 * one)


def test_what_is_not_felt_has_no_level() -> None:
    time = np.arange(8000) / 8000
    unfelt = 9.8 + np.sin(2 * np.pi * 5 * time) + np.sin(2 * np.pi * 1500 * time)
    assert felt_level(unfelt, 8000.0) == pytest.approx(0.0, abs=1e-9)


def test_the_nyquist_bin_counts_once() -> None:
    alternating = np.cos(np.pi * np.arange(1000))  # 500 Hz at 1000 Hz: RMS 1
    expected = 1 / (acceleration_threshold(500.0) / np.sqrt(2))
    assert felt_level(alternating, 1000.0) == pytest.approx(expected)
