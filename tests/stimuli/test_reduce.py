from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from feel321.stimuli.match import spectral_match, spectral_match_details
from feel321.stimuli.reducers.axes import pca321_adaptive
from feel321.stimuli.reducers.fourier import dft321_windowed
from feel321.stimuli.reducers.registry import REDUCERS

CONTRACT = [
    "sax321",
    "say321",
    "saz321",
    "soc321",
    "mag321",
    "pca321",
    "pca321_adaptive",
    "dft321",
    "dft321_windowed",
    "dft321_principal",
    "dft321_principal_windowed",
    "sax321_matched",
    "say321_matched",
    "saz321_matched",
    "pca321_matched",
    "sax321_matched_running",
    "say321_matched_running",
    "saz321_matched_running",
    "pca321_matched_windowed",
    "dft321_bands",
    "dft321_filtered",
]
RATE = 1000.0
LENGTHS = st.integers(1, 200)


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def finite(n: int) -> st.SearchStrategy[np.ndarray]:
    return arrays(np.float64, (3, n), elements=st.floats(-1e150, 1e150, allow_subnormal=False))


def brute_dft321(acceleration: np.ndarray) -> np.ndarray:
    """Equations 3 and 4 on the two-sided spectrum, as they stand."""
    spectra = np.fft.fft(acceleration)
    merged = np.sqrt((np.abs(spectra) ** 2).sum(axis=0)) * np.exp(
        1j * np.angle(spectra.sum(axis=0))
    )
    return np.fft.ifft(merged).real


def test_the_registry_holds_the_contract_in_its_order() -> None:
    assert list(REDUCERS) == CONTRACT


def test_an_unknown_reducer_is_answered_with_the_list() -> None:
    with pytest.raises(ValueError, match=r"must be one of sax321, .*dft321_windowed.*got 'dft'"):
        REDUCERS.find("dft")


@pytest.mark.parametrize("name", CONTRACT)
def test_shape_type_and_input_untouched(name: str) -> None:
    acceleration = noise(2, 4, 3, 101)
    before = acceleration.copy()
    reduced = REDUCERS[name](acceleration, RATE)
    assert reduced.shape == (2, 4, 101)
    assert reduced.dtype == np.float64
    np.testing.assert_array_equal(acceleration, before)
    assert not np.shares_memory(reduced, acceleration)


@pytest.mark.parametrize("name", CONTRACT)
def test_a_batch_gives_what_its_members_give(name: str) -> None:
    acceleration = noise(4, 3, 333)
    together = REDUCERS[name](acceleration, RATE)
    alone = np.array([REDUCERS[name](one, RATE) for one in acceleration])
    np.testing.assert_allclose(together, alone, atol=1e-12)


@pytest.mark.parametrize("name", CONTRACT)
def test_members_of_a_batch_may_differ_in_size_beyond_what_squares_can_hold(name: str) -> None:
    quiet, ordinary, loud = 1e-250, 1.0, 1e200
    one = noise(3, 97)
    together = REDUCERS[name](np.array([quiet * one, ordinary * one, loud * one]), RATE)
    for reduced, size in zip(together, (quiet, ordinary, loud), strict=True):
        np.testing.assert_allclose(reduced / size, REDUCERS[name](one, RATE), rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("name", CONTRACT)
def test_the_largest_finite_numbers_stay_finite(name: str) -> None:
    acceleration = np.zeros((3, 4))
    acceleration[0] = (1.2e308, 0.0, -1e308, 1e-5)
    expected = REDUCERS[name](acceleration / 2**600, RATE) * 2.0**600
    np.testing.assert_allclose(REDUCERS[name](acceleration, RATE), expected, rtol=1e-12)


@pytest.mark.parametrize("name", CONTRACT)
def test_layout_and_type_do_not_matter(name: str) -> None:
    base = np.round(100 * noise(3, 200))
    expected = REDUCERS[name](base[:, ::2], RATE)
    for same in (
        np.asfortranarray(base)[:, ::2],
        base[:, ::2].astype(np.int16),
        base[:, ::2].astype(">f4"),
        base[:, ::2].tolist(),
        base.T.copy().T[:, ::2],
    ):
        np.testing.assert_allclose(REDUCERS[name](same, RATE), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", CONTRACT)
def test_an_empty_batch_gives_an_empty_batch(name: str) -> None:
    assert REDUCERS[name](np.zeros((0, 3, 10)), RATE).shape == (0, 10)


@pytest.mark.parametrize("name", CONTRACT)
@pytest.mark.parametrize("factor", [1e-300, 1e-80, 3.0, 1e80, 1e300])
def test_scaling_the_recording_scales_the_output(name: str, factor: float) -> None:
    acceleration = noise(3, 97)
    expected = factor * REDUCERS[name](acceleration, RATE)
    np.testing.assert_allclose(
        REDUCERS[name](factor * acceleration, RATE), expected, rtol=1e-9, atol=1e-12 * factor
    )


@pytest.mark.parametrize("name", CONTRACT)
@pytest.mark.parametrize("n", [0, 1, 2, 3])
def test_the_shortest_signals(name: str, n: int) -> None:
    assert REDUCERS[name](np.ones((3, n)), RATE).shape == (n,)


@pytest.mark.parametrize("name", CONTRACT)
def test_silence_stays_silence(name: str) -> None:
    np.testing.assert_array_equal(REDUCERS[name](np.zeros((3, 77)), RATE), 0.0)


@pytest.mark.parametrize("name", CONTRACT)
def test_bad_input_is_refused_at_every_door(name: str) -> None:
    with pytest.raises(ValueError, match="three axes"):
        REDUCERS[name](np.zeros((2, 9)), RATE)
    with pytest.raises(ValueError, match="must be finite"):
        REDUCERS[name](np.full((3, 9), np.nan), RATE)
    with pytest.raises(ValueError, match="rate_hz"):
        REDUCERS[name](np.zeros((3, 9)), 0.0)


def test_samplewise_reducers_against_their_definitions() -> None:
    x, y, z = acceleration = noise(3, 50)
    for name, expected in {"sax321": x, "say321": y, "saz321": z, "soc321": x + y + z}.items():
        np.testing.assert_allclose(REDUCERS[name](acceleration, RATE), expected, rtol=0, atol=1e-15)
    np.testing.assert_allclose(
        REDUCERS["mag321"](acceleration, RATE), np.linalg.norm(acceleration, axis=0), rtol=1e-14
    )


# --- PCA -----------------------------------------------------------------------------------------------------------


def test_pca_keeps_the_largest_energy_that_a_fixed_axis_can() -> None:
    acceleration = noise(3, 500) * np.array([[1.0], [3.0], [2.0]]) + 5.0
    largest = np.linalg.eigvalsh(np.cov(acceleration, ddof=0))[-1]
    reduced = REDUCERS["pca321"](acceleration, RATE)
    assert reduced.mean() == pytest.approx(0.0, abs=1e-12)
    assert reduced.var() == pytest.approx(largest, rel=1e-12)


@settings(max_examples=50)
@given(st.integers(0, 2**32 - 1))
def test_pca_never_correlates_negatively_with_the_sum(seed: int) -> None:
    acceleration = noise(3, 60, seed=seed) * np.random.default_rng(seed).uniform(0.1, 3, (3, 1))
    reduced = REDUCERS["pca321"](acceleration, RATE)
    assert reduced @ (acceleration - acceleration.mean(axis=1, keepdims=True)).sum(axis=0) >= -1e-9


def test_pca_sign_is_not_left_to_rounding_where_the_sum_vanishes() -> None:
    wave = noise(400)
    wave -= wave.mean()
    for tiny in (0.0, 1e-16, -1e-16):
        acceleration = np.array([wave, -wave * (1 + tiny), 0 * wave])
        np.testing.assert_allclose(
            REDUCERS["pca321"](acceleration, RATE), np.sqrt(2) * wave, atol=1e-9
        )


def test_adaptive_pca_is_pca_where_the_axis_does_not_change() -> None:
    direction = np.array([0.6, -0.64, 0.48])
    wave = noise(900)
    acceleration = np.outer(direction, wave - wave.mean())
    expected = REDUCERS["pca321"](acceleration, RATE)
    np.testing.assert_allclose(
        REDUCERS["pca321_adaptive"](acceleration, RATE), expected, atol=1e-12
    )


def test_adaptive_pca_follows_an_axis_that_turns_without_jumping() -> None:
    n = 20000
    # Half a turn: the axis ends where it began, pointing the other way.
    angle = np.linspace(0, np.pi, n)
    wave = np.sin(2 * np.pi * 123.4 * np.arange(n) / RATE)
    acceleration = np.array([np.cos(angle), np.sin(angle), 0 * angle]) * wave
    reduced = REDUCERS["pca321_adaptive"](acceleration, RATE)
    np.testing.assert_allclose(reduced[50:-50], wave[50:-50], atol=0.01)
    fixed = REDUCERS["pca321"](acceleration, RATE)
    assert fixed.var() < 0.6 * reduced.var()


@pytest.mark.parametrize("seed", range(6))
def test_adaptive_pca_noise_in_pauses_does_not_choose_the_sign_of_what_follows(seed: int) -> None:
    at = np.arange(5000) % 1250
    taps = np.exp(-at / 15) * np.sin(2 * np.pi * 0.2 * at)
    acceleration = np.outer((0.6, -0.64, 0.48), taps)
    sensor = 1e-3 * np.linalg.norm(taps) * noise(2, 3, 5000, seed=seed) / np.sqrt(3 * 5000)
    one, other = pca321_adaptive(acceleration + sensor, RATE)
    assert abs(np.corrcoef(one, taps)[0, 1]) > 0.999
    apart = min(np.linalg.norm(one - other), np.linalg.norm(one + other))
    assert apart < 0.005 * np.linalg.norm(one)


@pytest.mark.parametrize("gain", [2.0**-30, 1e-3, 7.0])
def test_adaptive_pca_follows_any_gain(gain: float) -> None:
    acceleration = noise(3, 2000) * (1 + np.sin(np.arange(2000) / 200)) ** 4
    expected = gain * pca321_adaptive(acceleration, RATE)
    np.testing.assert_allclose(pca321_adaptive(gain * acceleration, RATE), expected, rtol=1e-9)


def test_adaptive_pca_axes_that_point_against_each_other_fade_through_zero() -> None:
    """Strong along x, then a whisper whose axis turns until it points against the memory: nothing is undefined."""
    n = 4000
    angle = np.where(np.arange(n) < n // 2, 0.0, np.linspace(-4 * np.pi, 4 * np.pi, n))
    size = np.where(np.arange(n) < n // 2, 1.0, 1e-3)
    acceleration = size * noise(n) * np.array([np.cos(angle), np.sin(angle), 0 * angle])
    reduced = pca321_adaptive(acceleration, RATE)
    assert np.all(np.abs(reduced) <= np.linalg.norm(acceleration, axis=0) * (1 + 1e-12))
    opposed = pca321_adaptive(acceleration[:, n // 2 :], RATE)
    assert np.sign(reduced[n // 2 + 100 :] * opposed[100:]).min() == -1


def test_adaptive_pca_keeps_its_axis_through_rest_and_ignores_a_constant_offset() -> None:
    wave = np.r_[noise(500), np.zeros(500), noise(500, seed=1)]
    acceleration = np.outer((0.0, 0.8, -0.6), wave)
    np.testing.assert_allclose(pca321_adaptive(acceleration, RATE), wave, atol=1e-9)
    moved = acceleration + np.array([[0.0], [0.0], [9.8]])
    np.testing.assert_allclose(pca321_adaptive(moved, RATE), wave - 9.8 * 0.6, atol=1e-6)


def test_a_whisper_on_a_large_offset_has_an_axis_of_its_own() -> None:
    whisper = 1e-7 * noise(500)
    reduced = pca321_adaptive([np.ones(500), whisper, np.zeros(500)], RATE)[50:-50]
    assert np.abs(reduced).max() < 1e-5  # along the diagonal it would be 0.58


def test_adaptive_pca_sign_is_not_left_to_rounding_either() -> None:
    wave = noise(400)
    for tiny in (0.0, 2e-16, -2e-16, 1e-15, -1e-15):
        acceleration = np.array([wave, -wave * (1 + tiny), 0 * wave])
        np.testing.assert_allclose(
            pca321_adaptive(acceleration, RATE), np.sqrt(2) * wave, atol=1e-9
        )


def test_adaptive_pca_against_a_loop_over_segments() -> None:
    n, hop = 1510, 20
    acceleration = noise(3, n) * np.array([[1.0], [1.5], [0.5]]) + 2.0
    window = 0.5 - 0.5 * np.cos(np.pi * np.arange(2 * hop) / hop)
    padded = np.pad(acceleration, ((0, 0), (hop, 3 * hop)))
    inside = np.pad(np.ones(n), (hop, 3 * hop))
    turning, memory = np.zeros(padded.shape), np.zeros(3)
    for start in range(0, n + hop, hop):
        part = slice(start, start + 2 * hop)
        weight = window * inside[part]
        covariance = np.cov(padded[:, part], aweights=weight, ddof=0)
        axis = np.linalg.eigh(covariance)[1][:, -1]
        axis *= 1 if axis @ (memory if memory.any() else np.ones(3)) >= 0 else -1
        turning[:, part] += np.outer(axis, window)
        memory = np.exp(-hop / RATE) * memory + axis * np.trace(covariance) * weight.sum()
    turning /= np.maximum(np.linalg.norm(turning, axis=0), np.sqrt(0.5))
    expected = (turning * padded).sum(axis=0)[hop : hop + n]
    np.testing.assert_allclose(
        pca321_adaptive(acceleration, RATE, window_s=0.04), expected, atol=1e-9
    )


# --- DFT321, whole signal --------------------------------------------------------------------------------------------


def test_dft_phase_is_the_sums_wherever_the_sum_is_more_than_rounding() -> None:
    wave = noise(1000)
    acceleration = np.outer((1.0, -3.0, 2.0 + 1e-9), wave)
    # The sum points with the wave, the strongest axis against it.
    expected = np.linalg.norm((1.0, -3.0, 2.0)) * wave
    np.testing.assert_allclose(REDUCERS["dft321"](acceleration, RATE), expected, atol=1e-4)


@pytest.mark.parametrize("n", [1, 2, 3, 64, 97, 1000, 1009])
def test_dft_is_equations_3_and_4(n: int) -> None:
    acceleration = noise(3, n, seed=n)
    np.testing.assert_allclose(
        REDUCERS["dft321"](acceleration, RATE), brute_dft321(acceleration), atol=1e-12
    )


@settings(max_examples=200)
@given(LENGTHS.flatmap(finite))
def test_dft_keeps_the_energy_and_the_spectrum_of_any_finite_input(
    acceleration: np.ndarray,
) -> None:
    reduced = REDUCERS["dft321"](acceleration, RATE)
    peak = np.abs(acceleration).max()
    if peak > 0:
        energy = ((acceleration / peak) ** 2).sum()
        assert ((reduced / peak) ** 2).sum() == pytest.approx(energy, rel=1e-12)
    details = spectral_match_details(acceleration, reduced, RATE)
    assert details.reason or details.value == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("offset", [10.0, 1e4, 1e5])
def test_dft_spectral_match_survives_a_large_offset(offset: float) -> None:
    acceleration = noise(3, 5000) + offset
    assert spectral_match(
        acceleration, REDUCERS["dft321"](acceleration, RATE), RATE
    ) == pytest.approx(1.0, abs=1e-9)


def test_dft_offset_and_nyquist_keep_their_sign() -> None:
    alternating = np.cos(np.pi * np.arange(48))
    np.testing.assert_allclose(
        REDUCERS["dft321"](np.outer((2.0, -6.0, 3.0), alternating), RATE), -7 * alternating
    )
    np.testing.assert_allclose(
        REDUCERS["dft321"](np.outer((-1.0, -2.0, 2.0), np.ones(48)), RATE), -3 * np.ones(48)
    )


@pytest.mark.parametrize("size", [0.0, 1e-16, 1e-15])
def test_dft_phase_is_never_set_by_rounding(size: float) -> None:
    """Where the sum vanishes, the strongest axis's phase: the output is that axis's waveform, not one of the noise."""
    wave = noise(2048)
    rounding = size * noise(2048, seed=5)
    reduced = REDUCERS["dft321"](np.array([wave, -wave + rounding, 0 * wave]), RATE)
    np.testing.assert_allclose(reduced, np.sqrt(2) * wave, atol=1e-9)


def test_dft_takes_the_strongest_axis_where_the_sum_vanishes() -> None:
    wave = noise(999)
    reduced = REDUCERS["dft321"](np.outer((1.0, -3.0, 2.0), wave), RATE)
    np.testing.assert_allclose(reduced, -np.sqrt(14) * wave, atol=1e-9)


# --- DFT321, windowed ----------------------------------------------------------------------------------------------


@settings(max_examples=150)
@given(n=st.integers(1, 300), window=st.integers(2, 500), seed=st.integers(0, 1000))
def test_three_equal_axes_give_sqrt_three_up_to_both_ends(n: int, window: int, seed: int) -> None:
    wave = noise(n, seed=seed)
    for reducer in (dft321_windowed, pca321_adaptive):
        reduced = reducer(np.array([wave, wave, wave]), RATE, window_s=window / RATE)
        np.testing.assert_allclose(
            reduced, np.sqrt(3) * wave, rtol=0, atol=1e-12 * np.abs(wave).max()
        )


def test_windowed_dft_against_a_loop_over_frames() -> None:
    n, hop = 217, 18
    acceleration = noise(3, n)
    window = np.sqrt(0.5 - 0.5 * np.cos(2 * np.pi * np.arange(2 * hop) / (2 * hop)))
    padded = np.pad(acceleration, ((0, 0), (hop, 3 * hop)))
    total = np.zeros(padded.shape[1])
    for start in range(0, n + hop, hop):
        total[start : start + 2 * hop] += window * brute_dft321(
            window * padded[:, start : start + 2 * hop]
        )
    reduced = dft321_windowed(acceleration, RATE, window_s=0.036)
    np.testing.assert_allclose(reduced, total[hop : hop + n], atol=1e-12)


def test_default_window_is_35_ms() -> None:
    acceleration = noise(3, 4000)
    default = REDUCERS["dft321_windowed"](acceleration, 10000.0)
    np.testing.assert_array_equal(default, dft321_windowed(acceleration, 10000.0, window_s=0.035))
    assert not np.allclose(default, dft321_windowed(acceleration, 10000.0, window_s=0.030))


@pytest.mark.parametrize("window", [0.0, -0.01, np.nan, np.inf])
def test_a_window_is_a_time_above_zero(window: float) -> None:
    with pytest.raises(ValueError, match="window_s"):
        dft321_windowed(noise(3, 50), RATE, window_s=window)
