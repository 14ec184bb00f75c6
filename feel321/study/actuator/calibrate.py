"""Calibration of a rig: sweeps and noise on each coil, through the output that sessions use, recorded by its sensor.

Each coil begins with a quiet sweep. What it makes of that decides how loud the next ones may be, so that neither the
rig's limits nor the sensor's full scale is passed; then levels rise, and the loudest sweep is the measurement. A coil
is measured, its filter is designed from what was measured, and both are verified by playing through the filter.
"""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import cast

import numpy as np
from scipy import fft

from feel321.study.actuator.bench import ALIVE, Bench, OnStep, average_thirds, find_slip, open_bench
from feel321.study.actuator.certificate import (
    MEASURED,
    TYPED,
    BudgetTerm,
    Certificate,
    CoilCertificate,
    begin_certificate,
)
from feel321.study.actuator.render import find_directions
from feel321.study.actuator.response import (
    ABOVE,
    BELOW,
    Phase,
    Response,
    Spectrum,
    Sweep,
    find_inside,
    find_ramp,
    make_inverse,
    make_sweep,
    measure_response,
    measure_sweep,
)
from feel321.study.actuator.rig import STANDARD_GRAVITY, ActuatorTable, Rig, require_sensor
from feel321.types import Samples

PROBE = 0.1  # of the level that limits allow: the first sweep of a coil
LADDER = (0.125, 0.25, 0.5)  # of the loudest sweep, before it
MARGIN = 0.9  # of limits and of the sensor's full scale, for what is foreseen
RINGING = 0.01  # of the RMS of a sweep: what may be left at the end of its pause
CREST = 4.0  # peak of the noise over its RMS
MOST_TURNED_DEG = 30.0  # from the direction in rig.toml
SILENCE_S = 0.5
TILTED = 0.1  # of the change along a sensor's axis: so much may come across it
SLIGHT = 0.001  # of the sensor's full scale: less is no gravity
TAPS_PERIODS = 12.0  # of the band's lowest frequency: the length of a filter
STEP_HZ = 0.5  # of the frequencies in a certificate
DB = 20 / math.log(10)


def calibrate_rig(
    rig: Rig,
    *,
    rate_hz: float,
    made: datetime,
    on_step: OnStep | None = None,
    is_stopping: Callable[[], bool] = lambda: False,
) -> Certificate:
    """Measure the coils of a rig, make their filters, and verify them by playing through them."""
    require_sensor(rig)
    main, quiet = make_main(rig, rate_hz=rate_hz), make_quiet(rig, rate_hz=rate_hz)
    n_main, n_quiet = main.period * main.n_repeats, quiet.period * quiet.n_repeats
    n_noise, n_coils = _count_noise(main), len(rig.actuators)
    n_all = 2 * n_main + (1 + len(LADDER)) * n_quiet + n_noise + n_quiet
    opened = open_bench(
        rig,
        rate_hz=rate_hz,
        n_longest=max(n_main, n_noise, n_coils * n_quiet),
        n_all=n_coils * n_all + round(SILENCE_S * rate_hz),
        on_step=on_step,
        is_stopping=is_stopping,
    )
    coils: dict[str, CoilCertificate] = {}
    with opened as bench:
        silence = np.zeros(round(SILENCE_S * rate_hz))
        noise = bench.play(silence, rig.actuators[0].channel).std(axis=1)
        for actuator in rig.actuators:
            try:
                run = measure_coil(bench, actuator)
                coil = design_coil(rig, run, noise_m_s2=float(np.linalg.norm(noise)))
                coils[actuator.name] = verify_coil(bench, coil, run)
            except ValueError as error:
                raise ValueError(f"coil {actuator.name!r}: {error}") from None
        latencies = measure_latencies(bench, coils)
    for name, coil in coils.items():
        shares = {
            other.name: abs(float(coil.direction @ other.direction))
            for other in coils.values()
            if other.name != name
        }
        onto_db = {other: DB * math.log(max(share, 1e-6)) for other, share in shares.items()}
        coils[name] = replace(coil, latency=latencies[name], onto_db=onto_db)
    certificate = begin_certificate(rig, coils, method=MEASURED, made=made, rate_hz=rate_hz)
    failures = [line for coil in coils.values() for line in find_failures(rig, coil)]
    return replace(certificate, failures=tuple(failures))


# Gravity, by which the scale of a sensor can be found.


def measure_rest(rig: Rig, *, rate_hz: float) -> Samples:
    """Measure the mean of each axis of the sensor while nothing plays, shape (axes,) in m/s²."""
    n = round(SILENCE_S * rate_hz)
    with open_bench(rig, rate_hz=rate_hz, n_longest=n) as bench:
        rest: Samples = bench.play(np.zeros(n), rig.actuators[0].channel).mean(axis=1)
        return rest


def scale_by_flip(up: Samples, down: Samples, *, full_scale_m_s2: float) -> float:
    """Find a sensor's full scale in m/s² from its rest with an axis up and down, shape (axes,) each.

    Gravity is once with the axis and once against it: half of the difference is 1 g, whatever the offset.
    """
    halves = np.sort(np.abs(up - down)) / 2
    half = float(halves[-1])
    if half < SLIGHT * full_scale_m_s2:
        raise ValueError(
            f"got a difference of {2 * half:.3g} m/s², expected about {2 * STANDARD_GRAVITY:.3g}; the sensor or its "
            "input does not pass gravity (AC-coupled): take the scale from its data sheet"
        )
    if (across := float(np.linalg.norm(halves[:-1]))) > TILTED * half:
        raise ValueError(
            f"got a difference of {2 * across:.3g} m/s² across the axis, expected at most {TILTED:.0%} of "
            f"the {2 * half:.3g} along it; turn the sensor by exactly half a turn, with one axis upright"
        )
    return full_scale_m_s2 * STANDARD_GRAVITY / half


# What is played.


def make_main(rig: Rig, *, rate_hz: float, peak: float = 1.0) -> Sweep:
    """Make the sweep that is the measurement."""
    settings = rig.calibration
    return Sweep(
        rate_hz=rate_hz,
        band_hz=settings.band_hz,
        duration_s=min(settings.sweep_s, MARGIN * rig.limits.duration_s),
        pause_s=settings.pause_s,
        n_repeats=settings.repeats,
        peak=peak,
    )


def make_quiet(rig: Rig, *, rate_hz: float, peak: float = 1.0) -> Sweep:
    """Make the sweeps before it, which are shorter."""
    main = make_main(rig, rate_hz=rate_hz, peak=peak)
    return replace(main, duration_s=max(main.duration_s / 2, 1.0), n_repeats=2)


def make_noise(sweep: Sweep) -> Samples:
    """Make noise in the band of a sweep, with the same peak, shape (n,), silent at its end as sweeps are."""
    n_pause, n = round(sweep.pause_s * sweep.rate_hz), _count_noise(sweep)
    rng = np.random.default_rng(1)
    spectrum = fft.rfft(rng.standard_normal(n - n_pause))
    grid_hz = fft.rfftfreq(n - n_pause, 1 / sweep.rate_hz)
    noise = fft.irfft(spectrum * find_inside(grid_hz, band_hz=sweep.ends_hz), n - n_pause)
    noise *= np.minimum(1, np.arange(len(noise)) / (0.05 * sweep.rate_hz))  # it ramps up
    noise *= np.minimum(1, np.arange(len(noise))[::-1] / (0.05 * sweep.rate_hz))
    noise = np.clip(noise / noise.std(), -CREST, CREST) * sweep.peak / CREST
    return np.concatenate([noise, np.zeros(n_pause)])


def _count_noise(sweep: Sweep) -> int:
    return round((sweep.duration_s + sweep.pause_s) * sweep.rate_hz)


def find_allowed(rig: Rig, actuator: ActuatorTable) -> float:
    """Find the largest peak of a sine, as a part of full scale, that the mixer lets pass."""
    limits = min(rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2)
    return min(1.0, MARGIN * limits / actuator.full_scale_m_s2)


def find_safe(rig: Rig, probe: Response) -> float:
    """Find the peak of a sweep, as a part of full scale, whose motion is within the limits and the sensor's scale."""
    # Ramps are part of a sweep, and a resonance may lie in one.
    ramp = find_ramp(probe.frequency_hz, band_hz=probe.band_hz)
    strongest = float((np.abs(probe.response) * ramp).max())
    limits = [rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2]
    if rig.sensor is not None:
        limits.append(rig.sensor.full_scale_m_s2)
    return MARGIN * min(limits) / strongest


# One coil: measured, its filter designed, and verified.


@dataclass(frozen=True, slots=True, kw_only=True)
class CoilRun:
    """What was measured of one coil: with a quiet, a middle and a loud sweep, with noise, and by repetition."""

    actuator: ActuatorTable
    main: Response
    ladder: Mapping[float, Response]
    noise: Response
    repeats_db: float

    @property
    def linearity_db(self) -> Samples:
        """How much the gain at each level differs from that at the lowest: the median over third octaves."""
        lowest = self.ladder[min(self.ladder)]
        return np.array([np.median(_compare_db(one, lowest)) for one in self.ladder.values()])


def measure_coil(bench: Bench, actuator: ActuatorTable) -> CoilRun:
    """Play sweeps of rising level, and noise, on one coil."""
    rig, rate_hz, channel = bench.rig, bench.rate_hz, actuator.channel
    level = rig.calibration.level * find_allowed(rig, actuator)

    def sweep(one: Sweep) -> tuple[Response, Samples]:
        recorded = bench.play_sweep(make_sweep(one), one, channel)
        return measure_sweep(one, recorded), recorded

    probe, _ = sweep(make_quiet(rig, rate_hz=rate_hz, peak=PROBE * level))
    _check_alive(probe, pause_s=rig.calibration.pause_s)
    top = min(level, find_safe(rig, probe))
    ladder = {
        share * top: sweep(make_quiet(rig, rate_hz=rate_hz, peak=share * top))[0]
        for share in LADDER
    }
    loud = make_main(rig, rate_hz=rate_hz, peak=top)
    main, recorded = sweep(loud)
    _check_ringing(recorded, period=loud.period, pause_s=loud.pause_s)
    # How much the level differs between equal sweeps: the median over third octaves.
    along = (main.direction @ recorded).reshape(loud.n_repeats, loud.period)
    frequency_hz = fft.rfftfreq(loud.period, 1 / rate_hz)
    energy = np.abs(fft.rfft(along)) ** 2
    levels_db = 10 * np.log10(average_thirds(energy, frequency_hz, band_hz=loud.band_hz))
    noise = make_noise(loud)
    measured = measure_response(
        noise,
        bench.play(noise, channel),
        rate_hz=rate_hz,
        band_hz=loud.band_hz,
        segment=len(noise) // 8,
    )
    return CoilRun(
        actuator=actuator,
        main=main,
        ladder=ladder | {top: main},
        noise=measured,
        repeats_db=float(np.median(levels_db.std(axis=0, ddof=1))),
    )


def design_coil(rig: Rig, run: CoilRun, *, noise_m_s2: float) -> CoilCertificate:
    """Make the filter of a coil, and what its certificate says of it without the filter."""
    main, settings, actuator = run.main, rig.calibration, run.actuator
    inverse = make_inverse(
        main,
        band_hz=settings.band_hz,
        max_gain_db=settings.max_gain_db,
        n_taps=round(TAPS_PERIODS / settings.band_hz[0] * main.rate_hz),
        phase=cast("Phase", settings.phase),
        min_coherence=settings.min_coherence,
    )
    inside = find_inside(main.frequency_hz, band_hz=main.band_hz)
    size, distortion = np.abs(main.response[inside]), main.distortion[inside]
    full_scale_m_s2 = float(np.median(size))
    before_db = main.find_deviation_db(target=full_scale_m_s2, band_hz=main.band_hz)
    # Harmonics over the band, relative to the sum of the fundamentals; both as energies.
    known = np.isfinite(distortion)
    harmonics = float(np.linalg.norm((size * distortion)[known]) / np.linalg.norm(size[known]))
    # A sensor with one axis does not see the direction, but its sign.
    typed = find_directions(rig)[0].get(actuator.name, np.eye(3)[0])
    is_seen = len(main.direction) == len(typed)
    low, high = main.band_hz
    grid_hz = np.arange(low / BELOW, high * ABOVE, STEP_HZ, dtype=np.float64)
    return CoilCertificate(
        name=actuator.name,
        channel=actuator.channel,
        full_scale_m_s2=full_scale_m_s2,
        target=inverse.target,
        latency=main.latency,
        delay=inverse.delay,
        gain_db=inverse.gain_db,
        before_db=float(np.abs(before_db).max()),
        least_coherence=float(main.coherence[inside].min()),
        crossed_db=main.cross_talk_db,
        noise_m_s2=noise_m_s2,
        total_distortion=harmonics,
        direction=main.direction if is_seen else np.sign(main.direction[0]) * typed,
        frequency_hz=grid_hz,
        response=_interpolate(grid_hz, main),
        coherence=np.interp(grid_hz, main.frequency_hz, main.coherence),
        distortion=np.interp(grid_hz, main.frequency_hz, main.distortion),
        equalised=np.full(len(grid_hz), np.nan, dtype=np.complex128),
        fir=inverse.fir,
        levels=np.array(list(run.ladder)),
        linearity_db=run.linearity_db,
    )


def verify_coil(bench: Bench, coil: CoilCertificate, run: CoilRun) -> CoilCertificate:
    """Play a sweep through the filter of a coil, as loud as its own, and compare the motion with the target."""
    rig, top = bench.rig, max(run.ladder)
    sweep = make_main(rig, rate_hz=bench.rate_hz, peak=top)
    asked = make_sweep(sweep)
    filtered = coil.equalise(asked)[: len(asked)]
    scale = min(top / np.abs(filtered).max(), MARGIN * rig.limits.peak_m_s2 / coil.target / top)
    recorded = bench.play_sweep(scale * filtered, sweep, coil.channel)
    after = measure_sweep(sweep, recorded, sent=scale * asked)
    band_hz = rig.calibration.band_hz
    off_db = after.find_deviation_db(target=coil.target, band_hz=band_hz)
    inside, worst = find_inside(after.frequency_hz, band_hz=band_hz), int(np.argmax(np.abs(off_db)))
    budget = _make_budget(rig, run, residual_db=float(np.sqrt(np.mean(off_db**2))))
    return replace(
        coil,
        largest_db=float(np.abs(off_db[worst])),
        worst_hz=float(after.frequency_hz[inside][worst]),
        least_coherence_after=float(after.coherence[inside].min()),
        equalised=_interpolate(coil.frequency_hz, after),
        budget=budget,
        uncertainty_db=math.hypot(*(term.db for term in budget)),
    )


def _make_budget(rig: Rig, run: CoilRun, *, residual_db: float) -> tuple[BudgetTerm, ...]:
    """Make the budget of a coil: standard uncertainties of its level in dB; bounds count as rectangular (GUM 4.3.7)."""
    main, settings = run.main, rig.calibration
    inside = find_inside(main.frequency_hz, band_hz=main.band_hz)
    coherence = np.clip(main.coherence[inside], 1e-6, 1)
    # Bendat and Piersol (2010), table 9.6: the random error of |H| from n segments.
    random = np.sqrt((1 - coherence) / (2 * settings.repeats * coherence))
    apart_db = float(np.sqrt(np.mean(_compare_db(run.noise, main) ** 2)))
    terms = {
        "repeatability": run.repeats_db,
        "noise": DB * float(np.median(random)),
        "linearity": float(np.abs(run.linearity_db).max()) / math.sqrt(3),
        "noise against sweep": apart_db / math.sqrt(3),
        "left after the filter": residual_db,
    }
    typed = BudgetTerm(name="sensor", db=settings.sensor_uncertainty_db, source=TYPED)
    return typed, *(BudgetTerm(name=name, db=db, source=MEASURED) for name, db in terms.items())


def measure_latencies(bench: Bench, coils: Mapping[str, CoilCertificate]) -> dict[str, int]:
    """Measure the latencies of all coils in one recording, one coil after another, in samples.

    A device that ran dry goes on with another latency, so those of different recordings cannot be compared.
    """
    quiet = make_quiet(bench.rig, rate_hz=bench.rate_hz)
    turn, n = quiet.period, quiet.period * quiet.n_repeats * len(coils)
    once = make_sweep(quiet)[:turn]
    places = {
        name: [turn * (number + k * len(coils)) for k in range(quiet.n_repeats)]
        for number, name in enumerate(coils)
    }
    sounds = {coil.channel: np.zeros(n) for coil in coils.values()}
    for name, coil in coils.items():
        for place in places[name]:
            sounds[coil.channel][place : place + turn] = float(coil.levels[1]) * once

    def cut(recorded: Samples, name: str) -> Samples:
        return np.concatenate([recorded[:, k : k + turn] for k in places[name]], axis=1)

    recorded = bench.insist(
        lambda: bench.play_all(sounds, n=n),
        lambda found: max(find_slip(cut(found, name), quiet) for name in coils),
    )
    return {
        name: measure_sweep(replace(quiet, peak=float(coil.levels[1])), cut(recorded, name)).latency
        for name, coil in coils.items()
    }


# What is wrong with a recording, and with a coil.


def _check_alive(probe: Response, *, pause_s: float) -> None:
    inside = find_inside(probe.frequency_hz, band_hz=probe.band_hz)
    coherence = float(np.median(probe.coherence[inside]))
    if coherence < ALIVE:
        raise ValueError(
            f"got no motion that follows the sweep (median coherence {coherence:.2f}), expected {ALIVE:g} or more; "
            "check coil, cable, amplifier, its channel in rig.toml, and the sensor"
        )
    if not 0 <= probe.latency / probe.rate_hz < pause_s:
        raise ValueError(
            f"pause_s under [calibration] must exceed the latency of {1e3 * probe.latency / probe.rate_hz:.0f} ms, got "
            f"{pause_s:g}; raise it"
        )


def _check_ringing(recorded: Samples, *, period: int, pause_s: float) -> None:
    """Refuse sweeps at the end of whose pauses the coil is not at rest: its noise there is more than at the rest."""
    sweeps = recorded.reshape(len(recorded), -1, period)
    sweeps = sweeps - sweeps.mean(axis=(1, 2), keepdims=True)
    mean = sweeps.mean(axis=1)  # what is not noise
    end = mean[:, -period // 50 :]
    left, noise = (float(np.sqrt(np.mean(one**2))) for one in (end, sweeps - mean[:, np.newaxis]))
    size = float(np.sqrt(np.mean(mean**2)))
    if left > RINGING * size + 3 * noise:
        raise ValueError(
            f"pause_s under [calibration] must exceed latency and ringing, got {pause_s:g} s, after which "
            f"{left / size:.0%} of the motion is left; raise it"
        )


def find_failures(rig: Rig, coil: CoilCertificate) -> Iterator[str]:
    """Find the limits of `[calibration]` that a coil does not keep."""
    own = rig.calibration
    worst = max(coil.budget, key=lambda term: term.db)
    typed = next(one.direction for one in rig.actuators if one.name == coil.name)
    cosine = float(coil.direction @ np.array(typed) / np.linalg.norm(typed)) if typed else 1.0
    turned_deg = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    for is_broken, told in (
        (
            coil.largest_db > own.max_deviation_db,
            f"is {coil.largest_db:.1f} dB off at {coil.worst_hz:.0f} Hz with its filter, the limit is "
            f"{own.max_deviation_db:g}; narrow band_hz or raise max_gain_db under [calibration]",
        ),
        (
            coil.uncertainty_db > own.max_uncertainty_db,
            f"is known to {coil.uncertainty_db:.2f} dB, the limit is {own.max_uncertainty_db:g}; its largest term is "
            f"{worst.name} ({worst.db:.2f} dB)",
        ),
        (
            coil.total_distortion > own.max_distortion,
            f"distorts by {coil.total_distortion:.0%}, the limit is {own.max_distortion:.0%}; lower level under "
            "[calibration], and the stimuli with it",
        ),
        (
            coil.least_coherence < own.min_coherence,
            f"has a coherence of {coil.least_coherence:.2f} at worst, the minimum is {own.min_coherence:g}; raise "
            "level, or narrow band_hz under [calibration]",
        ),
        (
            turned_deg > MOST_TURNED_DEG,
            f"moves {turned_deg:.0f}° from the direction in rig.toml; check its channel and polarity, or write "
            f"direction = {np.round(coil.direction, 2).tolist()}",
        ),
    ):
        if is_broken:
            yield f"coil {coil.name!r} {told}"


def _compare_db(one: Response, other: Response) -> Samples:
    """Compare the sizes of two responses: one over the other, in dB, in the third octaves of the band."""
    inside = find_inside(other.frequency_hz, band_hz=other.band_hz)
    at_hz = other.frequency_hz[inside]
    size = np.interp(at_hz, one.frequency_hz, np.abs(one.response))
    ratio_db = DB * np.log(size / np.abs(other.response[inside]))
    return average_thirds(ratio_db, at_hz, band_hz=other.band_hz)


def _interpolate(grid_hz: Samples, found: Response) -> Spectrum:
    return np.asarray(np.interp(grid_hz, found.frequency_hz, found.response), dtype=np.complex128)
