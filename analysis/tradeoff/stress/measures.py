"""How unstable a reducer is on one recording, number by number.

Conventions: `reduce` is called as in `REDUCERS`, `reduce(acceleration, rate_hz)` with acceleration (..., 3, n), and
must take batches. a is the recording, r = reduce(a) its output, ‖·‖ the root of the energy, δ the relative change of
`change.relative_change`, which is sign-free.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from analysis.tradeoff.stress.change import Change, admit_moving, relative_change, summarise
from stimuli.frames import DEFAULT_WINDOW_S, window_samples

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from analysis.tradeoff.stress.change import Free
    from stimuli.recording import Recording
    from stimuli.reduce import Reducer

    Samples = NDArray[np.float64]

LARGEST_DB = 60.0
"""An output that is weaker or stronger by more than this is silent, or out of all proportion."""


def perturbation_gain(
    reduce: Reducer,
    recording: Recording,
    *,
    rng: np.random.Generator,
    draws: int = 20,
    level_db: float = -60.0,
    free: Free = "sign",
) -> Change:
    r"""Tell how much more the output changes than the input, under weak sensor noise.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        What is perturbed.
    rng : numpy.random.Generator
        Source of the noise.
    draws : int
        Noises, at least 1.
    level_db : float
        Strength of the noise against the recording, below 0 dB.
    free : {"sign", "phase"}
        See `relative_change`.

    Returns
    -------
    Change
        Median and worst gain. 1: noise passes as it is; 1414 at -60 dB: the output is all noise.

    Raises
    ------
    ValueError
        If the recording is silent, or draws or level are out of range.

    Notes
    -----
    .. math:: G = \delta(R(a + n), R(a)) \,\Big/\, \frac{\|n\|}{\|a\|}, \qquad n \sim N(0, 1)^{3 \times n}
        \text{ scaled to } \|n\| = 10^{L/20} \|a\|

    a condition number measured at a distance [1]_; exactly \|R(n)\| \|a\| / (\|R(a)\| \|n\|) for linear reducers.

    References
    ----------
    .. [1] J. R. Rice, "A theory of condition", SIAM Journal on Numerical Analysis 3(2), 1966. doi:10.1137/0703023

    Examples
    --------
    >>> from stimuli.reduce import REDUCERS
    >>> from stimuli.recording import Recording
    >>> u = np.sin(np.arange(500.0))
    >>> anti_phase = Recording([u, -u, 0 * u], 1000, "anti-phase")
    >>> perturbation_gain(REDUCERS["dft321"], anti_phase, rng=np.random.default_rng(0)).median > 100
    True
    """
    if not level_db < 0:
        raise ValueError(f"level_db: got {level_db}, allowed is below 0 dB: the noise is weaker than the recording")
    samples, strength = admit_moving(recording, draws)
    share = 10 ** (level_db / 20)
    noise = rng.standard_normal((draws, *samples.shape))
    noise *= share * strength / np.linalg.norm(noise, axis=(-2, -1), keepdims=True)
    outputs = reduce(samples + noise, recording.rate_hz)
    return summarise(relative_change(outputs, reduce(samples, recording.rate_hz), free=free) / share)


def shift_change(reduce: Reducer, recording: Recording, *, rng: np.random.Generator, draws: int = 8) -> Change:
    """Tell how much the output changes if the same motion begins a little later.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        The motion; silence of one window is put around it.
    rng : numpy.random.Generator
        Source of the shifts, 1 sample to one window.
    draws : int
        Shifts, at least 1.

    Returns
    -------
    Change
        Median and worst δ(reduce(shifted a), shifted reduce(a)): 0 for what is shift-equivariant.

    Raises
    ------
    ValueError
        If the recording is silent or there are no draws.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> drag = Recording(np.random.default_rng(1).standard_normal((3, 50)), 1000, "drag")
    >>> shift_change(REDUCERS["mag321"], drag, rng=np.random.default_rng(0))
    Change(median=0.0, worst=0.0, p90=0.0)
    """
    samples, _ = admit_moving(recording, draws)
    most = window_samples(DEFAULT_WINDOW_S, recording.rate_hz)
    silence = np.zeros((3, most))
    embedded = np.concatenate([samples, silence], axis=-1)
    shifts = rng.integers(1, most, size=draws, endpoint=True)
    outputs = reduce(np.array([np.roll(embedded, shift, axis=-1) for shift in shifts]), recording.rate_hz)
    back = np.array([np.roll(output, -shift) for output, shift in zip(outputs, shifts, strict=True)])
    return summarise(relative_change(back, reduce(embedded, recording.rate_hz)))


def edge_error(reduce: Reducer, recording: Recording, *, window_s: float = DEFAULT_WINDOW_S) -> float:
    r"""Tell which share of the energy the output puts at the wrong time, across the edges of half windows.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        The recording.
    window_s : float
        Window in s; its half is the hop of frames that overlap by half.

    Returns
    -------
    float
        0 (the envelope is kept) to 1 (all energy is where there was none); 1 for a silent output.

    Raises
    ------
    ValueError
        If the recording is silent.

    Notes
    -----
    With p_k and q_k the shares of the energy about the mean of recording and output that lie in half window k, the
    total variation distance :math:`\frac{1}{2} \sum_k |p_k - q_k|`. Energy that a method spreads before a tap, wraps
    around the ends or loses at a frame's edge counts, its overall strength does not.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> tap = np.zeros(200)
    >>> tap[[50, 51]] = 1.0, -1.0
    >>> edge_error(REDUCERS["pca321"], Recording([tap, 2 * tap, -tap], 1000, "tap")) < 1e-12
    True
    """
    samples, _ = admit_moving(recording, 1)
    hop = window_samples(window_s, recording.rate_hz) // 2
    starts = np.arange(0, samples.shape[-1], hop)
    shares = []
    for signal in (samples, np.atleast_2d(reduce(samples, recording.rate_hz))):
        about_mean = signal - signal.mean(axis=-1, keepdims=True)
        energy = np.add.reduceat(np.square(about_mean).sum(axis=0), starts)
        shares.append(energy / energy.sum() if energy.sum() > 0 else np.zeros_like(energy))
    recorded, kept = shares
    return float(np.abs(recorded - kept).sum() / 2) if kept.any() else 1.0


def energy_error(reduce: Reducer, recording: Recording) -> float:
    """Tell how much stronger or weaker the output vibrates than the recording.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        The recording.

    Returns
    -------
    float
        10 log10 of the ratio of the energies about the mean, in dB, between -60 and 60: an offset is not felt.

    Raises
    ------
    ValueError
        If the recording is silent, or has nothing but an offset.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> u = np.sin(np.arange(1000.0))
    >>> round(energy_error(REDUCERS["soc321"], Recording([u, u, u], 1000, "same")), 2)
    4.77
    """
    samples, _ = admit_moving(recording, 1)
    recorded = float(samples.var(axis=-1).sum())
    if recorded == 0:
        raise ValueError(f"recording {recording.name!r}: has an offset and no vibration; choose one that moves")
    kept = float(reduce(samples, recording.rate_hz).var())
    with np.errstate(divide="ignore"):
        return float(np.clip(10 * np.log10(kept / recorded), -LARGEST_DB, LARGEST_DB))


def fault_gain(reduce: Reducer, recording: Recording, *, clean: Recording) -> float:
    """Tell how much more the output suffers from a fault of the recording than the recording itself.

    Parameters
    ----------
    reduce : Reducer
        The reducer.
    recording : Recording
        With the fault.
    clean : Recording
        The same motion without it.

    Returns
    -------
    float
        δ(reduce(faulty), reduce(clean)) over ‖faulty - clean‖ / ‖clean‖; NaN where both are the same.

    Raises
    ------
    ValueError
        If the clean recording is silent, or the two differ in length.

    Examples
    --------
    >>> from stimuli.recording import Recording
    >>> from stimuli.reduce import REDUCERS
    >>> u = np.sin(np.arange(100.0))
    >>> whole, cut = (Recording([v, 0 * u, 0 * u], 1000, "x") for v in (u, np.clip(u, -0.5, 0.5)))
    >>> round(fault_gain(REDUCERS["soc321"], cut, clean=whole), 9)
    1.0
    """
    samples, strength = admit_moving(clean, 1)
    if recording.n_samples != clean.n_samples:
        raise ValueError(f"clean: got {clean.n_samples} samples, allowed is {recording.n_samples}, as with the fault")
    share = float(np.linalg.norm(recording.acceleration - samples)) / strength
    outputs = (reduce(one.acceleration, one.rate_hz) for one in (recording, clean))
    return float(relative_change(*outputs)) / share if share else float("nan")
