"""A check of the rig: its devices and their rates, and a quiet train of pulses through the stream that sessions use."""

import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import StreamOutput, open_stream
from feel321.study.actuator.rig import Rig
from feel321.study.actuator.stream import list_devices, list_rates
from feel321.study.session.ports import Playback

RATES_HZ = (8000.0, 16000.0, 44100.0, 48000.0, 96000.0, 192000.0)

PULSE, TONE = "pulse", "tone"
PULSE_S = 0.02
PULSE_HZ = 250.0  # where skin is most sensitive
PULSE_LEVEL = 0.1  # of full scale or of the peak that the rig allows, whichever is less
TONE_S = 0.5  # length, besides what the device holds, of a tone that is stopped after its begin
STOPS_S = (0.1, 0.117, 0.131)  # times at which tones are stopped; uneven as well
N_TRIES = 5  # attempts at each stop, where a busy machine lets the tone end before it, or run dry
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
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open_stream(rig, sounds, rate_hz=rate_hz, folder=folder, clock=perf_counter) as output:
            played = _play_train(output, seconds=seconds, on_step=on_step)
            stops_ms = try_stops(output, lead_s=rig.masking.lead_s if rig.masking else 0.0)
            identity = output.identity
        numbers = [playback.measured.get("file_number") for playback in played]
        files = [folder / f"{int(number):04}.wav" for number in numbers if number is not None]
        lags_ms = [_find_lag(file, sounds[PULSE]) for file in files]
    return _sum_up(played, lags_ms, stops_ms, identity=identity)


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


def _find_lag(file: Path, pulse: Frames) -> float:
    """Find how late a pulse is in what the sensor measured, in ms."""
    samples, rate_hz = read_wav(file)
    shape = pulse[:, int(np.argmax(np.abs(pulse).max(axis=0)))].astype(np.float64)
    return float(np.argmax(np.abs(np.correlate(samples, shape, mode="valid")))) / rate_hz * 1e3


def _sum_up(
    played: Sequence[Playback],
    lags_ms: Sequence[float],
    stops_ms: Sequence[float],
    *,
    identity: Mapping[str, Any],
) -> Examination:
    onsets = [(playback.requested_s, playback.onset_s) for playback in played]
    late_ms = [1e3 * (onset_s - asked_s) for asked_s, onset_s in onsets if onset_s is not None]
    onset_ms, jitter_ms, jitter_99_ms = _describe_delays(late_ms)
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
    )


def _describe_delays(delays_ms: Sequence[float]) -> tuple[float, float, float]:
    """Compute the median, and the median and 99th percentile of the distance from it."""
    if not delays_ms:
        return float("nan"), float("nan"), float("nan")
    middle = float(np.median(delays_ms))
    low, high = np.percentile(np.abs(np.asarray(delays_ms) - middle), [50, 99])
    return middle, float(low), float(high)
