"""A check of the rig: its devices, a quiet train of pulses through the output of sessions, and tones on each coil.

A sensor is trusted only if it shows the pulses: above the noise before them, in their shape, below its full scale, and
about as strong as they were sent.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from time import perf_counter, sleep
from typing import Any

import numpy as np
from scipy import fft, signal

from feel321.study.actuator.bench import CLIPPED, Bench, open_bench
from feel321.study.actuator.calibrate import MARGIN, find_allowed
from feel321.study.actuator.certificate import Certificate, CoilCertificate
from feel321.study.actuator.device import FROM_LATENCY, list_devices, list_rates
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import Output, open_output
from feel321.study.actuator.rig import Rig, require_sensor
from feel321.study.session.ports import Playback
from feel321.types import Samples

RATES_HZ = (8000.0, 16000.0, 44100.0, 48000.0, 96000.0, 192000.0)

PULSE, TONE = "pulse", "tone"
PULSE_S = 0.02
PULSE_HZ = 250.0  # where skin is most sensitive
PULSE_LEVEL = 0.1  # of full scale or of the peak that the rig allows, whichever is less
TONE_S = 0.5  # length, besides what the device holds, of a tone that is stopped after its begin
STOPS_S = (0.1, 0.117, 0.131)  # times at which tones are stopped; uneven as well
N_TRIES = 5  # attempts at each stop, where a busy machine lets the tone end before it, or run dry
ABOVE_NOISE = 2.0  # least ratio of the RMS of a sensed pulse to that of the noise before it
# Least correlation of a sensed pulse with what was sent. From 8 to 48 kHz, white noise reached 0.33 and a click 0.18;
# pulses through coils with resonances from 40 to 400 Hz and Q up to 8 stayed above 0.8.
LIKENESS = 0.5
# Factor by which a sensed pulse may be weaker or stronger than the rig's full scales say.
STRENGTH = 10.0
GAPS_S = (0.1, 0.113, 0.127, 0.139, 0.151)  # uneven, out of step with the device's blocks


def survey_devices() -> list[dict[str, Any]]:
    """List the devices: name, host API, channels, the rates at which each would play, and whether it is a program."""
    devices = list_devices()
    if not devices:
        raise OSError(
            'doctor: no audio device found; plug one in, or play to files: name = "file" in rig.toml'
        )
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


# Pulses: latency, jitter and failures, and whether the sensor shows them.


@dataclass(frozen=True, slots=True)
class SensorCheck:
    """Lags of the pulses without fault, medians of level and noise (RMS) over all, and the first fault."""

    lags_ms: Sequence[float]
    n_recorded: int
    level_m_s2: float
    noise_m_s2: float
    fault: str


@dataclass(frozen=True, slots=True)
class Examination:
    """Latency, jitter and failures of a train of pulses."""

    device: str
    host_api: str
    rate_hz: float
    latency_ms: float
    n_pulses: int
    n_failed: int
    n_underruns: int
    onset_ms: float
    jitter_ms: float
    jitter_99_ms: float
    sensed_ms: float | None
    sensed_jitter_ms: float | None
    sensed_jitter_99_ms: float | None
    stop_ms: float | None
    callback_ms_max: float
    is_program: bool
    error: str
    n_estimated: int = 0
    sensor: SensorCheck | None = None


def examine_rig(
    rig: Rig, *, rate_hz: float, seconds: float, on_step: Callable[[int, int], None] | None = None
) -> Examination:
    """Play pulses on all actuators, and measure onsets and stops; on_step: called with the ms passed, and all."""
    longest_s = rig.limits.duration_s
    tone_s = min(TONE_S + 2 * rig.device.latency_s, longest_s)
    pulse = make_pulse(rig, rate_hz=rate_hz, seconds=min(PULSE_S, longest_s))
    sounds = {PULSE: pulse, TONE: make_pulse(rig, rate_hz=rate_hz, seconds=tone_s)}
    played: list[tuple[Playback, Frames | None]] = []
    with open_output(rig, sounds, rate_hz=rate_hz, clock=perf_counter) as output:
        begin_s = perf_counter()
        while (passed_s := perf_counter() - begin_s) < seconds or not played:
            if on_step is not None:
                on_step(round(1e3 * passed_s), round(1e3 * seconds))
            output.start(PULSE, gap_s=GAPS_S[len(played) % len(GAPS_S)])
            played.append((_await_end(output), output.captured))
        stops_ms = try_stops(output, lead_s=rig.masking.lead_s if rig.masking else 0.0)
        identity = output.identity
    playbacks = [playback for playback, _ in played]
    sensor = None  # of which a device that plays nothing says nothing
    if rig.sensor is not None and any(playback.completed for playback in playbacks):
        whole = [one for one in played if one[1] is not None and _is_whole(one[0])]
        heard = [np.asarray(one, np.float64) for _, one in whole or played if one is not None]
        sensor = check_sensor(rig, heard, pulse=pulse, rate_hz=rate_hz)
    late_ms = [
        1e3 * (one.onset_s - one.requested_s) for one in playbacks if one.onset_s is not None
    ]
    onset_ms, jitter_ms, jitter_99_ms = _describe_delays(late_ms) or (math.nan,) * 3
    sensed = _describe_delays(sensor.lags_ms if sensor else ()) or (None, None, None)
    return Examination(
        device=identity["device"],
        host_api=identity["host_api"],
        rate_hz=rate_hz,
        latency_ms=1e3 * playbacks[-1].measured.get("latency_s", math.nan),
        n_pulses=len(playbacks),
        n_failed=sum(not one.completed or bool(one.error) for one in playbacks),
        n_underruns=sum(one.underruns for one in playbacks),
        onset_ms=onset_ms,
        jitter_ms=jitter_ms,
        jitter_99_ms=jitter_99_ms,
        sensed_ms=sensed[0],
        sensed_jitter_ms=sensed[1],
        sensed_jitter_99_ms=sensed[2],
        stop_ms=max(stops_ms, default=None),
        callback_ms_max=max(one.measured.get("callback_ms_max", 0.0) for one in playbacks),
        is_program=bool(identity["is_program"]),
        error=next((one.error for one in reversed(playbacks) if one.error), ""),
        n_estimated=sum(one.dac_source == FROM_LATENCY for one in playbacks),
        sensor=sensor,
    )


def make_pulse(rig: Rig, *, rate_hz: float, seconds: float = PULSE_S) -> Frames:
    """Make a quiet pulse for all actuators of a rig, shape (n, channels)."""
    n = max(round(seconds * rate_hz), 1)
    shape = np.hanning(n) * np.sin(2 * np.pi * PULSE_HZ * np.arange(n) / rate_hz)
    pulse = np.zeros((n, rig.n_channels), dtype=np.float32)
    for actuator in rig.actuators:
        allowed = min(rig.limits.peak_m_s2, rig.limits.rms_m_s2) / actuator.full_scale_m_s2
        pulse[:, actuator.channel - 1] = PULSE_LEVEL * min(1.0, allowed) * shape
    return pulse


def try_stops(output: Output, *, lead_s: float) -> list[float]:
    """Stop tones on their way, and measure how long each of them went on until silence, in ms."""
    stops_ms: list[float] = []
    for wait_s in STOPS_S:
        for _ in range(N_TRIES):
            output.start(TONE, gap_s=lead_s)
            sleep(lead_s + wait_s)
            output.stop()
            playback = _await_end(output)
            if "stop_s" in playback.measured and not playback.underruns:
                stops_ms.append(1e3 * playback.measured["stop_s"])
                break
    return stops_ms


def _await_end(output: Output) -> Playback:
    while output.is_playing:
        sleep(0.001)
    return output.collect()


def _is_whole(playback: Playback) -> bool:
    return not (playback.underruns or playback.error or playback.measured["sensor_gaps"])


def _describe_delays(delays_ms: Sequence[float]) -> tuple[float, float, float] | None:
    """Compute the median, and the median and 99th percentile of the distance from it; None of none."""
    if not delays_ms:
        return None
    middle = float(np.median(delays_ms))
    low, high = np.percentile(np.abs(np.asarray(delays_ms) - middle), [50, 99])
    return middle, float(low), float(high)


def check_sensor(
    rig: Rig, recordings: Sequence[Samples], *, pulse: Frames, rate_hz: float
) -> SensorCheck:
    """Compare recordings, shape (axes, n) in m/s², with the pulse that was sent."""
    sensor = require_sensor(rig)
    rms = [
        float(np.sqrt(np.mean(pulse[:, one.channel - 1] ** 2))) * one.full_scale_m_s2
        for one in rig.actuators
    ]
    allowed = min(rms) / STRENGTH, sum(rms) * STRENGTH
    shape = pulse[:, int(np.argmax(np.abs(pulse).max(axis=0)))].astype(np.float64)
    lags_ms, levels, noises, faults = [], [], [], []
    for recording in recordings:
        if recording.shape[-1] < len(shape):
            continue
        strongest = recording[int(np.argmax(recording.std(axis=1)))]
        first, level, noise, likeness = find_pulse(strongest, shape)
        fault = _find_fault(
            strongest, (level, noise, likeness), allowed=allowed, full_scale=sensor.full_scale_m_s2
        )
        lags_ms += [] if fault else [first / rate_hz * 1e3]
        levels.append(level)
        noises.append(noise)
        faults.append(fault)
    where = f"sensor on channel {' '.join(map(str, sensor.inputs))}"
    found = [fault for fault in faults if fault]
    told = f"{where}, {len(found)} of {len(faults)} pulses: {found[0]}" if found else ""
    if not faults:
        told = (
            f"{where}: got no samples, expected a recording of each pulse; check the input device"
        )
    return SensorCheck(
        lags_ms=lags_ms,
        n_recorded=len(faults),
        level_m_s2=float(np.median(levels or [np.nan])),
        noise_m_s2=float(np.median(noises or [np.nan])),
        fault=told,
    )


def find_pulse(samples: Samples, shape: Samples) -> tuple[int, float, float, float]:
    """Find where a recording, shape (m,), correlates best with a pulse, shape (n,).

    Returns the place, the RMS there and before it, and the correlation, 0 to 1.
    """
    motion = samples - samples.mean()  # an accelerometer may measure gravity too
    n = len(shape)
    products = np.abs(np.correlate(motion, shape, mode="valid"))
    first = int(np.argmax(products))
    found = motion[first : first + n]
    # A resonant coil is late, so what is just before the best place may be its pulse already.
    before = motion[: first - n // 2] if first >= n else motion[-(n // 2) :]
    norm = float(np.linalg.norm(found) * np.linalg.norm(shape))
    level, noise = (float(np.sqrt(np.mean(one**2))) for one in (found, before))
    return first, level, noise, float(products[first]) / norm if norm else 0.0


def _find_fault(
    samples: Samples,
    pulse: tuple[float, float, float],
    *,
    allowed: tuple[float, float],
    full_scale: float,
) -> str:
    """Describe why a pulse (level, noise before it, likeness) cannot be trusted; empty if it can."""
    (level, noise, likeness), (low, high) = pulse, allowed
    peak = float(np.abs(samples).max())
    if not np.ptp(samples):
        return (
            f"got no signal (every sample is alike: {peak:g} m/s²), expected a pulse of "
            f"{low:.2g} to {high:.2g} m/s² RMS; check the sensor's power and cable, the input's mute, "
            "and [sensor] channel in rig.toml"
        )
    if peak >= CLIPPED * full_scale:
        return (
            f"got a clipped recording (full scale is {full_scale:g} m/s²), expected its peak below; "
            "lower the input's gain, and full_scale_m_s2 under [sensor] in rig.toml with it"
        )
    if level < ABOVE_NOISE * noise or likeness < LIKENESS:
        return (
            f"got no pulse (at best {level:.2g} m/s² RMS with noise of {noise:.2g} before it, correlation "
            f"{likeness:.2f}), expected {ABOVE_NOISE:g} times the noise and a correlation of {LIKENESS:g}; "
            "check that the sensor is mounted, the amplifier on, and [sensor] channel in rig.toml"
        )
    if not low <= level <= high:
        return (
            f"got a pulse of {level:.2g} m/s² RMS, expected {low:.2g} to {high:.2g}; check mounting and gains, "
            "and full_scale_m_s2 of sensor and actuators in rig.toml"
        )
    return ""


# Drift of the coils since their certificate: a second of tones on each, compared with the response it holds.

PERIOD_S = 0.25  # all tones are multiples of its inverse
SETTLING_S, TONES_S = 0.25, 0.85  # until a coil moves steadily; length of the tones
REST_S = 0.15  # after them and the certificate's latency, which may differ from today's by so much
CLEAR = 10.0  # least ratio of a tone's amplitude to the noise at its frequency
FEWEST = 3  # tones that must be clear


@dataclass(frozen=True, slots=True)
class Drift:
    """Level of a coil's response today over its certificate's, in dB: median over the clear tones, and largest."""

    coil: str
    median_db: float
    largest_db: float
    n_tones: int

    def find_fault(self, *, allowed_db: float) -> str:
        """Describe why the certificate holds no longer; empty if it does. Single tones may be off by twice as much."""
        if self.n_tones < FEWEST:
            return (
                f"coil {self.coil!r}: got {self.n_tones} tones above the noise, expected {FEWEST} or more; check coil, "
                "cable, amplifier, its channel in rig.toml, and the sensor"
            )
        if abs(self.median_db) <= allowed_db and abs(self.largest_db) <= 2 * allowed_db:
            return ""
        return (
            f"coil {self.coil!r} drifted by {self.median_db:+.1f} dB since its certificate ({self.largest_db:+.1f} dB "
            f"at most), the limit is {allowed_db:g} dB; put gains and mounting back, or run feel321 calibrate"
        )


def measure_drift(rig: Rig, certificate: Certificate) -> list[Drift]:
    """Play tones on each coil of a rig, and compare what the sensor measures with its certificate."""
    late = max(coil.latency for coil in certificate.coils.values())
    n = round((TONES_S + REST_S) * certificate.rate_hz) + late
    with open_bench(rig, rate_hz=certificate.rate_hz, n_longest=n) as bench:
        return [
            _measure_coil(bench, coil, find_tones(certificate.band_hz))
            for coil in certificate.coils.values()
        ]


def find_tones(band_hz: tuple[float, float]) -> Samples:
    """Find frequencies in Hz about a third of an octave apart in a band, all of whole periods."""
    low, high = band_hz
    wanted = low * 2 ** np.arange(0.0, math.log2(high / low), 1 / 3)
    tones: Samples = np.unique(np.maximum(np.ceil(wanted * PERIOD_S), 1)) / PERIOD_S
    return tones[tones <= high]


def _measure_coil(bench: Bench, coil: CoilCertificate, frequency_hz: Samples) -> Drift:
    rig, rate_hz = bench.rig, bench.rate_hz
    tones = make_tones(coil, frequency_hz, rate_hz=rate_hz)
    actuator = next(one for one in rig.actuators if one.name == coil.name)
    motion = float(np.abs(coil.respond(tones, rate_hz=rate_hz)).max())
    safe = MARGIN * min(rig.limits.peak_m_s2, require_sensor(rig).full_scale_m_s2) / motion
    sent = min(rig.calibration.level * find_allowed(rig, actuator), safe) * tones
    recorded = bench.play(sent, coil.channel)
    along = coil.direction @ recorded if len(recorded) == len(coil.direction) else recorded[0]
    level_db, is_clear = compare_tones(
        sent, along, coil=coil, frequency_hz=frequency_hz, rate_hz=rate_hz
    )
    found = level_db[is_clear]
    if not len(found):
        return Drift(coil.name, math.nan, math.nan, 0)
    return Drift(coil.name, float(np.median(found)), float(max(found, key=abs)), len(found))


def make_tones(coil: CoilCertificate, frequency_hz: Samples, *, rate_hz: float) -> Samples:
    """Make the sum of the tones, peak 1, shape (n,), ramped at both ends; what the coil makes weaker is stronger."""
    n_tones = round(TONES_S * rate_hz)
    time_s = np.arange(n_tones) / rate_hz
    size = np.interp(frequency_hz, coil.frequency_hz, np.abs(coil.response))
    # Schroeder's phases: a low peak.
    turns = np.arange(len(frequency_hz)) ** 2 / len(frequency_hz) / 2
    waves = np.sin(2 * np.pi * (np.outer(frequency_hz, time_s) + turns[:, None]))
    tones = (size**-0.5) @ waves * signal.windows.tukey(n_tones, 0.1)
    rest = round(REST_S * rate_hz) + coil.latency
    return np.concatenate([tones / np.abs(tones).max(), np.zeros(rest)])


def compare_tones(
    sent: Samples, along: Samples, *, coil: CoilCertificate, frequency_hz: Samples, rate_hz: float
) -> tuple[Samples, Sequence[bool]]:
    """Compare each tone with the certificate, in dB, and say which are clear of the noise; shapes (tones,).

    Two periods in which the coil moves steadily: their mean is the tone, their difference the noise.
    """
    n = round(PERIOD_S * rate_hz)
    moved = along - along.mean()
    late = int(np.argmax(np.abs(signal.correlate(moved, sent, method="fft")))) - (len(sent) - 1)
    first = max(late, 0) + round(SETTLING_S * rate_hz)
    bins = np.round(frequency_hz * PERIOD_S).astype(int)

    def transform(samples: Samples, start: int) -> Samples:
        return np.stack([fft.rfft(samples[k : k + n], n)[bins] for k in (start, start + n)])

    found = transform(moved, first)
    asked = np.abs(transform(sent, round(SETTLING_S * rate_hz)).mean(axis=0))
    size = np.abs(found.mean(axis=0))
    noise = np.abs(found[0] - found[1]) / 2
    known = np.interp(frequency_hz, coil.frequency_hz, np.abs(coil.response))
    return 20 * np.log10(np.maximum(size, 1e-12) / (asked * known)), size > CLEAR * noise
