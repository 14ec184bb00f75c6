import json
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


def test_every_table_of_the_template_is_one(tmp_path: Path) -> None:
    """The optional tables of the template, their # taken away, are read and do not collide."""
    lines = [
        line.removeprefix("# ") if line.startswith("# ") and _is_toml(line[2:]) else line
        for line in TEMPLATE.splitlines()
    ]
    rig = read(tmp_path, "\n".join(lines))
    assert rig.masking is not None
    assert (rig.masking.channels, rig.masking.rms, rig.masking.lead_s) == ((4, 5), 0.05, 0.5)
    assert rig.sensor is not None
    assert rig.sync is not None
    assert (rig.sync.level, rig.sync.duration_s, rig.n_channels) == (0.5, 0.005, 6)


def _is_toml(line: str) -> bool:
    return line.startswith("[") or " = " in line.split("#", maxsplit=1)[0]


COIL = '[[actuators]]\nname = "coil"\nchannel = 1\n'
MASKING = "[masking]\nchannels = [3]\n"
SENSOR = "[sensor]\nchannels = [1, 2, 3]\nfull_scale_m_s2 = 50.0\n"
TURNED = COIL + "direction = {}\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", "rig.toml: limits: missing; add it"),
        ("[devise]\n", "rig.toml: devise: unknown setting; did you mean device?"),
        (COIL + "chanel = 2\n", "actuators[1].chanel: unknown setting; did you mean channel?"),
        ("hertz = 2\n", "limits.hertz: unknown setting; known: peak_m_s2, rms_m_s2, duration_s"),
        (COIL + "plays = []\n", "actuators[1].plays must hold at least one name, got []"),
        (COIL + 'plays = ["q"]\n', "actuators[1].plays[1] must be one of reduced, x, y, z, got 'q'"),
        (COIL + 'plays = ["x", "x"]\n', "must hold each name once, got ['x', 'x']; more than once: x"),
        (COIL + COIL, "actuators must hold each name once; more than once: coil"),
        (COIL + "weight = -1\n", "actuators[1].weight must be greater than 0 or \"off\", got -1"),
        (TURNED.format([0, 0, 0]), "actuators[1].direction must be a direction of motion, such as [1, 0, 0]"),
        (TURNED.format([0, 1]), "rig.toml: actuators[1].direction"),
        (TURNED.format('"up"'), "rig.toml: actuators[1].direction must be a valid array, got 'up'"),
        (
            COIL + COIL.replace('"coil"', '"other"'),
            "channel 1: got actuator 'coil' and actuator 'other', but a channel has one use; move one of them",
        ),
        (MASKING + "[sync]\nchannel = 3\n", "channel 3: got masking and sync, but a channel has one use"),
        ("[masking]\nchannels = []\n", "masking.channels: got [], "),
        (MASKING + "ramp_s = 1.0\n", "masking must have lead_s of ramp_s or more"),
        (MASKING + "rms = 0.5\n", "masking.rms must be less than or equal to 0.15, got 0.5"),
        ("[sensor]\nfull_scale_m_s2 = 1.0\n", "sensor.channels: missing; add it"),
        (SENSOR + "sensitivity_mv_per_g = 100.0\n", "sensor.sensitivity_mv_per_g: unknown setting"),
        ('[calibration]\nphase = "minimum"\n', "calibration.phase: unknown setting"),
        ("[calibration]\nband_hz = [1000, 20]\n", "calibration.band_hz must be two frequencies in Hz that rise"),
        ("[sync]\nchannel = 0\n", "sync.channel must be greater than or equal to 1, got 0"),
        ("[device]\nname = ' '\n", "device.name must not be empty, got ' '"),
        ("[device]\nlatency_s = 0\n", "device.latency_s must be greater than 0, got 0"),
        ("[simulation]\ncoils = 5\n", "simulation.coils must be a valid array, got 5"),
        ("[simulation]\ncoils = [5]\n", "simulation.coils[1] must be a table, got 5"),
        ("[[simulation.coils]]\nname = 'thrid'\n", "names of actuators ('left coil', 'right coil'), got 'thrid'"),
    ],
)  # fmt: skip
def test_a_bad_table_gets_a_line(text: str, line: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\Arig.toml: [^\n]*\Z") as caught:
        read(tmp_path, LIMITS + text if text else text)
    assert line in str(caught.value)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (LIMITS.replace("90.0", "-1"), "limits.peak_m_s2 must be greater than 0, got -1"),
        (
            LIMITS.replace("10.0", "nan"),
            "limits.duration_s must be less than or equal to 3600, got nan",
        ),
        (LIMITS.replace("30", "true"), "limits.rms_m_s2 must be a valid number, got True"),
        ("actuators = []\n" + LIMITS, "rig.toml: actuators must hold at least one name, got []"),
        ("sync = 3\n" + LIMITS, "sync must be a table, got 3"),
        ("sensor = 5\n" + LIMITS, "sensor must be a table, got 5"),
        ("device = 2026-01-01\n" + LIMITS, "got the date or time 2026-01-01"),
        ("device = \n", "not valid TOML"),
        ("a = " + "[" * 150 + "]" * 150 + "\n" + LIMITS, "rig.toml: "),
    ],
)
def test_a_bad_rig_gets_a_line(text: str, line: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"\A[^\n]*\Z") as caught:
        read(tmp_path, text)
    assert line in str(caught.value)


@pytest.mark.parametrize(
    ("added", "is_alike"),
    [
        ("", True),
        ("[device]\nlatency_s = 0.2\n", True),
        ("[sync]\nchannel = 9\n", True),
        ("[calibration]\nlevel = 0.1\n", True),
        ("[simulation]\nlatency = 9\n", True),
        ("[device]\nname = 'Box'\n", False),
        (SENSOR, True),
        ("[[actuators]]\nname = 'left coil'\nchannel = 2\n", False),
    ],
)
def test_the_digest_tells_what_decides_what_the_hand_gets(
    added: str, *, is_alike: bool, tmp_path: Path
) -> None:
    assert (digest(read(tmp_path, LIMITS)) == digest(read(tmp_path, LIMITS + added))) == is_alike


@pytest.mark.parametrize("sensor", ["", SENSOR])
def test_an_identity_is_json_from_which_the_rig_is_read_again(tmp_path: Path, sensor: str) -> None:
    """The journals of sessions that are resumed have it."""
    rig = read(tmp_path, LIMITS + sensor + "[sync]\nchannel = 3\n")
    known = identify(rig)
    assert sorted(known) == ["actuators", "device", "limits", "masking", "sensor", "sync"]
    assert known["sync"] == {"channel": 3, "level": 0.5, "duration_s": 0.005}
    assert known["masking"] is None
    assert digest(Rig.model_validate_json(json.dumps(known))) == digest(rig)
