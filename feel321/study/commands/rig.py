"""Verbs of the rig: calibrate, doctor."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from feel321.study.commands import shared
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate, CoilCertificate
    from feel321.study.actuator.doctor import Drift, Examination
    from feel321.study.actuator.rig import Rig

# What the coils make of the samples sent to them.


@click.command(epilog="Example: feel321 calibrate my-study")
@shared.folder_argument
@click.option(
    "--device",
    help="Another device than the rig's: its name, or a part of it that no other one has.",
)
@click.option(
    "--manual",
    "gains",
    multiple=True,
    metavar="NAME=GAIN",
    help="Instead of measuring: the gain of an actuator, in m/s² at full scale; once for each.",
)
@shared.flag("--flip", "Find the scale of a DC-coupled sensor by turning it over; nothing plays.")
@shared.json_option
@click.pass_context
def calibrate(
    context: click.Context,
    *,
    folder: Path,
    device: str | None,
    gains: Sequence[str],
    flip: bool,
    as_json: bool,
) -> None:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps and noise on one coil after another, through the same stream as in a session, recorded by the sensor of
    rig.toml: response, distortion, noise, latency, direction and uncertainty of each coil, and a filter that makes its
    response flat, verified by playing through it. The certificate is stored in the study's folder calibration; run
    uses the newest that is valid. Press any key to stop. The exit code is 1 if the limits of [calibration] in rig.toml
    are not met; run then does not use the certificate.
    """
    from feel321.study.actuator.certificate import write_certificate
    from feel321.study.actuator.figure import draw_certificate

    study = require_study(folder)
    rig, rate_hz = _require_rig(study, device=device)
    if flip:
        shared.echo(_flip(rig, rate_hz=rate_hz))
        return
    made = datetime.now(UTC)
    certificate = (
        _type_gains(rig, gains, rate_hz=rate_hz, made=made)
        if gains
        else _measure(rig, rate_hz=rate_hz, made=made)
    )
    certificate = write_certificate(certificate, study.path)
    if not gains:  # of which there is nothing to see
        draw_certificate(certificate, study.calibration / certificate.id)
    if as_json:
        shared.print_json(_describe_certificate(certificate))
    else:
        shared.echo("\n".join(_list_lines(certificate)))
    for failure in certificate.failures:
        shared.warn(failure)
    if not certificate.passed:
        context.exit(1)


def _flip(rig: Rig, *, rate_hz: float) -> str:
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


def _require_rig(study: StudyFolder, *, device: str | None) -> tuple[Rig, float]:
    from feel321.study.actuator.rig import read_rig, take_device
    from feel321.study.settings.read import read_settings

    if not study.rig.is_file():
        raise FileNotFoundError(
            f"{study.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    rig, rate_hz = read_rig(study.rig), read_settings(study.settings).rig.rate_hz
    return (rig if device is None else take_device(rig, device)), rate_hz


def _type_gains(rig: Rig, gains: Sequence[str], *, rate_hz: float, made: datetime) -> Certificate:
    from feel321.study.actuator.certificate import make_manual
    from feel321.study.actuator.render import find_directions

    typed = {}
    for text in gains:
        name, _, gain = text.rpartition("=")
        try:
            typed[name.strip()] = float(gain)
        except ValueError:
            raise click.UsageError(
                f"--manual must be NAME=GAIN, such as 'left coil=12.5', got {text!r}"
            ) from None
    directions, _ = find_directions(rig)
    return make_manual(rig, typed, directions=directions, made=made, rate_hz=rate_hz)


def _measure(rig: Rig, *, rate_hz: float, made: datetime) -> Certificate:
    from feel321.study.actuator.calibrate import calibrate_rig
    from feel321.study.actuator.duplex import SweepStopped
    from feel321.study.actuator.rig import FILE_DEVICE

    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    try:
        with shared.show_progress("s of sweeps") as progress, _watch_keys() as is_pressed:
            return calibrate_rig(
                rig, rate_hz=rate_hz, made=made, on_step=progress, is_stopping=is_pressed
            )
    except SweepStopped:
        raise KeyboardInterrupt from None


@contextmanager
def _watch_keys() -> Iterator[Callable[[], bool]]:
    """Give a function that finds out whether a key was pressed, if stdin is a terminal; no Enter is needed."""
    if sys.stdin is None or not sys.stdin.isatty():
        yield lambda: False
        return
    if sys.platform == "win32":
        import msvcrt

        yield msvcrt.kbhit
        return
    import select
    import termios
    import tty

    number = sys.stdin.fileno()
    before = termios.tcgetattr(number)
    try:
        tty.setcbreak(number)
        yield lambda: bool(select.select([number], [], [], 0)[0])
    finally:
        termios.tcflush(number, termios.TCIFLUSH)
        termios.tcsetattr(number, termios.TCSADRAIN, before)


def _describe_certificate(certificate: Certificate) -> dict[str, Any]:
    arrays = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
    own = {
        name: getattr(certificate, name) for name in type(certificate).__slots__ if name != "coils"
    }
    coils = {
        name: {key: getattr(coil, key) for key in type(coil).__slots__ if key not in arrays}
        for name, coil in certificate.coils.items()
    }
    return own | {"passed": certificate.passed, "coils": coils}


def _list_lines(certificate: Certificate) -> Iterator[str]:
    verdict = "passed" if certificate.passed else "did not pass"
    low, high = certificate.band_hz
    yield (
        f"certificate {certificate.id} ({certificate.method}): {verdict}; {low:g} to {high:g} Hz at "
        f"{certificate.rate_hz:g} Hz, valid until {certificate.expires_utc[:10]}"
    )
    for coil in certificate.coils.values():
        yield f"{coil.name}: {_describe_coil(coil, certificate)}"


def _describe_coil(coil: CoilCertificate, certificate: Certificate) -> str:
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

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


@click.command(epilog="Example: feel321 doctor my-study --seconds 10")
@click.argument("folder", metavar="[STUDY]", type=shared.FILE, required=False)
@click.option(
    "--device",
    help="Another device than the rig's: its name, or a part of it that no other one has.",
)
@click.option(
    "--seconds",
    type=shared.BoundedNumber(0, 3600),
    default=5.0,
    show_default=True,
    help="Duration of the pulse train, in s.",
)
@shared.json_option
@click.pass_context
def doctor(
    context: click.Context,
    *,
    folder: Path | None,
    device: str | None,
    seconds: float,
    as_json: bool,
) -> None:
    """Test the rig: list devices, measure latency and jitter.

    Checks rig.toml and plays quiet pulses on every actuator, through the same stream as in a session. A sensor named in
    rig.toml must show the pulses, about as strong as they were sent; otherwise the exit code is 1. With a certificate
    of calibrate, a second of tones on each coil must show the response that it holds. Without a study, or where the rig
    plays to files, --device names what to play on.
    """
    from feel321.study.actuator.doctor import examine_rig, survey_devices
    from feel321.study.actuator.rig import SIMULATED_DEVICE

    rig, rate_hz = _find_rig(folder, device=device)
    is_simulated = rig is not None and rig.device.name == SIMULATED_DEVICE
    devices, found = [] if is_simulated else survey_devices(), None
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
    has_fault = found is not None and found.sensor is not None and bool(found.sensor.fault)
    known = None
    if folder is not None and rig is not None and seconds and not has_fault:
        known = _compare_with_certificate(folder, rig, rate_hz=rate_hz)
    if as_json:
        shared.print_json({
            "devices": devices,
            "examination": None if found is None else asdict(found),
            "calibration": None if known is None else asdict(known),
        })
    else:
        for one in devices:
            shared.echo(_describe_device(one))
        _print_examination(found)
        _print_drifts(known)
    if found is not None and found.sensor is not None and found.sensor.fault:
        raise OSError(found.sensor.fault)
    if known is not None and known.faults:
        raise OSError("\n".join(known.faults))
    if found is not None and (found.n_failed or found.n_underruns):
        context.exit(1)


@dataclass(frozen=True, slots=True)
class _Comparison:
    """The rig today beside its certificate: how far the coils drifted, and what is wrong."""

    certificate: str | None
    drifts: Sequence[Drift]
    faults: Sequence[str]


def _compare_with_certificate(folder: Path, rig: Rig, *, rate_hz: float) -> _Comparison | None:
    """Compare the rig with its newest certificate, if there is any."""
    from feel321.study.actuator.certificate import judge_certificates, list_certificates
    from feel321.study.actuator.doctor import measure_drift

    if not list_certificates(folder):
        return None
    now = datetime.now(UTC)
    certificate, faults = judge_certificates(folder, rig, now=now, rate_hz=rate_hz)
    if certificate is None:
        return _Comparison(None, (), faults)
    is_measured = certificate.method == "measured" and rig.sensor is not None
    drifts = measure_drift(rig, certificate) if is_measured else []
    allowed_db = rig.calibration.max_drift_db
    found = [one.find_fault(allowed_db=allowed_db) for one in drifts]
    return _Comparison(certificate.id, drifts, list(filter(None, found)))


def _print_drifts(known: _Comparison | None) -> None:
    for one in known.drifts if known else ():
        if not one.n_tones:
            continue
        shared.echo(
            f"{one.coil}: {one.median_db:+.2f} dB from its certificate, {one.largest_db:+.2f} dB at most, "
            f"in {one.n_tones} tones"
        )


def _find_rig(folder: Path | None, *, device: str | None) -> tuple[Rig | None, float]:
    """Read the study's rig, or make one of two coils for a device; None if there is nothing to play on."""
    from feel321.study.actuator.rig import FILE_DEVICE, LimitsTable, Rig, read_rig, take_device
    from feel321.study.settings.read import read_settings

    study = StudyFolder(Path()) if folder is None else require_study(folder)
    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    rig = rig if device is None else take_device(rig, device)
    return (None if rig.device.name == FILE_DEVICE else rig), rate_hz


def _describe_device(device: Mapping[str, Any]) -> str:
    rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
    channels = f"{device['outputs']} out, {device['inputs']} in"
    program = "; through a program" if device["is_program"] else ""
    return f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}"


def _describe_times(found: Examination) -> str:
    if not found.n_estimated:
        return "onset times are the device's own"
    return (
        f"{found.n_estimated} of {found.n_pulses} onset times are estimated from the latency: "
        "the device gives none"
    )


def _print_examination(found: Examination | None) -> None:
    if found is None:
        shared.echo("nothing was played; name a device with --device, or in the study's rig.toml")
        return
    lines = [
        f"{found.device} ({found.host_api}) played at {found.rate_hz:g} Hz; latency {found.latency_ms:.1f} ms",
        f"pulses {found.n_pulses}, failed {found.n_failed}, underruns {found.n_underruns}",
        f"requested to onset {found.onset_ms:.1f} ms, jitter {found.jitter_ms:.2f} ms (median), "
        f"{found.jitter_99_ms:.2f} ms (99 %); longest block {found.callback_ms_max:.2f} ms; "
        + _describe_times(found),
    ]
    if found.sensor is not None:
        lines.append(
            f"sensor: pulse found in {len(found.sensor.lags_ms)} of {found.sensor.n_recorded} recordings, "
            f"{found.sensor.level_m_s2:.2g} m/s² RMS; noise before it {found.sensor.noise_m_s2:.2g} m/s²"
        )
    if found.sensed_ms is not None:
        lines.append(
            f"onset's block to sensor {found.sensed_ms:.1f} ms, jitter {found.sensed_jitter_ms:.2f} ms (median), "
            f"{found.sensed_jitter_99_ms:.2f} ms (99 %)"
        )
    if found.stop_ms is not None:
        lines.append(
            f"a stop is silent after {found.stop_ms:.0f} ms at most; latency_s in rig.toml shortens it"
        )
    shared.echo("\n".join(lines))
    if found.is_program:
        shared.warn(
            f"{found.device}: a program plays it (a sound server, say), which may convert the rate and copy channels "
            "to others without notice; name the card itself, or give it as many channels there as the rig has"
        )
    if found.error:
        shared.warn(found.error)
