"""How strongly a rig's coils bring stimuli to the hand, from the directions in which they move.

Coils that move in the same direction add their amplitudes, coils at right angles their energies: what the hand gets of
a one-axis stimulus is the vector sum of the coils' directions, each times its weight. The default weights make that sum
1, so that a stimulus of 1 m/s² reaches the hand as 1 m/s², as a three-axis one does whose axes go to coils at right
angles. A rig that gives its coils no directions plays everything at weight 1.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.actuator.rig import AXES, REDUCED

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from study.actuator.rig import ActuatorTable, Rig

    Vector = NDArray[np.float64]
    Mix = Mapping[str, Mapping[str, float]]

EQUAL_DB = 0.5
"""Energies that differ by less count as equal."""

CANCELLED = 0.05
"""Coils whose motions sum to less than this share of one coil's work against each other."""


def find_mix(rig: Rig) -> dict[str, dict[str, float]]:
    """Find the factor by which each coil plays each thing that it plays.

    Parameters
    ----------
    rig : Rig
        The rig.

    Returns
    -------
    dict of str to dict of str to float
        Name of an actuator -> `reduced`, `x`, `y`, `z` -> factor.

    Raises
    ------
    ValueError
        If coils that play the same thing cancel each other.
    """
    known = all(actuator.direction is not None for actuator in rig.actuators)
    shares = {source: _find_share(rig, source) if known else 1.0 for source in (REDUCED, *AXES)}
    return {
        actuator.name: {
            source: actuator.weight if source == REDUCED and actuator.weight is not None else shares[source]
            for source in actuator.plays
        }
        for actuator in rig.actuators
    }


def find_directions(rig: Rig) -> tuple[dict[str, Vector], list[str]]:
    """Find in which direction each coil moves the hand.

    Parameters
    ----------
    rig : Rig
        The rig.

    Returns
    -------
    directions : dict of str to ndarray, shape (3,)
        Name of an actuator -> unit vector: its own, or the axis if it plays just one and says nothing.
    unknown : list of str
        Actuators of which neither is known.
    """
    found = {actuator.name: _find_direction(actuator) for actuator in rig.actuators}
    known = {name: direction for name, direction in found.items() if direction is not None}
    return known, [name for name in found if name not in known]


def reduced_energy(mix: Mix, directions: Mapping[str, Vector]) -> float:
    """Mean square at the hand of a one-axis stimulus with mean square 1.

    Parameters
    ----------
    mix : mapping
        From `find_mix`.
    directions : mapping
        From `find_directions`, all known.

    Returns
    -------
    float
        Mean square, 1 where nothing is lost or added.
    """
    return float(np.sum(_sum_motion(mix, directions, REDUCED) ** 2))


def original_energy(mix: Mix, directions: Mapping[str, Vector], covariance: Vector) -> float:
    """Mean square at the hand of a three-axis stimulus, relative to that of its axes; their covariance is (3, 3).

    Parameters
    ----------
    mix : mapping
        From `find_mix`.
    directions : mapping
        From `find_directions`, all known.
    covariance : ndarray, shape (3, 3)
        Of the axes; its scale does not matter.

    Returns
    -------
    float
        Mean square, 1 where nothing is lost or added.
    """
    motion = np.stack([_sum_motion(mix, directions, axis) for axis in AXES], axis=1)
    covariance = covariance if np.trace(covariance) > 0 else np.eye(3)  # of silence, any will do
    return float(np.trace(motion @ covariance @ motion.T) / np.trace(covariance))


def _find_share(rig: Rig, source: str) -> float:
    playing = [actuator for actuator in rig.actuators if source in actuator.plays]
    if not playing:
        return 1.0
    directions, _ = find_directions(rig)
    length = float(np.linalg.norm(np.sum([directions[actuator.name] for actuator in playing], axis=0)))
    if length < CANCELLED:
        names = " and ".join(repr(actuator.name) for actuator in playing)
        raise ValueError(
            f"{names} play {source!r} in opposite directions and cancel each other; turn one direction round, or let "
            "one of them play it"
        )
    return 1 / length


def _find_direction(actuator: ActuatorTable) -> Vector | None:
    if actuator.direction is not None:
        direction = np.array(actuator.direction)
        return np.asarray(direction / np.linalg.norm(direction))
    axes = [axis for axis in AXES if axis in actuator.plays]
    return np.eye(3)[AXES.index(axes[0])] if len(axes) == 1 else None


def _sum_motion(mix: Mix, directions: Mapping[str, Vector], source: str) -> Vector:
    parts = [factors[source] * directions[name] for name, factors in mix.items() if source in factors]
    return np.asarray(np.sum(parts, axis=0)) if parts else np.zeros(3)
