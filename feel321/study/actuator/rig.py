"""The rig of a lab, as described by `rig.toml`: which actuator is on which channel, and its limits.

Samples of stimuli are fractions of the study's full scale; samples for an actuator are fractions of the actuator's.
"""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from feel321.study.settings import fields

FILE_DEVICE = "file"  # the name of the device that renders to WAV files
REDUCED = "reduced"  # what an actuator plays of one-axis stimuli
AXES = ("x", "y", "z")  # of three-axis stimuli, in the order of the channels of their files
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


Direction = Annotated[
    tuple[fields.Finite, fields.Finite, fields.Finite], AfterValidator(_check_direction)
]


class ActuatorTable(fields.TomlTable):
    """`[[actuators]]`: one actuator; `render` explains directions and weights."""

    name: fields.Words
    channel: Channel
    full_scale_m_s2: Acceleration = 100.0
    plays: Annotated[tuple[Annotated[str, fields.one_of((REDUCED, *AXES))], ...], fields.Some] = (
        REDUCED,
    )
    direction: Direction | None = None
    weight: Annotated[fields.Positive, Field(le=100)] | None = None


class LimitsTable(fields.TomlTable):
    """`[limits]`: limits of each actuator; the RMS is that of any second."""

    peak_m_s2: Acceleration
    rms_m_s2: Acceleration
    duration_s: fields.Positive


class MaskingTable(fields.TomlTable):
    """`[masking]`: pink noise on headphones while something vibrates."""

    channels: tuple[Channel, ...]
    rms: Annotated[float, Field(gt=0, le=LOUDEST_MASKING)] = 0.05
    ramp_s: Fade = 0.2
    lead_s: Fade = 0.5
    seed: fields.Count = 1

    @model_validator(mode="after")
    def _is_on_in_time(self) -> Self:
        if self.ramp_s > self.lead_s:
            raise ValueError(
                f"got ramp_s {self.ramp_s:g} and lead_s {self.lead_s:g}: the ramp must be over when the vibration "
                "begins; raise lead_s or lower ramp_s"
            )
        if not self.channels:
            raise ValueError("got no channels; name at least one of those of the headphones")
        return self


class SensorTable(fields.TomlTable):
    """`[sensor]`: an input channel that measures the vibration."""

    channel: Channel
    full_scale_m_s2: Acceleration


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
    """`[calibration]`: how `calibrate` measures the coils, and what a certificate must keep to pass.

    level: peak of the loudest sweep, as a part of what device and limits allow. gain_uncertainty_db: of typed gains.
    """

    band_hz: BandHz = (20.0, 1000.0)
    max_gain_db: Decibels = 20.0
    phase: Annotated[str, fields.one_of(("minimum", "linear"))] = "minimum"
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
    gain_uncertainty_db: Decibels = 2.0


VOICE_COILS = (
    ActuatorTable(name="left coil", channel=1),
    ActuatorTable(name="right coil", channel=2),
)


def _check_actuators(actuators: tuple[ActuatorTable, ...]) -> tuple[ActuatorTable, ...]:
    fields.check_some(tuple(actuator.name for actuator in actuators))
    return actuators


class Rig(fields.TomlTable):
    """The whole of `rig.toml`."""

    device: DeviceTable = DeviceTable()
    actuators: Annotated[tuple[ActuatorTable, ...], AfterValidator(_check_actuators)] = VOICE_COILS
    limits: LimitsTable
    masking: MaskingTable | None = None
    sensor: SensorTable | None = None
    sync: SyncTable | None = None
    calibration: CalibrationTable = CalibrationTable()

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
    rig = fields.parse_toml(path, Rig)
    uses: dict[int, list[str]] = {}
    for channel, use in rig.outputs():
        uses.setdefault(channel, []).append(use)
    mistakes = [
        f"{path.name}: channel {channel}: got {' and '.join(shared)}, but a channel has one use; move one of them"
        for channel, shared in sorted(uses.items())
        if len(shared) > 1
    ]
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return rig


def take_device(rig: Rig, name: str) -> Rig:
    """Put a rig on another device, which is searched for in all host interfaces."""
    device = rig.device.model_copy(update={"name": name, "host_api": None})
    return rig.model_copy(update={"device": device})


def identify(rig: Rig) -> dict[str, Any]:
    """List all that decides what a rig does to a stimulus, for a journal's header; how it is calibrated does not."""
    settings = rig.model_dump(mode="json", exclude={"calibration"})
    for actuator in settings["actuators"]:
        # Journals of rigs without these settings were written before there were any.
        for name in ("direction", "weight"):
            if actuator[name] is None:
                del actuator[name]
    return settings


def digest(rig: Rig) -> str:
    """Make a digest of all that decides what a stimulus becomes at the hand: device, actuators and sensor."""
    settings = rig.model_dump(
        mode="json", include={"device", "actuators", "sensor"}, exclude_none=True
    )
    del settings["device"]["latency_s"]  # when it comes, not what comes
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()
