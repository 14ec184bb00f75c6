"""Whether a rig can play a study's stimuli as they are: every problem before a session, one line each."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from study.actuator.limiter import ROUNDING, WINDOW_S
from study.actuator.render import render_stimulus

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from stimuli.manifest import Stimulus, StimulusSet
    from study.actuator.rig import ActuatorTable, Rig


@dataclass(frozen=True, slots=True)
class _Excess:
    """One stimulus that asks too much of one actuator in one respect."""

    actuator: str
    limit: str
    asked: float
    stimulus_id: str


def find_rig_problems(rig: Rig, stimuli: StimulusSet, *, rate_hz: float, full_scale_m_s2: float) -> list[str]:
    """Find what keeps a rig from playing a set of stimuli as they are.

    Parameters
    ----------
    rig : Rig
        The rig.
    stimuli : StimulusSet
        What it is to play.
    rate_hz : float
        The study's rate in Hz.
    full_scale_m_s2 : float
        The study's full scale.

    Returns
    -------
    list of str
        One line per kind of problem, with how many stimuli have it and which the most; empty if there is none.
    """
    problems: dict[str, list[str]] = {}
    excesses: list[_Excess] = []
    for stimulus in stimuli.stimuli:
        try:
            rendered = render_stimulus(stimulus, stimuli.folder, rig, full_scale_m_s2=full_scale_m_s2)
        except ValueError as error:
            name, _, reason = str(error).partition(": ")
            problems.setdefault(reason, []).append(name)
            continue
        except OSError as error:
            problems.setdefault(f"{error.strerror}; build the set again", []).append(stimulus.file)
            continue
        if stimulus.rate_hz != rate_hz:
            reason = f"got a rate of {stimulus.rate_hz:g} Hz, the study plays at {rate_hz:g} Hz; build the set again"
            problems.setdefault(reason, []).append(stimulus.stimulus_id)
        excesses += _find_excesses(stimulus, rendered, rig)
    lines = [f"{_name_some(names)}: {reason}" for reason, names in problems.items()]
    return lines + list(_tell_excesses(excesses))


def slide_rms(samples: NDArray[np.float64], n_window: int) -> NDArray[np.float64]:
    """Compute the root mean square over every window, with silence before the samples.

    Parameters
    ----------
    samples : ndarray of float64, shape (n_samples,)
        The samples.
    n_window : int
        Length of the window in samples.

    Returns
    -------
    ndarray of float64, shape (n_samples,)
        That of the window that ends at each sample, in the samples' unit.
    """
    energy = np.concatenate([np.zeros(n_window), np.cumsum(samples**2)])
    return np.asarray(np.sqrt(np.maximum(energy[n_window:] - energy[:-n_window], 0.0) / n_window))


def _find_excesses(stimulus: Stimulus, rendered: NDArray[np.float32], rig: Rig) -> Iterator[_Excess]:
    for actuator in rig.actuators:
        samples = rendered[:, actuator.channel - 1].astype(np.float64)
        if not samples.any():
            continue
        for limit, (asked, allowed) in _compare(samples, stimulus.rate_hz, actuator=actuator, rig=rig).items():
            if asked > allowed * (1 + ROUNDING):
                yield _Excess(actuator.name, f"{limit} {allowed:g}", asked, stimulus.stimulus_id)


def _compare(
    samples: NDArray[np.float64], rate_hz: float, *, actuator: ActuatorTable, rig: Rig
) -> dict[str, tuple[float, float]]:
    """Set what a stimulus asks of an actuator against what is allowed."""
    scale, limits = actuator.full_scale_m_s2, rig.limits
    peak = float(np.abs(samples).max()) * scale
    rms = float(slide_rms(samples, round(WINDOW_S * rate_hz)).max()) * scale
    return {
        "the actuator's full_scale_m_s2 of": (peak, scale),
        "limits.peak_m_s2 of": (peak, limits.peak_m_s2),
        "limits.rms_m_s2 of": (rms, limits.rms_m_s2),
        "limits.duration_s of": (len(samples) / rate_hz, limits.duration_s),
    }


def _tell_excesses(excesses: Sequence[_Excess]) -> Iterator[str]:
    def kind(excess: _Excess) -> tuple[str, str]:
        return excess.actuator, excess.limit

    for (actuator, limit), group in groupby(sorted(excesses, key=kind), key=kind):
        worst = sorted(group, key=lambda excess: -excess.asked)
        yield (
            f"actuator {actuator!r}: {_name_some([excess.stimulus_id for excess in worst])}: got {worst[0].asked:.4g}, "
            f"above {limit}; lower gain or headroom in study.toml and build again, or raise that if the coil allows it"
        )


def _name_some(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{names[0]} and {len(names) - 1} more"
