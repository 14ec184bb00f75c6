"""Coils, a sensor and their faults, made apart from the product's own simulation: what was sent -> what is measured."""

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime

import numpy as np
from scipy import signal

from feel321.study.actuator.certificate import Certificate, CoilCertificate, begin_certificate
from feel321.study.actuator.response import Sweep, make_inverse, make_sweep, measure_sweep
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, Rig, SensorTable

RATE_HZ = 48000
MADE = datetime(2026, 3, 1, 12, tzinfo=UTC)
DIRECTIONS = ((0.940, 0.342, 0.0), (-0.259, 0.966, 0.0), (0.05, 0.05, 0.9975))


@dataclass(frozen=True)
class Loop:
    """Three coils and a sensor: resonances, Q, full scales; faults of the moment."""

    resonances_hz: tuple[float, ...] = (95.0, 130.0, 170.0)
    q: tuple[float, ...] = (4.0, 5.0, 3.0)
    full_scales: tuple[float, ...] = (80.0, 74.0, 92.0)
    gains: tuple[float, ...] = (1.0, 1.0, 1.0)
    order: tuple[int, ...] = (0, 1, 2)
    f0: tuple[float, ...] = (1.0, 1.0, 1.0)
    damped: tuple[float, ...] = (1.0, 1.0, 1.0)
    clip: tuple[float, ...] = (9.0, 9.0, 9.0)
    rattle: tuple[float, ...] = (0.0, 0.0, 0.0)
    rate: float = 1.0
    hum: float = 0.0
    hum_hz: float = 50.0
    late: int = 144
    sensor: tuple[float, ...] = (1.0, 1.0, 1.0)
    saturated: float = 200.0
    noise: float = 0.02
    rng: np.random.Generator = field(default_factory=lambda: np.random.default_rng(1))

    def but(self, **changes: object) -> "Loop":
        return replace(self, **changes)  # type: ignore[arg-type]

    def move(self, sent: np.ndarray) -> np.ndarray:
        """What the sensor measures of frames, shape (n, 3): (3, n) in m/s²."""
        sent = np.asarray(sent, dtype=np.float64)
        n, time_s = len(sent), np.arange(len(sent)) / RATE_HZ
        motion = np.zeros((3, n))
        for place in range(3):
            drive = sent[:, self.order[place]]
            if self.rate != 1:
                drive = np.interp(np.arange(n) * self.rate, np.arange(n), drive)
            drive = np.clip(drive, -self.clip[place], self.clip[place])
            drive = drive + 0.01 * drive**2
            omega = (
                2 * RATE_HZ * np.tan(np.pi * self.resonances_hz[place] * self.f0[place] / RATE_HZ)
            )
            own_q = self.q[place] / self.damped[place]
            coil = signal.bilinear([1, 0, 0], [1, omega / own_q, omega**2], RATE_HZ)
            moved = signal.lfilter(*coil, drive) * self.full_scales[place] * self.gains[place]
            moved = moved + self.rattle[place] * moved * np.abs(moved) / 40
            motion += np.outer(DIRECTIONS[place], moved)
        seen = np.zeros_like(motion)
        seen[:, self.late :] = motion[:, : n - self.late]
        phase = self.rng.uniform(0, 2 * np.pi)
        hum = self.hum * np.sin(2 * np.pi * self.hum_hz * time_s + phase)
        seen += self.noise * self.rng.standard_normal(seen.shape) + np.outer((1, 0.6, 0.6), hum)
        return np.clip(seen * np.array(self.sensor)[:, None], -self.saturated, self.saturated)


NAMES = ("left", "right", "third")


def make_rig(**tables: object) -> Rig:
    actuators = tuple(
        ActuatorTable(
            name=name, channel=place + 1, full_scale_m_s2=100.0, direction=DIRECTIONS[place],
            plays=("reduced", "xyz"[place]),
        )
        for place, name in enumerate(NAMES)
    )  # fmt: skip
    own = {
        "limits": LimitsTable(peak_m_s2=100, rms_m_s2=50, duration_s=30),
        "sensor": SensorTable(channels=(1, 2, 3), full_scale_m_s2=200),
        "actuators": actuators,
    }
    return Rig(**{**own, **tables})  # type: ignore[arg-type]


def certify(loop: Loop, rig: Rig | None = None, *, max_gain_db: float = 45.0) -> Certificate:
    """Measure the coils of a loop by sweeps, one after another, and give them their filters."""
    rig = rig or make_rig()
    sweep = Sweep(rate_hz=RATE_HZ, duration_s=2.0, pause_s=0.4, n_repeats=2, peak=0.2)
    asked, coils = make_sweep(sweep), {}
    for place, actuator in enumerate(rig.actuators):
        frames = np.zeros((len(asked), 3))
        frames[:, place] = asked
        found = measure_sweep(sweep, loop.move(frames))
        inverse = make_inverse(found, max_gain_db=max_gain_db, n_taps=round(0.6 * RATE_HZ))
        grid_hz = np.arange(10.0, 1250.0, 0.5)
        known = np.interp(grid_hz, found.frequency_hz, found.response)
        coils[actuator.name] = CoilCertificate(
            name=actuator.name, channel=actuator.channel, full_scale_m_s2=inverse.target,
            target=inverse.target, latency=found.latency, delay=inverse.delay,
            noise_m_s2=loop.noise * 3**0.5, total_distortion=0.01, direction=found.direction,
            frequency_hz=grid_hz, response=known, coherence=np.ones(len(grid_hz)),
            distortion=np.full(len(grid_hz), 0.01), equalised=known, fir=inverse.fir,
            levels=np.array([0.05, 0.2]), linearity_db=np.zeros(2),
        )  # fmt: skip
    return begin_certificate(rig, coils, method="measured", made=MADE, rate_hz=RATE_HZ)


def predict(certificate: Certificate, frames: np.ndarray) -> np.ndarray:
    """The motion at the hand, (3, n) in m/s², of frames sent, (n, channels), by a certificate."""
    moved = np.zeros((3, len(frames)))
    first = min(coil.latency for coil in certificate.coils.values())
    for coil in certificate.coils.values():
        late = coil.latency - first
        own = coil.respond(frames[:, coil.channel - 1], rate_hz=certificate.rate_hz)
        moved[:, late:] += np.outer(coil.direction, own[: len(frames) - late])
    return moved


def make_track(seed: int, *, peak: float, seconds: float = 0.8) -> np.ndarray:
    """Noise from 30 to 500 Hz, in m/s²."""
    n = round(seconds * RATE_HZ)
    noise = np.random.default_rng(seed).standard_normal(n) * signal.windows.tukey(n, 0.1)
    band = signal.butter(2, (30, 500), "band", fs=RATE_HZ, output="sos")
    noise = signal.sosfilt(band, noise)
    return np.asarray(noise / np.abs(noise).max() * peak)


def send(certificate: Certificate, *tracks: np.ndarray) -> np.ndarray:
    drives = [
        certificate.drive(name, track)
        for name, track in zip(certificate.coils, tracks, strict=True)
    ]
    frames = np.zeros((max(map(len, drives)), len(drives)), dtype=np.float32)
    for column, drive in enumerate(drives):
        frames[: len(drive), column] = drive
    return frames


def play(loop: Loop, sent: np.ndarray) -> np.ndarray:
    return loop.move(np.vstack([sent, np.zeros((4800 + loop.late, 3))]))
