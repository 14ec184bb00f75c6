"""Finding the one device that a rig names, among those that PortAudio lists."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from study.actuator.rig import Rig

FALLBACKS = ("default", "sysdefault")
"""Names of whatever the system prefers today: not always the same device, so none that a study can rest on."""


ALSA = "ALSA"
HARDWARE = "(hw:"
"""What ALSA's names have in them where there is a card behind them, not a program."""

PROGRAMS = ("JACK Audio Connection Kit", "PulseAudio", "MME", "Windows DirectSound")
"""Interfaces that are programs themselves."""


@dataclass(frozen=True, slots=True)
class Device:
    """A device as PortAudio lists it.

    Parameters
    ----------
    index : int
        Its number in the list; it changes when something is plugged in.
    name : str
        Its name.
    host_api : str
        Through which interface of the system.
    n_outputs, n_inputs : int
        How many channels it has at most.
    default_rate_hz : float
        The rate that it prefers.
    """

    index: int
    name: str
    host_api: str
    n_outputs: int
    n_inputs: int
    default_rate_hz: float

    @property
    def is_program(self) -> bool:
        """Whether a program stands before the hardware, a sound server say.

        It may convert the rate, and play the rig's channels on others too where its sink has more of them; PortAudio
        learns of neither.
        """
        return self.host_api in PROGRAMS or (self.host_api == ALSA and HARDWARE not in self.name)


def find_device(devices: Sequence[Device], name: str, *, host_api: str | None = None) -> Device:
    """Find an output device by its name, never another one in its stead.

    Parameters
    ----------
    devices : sequence of Device
        What there is.
    name : str
        The whole name, or a part of it, in whatever case, that no other device has.
    host_api : str, optional
        The interface, where several list the device; in whatever case.

    Returns
    -------
    Device
        The device.

    Raises
    ------
    OSError
        If there is none, or more than one: one line with what there is.

    Examples
    --------
    >>> coils = Device(3, "USB Audio: coils (hw:1,0)", "ALSA", 4, 2, 48000.0)
    >>> find_device([coils], "coils").index
    3
    """
    outputs = [device for device in devices if device.n_outputs and device.name.lower() not in FALLBACKS]
    if not outputs:
        raise OSError(f"device: got {name!r}, there is no output device at all; plug it in")
    through = f" through {host_api}" if host_api else ""
    if name.lower() in FALLBACKS:
        raise OSError(f"device: got {name!r}, which may be another one tomorrow; allowed: {_list(outputs)}")
    heard = [device for device in outputs if not host_api or device.host_api.lower() == host_api.lower()]
    found = [device for device in heard if device.name == name]
    found = found or [device for device in heard if name.strip() and name.lower() in device.name.lower()]
    if not found:
        raise OSError(f"device: got {name!r}{through}, which is not there; allowed: {_list(outputs)}")
    if len(found) > 1:
        raise OSError(
            f"device: got {name!r}{through}, which {len(found)} devices have in their names: {_list(found)}; "
            "name one in full, and its host_api in rig.toml"
        )
    return found[0]


def check_channels(device: Device, rig: Rig) -> None:
    """Demand every channel that a rig names.

    Parameters
    ----------
    device : Device
        What the rig hangs on.
    rig : Rig
        The rig.

    Raises
    ------
    OSError
        If a channel is missing.
    """
    n_inputs = rig.sensor.channel if rig.sensor else 0
    for kind, needed, there in (("output", rig.n_channels, device.n_outputs), ("input", n_inputs, device.n_inputs)):
        if needed > there:
            raise OSError(
                f"device: got {device.name!r} with {there} {kind} channel(s), the rig needs {needed}; "
                "take another device, or other channels in rig.toml"
            )


def _list(devices: Sequence[Device]) -> str:
    return ", ".join(f"{device.name!r} ({device.host_api})" for device in devices)
