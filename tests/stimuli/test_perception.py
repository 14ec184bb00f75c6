import numpy as np
import pytest

from feel321.stimuli.condition import fade
from feel321.stimuli.thresholds import (
    THRESHOLDS,
    acceleration_threshold,
    displacement_threshold,
    felt_level,
    loudest_levels,
    sensation_level_db,
)


@pytest.mark.parametrize("threshold", THRESHOLDS)
def test_felt_levels_by_hand(threshold: str) -> None:
    # Two tones of 3 and 4 times their thresholds add to 5; a fade takes 3/8 of a Hann window's energy, and a length
    # that is a prime number is padded.
    time = np.arange(7919) / 8000
    tones = [
        times * acceleration_threshold(f, threshold=threshold) * np.sin(2 * np.pi * f * time)
        for times, f in ((3, 100.0), (4, 400.0))
    ]
    wave = np.sum(tones, axis=0) * (0.5 - 0.5 * np.cos(2 * np.pi * np.arange(7919) / 7919))
    level = felt_level(wave, 8000.0, threshold=threshold)
    assert level == pytest.approx(5 * np.sqrt(3 / 8), rel=1e-3)
    assert 20 * np.log10(level) == pytest.approx(9.72, abs=0.01)


# --- sensation levels -------------------------------------------------------------------------------------------


def tone(frequency: float, *, seconds: float = 1.0, rate_hz: float = 8000.0) -> np.ndarray:
    time = np.arange(round(seconds * rate_hz)) / rate_hz
    return fade(np.sin(2 * np.pi * frequency * time), rate_hz, fade_s=seconds / 10)


@pytest.mark.parametrize("threshold", THRESHOLDS)
@pytest.mark.parametrize("frequency", [20.0, 45.0, 100.0, 250.0, 320.0, 700.0, 1000.0])
def test_a_tone_at_its_threshold_has_0_db_and_20_db_more_has_20_db(
    frequency: float, threshold: str
) -> None:
    at_threshold = acceleration_threshold(frequency, threshold=threshold) * tone(frequency)
    level = sensation_level_db(at_threshold, 8000.0, threshold=threshold)
    assert level == pytest.approx(0.0, abs=0.15)
    assert sensation_level_db(10 * at_threshold, 8000.0, threshold=threshold) == pytest.approx(
        level + 20, abs=1e-9
    )


@pytest.mark.parametrize("n", [1, 77, 1600, 20_011])
def test_silence_around_a_vibration_changes_no_level(n: int) -> None:
    burst = np.random.default_rng(n).standard_normal((3, 900)) * np.hanning(900)
    quiet = np.zeros((3, n))
    alone = loudest_levels(burst, 8000.0)["contactor"]
    for longer in ([burst, quiet], [quiet, burst], [quiet, burst, quiet, quiet]):
        assert loudest_levels(np.hstack(longer), 8000.0)["contactor"] == pytest.approx(
            alone, rel=2e-3
        )


def test_the_loudest_window_is_found_by_brute_force() -> None:
    rng = np.random.default_rng(3)
    signal = rng.standard_normal((2, 6000)) * rng.random(6000) ** 8
    frequency = np.fft.rfftfreq(16_000, 1 / 8000)
    weights = np.zeros(len(frequency))
    inside = (frequency >= 20) & (frequency <= 1000)
    edge = np.cos(
        np.pi
        / 2
        * np.clip(np.log2(np.maximum(20 / frequency[1:], frequency[1:] / 1000)) / 0.5, 0, 1)
    )
    weights[1:] = edge / (acceleration_threshold(frequency[1:]) / np.sqrt(2))
    assert inside.sum() > 1000
    weighted = np.fft.irfft(np.fft.rfft(signal, 16_000) * weights)
    sums = [np.sum(weighted[:, start : start + 1600] ** 2) for start in range(7600)]
    assert loudest_levels(signal, 8000.0)["contactor"] == pytest.approx(
        np.sqrt(max(sums) / 1600), rel=1e-4
    )


def test_the_stylus_keeps_the_published_numbers() -> None:
    points = displacement_threshold([10.0, 20.0, 320.0], threshold="grasped_stylus")
    np.testing.assert_allclose(points, [26e-6, 8.5e-6, 0.06e-6], rtol=1e-12)
    first, last = displacement_threshold([10.0, 160.0], threshold="grasped_stylus")
    assert 20 * np.log10(last / first) / 4 == pytest.approx(-13, abs=1e-9)  # mean slope per octave
    above = displacement_threshold([400.0, 800.0], threshold="grasped_stylus")
    assert 20 * np.log10(above[1] / above[0]) == pytest.approx(12.04, abs=0.01)
