"""The rig of a lab, as described by `rig.toml`: which actuator is on which channel, and its limits."""

import hashlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from feel321.study.keys import USUAL, KeysTable
from feel321.study.settings import fields

FILE_DEVICE = "file"  # the name of the device that renders to WAV files
SIMULATED_DEVICE = "simulated"  # the name of the device that `[simulation]` describes
RATE_HZ = 48000.0  # at which a device is tried that belongs to no study
REDUCED = "reduced"  # what an actuator plays of one-axis stimuli
AXES = ("x", "y", "z")  # of three-axis stimuli, in the order of the channels of their files
MARGIN = 0.9  # of limits and of the sensor's full scale, for what is foreseen
LOUDEST_MASKING = 0.15  # of full scale: peaks of minutes of Gaussian noise are below 6 RMS

Channel = Annotated[int, Field(ge=1, le=1024)]
Level = Annotated[float, Field(gt=0, le=1)]
Acceleration = Annotated[fields.Positive, Field(le=1e6)]
Fade = Annotated[fields.NotNegative, Field(le=60)]


class DeviceTable(fields.TomlTable):
    """`[device]`: the audio device that drives the actuators."""

    name: fields.Words = FILE_DEVICE
    host_api: fields.Words | None = None
    latency_s: Annotated[fields.Positive, Field(le=2)] = 0.05


def _check_direction(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(direction):
        raise ValueError("must be a direction of motion, such as [1, 0, 0]; its length is ignored")
    return direction


Three = tuple[fields.Finite, fields.Finite, fields.Finite]
Direction = Annotated[Three, AfterValidator(_check_direction)]
Source = Annotated[str, fields.one_of((REDUCED, *AXES))]


class ActuatorTable(fields.TomlTable):
    """`[[actuators]]`: one actuator; `render` explains directions and weights."""

    name: fields.Words
    channel: Channel
    full_scale_m_s2: Acceleration = 100.0
    plays: Annotated[tuple[Source, ...], fields.Some] = (REDUCED,)
    direction: Direction | None = None
    weight: Annotated[fields.Positive, Field(le=100)] | None = None


class LimitsTable(fields.TomlTable):
    """`[limits]`: limits of each actuator; the RMS is that of any second."""

    peak_m_s2: Acceleration
    rms_m_s2: Acceleration
    duration_s: Annotated[fields.Positive, Field(le=3600)]


class MaskingTable(fields.TomlTable):
    """`[masking]`: pink noise on headphones while something vibrates."""

    channels: Annotated[tuple[Channel, ...], Field(min_length=1)]
    rms: Annotated[float, Field(gt=0, le=LOUDEST_MASKING)] = 0.05
    ramp_s: Fade = 0.2
    lead_s: Fade = 0.5
    seed: fields.Seed = 1

    @model_validator(mode="after")
    def _is_on_in_time(self) -> Self:
        if self.ramp_s > self.lead_s:
            raise ValueError("must have lead_s of ramp_s or more: then the ramp is over in time")
        return self


class SensorTable(fields.TomlTable):
    """`[sensor]`: the inputs (x, y, z) that measure the vibration; `device`: where another one plays."""

    channels: tuple[Channel, Channel, Channel]
    device: fields.Words | None = None
    full_scale_m_s2: Acceleration


class CoilTable(fields.TomlTable):
    """`[[simulation.coils]]`: a simulated voice coil in place of the actuator of the same name."""

    name: fields.Words
    resonance_hz: fields.Positive = 160.0
    q: fields.Positive = 3.0
    full_scale_m_s2: Acceleration = 100.0
    direction: Direction | None = None
    latency: fields.Count = 0
    noise_m_s2: fields.NotNegative = 0.0
    saturation: fields.Positive | None = None


class SimulationTable(fields.TomlTable):
    """`[simulation]`: hardware for machines that have none; latency: samples from sending to the sensor."""

    speed: Annotated[fields.Positive, Field(le=1000)] = 1.0
    latency: fields.Count = 960
    noise_m_s2: fields.NotNegative = 0.01
    coils: tuple[CoilTable, ...] = ()
    seed: fields.Seed = 1


class SyncTable(fields.TomlTable):
    """`[sync]`: a pulse at the onset of each stimulus."""

    channel: Channel
    level: Level = 0.5
    duration_s: Annotated[fields.Positive, Field(le=1)] = 0.005


def _check_band(band_hz: tuple[float, float]) -> tuple[float, float]:
    if not 0 < band_hz[0] < band_hz[1]:
        raise ValueError("must be two frequencies in Hz that rise, such as [20, 1000]")
    return band_hz


BandHz = Annotated[tuple[fields.Finite, fields.Finite], AfterValidator(_check_band)]
Decibels = Annotated[fields.Positive, Field(le=60)]


class CalibrationTable(fields.TomlTable):
    """`[calibration]`: how `calibrate` measures the coils, and what a certificate must keep to pass."""

    band_hz: BandHz = (20.0, 1000.0)
    max_gain_db: Decibels | None = None
    level: Level = 0.5
    sweep_s: Annotated[fields.Positive, Field(le=60)] = 4.0
    pause_s: Annotated[fields.Positive, Field(le=10)] = 1.0
    repeats: Annotated[int, Field(ge=2, le=32)] = 3
    valid_days: fields.Positive = 90.0
    max_deviation_db: Decibels = 3.0
    max_drift_db: Decibels = 1.0
    max_uncertainty_db: Decibels = 2.0
    max_distortion: fields.Share = 0.2
    min_coherence: fields.Share = 0.95
    sensor_uncertainty_db: Decibels = 0.5
    gain_uncertainty_db: Decibels = 2.0


def _check_actuators(actuators: tuple[ActuatorTable, ...]) -> tuple[ActuatorTable, ...]:
    fields.check_some(tuple(actuator.name for actuator in actuators))
    return actuators


class Rig(fields.TomlTable):
    """The whole of `rig.toml`."""

    device: DeviceTable = DeviceTable()
    actuators: Annotated[tuple[ActuatorTable, ...], AfterValidator(_check_actuators)] = (
        ActuatorTable(name="left coil", channel=1),
        ActuatorTable(name="right coil", channel=2),
    )
    limits: LimitsTable
    masking: MaskingTable | None = None
    sensor: SensorTable | None = None
    sync: SyncTable | None = None
    calibration: CalibrationTable = CalibrationTable()
    simulation: SimulationTable | None = None
    keys: KeysTable = USUAL

    @property
    def n_channels(self) -> int:
        """Number of output channels that the device must have."""
        return max(channel for channel, _ in self.outputs())

    def outputs(self) -> Iterator[tuple[int, str]]:
        """List the use of each output channel."""
        for actuator in self.actuators:
            yield actuator.channel, f"actuator {actuator.name!r}"
        for channel in self.masking.channels if self.masking else ():
            yield channel, "masking"
        if self.sync:
            yield self.sync.channel, "sync"


def read_rig(path: Path) -> Rig:
    """Read and check a `rig.toml`."""
    if not path.is_file():
        raise FileNotFoundError(
            f"{path}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    rig = fields.parse_toml(path, Rig)
    uses: dict[int, list[str]] = {}
    for channel, use in rig.outputs():
        uses.setdefault(channel, []).append(use)
    mistakes = [
        f"channel {channel}: got {' and '.join(shared)}, but a channel has one use; move one of them"
        for channel, shared in sorted(uses.items())
        if len(shared) > 1
    ]
    names = [actuator.name for actuator in rig.actuators]
    coils = {coil.name for coil in rig.simulation.coils} if rig.simulation else set()
    mistakes += [
        f"simulation.coils must have the names of actuators ({', '.join(map(repr, names))}), got {name!r}"
        for name in sorted(coils.difference(names))
    ]
    if mistakes:
        raise ValueError("\n".join(f"{path.name}: {mistake}" for mistake in mistakes))
    return rig


def require_sensor(rig: Rig) -> SensorTable:
    """Find the rig's sensor, or refuse a rig without."""
    if rig.sensor is None:
        raise ValueError(
            "rig.toml has no [sensor], which calibrate needs; add one, or type gains: feel321 calibrate --manual "
            "'NAME=GAIN' (m/s² at full scale)"
        )
    return rig.sensor


def find_allowed(rig: Rig, actuator: ActuatorTable) -> float:
    """Find the largest peak of a sine, as a part of full scale, that the mixer lets pass."""
    limits = min(rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2)
    return min(1.0, MARGIN * limits / actuator.full_scale_m_s2)


def advise_latency(rig: Rig) -> str:
    """Say how a device runs dry less often; the pauses of sweeps must exceed the way there and back."""
    advice, twice_s = "raise latency_s under [device] in rig.toml", 2 * rig.device.latency_s
    if rig.calibration.pause_s > 2 * twice_s:  # there and back, were it twice as long
        return advice
    return f"{advice}, and pause_s under [calibration] to more than twice that"


def take_device(rig: Rig, name: str) -> Rig:
    """Put a rig on another device, which is searched for in all host interfaces."""
    device = rig.device.model_copy(update={"name": name, "host_api": None})
    return rig.model_copy(update={"device": device})


def identify(rig: Rig) -> dict[str, Any]:
    """List all that decides what a rig does to a stimulus, for a journal's header; calibration and keys do not."""
    settings = rig.model_dump(mode="json", exclude={"calibration", "keys"})
    if rig.sensor is not None:
        settings["sensor"] = rig.sensor.model_dump(mode="json", exclude_none=True)
    if settings["simulation"] is None:
        del settings["simulation"]
    return settings


def digest(rig: Rig) -> str:
    """Make a digest of all that decides what a stimulus becomes at the hand: device and actuators."""
    settings = rig.model_dump(mode="json", include={"device", "actuators"}, exclude_none=True)
    del settings["device"]["latency_s"]  # when it comes, not what comes
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
