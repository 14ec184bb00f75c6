"""Calibration of a rig: sweeps and noise on each coil, through the stream that sessions use, recorded by its sensor.

Each coil begins with a quiet sweep. What it makes of that decides how loud the next ones may be, so that neither the
rig's limits nor the sensor's full scale is passed; then levels rise, and the loudest sweep is the measurement.
"""

import math
import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from time import perf_counter, sleep
from typing import cast

import numpy as np
from scipy import fft

from feel321.stimuli.wav import read_wav
from feel321.study.actuator import calibration
from feel321.study.actuator.calibration import Response, Sweep
from feel321.study.actuator.certificate import (
    MEASURED,
    TYPED,
    BudgetTerm,
    Certificate,
    CoilCertificate,
    begin_certificate,
)
from feel321.study.actuator.mixer import Frames
from feel321.study.actuator.output import StreamOutput, open_stream
from feel321.study.actuator.rig import STANDARD_GRAVITY, ActuatorTable, Rig, SensorTable
from feel321.types import Samples

OnStep = Callable[[int, int], None]

PROBE = 0.1  # of the level that limits allow: the first sweep of a coil
LADDER = (0.125, 0.25, 0.5)  # of the loudest sweep, before it
MARGIN = 0.9  # of limits and of the sensor's full scale, for what is foreseen
CLIPPED = 0.999  # of the sensor's full scale
N_TRIES = 4  # of a playback in which the device ran dry
ALIVE = 0.8  # least median coherence of a coil that moves at all; of two sweeps of noise it is 0.5
RINGING = 0.01  # of the RMS of a sweep: what may be left at the end of its pause
CREST = 4.0  # peak of the noise over its RMS
MOST_TURNED_DEG = 30.0  # from the direction in rig.toml
SILENCE_S = 0.5
SLIGHT = 0.001  # of the sensor's full scale: less is no gravity
STEP_HZ = 0.5  # of the frequencies in a certificate
DB = 20 / math.log(10)


class SweepStopped(Exception):  # noqa: N818 - nothing went wrong
    """A key was pressed; the coils are silent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What all coils of a calibration share; sounds: of the open output, to which more are added."""

    rig: Rig
    rate_hz: float
    output: StreamOutput
    sounds: dict[str, Frames]
    folder: Path
    advance: Callable[[float], None]
    is_stopping: Callable[[], bool]

    def play(self, samples: Samples, channel: int) -> Samples:
        """Play samples, shape (n,), on a channel, and return what the sensor measured, shape (axes, n) in m/s²."""
        sound = np.zeros((len(samples), self.rig.n_channels), dtype=np.float32)
        sound[:, channel - 1] = samples
        self.sounds[""] = sound
        for _ in range(N_TRIES):
            if (recorded := self._play_once(len(samples))) is not None:
                self.advance(len(samples) / self.rate_hz)
                return recorded
        raise OSError(
            f"device {self.rig.device.name!r} ran dry {N_TRIES} times in a row; close other programs, or raise "
            "latency_s in rig.toml"
        )

    def _play_once(self, n: int) -> Samples | None:
        """Return what was recorded, or None if the device ran dry meanwhile."""
        self.output.start("", gap_s=0.05)
        while self.output.is_playing:
            if self.is_stopping():
                self.output.stop()
                raise SweepStopped
            sleep(0.002)
        playback = self.output.collect()
        if playback.error or "file_number" not in playback.measured:
            raise OSError(playback.error or "the sensor's input gave no samples; check its device")
        if playback.underruns or playback.measured["sensor_gaps"] or not playback.completed:
            return None
        path = self.folder / f"{round(playback.measured['file_number']):04}.wav"
        recorded = np.atleast_2d(read_wav(path)[0])[:, :n]
        path.unlink()
        return self._check(recorded, n=n, clipped=playback.clipped)

    def _check(self, recorded: Samples, *, n: int, clipped: int) -> Samples:
        if clipped:
            raise ValueError(
                f"the rig's limits cut {clipped} samples; lower level under [calibration], or sweep_s below duration_s"
            )
        if recorded.shape[1] < n:
            raise OSError(
                f"the sensor's input gave {recorded.shape[1]} samples of {n}; check its device"
            )
        full_scale = self.rig.sensor.full_scale_m_s2 if self.rig.sensor else math.inf
        if np.abs(recorded).max() >= CLIPPED * full_scale:
            raise ValueError(
                f"the sensor's input is clipped (full scale is {full_scale:g} m/s²); lower its gain and raise "
                "full_scale_m_s2 under [sensor] with it, or lower level under [calibration]"
            )
        return recorded


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
    coils = {}
    with _open_session(rig, rate_hz=rate_hz, on_step=on_step, is_stopping=is_stopping) as session:
        noise_m_s2 = _measure_silence(session)
        for actuator in rig.actuators:
            try:
                run = _measure_coil(session, actuator)
                coil = _make_coil(rig, run, noise_m_s2=noise_m_s2)
                coils[actuator.name] = _verify_coil(session, coil, run)
            except ValueError as error:
                raise ValueError(f"coil {actuator.name!r}: {error}") from None
    coils = {name: replace(coil, onto_db=_find_onto(coil, coils)) for name, coil in coils.items()}
    certificate = begin_certificate(rig, coils, method=MEASURED, made=made, rate_hz=rate_hz)
    failures = [line for coil in coils.values() for line in find_failures(rig, coil)]
    return replace(certificate, failures=tuple(failures))


def require_sensor(rig: Rig) -> SensorTable:
    """Find the rig's sensor, or refuse a rig without."""
    if rig.sensor is None:
        raise ValueError(
            "rig.toml has no [sensor], which calibrate needs; add one, or type gains: feel321 calibrate --manual "
            "'NAME=GAIN' (m/s² at full scale)"
        )
    return rig.sensor


@contextmanager
def _open_session(
    rig: Rig, *, rate_hz: float, on_step: OnStep | None, is_stopping: Callable[[], bool]
) -> Iterator[Session]:
    """Open the stream; the longest sound is there from the start, because it decides how much can be recorded."""
    main = make_main(rig, rate_hz=rate_hz, peak=1.0)
    quiet = make_quiet(rig, rate_hz=rate_hz, peak=1.0)
    per_coil = (2 * main.period * main.n_repeats + _count_noise(main)) + (
        (1 + len(LADDER)) * quiet.period * quiet.n_repeats
    )
    total_s, done_s = SILENCE_S + len(rig.actuators) * per_coil / rate_hz, 0.0

    def advance(seconds: float) -> None:
        nonlocal done_s
        done_s += seconds
        if on_step is not None:
            on_step(round(done_s), max(round(total_s), round(done_s)))

    longest = max(main.period * main.n_repeats, _count_noise(main))
    sounds: dict[str, Frames] = {"": np.zeros((longest, rig.n_channels), dtype=np.float32)}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        with open_stream(rig, sounds, rate_hz=rate_hz, folder=folder, clock=perf_counter) as output:
            yield Session(
                rig=rig,
                rate_hz=rate_hz,
                output=output,
                sounds=sounds,
                folder=folder,
                advance=advance,
                is_stopping=is_stopping,
            )


def measure_rest(rig: Rig, *, rate_hz: float) -> Samples:
    """Measure the mean of each axis of the sensor while nothing plays, shape (axes,) in m/s²."""
    with _open_session(rig, rate_hz=rate_hz, on_step=None, is_stopping=lambda: False) as session:
        n = round(SILENCE_S * rate_hz)
        rest: Samples = session.play(np.zeros(n), rig.actuators[0].channel).mean(axis=1)
        return rest


def scale_by_flip(up: Samples, down: Samples, *, full_scale_m_s2: float) -> float:
    """Find a sensor's full scale in m/s² from its rest with an axis up and down, shape (axes,) each.

    Gravity is once with the axis and once against it: half of the difference is 1 g, whatever the offset.
    """
    half = float(np.abs(up - down).max()) / 2
    if half < SLIGHT * full_scale_m_s2:
        raise ValueError(
            f"got a difference of {2 * half:.3g} m/s², expected about {2 * STANDARD_GRAVITY:.3g}; the sensor or its "
            "input does not pass gravity (AC-coupled): take the scale from its data sheet"
        )
    return full_scale_m_s2 * STANDARD_GRAVITY / half


def make_main(rig: Rig, *, rate_hz: float, peak: float) -> Sweep:
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


def make_quiet(rig: Rig, *, rate_hz: float, peak: float) -> Sweep:
    """Make the sweeps before it, which are shorter."""
    main = make_main(rig, rate_hz=rate_hz, peak=peak)
    return replace(main, duration_s=max(main.duration_s / 2, 1.0), n_repeats=2)


def find_allowed(rig: Rig, actuator: ActuatorTable) -> float:
    """Find the largest peak of a sine, as a part of full scale, that the mixer lets pass."""
    limits = min(rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2)
    return min(1.0, MARGIN * limits / actuator.full_scale_m_s2)


def _measure_silence(session: Session) -> float:
    """Measure the noise of the sensor, RMS in m/s² over all axes, while nothing plays."""
    n = round(SILENCE_S * session.rate_hz)
    recorded = session.play(np.zeros(n), session.rig.actuators[0].channel)
    return float(np.linalg.norm(recorded.std(axis=1)))


def _measure_coil(session: Session, actuator: ActuatorTable) -> CoilRun:
    rig, rate_hz = session.rig, session.rate_hz
    level = rig.calibration.level * find_allowed(rig, actuator)

    def sweep(one: Sweep) -> tuple[Response, Samples]:
        recorded = session.play(calibration.make_sweep(one), actuator.channel)
        return calibration.measure_sweep(one, recorded), recorded

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
    noise = make_noise(loud)
    return CoilRun(
        actuator=actuator,
        main=main,
        ladder=ladder | {top: main},
        noise=calibration.measure_response(
            noise,
            session.play(noise, actuator.channel),
            rate_hz=rate_hz,
            band_hz=loud.band_hz,
            segment=len(noise) // 8,
        ),
        repeats_db=_measure_repeats(loud, recorded, main),
    )


def find_safe(rig: Rig, probe: Response) -> float:
    """Find the peak of a sweep, as a part of full scale, whose motion is within the limits and the sensor's scale."""
    inside = calibration.find_inside(probe.frequency_hz, band_hz=probe.band_hz)
    strongest = float(np.abs(probe.response[inside]).max())
    limits = [rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2]
    if rig.sensor is not None:
        limits.append(rig.sensor.full_scale_m_s2)
    return MARGIN * min(limits) / strongest


def _check_alive(probe: Response, *, pause_s: float) -> None:
    inside = calibration.find_inside(probe.frequency_hz, band_hz=probe.band_hz)
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


def _measure_repeats(sweep: Sweep, recorded: Samples, main: Response) -> float:
    """Find how much the level differs between equal sweeps: standard deviation in dB, the median over third octaves."""
    along = (main.direction @ recorded).reshape(sweep.n_repeats, sweep.period)
    frequency_hz = fft.rfftfreq(sweep.period, 1 / sweep.rate_hz)
    energy = np.abs(fft.rfft(along)) ** 2
    levels = 10 * np.log10(_average_thirds(energy, frequency_hz, band_hz=sweep.band_hz))
    return float(np.median(levels.std(axis=0, ddof=1)))


def _average_thirds(
    values: Samples, frequency_hz: Samples, *, band_hz: calibration.Band
) -> Samples:
    """Average values, shape (..., k), in third octaves of a band; empty ones are left out."""
    low, high = band_hz
    n_bands = max(round(3 * math.log2(high / low)), 1)
    number = np.floor(n_bands * np.log(np.maximum(frequency_hz, 1e-9) / low) / math.log(high / low))
    found = [values[..., number == band] for band in range(n_bands)]
    return np.stack([one.mean(axis=-1) for one in found if one.shape[-1]], axis=-1)


def _compare_db(one: Response, other: Response) -> Samples:
    """Compare the sizes of two responses: one over the other, in dB, in the third octaves of the band."""
    band_hz = other.band_hz
    inside = calibration.find_inside(other.frequency_hz, band_hz=band_hz)
    at_hz = other.frequency_hz[inside]
    size = np.interp(at_hz, one.frequency_hz, np.abs(one.response))
    return _average_thirds(
        DB * np.log(size / np.abs(other.response[inside])), at_hz, band_hz=band_hz
    )


def make_noise(sweep: Sweep) -> Samples:
    """Make noise in the band of a sweep, with the same peak, shape (n,), silent at its end as sweeps are."""
    n_pause, n = round(sweep.pause_s * sweep.rate_hz), _count_noise(sweep)
    rng = np.random.default_rng(1)
    spectrum = fft.rfft(rng.standard_normal(n - n_pause))
    inside = calibration.find_inside(
        fft.rfftfreq(n - n_pause, 1 / sweep.rate_hz), band_hz=sweep.ends_hz
    )
    noise = fft.irfft(spectrum * inside, n - n_pause)
    noise *= np.minimum(1, np.arange(len(noise)) / (0.05 * sweep.rate_hz))  # it ramps up
    noise *= np.minimum(1, np.arange(len(noise))[::-1] / (0.05 * sweep.rate_hz))
    noise = np.clip(noise / noise.std(), -CREST, CREST) * sweep.peak / CREST
    return np.concatenate([noise, np.zeros(n_pause)])


def _count_noise(sweep: Sweep) -> int:
    return round((sweep.duration_s + sweep.pause_s) * sweep.rate_hz)


def _make_coil(rig: Rig, run: CoilRun, *, noise_m_s2: float) -> CoilCertificate:
    main, settings, actuator = run.main, rig.calibration, run.actuator
    inverse = calibration.make_inverse(
        main,
        band_hz=settings.band_hz,
        max_gain_db=settings.max_gain_db,
        n_taps=round(main.rate_hz),
        phase=cast("calibration.Phase", settings.phase),
        min_coherence=settings.min_coherence,
    )
    inside = calibration.find_inside(main.frequency_hz, band_hz=main.band_hz)
    low, high = main.band_hz
    ends_hz = low / calibration.BELOW, high * calibration.ABOVE
    grid_hz = np.arange(*ends_hz, STEP_HZ, dtype=np.float64)
    full_scale_m_s2 = float(np.median(np.abs(main.response[inside])))
    before = calibration.verify(main, target=full_scale_m_s2, band_hz=main.band_hz)
    return CoilCertificate(
        name=actuator.name,
        channel=actuator.channel,
        full_scale_m_s2=full_scale_m_s2,
        target=inverse.target,
        latency=main.latency,
        delay=inverse.delay,
        gain_db=inverse.gain_db,
        before_db=before.largest_db,
        least_coherence=before.least_coherence,
        crossed_db=main.cross_talk_db,
        noise_m_s2=noise_m_s2,
        total_distortion=_sum_distortion(main),
        direction=_find_direction(actuator, main),
        frequency_hz=grid_hz,
        response=_interpolate(grid_hz, main),
        coherence=np.interp(grid_hz, main.frequency_hz, main.coherence),
        distortion=np.interp(grid_hz, main.frequency_hz, main.distortion),
        equalised=np.full(len(grid_hz), np.nan, dtype=np.complex128),
        fir=inverse.fir,
        levels=np.array(list(run.ladder)),
        linearity_db=run.linearity_db,
    )


def _interpolate(grid_hz: Samples, found: Response) -> calibration.Spectrum:
    return np.asarray(np.interp(grid_hz, found.frequency_hz, found.response), dtype=np.complex128)


def _find_direction(actuator: ActuatorTable, main: Response) -> Samples:
    """Find the direction of a coil, shape (3,): as measured; of a sensor with one axis, rig.toml's with its sign."""
    if len(main.direction) == len(np.eye(3)):
        return main.direction
    typed = np.array(actuator.direction or (1.0, 0.0, 0.0))
    direction: Samples = np.sign(main.direction[0]) * typed / np.linalg.norm(typed)
    return direction


def _sum_distortion(main: Response) -> float:
    """Sum harmonics over the band, relative to the sum of the fundamentals; both as energies."""
    inside = calibration.find_inside(main.frequency_hz, band_hz=main.band_hz)
    size, share = np.abs(main.response[inside]), main.distortion[inside]
    known = np.isfinite(share)
    return float(np.linalg.norm((size * share)[known]) / np.linalg.norm(size[known]))


def _verify_coil(session: Session, coil: CoilCertificate, run: CoilRun) -> CoilCertificate:
    """Play a sweep through the filter of a coil, as loud as its own, and compare the motion with the target."""
    rig, top = session.rig, max(run.ladder)
    sweep = make_main(rig, rate_hz=session.rate_hz, peak=top)
    asked = calibration.make_sweep(sweep)
    filtered = coil.equalise(asked)[: len(asked)]
    scale = min(top / np.abs(filtered).max(), MARGIN * rig.limits.peak_m_s2 / coil.target / top)
    recorded = session.play(scale * filtered, coil.channel)
    after = calibration.measure_sweep(sweep, recorded, sent=scale * asked)
    found = calibration.verify(after, target=coil.target, band_hz=rig.calibration.band_hz)
    budget = _make_budget(rig, run, residual_db=float(np.sqrt(np.mean(found.deviation_db**2))))
    return replace(
        coil,
        largest_db=found.largest_db,
        worst_hz=float(found.frequency_hz[int(np.argmax(np.abs(found.deviation_db)))]),
        least_coherence_after=found.least_coherence,
        equalised=_interpolate(coil.frequency_hz, after),
        budget=budget,
        uncertainty_db=math.hypot(*(term.db for term in budget)),
    )


def _make_budget(rig: Rig, run: CoilRun, *, residual_db: float) -> tuple[BudgetTerm, ...]:
    """Make the budget of a coil: standard uncertainties of its level in dB; bounds count as rectangular (GUM 4.3.7)."""
    main = run.main
    inside = calibration.find_inside(main.frequency_hz, band_hz=main.band_hz)
    coherence = np.clip(main.coherence[inside], 1e-6, 1)
    # Bendat and Piersol (2010), table 9.6: the random error of |H| from n segments.
    n_repeats = rig.calibration.repeats
    random = np.sqrt((1 - coherence) / (2 * n_repeats * coherence))
    apart_db = float(np.sqrt(np.mean(_compare_db(run.noise, main) ** 2)))
    terms = {
        "repeatability": run.repeats_db,
        "noise": DB * float(np.median(random)),
        "linearity": float(np.abs(run.linearity_db).max()) / math.sqrt(3),
        "noise against sweep": apart_db / math.sqrt(3),
        "left after the filter": residual_db,
    }
    typed = BudgetTerm(name="sensor", db=rig.calibration.sensor_uncertainty_db, source=TYPED)
    return typed, *(BudgetTerm(name=name, db=db, source=MEASURED) for name, db in terms.items())


def _find_onto(coil: CoilCertificate, coils: Mapping[str, CoilCertificate]) -> dict[str, float]:
    """Find how much of a coil's motion goes along the directions of the others, in dB of its own."""
    shares = {
        other.name: abs(float(coil.direction @ other.direction))
        for other in coils.values()
        if other.name != coil.name
    }
    return {name: DB * math.log(max(share, 1e-6)) for name, share in shares.items()}


def find_failures(rig: Rig, coil: CoilCertificate) -> Iterator[str]:
    """Find the limits of `[calibration]` that a coil does not keep."""
    settings, name = rig.calibration, f"coil {coil.name!r}"
    if coil.largest_db > settings.max_deviation_db:
        yield (
            f"{name} is {coil.largest_db:.1f} dB off at {coil.worst_hz:.0f} Hz with its filter, allowed are "
            f"{settings.max_deviation_db:g}; narrow band_hz or raise max_gain_db under [calibration]"
        )
    if coil.uncertainty_db > settings.max_uncertainty_db:
        worst = max(coil.budget, key=lambda term: term.db)
        yield (
            f"{name} is known to {coil.uncertainty_db:.2f} dB, allowed are {settings.max_uncertainty_db:g}; its "
            f"largest term is {worst.name} ({worst.db:.2f} dB)"
        )
    if coil.total_distortion > settings.max_distortion:
        yield (
            f"{name} distorts by {coil.total_distortion:.0%}, allowed are {settings.max_distortion:.0%}; lower level "
            "under [calibration], and the stimuli with it"
        )
    if coil.least_coherence < settings.min_coherence:
        yield (
            f"{name} has a coherence of {coil.least_coherence:.2f} at worst, needed is {settings.min_coherence:g}; "
            "raise level, or narrow band_hz under [calibration]"
        )
    typed = next(one.direction for one in rig.actuators if one.name == coil.name)
    cosine = float(coil.direction @ np.array(typed) / np.linalg.norm(typed)) if typed else 1.0
    turned_deg = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    if turned_deg > MOST_TURNED_DEG:
        yield (
            f"{name} moves {turned_deg:.0f}° from the direction in rig.toml; check its channel and polarity, or write "
            f"direction = {np.round(coil.direction, 2).tolist()}"
        )
