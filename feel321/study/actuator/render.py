"""From a stimulus's file to the samples of the rig's channels, and checks of their size.

Coils that move in the same direction add their amplitudes, coils at right angles their energies: a one-axis stimulus
reaches the hand as the vector sum of the coils' directions, each times its weight. The default weights make that sum 1,
so that a stimulus of 1 m/s² reaches the hand as 1 m/s². A rig that gives no directions plays everything at weight 1.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from feel321.arguments import check_finite
from feel321.protocols.threshold import ThresholdBlock, name_tone
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.stimuli.wav import read_wav
from feel321.study.actuator.certificate import Certificate
from feel321.study.actuator.mixer import ROUNDING, WINDOW_S, Frames
from feel321.study.actuator.rig import AXES, REDUCED, Rig
from feel321.types import Samples as Vector

if TYPE_CHECKING:
    from feel321.study.settings.schema import Settings

Mix = Mapping[str, Mapping[str, float]]
Levels = NDArray[np.floating[Any]]

EQUAL_DB = 0.5  # energies that differ by less count as equal
CANCELLED = 0.05  # motions that sum to less than this share of one coil's cancel each other


def find_mix(rig: Rig) -> dict[str, dict[str, float]]:
    """Find each actuator's factor on each of its sources: name -> `reduced`, `x`, `y`, `z` -> factor."""
    directions, _ = find_directions(rig)
    shares = dict.fromkeys((REDUCED, *AXES), 1.0)
    for source in shares if all(one.direction is not None for one in rig.actuators) else ():
        names = [one.name for one in rig.actuators if source in one.plays]
        length = float(np.linalg.norm(np.sum([directions[name] for name in names], axis=0)))
        if names and length < CANCELLED:
            raise ValueError(
                f"rig.toml: {' and '.join(map(repr, names))} play {source!r} in opposite directions and cancel each "
                "other; turn one direction round, or let only one of them play it"
            )
        shares[source] = 1 / length if names else 1.0
    mix = {one.name: {source: shares[source] for source in one.plays} for one in rig.actuators}
    for actuator in rig.actuators:
        if actuator.weight is not None and REDUCED in actuator.plays:
            mix[actuator.name][REDUCED] = actuator.weight
    return mix


def find_directions(rig: Rig) -> tuple[dict[str, Vector], list[str]]:
    """Find in which direction each coil moves the hand, a unit vector, and for which coils that is not known."""
    known: dict[str, Vector] = {}
    for actuator in rig.actuators:
        axes = [axis for axis in AXES if axis in actuator.plays]
        if actuator.direction is not None:
            direction = np.array(actuator.direction)
            known[actuator.name] = np.asarray(direction / np.linalg.norm(direction))
        elif len(axes) == 1:
            known[actuator.name] = np.eye(3)[AXES.index(axes[0])]
    return known, [one.name for one in rig.actuators if one.name not in known]


def sum_motion(mix: Mix, directions: Mapping[str, Vector], sources: Sequence[str]) -> Vector:
    """Sum how the coils move the hand by each source, shape (3, sources)."""
    motion = np.zeros((len(AXES), len(sources)))
    for name, direction in directions.items():
        motion += np.outer(direction, [mix[name].get(source, 0.0) for source in sources])
    return motion


def find_energy(
    mix: Mix, directions: Mapping[str, Vector], covariance: Vector | None = None
) -> float:
    """Mean square at the hand of a one-axis stimulus of mean square 1; or of three axes, relative to theirs."""
    sources = (REDUCED,) if covariance is None else AXES
    covariance = np.eye(1) if covariance is None else covariance
    covariance = covariance if np.trace(covariance) > 0 else np.eye(3)  # of silence, any will do
    motion = sum_motion(mix, directions, sources)
    return float(np.trace(motion @ covariance @ motion.T) / np.trace(covariance))


def render_stimulus(
    stimulus: Stimulus,
    folder: Path,
    rig: Rig,
    *,
    full_scale_m_s2: float,
    certificate: Certificate | None = None,
) -> Frames:
    """Render one stimulus for a rig, as samples of shape (n_samples, channels), by a certificate with its filters."""
    samples, rate_hz = read_wav(folder / stimulus.file)
    tracks, mix = np.atleast_2d(samples), find_mix(rig)
    if tracks.shape[1] != stimulus.n_samples or rate_hz != stimulus.rate_hz:
        raise ValueError(
            f"{stimulus.file}: got {tracks.shape[1]} samples at {rate_hz} Hz, the manifest says {stimulus.n_samples} "
            f"at {stimulus.rate_hz:g}; build the set again"
        )
    if len(tracks) not in {1, len(AXES)}:
        got = len(tracks)
        raise ValueError(f"{stimulus.file}: must have 1 or 3 channels, got {got}; build it again")
    check_finite(tracks, stimulus.file)
    own = dict(zip((REDUCED,) if len(tracks) == 1 else AXES, tracks, strict=True))
    if missing := set(own).difference(*mix.values()):
        raise ValueError(
            f"{stimulus.stimulus_id}: no actuator plays {', '.join(sorted(missing))}; add it to `plays` in rig.toml, "
            "or name a reference in study.toml that the rig can play"
        )
    asked_m_s2 = {}
    for name, factors in mix.items():
        moved = np.zeros(stimulus.n_samples)
        for source in (one for one in factors if one in own):
            moved = moved + factors[source] * own[source]
        asked_m_s2[name] = moved * full_scale_m_s2
    return render_motion(asked_m_s2, rig, certificate=certificate)


def render_motion(
    asked_m_s2: Mapping[str, Vector], rig: Rig, *, certificate: Certificate | None
) -> Frames:
    """Render the motions asked of the actuators, shape (n,) each, as samples of shape (n + tail, channels)."""
    sent = {
        one.channel - 1: certificate.drive(one.name, asked_m_s2[one.name])
        if certificate
        else asked_m_s2[one.name] / one.full_scale_m_s2
        for one in rig.actuators
    }
    rendered = np.zeros((max(map(len, sent.values())), rig.n_channels), dtype=np.float32)
    for column, samples in sent.items():
        rendered[: len(samples), column] = samples
    return rendered


RAMP_S = 0.02  # of a tone, at both ends: shorter ones would add other frequencies


def make_tone(frequency_hz: float, *, duration_s: float, rate_hz: float) -> Vector:
    """Make a sinusoid of root mean square 1 between its ramps, shape (n_samples,)."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    from_end_s = np.minimum(time_s, time_s[-1] - time_s)
    ramp = np.sin(np.pi / 2 * np.minimum(from_end_s / RAMP_S, 1.0)) ** 2
    return np.asarray(np.sqrt(2) * np.sin(2 * np.pi * frequency_hz * time_s) * ramp)


def render_tones(
    block: ThresholdBlock, rig: Rig, *, rate_hz: float, certificate: Certificate | None = None
) -> dict[str, Frames]:
    """Render the tone of each frequency for a rig, by name, shape (n_samples, channels), for 1 m/s² RMS at the hand."""
    sounds, mix = {}, find_mix(rig)
    for frequency in block.frequencies_hz:
        tone = make_tone(frequency, duration_s=block.duration_s, rate_hz=rate_hz)
        asked = {one.name: mix[one.name].get(REDUCED, 0.0) * tone for one in rig.actuators}
        sounds[name_tone(frequency)] = render_motion(asked, rig, certificate=certificate)
    return sounds


def find_rig_problems(
    rig: Rig, stimuli: StimulusSet, settings: "Settings", *, certificate: Certificate | None = None
) -> tuple[list[str], dict[str, Frames]]:
    """Find what keeps a rig from playing a study as it is, in one line per problem; also returns what was rendered."""
    own, block = settings.rig, settings.session.threshold
    problems: dict[str, list[str]] = {}
    excesses: dict[tuple[str, str], list[tuple[float, str]]] = {}
    sounds: dict[str, Frames] = {}
    choices: dict[str, Any] = {"full_scale_m_s2": own.full_scale_m_s2, "certificate": certificate}
    find_mix(rig)  # which refuses coils that cancel each other
    for one in stimuli.stimuli:
        try:
            rendered = render_stimulus(one, stimuli.folder, rig, **choices)
        except ValueError as error:
            named, _, reason = str(error).partition(": ")
            problems.setdefault(reason, []).append(named)
            continue
        except OSError as error:
            reason = error.strerror or str(error).removeprefix(f"{one.file}: ")
            problems.setdefault(f"{reason}; build the set again", []).append(one.file)
            continue
        if one.rate_hz != own.rate_hz:
            reason = f"got a rate of {one.rate_hz:g} Hz, the study plays at {own.rate_hz:g} Hz; build the set again"
            problems.setdefault(reason, []).append(one.stimulus_id)
        sounds[one.stimulus_id] = rendered
        found = _find_excesses(rig, rendered, rate_hz=one.rate_hz, certificate=certificate)
        for actuator, limit, asked in found:
            excesses.setdefault((actuator, limit), []).append((-asked, one.stimulus_id))
    lines = [f"rig.toml: {_shorten(names)}: {reason}" for reason, names in problems.items()]
    filters = " lower max_gain_db or narrow band_hz under [calibration] and calibrate again,"
    for (actuator, limit), above in sorted(excesses.items()):
        worst = sorted(above, key=itemgetter(0))
        names = _shorten([name for _, name in worst])
        lines.append(
            f"rig.toml: actuator {actuator!r}: {names}: got {-worst[0][0]:.4g}, above {limit}; lower gain or headroom "
            f"in study.toml and build again,{filters if certificate else ''} or raise the limit if the coil allows it"
        )
    if block:
        tones: dict[str, Any] = {"rate_hz": own.rate_hz, "certificate": certificate}
        lines += find_tone_problems(block.make_block(), rig, **tones)
    return lines, sounds


def find_tone_problems(
    block: ThresholdBlock, rig: Rig, *, rate_hz: float, certificate: Certificate | None = None
) -> Iterator[str]:
    """Find what keeps a rig from playing the strongest tones of a threshold block, in one line per limit."""
    if not any(REDUCED in actuator.plays for actuator in rig.actuators):
        yield f"rig.toml: no actuator plays {REDUCED}, which session.threshold needs; add it to `plays`"
    strongest, worst = 10 ** (block.plan.highest_db / 20), dict[tuple[str, str], float]()
    for sound in render_tones(block, rig, rate_hz=rate_hz, certificate=certificate).values():
        loud = strongest * sound.astype(np.float64)
        found = _find_excesses(rig, loud, rate_hz=rate_hz, certificate=certificate)
        for name, limit, asked in found:
            worst[name, limit] = max(asked, worst.get((name, limit), 0.0))
    for (actuator, limit), asked in worst.items():
        key = "duration_s" if "duration_s" in limit else "highest_db"
        yield (
            f"rig.toml: actuator {actuator!r}: the strongest tone of session.threshold will ask for {asked:.4g}, above "
            f"{limit}; lower session.threshold.{key} in study.toml"
        )


def _find_excesses(
    rig: Rig, rendered: Levels, *, rate_hz: float, certificate: Certificate | None
) -> Iterator[tuple[str, str, float]]:
    """Find where rendered samples, shape (n, channels), ask too much: actuator, limit, and what they ask."""
    limits, n_window = rig.limits, round(WINDOW_S * rate_hz)
    for actuator in rig.actuators:
        samples = rendered[:, actuator.channel - 1].astype(np.float64)
        if not samples.any():
            continue
        scale, which, motions = actuator.full_scale_m_s2, "full_scale_m_s2", []
        if certificate:  # at a resonance a coil moves more than it is driven
            coil = certificate.coils[actuator.name]
            scale, which = coil.target, "measured full scale"
            motions = [coil.respond(samples, rate_hz=rate_hz)]
        motions = [samples * scale, *motions]
        peaks = [float(np.abs(one).max()) for one in motions]
        # The mean square over every window, with silence before the samples.
        sums = np.cumsum(np.pad(np.square(motions), ((0, 0), (n_window, 0))), axis=1)
        energy = np.max(sums[:, n_window:] - sums[:, :-n_window])
        rms = math.sqrt(max(float(energy), 0.0) / n_window)
        for limit, asked, allowed in (
            (f"the actuator's {which}", peaks[0], scale),
            ("limits.peak_m_s2", max(peaks), limits.peak_m_s2),
            ("limits.rms_m_s2", rms, limits.rms_m_s2),
            ("limits.duration_s", len(samples) / rate_hz, limits.duration_s),
        ):
            if asked > allowed * (1 + ROUNDING):
                yield actuator.name, f"{limit} of {allowed:g}", asked


def _shorten(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
