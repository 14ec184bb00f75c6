"""From a stimulus's file to the samples of the rig's channels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from stimuli.recording import check_finite
from stimuli.wav import read_wav
from study.actuator.reach import find_mix
from study.actuator.rig import AXES, REDUCED

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from stimuli.manifest import Stimulus, StimulusSet
    from study.actuator.rig import Rig

SOURCES = {1: (REDUCED,), len(AXES): AXES}
"""What the channels of a stimulus's file are, by their number."""


def render_stimulus(stimulus: Stimulus, folder: Path, rig: Rig, *, full_scale_m_s2: float) -> NDArray[np.float32]:
    """Render one stimulus for a rig.

    Where study and actuator have the same full scale, the samples are those of the file times the coil's weight.

    Parameters
    ----------
    stimulus : Stimulus
        Which.
    folder : Path
        The stimulus set's folder.
    rig : Rig
        What it is played on.
    full_scale_m_s2 : float
        The study's full scale, which the file's samples are fractions of.

    Returns
    -------
    ndarray of float32, shape (n_samples, channels)
        What each channel of the device gets; 0 where nothing vibrates.

    Raises
    ------
    ValueError
        If the file is not what the manifest says or holds what is no number, or no actuator plays a channel of it.
    OSError
        If the file cannot be opened.
    """
    samples, rate_hz = read_wav(folder / stimulus.file)
    tracks = np.atleast_2d(samples)
    if tracks.shape[1] != stimulus.n_samples or rate_hz != stimulus.rate_hz:
        raise ValueError(
            f"{stimulus.file}: got {tracks.shape[1]} samples at {rate_hz} Hz, the manifest says {stimulus.n_samples} "
            f"at {stimulus.rate_hz:g}; build the set again"
        )
    if len(tracks) not in SOURCES:
        raise ValueError(f"{stimulus.file}: got {len(tracks)} channels, allowed are 1 or {len(AXES)}; build it again")
    check_finite(tracks, stimulus.file)
    sources = SOURCES[len(tracks)]
    if missing := [source for source in sources if not any(source in actuator.plays for actuator in rig.actuators)]:
        raise ValueError(
            f"{stimulus.stimulus_id}: no actuator plays {', '.join(missing)}; add it to `plays` in rig.toml, or name a "
            "reference in study.toml that the rig can play"
        )
    rendered = np.zeros((stimulus.n_samples, rig.n_channels), dtype=np.float32)
    mix = find_mix(rig)
    for actuator in rig.actuators:
        factors = mix[actuator.name]
        played = [
            factors[source] * track for source, track in zip(sources, tracks, strict=True) if source in actuator.plays
        ]
        scale = full_scale_m_s2 / actuator.full_scale_m_s2
        rendered[:, actuator.channel - 1] = sum(played, np.zeros(stimulus.n_samples)) * scale
    return rendered


def render_set(stimuli: StimulusSet, rig: Rig, *, full_scale_m_s2: float) -> dict[str, NDArray[np.float32]]:
    """Render every stimulus of a set, so that nothing is read while a session runs.

    Parameters
    ----------
    stimuli : StimulusSet
        The set.
    rig : Rig
        What it is played on.
    full_scale_m_s2 : float
        The study's full scale.

    Returns
    -------
    dict of str to ndarray of float32, shape (n_samples, channels)
        What `Mixer` plays, by the stimuli's ids.

    Raises
    ------
    ValueError
        If one cannot be rendered.
    OSError
        If a file cannot be opened.
    """
    return {
        stimulus.stimulus_id: render_stimulus(stimulus, stimuli.folder, rig, full_scale_m_s2=full_scale_m_s2)
        for stimulus in stimuli.stimuli
    }
