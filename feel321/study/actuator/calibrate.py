"""Calibration of a rig: sweeps on each coil, through the output that sessions use, recorded by its sensor.

What a quiet sweep shows decides how strong the next ones may be; the strongest one is the measurement. From it the
filters are designed, and verified by playing through them.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from datetime import datetime
from functools import partial
from typing import Any

import numpy as np
from scipy import fft

from feel321.arguments import follow
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.actuator import certificate as certificates
from feel321.study.actuator import response
from feel321.study.actuator import rig as rigs
from feel321.study.actuator.certificate import FOLDER, MEASURED, Certificate, CoilCertificate
from feel321.study.actuator.output import Bench, OnStep, open_bench
from feel321.study.actuator.render import find_directions, find_rig_problems
from feel321.study.actuator.response import Response, Sweep
from feel321.study.actuator.rig import ActuatorTable, Rig
from feel321.study.folder import OpenStudy, Outcome, StudyFolder, UsageError
from feel321.study.settings.read import read_settings
from feel321.study.terminal import ask, echo, format_facts, is_answerable
from feel321.types import Samples

PROBE = 0.1  # of the level that limits allow: the first sweep of a coil
LADDER = (0.125, 0.25, 0.5)  # of the loudest sweep, before it
MOST_TURNED_DEG = 30.0  # from the direction in rig.toml
SILENCE_S = 0.5
TAPS_PERIODS = 12.0  # of the band's lowest frequency: the length of a filter
STEP_HZ = 0.5  # of the frequencies in a certificate
MOST_GAIN_DB = 50.0  # of a filter that is proposed; beyond, the band is narrowed
LEAST_BAND = 0.8  # of the octaves that were asked, for a coil to pass
SPARE_DB = 1.0  # by which a proposed gain exceeds what the response asks for
Coils = Mapping[str, CoilCertificate]


def make_sweeps(rig: Rig, *, rate_hz: float, peak: float) -> tuple[Sweep, Sweep]:
    """Make the sweep that is the measurement, and the shorter one before it."""
    own, longest_s = rig.calibration, rigs.MARGIN * rig.limits.duration_s
    main = Sweep(
        rate_hz=rate_hz,
        band_hz=own.band_hz,
        duration_s=min(own.sweep_s, longest_s),
        pause_s=own.pause_s,
        n_repeats=own.repeats,
        peak=peak,
    )
    return main, replace(main, duration_s=max(main.duration_s / 2, 1.0), n_repeats=2)


@dataclass(frozen=True, slots=True, kw_only=True)
class CoilRun(Response):
    """What was measured of one coil; repeats_db: between equal sweeps; noise_m_s2: RMS while nothing plays."""

    levels: Samples
    linearity_db: Samples
    repeats_db: float
    noise_m_s2: float


def measure_coil(bench: Bench, actuator: ActuatorTable, *, noise_m_s2: float) -> CoilRun:
    """Play sweeps of rising level on one coil."""
    rig, rate_hz, levels = bench.rig, bench.rate_hz, (*LADDER, 1.0)
    level = rig.calibration.level * rigs.find_allowed(rig, actuator)

    def sweep(one: Sweep) -> tuple[Response, Samples]:
        recorded = bench.play_sweep(response.make_sweep(one), one, actuator.channel)
        return response.measure_sweep(one, recorded), recorded

    loud, quiet = make_sweeps(rig, rate_hz=rate_hz, peak=PROBE * level)
    probe, _ = sweep(quiet)
    top = min(level, _find_safe(rig, probe))
    loud, steps = replace(loud, peak=top), [replace(quiet, peak=one * top) for one in LADDER]
    ladder = [sweep(step)[0] for step in steps]
    main, recorded = sweep(loud)
    in_band_hz = probe.frequency_hz[probe.inside]
    linearity_db = []
    for one in (*ladder, main):  # by third octaves, over the quietest step
        size = np.interp(in_band_hz, one.frequency_hz, np.abs(one.response))
        ratio_db = response.DB * np.log(size / np.abs(ladder[0].response[probe.inside]))
        thirds_db = response.average_thirds(ratio_db, in_band_hz, band_hz=loud.band_hz)
        linearity_db.append(float(np.median(thirds_db)))
    along = (main.direction @ recorded).reshape(loud.n_repeats, loud.period)
    energy = np.abs(fft.rfft(along)) ** 2
    at_hz = fft.rfftfreq(loud.period, 1 / rate_hz)
    repeated_db = 10 * np.log10(response.average_thirds(energy, at_hz, band_hz=loud.band_hz))
    kept = main.frequency_hz <= response.ABOVE * loud.band_hz[1]
    names = ("frequency_hz", "response", "coherence", "distortion")
    return CoilRun(
        **asdict(main) | {name: getattr(main, name)[kept] for name in names},
        levels=top * np.array(levels),
        linearity_db=np.array(linearity_db),
        repeats_db=float(np.median(repeated_db.std(axis=0, ddof=1))),
        noise_m_s2=noise_m_s2,
    )


def _find_safe(rig: Rig, probe: Response) -> float:
    """Find the peak of a sweep, over full scale, that moves the coil within the limits and the sensor's scale."""
    coherence = float(np.median(probe.coherence[probe.inside]))
    latency_s = probe.latency / probe.rate_hz
    if coherence < response.ALIVE:
        raise ValueError(
            f"got no motion that follows the sweep (median coherence {coherence:.2f}), expected more; "
            "check coil, cable, amplifier, its channel in rig.toml, and the sensor"
        )
    if not 0 <= latency_s < rig.calibration.pause_s:
        raise ValueError(
            f"pause_s under [calibration] must exceed the latency of {1e3 * latency_s:.0f} ms, got "
            f"{rig.calibration.pause_s:g}; raise it"
        )
    low_hz, high_hz = probe.band_hz[0] / response.BELOW, probe.band_hz[1] * response.ABOVE
    log_hz = np.log(np.maximum(probe.frequency_hz, response.TINY))
    # A resonance may lie where the sweep rises to its peak, or falls.
    ramps = response.make_ramps(
        (log_hz - math.log(low_hz)) / math.log(response.BELOW),
        (math.log(high_hz) - log_hz) / math.log(response.ABOVE),
    )
    limits = (rig.limits.peak_m_s2, math.sqrt(2) * rig.limits.rms_m_s2)
    allowed = min(*limits, rigs.require_sensor(rig).full_scale_m_s2)
    return rigs.MARGIN * allowed / float((np.abs(probe.response) * ramps).max())


def propose_band(rig: Rig, seen: Response) -> tuple[response.Band, float]:
    """Propose the band of a coil and the gain of its filter in dB: as in rig.toml, or what coil and noise allow."""
    own, size = rig.calibration, np.abs(seen.response)
    if own.max_gain_db is not None:
        return own.band_hz, own.max_gain_db
    inside = response.find_inside(seen.frequency_hz, band_hz=own.band_hz)
    needed_db = response.DB * np.log(np.median(size[inside]) / np.maximum(size, 1e-12))
    is_good = inside & (seen.coherence >= own.min_coherence)
    is_good &= needed_db <= MOST_GAIN_DB - SPARE_DB
    if not is_good.any():
        return own.band_hz, MOST_GAIN_DB
    # The longest stretch without a frequency that would need too much, or that noise hides.
    edges = np.flatnonzero(np.diff(np.concatenate([[False], is_good, [False]])))
    ends_hz = seen.frequency_hz[edges.reshape(-1, 2) - [0, 1]]
    low, high = max(ends_hz, key=lambda one: float(one[1] / one[0]))
    first, last = seen.frequency_hz[inside][[0, -1]]
    low = own.band_hz[0] if low == first else float(low)
    high = own.band_hz[1] if high == last else float(high)
    size = size[response.find_inside(seen.frequency_hz, band_hz=(low, high))]
    most_db = response.DB * math.log(float(np.median(size) / size.min()))
    return (low, high), min(most_db + SPARE_DB, MOST_GAIN_DB)


def design_coil(rig: Rig, actuator: ActuatorTable, run: CoilRun) -> CoilCertificate:
    """Make the filter of a coil, and what its certificate says of it: by calculation, until it is verified."""
    own, (band_hz, gain_db) = rig.calibration, propose_band(rig, run)
    inverse = response.make_inverse(
        run,
        band_hz=band_hz,
        max_gain_db=gain_db,
        n_taps=round(TAPS_PERIODS / band_hz[0] * run.rate_hz),
        min_coherence=own.min_coherence,
    )
    inside = response.find_inside(run.frequency_hz, band_hz=band_hz)
    size, distortion = np.abs(run.response[inside]), run.distortion[inside]
    full_scale_m_s2 = float(np.median(size))
    before_db = run.find_deviation_db(target=full_scale_m_s2, band_hz=band_hz)
    known = np.isfinite(distortion)
    low, high = own.band_hz
    grid_hz = np.arange(low / response.BELOW, high * response.ABOVE, STEP_HZ, dtype=np.float64)
    coil = CoilCertificate(
        name=actuator.name,
        channel=actuator.channel,
        band_hz=band_hz,
        full_scale_m_s2=full_scale_m_s2,
        latency=run.latency,
        before_db=float(np.abs(before_db).max()),
        least_coherence=float(run.coherence[inside].min()),
        crossed_db=run.cross_talk_db,
        noise_m_s2=run.noise_m_s2,
        # Harmonics over the band, relative to the sum of the fundamentals; both as energies.
        total_distortion=float(
            np.linalg.norm((size * distortion)[known]) / np.linalg.norm(size[known])
        ),
        direction=run.direction,
        frequency_hz=grid_hz,
        response=np.interp(grid_hz, run.frequency_hz, run.response),
        coherence=np.interp(grid_hz, run.frequency_hz, run.coherence),
        distortion=np.interp(grid_hz, run.frequency_hz, run.distortion),
        equalised=np.full(len(grid_hz), np.nan, dtype=np.complex128),
        levels=run.levels,
        linearity_db=run.linearity_db,
        **asdict(inverse),
    )
    flat = run.response * coil.find_filter(run.frequency_hz, rate_hz=run.rate_hz)
    unknown = np.full_like(run.coherence, np.nan)
    after = replace(run, response=flat, coherence=unknown)
    return judge_filter(rig, coil, run=run, after=after)


def judge_filter(
    rig: Rig, coil: CoilCertificate, *, run: CoilRun, after: Response
) -> CoilCertificate:
    """Compare the response with a filter, measured or calculated, with its target; and add up the uncertainties."""
    off_db = after.find_deviation_db(target=coil.target, band_hz=coil.band_hz)
    inside = response.find_inside(after.frequency_hz, band_hz=coil.band_hz)
    worst, settings = int(np.argmax(np.abs(off_db))), rig.calibration
    own = run.coherence[response.find_inside(run.frequency_hz, band_hz=coil.band_hz)]
    coherence = np.clip(own, 1e-6, 1)
    # Bendat and Piersol (2010), table 9.6: the random error of |H| from n segments.
    random = np.sqrt((1 - coherence) / (2 * settings.repeats * coherence))
    # Standard uncertainties of the level in dB; bounds count as rectangular (GUM 4.3.7).
    budget = {
        "sensor, as typed": settings.sensor_uncertainty_db,
        "repeatability": run.repeats_db,
        "noise": response.DB * float(np.median(random)),
        "linearity": float(np.abs(run.linearity_db).max()) / math.sqrt(3),
        "left after the filter": float(np.sqrt(np.mean(off_db**2))),
    }
    return replace(
        coil,
        largest_db=float(np.abs(off_db[worst])),
        worst_hz=float(after.frequency_hz[inside][worst]),
        least_coherence_after=float(after.coherence[inside].min()),
        equalised=np.interp(coil.frequency_hz, after.frequency_hz, after.response),
        budget=budget,
        uncertainty_db=math.hypot(*budget.values()),
    )


def verify_coil(bench: Bench, coil: CoilCertificate, run: CoilRun) -> CoilCertificate:
    """Play a sweep through the filter of a coil, as loud as its own, and compare the motion with the target."""
    rig, top = bench.rig, float(run.levels[-1])
    sweep, _ = make_sweeps(rig, rate_hz=bench.rate_hz, peak=top)
    asked = response.make_sweep(sweep)
    filtered = coil.equalise(asked)[: len(asked)]
    most = rigs.MARGIN * rig.limits.peak_m_s2 / coil.target / top
    scale = min(top / np.abs(filtered).max(), most)
    recorded = bench.play_sweep(scale * filtered, sweep, coil.channel)
    after = response.measure_sweep(sweep, recorded, sent=scale * asked)
    return judge_filter(rig, coil, run=run, after=after)


def measure_latencies(bench: Bench, coils: Coils) -> dict[str, CoilCertificate]:
    """Measure the latencies of all coils in one recording: a device that ran dry goes on with another latency."""
    _, quiet = make_sweeps(bench.rig, rate_hz=bench.rate_hz, peak=1.0)
    turn, n_coils, once = quiet.period, len(coils), response.make_sweep(quiet)[: quiet.period]
    sounds = {}
    for number, coil in enumerate(coils.values()):  # one coil after another, again and again
        turns = np.zeros((quiet.n_repeats, n_coils, turn))
        turns[:, number] = float(coil.levels[1]) * once
        sounds[coil.channel] = turns.ravel()

    def cut(recorded: Samples) -> list[Samples]:
        turns = recorded.reshape(len(recorded), -1, n_coils, turn)
        return [turns[:, :, number].reshape(len(recorded), -1) for number in range(n_coils)]

    def find_slip(recorded: Samples) -> int:
        return max(response.find_slip(one, quiet) for one in cut(recorded))

    recorded = bench.insist(sounds, find_slip)
    found = {}
    for (name, coil), own in zip(coils.items(), cut(recorded), strict=True):
        sweep = replace(quiet, peak=float(coil.levels[1]))
        found[name] = replace(coil, latency=response.measure_sweep(sweep, own).latency)
    return found


def find_failures(rig: Rig, coil: CoilCertificate) -> Iterator[str]:
    """Find the limits of `[calibration]` that a coil does not keep."""
    own, (low, high) = rig.calibration, coil.band_hz
    worst = max(coil.budget, key=coil.budget.__getitem__)
    typed = next(one.direction for one in rig.actuators if one.name == coil.name)
    cosine = float(coil.direction @ np.array(typed) / np.linalg.norm(typed)) if typed else 1.0
    turned_deg = math.degrees(math.acos(min(max(cosine, -1.0), 1.0)))
    octaves, asked = math.log(high / low), math.log(own.band_hz[1] / own.band_hz[0])
    broken = {
        f"is {coil.largest_db:.1f} dB off at {coil.worst_hz:.0f} Hz with its filter, the limit is "
        f"{own.max_deviation_db:g}; narrow band_hz or raise max_gain_db under [calibration]": (
            coil.largest_db > own.max_deviation_db
        ),
        f"is known to {coil.uncertainty_db:.2f} dB, the limit is {own.max_uncertainty_db:g}; its largest term is "
        f"{worst} ({coil.budget[worst]:.2f} dB)": coil.uncertainty_db > own.max_uncertainty_db,
        f"distorts by {coil.total_distortion:.0%}, the limit is {own.max_distortion:.0%}; lower level under "
        "[calibration], and the stimuli with it": coil.total_distortion > own.max_distortion,
        f"has a coherence of {coil.least_coherence:.2f} at worst, the minimum is {own.min_coherence:g}; raise level, "
        "or narrow band_hz under [calibration]": coil.least_coherence < own.min_coherence,
        f"is flat from {low:.0f} to {high:.0f} Hz only, asked was {own.band_hz[0]:g} to {own.band_hz[1]:g}; raise "
        "level, or narrow band_hz under [calibration]": octaves < LEAST_BAND * asked,
        f"moves {turned_deg:.0f}° from the direction in rig.toml; check its channel and polarity, or write "
        f"direction = {np.round(coil.direction, 2).tolist()}": turned_deg > MOST_TURNED_DEG,
    }
    yield from (f"coil {coil.name!r} {told}" for told, is_broken in broken.items() if is_broken)


def calibrate(
    rig: Rig,
    *,
    rate_hz: float,
    made: datetime,
    agree: Callable[[Certificate], bool] = lambda _: True,
    on_step: OnStep = lambda _done, _total: None,
) -> Certificate:
    """Measure the coils of a rig, make their filters, and verify them by playing through them.

    agree: shows what is proposed, and asks for consent.
    """

    def certify(coils: Coils) -> Certificate:
        own: dict[str, Any] = {"method": MEASURED, "made": made, "rate_hz": rate_hz}
        failures = (line for coil in coils.values() for line in find_failures(rig, coil))
        found = certificates.begin_certificate(rig, coils, **own)
        return replace(found, failures=tuple(failures))

    rigs.require_sensor(rig)
    main, quiet = make_sweeps(rig, rate_hz=rate_hz, peak=1.0)
    n_main, n_quiet = main.period * main.n_repeats, quiet.period * quiet.n_repeats
    n_coils, n_silent = len(rig.actuators), round(SILENCE_S * rate_hz)
    n_all = n_coils * (2 * n_main + (2 + len(LADDER)) * n_quiet) + n_silent
    show: dict[str, Any] = {"total_s": n_all / rate_hz, "on_step": on_step}
    n_longest = max(n_main, n_coils * n_quiet)
    with open_bench(rig, rate_hz=rate_hz, n_longest=n_longest, **show) as bench:
        noise_m_s2 = float(np.linalg.norm(bench.play({}, n=n_silent).std(axis=1)))
        runs, coils = dict[str, CoilRun](), dict[str, CoilCertificate]()
        for one in rig.actuators:
            with _named(one.name):
                runs[one.name] = measure_coil(bench, one, noise_m_s2=noise_m_s2)
                coils[one.name] = design_coil(rig, one, runs[one.name])
        if not agree(certify(coils)):
            raise KeyboardInterrupt
        for name, coil in coils.items():
            with _named(name):
                coils[name] = verify_coil(bench, coil, runs[name])
        return certify(measure_latencies(bench, coils))


@contextmanager
def _named(coil: str) -> Iterator[None]:
    """Say of which coil an error is."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"coil {coil!r}: {error}") from None


# The verb.

ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""


def calibrate_rig(lab: OpenStudy, *, device: str | None, manual: Sequence[str]) -> Outcome:
    """Measure the coils, or take typed gains, and store a certificate."""
    folder = lab.folder
    rig, own = rigs.read_rig(folder.rig), folder.settings
    rate_hz = read_settings(own).rig.rate_hz if own.is_file() else rigs.RATE_HZ
    rig = rigs.take_device(rig, device) if device else rig
    when: dict[str, Any] = {"made": lab.now(), "rate_hz": rate_hz}
    if manual:
        typed, (directions, _) = dict(map(_read_gain, manual)), find_directions(rig)
        made = certificates.make_manual(rig, typed, directions=directions, **when)
    elif rig.device.name == rigs.FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    else:
        with follow(lab.progress, "s of sweeps") as step:
            made = calibrate(rig, agree=partial(agree, folder, rig), on_step=step, **when)
    certificate = certificates.write_certificate(made, folder.path)
    certificates.draw_certificate(certificate, folder.path / FOLDER / certificate.id)
    passed = not certificate.failures
    facts = asdict(certificate) | {"passed": passed}
    for coil in facts["coils"].values():
        for name in ARRAYS & coil.keys():
            del coil[name]
    for failure in certificate.failures:
        lab.say(failure)
    verdict, until = "passed" if passed else "did not pass", certificate.expires_utc[:10]
    line = f"certificate {certificate.id} ({certificate.method}): {verdict}; valid until {until}"
    return Outcome(facts, [line, *format_facts(facts["coils"])], failed=not passed)


def _read_gain(text: str) -> tuple[str, float]:
    name, _, gain = text.rpartition("=")
    try:
        return name.strip(), float(gain)
    except ValueError:
        example = "'left coil=12.5'"
        raise UsageError(f"--manual must be NAME=GAIN, such as {example}, got {text!r}") from None


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
    asked = "Enter takes it; n stops, to calibrate again with another max_gain_db of [calibration]."
    return not ask(asked).startswith("n")


def _find_cost(folder: StudyFolder, rig: Rig, proposed: Certificate) -> Iterator[str]:
    """Say how much of full scale the study's stimuli take through the filters, and how weak the weakest then is."""
    if not (folder.stimuli.is_dir() and folder.settings.is_file()):
        yield "the study has no stimuli yet; once they are built, feel321 check says which are too strong"
        return
    try:
        stimuli, settings = read_stimuli(folder.stimuli), read_settings(folder.settings)
        problems, sounds = find_rig_problems(rig, stimuli, settings, certificate=proposed)
    except (OSError, ValueError) as error:  # minutes of sweeps are not lost for it
        problems, sounds = str(error).splitlines(), {}
    if not sounds:
        yield f"how strong the stimuli come is not known: {problems[0]}"
        return
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
