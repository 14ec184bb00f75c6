"""Golden vectors: inputs whose outputs are known as closed forms, or from the defining sums, never from our reducers.

They were chosen so that the faults seen in public code all fail: a full-wave rectified output, a half spectrum mirrored
wrongly for even lengths, squares without conjugates, a division by a vanishing sum of windows, and silence where the
sum of the axes vanishes. Where the axes cancel, equation 4 leaves the phase open; ours is that of the strongest axis.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest

from feel321.stimuli.reducers.fourier import dft321, dft321_windowed
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer

RATE_HZ = 1000.0
TOLERANCE = 1e-9
"""Largest deviation allowed, relative to the largest expected value."""

Samples: TypeAlias = "np.ndarray"


class Vector(NamedTuple):
    """Three axes, (3, n), and the output, (n,), that equations 3 and 4 give."""

    name: str
    acceleration: Samples
    expected: Samples


def along(direction: tuple[float, ...], wave: Samples) -> Samples:
    return np.array(direction)[:, None] * wave


def list_common() -> Iterator[Vector]:
    """Vectors that every form reproduces: axes that share one waveform keep it, first and last sample included."""
    rng = np.random.default_rng(321)
    for n in (1, 2, 3, 64, 97):
        wave = rng.standard_normal(n)
        yield Vector(f"equal_axes_{n}", np.array([wave, wave, wave]), 3**0.5 * wave)
        single = np.zeros((3, n))
        single[n % 3] = wave
        yield Vector(f"silent_axes_{n}", single, wave)
        coarse = np.round(8 * wave) / 8 + (n < 4)  # the shortest ones must not be silent
        for name, line, gain in (
            ("anti_phase", (1.0, -1.0, 0.0), 2**0.5),
            ("anti_phase_strongest", (1.0, -3.0, 2.0), -(14**0.5)),
            ("anti_phase_close", (1.0, -1.25, 0.25), -(2.625**0.5)),
        ):
            yield Vector(f"{name}_{n}", along(line, coarse), gain * coarse)
        # A sum that is small, but far above rounding, is still what equation 4 asks for.
        almost = (1.0, -3.0, 2.0 + 2.0**-16)
        yield Vector(
            f"almost_anti_phase_{n}", along(almost, coarse), np.linalg.norm(almost) * coarse
        )
    edge = np.zeros(97)
    edge[[0, 17, 18, 35, 36, 96]] = (1.0, -2.0, 3.0, -1.0, 2.0, 1.5)
    yield Vector("impulses_at_window_edges", along((1.0, 2.0, 2.0), edge), 3.0 * edge)
    yield Vector("offset", along((2.0, 3.0, 6.0), np.ones(50)), np.full(50, 7.0))


def sum_up(acceleration: Samples) -> Samples:
    """Equations 3 and 4 from the defining sums of the two-sided transform, one frequency after the other."""
    n = acceleration.shape[1]
    time = np.arange(n)
    reduced = np.zeros(n, dtype=complex)
    for frequency in range(n):
        wave = np.exp(-2j * np.pi * frequency * time / n)
        axes = [complex(np.dot(axis, wave)) for axis in acceleration]
        magnitude = np.sqrt(sum(abs(value) ** 2 for value in axes))
        reduced += magnitude * np.exp(1j * np.angle(sum(axes))) * np.conj(wave) / n
    return reduced.real


def list_whole() -> Iterator[Vector]:
    """Vectors for the whole-signal form: closed forms, and the defining sums evaluated term by term."""
    for n in (50, 51):
        angle = 2 * np.pi * 5 * np.arange(n) / n
        circle = np.array([np.cos(angle), np.sin(angle), np.zeros(n)])
        yield Vector(f"circular_motion_{n}", circle, 2**0.5 * np.cos(angle - np.pi / 4))
    alternating = np.cos(np.pi * np.arange(48))
    yield Vector("nyquist", along((2.0, -6.0, 3.0), alternating), -7.0 * alternating)
    rng = np.random.default_rng(2010)
    for n in (1, 2, 3, 30, 31):
        acceleration = rng.standard_normal((3, n)) * [[1.0], [2.0], [0.5]]
        yield Vector(f"by_definition_{n}", acceleration, sum_up(acceleration))


COMMON, WHOLE = list(list_common()), list(list_whole())


@pytest.mark.parametrize("vector", [*COMMON, *WHOLE], ids=lambda one: one.name)
def test_the_whole_form_gives_the_known_output(vector: Vector) -> None:
    off = np.abs(dft321(vector.acceleration, RATE_HZ) - vector.expected).max()
    assert off <= TOLERANCE * np.abs(vector.expected).max()


@pytest.mark.parametrize("window_s", [0.02, 0.035, 0.05])
@pytest.mark.parametrize("vector", COMMON, ids=lambda one: one.name)
def test_the_windowed_form_gives_the_known_output(vector: Vector, window_s: float) -> None:
    off = np.abs(
        dft321_windowed(vector.acceleration, RATE_HZ, window_s=window_s) - vector.expected
    ).max()
    assert off <= TOLERANCE * np.abs(vector.expected).max()


@pytest.mark.parametrize("window_s", [0.02, 0.035, 0.05])
def test_frames_keep_the_energy_of_a_circle_and_nearly_its_shape(window_s: float) -> None:
    angle = 2 * np.pi * 0.2 * np.arange(200)
    reduced = dft321_windowed([np.cos(angle), np.sin(angle), 0 * angle], RATE_HZ, window_s=window_s)
    expected = 2**0.5 * np.cos(angle - np.pi / 4)
    assert np.sum(reduced**2) == pytest.approx(np.sum(expected**2), rel=0.005)
    assert np.abs(reduced - expected).max() < 0.3 * np.abs(expected).max()


N_SAMPLES = 600
FREE_SIGN = {"pca321_adaptive", "dft321_principal_windowed", "pca321_matched_windowed"}
"""Reducers whose output's sign, the same for all of it, is left open."""


def take_phase_of_sum(line: Samples, wave: Samples) -> Samples:
    """Give the sign of the sum of the components; where it vanishes, that of the strongest."""
    sign = np.sign(line.sum() or line[np.argmax(np.abs(line))])
    return sign * np.linalg.norm(line) * wave


def take_length(line: Samples, wave: Samples) -> Samples:
    return np.linalg.norm(line) * wave


CLOSED_FORMS: dict[str, Callable[[Samples, Samples], Samples]] = {
    **{f"sa{axis}321": lambda line, wave, at=at: line[at] * wave for at, axis in enumerate("xyz")},
    "soc321": lambda line, wave: line.sum() * wave,
    "mag321": lambda line, wave: np.linalg.norm(line) * np.abs(wave),
    "pca321_adaptive": take_length,
    "dft321_windowed": take_phase_of_sum,
    "dft321_principal_windowed": take_length,
    **{
        f"sa{axis}321_matched_running": lambda line, wave, at=at: (
            np.sign(line[at]) * np.linalg.norm(line) * wave
        )
        for at, axis in enumerate("xyz")
    },
    "pca321_matched_windowed": take_length,
    # One gain in all bands; where the axes cancel it is limited, and there is nothing to amplify.
    "dft321_filtered": lambda line, wave: np.sign(line.sum()) * np.linalg.norm(line) * wave,
}
"""Reducer that streams -> its output for a motion along a line, (3,), with a waveform, (n,)."""


def stream(name: str, motion: Samples, *, block: int) -> Samples:
    """Feed a stream in blocks, and return its output without the latency."""
    made = StreamingReducer(name, RATE_HZ)
    parts = [made.process(motion[:, at : at + block]) for at in range(0, N_SAMPLES, block)]
    late = np.concatenate([*parts, made.flush()])
    assert late.size == N_SAMPLES + made.latency_samples
    assert not late[: made.latency_samples].any()
    return late[made.latency_samples :]


def test_every_stream_has_a_closed_form() -> None:
    assert set(CLOSED_FORMS) == set(REDUCERS) - set(WHY_NOT_STREAMING)


@pytest.mark.parametrize("block", [1, 7, 64, 480])
@pytest.mark.parametrize("line", [(1, 2, 2), (2, -6, 3), (1, -3, 2)], ids=str)
@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_a_stream_gives_the_known_output(name: str, line: tuple[float, ...], block: int) -> None:
    wave = np.round(64 * np.random.default_rng(2010).standard_normal(N_SAMPLES)) / 64
    for first, end in ((0, 3), (200, 290), (400, 480)):  # silence, at the start too
        wave[first:end] = 0.0
    expected = CLOSED_FORMS[name](np.array(line, dtype=float), wave)
    got = stream(name, along(line, wave), block=block)
    signs = (1, -1) if name in FREE_SIGN else (1,)
    off = min(np.abs(sign * got - expected).max() for sign in signs)
    assert off <= TOLERANCE * (np.abs(expected).max() or np.abs(wave).max())
