"""Verbs of the rig: calibrate, doctor."""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.mixer import Frames
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
    redesign: bool = False,
    as_json: Json = False,
) -> int:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps on one coil after another, through the same stream as in a session, recorded by the sensor of rig.toml:
    response, distortion, noise, latency, direction and uncertainty of each coil. From that it proposes the band and the
    gain of a filter that makes each response flat, says what that costs in level, and asks; then it verifies the
    filters by playing through them. Ctrl-C stops; coils that are done are kept. The certificate is stored in the
    study's folder calibration; run uses the newest that is valid. The exit code is 1 if the limits of [calibration] in
    rig.toml are not met; run then does not use the certificate.

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
    if manual:
        made = _type_gains(rig, manual, rate_hz=rate_hz)
    else:
        made = _measure(folder, rig, rate_hz=rate_hz, redesign=redesign)
    certificate = write_certificate(made, folder.path)
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


def _type_gains(rig: "Rig", manual: Sequence[str], *, rate_hz: float) -> "Certificate":
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
    return make_manual(rig, typed, directions=directions, made=datetime.now(UTC), rate_hz=rate_hz)


def _measure(folder: StudyFolder, rig: "Rig", *, rate_hz: float, redesign: bool) -> "Certificate":
    from feel321.study.actuator.calibrate import KEPT, Calibration
    from feel321.study.actuator.rig import FILE_DEVICE

    own = Calibration(
        rig=rig,
        rate_hz=rate_hz,
        made=datetime.now(UTC),
        folder=folder.path,
        agree=partial(agree, folder, rig),
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
    with shared.show_progress("s of sweeps") as own.on_step:
        return own.run()


def agree(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> bool:
    """Show what is proposed for each coil and what it costs in level; ask, where somebody is there."""
    lines = []
    for coil in proposed.coils.values():
        low, high = coil.band_hz
        least = coil.target * 10 ** (-coil.gain_db / 20)
        lines.append(
            f"{coil.name}: flat from {low:.0f} to {high:.0f} Hz within {coil.largest_db:.1f} dB by a gain of up to "
            f"{coil.gain_db:.0f} dB; so it plays up to {coil.target:.3g} m/s², and {least:.2g} where it is weakest"
        )
    shared.echo("\n".join([*lines, *_find_cost(folder, rig, proposed)]), err=True)
    if sys.stdin is None or not sys.stdin.isatty():
        return True
    shared.echo(
        "Enter takes it; n stops: --redesign tries other settings of [calibration].", err=True
    )
    return not sys.stdin.readline().strip().lower().startswith("n")


def _find_cost(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> Iterator[str]:
    """Say how much of full scale the study's stimuli take through the filters, and how weak the weakest then is."""
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
    peaks = {name: float(abs(sound).max()) for name, sound in sounds.items()}
    strongest = max(peaks, key=peaks.__getitem__)
    headroom_db = -20 * math.log10(max(peaks[strongest], 1e-9))
    told = f"headroom {headroom_db:.1f} dB"
    if headroom_db < 0:
        told = f"{-headroom_db:.1f} dB too much: lower gain or headroom in study.toml by that, and build again"
    yield f"strongest stimulus {strongest}: {peaks[strongest]:.0%} of full scale, {told}"
    levels = {one.stimulus_id: one.sensation_level_db for one in stimuli}
    felt = {name: level for name, level in levels.items() if math.isfinite(level)}
    if felt:
        weakest = min(felt, key=felt.__getitem__)
        left_db = felt[weakest] + min(headroom_db, 0.0)
        yield f"weakest stimulus {weakest}: {left_db:.1f} dB over the threshold of feeling"


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
    devices, found, known = [] if is_simulated else survey_devices(), None, None
    faults: list[str] = []
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            certificate, faults = _find_certificate(study, rig, rate_hz=rate_hz)
            probes, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
            faults += [f"{name}: {one['fault']}" for name, one in probes.items() if one["fault"]]
            faults += [hum] if hum else []
            known = {
                "certificate": certificate and certificate.id,
                "coils": probes,
                "faults": faults,
            }
    facts = {"devices": devices, "examination": found, "rig": known}
    lines = [*shared.lay_facts(facts)]
    if found is None:
        lines.append("nothing was played; name a device with --device, or in the study's rig.toml")
    shared.print_facts(facts, lines, as_json=as_json)
    if found is not None and found["is_program"]:
        shared.warn(
            f"{found['device']}: a program plays it (a sound server, say), which may convert the rate and copy "
            "channels to others without notice; name the card itself, or give it as many channels as the rig has"
        )
    if found is not None and found["error"]:
        shared.warn(found["error"])
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
