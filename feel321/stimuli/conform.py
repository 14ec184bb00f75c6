"""Golden vectors for DFT321: a test of any implementation, in any language, against the paper.

`check_dft321` tries a Python callable; `feel321 port FOLDER` (`feel321.stimuli.port`) writes the same vectors as files
and checks the answers that a MATLAB or C++ port put beside them. Expected outputs are closed forms or come from the
defining sums, never from this package's own reducers. The vectors were chosen so that the faults seen in public code
all fail: a full-wave rectified output, a half spectrum mirrored wrongly for even lengths, squares without conjugates,
a division by a vanishing sum of windows, and silence where the sum of the axes vanishes.

Equation 4 is the angle of the sum of the axes. Where that sum is zero it leaves the phase open, and any phase agrees
with the paper; ours is that of the strongest axis. Such a frequency is judged by what the equations do decide:

- the output has n real, finite samples, and no frequency holds more than equation 3 gives it;
- a Hermitian spectrum keeps every magnitude. One whose phases at f and -f were set by rounding, each by its own, keeps
  less in its real part: at some frequency all of it, and a fifth of the energy in vectors of 64 samples or more;
- in frames a phase that is set by rounding moves energy to where the window is zero. There is no more to be checked
  than 1 % to 200 % of the energy, and only in vectors that are longer than a frame.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from feel321.doors import check_name
from feel321.records import Result
from feel321.types import Form, Samples

FORMS = ("whole", "windowed")
RATE_HZ = 1000
SQRT_2, SQRT_3, SQRT_14 = 2**0.5, 3**0.5, 14**0.5
TOLERANCE = 1e-9
"""Largest deviation allowed, relative to the largest expected value, in float64."""
FILE_TOLERANCE = 1e-5
"""The same for answers in files, which may be computed in float32."""
ENERGY_TOLERANCE = 0.005
"""Largest relative deviation of the energy, also where the shape has slack."""

CANCELS = 1e-12
"""A sum of axes up to this share of their strength is zero: equation 4 leaves the phase open."""
LONG = 64
"""Samples from which on the energy of an open phase is judged: the axes of shorter ones hold few frequencies."""
WHOLE_KEPT, LEAST_KEPT = 0.99, 0.2
"""Of an open phase: the share of its magnitude that some frequency keeps, and of the energy that all of them keep."""
SEVERAL, SILENT = 10, 1e-6
"""Of more open frequencies than that, a fifth below that share of their magnitude is no matter of rounding."""
IN_FRAMES = (0.01, 2.0)
"""Energy of an open phase in frames: 0.02 to 0.74 in honest ones; frames that overlap by half at most double it."""


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


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Conformity(Result):
    """How an implementation that conforms answered the golden vectors.

    Parameters
    ----------
    form : str
        "whole" or "windowed"; for streams, the reducer's name.
    vectors : int
        Vectors tried.
    off : float
        Largest deviation from the expected output where the equations decide it, as a share of the peak.
    differing : tuple of str
        Vectors with another output than ours because equation 4 leaves their phase open.
    energy : float
        Least share of the energy that is kept in them; 1 if there are none.
    """

    form: str
    vectors: int
    off: float
    differing: tuple[str, ...] = ()
    energy: float = 1.0

    @property
    def verdict(self) -> str:
        """The outcome in words; the third one, "does not conform", is an error."""
        if not self.differing:
            return "agrees"
        count = len(self.differing)
        return f"agrees with the paper; differs where the paper leaves the phase open ({count})"

    @property
    def notes(self) -> tuple[str, ...]:
        """What the difference means, one sentence each."""
        found = [f"{self.verdict}; elsewhere off by at most {self.off:.1g} of the peak"]
        if self.differing:
            found.append(
                "where the axes cancel, feel321 takes the strongest axis's phase: "
                + ", ".join(self.differing)
            )
        if self.energy < 1 - ENERGY_TOLERANCE:
            found.append(
                f"there as little as {100 * self.energy:.2g} % of the energy is kept: open phases cancel each other"
            )
        return tuple(found)


def check_dft321(
    candidate: Callable[[Samples, float], Samples], *, form: Form = "whole"
) -> Conformity:
    """Raise unless a DFT321 implementation does what the paper's equations 3 and 4 say.

    Parameters
    ----------
    candidate : callable
        Called as candidate(acceleration, rate_hz) with shapes (3, n); must give n samples.
    form : {"whole", "windowed"}
        Which form the candidate implements.

    Returns
    -------
    Conformity
        Its verdict is "agrees", or that the output differs where the paper leaves the phase open, and how often.

    Raises
    ------
    ValueError
        One line that names every vector that failed, and how: the implementation does not conform.

    Notes
    -----
    Where the axes cancel at a frequency, equation 4 [1]_ is the angle of zero. Any phase agrees with it there, and only
    length, realness and magnitude are judged; ours is that of the strongest axis.

    References
    ----------
    .. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency
       accelerations for haptic rendering", EuroHaptics 2010. doi:10.1007/978-3-642-14075-4_12

    Examples
    --------
    >>> import numpy as np
    >>> from feel321 import stimuli
    >>> stimuli.check_dft321(stimuli.REDUCERS.dft321).verdict
    'agrees'
    >>> def published(acceleration, rate_hz):
    ...     spectra = np.fft.rfft(acceleration)
    ...     magnitude = np.sqrt((abs(spectra) ** 2).sum(axis=0))
    ...     return np.fft.irfft(magnitude * np.exp(1j * np.angle(spectra.sum(axis=0))), acceleration.shape[1])
    >>> stimuli.check_dft321(published).verdict
    'agrees with the paper; differs where the paper leaves the phase open (13)'
    >>> stimuli.check_dft321(lambda acceleration, rate_hz: abs(published(acceleration, rate_hz)))
    Traceback (most recent call last):
    ...
    ValueError: dft321 does not conform: ...
    """
    judged: list[Judged] = []
    for vector in golden_vectors(form):
        try:
            output = candidate(vector.acceleration.copy(), float(RATE_HZ))
        except Exception as error:  # noqa: BLE001 - whatever a foreign implementation raises is its fault to report
            judged.append(
                Judged(vector.name, (f"{vector.name}: raised {type(error).__name__}: {error}",))
            )
        else:
            judged.append(judge(vector, output, form=form))
    return conclude(judged, form=form)


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


@dataclass(frozen=True, slots=True)
class Judged:
    """One vector's outcome; off: of the peak, where the output is decided; energy: where it is open and differs."""

    name: str
    faults: tuple[str, ...] = ()
    off: float = 0.0
    energy: float | None = None


def conclude(judged: Sequence[Judged], *, form: str, name: str = "dft321") -> Conformity:
    """Sum up, or raise with every fault."""
    if faults := [fault for one in judged for fault in one.faults]:
        raise ValueError(f"{name} does not conform: {'; '.join(faults)}")
    kept = {one.name: one.energy for one in judged if one.energy is not None}
    off = max((one.off for one in judged), default=0.0)
    return Conformity(form, len(judged), off, tuple(kept), min([1.0, *kept.values()]))


def judge(
    vector: GoldenVector, output: object, *, form: str, tolerance: float = TOLERANCE
) -> Judged:
    """Compare an output with what the equations decide of it."""
    got, name = np.asarray(output), vector.name
    if fault := find_misshape(got, vector.expected.shape):
        return Judged(name, (f"{name}: {fault}",))
    off = float(np.abs(got - vector.expected).max() / np.abs(vector.expected).max())
    energy = float(np.vdot(got, got) / np.vdot(vector.expected, vector.expected))
    allowed, is_whole = max(tolerance, vector.slack), form == "whole"
    is_open = find_open(vector.acceleration).any() if is_whole else cancels(vector.acceleration)
    if off <= allowed or not is_open:
        faults = tuple(_list_deviations(name, off=off, allowed=allowed, energy=energy))
        return Judged(name, faults, off * (not vector.slack))
    if is_whole:
        return Judged(name, tuple(_judge_bins(vector, got, tolerance)), energy=energy)
    return Judged(name, tuple(judge_frames(name, energy, got.size)), energy=energy)


def find_misshape(got: NDArray[Any], shape: tuple[int, ...]) -> str:
    """Say what is wrong with an output of another shape or kind; nothing if it can be compared."""
    if got.shape != shape:
        return f"got shape {got.shape}, expected {shape}"
    is_real = not np.iscomplexobj(got) and np.all(np.isfinite(got))
    return "" if is_real else "got values that are complex or not finite"


def find_open(acceleration: Samples) -> NDArray[np.bool_]:
    """Find the frequencies of the half spectrum, (n_bins,), at which there is energy, but the axes cancel."""
    spectra = np.fft.rfft(acceleration)
    size = np.sqrt((np.abs(spectra) ** 2).sum(axis=0))
    is_strong = size > CANCELS * size.max(initial=0.0)
    open_ = is_strong & (np.abs(spectra.sum(axis=0)) <= CANCELS * size.max(initial=0.0))
    return np.asarray(open_)


def _list_deviations(name: str, *, off: float, allowed: float, energy: float) -> Iterator[str]:
    if off > allowed:
        yield f"{name}: off by {off:.2g} of the peak, more than {allowed:g}"
    if abs(energy - 1) > ENERGY_TOLERANCE:
        yield f"{name}: holds {energy:.3g} times the energy, must be 1 +- {ENERGY_TOLERANCE:g}"


def _judge_bins(vector: GoldenVector, got: Samples, tolerance: float) -> Iterator[str]:
    """Judge a whole signal frequency by frequency: all of it where the phase is decided, its magnitude where not."""
    there, wanted = np.fft.rfft(got), np.fft.rfft(vector.expected)
    is_open, slack = find_open(vector.acceleration), tolerance * np.abs(wanted).max()
    if np.any(np.abs(there - wanted)[~is_open] > slack):
        yield f"{vector.name}: differs at a frequency whose phase is decided"
    if np.any(np.abs(there[is_open]) > np.abs(wanted[is_open]) + slack):
        yield f"{vector.name}: stronger at a frequency than equation 3 allows"
    shares = np.abs(there[is_open]) / np.abs(wanted[is_open])
    energy = (np.abs(there[is_open]) ** 2).sum() / (np.abs(wanted[is_open]) ** 2).sum()
    if shares.size > SEVERAL and (shares < SILENT).mean() > LEAST_KEPT:
        yield f"{vector.name}: silent at frequencies where the axes cancel; equation 3 gives their magnitude"
    if shares.max() < WHOLE_KEPT or (got.size >= LONG and energy < LEAST_KEPT):
        yield (
            f"{vector.name}: holds {energy:.2g} times the energy where the axes cancel; equation 4 leaves the phase "
            "open there, equation 3 not the magnitude"
        )


def cancels(acceleration: Samples) -> bool:
    """Find out whether the axes, (3, n), cancel in every sample, and so in every frame; NaN is a missing sample."""
    most = float(np.nanmax(np.abs(acceleration), initial=0.0))
    return bool(np.nanmax(np.abs(acceleration.sum(axis=0))) <= CANCELS * most)


def judge_frames(name: str, energy: float, n_samples: int) -> Iterator[str]:
    """Judge frames whose phases are open: by their energy, and that only where there are several."""
    low, high = IN_FRAMES
    if energy > high or (n_samples >= LONG and energy < low):
        yield f"{name}: holds {energy:.2g} times the energy where the axes cancel, must be {low:g} to {high:g}"
