"""The rig of a lab as `rig.toml` tells it: which actuator hangs on which channel, and what it may do at most.

Samples of stimuli are fractions of the study's full scale; samples for an actuator are fractions of the actuator's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import AfterValidator, Field, model_validator

from feel321.study.settings.fields import (
    Count,
    Finite,
    NotNegative,
    Positive,
    Some,
    Table,
    Words,
    one_of,
    parse_toml,
)

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

FILE_DEVICE = "file"
"""The name of the device that renders to WAV files."""

REDUCED = "reduced"
"""What an actuator plays that plays one-axis stimuli."""

AXES = ("x", "y", "z")
"""What actuators play of three-axis stimuli, in the order of the channels of their files."""

LOUDEST_MASKING = 0.15
"""Largest RMS of masking as a part of full scale: peaks of minutes of Gaussian noise are below six times that."""

Channel = Annotated[int, Field(ge=1, le=1024)]
Level = Annotated[float, Field(gt=0, le=1)]
Acceleration = Annotated[Positive, Field(le=1e6)]
Fade = Annotated[NotNegative, Field(le=60)]


class DeviceTable(Table):
    """`[device]`: what the actuators hang on."""

    name: Words = FILE_DEVICE
    host_api: Words | None = None
    latency_s: Annotated[Positive, Field(le=2)] = 0.05


def _check_direction(direction: tuple[float, float, float]) -> tuple[float, float, float]:
    if not any(direction):
        raise ValueError(
            "allowed is a direction of motion, such as [1, 0, 0]; its length does not matter"
        )
    return direction


Direction = Annotated[tuple[Finite, Finite, Finite], AfterValidator(_check_direction)]


class ActuatorTable(Table):
    """`[[actuators]]`: one actuator; `reach` says what directions and weights do."""

    name: Words
    channel: Channel
    full_scale_m_s2: Acceleration = 100.0
    plays: Annotated[tuple[Annotated[str, one_of((REDUCED, *AXES))], ...], Some] = (REDUCED,)
    direction: Direction | None = None
    weight: Annotated[Positive, Field(le=100)] | None = None


class LimitsTable(Table):
    """`[limits]`: what an actuator may do at most; the RMS is that of any second."""

    peak_m_s2: Acceleration
    rms_m_s2: Acceleration
    duration_s: Positive


class MaskingTable(Table):
    """`[masking]`: pink noise on headphones while something vibrates."""

    channels: tuple[Channel, ...]
    rms: Annotated[float, Field(gt=0, le=LOUDEST_MASKING)] = 0.05
    ramp_s: Fade = 0.2
    lead_s: Fade = 0.5
    seed: Count = 1

    @model_validator(mode="after")
    def _is_on_in_time(self) -> Self:
        if self.ramp_s > self.lead_s:
            raise ValueError(
                f"got a ramp_s of {self.ramp_s:g} and a lead_s of {self.lead_s:g}, allowed is a ramp that is over when "
                "the vibration begins; raise lead_s or lower ramp_s"
            )
        if not self.channels:
            raise ValueError(
                "got no channels, allowed is one or more; name those of the headphones"
            )
        return self


class SensorTable(Table):
    """`[sensor]`: what measures the vibration on an input channel."""

    channel: Channel
    full_scale_m_s2: Acceleration


class SyncTable(Table):
    """`[sync]`: a pulse when a stimulus begins."""

    channel: Channel
    level: Level = 0.5
    duration_s: Annotated[Positive, Field(le=1)] = 0.005


VOICE_COILS = (
    ActuatorTable(name="left coil", channel=1),
    ActuatorTable(name="right coil", channel=2),
)


def _check_names(actuators: tuple[ActuatorTable, ...]) -> tuple[ActuatorTable, ...]:
    if not actuators:
        raise ValueError("allowed is one actuator or more")
    names = [actuator.name for actuator in actuators]
    if doubled := sorted({name for name in names if names.count(name) > 1}):
        raise ValueError(f"allowed is each name once; more than once: {', '.join(doubled)}")
    return actuators


class Rig(Table):
    """The whole of `rig.toml`."""

    device: DeviceTable = DeviceTable()
    actuators: Annotated[tuple[ActuatorTable, ...], AfterValidator(_check_names)] = VOICE_COILS
    limits: LimitsTable
    masking: MaskingTable | None = None
    sensor: SensorTable | None = None
    sync: SyncTable | None = None

    @property
    def n_channels(self) -> int:
        """How many output channels the device must have."""
        return max(channel for channel, _ in self.outputs())

    def outputs(self) -> Iterator[tuple[int, str]]:
        """List what stands on which output channel."""
        for actuator in self.actuators:
            yield actuator.channel, f"actuator {actuator.name!r}"
        for channel in self.masking.channels if self.masking else ():
            yield channel, "masking"
        if self.sync:
            yield self.sync.channel, "sync"


TABLES: dict[tuple[str, ...], type[Table]] = {
    (): Rig,
    ("actuators",): ActuatorTable,
    ("device",): DeviceTable,
    ("limits",): LimitsTable,
    ("masking",): MaskingTable,
    ("sensor",): SensorTable,
    ("sync",): SyncTable,
}
"""Which keys are allowed where."""


def read_rig(path: Path) -> Rig:
    """Read and check a `rig.toml`."""
    rig = parse_toml(path, Rig, tables=TABLES)
    uses: dict[int, list[str]] = {}
    for channel, use in rig.outputs():
        uses.setdefault(channel, []).append(use)
    mistakes = [
        f"{path.name}: channel {channel}: got {' and '.join(shared)}, allowed is one use of a channel; move one of them"
        for channel, shared in sorted(uses.items())
        if len(shared) > 1
    ]
    if mistakes:
        raise ValueError("\n".join(mistakes))
    return rig


def take_device(rig: Rig, name: str) -> Rig:
    """Hang a rig on another device, which is looked for in all host interfaces."""
    return rig.model_copy(
        update={"device": rig.device.model_copy(update={"name": name, "host_api": None})}
    )


def identify(rig: Rig) -> dict[str, Any]:
    """List all that decides what a rig does to a stimulus, for a journal's header."""
    settings = rig.model_dump(mode="json")
    late = ("direction", "weight")
    actuators = [
        {name: value for name, value in actuator.items() if name not in late or value is not None}
        for actuator in settings["actuators"]
    ]
    return {**settings, "actuators": actuators}
