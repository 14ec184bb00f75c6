"""Sinks for machines without hardware: voice coils that move a simulated sensor, and WAV files."""

from math import inf
from threading import Event, Thread
from time import perf_counter

import numpy as np
from scipy import signal

from feel321.study.actuator.device import BlockTimes, Fill, SessionClock, Sink
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.rig import (
    FILE_DEVICE,
    SIMULATED_DEVICE,
    CoilTable,
    Rig,
    SimulationTable,
)
from feel321.types import Samples

BLOCK_FRAMES = 512  # longest delay of a stop, as with a device
MOST_BEHIND_S = 0.2  # of its own time: a machine that lags by more slows the device down


class FileSink(Sink):
    """Keeps the blocks of a playback, which are filled in the time that they would take."""

    name = FILE_DEVICE

    def begin(self) -> None:
        """Begin a playback."""
        self._begin_s = self._clock()
        self.blocks: list[Frames] = []

    def serve_due(self) -> bool:
        """Fill a block that would have been played by now; returns whether there was one."""
        n_filled = BLOCK_FRAMES * len(self.blocks)
        if (self._clock() - self._begin_s) * self._rate_hz - n_filled < BLOCK_FRAMES:
            return False
        out = np.zeros((BLOCK_FRAMES, self._rig.n_channels), dtype=np.float32)
        sent_s = self._begin_s + n_filled / self._rate_hz
        # What is in a file is out.
        self._fill(out, BlockTimes(now_s=inf, dac_s=sent_s, dac_source=""), None)
        self.blocks.append(out)
        return True


class SimulatedCoil:
    """A voice coil at work: a causal filter that takes drive block by block and keeps its state between blocks.

    Acceleration over force of a mass on a damped spring is `s² / (s² + s ω₀ / Q + ω₀²)`, made discrete by the bilinear
    transform with the resonance kept in its place. How drive is cut into blocks changes nothing, noise included.
    """

    def __init__(self, coil: CoilTable, *, rate_hz: float, rng: np.random.Generator) -> None:
        if not rate_hz > 2 * coil.resonance_hz:
            raise ValueError(
                f"rate_hz must be above twice the resonance of {coil.resonance_hz:g} Hz, got {rate_hz:g}"
            )
        self._coil, self._rng = coil, rng
        direction = np.array(coil.direction or (1.0, 0.0, 0.0))
        self._direction = direction / np.linalg.norm(direction)
        self._b, self._a = discretise(coil, rate_hz=rate_hz)
        self._state, self._line = np.zeros(2), np.zeros(coil.latency)

    def process(self, drive: Samples) -> Samples:
        """Return acceleration in m/s², shape (3, n), for drive in full scales, shape (n,)."""
        coil, n = self._coil, len(drive)
        self._line = np.concatenate([self._line, drive])
        late, self._line = self._line[:n], self._line[n:]
        if coil.saturation is not None:
            late = coil.saturation * np.tanh(late / coil.saturation)
        moved, self._state = signal.lfilter(self._b, self._a, late, zi=self._state)
        noise = self._rng.standard_normal((n, 3)).T  # in time order, so that blocks do not matter
        motion: Samples = np.outer(self._direction, coil.full_scale_m_s2 * moved)
        return motion + coil.noise_m_s2 * noise


def discretise(coil: CoilTable, *, rate_hz: float) -> tuple[Samples, Samples]:
    """Make numerator and denominator, shape (3,) each, of a coil's digital filter of unit gain at high frequencies."""
    omega = 2 * rate_hz * np.tan(np.pi * coil.resonance_hz / rate_hz)
    b, a = signal.bilinear([1.0, 0.0, 0.0], [1.0, omega / coil.q, omega**2], fs=rate_hz)
    return np.asarray(b, dtype=np.float64), np.asarray(a, dtype=np.float64)


class Hardware:
    """The coils and the sensor of a rig, without a device; they keep their state between blocks."""

    def __init__(self, rig: Rig, *, rate_hz: float) -> None:
        simulation, self._sensor = rig.simulation or SimulationTable(), rig.sensor
        tables = {coil.name: coil for coil in simulation.coils}
        self._rng = np.random.default_rng(simulation.seed)
        self._coils = []
        for actuator in rig.actuators:
            own = tables.get(actuator.name, CoilTable(name=actuator.name))
            late = own.latency + simulation.latency
            direction = own.direction or actuator.direction
            own = own.model_copy(update={"direction": direction, "latency": late})
            coil = SimulatedCoil(own, rate_hz=rate_hz, rng=self._rng)
            self._coils.append((actuator.channel - 1, coil))
        self._noise_m_s2 = simulation.noise_m_s2
        along = np.array([simulation.sensor_direction])
        several = rig.sensor is not None and len(rig.sensor.inputs) > 1
        self._axes = np.eye(3) if several else along / np.linalg.norm(along)

    def sense(self, out: Frames) -> Frames | None:
        """Return what the sensor's input gets for frames sent, shape (n, channels), as parts of its full scale."""
        motion = self._noise_m_s2 * self._rng.standard_normal((3, len(out)))
        for column, coil in self._coils:
            motion += coil.process(out[:, column].astype(np.float64))
        if self._sensor is None:
            return None
        seen = (self._axes @ motion).T / self._sensor.full_scale_m_s2
        return np.clip(seen, -1, 1).astype(np.float32)


class SimulatedStream(Sink):
    """Coils of `[simulation]` that a thread moves, block by block, as a device would."""

    name = SIMULATED_DEVICE

    def __init__(self, rig: Rig, *, rate_hz: float, fill: Fill, clock: SessionClock) -> None:
        super().__init__(rig, rate_hz=rate_hz, fill=fill, clock=clock)
        self.identity |= {"host_api": "feel321", "is_program": False}
        simulation = rig.simulation or SimulationTable()
        self.latency_s = rig.device.latency_s
        self.there_and_back_s = rig.device.latency_s + simulation.latency / rate_hz
        self._hardware, self._speed = Hardware(rig, rate_hz=rate_hz), simulation.speed
        self._sensed = self._hardware.sense(np.zeros((BLOCK_FRAMES, rig.n_channels), np.float32))
        self._begin_s, self._frame = perf_counter(), 0
        self._closing = Event()
        self._thread = Thread(target=self._run, daemon=True)
        self._thread.start()

    def find_fault(self) -> str:
        """Say whether it has stopped asking for blocks."""
        return "" if self._thread.is_alive() else "stopped"

    def compare_clocks(self) -> float:
        """Find by how much the session's clock is ahead of the device's, in s."""
        return self._clock() - (perf_counter() - self._begin_s) * self._speed

    def close(self) -> None:
        """Silence the device and let it go."""
        self._closing.set()
        self._thread.join()

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
        out = np.zeros((BLOCK_FRAMES, self._rig.n_channels), dtype=np.float32)
        now_s = self._frame / self._rate_hz
        self._frame += BLOCK_FRAMES
        # As with a device, what is sensed is of the block before.
        self._fill(out, BlockTimes(now_s=now_s, dac_s=now_s + self.latency_s), self._sensed)
        self._sensed = self._hardware.sense(out)
