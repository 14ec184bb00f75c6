"""Is the rig well? Its devices and their rates, and a quiet train of pulses through the stream that sessions use."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from time import perf_counter, sleep
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.stream import list_devices, list_rates
from feel321.study.actuator.stream_output import open_stream

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from feel321.study.actuator.output import Delivery
    from feel321.study.actuator.rig import Rig
    from feel321.study.actuator.stream_output import StreamOutput

RATES_HZ = (8000.0, 16000.0, 44100.0, 48000.0, 96000.0, 192000.0)

PULSE = "pulse"
PULSE_S = 0.02
PULSE_HZ = 250.0  # where skin feels best
PULSE_LEVEL = 0.1
"""Level of a pulse, as a part of full scale or of the peak that the rig allows, whichever is less."""

TONE = "tone"
TONE_S = 0.5
"""How long a tone lasts, besides what the device holds, that is stopped after its begin."""

STOPS_S = (0.1, 0.117, 0.131)
"""After these, uneven as well."""

N_TRIES = 5
"""So often each stop is tried where a busy machine lets the tone end before it, or run dry."""

GAPS_S = (0.1, 0.113, 0.127, 0.139, 0.151)
"""Uneven, so that onsets do not keep step with the device's blocks."""


@dataclass(frozen=True, slots=True)
class Examination:
    """What a train of pulses showed."""

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


def survey_devices(*, rates_hz: Sequence[float] = RATES_HZ) -> list[dict[str, Any]]:
    """List the devices, and the rates at which each would play.

    Returns one per device: name, host API, numbers of channels, rates in Hz, whether a program
    stands before it.
    """
    devices = list_devices()
    if not devices:
        raise OSError(
            'doctor: got no audio device at all; plug one in, or play to files: name = "file" in rig.toml'
        )
    return [
        {
            "name": device.name,
            "host_api": device.host_api,
            "outputs": device.n_outputs,
            "inputs": device.n_inputs,
            "rates_hz": list_rates(device, n_channels=1, rates_hz=rates_hz)
            if device.n_outputs
            else [],
            "is_program": device.is_program,
        }
        for device in devices
    ]


def examine_rig(
    rig: Rig, *, rate_hz: float, seconds: float, on_step: Callable[[int, int], None] | None = None
) -> Examination:
    """Play pulses on all actuators for a while, measure when they began, and how long stops take.

    on_step: called with the ms that have passed, and all of them.
    """
    tone_s = min(TONE_S + 2 * rig.device.latency_s, rig.limits.duration_s)
    sounds = {
        PULSE: make_pulse(rig, rate_hz=rate_hz, seconds=min(PULSE_S, rig.limits.duration_s)),
        TONE: make_pulse(rig, rate_hz=rate_hz, seconds=tone_s),
    }
    with (
        tempfile.TemporaryDirectory() as folder,
        open_stream(
            rig, sounds, rate_hz=rate_hz, folder=Path(folder), clock=perf_counter
        ) as output,
    ):
        deliveries = _play_train(output, seconds=seconds, on_step=on_step)
        stops_ms = try_stops(output, lead_s=rig.masking.lead_s if rig.masking else 0.0)
        lags_ms = [
            _find_lag(Path(folder), delivery, sounds[PULSE], rate_hz=rate_hz)
            for delivery in deliveries
            if "file_number" in delivery.measured
        ]
        return _sum_up(deliveries, lags_ms, stops_ms, identity=output.identity)


def make_pulse(rig: Rig, *, rate_hz: float, seconds: float = PULSE_S) -> NDArray[np.float32]:
    """Make a quiet pulse for all actuators of a rig.

    Returns (n, channels).
    """
    n = max(round(seconds * rate_hz), 1)
    time_s = np.arange(n) / rate_hz
    shape = np.hanning(n) * np.sin(2 * np.pi * PULSE_HZ * time_s)
    pulse = np.zeros((n, rig.n_channels), dtype=np.float32)
    for actuator in rig.actuators:
        full_scale = actuator.full_scale_m_s2
        peak = min(1.0, rig.limits.peak_m_s2 / full_scale, rig.limits.rms_m_s2 / full_scale)
        pulse[:, actuator.channel - 1] = PULSE_LEVEL * peak * shape
    return pulse


def try_stops(output: StreamOutput, *, lead_s: float) -> list[float]:
    """Stop tones on their way, and measure how long each of them went on.

    Returns from the wish to stop to silence, in ms.
    """
    stops_s: list[float] = []
    for wait_s in STOPS_S:
        tries_s = (_try_stop(output, lead_s=lead_s, wait_s=wait_s) for _ in range(N_TRIES))
        stops_s += islice((stop_s for stop_s in tries_s if stop_s is not None), 1)
    return [1e3 * stop_s for stop_s in stops_s]


def _play_train(
    output: StreamOutput, *, seconds: float, on_step: Callable[[int, int], None] | None
) -> list[Delivery]:
    deliveries: list[Delivery] = []
    begin_s = perf_counter()
    while (passed_s := perf_counter() - begin_s) < seconds or not deliveries:
        if on_step is not None:
            on_step(round(1e3 * passed_s), round(1e3 * seconds))
        output.start(PULSE, gap_s=GAPS_S[len(deliveries) % len(GAPS_S)])
        while output.is_playing:
            sleep(0.001)
        deliveries.append(output.collect())
    return deliveries


def _try_stop(output: StreamOutput, *, lead_s: float, wait_s: float) -> float | None:
    output.start(TONE, gap_s=lead_s)
    sleep(lead_s + wait_s)
    output.stop()
    while output.is_playing:
        sleep(0.001)
    delivery = output.collect()
    return None if delivery.underruns else delivery.measured.get("stop_s")


def _find_lag(
    folder: Path, delivery: Delivery, pulse: NDArray[np.float32], *, rate_hz: float
) -> float:
    """Find a pulse in what the sensor measured; how late it is, in ms."""
    samples, _ = read_wav(folder / f"{int(delivery.measured['file_number']):04}.wav")
    shape = pulse[:, int(np.argmax(np.abs(pulse).max(axis=0)))].astype(np.float64)
    return float(np.argmax(np.abs(np.correlate(samples, shape, mode="valid")))) / rate_hz * 1e3


def _sum_up(
    deliveries: Sequence[Delivery],
    lags_ms: Sequence[float],
    stops_ms: Sequence[float],
    *,
    identity: Mapping[str, Any],
) -> Examination:
    begun = [(delivery.requested_s, delivery.onset_s) for delivery in deliveries]
    late_ms = [
        1e3 * (onset_s - requested_s) for requested_s, onset_s in begun if onset_s is not None
    ]
    onset_ms, jitter_ms, jitter_99_ms = _describe(late_ms)
    sensed_ms, sensed_jitter_ms, sensed_jitter_99_ms = (
        _describe(lags_ms) if lags_ms else (None, None, None)
    )
    errors = [delivery.error for delivery in deliveries if delivery.error]
    return Examination(
        device=identity["device"],
        host_api=identity["host_api"],
        rate_hz=identity["rate_hz"],
        latency_ms=1e3 * deliveries[-1].measured.get("latency_s", float("nan")),
        n_pulses=len(deliveries),
        n_failed=sum(not delivery.completed or bool(delivery.error) for delivery in deliveries),
        n_underruns=sum(delivery.underruns for delivery in deliveries),
        onset_ms=onset_ms,
        jitter_ms=jitter_ms,
        jitter_99_ms=jitter_99_ms,
        sensed_ms=sensed_ms,
        sensed_jitter_ms=sensed_jitter_ms,
        sensed_jitter_99_ms=sensed_jitter_99_ms,
        stop_ms=max(stops_ms, default=None),
        is_program=bool(identity["is_program"]),
        callback_ms_max=max(
            delivery.measured.get("callback_ms_max", 0.0) for delivery in deliveries
        ),
        error=errors[-1] if errors else "",
    )


def _describe(delays_ms: Sequence[float]) -> tuple[float, float, float]:
    """Give the median, and the median and 99th percentile of the distance from it."""
    if not delays_ms:
        return float("nan"), float("nan"), float("nan")
    middle = float(np.median(delays_ms))
    low, high = np.percentile(np.abs(np.asarray(delays_ms) - middle), [50, 99])
    return middle, float(low), float(high)
