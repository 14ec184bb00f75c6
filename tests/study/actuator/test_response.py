"""Calibration against simulated coils, whose every property was planted, and against their exact filters."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import signal, special

from feel321.study.actuator.response import (
    Response,
    Sweep,
    make_inverse,
    make_sweep,
    measure_response,
    measure_sweep,
)
from feel321.study.actuator.rig import CoilTable
from feel321.study.actuator.simulated import SimulatedCoil, discretise

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


def make_plain(coil: CoilTable, *, n_taps: int) -> tuple[Any, float]:
    """The filter that a plain ratio of Welch spectra gives, from as many seconds of noise, and its target."""
    noise = 0.2 * np.random.default_rng(3).standard_normal(len(make_sweep(SWEEP)))
    recorded = np.array(coil.direction) / 3 @ drive(coil, noise, seed=4)
    frequency_hz, sent = signal.welch(noise, RATE_HZ, nperseg=1024)
    gain = np.sqrt(signal.welch(recorded, RATE_HZ, nperseg=1024)[1] / sent)
    inside = (frequency_hz >= 20) & (frequency_hz <= 1000)
    target = float(np.median(gain[inside]))
    wanted = np.where(inside, target / gain, 1.0)
    return signal.firwin2(n_taps + 1, frequency_hz, wanted, fs=RATE_HZ), target


@pytest.mark.parametrize(
    ("resonance_hz", "q"), [(80.0, 8.0), (80.0, 1.0), (160.0, 3.0), (250.0, 1.0), (250.0, 8.0)]
)
def test_coils_are_equalised(resonance_hz: float, q: float) -> None:
    coil = alter(REAL, resonance_hz=resonance_hz, q=q)
    response = measure(coil)
    inverse = make_inverse(response, max_gain_db=50, n_taps=8000)
    plain, plain_target = make_plain(coil, n_taps=8000)
    after = play_through(inverse.fir, coil)
    inside = (after.frequency_hz >= EVIDENCE_HZ[0]) & (after.frequency_hz <= EVIDENCE_HZ[1])
    assert find_largest(after, inverse.target) < 1
    assert after.coherence[inside].min() > 0.95
    assert find_largest(response, inverse.target) > 20
    assert find_largest(play_through(plain, coil), plain_target) > 1


def test_linear_phase_equalises_as_well() -> None:
    inverse = make_inverse(measure(REAL), max_gain_db=50, n_taps=8001, phase="linear")
    assert np.allclose(inverse.fir, inverse.fir[::-1], atol=1e-12)
    assert inverse.delay == 4000
    assert find_largest(play_through(inverse.fir, REAL), inverse.target) < 1


def test_minimum_phase_undoes_the_phase_too() -> None:
    found = play_through(make_inverse(measure(QUIET), max_gain_db=50, n_taps=8000).fir, QUIET)
    # Nearer to its lower edge, the step from the full correction to none turns the phase itself.
    inside = (found.frequency_hz > 100) & (found.frequency_hz < 800)
    uncorrected = measure(QUIET)
    turned = [np.abs(np.angle(one.response[inside])).max() for one in (found, uncorrected)]
    assert turned[0] < turned[1] / 3, turned


def test_corrected_phase_gives_the_shape_that_was_asked_for_only_later() -> None:
    inverse = make_inverse(measure(QUIET), max_gain_db=50, n_taps=8000, phase="corrected")
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


def test_noise_gives_the_same_response_and_latency() -> None:
    noise = 0.2 * np.random.default_rng(5).standard_normal(16 * 8000)
    coil = alter(REAL, latency=700, saturation=None)
    found = measure_response(noise, drive(coil, noise), rate_hz=RATE_HZ, segment=4096)
    swept = measure(coil)
    inside = (found.frequency_hz >= 50) & (found.frequency_hz <= 1000)
    size = np.interp(found.frequency_hz, swept.frequency_hz, np.abs(swept.response))
    assert found.latency == 700
    assert np.abs(20 * np.log10(np.abs(found.response) / size)[inside]).max() < 0.5
    assert found.coherence[inside].min() > 0.95


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


def test_a_linear_coil_has_no_distortion() -> None:
    found = measure(alter(QUIET, resonance_hz=80, q=1))
    inside = (found.frequency_hz > 25) & (found.frequency_hz < 900)
    assert found.distortion[inside].max() < 0.003


@pytest.mark.parametrize("direction", [(0, 0, 1), (1, -2, 2), (-1, 0.1, 0), (1, 1, 1)])
def test_planted_direction_is_found_with_its_sign(direction: Any) -> None:
    found = measure(alter(REAL, direction=direction, noise_m_s2=0.05))
    cosine = found.direction @ np.array(direction) / np.linalg.norm(direction)
    assert math.degrees(math.acos(min(cosine, 1))) < 3


def test_planted_cross_talk_is_found() -> None:
    sweeps = make_sweep(SWEEP)
    across = alter(QUIET, direction=(2, 1, 0), full_scale_m_s2=10 * 10 ** (-30 / 20), latency=45)
    recorded = drive(QUIET, sweeps) + drive(across, sweeps)
    assert measure_sweep(SWEEP, recorded).cross_talk_db == pytest.approx(-30, abs=1)


def test_gain_and_latency_change_nothing_else() -> None:
    base, loud, late = (
        measure(coil)
        for coil in (QUIET, alter(QUIET, full_scale_m_s2=40), alter(QUIET, latency=800))
    )
    first, second, third = (make_inverse(one, n_taps=4000) for one in (base, loud, late))
    inside = (base.frequency_hz >= 20) & (base.frequency_hz <= 1000)
    assert np.allclose(loud.response[inside], 4 * base.response[inside], rtol=1e-9)
    assert np.allclose(late.response[inside], base.response[inside], rtol=1e-6)
    assert late.latency - base.latency == 763
    assert second.target == pytest.approx(4 * first.target)
    assert np.allclose(second.fir, first.fir, atol=1e-9)
    assert np.allclose(third.fir, first.fir, atol=1e-6)


@pytest.mark.parametrize("max_gain_db", [0.0, 12.0, 30.0])
@pytest.mark.parametrize("phase", ["minimum", "linear"])
def test_gain_is_bounded(max_gain_db: float, phase: Any) -> None:
    response = measure(REAL)
    inverse = make_inverse(response, max_gain_db=max_gain_db, n_taps=4000, phase=phase)
    largest_db = 20 * np.log10(np.abs(np.fft.rfft(inverse.fir, 2**17)).max())
    assert largest_db <= max_gain_db + 0.01
    assert inverse.gain_db == pytest.approx(largest_db, abs=0.01)
    louder = (response.frequency_hz > 160) & (response.frequency_hz < 200)
    reachable, at_hz = np.abs(response.response[louder]), response.frequency_hz[louder]
    gain = np.abs(signal.freqz(inverse.fir, 1, at_hz, fs=RATE_HZ)[1])
    assert 20 * np.log10(gain * reachable / inverse.target) == pytest.approx(0, abs=0.06)


def test_nothing_is_corrected_where_coherence_is_poor_or_outside_the_band() -> None:
    response = measure(QUIET)
    hole = (response.frequency_hz > 40) & (response.frequency_hz < 60)
    poor = replace(response, coherence=np.where(hole, 0.5, response.coherence))
    asked_hz = [10.0, 50.0, 100.0, 3000.0]
    for one, expected_db in [(poor, 0.0), (response, 17.0)]:
        fir = make_inverse(one, max_gain_db=50, n_taps=8000).fir
        gain_db = 20 * np.log10(np.abs(signal.freqz(fir, 1, asked_hz, fs=RATE_HZ)[1]))
        assert gain_db[[0, 3]] == pytest.approx([0, 0], abs=0.3)
        assert (gain_db[1] > expected_db) if expected_db else (abs(gain_db[1]) < 0.5)


@pytest.mark.parametrize("peak", [0.01, 0.5, 1.0])
def test_sweeps_keep_their_limit_and_rise_from_silence(peak: float) -> None:
    sweep = replace(SWEEP, peak=peak)
    first, *others = make_sweep(sweep).reshape(sweep.n_repeats, -1)
    envelope = np.abs(signal.hilbert(first))
    begin = round(sweep.time_constant_s * math.log(2) * RATE_HZ)
    end = round(sweep.time_constant_s * math.log(2 * 1000 / 20) * RATE_HZ)
    assert np.abs(first).max() <= peak
    assert all(np.array_equal(first, other) for other in others)
    assert envelope[begin + 400 : end - 40] == pytest.approx(peak, rel=0.02)
    assert np.abs(first[:80]).max() < 0.01 * peak
    assert np.abs(first[end + 2000 :]).max() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("block", [1, 1000])
def test_blocks_do_not_matter_to_the_coil(block: int) -> None:
    coil = alter(REAL, drift_db_per_min=-3.0)
    samples = np.random.default_rng(6).standard_normal(2000)
    whole = drive(coil, samples)
    parts = SimulatedCoil(coil, rate_hz=RATE_HZ, rng=np.random.default_rng(1))
    pieces = [parts.process(samples[a : a + block]) for a in range(0, 2000, block)]
    assert np.allclose(np.concatenate(pieces, axis=1), whole, rtol=1e-9, atol=1e-12)


def test_a_coil_drifts_as_planted_and_never_answers_early() -> None:
    tone = np.sin(2 * np.pi * 160 * np.arange(8000 * 30) / RATE_HZ)
    moved = drive(alter(QUIET, drift_db_per_min=-4.0), tone)[2]
    assert not moved[:37].any()
    assert moved[38] != 0
    levels = [np.abs(moved[k : k + 800]).max() for k in (4000, 4000 + 8000 * 15)]
    assert 20 * math.log10(levels[1] / levels[0]) == pytest.approx(-1, abs=0.01)


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: Sweep(rate_hz=2000), "band_hz must rise within 0 to 800 Hz"),
        (lambda: replace(SWEEP, peak=1.2), "peak must be above 0 and at most 1"),
        (lambda: replace(SWEEP, n_repeats=1), "n_repeats must be 2 or more"),
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
