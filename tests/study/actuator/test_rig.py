from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path

import pytest

from feel321.study.actuator.rig import Rig, digest, identify, read_rig

LIMITS = "[limits]\npeak_m_s2 = 90.0\nrms_m_s2 = 30\nduration_s = 10.0\n"
TEMPLATE = (Path(__file__).parents[1] / "settings" / "all_rig_settings.toml").read_text(
    encoding="utf-8"
)


def read(tmp_path: Path, text: str) -> Rig:
    path = tmp_path / "rig.toml"
    path.write_text(text, encoding="utf-8")
    return read_rig(path)


def test_two_voice_coils_are_the_default(tmp_path: Path) -> None:
    rig = read(tmp_path, LIMITS)
    assert [(a.name, a.channel, a.plays) for a in rig.actuators] == [
        ("left coil", 1, ("reduced",)),
        ("right coil", 2, ("reduced",)),
    ]
    assert (rig.n_channels, rig.device.name, rig.masking, rig.sensor, rig.sync) == (
        2,
        "file",
        None,
        None,
        None,
    )
    assert rig.limits.rms_m_s2 == 30.0


def test_the_template_is_a_rig_that_plays_every_axis(tmp_path: Path) -> None:
    text = (files("feel321.study") / "settings" / "rig_template.toml").read_text(encoding="utf-8")
    rig = read(tmp_path, text)
    assert {source for actuator in rig.actuators for source in actuator.plays} == {
        "reduced",
        "x",
        "y",
        "z",
    }


def test_every_table_of_the_template_is_one(tmp_path: Path) -> None:
    """The optional tables of the template, their # taken away, are read and do not collide."""
    lines = [
        line.removeprefix("# ") if line.startswith("# ") and _is_toml(line[2:]) else line
        for line in _lines()
    ]
    rig = read(tmp_path, "\n".join(lines))
    assert rig.masking is not None
    assert (rig.masking.channels, rig.masking.rms, rig.masking.ramp_s, rig.masking.lead_s) == (
        (4, 5),
        0.05,
        0.2,
        0.5,
    )
    assert rig.sensor is not None
    assert rig.sync is not None
    assert (rig.sync.level, rig.sync.duration_s, rig.n_channels) == (0.5, 0.005, 6)


def _lines() -> list[str]:
    return TEMPLATE.splitlines()


def _is_toml(line: str) -> bool:
    return line.startswith("[") or " = " in line.split("#", maxsplit=1)[0]


def test_identity_is_json_and_tells_every_setting(tmp_path: Path) -> None:
    rig = read(tmp_path, LIMITS + "[sync]\nchannel = 3\n")
    identity = identify(rig)
    assert json.loads(json.dumps(identity)) == identity
    assert identity["sync"] == {"channel": 3, "level": 0.5, "duration_s": 0.005}
    assert identity["masking"] is None
    assert identity != identify(read(tmp_path, LIMITS))


COIL = '[[actuators]]\nname = "coil"\nchannel = 1\n'
MASKING = "[masking]\nchannels = [3]\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "rig.toml: limits: missing; add it"),
        (LIMITS + "[devise]\n", "rig.toml: devise: unknown setting; did you mean device?"),
        (
            LIMITS + COIL + "chanel = 2\n",
            "rig.toml: actuators[1].chanel: unknown setting; did you mean channel?",
        ),
        (
            LIMITS + MASKING + "zzz = 2\n",
            "masking.zzz: unknown setting; known: channels, rms, ramp_s, lead_s, seed",
        ),
        (
            LIMITS + "hertz = 2\n",
            "limits.hertz: unknown setting; known: peak_m_s2, rms_m_s2, duration_s",
        ),
        ("actuators = []\n" + LIMITS, "rig.toml: actuators must hold at least one name, got []"),
        (LIMITS + COIL + "plays = []\n", "actuators[1].plays must hold at least one name, got []"),
        (
            LIMITS + COIL + 'plays = ["q"]\n',
            "actuators[1].plays[1] must be one of reduced, x, y, z, got 'q'",
        ),
        (
            LIMITS + COIL + 'plays = ["x", "x"]\n',
            "must hold each name once, got ['x', 'x']; more than once: x",
        ),
        (LIMITS + COIL + COIL, "actuators must hold each name once; more than once: coil"),
        (
            LIMITS + COIL + COIL.replace('"coil"', '"other"'),
            "channel 1: got actuator 'coil' and actuator 'other', but a channel has one use; move one of them",
        ),
        (
            LIMITS + "[masking]\nchannels = [2]\n",
            "channel 2: got actuator 'right coil' and masking, but a",
        ),
        (
            LIMITS + "[masking]\nchannels = [3, 3]\n",
            "channel 3: got masking and masking, but a channel has one use",
        ),
        (
            LIMITS + MASKING + "[sync]\nchannel = 3\n",
            "channel 3: got masking and sync, but a channel has one use",
        ),
        (LIMITS + "[masking]\nchannels = []\n", "masking: got no channels; name at least one"),
        (
            LIMITS + MASKING + "ramp_s = 1.0\n",
            "masking: got ramp_s 1 and lead_s 0.5: the ramp must be over",
        ),
        (
            LIMITS + MASKING + "rms = 0.5\n",
            "masking.rms must be less than or equal to 0.15, got 0.5",
        ),
        (
            LIMITS + "[sensor]\nfull_scale_m_s2 = 1.0\n",
            "sensor must have either channel or channels (x, y, z); name one of them",
        ),
        (
            LIMITS + "[sensor]\nchannel = 1\nsensitivity_mv_per_g = 100.0\n",
            "sensor must have full_scale_m_s2 alone, or sensitivity_mv_per_g and input_peak_v",
        ),
        (
            LIMITS
            + f"[sensor]\nchannel = 1\nsensitivity_mv_per_g = 1{'0' * 400}\ninput_peak_v = 5.0\n",
            "sensor must have full_scale_m_s2 alone, or",
        ),
        (
            LIMITS + "[calibration]\nband_hz = [1000, 20]\n",
            "calibration.band_hz must be two frequencies in Hz that rise",
        ),
        (
            LIMITS + "[sync]\nchannel = 0\n",
            "sync.channel must be greater than or equal to 1, got 0",
        ),
        (
            LIMITS + "[sync]\nchannel = 3\nlevel = 1.5\n",
            "sync.level must be less than or equal to 1, got 1.5",
        ),
        (LIMITS.replace("90.0", "0"), "limits.peak_m_s2 must be greater than 0, got 0"),
        (LIMITS.replace("90.0", "-1"), "limits.peak_m_s2 must be greater than 0, got -1"),
        (LIMITS.replace("10.0", "nan"), "limits.duration_s must be a finite number, got nan"),
        (LIMITS.replace("30", '"30"'), "limits.rms_m_s2 must be a valid number, got '30'"),
        (LIMITS.replace("30", "true"), "limits.rms_m_s2 must be a valid number, got True"),
        (LIMITS + "[device]\nname = ' '\n", "device.name must not be empty, got ' '"),
        (LIMITS + "[device]\nlatency_s = 0\n", "device.latency_s must be greater than 0, got 0"),
        (LIMITS + "sync = 3\n", "limits.sync: unknown setting"),
        ("sync = 3\n" + LIMITS, "sync must be a table, got 3"),
        ("device = 2026-01-01\n" + LIMITS, "got the date or time 2026-01-01"),
        ("device = \n", "not valid TOML"),
        ("a = " + "[" * 150 + "]" * 150 + "\n" + LIMITS, "rig.toml: "),
    ],
)
def test_a_bad_rig_gets_a_line(text: str, line: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\A[^\n]*\Z") as caught:
        read(tmp_path, text)
    assert line in str(caught.value)


def test_every_mistake_gets_its_own_line(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="limits") as caught:
        read(tmp_path, LIMITS.replace("90.0", "-1").replace("10.0", "0") + "[sync]\n")
    assert [line.split()[1].strip(":") for line in str(caught.value).splitlines()] == [
        "limits.peak_m_s2",
        "limits.duration_s",
        "sync.channel",
    ]


SENSOR = "[sensor]\nchannel = 1\nfull_scale_m_s2 = 50.0\n"


@pytest.mark.parametrize(
    ("added", "is_alike"),
    [
        ("", True),
        ("[device]\nlatency_s = 0.2\n", True),
        ("[sync]\nchannel = 9\n", True),
        ("[calibration]\nlevel = 0.1\n", True),
        ("[simulation]\nlatency = 9\n", True),
        ("[device]\nname = 'Box'\n", False),
        (SENSOR, False),
        ("[[actuators]]\nname = 'left coil'\nchannel = 2\n", False),
    ],
)
def test_the_digest_tells_what_decides_what_the_hand_gets(
    added: str, *, is_alike: bool, tmp_path: Path
) -> None:
    assert (digest(read(tmp_path, LIMITS)) == digest(read(tmp_path, LIMITS + added))) == is_alike


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"rig\.toml"):
        read_rig(tmp_path / "rig.toml")


def test_a_data_sheet_gives_the_sensors_scale(tmp_path: Path) -> None:
    sheet = "[sensor]\nchannels = [1, 2, 3]\nsensitivity_mv_per_g = 100.0\ninput_peak_v = 2.0\n"
    sensor = read(tmp_path, LIMITS + sheet).sensor
    assert sensor is not None
    assert sensor.inputs == (1, 2, 3)
    assert sensor.full_scale_m_s2 == pytest.approx(20 * 9.80665)


def test_identities_of_old_rigs_are_as_they_were(tmp_path: Path) -> None:
    """The journals of sessions that are resumed have them."""
    known = identify(read(tmp_path, LIMITS + SENSOR))
    assert sorted(known) == ["actuators", "device", "limits", "masking", "sensor", "sync"]
    assert known["sensor"] == {"channel": 1, "full_scale_m_s2": 50.0}
