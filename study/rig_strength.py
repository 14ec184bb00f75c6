"""What a rig makes of the strength of stimuli: equal energy for one axis and for three, and peaks that it can play."""

from __future__ import annotations

from typing import TYPE_CHECKING

from stimuli.condition import condition
from stimuli.recipe import ORIGINAL
from study.actuator.limiter import ROUNDING
from study.actuator.reach import EQUAL_DB, find_directions, find_mix, original_energy, reduced_energy
from study.actuator.rig import AXES, REDUCED
from study.strength import Findings, energy_db, write_db

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

    from stimuli.recipe import Recipe
    from stimuli.recording import Recording
    from stimuli.sets import Foreseen
    from study.actuator.rig import Rig


def find_reach(rig: Rig, recordings: Sequence[Recording], recipe: Recipe) -> Findings:
    """Compare the energy with which one-axis stimuli and the three-axis reference reach the hand.

    Parameters
    ----------
    rig : Rig
        The rig.
    recordings : sequence of Recording
        Recordings of the study; their axes' covariance counts where coils are not at right angles.
    recipe : Recipe
        Whether there is a three-axis reference, and how recordings are conditioned.

    Returns
    -------
    Findings
        Equality as a note, a difference as a warning, with the weights that would remove it.
    """
    if recipe.reference != ORIGINAL:
        return Findings()
    directions, unknown = find_directions(rig)
    if unknown:
        return Findings(
            warnings=[
                f"actuators {', '.join(map(repr, unknown))}: no direction is known, so nobody can say whether one-axis "
                "stimuli and the three-axis reference reach the hand with equal energy; add direction = [x, y, z] "
                "to every actuator"
            ]
        )
    mix = find_mix(rig)
    reduced = reduced_energy(mix, directions)
    differences = {
        recording.name: energy_db(reduced, original_energy(mix, directions, _covariance(recording, recipe)))
        for recording in recordings
    }
    name = max(differences, key=lambda name: abs(differences[name]))
    figures: dict[str, object] = {"reduced_over_reference_db": differences}
    worst = differences[name]
    if abs(worst) < EQUAL_DB:
        same = "one-axis stimuli and the three-axis reference reach the hand with equal energy"
        return Findings(notes=[f"{same} (difference {write_db(worst)} dB)"], figures=figures)
    return Findings(warnings=[_tell_apart(rig, worst, name, among=differences)], figures=figures)


def find_rig_limits(rig: Rig, foreseen: Sequence[Foreseen], reference: str) -> list[str]:
    """Find what a rig cannot play, by the peaks of stimuli that are not built yet.

    Parameters
    ----------
    rig : Rig
        The rig.
    foreseen : sequence of Foreseen
        Stimuli as a build would make them.
    reference : str
        The reference of the recipe.

    Returns
    -------
    list of str
        One line each; empty if nothing was found.
    """
    needed = (REDUCED, *AXES) if reference == ORIGINAL else (REDUCED,)
    missing = [source for source in needed if not any(source in actuator.plays for actuator in rig.actuators)]
    remedy = "add it to `plays`, or name a reference in study.toml that the rig can play"
    lines = [f"no actuator plays {', '.join(missing)}; {remedy}"] if missing else []
    mix = find_mix(rig)
    worst = max((one for one in foreseen if one.reducer != ORIGINAL), key=lambda one: one.peak_m_s2)
    for actuator in rig.actuators:
        asked = worst.peak_m_s2 * mix[actuator.name].get(REDUCED, 0.0)
        limits = {"limits.peak_m_s2": rig.limits.peak_m_s2, "its full_scale_m_s2": actuator.full_scale_m_s2}
        limit = min(limits, key=lambda name: limits[name])
        if asked > limits[limit] * (1 + ROUNDING):
            lines.append(
                f"actuator {actuator.name!r}: {worst.recording} {worst.reducer} will ask for {asked:.4g} m/s², above "
                f"{limit} of {limits[limit]:g}; lower gain or headroom in study.toml, or raise that if the coil allows"
            )
    return lines


def _covariance(recording: Recording, recipe: Recipe) -> NDArray[np.float64]:
    import numpy as np

    acceleration = condition(recording, recipe.conditioning).acceleration
    return np.asarray(np.einsum("in,jn->ij", acceleration, acceleration))


def _tell_apart(rig: Rig, difference_db: float, recording: str, *, among: dict[str, float]) -> str:
    """Put into words that strength tells the reference from reduced stimuli, and which weights would hide it."""
    mix = find_mix(rig)
    factor = 10 ** (-difference_db / 20)
    weights = {name: factors[REDUCED] * factor for name, factors in mix.items() if REDUCED in factors}
    how = ", ".join(f"{name!r} {weight:.4g}" for name, weight in weights.items())
    where = "" if max(among.values()) - min(among.values()) < EQUAL_DB else f" in recording {recording!r}"
    than = "stronger" if difference_db > 0 else "weaker"
    remedy = f"set weight: {how}"
    if not all(actuator.direction for actuator in rig.actuators):
        remedy += "; or add direction = [x, y, z] to every actuator, then these weights are the default"
    elif where:
        remedy += ", or put the coils of x, y and z at right angles"
    return (
        f"one-axis stimuli reach the hand {abs(difference_db):.1f} dB {than} than the three-axis reference{where}, so "
        f"that strength tells them apart; {remedy}"
    )
