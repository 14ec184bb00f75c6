"""Verbs of the rig: calibrate, doctor."""

import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate, CoilCertificate
    from feel321.study.actuator.mixer import Frames
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
    redesign: bool = False,
    as_json: Json = False,
) -> int:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps on one coil after another, through the same stream as in a session, recorded by the sensor of
    rig.toml: response, distortion, noise, latency, direction and uncertainty of each coil. From that it proposes the
    band and the gain of a filter that makes each response flat, says what that costs in level, and asks; then it
    verifies the filters by playing through them. Any key stops what plays; coils that are done are kept. The
    certificate is stored in the study's folder calibration; run uses the newest that is valid. The exit code is 1 if
    the limits of [calibration] in rig.toml are not met; run then does not use the certificate.

    Example: feel321 calibrate my-study

    Parameters
    ----------
    manual
        Type a gain instead of measuring, in m/s² at full scale; once for each.
    redesign
        Design anew from the stored sweeps, without playing.
    """
    from feel321.study.actuator.certificate import draw_certificate, write_certificate

    folder = require_study(study)
    rig, rate_hz = _find_rig(folder, device) if folder.rig.is_file() else (None, RATE_HZ)
    if rig is None:
        raise FileNotFoundError(
            f"{folder.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    made = datetime.now(UTC)
    if manual:
        certificate = _type_gains(rig, manual, rate_hz=rate_hz, made=made)
    else:
        certificate = _measure(folder, rig, rate_hz=rate_hz, made=made, redesign=redesign)
    certificate = write_certificate(certificate, folder.path)
    if not manual:  # of which there is nothing to see
        draw_certificate(certificate, folder.calibration / certificate.id)
    if as_json:
        shared.print_json(_describe_certificate(certificate))
    else:
        shared.echo("\n".join(_list_lines(certificate)))
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


def _type_gains(
    rig: "Rig", manual: Sequence[str], *, rate_hz: float, made: datetime
) -> "Certificate":
    from feel321.study.actuator.certificate import make_manual
    from feel321.study.actuator.render import find_directions

    typed = {}
    for text in manual:
        name, _, gain = text.rpartition("=")
        try:
            typed[name.strip()] = float(gain)
        except ValueError:
            shared.refuse_use(f"--manual must be NAME=GAIN, such as 'left coil=12.5', got {text!r}")
    directions, _ = find_directions(rig)
    return make_manual(rig, typed, directions=directions, made=made, rate_hz=rate_hz)


def _measure(
    folder: StudyFolder, rig: "Rig", *, rate_hz: float, made: datetime, redesign: bool
) -> "Certificate":
    from feel321.study.actuator.calibrate import KEPT, Calibration
    from feel321.study.actuator.output import SweepStopped
    from feel321.study.actuator.rig import FILE_DEVICE

    own = Calibration(
        rig=rig, rate_hz=rate_hz, made=made, folder=folder.path, agree=partial(_agree, folder, rig)
    )
    if redesign:
        return own.redesign()
    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    if kept := own.find_runs(within=KEPT):
        shared.echo(f"kept, as they were measured a while ago: {', '.join(kept)}", err=True)
    try:
        with shared.show_progress("s of sweeps") as own.on_step, _watch_keys() as own.is_stopping:
            return own.run()
    except SweepStopped:
        raise KeyboardInterrupt from None


def _agree(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> bool:
    """Show what is proposed for each coil and what it costs in level; ask, where somebody is there."""
    lines = []
    for coil in proposed.coils.values():
        low, high = coil.band_hz
        least = coil.target * 10 ** (-coil.gain_db / 20)
        lines.append(
            f"{coil.name}: flat from {low:.0f} to {high:.0f} Hz within {coil.largest_db:.1f} dB by a gain of up to "
            f"{coil.gain_db:.0f} dB; so it plays up to {coil.target:.3g} m/s², and {least:.2g} where it is weakest"
        )
    lines += _find_cost(folder, rig, proposed)
    shared.echo("\n".join(lines), err=True)
    if sys.stdin is None or not sys.stdin.isatty():
        return True
    shared.echo(
        "Enter takes it; n stops, and --redesign tries other settings of [calibration].", err=True
    )
    return not sys.stdin.readline().strip().lower().startswith("n")


def _find_cost(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> Iterator[str]:
    """Say how much of full scale the study's stimuli take through the filters, and how weak the weakest then is."""
    import numpy as np

    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.actuator.render import find_rig_problems
    from feel321.study.settings.read import read_settings

    if not (folder.stimuli.is_dir() and folder.settings.is_file()):
        yield "the study has no stimuli yet; build them, and calibrate --redesign says how strong they come"
        return
    stimuli, own = read_stimuli(folder.stimuli), read_settings(folder.settings).rig
    sounds: dict[str, Frames] = {}
    find_rig_problems(
        rig,
        stimuli,
        rate_hz=own.rate_hz,
        full_scale_m_s2=own.full_scale_m_s2,
        certificate=proposed,
        sounds=sounds,
    )
    peaks = {name: float(np.abs(sound).max()) for name, sound in sounds.items()}
    strongest = max(peaks, key=peaks.__getitem__)
    headroom_db = -20 * math.log10(max(peaks[strongest], 1e-9))
    told = f"headroom {headroom_db:.1f} dB"
    if headroom_db < 0:
        told = f"{-headroom_db:.1f} dB too much: lower gain or headroom in study.toml by that, and build again"
    yield f"strongest stimulus {strongest}: {peaks[strongest]:.0%} of full scale, {told}"
    levels = {
        one.stimulus_id: one.sensation_level_db
        for one in stimuli
        if math.isfinite(one.sensation_level_db)
    }
    if levels:
        weakest = min(levels, key=levels.__getitem__)
        left_db = levels[weakest] + min(headroom_db, 0.0)
        yield f"weakest stimulus {weakest}: {left_db:.1f} dB over the threshold of feeling"


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
    seen = f"coherence {coil.least_coherence_after:.3f}"
    if math.isnan(coil.least_coherence_after):
        seen = "by calculation"
    return (
        f"{coil.target:.4g} m/s² at full scale, ± {coil.uncertainty_db:.2f} dB; within {coil.largest_db:.2f} dB with "
        f"its filter ({coil.before_db:.1f} dB without; gain up to {coil.gain_db:.0f} dB), {seen}\n"
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
    """Test the rig: list devices, measure latency and jitter, try each coil.

    Checks rig.toml and plays quiet pulses on every actuator, through the same stream as in a session. With a sensor, a
    probe on each coil finds by name what is dead, inverted, swapped, loose or too loud, against the certificate of
    calibrate or the directions of rig.toml, and a wrong rate, a missing channel or hum; the exit code is then 1.
    Without a study, or where the rig plays to files, --device names what to play on.

    Example: feel321 doctor my-study --seconds 10

    Parameters
    ----------
    seconds
        Duration of the pulse train, in s.
    """
    from feel321.study.actuator.doctor import examine_rig, probe_coils, survey_devices
    from feel321.study.actuator.rig import FILE_DEVICE, SIMULATED_DEVICE

    rig, rate_hz = _find_rig(StudyFolder(Path()) if study is None else require_study(study), device)
    if rig is not None and rig.device.name == FILE_DEVICE:
        rig = None
    is_simulated = rig is not None and rig.device.name == SIMULATED_DEVICE
    devices, found = [] if is_simulated else survey_devices(), None
    name: str | None = None
    faults: list[str] = []
    probes: list[dict[str, Any]] = []
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            certificate, faults = _find_certificate(study, rig, rate_hz=rate_hz)
            name = certificate.id if certificate else None
            probes, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
            faults += [f"{one['coil']}: {one['fault']}" for one in probes if one["fault"]]
            faults += [hum] if hum else []
    if as_json:
        coils = {"certificate": name, "coils": probes, "faults": faults}
        shared.print_json({"devices": devices, "examination": found, "rig": coils})
    else:
        lines = [*map(_describe_device, devices), *_describe_examination(found)]
        shared.echo("\n".join([*lines, *map(_describe_probe, probes)]))
        _warn_of(found)
    if faults:
        raise OSError("\n".join(faults))
    return 1 if found is not None and (found["n_failed"] or found["n_underruns"]) else 0


def _find_certificate(
    study: Path | None, rig: "Rig", *, rate_hz: float
) -> tuple["Certificate | None", list[str]]:
    """Find the certificate that run would use; what is wrong with those that are there."""
    from feel321.study.actuator.certificate import judge_certificates, list_certificates

    if study is None or not list_certificates(study):
        return None, []
    return judge_certificates(study, rig, now=datetime.now(UTC), rate_hz=rate_hz)


def _describe_probe(probe: Mapping[str, Any]) -> str:
    if not probe["direction"]:
        return f"{probe['coil']}: {probe['fault']}"
    direction = ", ".join(f"{part:z.2f}" for part in probe["direction"])
    return (
        f"{probe['coil']}: {probe['level_m_s2']:.3g} m/s² at full scale along ({direction}), "
        f"{probe['delay_ms']:.1f} ms, distortion {probe['distortion']:.1%}, coherence {probe['coherence']:.2f}: "
        f"{probe['fault'] or 'as it should be'}"
    )


def _describe_device(device: Mapping[str, Any]) -> str:
    rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
    channels = f"{device['outputs']} out, {device['inputs']} in"
    program = "; through a program" if device["is_program"] else ""
    return f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}"


def _describe_examination(found: Mapping[str, Any] | None) -> Iterator[str]:
    if found is None:
        yield "nothing was played; name a device with --device, or in the study's rig.toml"
        return
    times = "onset times are the device's own"
    if found["n_estimated"]:
        times = (
            f"{found['n_estimated']} of {found['n_pulses']} onset times are estimated from the latency: "
            "the device gives none"
        )
    yield (
        f"{found['device']} ({found['host_api']}) played at {found['rate_hz']:g} Hz; latency "
        f"{found['latency_ms']:.1f} ms"
    )
    yield f"pulses {found['n_pulses']}, failed {found['n_failed']}, underruns {found['n_underruns']}"
    for name, told in (("onset", "requested to onset"), ("sensed", "onset's block to sensor")):
        if found[f"{name}_ms"] is not None:
            yield (
                f"{told} {found[f'{name}_ms']:.1f} ms, jitter {found[f'{name}_jitter_ms']:.2f} ms (median), "
                f"{found[f'{name}_jitter_99_ms']:.2f} ms (99 %)"
            )
    yield f"longest block {found['callback_ms_max']:.2f} ms; {times}"


def _warn_of(found: Mapping[str, Any] | None) -> None:
    if found is not None and found["is_program"]:
        shared.warn(
            f"{found['device']}: a program plays it (a sound server, say), which may convert the rate and copy "
            "channels to others without notice; name the card itself, or give it as many channels there as the rig has"
        )
    if found is not None and found["error"]:
        shared.warn(found["error"])
