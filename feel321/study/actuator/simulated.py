"""A device that is simulated: it asks for blocks as a real one does, and coils of `[simulation]` move its sensor."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from threading import Event, Thread
from time import perf_counter

import numpy as np
from scipy import signal

from feel321.study.actuator.device import BlockTimes, Device, Fill, SessionClock
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.rig import (
    SIMULATED_DEVICE,
    ActuatorTable,
    CoilTable,
    Rig,
    SimulationTable,
)
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


SIMULATED = Device(
    index=-1, name=SIMULATED_DEVICE, host_api="feel321", n_outputs=1024, n_inputs=1024
)
BLOCK_FRAMES = 512
MOST_BEHIND_S = 0.2  # of its own time: a machine that lags by more slows the device down


class Hardware:
    """The coils and the sensor of a rig, without a device; they keep their state between blocks."""

    def __init__(self, rig: Rig, *, rate_hz: float) -> None:
        simulation = rig.simulation or SimulationTable()
        tables = {coil.name: coil for coil in simulation.coils}
        names = [actuator.name for actuator in rig.actuators]
        if unknown := [name for name in tables if name not in names]:
            raise ValueError(
                f"simulation.coils must have the names of actuators ({', '.join(map(repr, names))}), got {unknown[0]!r}"
            )
        self._rng = np.random.default_rng(simulation.seed)
        self._coils = [
            (actuator.channel - 1, self._make_coil(actuator, tables, simulation, rate_hz=rate_hz))
            for actuator in rig.actuators
        ]
        self._noise_m_s2 = simulation.noise_m_s2
        self._sensor = rig.sensor
        along = np.array([simulation.sensor_direction])
        several = rig.sensor is not None and len(rig.sensor.inputs) > 1
        self._axes = np.eye(3) if several else along / np.linalg.norm(along)

    def _make_coil(
        self,
        actuator: ActuatorTable,
        tables: Mapping[str, CoilTable],
        simulation: SimulationTable,
        *,
        rate_hz: float,
    ) -> SimulatedCoil:
        own = tables.get(actuator.name, CoilTable(name=actuator.name)).model_dump(exclude={"name"})
        own["direction"] = own["direction"] or actuator.direction or (1.0, 0.0, 0.0)
        own["saturation"] = own["saturation"] or float("inf")
        own["latency"] += simulation.latency
        return SimulatedCoil(Coil(**own), rate_hz=rate_hz, rng=self._rng)

    def move(self, out: Frames) -> Samples:
        """Return what the sensor's place does, in m/s², shape (axes, n), for frames sent, shape (n, channels)."""
        motion = self._noise_m_s2 * self._rng.standard_normal((3, len(out)))
        for column, coil in self._coils:
            motion += coil.process(out[:, column].astype(np.float64))
        moved: Samples = self._axes @ motion
        return moved

    def sense(self, out: Frames) -> Frames | None:
        """Return what the sensor's input gets, as parts of its full scale, shape (n, axes); None without a sensor."""
        moved = self.move(out)
        if self._sensor is None:
            return None
        return np.clip(moved.T / self._sensor.full_scale_m_s2, -1, 1).astype(np.float32)


class SimulatedStream:
    """What `stream.DeviceStream` is, for the simulated device; a thread asks for its blocks."""

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill) -> None:
        self.device = SIMULATED
        self.latency_s = rig.device.latency_s
        self.there_and_back_s = (
            rig.device.latency_s + (rig.simulation.latency if rig.simulation else 0) / rate_hz
        )
        self._hardware = Hardware(rig, rate_hz=rate_hz)
        self._speed = rig.simulation.speed if rig.simulation else 1.0
        self._rate_hz, self._fill, self._n_channels = rate_hz, fill, rig.n_channels
        self._sensed = self._hardware.sense(
            np.zeros((BLOCK_FRAMES, rig.n_channels), dtype=np.float32)
        )
        self._begin_s, self._frame = perf_counter(), 0
        self._closing = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def is_active(self) -> bool:
        """Whether it still asks for blocks."""
        return self._thread.is_alive()

    @property
    def is_silent(self) -> bool:
        """Whether it has asked for nothing for long: only when it has ended."""
        return not self.is_active

    def find_fault(self) -> str:
        """Describe why the stream does not run; empty if it does."""
        return "" if self.is_active else "stopped"

    def compare_clocks(self, clock: SessionClock) -> float:
        """Find by how much the session's clock is ahead of the device's, in s."""
        return clock() - (perf_counter() - self._begin_s) * self._speed

    def close(self) -> bool:
        """Silence the device and let it go."""
        self._closing.set()
        self._thread.join()
        return True

    def _run(self) -> None:
        block_s = BLOCK_FRAMES / self._rate_hz
        while not self._closing.is_set():
            behind_s = (perf_counter() - self._begin_s) * self._speed - self._frame / self._rate_hz
            if behind_s < block_s:
                self._closing.wait((block_s - behind_s) / self._speed)
                continue
            if behind_s > MOST_BEHIND_S * max(self._speed, 1.0):
                self._begin_s += behind_s / self._speed
            self._serve()

    def _serve(self) -> None:
        out = np.zeros((BLOCK_FRAMES, self._n_channels), dtype=np.float32)
        now_s = self._frame / self._rate_hz
        times = BlockTimes(now_s=now_s, dac_s=now_s + self.latency_s, adc_s=now_s)
        self._frame += BLOCK_FRAMES
        self._fill(out, times, self._sensed)  # as with a device, of the block before
        self._sensed = self._hardware.sense(out)
