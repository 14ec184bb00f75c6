import numpy as np
import pytest
from scipy.signal import butter, sosfiltfilt

from feel321.stimuli.condition import Conditioning, condition, fade, filter_zero_phase, resample
from feel321.stimuli.recording import Recording

RATE = 8000.0
NOTHING = Conditioning(remove_offset=False, high_pass_hz=None, low_pass_hz=None)


def tones(*frequencies: float, n: int = 16000, rate: float = RATE) -> np.ndarray:
    return np.sum([np.sin(2 * np.pi * f * np.arange(n) / rate) for f in frequencies], axis=0)


def recording(wave: np.ndarray, rate: float = RATE) -> Recording:
    return Recording(np.array([wave, 2 * wave, -wave]), rate, "wave")


def amplitude(wave: np.ndarray, frequency: float, rate: float = RATE) -> float:
    middle = slice(len(wave) // 4, 3 * len(wave) // 4)
    turning = np.exp(-2j * np.pi * frequency * np.arange(len(wave)) / rate)
    return 2 * abs(np.mean((wave * turning)[middle]))


def test_default_corners_halve_the_amplitude_and_do_not_shift() -> None:
    conditioned = condition(recording(tones(2, 20, 150, 1000, 3000)), Conditioning())
    got = [amplitude(conditioned.acceleration[0], f) for f in (2, 20, 150, 1000, 3000)]
    # Forwards and backwards: the Butterworth gain squared, 1/2 at the corner, (f/f_c)^8 below the high pass's.
    np.testing.assert_allclose(got, [1e-8, 0.5, 1.0, 0.5, 0.0], atol=2e-3)
    band = condition(recording(tones(150)), Conditioning()).acceleration[0]
    np.testing.assert_allclose(band[2000:-2000], tones(150)[2000:-2000], atol=1e-3)


def test_a_filter_is_padded_by_a_period_of_its_corner() -> None:
    wave = tones(30.3, 150) + 2
    sections = butter(4, 20, btype="highpass", fs=RATE, output="sos")
    filtered = filter_zero_phase(wave, RATE, corner_hz=20.0, kind="highpass")
    np.testing.assert_array_equal(filtered, sosfiltfilt(sections, wave, padlen=400))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"high_pass_hz": 0.0}, "high_pass_hz must be .*got 0.0"),
        ({"high_pass_hz": 900.0, "low_pass_hz": 500.0}, "must be below low_pass_hz"),
        ({"crop_s": (1.0, 0.5)}, "0 <= start < end"),
    ],
)
def test_steps_that_make_no_sense_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Conditioning(**changes)


def test_fades_are_raised_cosines_at_both_ends() -> None:
    faded = fade(np.ones((2, 1000)), 1000.0, fade_s=0.1)
    np.testing.assert_allclose(faded[:, 100:900], 1.0)
    np.testing.assert_allclose(
        faded[0, :100], 0.5 - 0.5 * np.cos(np.pi * (np.arange(100) + 0.5) / 100)
    )
    np.testing.assert_allclose(faded, faded[:, ::-1])
    np.testing.assert_array_equal(fade(np.ones(10), 1000.0, fade_s=0.0), 1.0)


@pytest.mark.parametrize("rate", [1601.57, 6898.24, 26927.2, 48000.0])
def test_resampling_keeps_tones_in_place_at_fractional_rates(rate: float) -> None:
    n = int(rate)
    wave = tones(50, 300, n=n, rate=rate) * np.hanning(n)
    resampled = resample(np.array([wave, -wave]), rate, to_hz=48000.0)
    m = resampled.shape[1]
    assert abs(m - n * 48000 / rate) <= 1
    time = np.arange(m) / 48000.0
    expected = (np.sin(2 * np.pi * 50 * time) + np.sin(2 * np.pi * 300 * time)) * np.interp(
        time, np.arange(n) / rate, np.hanning(n)
    )
    np.testing.assert_allclose(resampled[0], expected, atol=2e-5)
    np.testing.assert_array_equal(resampled[1], -resampled[0])
    assert resample(np.ones((3, 1)), rate, to_hz=44100.0).shape[0] == 3
