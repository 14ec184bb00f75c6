"""How much depends on the way the sensor was glued on: of the output itself, and of the metrics.

Conventions as in `measures`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from analysis.tradeoff.stress.change import Change, admit_moving, relative_change, summarise
from stimuli.match import axis_correlations, mean_heard
from stimuli.rotation import random_rotations
from stimuli.spectrum import OriginalSpectrum

if TYPE_CHECKING:
    from analysis.tradeoff.stress.change import Free
    from stimuli.recording import Recording
    from stimuli.reduce import Reducer

FLIPS = np.array([[-1.0, 1.0, 1.0], [1.0, -1.0, 1.0], [1.0, 1.0, -1.0]])
"""The axis signs that differ by more than the sign of everything."""


class Spread(NamedTuple):
    """Standard deviations of both metrics over orientations of the sensor.

    Parameters
    ----------
    spectral_sd, temporal_sd : float
        With ddof 1; NaN for the spectral one where the recording has no frequency from 20 to 1000 Hz.
    """

    spectral_sd: float
    temporal_sd: float


def rotation_change(
    reduce: Reducer, recording: Recording, *, rng: np.random.Generator, draws: int = 20, free: Free = "sign"
) -> Change:
    """Tell how much the output changes if the sensor is glued on in another way.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        What is turned.
    rng : numpy.random.Generator
        Source of the orientations, uniform over all rotations.
    draws : int
        Orientations, at least 1.
    free : {"sign", "phase"}
        See `relative_change`.

    Returns
    -------
    Change
        Median and worst δ(reduce(Q a), reduce(a)) over rotations Q.

    Raises
    ------
    ValueError
        If the recording is silent or there are no draws.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 50)) * [[1], [2], [4]], 1000, "drag")
    >>> change = {name: rotation_change(REDUCERS[name], drag, rng=np.random.default_rng(0))
    ...           for name in ("sax321", "pca321")}
    >>> change["sax321"].median > 0.5, change["pca321"].worst < 1e-12
    (True, True)
    """
    samples, _ = admit_moving(recording, draws)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    outputs = reduce(turned, recording.rate_hz)
    return summarise(relative_change(outputs, reduce(samples, recording.rate_hz), free=free))


def flip_change(reduce: Reducer, recording: Recording) -> Change:
    """Tell how much the output changes if one axis of the sensor has the other sign.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        Whose axes are flipped, one at a time: two flips are one of the third axis and a sign of everything.

    Returns
    -------
    Change
        Median and worst of the three.

    Raises
    ------
    ValueError
        If the recording is silent.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> u = np.sin(np.arange(50.0))
    >>> same = Recording([u, u, u], 1000, "same")
    >>> round(flip_change(REDUCERS["soc321"], same).worst, 6), flip_change(REDUCERS["mag321"], same).worst
    (0.666667, 0.0)
    """
    samples, _ = admit_moving(recording, 1)
    outputs = reduce(FLIPS[..., None] * samples, recording.rate_hz)
    return summarise(relative_change(outputs, reduce(samples, recording.rate_hz)))


def metric_spread(
    reduce: Reducer, recording: Recording, *, rng: np.random.Generator, draws: int = 20
) -> Spread:
    """Tell how much both metrics depend on the way the sensor was glued on.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        What is turned.
    rng : numpy.random.Generator
        Source of the orientations.
    draws : int
        Orientations, at least 2.

    Returns
    -------
    Spread
        Of spectral and temporal match.

    Raises
    ------
    ValueError
        If the recording is silent or there are fewer than 2 draws.

    References
    ----------
    .. [1] Park & Kuchenbecker, World Haptics 2019. doi:10.1109/WHC.2019.8816148

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 500)) * [[1], [2], [4]], 1000, "drag")
    >>> metric_spread(REDUCERS["sax321"], drag, rng=np.random.default_rng(0)).spectral_sd > 0.1
    True
    """
    if draws < 2:  # noqa: PLR2004 - a spread needs two
        raise ValueError(f"draws: got {draws}, allowed is 2 or more")
    samples, _ = admit_moving(recording, draws)
    turned = np.einsum("rij,jn->rin", random_rotations(draws, rng), samples)
    outputs = reduce(turned, recording.rate_hz)
    original = OriginalSpectrum(samples, recording.rate_hz)
    spectral = float(np.std(original.match(outputs), ddof=1)) if len(original.smoothed) else float("nan")
    return Spread(spectral, float(np.std(mean_heard(axis_correlations(turned, outputs)), ddof=1)))
