"""A check of the rig: its devices, a quiet train of pulses through the output of sessions, and each coil by name."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np

from feel321.arguments import follow
from feel321.study.actuator import certificate as certificates
from feel321.study.actuator import faults
from feel321.study.actuator import rig as rigs
from feel321.study.actuator.certificate import MEASURED, Certificate
from feel321.study.actuator.device import FROM_LATENCY, list_devices, list_rates
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import open_bench, open_output
from feel321.study.actuator.render import find_directions
from feel321.study.actuator.response import Response, Sweep, make_sweep, measure_sweep
from feel321.study.actuator.rig import ActuatorTable, Rig
from feel321.study.folder import OpenStudy, Outcome, require_study
from feel321.study.session.ports import Playback
from feel321.study.settings.read import read_settings
from feel321.study.terminal import format_facts
from feel321.types import Samples

RATES_HZ = (8000.0, 16000.0, 44100.0, 48000.0, 96000.0, 192000.0)

PULSE_S = 0.02
PULSE_HZ = 250.0  # where skin is most sensitive
PULSE_LEVEL = 0.1  # of full scale or of the peak that the rig allows, whichever is less
LIKENESS = 0.5  # of a sensed pulse with what was sent: white noise reached 0.33, coils 0.8
GAPS_S = (0.1, 0.113, 0.127, 0.139, 0.151)  # uneven, out of step with the device's blocks


def survey_devices() -> list[dict[str, Any]]:
    """List the devices, and the rates at which each would play."""
    devices = list_devices()
    if not devices:
        raise OSError('doctor: no audio device found; plug one in, or take the device "file"')
    return [
        {
            "name": device.name,
            "host_api": device.host_api,
            "outputs": device.n_outputs,
            "inputs": device.n_inputs,
            "rates_hz": list_rates(device, RATES_HZ if device.n_outputs else ()),
            "is_program": device.is_program,
        }
        for device in devices
    ]


def examine_rig(
    rig: Rig, *, rate_hz: float, seconds: float, on_step: Callable[[int, int], None]
) -> dict[str, Any]:
    """Play pulses on all actuators, and measure latency, jitter and failures; on_step gets the ms passed, and all."""
    pulse = make_pulse(rig, rate_hz=rate_hz, seconds=min(PULSE_S, rig.limits.duration_s))
    played = list[Playback]()
    lags_ms = list[float]()
    with open_output(rig, {"": pulse}, rate_hz=rate_hz, clock=perf_counter) as output:
        begin_s = perf_counter()
        while (passed_s := perf_counter() - begin_s) < seconds or not played:
            on_step(round(1e3 * passed_s), round(1e3 * seconds))
            output.start("", gap_s=GAPS_S[len(played) % len(GAPS_S)])
            while output.is_playing:
                sleep(0.001)
            played.append(output.collect())
            lag = find_pulse(output.captured, pulse)
            lags_ms += [] if lag is None else [1e3 * lag / rate_hz]
        identity = output.identity
    late_ms = [1e3 * (one.onset_s - one.requested_s) for one in played if one.onset_s is not None]
    named = {name: identity[name] for name in ("device", "host_api", "is_program")}
    return named | {
        "rate_hz": rate_hz,
        "latency_ms": 1e3 * played[-1].measured.get("latency_s", math.nan),
        "n_pulses": len(played),
        "n_failed": sum(not one.completed or bool(one.error) for one in played),
        "n_underruns": sum(one.underruns for one in played),
        "n_estimated": sum(one.dac_source == FROM_LATENCY for one in played),
        "n_sensed": len(lags_ms),
        **_describe_delays("onset", late_ms),
        **_describe_delays("sensed", lags_ms),
        "callback_ms_max": max(one.measured.get("callback_ms_max", 0.0) for one in played),
        "error": next((one.error for one in reversed(played) if one.error), ""),
    }


def _describe_delays(name: str, delays_ms: Sequence[float]) -> dict[str, float | None]:
    """Compute the median, and the median and 99th percentile of the distance from it; None of none."""
    found: list[float | None] = [None] * 3
    if delays_ms:
        middle = float(np.median(delays_ms))
        apart = np.abs(np.asarray(delays_ms) - middle)
        found = [middle, *map(float, np.percentile(apart, [50, 99]))]
    ends = ("ms", "jitter_ms", "jitter_99_ms")
    return {f"{name}_{end}": value for end, value in zip(ends, found, strict=True)}


def make_pulse(rig: Rig, *, rate_hz: float, seconds: float = PULSE_S) -> Frames:
    """Make a quiet pulse for all actuators of a rig, shape (n, channels)."""
    n = max(round(seconds * rate_hz), 1)
    shape = np.hanning(n) * np.sin(2 * np.pi * PULSE_HZ * np.arange(n) / rate_hz)
    pulse = np.zeros((n, rig.n_channels), dtype=np.float32)
    for actuator in rig.actuators:
        allowed = min(rig.limits.peak_m_s2, rig.limits.rms_m_s2) / actuator.full_scale_m_s2
        pulse[:, actuator.channel - 1] = PULSE_LEVEL * min(1.0, allowed) * shape
    return pulse


def find_pulse(recorded: Frames | None, pulse: Frames) -> int | None:
    """Find the sample of a recording, (axes, m), at which it correlates best with a pulse; None if it is not there."""
    if recorded is None or recorded.shape[1] < len(pulse):
        return None
    shape = pulse[:, int(np.argmax(np.abs(pulse).max(axis=0)))].astype(np.float64)
    strongest = recorded[int(np.argmax(recorded.std(axis=1)))].astype(np.float64)
    motion = strongest - strongest.mean()  # an accelerometer may measure gravity too
    products = np.abs(np.correlate(motion, shape, mode="valid"))
    first = int(np.argmax(products))
    norm = float(np.linalg.norm(motion[first : first + len(shape)]) * np.linalg.norm(shape))
    return first if norm and products[first] > LIKENESS * norm else None


PROBE_HZ = (30.0, 800.0)
PROBE_S, PAUSE_S = 0.8, 0.3
PROBE_LEVEL = 0.2  # of what full scale and limits allow
SAFE = 0.5  # of the limits and of the sensor's full scale, where the response is known
LIKELY = 0.85  # least cosine between a coil's direction and the one that is seen
SHARED = 0.3  # part of a motion along another coil's direction that is that coil's
SEEN = 0.6  # least median coherence of a coil that moves
STRENGTH = 10.0  # factor by which a coil may be weaker or stronger than its full scale says
DISTORTED = 0.2  # of the motion
AUDIBLE = 3.0  # ratio of a hum to the noise without it


def probe_coils(
    rig: Rig, certificate: Certificate | None, *, rate_hz: float
) -> tuple[dict[str, dict[str, Any]], str]:
    """Play a probe on each coil in turn, and describe it and what is wrong; and name a hum while nothing plays."""
    sweep = Sweep(
        rate_hz=rate_hz,
        band_hz=(PROBE_HZ[0], min(PROBE_HZ[1], rate_hz / 4)),
        duration_s=PROBE_S,
        pause_s=PAUSE_S + 2 * rig.device.latency_s,  # there and back
        n_repeats=2,
        peak=1.0,
    )
    asked, found, sensor = make_sweep(sweep), dict[str, dict[str, Any]](), rigs.require_sensor(rig)
    known = certificate if certificate and certificate.method == MEASURED else None
    diagnosis = faults.Diagnosis(known, rig) if known else None
    if diagnosis is not None:
        diagnosis.lag = None  # a stream that was opened anew has not the certificate's latency
    with open_bench(rig, rate_hz=rate_hz, n_longest=len(asked)) as bench:
        silence = bench.play({}, n=round(rate_hz))
        for actuator in rig.actuators:
            peak = PROBE_LEVEL * rigs.find_allowed(rig, actuator)
            if known:
                motion = known.coils[actuator.name].respond(asked, rate_hz=rate_hz)
                safe = SAFE * min(rig.limits.peak_m_s2, sensor.full_scale_m_s2)
                peak = min(peak, safe / float(np.abs(motion).max()))
            recorded = bench.play({actuator.channel: peak * asked}, n=len(asked))
            seen = measure_sweep(replace(sweep, peak=peak), recorded) if np.ptp(recorded) else None
            if diagnosis:
                # One sweep only: a converter at another rate need not stretch the pause before the second.
                sent = np.zeros((sweep.period, rig.n_channels), dtype=np.float32)
                sent[:, actuator.channel - 1] = peak * asked[: sweep.period]
                once = recorded[:, : sweep.period]
                fault = diagnosis.judge(sent, once).removeprefix(f"{actuator.name}: ")
            else:
                fault = find_fault(rig, actuator, seen, recorded=recorded, sent=peak * asked)
            found[actuator.name] = {**_describe(seen), "fault": fault}
    still = silence - silence.mean(axis=1, keepdims=True)
    hum_hz, rms = faults.find_hum(still, rate_hz=rate_hz, size=0.0)
    rest = float(np.mean(np.square(still).sum(axis=0))) - rms**2
    is_heard = hum_hz and rms >= AUDIBLE * math.sqrt(max(rest, 0.0))
    return found, faults.describe_hum(hum_hz, rms) if is_heard else ""


def _describe(seen: Response | None) -> dict[str, Any]:
    if seen is None:
        names = ("level_m_s2", "direction", "coherence", "delay_ms", "distortion")
        return dict(zip(names, (0.0, [], 0.0, None, None), strict=True))
    return {
        "level_m_s2": float(np.median(np.abs(seen.response[seen.inside]))),
        "direction": seen.direction.tolist(),
        "coherence": float(np.median(seen.coherence[seen.inside])),
        "delay_ms": 1e3 * seen.latency / seen.rate_hz,
        "distortion": float(np.nanmedian(seen.distortion[seen.inside])),
    }


def find_fault(
    rig: Rig, actuator: ActuatorTable, seen: Response | None, *, recorded: Samples, sent: Samples
) -> str:
    """Name what is wrong with a coil that has no certificate, by what its probe moved."""
    full_scale_m_s2 = rigs.require_sensor(rig).full_scale_m_s2
    fault = faults.find_sensor_fault(recorded, full_scale_m_s2=full_scale_m_s2)
    if fault or seen is None:
        return fault
    probe = _describe(seen)
    if probe["coherence"] < SEEN:
        return _find_rate(sent, recorded, rate_hz=seen.rate_hz) or (
            f"dead: no motion follows the probe (coherence {probe['coherence']:.2f}, expected {SEEN:g} or more); check "
            "coil, cable, amplifier, its channel in rig.toml, and the sensor"
        )
    if fault := _find_turned(rig, actuator, seen.direction):
        return fault
    low, high = actuator.full_scale_m_s2 / STRENGTH, actuator.full_scale_m_s2 * STRENGTH
    if not low < probe["level_m_s2"] < high:
        return (
            f"got {probe['level_m_s2']:.3g} m/s² at full scale, expected {low:.3g} to {high:.3g}; check mounting and "
            "gains, and full_scale_m_s2 of sensor and actuator in rig.toml"
        )
    if probe["distortion"] > DISTORTED:
        return f"distortion of {probe['distortion']:.0%}: it rattles, or the amplifier clips"
    return ""


def _find_turned(rig: Rig, actuator: ActuatorTable, seen: Samples) -> str:
    """Name a coil that is inverted, or moves as another one should, by the directions of rig.toml."""
    typed, _ = find_directions(rig)
    own = typed.pop(actuator.name, None)
    if own is None or seen @ own > LIKELY:
        return ""
    if seen @ own < -LIKELY:
        return "inverted: exchange its wires"
    others = {name: abs(float(seen @ one)) for name, one in typed.items()}
    moved = [name for name, along in others.items() if along > SHARED]
    if len(moved) == 1 and others[moved[0]] > LIKELY:
        other = moved[0]
        return f"{actuator.name} and {other} swapped, or on one channel: its probe moves {other}"
    if moved and abs(seen @ own) < SHARED:
        return (
            f"dead, its samples move {' and '.join(moved)}: the sink lacks channel {actuator.channel}; give it as many "
            "as the rig has"
        )
    return f"moves along {np.round(seen, 2).tolist()}, rig.toml says {np.round(own, 2).tolist()}"


def _find_rate(sent: Samples, recorded: Samples, *, rate_hz: float) -> str:
    """Name the rate of a converter that plays a probe faster or slower."""
    strongest = recorded[int(np.argmax(recorded.std(axis=1)))]
    size = float(np.linalg.norm(strongest - strongest.mean()))

    def liken(rate: float) -> float:
        place = np.arange(0, len(sent) - 1, rate)
        played = np.interp(place, np.arange(len(sent)), sent)
        n = len(sent) + len(played)
        cross = np.fft.irfft(np.fft.rfft(strongest, n) * np.fft.rfft(played, n).conj(), n)
        return float(np.abs(cross).max()) / max(size * float(np.linalg.norm(played)), 1e-30)

    best = max((1.0, *faults.RATES), key=liken)
    return "" if best == 1 or liken(best) < 2 * liken(1.0) else faults.name_rate(best, rate_hz)


def examine_study_rig(lab: OpenStudy, *, device: str | None, seconds: float) -> Outcome:
    """Play pulses and probes on the rig of a study, or on a device without one, and say what is wrong."""
    folder = lab.folder
    if folder.path != Path():  # without a study a device can be tested
        require_study(folder.path)
    own, rig = folder.settings, None
    rate_hz = read_settings(own).rig.rate_hz if own.is_file() else rigs.RATE_HZ
    if folder.rig.is_file() or device:
        limits = rigs.LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0)
        rig = rigs.read_rig(folder.rig) if folder.rig.is_file() else Rig(limits=limits)
        rig = rigs.take_device(rig, device) if device else rig
    name = rig.device.name if rig else rigs.FILE_DEVICE
    devices = [] if name == rigs.SIMULATED_DEVICE else survey_devices()
    found, known, wrong = dict[str, Any](), dict[str, Any](), list[str]()
    if rig is not None and name != rigs.FILE_DEVICE and seconds:
        with follow(lab.progress, "pulses") as step:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=step)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            certificate = None
            if certificates.list_certificates(folder.path):
                certificate, wrong = certificates.judge_certificates(
                    folder.path, rig, now=lab.now(), rate_hz=rate_hz
                )
            coils, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
            wrong += [f"{name}: {one['fault']}" for name, one in coils.items() if one["fault"]]
            wrong += [hum] if hum else []
            known = {"certificate": certificate and certificate.id, "coils": coils, "faults": wrong}
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
    return Outcome(facts, lines, faults=wrong, failed=failed)
