"""Verbs of the rig: calibrate, doctor."""

import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate, CoilCertificate
    from feel321.study.actuator.doctor import Examination
    from feel321.study.actuator.rig import Rig

Device = Annotated[
    str | None,
    Parameter(
        metavar="NAME", help="Device instead of the rig's: its name, or a unique part of it."
    ),
]


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
    uses the newest that is valid. Ctrl-C stops. The exit code is 1 if the limits of [calibration] in rig.toml
    are not met; run then does not use the certificate.

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
    made = datetime.now(UTC)
    certificate = write_certificate(_certify(rig, manual, rate_hz=rate_hz, made=made), folder.path)
    if not manual:  # of which there is nothing to see
        draw_certificate(certificate, folder.calibration / certificate.id)
    shared.print_facts(
        _describe_certificate(certificate), _list_lines(certificate), as_json=as_json
    )
    for failure in certificate.failures:
        shared.warn(failure)
    return 0 if certificate.passed else 1


RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


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


def _certify(rig: "Rig", manual: Sequence[str], *, rate_hz: float, made: datetime) -> "Certificate":
    """Measure the coils, or take gains that were typed."""
    from feel321.study.actuator.calibrate import calibrate_rig
    from feel321.study.actuator.certificate import make_manual
    from feel321.study.actuator.render import find_directions
    from feel321.study.actuator.rig import FILE_DEVICE

    typed = {}
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


ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""


def _describe_certificate(certificate: "Certificate") -> dict[str, Any]:
    def list_fields(record: object, left_out: set[str]) -> dict[str, Any]:
        names = [name for name in type(record).__slots__ if name not in left_out]  # type: ignore[attr-defined]  # a record's
        return {name: getattr(record, name) for name in names}

    coils = {name: list_fields(coil, ARRAYS) for name, coil in certificate.coils.items()}
    return list_fields(certificate, {"coils"}) | {"passed": certificate.passed, "coils": coils}


def _list_lines(certificate: "Certificate") -> Iterator[str]:
    verdict = "passed" if certificate.passed else "did not pass"
    low, high = certificate.band_hz
    yield (
        f"certificate {certificate.id} ({certificate.method}): {verdict}; {low:g} to {high:g} Hz at "
        f"{certificate.rate_hz:g} Hz, valid until {certificate.expires_utc[:10]}"
    )
    for coil in certificate.coils.values():
        yield f"{coil.name}: {_describe_coil(coil, certificate)}"


def _describe_coil(coil: "CoilCertificate", certificate: "Certificate") -> str:
    if certificate.method == "manual":
        return f"{coil.target:.4g} m/s² at full scale, typed, to ± {coil.uncertainty_db:.1f} dB; no filter"
    direction = ", ".join(f"{part:z.2f}" for part in coil.direction)
    bent_db = max(coil.linearity_db, key=abs)
    return (
        f"{coil.target:.4g} m/s² at full scale, ± {coil.uncertainty_db:.2f} dB; within {coil.largest_db:.2f} dB with "
        f"its filter ({coil.before_db:.1f} dB without; gain up to {coil.gain_db:.0f} dB), coherence "
        f"{coil.least_coherence_after:.3f}\n"
        f"  latency {1e3 * coil.latency / certificate.rate_hz:.2f} ms, direction ({direction}), cross-axis "
        f"{coil.crossed_db:.0f} dB; distortion {coil.total_distortion:.1%}, nonlinearity {bent_db:+z.2f} dB; noise "
        f"{coil.noise_m_s2:.2g} m/s² RMS"
    )


# What is connected to this machine, whether it plays in time, and as it did when it was calibrated.


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
    lines = [*map(_describe_device, devices), *_describe_examination(found)]
    shared.print_facts(facts, [*lines, *_describe_drifts(known)], as_json=as_json)
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
    allowed_db = rig.calibration.max_drift_db
    found = [one.find_fault(allowed_db=allowed_db) for one in drifts]
    return {
        "certificate": certificate.id,
        "drifts": list(map(asdict, drifts)),
        "faults": list(filter(None, found)),
    }


def _describe_drifts(known: Mapping[str, Any] | None) -> Iterator[str]:
    for one in known["drifts"] if known else ():
        if one["n_tones"]:
            yield (
                f"{one['coil']}: {one['median_db']:+.2f} dB from its certificate, {one['largest_db']:+.2f} dB at most, "
                f"in {one['n_tones']} tones"
            )


def _describe_device(device: Mapping[str, Any]) -> str:
    rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
    channels = f"{device['outputs']} out, {device['inputs']} in"
    program = "; through a program" if device["is_program"] else ""
    return f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}"


def _describe_examination(found: "Examination | None") -> Iterator[str]:
    if found is None:
        yield "nothing was played; name a device with --device, or in the study's rig.toml"
        return
    times = "onset times are the device's own"
    if found.n_estimated:
        times = (
            f"{found.n_estimated} of {found.n_pulses} onset times are estimated from the latency: "
            "the device gives none"
        )
    yield f"{found.device} ({found.host_api}) played at {found.rate_hz:g} Hz; latency {found.latency_ms:.1f} ms"
    yield f"pulses {found.n_pulses}, failed {found.n_failed}, underruns {found.n_underruns}"
    yield (
        f"requested to onset {found.onset_ms:.1f} ms, jitter {found.jitter_ms:.2f} ms (median), "
        f"{found.jitter_99_ms:.2f} ms (99 %); longest block {found.callback_ms_max:.2f} ms; {times}"
    )
    if found.sensor is not None:
        yield (
            f"sensor: pulse found in {len(found.sensor.lags_ms)} of {found.sensor.n_recorded} recordings, "
            f"{found.sensor.level_m_s2:.2g} m/s² RMS; noise before it {found.sensor.noise_m_s2:.2g} m/s²"
        )
    if found.sensed_ms is not None:
        yield (
            f"onset's block to sensor {found.sensed_ms:.1f} ms, jitter {found.sensed_jitter_ms:.2f} ms (median), "
            f"{found.sensed_jitter_99_ms:.2f} ms (99 %)"
        )
    if found.stop_ms is not None:
        yield f"a stop is silent after {found.stop_ms:.0f} ms at most; latency_s in rig.toml shortens it"
