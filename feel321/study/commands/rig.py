"""Verbs of the rig: calibrate, doctor."""

import sys
from collections.abc import Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.rig import Rig

Device = Annotated[
    str | None,
    Parameter(
        metavar="NAME", help="Device instead of the rig's: its name, or a unique part of it."
    ),
]

ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


def calibrate(
    study: File = Path(),
    /,
    *,
    device: Device = None,
    manual: Annotated[tuple[str, ...], Parameter(metavar="NAME=GAIN")] = (),
    flip: bool = False,
    as_json: Json = False,
) -> int:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps and noise on one coil after another, through the same stream as in a session, recorded by the sensor of
    rig.toml: response, distortion, noise, latency, direction and uncertainty of each coil, and a filter that makes its
    response flat, verified by playing through it. The certificate is stored in the study's folder calibration; run
    uses the newest that is valid. Ctrl-C stops. The exit code is 1 if the limits of [calibration] in rig.toml are not
    met; run then does not use the certificate.

    Example: feel321 calibrate my-study

    Parameters
    ----------
    manual
        Type a gain instead of measuring, in m/s² at full scale; once for each.
    flip
        Scale a DC-coupled sensor by turning it over.
    """
    from feel321.study.actuator.certificate import write_certificate
    from feel321.study.actuator.figure import draw_certificate

    folder = require_study(study)
    rig, rate_hz = _find_rig(folder, device) if folder.rig.is_file() else (None, RATE_HZ)
    if rig is None:
        raise FileNotFoundError(
            f"{folder.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    if flip:
        shared.echo(_flip(rig, rate_hz=rate_hz))
        return 0
    certificate = write_certificate(_certify(rig, manual, rate_hz=rate_hz), folder.path)
    if not manual:  # of which there is nothing to see
        draw_certificate(certificate, folder.calibration / certificate.id)
    facts = asdict(certificate) | {"passed": certificate.passed}
    for coil in facts["coils"].values():
        for name in ARRAYS & coil.keys():
            del coil[name]
    verdict = "passed" if certificate.passed else "did not pass"
    until = f"valid until {certificate.expires_utc[:10]}"
    lines = [f"certificate {certificate.id} ({certificate.method}): {verdict}; {until}"]
    shared.print_facts(facts, [*lines, *shared.lay_facts(facts["coils"])], as_json=as_json)
    for failure in certificate.failures:
        shared.warn(failure)
    return 0 if certificate.passed else 1


def _find_rig(study: StudyFolder, device: str | None) -> tuple["Rig | None", float]:
    """Read the study's rig, or make one of two coils for a device; None if neither is named."""
    from feel321.study.actuator.rig import LimitsTable, Rig, read_rig, take_device
    from feel321.study.settings.read import read_settings

    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    return (rig if device is None else take_device(rig, device)), rate_hz


def _flip(rig: "Rig", *, rate_hz: float) -> str:
    from feel321.study.actuator.calibrate import measure_rest, scale_by_flip
    from feel321.study.actuator.rig import require_sensor

    sensor = require_sensor(rig)
    rests = []
    for words in ("Lay the sensor down with one axis up", "Turn it over"):
        shared.echo(f"{words}, let it rest, then press Enter.", err=True)
        sys.stdin.readline()
        rests.append(measure_rest(rig, rate_hz=rate_hz))
    scale = scale_by_flip(*rests, full_scale_m_s2=sensor.full_scale_m_s2)
    return f"full_scale_m_s2 = {scale:.5g}  # by turning it over: for [sensor] in rig.toml"


def _certify(rig: "Rig", manual: Sequence[str], *, rate_hz: float) -> "Certificate":
    """Measure the coils, or take gains that were typed."""
    from feel321.study.actuator.calibrate import calibrate_rig
    from feel321.study.actuator.certificate import make_manual
    from feel321.study.actuator.render import find_directions
    from feel321.study.actuator.rig import FILE_DEVICE

    typed, made = {}, datetime.now(UTC)
    for text in manual:
        name, _, gain = text.rpartition("=")
        try:
            typed[name.strip()] = float(gain)
        except ValueError:
            shared.refuse_use(f"--manual must be NAME=GAIN, such as 'left coil=12.5', got {text!r}")
    if typed:
        directions, _ = find_directions(rig)
        return make_manual(rig, typed, directions=directions, made=made, rate_hz=rate_hz)
    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    with shared.show_progress("s of sweeps") as progress:
        return calibrate_rig(rig, rate_hz=rate_hz, made=made, on_step=progress)


def doctor(
    study: File | None = None,
    /,
    *,
    device: Device = None,
    seconds: Annotated[float, within(0, 3600)] = 5.0,
    as_json: Json = False,
) -> int:
    """Test the rig: list devices, measure latency and jitter.

    Checks rig.toml and plays quiet pulses on every actuator, through the same stream as in a session. A sensor named in
    rig.toml must show the pulses, about as strong as they were sent; otherwise the exit code is 1. With a certificate
    of calibrate, a second of tones on each coil must show the response that it holds. Without a study, or where the rig
    plays to files, --device names what to play on.

    Example: feel321 doctor my-study --seconds 10

    Parameters
    ----------
    seconds
        Duration of the pulse train, in s.
    """
    from feel321.study.actuator.doctor import examine_rig, survey_devices
    from feel321.study.actuator.rig import FILE_DEVICE, SIMULATED_DEVICE

    rig, rate_hz = _find_rig(StudyFolder(Path()) if study is None else require_study(study), device)
    if rig is not None and rig.device.name == FILE_DEVICE:
        rig = None
    is_simulated = rig is not None and rig.device.name == SIMULATED_DEVICE
    devices, found, known = [] if is_simulated else survey_devices(), None, None
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
    fault = found.sensor.fault if found is not None and found.sensor is not None else ""
    if study is not None and rig is not None and found is not None and not fault:
        known = _compare_with_certificate(study, rig, rate_hz=rate_hz)
    examination = None if found is None else asdict(found)
    facts = {"devices": devices, "examination": examination, "calibration": known}
    lines = [*shared.lay_facts(facts)]
    if found is None:
        lines.append("nothing was played; name a device with --device, or in the study's rig.toml")
    shared.print_facts(facts, lines, as_json=as_json)
    if found is not None and found.is_program:
        shared.warn(
            f"{found.device}: a program plays it (a sound server, say), which may convert the rate and copy channels "
            "to others without notice; name the card itself, or give it as many channels there as the rig has"
        )
    if found is not None and found.error:
        shared.warn(found.error)
    if faults := [fault] if fault else known["faults"] if known else ():
        raise OSError("\n".join(faults))
    return 1 if found is not None and (found.n_failed or found.n_underruns) else 0


def _compare_with_certificate(folder: Path, rig: "Rig", *, rate_hz: float) -> dict[str, Any] | None:
    """Compare the rig with its newest certificate, if there is any: how far the coils drifted, and what is wrong."""
    from feel321.study.actuator.certificate import judge_certificates, list_certificates
    from feel321.study.actuator.doctor import measure_drift

    if not list_certificates(folder):
        return None
    now = datetime.now(UTC)
    certificate, faults = judge_certificates(folder, rig, now=now, rate_hz=rate_hz)
    if certificate is None:
        return {"certificate": None, "drifts": (), "faults": faults}
    is_measured = certificate.method == "measured" and rig.sensor is not None
    drifts = measure_drift(rig, certificate) if is_measured else []
    found = [one.find_fault(allowed_db=rig.calibration.max_drift_db) for one in drifts]
    return {
        "certificate": certificate.id,
        "drifts": list(map(asdict, drifts)),
        "faults": list(filter(None, found)),
    }
