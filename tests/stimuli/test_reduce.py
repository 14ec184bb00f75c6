import numpy as np
import pytest

from feel321.stimuli.reducers.axes import pca321_adaptive
from feel321.stimuli.reducers.fourier import dft321_windowed
from feel321.stimuli.reducers.registry import REDUCERS

CONTRACT = [
    "sax321", "say321", "saz321", "soc321", "mag321", "pca321", "pca321_adaptive", "dft321", "dft321_windowed",
    "dft321_principal", "dft321_principal_windowed", "sax321_matched", "say321_matched", "saz321_matched",
    "pca321_matched", "sax321_matched_running", "say321_matched_running", "saz321_matched_running",
    "pca321_matched_windowed", "dft321_bands", "dft321_filtered",
]  # fmt: skip
RATE = 1000.0


def noise(*shape: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).standard_normal(shape)


def brute_dft321(acceleration: np.ndarray) -> np.ndarray:
    """Equations 3 and 4 on the two-sided spectrum, as they stand."""
    spectra = np.fft.fft(acceleration)
    merged = np.sqrt((np.abs(spectra) ** 2).sum(axis=0)) * np.exp(
        1j * np.angle(spectra.sum(axis=0))
    )
    return np.fft.ifft(merged).real


def test_the_registry_holds_the_contract_in_its_order() -> None:
    assert list(REDUCERS) == CONTRACT


LAWS = {  # name -> (reduce, recording) -> what must be equal
    "a louder recording": lambda f, a: (f(3.0 * a), 3.0 * f(a)),
    "silence": lambda f, a: (f(0 * a), np.zeros(a.shape[-1])),
    "a batch of batches": lambda f, a: (f(np.array([[a, 2 * a]] * 2))[1, 1], f(2 * a)),
    "an empty batch": lambda f, a: (f(np.zeros((0, *a.shape))), np.zeros((0, a.shape[-1]))),
    "memory layout": lambda f, a: (f(np.asfortranarray(a)), f(a)),
    "every other sample": lambda f, a: (f(np.repeat(a, 2, axis=1)[:, ::2]), f(a)),
    "integers": lambda f, a: (f(np.round(9 * a).astype(np.int16)), f(np.round(9 * a))),
    "lists of floats": lambda f, a: (f(a.tolist()), f(a)),
    "big-endian 32 bits": lambda f, a: (f(a.astype(">f4")), f(a.astype("f4").astype("f8"))),
}
REFUSALS = {
    "three axes": np.zeros((2, 9)),
    "must be finite": np.full((3, 9), np.nan),
    "real numbers": np.ones((3, 9)) * 1j,
    "peaks from 1e-60 to 1e": np.full((3, 9), 1e70),
}


@pytest.mark.parametrize("n", [0, 1, 2, 3, 97, 333])
@pytest.mark.parametrize("name", CONTRACT)
def test_the_laws_of_every_reducer(name: str, n: int) -> None:
    acceleration = np.clip(noise(3, n, seed=n), -4, 4)
    before = acceleration.copy()

    def reduce(samples: np.ndarray) -> np.ndarray:
        return REDUCERS[name](samples, RATE)

    for law, make in LAWS.items():
        got, wanted = make(reduce, acceleration)
        np.testing.assert_allclose(got, wanted, rtol=1e-9, atol=1e-11, err_msg=law)
        assert got.dtype == np.float64
    np.testing.assert_array_equal(acceleration, before)
    assert not np.shares_memory(reduce(acceleration), acceleration)
    for message, samples in REFUSALS.items():
        with pytest.raises(ValueError, match=message):
            reduce(samples)
    with pytest.raises(ValueError, match="rate_hz"):
        REDUCERS[name](acceleration, 0.0)


@pytest.mark.parametrize("tiny", [0.0, 2e-16, -2e-16, 1e-15])
@pytest.mark.parametrize("name", ["pca321", "pca321_adaptive", "dft321"])
def test_no_sign_or_phase_is_left_to_rounding_where_the_sum_vanishes(
    name: str, tiny: float
) -> None:
    wave = noise(400)
    wave -= wave.mean()
    reduced = REDUCERS[name](np.array([wave, -wave * (1 + tiny), 0 * wave]), RATE)
    np.testing.assert_allclose(reduced, np.sqrt(2) * wave, atol=1e-9)


# --- PCA -----------------------------------------------------------------------------------------------------------


def test_pca_keeps_the_largest_energy_that_a_fixed_axis_can() -> None:
    acceleration = noise(3, 500) * np.array([[1.0], [3.0], [2.0]]) + 5.0
    largest = np.linalg.eigvalsh(np.cov(acceleration, ddof=0))[-1]
    reduced = REDUCERS["pca321"](acceleration, RATE)
    assert reduced.mean() == pytest.approx(0.0, abs=1e-12)
    assert reduced.var() == pytest.approx(largest, rel=1e-12)


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


# --- DFT321, windowed ----------------------------------------------------------------------------------------------


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
