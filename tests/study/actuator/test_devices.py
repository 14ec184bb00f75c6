from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from feel321.study.actuator.device import Device, check_channels, find_device
from feel321.study.actuator.rig import ActuatorTable, LimitsTable, Rig, SensorTable

if TYPE_CHECKING:
    from collections.abc import Sequence

COILS = Device(0, "USB Audio: coils (hw:1,0)", "ALSA", 4, 0)
COILS_JACK = Device(1, "USB Audio: coils (hw:1,0)", "JACK", 4, 0)
PAIR = Device(2, "coils", "ALSA", 2, 1)
SYSTEM = Device(4, "default", "ALSA", 32, 32)
MICROPHONE = Device(3, "microphone", "ALSA", 0, 2)
LIMITS = LimitsTable(peak_m_s2=10, rms_m_s2=5, duration_s=9)


@pytest.mark.parametrize(
    ("devices", "name", "host_api", "found"),
    [
        ([COILS, PAIR], "coils", None, PAIR),  # the whole name, though another has it as a part
        ([COILS, MICROPHONE], "COILS", None, COILS),
        ([COILS, COILS_JACK], "coils", "jack", COILS_JACK),
    ],
)
def test_a_device_is_found_by_its_name_or_a_part_that_no_other_has(
    devices: Sequence[Device], name: str, host_api: str | None, found: Device
) -> None:
    assert find_device(devices, name, host_api=host_api) == found


@pytest.mark.parametrize(
    ("devices", "name", "host_api", "message"),
    [
        (
            [COILS, PAIR],
            "headset",
            None,
            r"device 'headset' not found; name one of 'USB Audio.*'coils' \(ALSA\)$",
        ),
        (
            [COILS, COILS_JACK],
            "coils",
            None,
            r"2 devices have it in their names: .*\(JACK\); name one in full",
        ),
        ([COILS, COILS_JACK], COILS.name, None, "2 devices have it"),
        ([MICROPHONE], "microphone", None, "there is no output device at all; plug it in"),
        (
            [COILS],
            "coils",
            "JACK",
            r"device 'coils' through JACK not found; name one of .*\(ALSA\)$",
        ),
        ([COILS], " ", None, "device ' ' not found"),
        ([COILS, SYSTEM], "defa", None, "device 'defa' not found; name one of 'USB Audio"),
        ([SYSTEM], "defa", None, "there is no output device at all"),
        ([COILS], "sysdefault", None, "may be another one tomorrow; name one of 'USB Audio"),
    ],
)
def test_nothing_is_taken_in_its_stead(
    devices: Sequence[Device], name: str, host_api: str | None, message: str
) -> None:
    with pytest.raises(OSError, match=message):
        find_device(devices, name, host_api=host_api)


@pytest.mark.parametrize(
    ("name", "host_api", "is_program"),
    [
        (COILS.name, "ALSA", False),
        ("pulse", "ALSA", True),
        ("stylus", "ALSA", True),
        ("coils", "JACK Audio Connection Kit", True),
        ("coils", "Windows DirectSound", True),
        ("coils", "Windows WASAPI", False),
        ("coils", "Core Audio", False),
    ],
)
def test_a_program_before_the_card_is_known(name: str, host_api: str, is_program: bool) -> None:
    assert Device(0, name, host_api, 2, 0).is_program is is_program


def test_every_channel_that_the_rig_names_has_to_be_there() -> None:
    third = (ActuatorTable(name="third", channel=3),)
    check_channels(COILS, Rig(limits=LIMITS, actuators=third))
    with pytest.raises(
        OSError, match=r"device 'coils' has 2 output channel\(s\), the rig needs 3; take another"
    ):
        check_channels(PAIR, Rig(limits=LIMITS, actuators=third))
    with pytest.raises(OSError, match=r"has 1 input channel\(s\), the rig needs 2"):
        check_channels(PAIR, Rig(limits=LIMITS, sensor=SensorTable(channel=2, full_scale_m_s2=9)))
