"""Golden vectors for DFT321: a test of any implementation, in any language, against the paper.

`check_dft321` tries a Python callable; `python -m feel321.stimuli write-vectors FOLDER` writes the
same vectors as three-channel WAV files, and `python -m feel321.stimuli check-vectors FOLDER` checks
the one-channel files `NAME.out.wav` that a MATLAB or C++ port put beside them. Expected outputs are
closed forms or come from the defining sums, never from this package's own reducers. The vectors
were chosen so that the faults seen in public code all fail: a full-wave rectified output, a half
spectrum mirrored wrongly for even lengths, squares without conjugates, and a division by a
vanishing sum of windows.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from feel321.doors import check_name
from feel321.stimuli.wav import read_wav, write_wav
from feel321.types import Form, Samples

FORMS = ("whole", "windowed")
RATE_HZ = 1000
SQRT_2, SQRT_3, SQRT_14 = 2**0.5, 3**0.5, 14**0.5
TOLERANCE = 1e-9
"""Largest deviation allowed, relative to the largest expected value, in float64."""
WAV_TOLERANCE = 1e-5
"""The same for float32 files."""
ENERGY_TOLERANCE = 0.005
"""Largest relative deviation of the energy, also where the shape has slack."""


@dataclass(frozen=True, slots=True, eq=False)
class GoldenVector:
    """Three axes, (3, n_samples), and the output, (n_samples,), that equations 3 and 4 give."""

    name: str
    acceleration: Samples
    expected: Samples
    slack: float = 0.0


def golden_vectors(form: Form = "whole") -> tuple[GoldenVector, ...]:
    """List the vectors, at 1000 Hz, that a conforming DFT321 must reproduce.

    A form is one transform over the whole signal, or short overlapping frames; for the latter only those vectors are
    listed whose output does not, or hardly, depend on where the frames lie.
    """
    check_name(form, FORMS, "form")
    return (*_everywhere(), *(_whole_only() if form == "whole" else _windowed_only()))


def check_dft321(candidate: Callable[[Samples, float], Samples], *, form: Form = "whole") -> None:
    """Raise unless a DFT321 implementation reproduces every golden vector.

    Parameters
    ----------
    candidate : callable
        Called as candidate(acceleration, rate_hz) with shapes (3, n); must give n samples.
    form : {"whole", "windowed"}
        Which form the candidate implements.

    Raises
    ------
    ValueError
        One line that names every vector that failed, and how.

    Examples
    --------
    >>> from feel321 import stimuli
    >>> stimuli.check_dft321(stimuli.REDUCERS.dft321)
    >>> stimuli.check_dft321(lambda acceleration, rate_hz: abs(stimuli.REDUCERS.dft321(acceleration, rate_hz)))
    Traceback (most recent call last):
    ...
    ValueError: dft321 does not conform: ...
    """
    faults: list[str] = []
    for vector in golden_vectors(form):
        try:
            output = candidate(vector.acceleration.copy(), float(RATE_HZ))
        except Exception as error:  # noqa: BLE001 - whatever a foreign implementation raises is its fault to report
            faults.append(f"{vector.name}: raised {type(error).__name__}: {error}")
        else:
            faults.extend(_faults(vector, output, TOLERANCE))
    _raise(faults)


def write_vectors(folder: Path, *, form: Form = "whole") -> list[Path]:
    """Write the inputs as three-channel float32 WAV files, for a port in another language."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for vector in golden_vectors(form):
        paths.append(folder / f"{vector.name}.wav")
        write_wav(paths[-1], vector.acceleration, RATE_HZ)
    return paths


def check_outputs(folder: Path, *, form: Form = "whole") -> None:
    """Raise unless the files NAME.out.wav hold the expected outputs."""
    faults: list[str] = []
    for vector in golden_vectors(form):
        path = folder / f"{vector.name}.out.wav"
        if path.is_file():
            faults.extend(_faults(vector, read_wav(path)[0], WAV_TOLERANCE))
        else:
            faults.append(f"{vector.name}: {path.name} is missing")
    _raise(faults)


def _everywhere() -> Iterator[GoldenVector]:
    """Vectors that every form reproduces: axes that share one waveform keep it, first and last sample included."""
    rng = np.random.default_rng(321)
    for n in (1, 2, 3, 64, 97):
        wave = rng.standard_normal(n)
        yield GoldenVector(f"equal_axes_{n}", np.array([wave, wave, wave]), SQRT_3 * wave)
        # One axis at a time, so that an implementation cannot pass by looking at one of them only.
        axis = n % 3
        single = np.zeros((3, n))
        single[axis] = wave
        yield GoldenVector(f"silent_axes_{n}", single, wave)
        # Few bits, so that the axes cancel in float32 too; the strongest, x among equals, then gives the phase.
        coarse = np.round(8 * wave) / 8 + (n < 4)  # noqa: PLR2004 - the shortest ones must not be silent
        yield GoldenVector(f"anti_phase_{n}", _along((1.0, -1.0, 0.0), coarse), SQRT_2 * coarse)
        yield GoldenVector(
            f"anti_phase_strongest_{n}", _along((1.0, -3.0, 2.0), coarse), -SQRT_14 * coarse
        )
        yield GoldenVector(
            f"anti_phase_close_{n}", _along((1.0, -1.25, 0.25), coarse), -(2.625**0.5) * coarse
        )
        # A sum that is small, but far above rounding, is still what equation 4 asks for.
        almost = (1.0, -3.0, 2.0 + 2.0**-16)
        yield GoldenVector(
            f"almost_anti_phase_{n}", _along(almost, coarse), np.linalg.norm(almost) * coarse
        )
    edge = np.zeros(97)
    edge[[0, 17, 18, 35, 36, 96]] = (1.0, -2.0, 3.0, -1.0, 2.0, 1.5)
    yield GoldenVector("impulses_at_window_edges", _along((1.0, 2.0, 2.0), edge), 3.0 * edge)
    yield GoldenVector("offset", _along((2.0, 3.0, 6.0), np.ones(50)), np.full(50, 7.0))


def _whole_only() -> Iterator[GoldenVector]:
    """Vectors for the whole-signal form: closed forms, and the defining sums evaluated term by term."""
    for n in (50, 51):
        angle = 2 * np.pi * 5 * np.arange(n, dtype=np.float64) / n
        circle = np.array([np.cos(angle), np.sin(angle), np.zeros(n)], dtype=np.float64)
        yield GoldenVector(f"circular_motion_{n}", circle, SQRT_2 * np.cos(angle - np.pi / 4))
    alternating = np.cos(np.pi * np.arange(48, dtype=np.float64))
    yield GoldenVector("nyquist", _along((2.0, -6.0, 3.0), alternating), -7.0 * alternating)
    rng = np.random.default_rng(2010)
    for n in (1, 2, 3, 30, 31):
        acceleration = rng.standard_normal((3, n)) * np.array([[1.0], [2.0], [0.5]])
        yield GoldenVector(f"by_definition_{n}", acceleration, _by_definition(acceleration))


def _windowed_only() -> Iterator[GoldenVector]:
    """Circular motion in frames: its energy must be kept; its shape changes where it is cut (25 % of the peak)."""
    angle = 2 * np.pi * 0.2 * np.arange(200, dtype=np.float64)
    circle = np.array([np.cos(angle), np.sin(angle), np.zeros(200)], dtype=np.float64)
    yield GoldenVector(
        "circular_motion_in_frames", circle, SQRT_2 * np.cos(angle - np.pi / 4), slack=0.3
    )


def _along(direction: tuple[float, float, float], wave: Samples) -> Samples:
    return np.array(direction)[:, None] * wave


def _by_definition(acceleration: Samples) -> Samples:
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


def _faults(vector: GoldenVector, output: object, tolerance: float) -> Iterator[str]:
    got = np.asarray(output)
    if got.shape != vector.expected.shape:
        yield f"{vector.name}: got shape {got.shape}, expected {vector.expected.shape}"
    elif np.iscomplexobj(got) or not np.all(np.isfinite(got)):
        yield f"{vector.name}: got values that are complex or not finite"
    else:
        off = float(np.abs(got - vector.expected).max() / np.abs(vector.expected).max())
        allowed = max(tolerance, vector.slack)
        if off > allowed:
            yield f"{vector.name}: off by {off:.2g} of the peak, more than {allowed:g}"
        energy = float(np.vdot(got, got) / np.vdot(vector.expected, vector.expected))
        if abs(energy - 1) > ENERGY_TOLERANCE:
            yield f"{vector.name}: holds {energy:.3g} times the energy, must be 1 +- {ENERGY_TOLERANCE:g}"


def _raise(faults: list[str]) -> None:
    if faults:
        raise ValueError(f"dft321 does not conform: {'; '.join(faults)}")
