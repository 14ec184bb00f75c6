"""Which axis should the phase come from? Run by hand: `python tests/bench/reducers.py [SCENE ...]`.

Every candidate but `pca321` keeps equation 3's magnitude and takes the phase of the projection on its own axis, so its
spectral match is 1. Per scene and candidate three figures: the perturbation gain (median over noises at -60 dB, up to
sign), the same with a constant phase left free (on circular motion a turn of the sensor *is* a shift in time), and
`inv`, the rotation-invariant temporal match; for `dft321` the mean over random mountings. Where the second eigenvalue
stands within 20 % of the first, the trade-off of gain against inv over `PULL` and `TILT` follows.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy import fft

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.match import WEBER_FRACTION
from feel321.stimuli.reducers import fourier
from feel321.stimuli.reducers.axes import leading_axis, pca321
from feel321.stimuli.reducers.fourier import align, dft321, dft321_principal, measure
from feel321.stimuli.rotation import random_rotations, temporal_match_invariant
from feel321.stimuli.synthesis import SCENES, make_scene

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    Samples = NDArray[np.float64]
    Spectra = NDArray[np.complex128]
    Reduce = Callable[[Samples, float], Samples]

SHARED = Path(__file__).resolve().parents[3] / "shared" / "recordings"
DRAWS, MOUNTINGS, LEVEL = 7, 10, 1e-3
CLOSE = 1 / 1.2


def along(choose: Callable[[Samples, Spectra], Samples]) -> Reduce:
    """Make a reducer of equation 3's magnitude along the axis, or the axis per bin, that is chosen."""

    def reduce(acceleration: Samples, rate_hz: float) -> Samples:
        del rate_hz
        spectra = fft.rfft(acceleration)
        axis = choose(acceleration, spectra)
        if axis.ndim == 1:
            merged = align([*spectra], measure([*spectra])[0], axis=axis)
        else:
            merged = align([*spectra[:, :, None]], measure([*spectra])[0][:, None], axis=axis)[:, 0]
        return fft.irfft(merged, acceleration.shape[1])

    return reduce


def first_principal(acceleration: Samples, spectra: Spectra) -> Samples:
    """Take the first principal axis and nothing else."""
    del acceleration
    return leading_axis(measure([*spectra])[1])


def climbed(steps: int) -> Callable[[Samples, Spectra], Samples]:
    """Climb from the first principal axis (point 2 of the notes in `leading`), without pull and tilt."""

    def choose(acceleration: Samples, spectra: Spectra) -> Samples:
        axis = first_principal(acceleration, spectra)
        for _ in range(steps):
            aligned = align([*spectra], measure([*spectra])[0], axis=axis)
            axis = (spectra[:, 1:] @ aligned[1:].conj()).real
            axis /= np.linalg.norm(axis)
        return axis

    return choose


def loud_moments(acceleration: Samples, spectra: Spectra) -> Samples:
    """Weigh instants by their energy: an axis in time, where the motion is strong (kurtosis-like)."""
    del spectra
    return leading_axis((acceleration * np.sum(acceleration**2, axis=0)) @ acceleration.T)


def clear_bins(acceleration: Samples, spectra: Spectra) -> Samples:
    """Weigh bins by their energy: what stands above the sensor's noise counts more (noise-aware)."""
    del acceleration
    strong = spectra * np.sum(np.abs(spectra) ** 2, axis=0)
    return leading_axis((strong @ spectra.conj().T).real)


def per_band(acceleration: Samples, spectra: Spectra) -> Samples:
    """Take an axis per frequency, from 22 % around it, where one stands out; the whole signal's elsewhere, smoothly."""
    whole = first_principal(acceleration, spectra)
    products = (spectra[:, None] * spectra[None].conj()).real
    running = np.concatenate([np.zeros((3, 3, 1)), np.cumsum(products, axis=-1)], axis=-1)
    bins = np.arange(spectra.shape[1])
    half = np.maximum(bins * WEBER_FRACTION / 2, 8).astype(int)
    low, high = np.maximum(bins - half, 0), np.minimum(bins + half + 1, bins.size)
    values, vectors = np.linalg.eigh(np.moveaxis(running[..., high] - running[..., low], -1, 0))
    clear = np.clip((values[:, 2] - values[:, 1]) / np.maximum(values[:, 2], 1e-300), 0, 1)[:, None]
    own = vectors[:, :, 2] * np.where(vectors[:, :, 2] @ whole < 0, -1.0, 1.0)[:, None]
    mixed = clear * own + (1 - clear) * whole
    return mixed / np.linalg.norm(mixed, axis=1, keepdims=True)


CANDIDATES: dict[str, Reduce] = {
    "pca321": pca321,
    "dft321": dft321,
    "dft321_principal": dft321_principal,
    "first axis": along(first_principal),
    "1 step": along(climbed(1)),
    "20 steps": along(climbed(20)),
    "loud moments": along(loud_moments),
    "clear bins": along(clear_bins),
    "axis per band": along(per_band),
}


def scenes() -> Iterator[tuple[str, Samples, float]]:
    """Bundled scenes, recordings, and motion made to have no leading axis or phases left open."""
    made = [make_scene(name) for name in SCENES]
    read = [
        read_recording(path)
        for path in sorted(SHARED.glob("*"))
        if path.suffix in {".csv", ".npz", ".wav"}
    ]
    for recording in made + read:
        conditioned = condition(recording, Conditioning())
        yield recording.name, conditioned.acceleration, recording.rate_hz
    rng, turn = np.random.default_rng(5), 2 * np.pi * np.arange(20_000) / 10_000
    hiss, wave = 1e-3 * rng.standard_normal((3, 20_000)), rng.standard_normal(20_000)
    yield "anti-phase", np.array([wave, -wave, 0 * wave]) + hiss, 10_000.0
    tones = np.array([np.sin(100 * turn), 0.6 * np.sin(231.7 * turn + 0.4), 0 * turn])
    yield "two tones", tones + hiss, 10_000.0
    yield "two tones, 2 % across", tones + np.array([[0.0], [0.0], [20.0]]) * hiss, 10_000.0
    yield "circle", np.array([np.cos(150 * turn), np.sin(150 * turn), 0 * turn]) + hiss, 10_000.0
    yield (
        "ellipse",
        np.array([np.cos(150 * turn), 0.8 * np.sin(150 * turn), 0 * turn]) + hiss,
        10_000.0,
    )
    yield "isotropic", rng.standard_normal((3, 20_000)), 10_000.0


def gains(reduce: Reduce, acceleration: Samples, rate_hz: float) -> tuple[float, float]:
    """Median relative change of the output over that of the input: up to sign, and up to a constant phase."""
    rng = np.random.default_rng(0)
    once, found = fft.rfft(reduce(acceleration, rate_hz)), []
    for _ in range(DRAWS):
        hiss = rng.standard_normal(acceleration.shape)
        hiss *= LEVEL * np.linalg.norm(acceleration) / np.linalg.norm(hiss)
        other = fft.rfft(reduce(acceleration + hiss, rate_hz))
        together = np.vdot(once, other)
        turns = np.sign(together.real) or 1.0, together / (abs(together) or 1.0)
        found.append([
            np.linalg.norm(other - turn * once) / np.linalg.norm(once) / LEVEL for turn in turns
        ])
    by_sign, by_phase = np.median(found, axis=0)
    return float(by_sign), float(by_phase)


def inv(reduce: Reduce, acceleration: Samples, rate_hz: float) -> float:
    """Rotation-invariant temporal match, mean over mountings where the output depends on them."""
    count = MOUNTINGS if reduce is dft321 else 1
    turned = [
        turn @ acceleration
        for turn in random_rotations(count, np.random.default_rng(1)).reshape(-1, 3, 3)
    ]
    return float(np.mean([temporal_match_invariant(one, reduce(one, rate_hz)) for one in turned]))


def cell(reduce: Reduce, acceleration: Samples, rate_hz: float) -> str:
    by_sign, by_phase = gains(reduce, acceleration, rate_hz)
    return f"{by_sign:6.1f} {by_phase:6.1f} {inv(reduce, acceleration, rate_hz):.3f}"


def trade_off(acceleration: Samples, rate_hz: float) -> None:
    """Gain against inv over the two numbers that `dft321_principal` rests on."""
    chosen = fourier.PULL, fourier.TILT
    for tilt in (0.0, 0.05, 0.1, 0.2):
        cells = []
        for pull in (0.0, 0.003, 0.01, 0.03, 0.1, 0.3):
            fourier.PULL, fourier.TILT = pull, tilt
            cells.append(f"{pull:5.3f}: {cell(dft321_principal, acceleration, rate_hz)}")
        print(f"    tilt {tilt:4.2f}, pull  {'   '.join(cells)}", flush=True)
    fourier.PULL, fourier.TILT = chosen


def main() -> int:
    wanted = set(sys.argv[1:])
    print("gain up to sign, gain up to phase, inv")
    print(f"{'scene':22} l2/l1  {'  '.join(f'{name:>19}' for name in CANDIDATES)}")
    for name, acceleration, rate_hz in scenes():
        if wanted and name not in wanted:
            continue
        values = np.linalg.eigvalsh(np.cov(acceleration))
        ratio = values[-2] / values[-1]
        cells = [cell(reduce, acceleration, rate_hz) for reduce in CANDIDATES.values()]
        print(f"{name:22} {ratio:5.3f}  {'  '.join(f'{text:>19}' for text in cells)}", flush=True)
        if ratio > CLOSE:
            trade_off(acceleration, rate_hz)
    return 0


if __name__ == "__main__":
    sys.exit(main())
