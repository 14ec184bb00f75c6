"""Valid files of every kind, from which fuzzing starts: formats of recordings, and all that a small study holds."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

RATE_HZ = 1000.0
NOW = datetime(2026, 3, 1, 12, tzinfo=UTC)

STUDY = """
[study]
name = "fuzz"
[[recordings]]
scene = "bumps"
duration_s = 0.1
[[recordings]]
scene = "hard_taps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "dft321"]
anchors = false
[session]
protocols = ["abx"]
[[session.questions]]
name = "age"
kind = "number"
question = "How old are you?"
low = 18
high = 99
"""


def make_signal(n: int = 40) -> Any:
    """Three axes that differ, shape (3, n)."""
    return np.random.default_rng(7).normal(size=(3, n)).round(4)


def make_wavs() -> list[bytes]:
    """WAVs of every sample format that is read."""
    from scipy.io import wavfile

    wavs, signal = [], make_signal()
    for kind, scale in (("<f4", 1.0), ("<f8", 1.0), ("<i2", 8000), ("<i4", 2**28), ("u1", 40)):
        content = io.BytesIO()
        frames = (signal.T * scale + (128 if kind == "u1" else 0)).astype(kind)
        wavfile.write(content, int(RATE_HZ), frames)
        wavs.append(content.getvalue())
    return wavs


def make_npz(**further: Any) -> bytes:
    content = io.BytesIO()
    np.savez(content, acceleration=make_signal(), rate_hz=RATE_HZ, unit="m/s^2", **further)
    return content.getvalue()


def make_npy(array: Any) -> bytes:
    content = io.BytesIO()
    np.save(content, array)
    return content.getvalue()


def wrap_npy(content: bytes) -> bytes:
    """Pack bytes as the samples of an NPZ, so that its checksums are right whatever they are."""
    archive = io.BytesIO()
    with zipfile.ZipFile(archive, "w") as file:
        file.writestr("acceleration.npy", content)
        file.writestr("rate_hz.npy", make_npy(np.float64(RATE_HZ)))
    return archive.getvalue()


def make_mats() -> list[bytes]:
    from scipy.io import savemat

    mats = []
    for options in ({"format": "4"}, {"format": "5"}, {"format": "5", "do_compression": True}):
        content = io.BytesIO()
        savemat(content, {"acceleration": make_signal(), "rate_hz": RATE_HZ}, **options)
        mats.append(content.getvalue())
    return mats


def make_tables() -> list[bytes]:
    """Tables with and without head, time, units; separated by comma, semicolon, tab."""
    rows = make_signal().T.tolist()
    plain = "\n".join(",".join(map(str, row)) for row in rows)
    timed = "\n".join(f"{k / RATE_HZ};" + ";".join(map(str, row)) for k, row in enumerate(rows))
    return [
        f"x,y,z\n{plain}\n".encode(),
        plain.encode(),
        f"time (s);x [g];y [g];z [g]\n{timed}".encode(),
        f"# rate: 1000 Hz\n{timed}".replace(".", ",").encode(),
        timed.replace(";", "\t").replace("\n", "\r\n").encode(),
    ]


def make_hatt() -> bytes:
    axes = "".join(
        f"<Accel{axis}>{' '.join(map(str, values))}</Accel{axis}>"
        for axis, values in zip("XYZ", make_signal(), strict=True)
    )
    return f"<Recording><SampleRate>10000</SampleRate><AccelUnit>g</AccelUnit>{axes}</Recording>".encode()


def make_ides() -> list[bytes]:
    """An enDAQ recording by the maker's own schema."""
    import ebmlite
    import idelib

    schema = ebmlite.loadSchema(str(Path(idelib.__file__).parent / "schemata" / "mide_ide.xml"))
    axes = [
        {"SubChannelID": i, "SubChannelName": name, "SubChannelLabel": "g", "SubChannelUnits": "g",
         "SubChannelCalibrationIDRef": 1}
        for i, name in enumerate(("X", "Y", "Z"))
    ]  # fmt: skip
    channel = {
        "ChannelID": 8, "ChannelName": "a", "SubChannel": axes, "ChannelFormat": "<hhh",
        "TimeCodeScale": "1.0/1000000", "TimeCodeModulus": 2**32,
    }  # fmt: skip
    linear = {"CalID": 1, "CalReferenceValue": 0.0, "PolynomialCoef": [0.001, 0.0]}
    counts = (make_signal().T * 1000).astype("<i2").tobytes()
    recorder = {"RecorderTypeUID": 1, "RecorderSerial": 1}
    properties = {"RecorderInfo": recorder, "ChannelList": {"Channel": [channel]}}
    block = {
        "ChannelIDRef": 8, "StartTimeCodeAbsMod": 0, "EndTimeCodeAbsMod": 39_000, "ChannelDataPayload": counts
    }  # fmt: skip
    elements: list[dict[str, Any]] = [
        {"EBML": {"DocType": "mide"}},
        {"RecordingProperties": properties},
        {"CalibrationList": {"UnivariatePolynomial": [linear]}},
        {"ChannelDataBlock": block},
    ]
    return [b"".join(schema.encodes(element) for element in elements)]


def make_study(folder: Path) -> None:
    """Build a study, simulate two participants, calibrate its rig by hand, withdraw one more, benchmark a reducer."""
    from feel321.analysis.tradeoff.benchmark.card import write_card
    from feel321.analysis.tradeoff.benchmark.run import run_benchmark
    from feel321.stimuli.reducers.registry import REDUCERS
    from feel321.study.actuator import certificate
    from feel321.study.actuator.rig import identify, read_rig
    from feel321.study.folder import StudyFolder
    from feel321.study.persons.withdrawal import withdraw_participant
    from feel321.study.study import Study

    study = StudyFolder(folder)
    folder.mkdir(parents=True, exist_ok=True)
    study.settings.write_text(STUDY, encoding="utf-8")
    templates = Path(certificate.__file__).parents[1] / "settings"
    study.rig.write_bytes((templates / "rig_template.toml").read_bytes())
    (folder / "rig_all.toml").write_bytes(study.rig.read_bytes() + RIG)
    (folder / "template.toml").write_bytes((templates / "template.toml").read_bytes())
    (folder / "texts.toml").write_bytes(TEXTS)
    (folder / "rig.json").write_text(
        json.dumps(identify(read_rig(folder / "rig_all.toml"))), encoding="utf-8"
    )
    own = Study.open(folder)
    own.build(page=False)
    own.simulate(3, 1)
    withdraw_participant(study, "sim003", now=lambda: NOW, reason="asked")
    rig = read_rig(study.rig)
    gains = {actuator.name: 100.0 for actuator in rig.actuators}
    made = certificate.make_manual(rig, gains, directions={}, made=NOW, rate_hz=48_000.0)
    certificate.write_certificate(made, folder)
    for file in (folder / "calibration").iterdir():
        file.rename(file.with_stem("c"))
    cards = run_benchmark({"mag321": REDUCERS.mag321}, rounds=3).cards
    write_card(cards[0], folder)
    (folder / "a.wav").write_bytes(make_wavs()[2])
    for axis in "YZ":
        (folder / f"G1_Movement_{axis}_train1.txt").write_bytes(b"0.5\n-1.25\n3e-2\n")
    (folder / "people.csv").write_bytes(PEOPLE)
    names = [
        line.partition(",")[0]
        for line in study.manifest.read_text(encoding="utf-8").splitlines()[1:]
    ]
    rows = [
        f"{who},{name},realism,{50 + 7 * k % 40}"
        for who in ("a", "b")
        for k, name in enumerate(names)
    ]
    (folder / "rated.csv").write_text("\n".join([RATED, *rows]) + "\n", encoding="utf-8")


def make_parquet() -> bytes:
    import pandas as pd

    content = io.BytesIO()
    frame = pd.DataFrame({"participant": ["a"] * 3, "rating": [1.0, 2.0, 3.0]})
    frame.to_parquet(content)
    return content.getvalue()


def pack_cell(table: int, column: int, kind: int, value: bytes) -> bytes:
    return struct.pack("BBB", table, column, kind) + value


CELLS = [
    pack_cell(0, 3, 2, b"running"),
    pack_cell(0, 2, 0, struct.pack("<q", 7)),
    pack_cell(1, 2, 1, struct.pack("<d", 1.5)),
    pack_cell(1, 0, 3, b"\xff"),
    pack_cell(0, 1, 4, b""),
]

RATED = "participant,stimulus_id,scale,rating"
PEOPLE = b"participant,group,rig,calibration\nsim001,old,ab,c1\nsim002,young,ab,c2\n"
RIG = b"""
[masking]
channels = [4, 5]
rms = 0.05
[sensor]
channels = [1, 2, 3]
sensitivity_mv_per_g = 100.0
input_peak_v = 5.0
[sync]
channel = 6
level = 0.5
[keys]
next = ["enter", "b"]
play = ["f1", "f2"]
[calibration]
band_hz = [20, 1000]
"""
TEXTS = b"""
[pages.welcome]
title = "Hello"
[scales.realism]
question = "How real?"
low_label = "Not"
high_label = "Very"
"""
SIDECAR = json.dumps({"unit": "g", "rate_hz": RATE_HZ, "axes": ["x", "y", "z"]}).encode()
MATRIX = b",a,b,c\na,0,1,2\nb,1,0,3\nc,2,3,0\n"
MEANS = b"recording,reducer,mean,sd,n\na,sax321,50,10,12\na,dft321,60,9,12\nb,sax321,40,8,12\nb,dft321,65,10,12\n"
ANSWER = b"1.5\n2.5\n-3e-2\n"
FORMULAS = [
    b"y ~ a + b + (1 | g)",
    b"y ~ a * b + (1 + a || g) + (1 | g:h)",
    b"y ~ I(a**2) + `b` + (0 + a | g/h)",
    b"log(y) ~ C(k) + poly(a, 2) + (1 | g)",
]
ARGUMENTS = [
    b"power\0--participants\012\0--seed\03",
    b"simulate\0--participants\04\0--seed\01\0.",
    b"chart\0--json\0--reducer\0all",
    b"reduce\0x.wav\0--reducer\0dft321\0-o\0y.wav\0--columns\0time,x,y,z",
    b"analyze\0--draws\0100\0--metric\0gain",
    b"build\0--processes\02\0--quiet",
    b"ledger\0--rebuild",
    b"export\0--json",
    b"monitor\0--port\00",
    b"texts\0de",
]
REQUESTS = [
    b"GET /?token=@ HTTP/1.1\nHost: 127.0.0.1:8321\n\n",
    b"POST /act?token=@ HTTP/1.1\nHost: localhost:8321\n\n"
    b'{"kind": "press", "key": "enter", "x": 0.5, "y": -0.25}',
    b"HEAD /screen.json?token=@&after=3 HTTP/1.1\nHost: [::1]:8321\n\n",
]
