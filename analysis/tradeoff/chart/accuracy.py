"""How well methods keep scenes, whatever way the sensor was glued on.

The same random orientations serve every scene and method, so that differences between methods are not differences
between draws. For a reducer as it is, the paper's two metrics come out as `stimuli.rotation_statistics` gives them.

References
----------
.. [1] G. Park, K. J. Kuchenbecker, "Objective and subjective assessment of algorithms for reducing three-axis
   vibrations to one-axis vibrations", World Haptics 2019. doi:10.1109/WHC.2019.8816148
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.chart.records import MEASURES, Accuracy
from stimuli.condition import resample
from stimuli.invariant import temporal_match_invariant
from stimuli.match import axis_correlations, mean_heard
from stimuli.rotation import random_rotations
from stimuli.spectrum import OriginalSpectrum, WeberSmoothing, energy_spectrum, linear_grid

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import NDArray

    from analysis.tradeoff.chart.methods import Method
    from stimuli.recording import Recording

    Samples = NDArray[np.float64]


def measure_accuracy(
    recording: Recording, methods: Iterable[Method], *, turns: Samples, sweep: str = "reducer"
) -> tuple[Accuracy, ...]:
    """Measure methods on one scene.

    Parameters
    ----------
    recording : Recording
        The scene.
    methods : iterable of Method
        What is measured.
    turns : ndarray, shape (rotations, 3, 3)
        Sensor orientations, at least two.
    sweep : str
        What is varied.

    Returns
    -------
    tuple of Accuracy
        One per method and measure.

    Raises
    ------
    ValueError
        If the recording has nothing that could be compared, or there are too few orientations.
    """
    if len(turns) < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"rotations: got {len(turns)}, allowed is 2 or more: one orientation has no spread")
    try:
        scene = _Scene(recording)
        turned = [recording.acceleration, *(turn @ recording.acceleration for turn in turns)]
        return tuple(found for method in methods for found in _measure(scene, method, turned=turned, sweep=sweep))
    except ValueError as error:
        raise ValueError(f"recording {recording.name!r}: {error}") from error


def draw_turns(rotations: int, seed: int) -> Samples:
    """Draw sensor orientations.

    Parameters
    ----------
    rotations : int
        How many.
    seed : int
        Of the draw.

    Returns
    -------
    ndarray, shape (rotations, 3, 3)
        Uniform over all rotations.
    """
    return random_rotations(rotations, np.random.default_rng(seed))


def cut_piece(recording: Recording, longest_s: float) -> Recording:
    """Take the middle of a recording that is long.

    Parameters
    ----------
    recording : Recording
        Any.
    longest_s : float
        What is kept at most, in s.

    Returns
    -------
    Recording
        Itself, or its middle.
    """
    if recording.duration_s <= longest_s:
        return recording
    n = round(longest_s * recording.rate_hz)
    first = (recording.n_samples - n) // 2
    return replace(recording, acceleration=recording.acceleration[:, first : first + n], sha256="")


def change_rate(recording: Recording, rate_hz: float) -> Recording:
    """Resample a recording.

    Parameters
    ----------
    recording : Recording
        Any.
    rate_hz : float
        The new rate.

    Returns
    -------
    Recording
        Same name.
    """
    samples = resample(recording.acceleration, recording.rate_hz, to_hz=rate_hz)
    return replace(recording, acceleration=samples, rate_hz=rate_hz, sha256="")


class _Scene:
    """A recording whose spectrum is ready to be compared: no orientation changes the sum of its axes' energies.

    What `INVARIANTS` would work out anew in every call is here worked out once.
    """

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        samples, rate, n = recording.acceleration, recording.rate_hz, recording.n_samples
        self._original = OriginalSpectrum(samples, rate)
        if self._original.reason:
            raise ValueError(self._original.reason)
        self._smooth = WeberSmoothing(linear_grid(n, rate), rate / n, n // 2 + 1)
        self._energy = energy_spectrum(samples, self._smooth.bins).sum(axis=0)

    def score(self, turned: Samples, reduced: Samples) -> list[float]:
        """Give the measures of one reduced signal, in the order of `MEASURES`."""
        energy = energy_spectrum(reduced, self._smooth.bins)
        total, apart = self._smooth(self._energy + energy).sum(), np.abs(self._smooth(self._energy - energy)).sum()
        spectral, bounded = map(float, self._original.match_both(reduced))
        temporal = float(mean_heard(axis_correlations(turned, reduced)))
        shared = float((total - apart) / (total + apart))
        return [spectral, temporal, bounded, shared, temporal_match_invariant(turned, reduced)]


def _measure(scene: _Scene, method: Method, *, turned: list[Samples], sweep: str) -> list[Accuracy]:
    name, rate = scene.recording.name, scene.recording.rate_hz
    scores = np.array([scene.score(one, method.reduce(one, rate)) for one in turned])
    mounted, mean, sd = scores[0], scores[1:].mean(axis=0), scores[1:].std(axis=0, ddof=1)
    return [
        Accuracy(
            sweep, method.label, method.reducer, name, rate, measure,
            float(mounted[i]), float(mean[i]), float(sd[i]), len(turned) - 1,
        )
        for i, measure in enumerate(MEASURES)
    ]  # fmt: skip
