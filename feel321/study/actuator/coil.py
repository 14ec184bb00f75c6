"""A simulated voice coil with a three-axis accelerometer on it: hardware for machines that have none."""

import math
from dataclasses import dataclass

import numpy as np
from scipy import signal

from feel321.types import Samples


@dataclass(frozen=True, slots=True, kw_only=True)
class Coil:
    """A voice coil, driven in units of full scale, that moves a mass on a spring.

    full_scale_m_s2: acceleration at full scale far above resonance. saturation: drive (in full scales) at which the
    amplifier approaches its limit, `s tanh(u / s)`; infinite for a linear one. noise_m_s2: RMS of the noise of each
    axis of the sensor. direction: of the acceleration for positive drive; any length but zero. latency: samples from
    drive to sensor. drift_db_per_min: change of gain since the start.
    """

    resonance_hz: float
    q: float
    full_scale_m_s2: float = 10.0
    drift_db_per_min: float = 0.0
    saturation: float = math.inf
    noise_m_s2: float = 0.0
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    latency: int = 0

    def __post_init__(self) -> None:
        """Refuse coils that cannot exist."""
        for name in ("resonance_hz", "q", "full_scale_m_s2", "saturation"):
            if not getattr(self, name) > 0:
                raise ValueError(f"coil: {name} must be positive, got {getattr(self, name)}")
        for name in ("noise_m_s2", "latency"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"coil: {name} must be 0 or more, got {getattr(self, name)}")
        if not np.linalg.norm(self.direction) > 0:
            raise ValueError("coil: direction must not be zero; name an axis, such as (0, 0, 1)")


class SimulatedCoil:
    """A coil at work: a causal filter that takes drive block by block and keeps its state between blocks.

    Acceleration over force of a mass on a damped spring is `s² / (s² + s ω₀ / Q + ω₀²)`, made discrete by the bilinear
    transform with the resonance kept in its place. How drive is cut into blocks changes nothing, noise included.
    """

    def __init__(self, coil: Coil, *, rate_hz: float, rng: np.random.Generator) -> None:
        if not rate_hz > 2 * coil.resonance_hz:
            raise ValueError(
                f"rate_hz must be above twice the resonance of {coil.resonance_hz:g} Hz, got {rate_hz:g}"
            )
        self.coil, self.rate_hz = coil, rate_hz
        self._rng = rng
        self._direction = np.array(coil.direction) / np.linalg.norm(coil.direction)
        self._b, self._a = discretise(coil, rate_hz=rate_hz)
        self._state = np.zeros(2)
        self._line = np.zeros(coil.latency)
        self._n_done = 0

    def process(self, drive: Samples) -> Samples:
        """Return acceleration in m/s², shape (3, n), for drive in full scales, shape (n,)."""
        if drive.ndim != 1 or not np.isfinite(drive).all():
            raise ValueError(f"drive must be finite numbers, shape (n,), got shape {drive.shape}")
        coil, n = self.coil, len(drive)
        self._line = np.concatenate([self._line, drive])
        late, self._line = self._line[:n], self._line[n:]
        if math.isfinite(coil.saturation):
            late = coil.saturation * np.tanh(late / coil.saturation)
        moved, self._state = signal.lfilter(self._b, self._a, late, zi=self._state)
        minutes = (self._n_done + np.arange(n)) / self.rate_hz / 60
        self._n_done += n
        moved *= coil.full_scale_m_s2 * 10 ** (coil.drift_db_per_min * minutes / 20)
        noise = self._rng.standard_normal((n, 3)).T  # in time order, so that blocks do not matter
        return np.outer(self._direction, moved) + coil.noise_m_s2 * noise


def discretise(coil: Coil, *, rate_hz: float) -> tuple[Samples, Samples]:
    """Make numerator and denominator, shape (3,) each, of a coil's digital filter of unit gain at high frequencies."""
    omega = 2 * rate_hz * math.tan(math.pi * coil.resonance_hz / rate_hz)
    b, a = signal.bilinear([1.0, 0.0, 0.0], [1.0, omega / coil.q, omega**2], fs=rate_hz)
    return np.asarray(b, dtype=np.float64), np.asarray(a, dtype=np.float64)
