"""How strong the stimuli of a study are as its rig plays them: clipped, below threshold, or within reach.

Works on what a build would make (`feel321.stimuli.sets.build.place_surveyed`), whether it was made yet or not.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import inf, log10, sqrt
from operator import attrgetter, itemgetter

import numpy as np
from numpy.typing import NDArray

from feel321.protocols.trial import SURFACE
from feel321.stimuli.sets.build import Foreseen
from feel321.stimuli.sets.manifest import StimulusSet, find_raised
from feel321.stimuli.sets.recipe import GAIN_PER_RECORDING, ONE_GAIN, ORIGINAL, Recipe
from feel321.stimuli.thresholds import THRESHOLDS, acceleration_threshold, to_db
from feel321.study.actuator import render
from feel321.study.actuator.rig import REDUCED, Rig
from feel321.study.folder import Problems
from feel321.study.settings.read import make_design, make_recipe
from feel321.study.settings.schema import ACCEPT, Settings
from feel321.types import ANCHOR

WEAK_DB = 10.0  # with less over the threshold stimuli are felt, but hardly as what they are
REACH_DB = 12.0  # three standard deviations of thresholds between participants
COSTLY_DB = 1.0  # a recording that takes less headroom from the others is not worth a line

# Recording, level arm, gain, and the largest magnitude that is played, in m/s².
Gain = tuple[str, str, float, float]


def find_strength(settings: Settings, foreseen: Sequence[Foreseen], recipe: Recipe) -> Problems:
    """Find out how strongly the stimuli of a study will be felt."""
    unfelt = tuple(_find_weak(foreseen, recipe, least=-inf, below=0.0))
    is_accepted = settings.stimuli.below_threshold == ACCEPT
    felt = [one for one in foreseen if one.role != ANCHOR]
    ranges: dict[str, dict[str, list[float]]] = {}
    for one in foreseen:
        own = ranges.setdefault(one.recording, {curve: [inf, -inf] for curve in THRESHOLDS})
        for curve, level in one.sensation_levels_db.items():
            own[curve] = [min(own[curve][0], level), max(own[curve][1], level)]
    levels = [one.sensation_levels_db[recipe.threshold] for one in foreseen]
    return Problems(
        problems=() if is_accepted else unfelt,
        warnings=(
            *(unfelt if is_accepted else ()),
            *_find_weak(foreseen, recipe, least=0.0, below=WEAK_DB),
            *find_raised((one.recording, one.level, one.gain) for one in felt),
            *_compare_with_surface(settings, [one.gain for one in felt]),
            *_find_out_of_reach(settings),
        ),
        notes=(
            *_describe_gains(
                [(one.recording, one.level, one.gain, one.peak_m_s2) for one in felt], recipe
            ),
            f"sensation levels: {write_db(min(levels)).removesuffix(' dB')} to {write_db(max(levels))} over the "
            f"detection threshold ({recipe.threshold}) in the loudest 200 ms; "
            "feel321 check --json lists every recording",
        ),
        figures={
            "gain": recipe.gain,
            "threshold": recipe.threshold,
            "below_threshold": sum(level < 0 for level in levels),
            "stimuli": len(foreseen),
            "sensation_levels_db": ranges,
        },
    )


def _find_out_of_reach(settings: Settings) -> Iterator[str]:
    """List the frequencies at which many participants may have a threshold beyond the levels that are played."""
    block, curve = settings.session.threshold, settings.stimuli.threshold
    for frequency in block.frequencies_hz if block else ():
        level_db = to_db(float(acceleration_threshold(frequency, threshold=curve)) / sqrt(2))
        if block and not block.lowest_db + REACH_DB <= level_db <= block.highest_db - REACH_DB:
            yield (
                f"session.threshold: at {frequency:g} Hz thresholds are expected around {level_db:.0f} dB ({curve}); "
                f"lowest_db and highest_db should be {REACH_DB:g} dB away from that, got {block.lowest_db:g} and "
                f"{block.highest_db:g}"
            )


def _describe_gains(gains: Sequence[Gain], recipe: Recipe) -> list[str]:
    """Describe by which gains stimuli are played, and what one recording's peak costs the others."""
    own = {name: one["gain"] for name, one in recipe.exceptions.items() if "gain" in one}
    common = [one for one in gains if one[0] not in own]
    as_is = [gain for _, level, gain, _ in common if level == "as_is"]
    scope = {ONE_GAIN: "one for the whole set", GAIN_PER_RECORDING: "one per recording"}
    how = f"gain, {scope.get(str(recipe.gain), 'as given in study.toml')}"
    lines = [f"{how}: {_write_range(as_is)} m/s² played per m/s² recorded" if as_is else how]
    if own:
        named = ", ".join(f"{name} {gain:g}" for name, gain in own.items())
        lines.append(f"gain of its own: {named}")
    peaks: dict[str, float] = {}
    for recording, _, gain, peak in common if recipe.gain == ONE_GAIN else ():
        peaks[recording] = max(peak / gain, peaks.get(recording, -1.0))
    recording, *others = sorted(peaks, key=lambda name: -peaks[name]) or [""]
    second = peaks[others[0]] if others else 0.0
    cost_db = to_db(peaks[recording] / second) if second else 0.0
    if cost_db >= COSTLY_DB:
        lines.append(
            f"headroom: the peak of recording {recording!r} sets the gain; all other recordings are played "
            f'{cost_db:.1f} dB weaker for it; gain = "{GAIN_PER_RECORDING}" avoids that'
        )
    return lines


def find_unfelt(settings: Settings, stimuli: StimulusSet) -> str:
    """Say in one line that stimuli of a built set cannot be felt; empty if all can, or if that was accepted."""
    levels = {row.stimulus_id: row.sensation_level_db for row in stimuli.stimuli}
    weak = [name for name, level in levels.items() if not level >= 0]  # NaN stands for silence
    if not weak or settings.stimuli.below_threshold == ACCEPT:
        return ""
    return (
        f"{len(weak)} of {len(levels)} stimuli, such as {weak[0]}, are below the detection threshold and cannot be "
        f'felt; feel321 check says what helps, or accept it: below_threshold = "{ACCEPT}" under [stimuli]'
    )


def describe_built(settings: Settings, stimuli: StimulusSet) -> list[str]:
    """Describe the gains of a built set, beside a real surface too, and how many of its stimuli cannot be felt."""
    recipe = make_recipe(settings, stimuli.folder.parent)
    most, felt = recipe.full_scale_m_s2, [one for one in stimuli if one.role != ANCHOR]
    gains = [(one.recording, one.level, one.gain, most * one.peak) for one in felt]
    unfelt = filter(None, [find_unfelt(settings, stimuli)])
    beside = _compare_with_surface(settings, [one.gain for one in felt])
    return [*_describe_gains(gains, recipe), *beside, *unfelt, *stimuli.warnings]


def find_clipping(foreseen: Sequence[Foreseen], recipe: Recipe) -> Iterator[str]:
    """Find stimuli that are not built yet and will be limited at full scale: one line per recording."""
    most = recipe.full_scale_m_s2
    for recording, own in _group(foreseen):
        if over := [one.peak_m_s2 / most for one in own if one.peak_m_s2 > most]:
            yield (
                f"recording {recording!r}: {len(over)} of {len(own)} stimuli will be clipped at full scale "
                f"({most:g} m/s²), by up to {to_db(max(over)):.1f} dB; lower the gain or raise full_scale_m_s2"
            )


def _group(foreseen: Iterable[Foreseen]) -> list[tuple[str, list[Foreseen]]]:
    return [(name, list(own)) for name, own in groupby(foreseen, attrgetter("recording"))]


def _find_weak(
    foreseen: Sequence[Foreseen], recipe: Recipe, *, least: float, below: float
) -> Iterator[str]:
    """List recordings whose stimuli have sensation levels in a range, and the remedy: gain, rig, leaving some out."""
    accept = "" if below else f', or accept it: below_threshold = "{ACCEPT}" under [stimuli]'
    where = f"below the detection threshold ({recipe.threshold}), not to be felt"
    if below:
        where = f"less than {below:g} dB over the detection threshold ({recipe.threshold})"
    for recording, own in _group(foreseen):
        levels = [(one.sensation_levels_db[recipe.threshold], one) for one in own]
        weak = sorted(
            ((level, one) for level, one in levels if least <= level < below), key=itemgetter(0)
        )
        if not weak:
            continue
        has_arms = len(recipe.levels) > 1 or len({one.level for _, one in weak}) > 1
        named = ", ".join(
            f"{one.reducer}{f' {one.level}' if has_arms else ''} {write_db(level)}"
            for level, one in weak
        )
        peak = max(one.peak_m_s2 for one in own if one.role != ANCHOR)
        room_db = energy_db(recipe.headroom * recipe.full_scale_m_s2, peak) * 2
        advice = (
            "leave out the recording or these reducers, or use a stronger rig (full_scale_m_s2)"
        )
        if weak[0][0] > -inf and recipe.gain != GAIN_PER_RECORDING and room_db > COSTLY_DB:
            helped = f'gain = "{GAIN_PER_RECORDING}" plays this recording {room_db:.1f} dB stronger'
            advice = f"{helped}; leave out what is still weak then, or use a stronger rig"
        what = f"{len(weak)} of {len(own)} stimuli {where}: {named}"
        yield f"recording {recording!r}: {what}; {advice}{accept}"


def _compare_with_surface(settings: Settings, gains: Sequence[float]) -> Iterator[str]:
    tasks = make_design(settings).tasks
    beside = [one.protocol for one in tasks if one.surface or one.reference == SURFACE]
    if beside and set(gains) != {1.0}:
        yield (
            f"tasks {', '.join(beside)}: the real surface is felt, but stimuli are played at {_write_range(gains)} "
            "times the strength that was recorded, so ratings would mix strength with likeness; set gain = 1.0 and "
            'levels = ["as_is"] under [stimuli]'
        )


def _write_range(values: Sequence[float]) -> str:
    return " to ".join(dict.fromkeys(f"{value:.3g}" for value in (min(values), max(values))))


def energy_db(energy: float, other: float) -> float:
    """Compute 10 log10 of the ratio of energies, infinite where one is 0."""
    if energy > 0 and other > 0:
        return 10 * log10(energy / other)
    return inf if energy > other else -inf


def write_db(value: float) -> str:
    """Write dB to one place, without -0.0."""
    return "silent" if value == -inf else f"{round(value, 1) + 0.0:.1f} dB"


# What a rig makes of the strength of stimuli: equal energy for one axis and for three.


def find_reach(
    rig: Rig, covariances: Mapping[str, NDArray[np.float64]], recipe: Recipe, *, name: str
) -> Problems:
    """Compare how much energy of one-axis stimuli and of the reference reaches the hand.

    covariances: (3, 3) each; name: of the rig's file.
    """
    if recipe.reference != ORIGINAL:
        return Problems()
    directions, unknown = render.find_directions(rig)
    if unknown:
        line = (
            f"{name}: actuators {', '.join(map(repr, unknown))}: no direction is known, so it is unknown whether "
            "one-axis stimuli and the three-axis reference reach the hand with equal energy; add direction = [x, y, z] "
            "to every actuator"
        )
        return Problems(warnings=(line,))
    mix = render.find_mix(rig)
    reduced = render.find_energy(mix, directions)
    differences = {
        recording: energy_db(reduced, render.find_energy(mix, directions, covariance))
        for recording, covariance in covariances.items()
    }
    recording = max(differences, key=lambda name: abs(differences[name]))
    worst, figures = differences[recording], {"reduced_over_reference_db": differences}
    if abs(worst) < render.EQUAL_DB:
        same = "one-axis stimuli and the three-axis reference reach the hand with equal energy"
        return Problems(notes=(f"{name}: {same} (difference {write_db(worst)})",), figures=figures)
    # Strength gives the reference away; these weights would avoid that.
    factor = 10 ** (-worst / 20)
    weights = {name: own[REDUCED] * factor for name, own in mix.items() if REDUCED in own}
    remedy = (
        f"set weight: {', '.join(f'{name!r} {weight:.4g}' for name, weight in weights.items())}"
    )
    is_alike = max(differences.values()) - min(differences.values()) < render.EQUAL_DB
    if not all(actuator.direction for actuator in rig.actuators):
        remedy += "; or add direction = [x, y, z] to every actuator"
    elif not is_alike:
        remedy += ", or put the coils of x, y and z at right angles"
    warning = (
        f"{name}: one-axis stimuli reach the hand {abs(worst):.1f} dB {'stronger' if worst > 0 else 'weaker'} than the "
        f"three-axis reference{'' if is_alike else f' in recording {recording!r}'}, so they can be distinguished by "
        f"strength; {remedy}"
    )
    return Problems(warnings=(warning,), figures=figures)
