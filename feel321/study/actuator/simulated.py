"""A device that is simulated: it asks for blocks as a real one does, and coils of `[simulation]` move its sensor."""

from collections.abc import Mapping
from threading import Event, Thread
from time import perf_counter

import numpy as np

from feel321.study.actuator.coil import Coil, SimulatedCoil
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.rig import (
    SIMULATED_DEVICE,
    ActuatorTable,
    CoilTable,
    Rig,
    SimulationTable,
)
from feel321.study.actuator.stream import BlockTimes, Device, Fill, SessionClock
from feel321.types import Samples

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
