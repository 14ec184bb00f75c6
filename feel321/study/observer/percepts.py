"""How different every stimulus of a set feels from its recording's original.

Counted is what lies between 20 and 1000 Hz, in multiples of the vibrotactile threshold
(`feel321.stimuli.sets.anchors`); axes add by energy, because the hand cannot distinguish directions of
vibration [1]_. Three differences are kept apart:

- *spectral*: root mean square difference, over frequencies evenly spaced in octaves, of the levels above threshold in
  bands as wide as people confuse (22 %). The stimulus is brought to the felt level of the original first, and what
  then is below threshold counts as silent: 0 dB.
- *envelope*: the part of the original's envelope that no factor on the stimulus's envelope explains, as a share of it
  (the sine between the two). Envelopes are root mean squares, smoothed to below 50 Hz.
- *level*: difference of the felt levels.

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

from dataclasses import dataclass, field
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


@dataclass(frozen=True, slots=True)
class Percept:
    """The differences by which the hand distinguishes a stimulus from its recording's original."""

    spectral_db: float
    envelope: float
    level_db: float
    sensation: Sensation | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class Sensation:
    """A vibration as the hand senses it; bands: (n_frequencies,), envelope: (n_steps,)."""

    level: float
    bands: NDArray[np.float64]
    envelope: NDArray[np.float64]


def read_percepts(stimuli: StimulusSet) -> dict[str, Percept]:
    """Read all files of a set once and measure how each differs from its recording's original."""
    sensed: dict[str, Sensation] = {}
    percepts = {}
    for stimulus in stimuli.stimuli:
        original = _find_original(stimulus, stimuli.stimuli)
        if original.stimulus_id not in sensed:
            sensed[original.stimulus_id] = _read(original, stimuli.folder)
        there = sensed[original.stimulus_id]
        here = there if stimulus == original else _read(stimulus, stimuli.folder)
        percepts[stimulus.stimulus_id] = compare_sensations(here, there)
    return percepts


def sense(acceleration: NDArray[np.float64], rate_hz: float) -> Sensation:
    """Compute what the hand senses of a vibration, shape (n_samples,) or (3, n_samples), in m/s²."""
    from scipy import fft

    from feel321.stimuli.match import WEBER_FRACTION, WeberSmoothing, log_grid
    from feel321.stimuli.sets.anchors import felt_level
    from feel321.stimuli.thresholds import acceleration_threshold

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
    return Sensation(max(level, 1.0), bands * is_felt, envelope * is_felt)


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
            "observer's threshold_spectral, envelope and level are measured; set these weights to 0, or set "
            '[stimuli] reference = "original" and build again'
        )
    # A set may hold an original per level arm: the arm's own comes first.
    return next((other for other in candidates if other.level == stimulus.level), candidates[0])


def _read(stimulus: Stimulus, folder: Path) -> Sensation:
    from feel321.stimuli.wav import read_wav

    samples, rate_hz = read_wav(folder / stimulus.file)
    rms = float(np.sqrt(np.sum(samples**2) / samples.shape[-1]))
    # A file holds shares of full scale; the manifest says how much acceleration that is.
    return sense(samples * (stimulus.rms_m_s2 / rms if rms else 0.0), rate_hz)
