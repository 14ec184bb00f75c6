"""How different every stimulus of a set feels from its recording's original.

Counted is what lies between 20 and 1000 Hz, in multiples of the vibrotactile threshold
(`feel321.stimuli.thresholds`); axes add by energy, because the hand hardly distinguishes directions of
vibration [1]_. Four differences are kept apart:

- *spectral*: root mean square difference, over frequencies evenly spaced in octaves, of the levels above threshold in
  bands as wide as people confuse (22 %). The stimulus is brought to the felt level of the original first, and what
  then is below threshold counts as silent: 0 dB.
- *envelope*: the part of the original's envelope that no factor on the stimulus's envelope explains, as a share of it
  (the sine between the two). Envelopes are root mean squares, smoothed to below 50 Hz.
- *level*: difference of the felt levels.
- *direction*: half the summed difference between the shares of energy in the three principal directions. A stimulus on
  one axis has all of it in one; against its original it loses the share outside the strongest, whatever its axis. All
  stimuli on one axis lose the same.

A fourth number is no difference: how far a stimulus on one axis follows the *vector magnitude* of its original, as the
correlation of the two between 20 and 1000 Hz, without its sign.

A factor on a stimulus changes the level alone. A stimulus that is below threshold as a whole counts as silence.

Two stimuli of a recording are compared with each other in the same way: two that are equally far from the original
need not be equal.

References
----------
.. [1] N. Landin, J. M. Romano, W. McMahan, K. J. Kuchenbecker, "Dimensional reduction of high-frequency accelerations
   for haptic rendering", EuroHaptics 2010 (directions of vibration are not distinguished).
   doi:10.1007/978-3-642-14075-4_12
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet

ENVELOPE_HZ = 50.0
"""Where smoothing has halved an envelope's power: slower changes are felt as such, faster ones as roughness."""

ENVELOPE_STEP_S = 1e-3  # distance of an envelope's samples


ONE_AXIS = np.array([
    0.0,
    0.0,
    1.0,
])  # shares of the energy in principal directions, the strongest last


@dataclass(frozen=True, slots=True)
class Percept:
    """The differences by which the hand distinguishes a stimulus from its recording's original."""

    spectral_db: float
    envelope: float
    level_db: float
    sensation: Sensation | None = field(default=None, compare=False, repr=False)
    direction: float = 0.0
    vector_magnitude: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Sensation:
    """A vibration as the hand senses it; bands: (n_frequencies,), envelope: (n_steps,), directions: (3,) shares."""

    level: float
    bands: NDArray[np.float64]
    envelope: NDArray[np.float64]
    directions: NDArray[np.float64] = field(default_factory=lambda: ONE_AXIS)


def read_percepts(stimuli: StimulusSet) -> dict[str, Percept]:
    """Read all files of a set once and measure how each differs from its recording's original."""
    sensed: dict[str, tuple[Sensation, NDArray[np.complex128]]] = {}
    percepts = {}
    for stimulus in stimuli.stimuli:
        original = _find_original(stimulus, stimuli.stimuli)
        if original.stimulus_id not in sensed:
            samples, rate_hz = _read(original, stimuli.folder)
            sensed[original.stimulus_id] = sense(samples, rate_hz), find_vibration(samples, rate_hz)
        there, magnitude = sensed[original.stimulus_id]
        if stimulus == original:
            percepts[stimulus.stimulus_id] = compare_sensations(there, there)
            continue
        samples, rate_hz = _read(stimulus, stimuli.folder)
        percept = compare_sensations(sense(samples, rate_hz), there)
        if samples.ndim == 1:
            followed = correlate_vibrations(find_vibration(samples, rate_hz), magnitude)
            percept = replace(percept, vector_magnitude=followed)
        percepts[stimulus.stimulus_id] = percept
    return percepts


def find_vibration(samples: NDArray[np.float64], rate_hz: float) -> NDArray[np.complex128]:
    """Find what of a signal, (n_samples,), or of the length of a vector, (3, n_samples), is felt as vibration."""
    from scipy import fft

    from feel321.stimuli.match import HIGHEST_HZ, LOWEST_HZ

    length = samples if samples.ndim == 1 else np.sqrt(np.square(samples).sum(axis=0))
    padded = fft.next_fast_len(length.size, real=True)
    spectrum, frequency = fft.rfft(length, padded), fft.rfftfreq(padded, 1 / rate_hz)
    return np.asarray(spectrum[(frequency >= LOWEST_HZ) & (frequency <= HIGHEST_HZ)])


def correlate_vibrations(first: NDArray[np.complex128], second: NDArray[np.complex128]) -> float:
    """Correlate two vibrations by Parseval's theorem, without the sign, 0 to 1; nothing goes along with silence."""
    strength = float(np.linalg.norm(first) * np.linalg.norm(second))
    return abs(float(np.vdot(first, second).real)) / strength if strength else 0.0


def sense(acceleration: NDArray[np.float64], rate_hz: float) -> Sensation:
    """Compute what the hand senses of a vibration, shape (n_samples,) or (3, n_samples), in m/s²."""
    from scipy import fft

    from feel321.stimuli.match import WEBER_FRACTION, WeberSmoothing, log_grid
    from feel321.stimuli.thresholds import acceleration_threshold, felt_level

    n = acceleration.shape[-1]
    # Lengths with large prime factors cost ten times as much.
    padded = fft.next_fast_len(n, real=True)
    spacing = rate_hz / padded
    grid = log_grid(n, rate_hz)
    smooth = WeberSmoothing(grid, spacing, padded // 2 + 1)
    spectrum = fft.rfft(np.atleast_2d(acceleration), padded)
    spectrum[:, : smooth.bins.start] = spectrum[:, smooth.bins.stop :] = 0.0
    frequency = np.arange(smooth.bins.start, smooth.bins.stop) * spacing
    # The threshold's peak; ours are powers.
    spectrum[:, smooth.bins] /= acceleration_threshold(frequency) / np.sqrt(2)
    energy = np.sum(np.abs(spectrum[:, smooth.bins]) ** 2, axis=0)
    bands = smooth(energy) * (WEBER_FRACTION * grid / spacing) * 2 / n / padded
    envelope = _smooth_envelope(np.sum(fft.irfft(spectrum, padded)[:, :n] ** 2, axis=0), rate_hz)
    level = felt_level(acceleration, rate_hz)
    is_felt = level >= 1.0
    directions = _share_directions(spectrum[:, smooth.bins]) if is_felt else ONE_AXIS
    return Sensation(max(level, 1.0), bands * is_felt, envelope * is_felt, directions)


def _share_directions(spectrum: NDArray[np.complex128]) -> NDArray[np.float64]:
    energies = np.linalg.eigvalsh((spectrum @ spectrum.conj().T).real)
    shares = np.pad(np.maximum(energies, 0.0), (ONE_AXIS.size - energies.size, 0))
    return shares / shares.sum() if shares.any() else ONE_AXIS


def compare_sensations(stimulus: Sensation, original: Sensation) -> Percept:
    """Measure how a stimulus differs from an original."""
    pairs = (stimulus.envelope, original.envelope), (stimulus.bands, original.bands)
    if any(one.shape != other.shape for one, other in pairs):
        raise ValueError(
            "percepts: a stimulus and its original must have the same length and rate, got "
            f"{stimulus.envelope.size} ms and {original.envelope.size} ms; build the stimulus set again"
        )
    ratio = stimulus.level / original.level
    strengths = np.linalg.norm(stimulus.envelope), np.linalg.norm(original.envelope)
    residue = float(any(strengths))
    if all(strengths):
        shape, wanted = stimulus.envelope / strengths[0], original.envelope / strengths[1]
        residue = float(np.linalg.norm(wanted - (wanted @ shape) * shape))
    felt, meant = (
        10 * np.log10(np.maximum(bands, 1.0))
        for bands in (stimulus.bands / ratio**2, original.bands)
    )
    return Percept(
        spectral_db=float(np.sqrt(np.mean((felt - meant) ** 2))),
        envelope=residue,
        level_db=float(20 * np.log10(ratio)),
        sensation=stimulus,
        direction=float(np.abs(stimulus.directions - original.directions).sum() / 2),
    )


def compare_percepts(first: Percept, second: Percept) -> Percept:
    """Measure how two stimuli of a recording differ from each other; their order does not matter."""
    near, far = sorted(
        (first, second), key=lambda lost: (lost.spectral_db, lost.envelope, lost.level_db)
    )
    if near.sensation and far.sensation:
        return compare_sensations(far.sensation, near.sensation)
    return Percept(
        spectral_db=far.spectral_db - near.spectral_db,
        envelope=abs(far.envelope - near.envelope),
        level_db=far.level_db - near.level_db,
        direction=abs(far.direction - near.direction),
    )


def _smooth_envelope(energy: NDArray[np.float64], rate_hz: float) -> NDArray[np.float64]:
    from scipy.ndimage import gaussian_filter1d

    step = max(round(ENVELOPE_STEP_S * rate_hz), 1)
    coarse = np.add.reduceat(energy, np.arange(0, energy.size, step)) / step
    # A Gaussian, because it does not ring: the mean of squares stays positive.
    deviation_s = np.sqrt(np.log(2)) / (2 * np.pi * ENVELOPE_HZ)
    return np.sqrt(gaussian_filter1d(coarse, deviation_s * rate_hz / step, mode="constant"))


def _find_original(stimulus: Stimulus, stimuli: Iterable[Stimulus]) -> Stimulus:
    from feel321.stimuli.sets.recipe import ORIGINAL

    wanted = (stimulus.recording, "reference", ORIGINAL)
    candidates = [
        other for other in stimuli if (other.recording, other.role, other.reducer) == wanted
    ]
    if not candidates:
        raise ValueError(
            f"recording {stimulus.recording!r}: the stimulus set must hold its three-axis original, from which the "
            "observer's threshold_spectral, envelope, level, direction and vector_magnitude are measured; set these "
            "weights to 0, or set "
            '[stimuli] reference = "original" and build again'
        )
    # A set may hold an original per level arm: the arm's own comes first.
    return next((other for other in candidates if other.level == stimulus.level), candidates[0])


def _read(stimulus: Stimulus, folder: Path) -> tuple[NDArray[np.float64], float]:
    """Read a stimulus, in m/s²."""
    from feel321.stimuli.wav import read_wav

    samples, rate_hz = read_wav(folder / stimulus.file)
    rms = float(np.sqrt(np.sum(samples**2) / samples.shape[-1]))
    # A file holds shares of full scale; the manifest says how much acceleration that is.
    return samples * (stimulus.rms_m_s2 / rms if rms else 0.0), rate_hz
