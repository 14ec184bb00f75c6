"""The verbs of the rig: `calibrate` measures its coils and makes filters for them, `doctor` tests it."""

from __future__ import annotations

import math
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.doors import follow
from feel321.study.actuator.rig import (
    FILE_DEVICE,
    SIMULATED_DEVICE,
    LimitsTable,
    Rig,
    read_rig,
    take_device,
)
from feel321.study.folder import Outcome, UsageError, require_study
from feel321.study.settings.read import read_settings
from feel321.study.terminal import ask, echo, format_facts, is_answerable

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.mixer import Frames
    from feel321.study.folder import OpenStudy, StudyFolder

ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""

RATE_HZ = 48000.0  # at which a device is tried that belongs to no study


def _find_rate(folder: StudyFolder) -> float:
    return read_settings(folder.settings).rig.rate_hz if folder.settings.is_file() else RATE_HZ


def calibrate_rig(
    lab: OpenStudy, *, device: str | None, manual: Sequence[str], redesign: bool
) -> Outcome:
    """Measure the coils, or take typed gains, and store a certificate."""
    from feel321.study.actuator.certificate import (
        FOLDER,
        draw_certificate,
        make_manual,
        write_certificate,
    )
    from feel321.study.actuator.render import find_directions

    folder = lab.folder
    if not folder.rig.is_file():
        raise FileNotFoundError(
            f"{folder.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    rig, rate_hz = read_rig(folder.rig), _find_rate(folder)
    rig = take_device(rig, device) if device else rig
    if manual:
        typed, directions = dict(map(_read_gain, manual)), find_directions(rig)[0]
        made = make_manual(rig, typed, directions=directions, made=lab.now(), rate_hz=rate_hz)
    else:
        made = _measure(lab, rig, rate_hz=rate_hz, redesign=redesign)
    certificate = write_certificate(made, folder.path)
    draw_certificate(certificate, folder.path / FOLDER / certificate.id)
    passed = not certificate.failures
    facts = asdict(certificate) | {"passed": passed}
    for coil in facts["coils"].values():
        for name in ARRAYS & coil.keys():
            del coil[name]
    for failure in certificate.failures:
        lab.say(failure)
    verdict = "passed" if passed else "did not pass"
    until = f"valid until {certificate.expires_utc[:10]}"
    line = f"certificate {certificate.id} ({certificate.method}): {verdict}; {until}"
    return Outcome(facts, [line, *format_facts(facts["coils"])], failed=not passed)


def _read_gain(text: str) -> tuple[str, float]:
    name, _, gain = text.rpartition("=")
    try:
        return name.strip(), float(gain)
    except ValueError:
        example = "'left coil=12.5'"
        raise UsageError(f"--manual must be NAME=GAIN, such as {example}, got {text!r}") from None


def _measure(lab: OpenStudy, rig: Rig, *, rate_hz: float, redesign: bool) -> Certificate:
    from feel321.study.actuator.calibrate import KEPT, Calibration

    consent = partial(agree, lab.folder, rig)
    own = Calibration(
        rig=rig, rate_hz=rate_hz, made=lab.now(), folder=lab.folder.path, agree=consent
    )
    if redesign:
        return own.redesign()
    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    if kept := own.find_runs(within=KEPT):
        echo(f"kept, as they were measured a while ago: {', '.join(kept)}", err=True)
    with follow(lab.progress, "s of sweeps") as own.on_step:
        return own.run()


def agree(folder: StudyFolder, rig: Rig, proposed: Certificate) -> bool:
    """Show what is proposed for each coil and what it costs in level; ask, where somebody is there."""
    for coil in proposed.coils.values():
        low, high = coil.band_hz
        least = coil.target * 10 ** (-coil.gain_db / 20)
        echo(
            f"{coil.name}: flat from {low:.0f} to {high:.0f} Hz within {coil.largest_db:.1f} dB by a gain of up to "
            f"{coil.gain_db:.0f} dB; so it plays up to {coil.target:.3g} m/s², and {least:.2g} where it is weakest",
            err=True,
        )
    for line in _find_cost(folder, rig, proposed):
        echo(line, err=True)
    if not is_answerable():
        return True
    asked = "Enter takes it; n stops: --redesign tries another max_gain_db of [calibration]."
    return not ask(asked).startswith("n")


def _find_cost(folder: StudyFolder, rig: Rig, proposed: Certificate) -> Iterator[str]:
    """Say how much of full scale the study's stimuli take through the filters, and how weak the weakest then is."""
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.actuator.render import find_rig_problems

    if not (folder.stimuli.is_dir() and folder.settings.is_file()):
        yield "the study has no stimuli yet; build them, and calibrate --redesign says how strong they come"
        return
    stimuli, own = read_stimuli(folder.stimuli), read_settings(folder.settings).rig
    scale, sounds = own.full_scale_m_s2, dict[str, "Frames"]()
    find_rig_problems(
        rig, stimuli, rate_hz=own.rate_hz, full_scale_m_s2=scale, certificate=proposed, sounds=sounds
    )  # fmt: skip
    peaks = {name: float(abs(sound).max()) for name, sound in sounds.items()}
    strongest = max(peaks, key=peaks.__getitem__)
    headroom_db = -20 * math.log10(max(peaks[strongest], 1e-9))
    said = f"headroom {headroom_db:.1f} dB"
    if headroom_db < 0:
        said = f"{-headroom_db:.1f} dB too much: lower gain or headroom in study.toml by that, and build again"
    yield f"strongest stimulus {strongest}: {peaks[strongest]:.0%} of full scale, {said}"
    levels = {one.stimulus_id: one.sensation_level_db for one in stimuli}
    felt = {name: level for name, level in levels.items() if math.isfinite(level)}
    if felt:
        weakest = min(felt, key=felt.__getitem__)
        left_db = felt[weakest] + min(headroom_db, 0.0)
        yield f"weakest stimulus {weakest}: {left_db:.1f} dB over the threshold of feeling"


def examine_study_rig(lab: OpenStudy, *, device: str | None, seconds: float) -> Outcome:
    """Play pulses and probes on the rig of a study, or on a device without one, and say what is wrong."""
    from feel321.study.actuator.doctor import examine_rig, survey_devices

    folder = lab.folder
    if folder.path != Path():  # without a study a device can be tested
        require_study(folder.path)
    rate_hz, rig = _find_rate(folder), None
    if folder.rig.is_file() or device:
        limits = LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0)
        rig = read_rig(folder.rig) if folder.rig.is_file() else Rig(limits=limits)
        rig = take_device(rig, device) if device else rig
    name = rig.device.name if rig else FILE_DEVICE
    devices = [] if name == SIMULATED_DEVICE else survey_devices()
    found: dict[str, Any] = {}
    known: dict[str, Any] = {}
    if rig is not None and name != FILE_DEVICE and seconds:
        with follow(lab.progress, "pulses") as step:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=step)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            known = _probe(lab, rig, rate_hz=rate_hz)
    facts = {"devices": devices, "examination": found or None, "rig": known or None}
    nothing = "nothing was played; name a device with --device, or in the study's rig.toml"
    lines = [*format_facts(facts), *([] if found else [nothing])]
    if found and found["is_program"]:
        lab.say(
            f"{found['device']}: a program plays it (a sound server, say), which may convert the rate and copy "
            "channels to others without notice; name the card itself, or give it as many channels as the rig has"
        )
    if found and found["error"]:
        lab.say(found["error"])
    failed = bool(found and (found["n_failed"] or found["n_underruns"]))
    return Outcome(facts, lines, faults=known.get("faults", ()), failed=failed)


def _probe(lab: OpenStudy, rig: Rig, *, rate_hz: float) -> dict[str, Any]:
    """Probe each coil, against the certificate if there is one."""
    from feel321.study.actuator.certificate import judge_certificates, list_certificates
    from feel321.study.actuator.doctor import probe_coils

    path, certificate, faults = lab.folder.path, None, list[str]()
    if list_certificates(path):
        certificate, faults = judge_certificates(path, rig, now=lab.now(), rate_hz=rate_hz)
    coils, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
    faults += [f"{name}: {one['fault']}" for name, one in coils.items() if one["fault"]]
    faults += [hum] if hum else []
    return {"certificate": certificate and certificate.id, "coils": coils, "faults": faults}
