"""Calibration against simulated coils, whose every property was planted, and against their exact filters."""

import math
from dataclasses import replace
from pathlib import Path
from time import perf_counter, sleep
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy import signal, special

from feel321.stimuli.wav import read_wav
from feel321.study.actuator.device import BLOCK_FRAMES, SimulatedCoil, discretise
from feel321.study.actuator.output import open_output
from feel321.study.actuator.response import Response, Sweep, make_inverse, make_sweep, measure_sweep
from feel321.study.actuator.rig import (
    CoilTable,
    DeviceTable,
    LimitsTable,
    Rig,
    SensorTable,
    SimulationTable,
)

RATE_HZ = 8000.0
SWEEP = Sweep(rate_hz=RATE_HZ)
QUIET = CoilTable(
    name="coil", resonance_hz=160, q=4, full_scale_m_s2=10, direction=(1, -2, 2), latency=37
)
REAL = QUIET.model_copy(
    update={"noise_m_s2": 0.002, "saturation": 3.0}
)  # noise 74 dB below full scale
EVIDENCE_HZ = (20.0, 800.0)


def alter(coil: CoilTable, **changes: Any) -> CoilTable:
    return coil.model_copy(update=changes)


def find_largest(found: Response, target: float, band_hz: Any = EVIDENCE_HZ) -> float:
    """Find the largest deviation from a target in a band, in dB."""
    return float(np.abs(found.find_deviation_db(target=target, band_hz=band_hz)).max())


def drive(coil: CoilTable, samples: Any, *, rate_hz: float = RATE_HZ, seed: int = 1) -> Any:
    return SimulatedCoil(coil, rate_hz=rate_hz, rng=np.random.default_rng(seed)).process(samples)


def measure(coil: CoilTable, sweep: Sweep = SWEEP) -> Response:
    return measure_sweep(sweep, drive(coil, make_sweep(sweep), rate_hz=sweep.rate_hz))


def play_through(fir: Any, coil: CoilTable) -> Response:
    """Play sweeps through a filter, as loud as without it, and measure from before the filter to the sensor."""
    sweeps = make_sweep(SWEEP)
    filtered = signal.oaconvolve(sweeps, fir)[: len(sweeps)]
    scale = SWEEP.peak / np.abs(filtered).max()
    return measure_sweep(SWEEP, drive(coil, scale * filtered, seed=2), sent=scale * sweeps)


@pytest.mark.parametrize(
    ("resonance_hz", "q"), [(80.0, 8.0), (80.0, 1.0), (160.0, 3.0), (250.0, 1.0), (250.0, 8.0)]
)
def test_coils_are_equalised(resonance_hz: float, q: float) -> None:
    coil = alter(REAL, resonance_hz=resonance_hz, q=q)
    response = measure(coil)
    inverse = make_inverse(response, max_gain_db=50, n_taps=8000)
    after = play_through(inverse.fir, coil)
    inside = (after.frequency_hz >= EVIDENCE_HZ[0]) & (after.frequency_hz <= EVIDENCE_HZ[1])
    assert find_largest(after, inverse.target) < 1
    assert after.coherence[inside].min() > 0.95
    assert find_largest(response, inverse.target) > 20


def test_corrected_phase_gives_the_shape_that_was_asked_for_only_later() -> None:
    inverse = make_inverse(measure(QUIET), max_gain_db=50, n_taps=8000)
    found = play_through(inverse.fir, QUIET)
    assert inverse.delay == 4 / 20 * RATE_HZ
    assert found.latency == QUIET.latency + inverse.delay
    inside = (found.frequency_hz > 25) & (found.frequency_hz < 800)
    assert np.abs(np.angle(found.response[inside])).max() < 0.15
    assert find_largest(found, inverse.target) < 1


def test_response_is_that_of_the_exact_filter() -> None:
    found = measure(QUIET)
    inside = (found.frequency_hz >= 20) & (found.frequency_hz <= 1000)
    exact = signal.freqz(
        *discretise(QUIET, rate_hz=RATE_HZ), found.frequency_hz[inside], fs=RATE_HZ
    )[1]
    assert np.abs(found.response[inside] / (10 * exact) - 1).max() < 0.01
    assert found.coherence[inside].min() > 0.9999


@pytest.mark.parametrize(("rate_hz", "latency"), [(8000, 0), (8000, 701), (48000, 2401)])
@pytest.mark.parametrize(("resonance_hz", "q"), [(80, 8), (250, 1)])
def test_latency_is_found_to_the_sample(
    rate_hz: float, latency: int, resonance_hz: float, q: float
) -> None:
    coil = alter(REAL, resonance_hz=resonance_hz, q=q, latency=latency)
    sweep = Sweep(rate_hz=rate_hz, duration_s=2, n_repeats=2)
    assert measure(coil, sweep).latency == latency


@pytest.mark.parametrize("saturation", [0.2, 0.5, 1.0])
def test_planted_distortion_is_found_within_a_tenth(saturation: float) -> None:
    coil = alter(REAL, saturation=saturation)
    found = measure(coil)
    # Fourier coefficients of s tanh(a sin(x) / s), by Gauss-Legendre; even ones are 0.
    nodes, weights = special.roots_legendre(200)
    angle = np.pi / 2 * (nodes + 1)
    wave = np.tanh(SWEEP.peak / saturation * np.sin(angle))
    planted = {n: abs(np.sum(weights * wave * np.sin(n * angle))) for n in (1, 3, 5)}
    b, a = discretise(coil, rate_hz=RATE_HZ)
    for f in (25.0, 50.0, 100.0, 160.0, 300.0, 600.0, 790.0):
        sizes = [planted[n] * abs(signal.freqz(b, a, [n * f], fs=RATE_HZ)[1][0]) for n in planted]
        expected = math.hypot(*sizes[1:]) / sizes[0]
        at = np.interp(f, found.frequency_hz, found.distortion)
        assert at == pytest.approx(expected, rel=0.1), f


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, -2, 2), (-1, 0.1, 0), (1, 1, 1)])
def test_planted_direction_is_found_with_its_sign(direction: Any) -> None:
    found = measure(alter(REAL, direction=direction, noise_m_s2=0.05))
    cosine = found.direction @ np.array(direction) / np.linalg.norm(direction)
    assert math.degrees(math.acos(min(cosine, 1))) < 3


@pytest.mark.parametrize("max_gain_db", [0.0, 12.0, 30.0])
def test_gain_is_bounded(max_gain_db: float) -> None:
    response = measure(REAL)
    inverse = make_inverse(response, max_gain_db=max_gain_db, n_taps=4000)
    largest_db = 20 * np.log10(np.abs(np.fft.rfft(inverse.fir, 2**17)).max())
    assert largest_db <= max_gain_db + 0.01
    assert inverse.gain_db == pytest.approx(largest_db, abs=0.01)
    louder = (response.frequency_hz > 160) & (response.frequency_hz < 200)
    reachable, at_hz = np.abs(response.response[louder]), response.frequency_hz[louder]
    gain = np.abs(signal.freqz(inverse.fir, 1, at_hz, fs=RATE_HZ)[1])
    assert 20 * np.log10(gain * reachable / inverse.target) == pytest.approx(0, abs=0.06)


def test_nothing_is_corrected_where_coherence_is_poor_or_outside_the_band() -> None:
    response = measure(QUIET)
    hole = (response.frequency_hz > 30) & (response.frequency_hz < 80)
    poor = replace(response, coherence=np.where(hole, 0.5, response.coherence))
    asked_hz = [10.0, 50.0, 100.0, 3000.0]
    for one, expected_db in [(poor, 0.0), (response, 17.0)]:
        fir = make_inverse(one, max_gain_db=50, n_taps=8000).fir
        gain_db = 20 * np.log10(np.abs(signal.freqz(fir, 1, asked_hz, fs=RATE_HZ)[1]))
        assert gain_db[[0, 3]] == pytest.approx([0, 0], abs=1.5)
        assert (gain_db[1] > expected_db) if expected_db else (abs(gain_db[1]) < 1)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Sweep(rate_hz=2000), "band_hz must rise within 0 to 800 Hz"),
        (lambda: replace(SWEEP, duration_s=0.001), "must be longer"),
        (lambda: measure_sweep(SWEEP, np.zeros(len(make_sweep(SWEEP)))), "not all 0"),
        (lambda: measure_sweep(SWEEP, np.full(len(make_sweep(SWEEP)), np.nan)), "finite"),
        (
            lambda: make_inverse(measure(QUIET), n_taps=100, min_coherence=1.1),
            "no frequency from 20 to 1000 Hz has coherence",
        ),
        (lambda: drive(QUIET, np.ones(3), rate_hz=200), "rate_hz must be above twice"),
    ],
)
def test_bad_input_is_refused(call: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        call()


def test_a_playback_comes_back_through_coils_and_sensor(tmp_path: Path) -> None:
    """To the sample: what the sensor of the simulated device measures is what its coils make of what was sent."""
    table = alter(
        REAL, name="right coil", direction=(0, 3, 4), latency=3, noise_m_s2=0.0, saturation=None
    )
    rig = Rig(
        device=DeviceTable(name="simulated", latency_s=0.1),
        limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=60.0, duration_s=30.0),
        sensor=SensorTable(channels=(1, 2, 3), full_scale_m_s2=200.0),
        simulation=SimulationTable(speed=10.0, latency=40, noise_m_s2=0.0, coils=(table,)),
    )
    sound = np.zeros((4000, 2), dtype=np.float32)
    sound[:, 1] = np.random.default_rng(1).uniform(-0.5, 0.5, 4000)
    own = {"rate_hz": RATE_HZ, "folder": tmp_path, "clock": perf_counter}
    with open_output(rig, {"noise": sound}, **own) as output:
        output.start("noise", gap_s=0.05)
        while output.is_playing:
            sleep(0.001)
        playback = output.collect()
    assert (playback.completed, playback.error, playback.underruns) == (True, "", 0)
    measured, rate_hz = read_wav(tmp_path / f"{playback.measured['file_number']:04.0f}.wav")
    assert_array_equal(measured, output.captured)
    late = BLOCK_FRAMES + 40 + 3
    moved = signal.lfilter(*discretise(table, rate_hz=RATE_HZ), sound[:, 1])
    assert rate_hz == RATE_HZ
    expected = np.outer([0, 0.6, 0.8], 10 * moved)
    np.testing.assert_allclose(measured[:, late : late + 4000], expected, atol=1e-4)
    assert not measured[:, :late].any()
