"""Certificates: what is written comes back, what was changed is refused, and predictions follow the exact filters."""

import hashlib
import json
from dataclasses import fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy import signal

from feel321.study.actuator.certificate import (
    Certificate,
    CoilCertificate,
    judge_certificates,
    make_manual,
    read_certificate,
    write_certificate,
)
from feel321.study.actuator.device import discretise
from feel321.study.actuator.rig import (
    CalibrationTable,
    CoilTable,
    LimitsTable,
    Rig,
    SensorTable,
    digest,
    take_device,
)
from tests.study.actuator.outside import predict

RATE_HZ = 8000.0
MADE = datetime(2026, 3, 1, 12, tzinfo=UTC)
DAY = timedelta(days=1)
RIG = Rig(
    limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=60.0),
    calibration=CalibrationTable(valid_days=30.0),
)
GAINS = {"left coil": 12.5, "right coil": 10.0}
COIL = CoilTable(name="coil", resonance_hz=160, q=4, direction=(0, 0.6, 0.8))


def make(**changes: Any) -> Certificate:
    directions = {"left coil": np.eye(3)[0], "right coil": np.eye(3)[1]}
    own = {"made": MADE, "rate_hz": RATE_HZ, "directions": directions}
    return make_manual(RIG, GAINS, **{**own, **changes})


def resonate(coil: CoilCertificate) -> CoilCertificate:
    """Give a coil the exact response of a simulated one."""
    frequency_hz = np.linspace(0, RATE_HZ / 2, 16001)
    response = 10 * signal.freqz(*discretise(COIL, rate_hz=RATE_HZ), frequency_hz, fs=RATE_HZ)[1]
    return replace(
        coil, frequency_hz=frequency_hz, response=response, direction=np.array(COIL.direction)
    )


def test_what_is_written_comes_back(tmp_path: Path) -> None:
    certificate = make()
    coils = {name: resonate(coil) for name, coil in certificate.coils.items()}
    written = write_certificate(replace(certificate, coils=coils, failures=("too late",)), tmp_path)
    found = read_certificate(tmp_path / "calibration" / f"{certificate.id}.json")
    assert (found.identity, found.method) == (written.identity, "manual")
    assert (found.band_hz, found.failures, found.rig_sha256) == (
        (20.0, 1000.0), ("too late",), digest(RIG),
    )  # fmt: skip
    for name, coil in coils.items():
        for array in (one.name for one in fields(coil)):
            np.testing.assert_array_equal(getattr(found.coils[name], array), getattr(coil, array))
    with pytest.raises(FileExistsError, match="not overwritten"):
        write_certificate(certificate, tmp_path)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b'"target": 12.5', b'"target": 13.5', "changed after it was written"),
        (b"2026-03-31", b"2036-03-31", "changed after it was written"),
        (b"AAAA", b"AABA", "changed after it was written"),
        (b"{", b"", "not a certificate"),
    ],
)
def test_what_was_changed_is_refused(tmp_path: Path, old: bytes, new: bytes, reason: str) -> None:
    certificate = write_certificate(make(), tmp_path)
    path = tmp_path / "calibration" / f"{certificate.id}.json"
    path.write_bytes(path.read_bytes().replace(old, new, 1))
    with pytest.raises(ValueError, match=reason) as refusal:
        read_certificate(path)
    assert "\n" not in str(refusal.value)
    found, faults = judge_certificates(tmp_path, RIG, now=MADE)
    assert found is None
    assert len(faults) == 1


GOOD: dict[str, Any] = {"left": {"name": "left coil", "channel": 1}}
FORGED = [
    ({"coils": 5}, "coils"), ({"coils": ["x"]}, "coils"), ({"coils": {"a": 1}}, "coils.a"), ({"coils": {}}, "coils"),
    ({"coils": GOOD}, "coils.left.full_scale_m_s2"), ({"sensor": 5}, "sensor"), ({"band_hz": 5}, "band_hz"),
    ({"sensor": {"channels": [1, 2, 3]}}, "sensor.full_scale_m_s2"), ({"expires_utc": "soon"}, "expires_utc"),
    ({"expires_utc": "2026-01-01"}, "expires_utc"), ({"expires_utc": 5}, "expires_utc"), ({"rate_hz": 0}, "rate_hz"),
    ({"own": 1}, "own"), ({"format": "9"}, "format"),
    *(({"target": gain}, "coils.left coil.target") for gain in (0, -1, "x", None, [1])),
    ({"full_scale_m_s2": 0}, "coils.left coil.full_scale_m_s2"),
    *(({"fir": text}, "coils.left coil.fir") for text in ("", "x", "UEsDBA==", 5)),
]  # fmt: skip


@pytest.mark.parametrize(("change", "place"), FORGED)
def test_what_was_forged_with_a_new_seal_is_one_line_with_its_place(
    tmp_path: Path, change: dict[str, Any], place: str
) -> None:
    certificate = write_certificate(make(), tmp_path)
    path = tmp_path / "calibration" / f"{certificate.id}.json"
    entry = json.loads(path.read_text(encoding="utf-8"))
    (entry["coils"]["left coil"] if "left coil" in place else entry).update(change)
    del entry["sha256"]
    seal = hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()
    path.write_text(json.dumps(entry | {"sha256": seal}), encoding="utf-8")
    found, (line,) = judge_certificates(tmp_path, RIG, now=MADE)
    assert found is None
    assert line.startswith(f"certificate {path.name}: {place}: ")
    assert line.endswith("; calibrate again")


def test_a_key_that_an_older_version_wrote_as_null_is_no_reason_to_calibrate_again(
    tmp_path: Path,
) -> None:
    sensor = SensorTable(channels=(1, 2, 3), full_scale_m_s2=100.0)
    certificate = write_certificate(replace(make(), sensor=sensor), tmp_path)
    path = tmp_path / "calibration" / f"{certificate.id}.json"
    entry = json.loads(path.read_text(encoding="utf-8"))
    del entry["sha256"]
    entry["sensor"]["channel"] = None
    seal = hashlib.sha256(json.dumps(entry, sort_keys=True).encode()).hexdigest()
    path.write_text(json.dumps(entry | {"sha256": seal}), encoding="utf-8")
    assert read_certificate(path).sensor == sensor


@pytest.mark.parametrize(
    ("gains", "reason"),
    [
        ({"left coil": 1.0}, "not so: 'right coil'"),
        ({**GAINS, "third": 1.0}, "not so: 'third'"),
        ({"left coil": 0.0, "right coil": 1.0}, "must be positive m/s² per full scale, got 0"),
    ],
)
def test_typed_gains_must_be_of_the_rigs_coils(gains: dict[str, float], reason: str) -> None:
    with pytest.raises(ValueError, match=reason):
        make_manual(RIG, gains, directions={}, made=MADE, rate_hz=RATE_HZ)


def test_the_newest_valid_certificate_of_the_rig_is_found(tmp_path: Path) -> None:
    other = take_device(RIG, "other")
    assert judge_certificates(tmp_path, RIG, now=MADE) == (
        None, ["no certificate of calibration; run feel321 calibrate"],
    )  # fmt: skip
    first, second = (write_certificate(make(made=MADE + n * DAY), tmp_path) for n in (0, 1))
    for later in (timedelta(), 29 * DAY):
        found = judge_certificates(tmp_path, RIG, now=MADE + DAY + later)[0]
        assert found is not None
        assert found.id == second.id != first.id
    for faulty, kind in (
        (judge_certificates(tmp_path, RIG, now=MADE + 31 * DAY), "expired on 2026-04-01"),
        (judge_certificates(tmp_path, other, now=MADE + DAY), "is of another rig"),
        (judge_certificates(tmp_path, RIG, now=MADE + DAY, rate_hz=48000.0), "was measured at 8000 Hz"),
    ):  # fmt: skip
        assert faulty[0] is None
        assert len(faulty[1]) == 1
        assert kind in faulty[1][0]
    left, right = first.coils.values()
    swapped = replace(first, coils={"left coil": right, "right coil": left})
    assert "is of another rig" in swapped.find_faults(RIG, MADE)[0]


def test_a_prediction_is_the_sum_of_the_coils_exact_filters() -> None:
    certificate = make()
    left, right = certificate.coils.values()
    late = replace(resonate(right), latency=5)
    certificate = replace(certificate, coils={"left coil": left, "right coil": late})
    frames = np.zeros((4000, 2))
    frames[:2000] = 0.1 * np.random.default_rng(1).standard_normal((2000, 2))
    found = predict(certificate, frames)
    moved = 10 * signal.lfilter(*discretise(COIL, rate_hz=RATE_HZ), frames[:, 1])
    expected = np.outer([0, 0.6, 0.8], np.concatenate([np.zeros(5), moved[:-5]]))
    expected[0] += 12.5 * frames[:, 0]
    assert np.abs(found - expected).max() < 0.01 * np.abs(expected).max()


def test_coils_of_unlike_latency_move_together() -> None:
    certificate = make()
    left, right = certificate.coils.values()
    certificate = replace(
        certificate, coils={"left coil": left, "right coil": replace(right, latency=5)}
    )
    asked = np.random.default_rng(1).standard_normal(50)
    sent = {name: certificate.drive(name, asked) for name in certificate.coils}
    frames = np.zeros((60, 2))
    for column, samples in enumerate(sent.values()):
        frames[: len(samples), column] = samples
    moved = predict(certificate, frames)
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-9)
    np.testing.assert_allclose(moved[0, 5:55], asked, atol=1e-9)
