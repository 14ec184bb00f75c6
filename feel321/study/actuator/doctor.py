"""A check of the rig: its devices and their rates, and a quiet train of pulses through the stream that sessions use.

A sensor is trusted only if it shows the pulses: above the noise before them, in their shape, below its full scale, and
about as strong as they were sent.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import fft, signal

from feel321.files import temporary_folder
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.calibrate import MARGIN, find_allowed
from feel321.study.actuator.certificate import Certificate, CoilCertificate
from feel321.study.actuator.device import FROM_LATENCY, list_devices, list_rates
from feel321.study.actuator.duplex import Session, open_session
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import StreamOutput, open_stream
from feel321.study.actuator.rig import Rig, require_sensor
from feel321.study.session.ports import Playback

Samples = NDArray[np.float64]

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
CLIPPED = 0.999  # of the sensor's full scale
GAPS_S = (0.1, 0.113, 0.127, 0.139, 0.151)  # uneven, out of step with the device's blocks


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
    sensor: "SensorCheck | None" = None


@dataclass(frozen=True, slots=True)
class SensedPulse:
    """A pulse as a sensor measured it.

    lag_ms: since its onset was sent; level_m_s2, noise_m_s2: RMS of the pulse, and before it; likeness: correlation
    with what was sent, 0 to 1; peak_m_s2, spread_m_s2: largest magnitude, and largest minus smallest value.
    """

    lag_ms: float
    level_m_s2: float
    noise_m_s2: float
    likeness: float
    peak_m_s2: float
    spread_m_s2: float


@dataclass(frozen=True, slots=True)
class SensorCheck:
    """Lags of the pulses without fault, medians of level and noise (RMS) over all, and the first fault."""

    lags_ms: Sequence[float]
    n_recorded: int
    level_m_s2: float
    noise_m_s2: float
    fault: str


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


def examine_rig(
    rig: Rig, *, rate_hz: float, seconds: float, on_step: Callable[[int, int], None] | None = None
) -> Examination:
    """Play pulses on all actuators, and measure onsets and stops; on_step: called with the ms passed, and all."""
    longest_s = rig.limits.duration_s
    tone_s = min(TONE_S + 2 * rig.device.latency_s, longest_s)
    sounds = {
        PULSE: make_pulse(rig, rate_hz=rate_hz, seconds=min(PULSE_S, longest_s)),
        TONE: make_pulse(rig, rate_hz=rate_hz, seconds=tone_s),
    }
    with temporary_folder() as folder:
        with open_stream(rig, sounds, rate_hz=rate_hz, folder=folder, clock=perf_counter) as output:
            played = _play_train(output, seconds=seconds, on_step=on_step)
            stops_ms = try_stops(output, lead_s=rig.masking.lead_s if rig.masking else 0.0)
            identity = output.identity
        recordings = _read_recordings(folder, played)
    # A device that plays nothing says nothing of the sensor.
    sensor = None
    if any(playback.completed for playback in played):
        sensor = check_sensor(rig, recordings, pulse=sounds[PULSE], rate_hz=rate_hz)
    return _sum_up(played, sensor, stops_ms, identity=identity)


def make_pulse(rig: Rig, *, rate_hz: float, seconds: float = PULSE_S) -> Frames:
    """Make a quiet pulse for all actuators of a rig, shape (n, channels)."""
    n = max(round(seconds * rate_hz), 1)
    shape = np.hanning(n) * np.sin(2 * np.pi * PULSE_HZ * np.arange(n) / rate_hz)
    pulse = np.zeros((n, rig.n_channels), dtype=np.float32)
    for actuator in rig.actuators:
        allowed = min(rig.limits.peak_m_s2, rig.limits.rms_m_s2) / actuator.full_scale_m_s2
        pulse[:, actuator.channel - 1] = PULSE_LEVEL * min(1.0, allowed) * shape
    return pulse


def try_stops(output: StreamOutput, *, lead_s: float) -> list[float]:
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


def _play_train(
    output: StreamOutput, *, seconds: float, on_step: Callable[[int, int], None] | None
) -> list[Playback]:
    played: list[Playback] = []
    begin_s = perf_counter()
    while (passed_s := perf_counter() - begin_s) < seconds or not played:
        if on_step is not None:
            on_step(round(1e3 * passed_s), round(1e3 * seconds))
        output.start(PULSE, gap_s=GAPS_S[len(played) % len(GAPS_S)])
        played.append(_await_end(output))
    return played


def _await_end(output: StreamOutput) -> Playback:
    while output.is_playing:
        sleep(0.001)
    return output.collect()


def _read_recordings(folder: Path, played: Sequence[Playback]) -> list[Samples]:
    """Read what the sensor measured at each pulse; where some were whole, only at those."""
    there = [playback for playback in played if "file_number" in playback.measured]
    whole = [
        one for one in there if not (one.underruns or one.error or one.measured["sensor_gaps"])
    ]
    numbers = [int(playback.measured["file_number"]) for playback in whole or there]
    return [read_wav(folder / f"{number:04}.wav")[0] for number in numbers]


def check_sensor(
    rig: Rig, recordings: Sequence[Samples], *, pulse: Frames, rate_hz: float
) -> SensorCheck | None:
    """Compare recordings, shape (n,) or (axes, n) in m/s², with the pulse that was sent; None without a sensor."""
    if rig.sensor is None:
        return None
    rms = [
        float(np.sqrt(np.mean(pulse[:, one.channel - 1] ** 2))) * one.full_scale_m_s2
        for one in rig.actuators
    ]
    shape = pulse[:, int(np.argmax(np.abs(pulse).max(axis=0)))].astype(np.float64)
    pulses = [
        measure_pulse(_take_strongest(one), rate_hz, shape=shape)
        for one in recordings
        if one.shape[-1] >= len(shape)
    ]
    sent_m_s2, full_scale_m_s2 = (min(rms), sum(rms)), rig.sensor.full_scale_m_s2
    faults = [
        find_fault(one, sent_m_s2=sent_m_s2, full_scale_m_s2=full_scale_m_s2) for one in pulses
    ]
    return SensorCheck(
        lags_ms=[one.lag_ms for one, fault in zip(pulses, faults, strict=True) if not fault],
        n_recorded=len(pulses),
        level_m_s2=float(np.median([one.level_m_s2 for one in pulses] or [np.nan])),
        noise_m_s2=float(np.median([one.noise_m_s2 for one in pulses] or [np.nan])),
        fault=_sum_up_faults(faults, channel=" ".join(map(str, rig.sensor.inputs))),
    )


def _take_strongest(recording: Samples) -> Samples:
    """Take the axis that moves most, shape (n,), of one or several."""
    axes = np.atleast_2d(recording)
    return np.asarray(axes[int(np.argmax(axes.std(axis=1)))])


def _sum_up_faults(faults: Sequence[str], *, channel: str) -> str:
    where = f"sensor on channel {channel}"
    if not faults:
        return (
            f"{where}: got no samples, expected a recording of each pulse; check the input device"
        )
    found = [fault for fault in faults if fault]
    return f"{where}, {len(found)} of {len(faults)} pulses: {found[0]}" if found else ""


def measure_pulse(samples: Samples, rate_hz: float, *, shape: Samples) -> SensedPulse:
    """Measure a pulse, shape (m,), where a recording, shape (n,) in m/s², correlates best with it."""
    motion = samples - samples.mean()  # an accelerometer may measure gravity too
    n = len(shape)
    products = np.abs(np.correlate(motion, shape, mode="valid"))
    first = int(np.argmax(products))
    found = motion[first : first + n]
    # A resonant coil is late, so what is just before the best place may be its pulse already.
    before = motion[: first - n // 2] if first >= n else motion[-(n // 2) :]
    norm = float(np.linalg.norm(found) * np.linalg.norm(shape))
    return SensedPulse(
        lag_ms=first / rate_hz * 1e3,
        level_m_s2=float(np.sqrt(np.mean(found**2))),
        noise_m_s2=float(np.sqrt(np.mean(before**2))),
        likeness=float(products[first]) / norm if norm else 0.0,
        peak_m_s2=float(np.abs(samples).max()),
        spread_m_s2=float(np.ptp(samples)),
    )


def find_fault(
    pulse: SensedPulse, *, sent_m_s2: tuple[float, float], full_scale_m_s2: float
) -> str:
    """Describe why a pulse cannot be trusted; empty if it can. sent_m_s2: RMS by the weakest coil, by all together."""
    low, high = sent_m_s2[0] / STRENGTH, sent_m_s2[1] * STRENGTH
    level, noise = pulse.level_m_s2, pulse.noise_m_s2
    if not pulse.spread_m_s2:
        return (
            f"got no signal (every sample is alike: {pulse.peak_m_s2:g} m/s²), expected a pulse of "
            f"{low:.2g} to {high:.2g} m/s² RMS; check the sensor's power and cable, the input's mute, "
            "and [sensor] channel in rig.toml"
        )
    if pulse.peak_m_s2 >= CLIPPED * full_scale_m_s2:
        return (
            f"got a clipped recording (full scale is {full_scale_m_s2:g} m/s²), expected its peak below; "
            "lower the input's gain, and full_scale_m_s2 under [sensor] in rig.toml with it"
        )
    if level < ABOVE_NOISE * noise or pulse.likeness < LIKENESS:
        return (
            f"got no pulse (at best {level:.2g} m/s² RMS with noise of {noise:.2g} before it, correlation "
            f"{pulse.likeness:.2f}), expected {ABOVE_NOISE:g} times the noise and a correlation of {LIKENESS:g}; "
            "check that the sensor is mounted, the amplifier on, and [sensor] channel in rig.toml"
        )
    if not low <= level <= high:
        return (
            f"got a pulse of {level:.2g} m/s² RMS, expected {low:.2g} to {high:.2g}; check mounting and gains, "
            "and full_scale_m_s2 of sensor and actuators in rig.toml"
        )
    return ""


def _sum_up(
    played: Sequence[Playback],
    sensor: SensorCheck | None,
    stops_ms: Sequence[float],
    *,
    identity: Mapping[str, Any],
) -> Examination:
    onsets = [(playback.requested_s, playback.onset_s) for playback in played]
    late_ms = [1e3 * (onset_s - asked_s) for asked_s, onset_s in onsets if onset_s is not None]
    onset_ms, jitter_ms, jitter_99_ms = _describe_delays(late_ms)
    lags_ms = sensor.lags_ms if sensor else ()
    sensed = _describe_delays(lags_ms) if lags_ms else (None, None, None)
    return Examination(
        device=identity["device"],
        host_api=identity["host_api"],
        rate_hz=identity["rate_hz"],
        latency_ms=1e3 * played[-1].measured.get("latency_s", float("nan")),
        n_pulses=len(played),
        n_failed=sum(not playback.completed or bool(playback.error) for playback in played),
        n_underruns=sum(playback.underruns for playback in played),
        onset_ms=onset_ms,
        jitter_ms=jitter_ms,
        jitter_99_ms=jitter_99_ms,
        sensed_ms=sensed[0],
        sensed_jitter_ms=sensed[1],
        sensed_jitter_99_ms=sensed[2],
        stop_ms=max(stops_ms, default=None),
        is_program=bool(identity["is_program"]),
        callback_ms_max=max(playback.measured.get("callback_ms_max", 0.0) for playback in played),
        error=next((playback.error for playback in reversed(played) if playback.error), ""),
        n_estimated=sum(playback.dac_source == FROM_LATENCY for playback in played),
        sensor=sensor,
    )


def _describe_delays(delays_ms: Sequence[float]) -> tuple[float, float, float]:
    """Compute the median, and the median and 99th percentile of the distance from it."""
    if not delays_ms:
        return float("nan"), float("nan"), float("nan")
    middle = float(np.median(delays_ms))
    low, high = np.percentile(np.abs(np.asarray(delays_ms) - middle), [50, 99])
    return middle, float(low), float(high)


# Drift of the coils since their certificate: a second of tones on each, compared with the response it holds.

PERIOD_S = 0.25  # all tones are multiples of its inverse
SETTLING_S, TONES_S = 0.25, 0.85  # until a coil moves steadily; length of the tones
REST_S = (
    0.15  # after them and the latency of the certificate, which may differ from today's by so much
)
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
    with open_session(rig, rate_hz=certificate.rate_hz, n_longest=n) as session:
        return [
            _measure_coil(session, coil, band_hz=certificate.band_hz)
            for coil in certificate.coils.values()
        ]


def find_tones(band_hz: tuple[float, float]) -> Samples:
    """Find frequencies in Hz about a third of an octave apart in a band, all of whole periods."""
    low, high = band_hz
    wanted = low * 2 ** np.arange(0.0, math.log2(high / low), 1 / 3)
    tones: Samples = np.unique(np.maximum(np.ceil(wanted * PERIOD_S), 1)) / PERIOD_S
    return tones[tones <= high]


def make_tones(coil: CoilCertificate, frequency_hz: Samples, *, rate_hz: float) -> Samples:
    """Make the sum of the tones, peak 1, shape (n,), ramped at both ends; what the coil makes weaker is stronger."""
    n_tones = round(TONES_S * rate_hz)
    time_s = np.arange(n_tones) / rate_hz
    size = np.interp(frequency_hz, coil.frequency_hz, np.abs(coil.response))
    turns = (
        np.arange(len(frequency_hz)) ** 2 / len(frequency_hz) / 2
    )  # Schroeder's phases: a low peak
    waves = np.sin(2 * np.pi * (np.outer(frequency_hz, time_s) + turns[:, None]))
    tones = (size**-0.5) @ waves * signal.windows.tukey(n_tones, 0.1)
    rest = round(REST_S * rate_hz) + coil.latency
    return np.concatenate([tones / np.abs(tones).max(), np.zeros(rest)])


def _measure_coil(
    session: Session, coil: CoilCertificate, *, band_hz: tuple[float, float]
) -> Drift:
    rig, rate_hz = session.rig, session.rate_hz
    frequency_hz = find_tones(band_hz)
    tones = make_tones(coil, frequency_hz, rate_hz=rate_hz)
    actuator = next(one for one in rig.actuators if one.name == coil.name)
    motion = float(np.abs(coil.respond(tones, rate_hz=rate_hz)).max())
    safe = MARGIN * min(rig.limits.peak_m_s2, require_sensor(rig).full_scale_m_s2) / motion
    sent = min(rig.calibration.level * find_allowed(rig, actuator), safe) * tones
    recorded = session.play(sent, coil.channel)
    along = coil.direction @ recorded if len(recorded) == len(coil.direction) else recorded[0]
    level_db, clear = compare_tones(
        sent, along, coil=coil, frequency_hz=frequency_hz, rate_hz=rate_hz
    )
    found = level_db[clear]
    if not len(found):
        return Drift(coil.name, math.nan, math.nan, 0)
    return Drift(coil.name, float(np.median(found)), float(max(found, key=abs)), len(found))


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
