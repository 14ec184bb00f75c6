"""Tones for threshold measurements: rendered once per frequency for 1 m/s² RMS at the hand, scaled as they are played.

They go through every actuator that plays one-axis stimuli, with the rig's mix; a silent interval is the same tone times
0, so that masking noise and sync pulse are those of an interval that vibrates.
"""

from collections.abc import Iterator

import numpy as np

from feel321.protocols.detection import ThresholdBlock, name_tone
from feel321.study.actuator.certificate import Certificate
from feel321.study.actuator.mixer import ROUNDING, WINDOW_S, Frames
from feel321.study.actuator.render import find_mix, render_motion, slide_rms
from feel321.study.actuator.rig import REDUCED, Rig
from feel321.types import Samples

RAMP_S = 0.02
"""Raised-cosine ramps at both ends: shorter ones would add other frequencies."""


def make_tone(frequency_hz: float, *, duration_s: float, rate_hz: float) -> Samples:
    """Make a sinusoid of root mean square 1 between its ramps, shape (n_samples,)."""
    time_s = np.arange(round(duration_s * rate_hz)) / rate_hz
    from_end_s = np.minimum(time_s, time_s[-1] - time_s)
    ramp = np.sin(np.pi / 2 * np.minimum(from_end_s / RAMP_S, 1.0)) ** 2
    return np.asarray(np.sqrt(2) * np.sin(2 * np.pi * frequency_hz * time_s) * ramp)


def render_tones(
    block: ThresholdBlock, rig: Rig, *, rate_hz: float, certificate: Certificate | None = None
) -> dict[str, Frames]:
    """Render the tone of each frequency for a rig, by name, shape (n_samples, channels)."""
    sounds, mix = {}, find_mix(rig)
    for frequency in block.frequencies_hz:
        tone = make_tone(frequency, duration_s=block.duration_s, rate_hz=rate_hz)
        asked = {one.name: mix[one.name].get(REDUCED, 0.0) * tone for one in rig.actuators}
        sounds[name_tone(frequency)] = render_motion(asked, rig, certificate=certificate)
    return sounds


def find_tone_problems(
    block: ThresholdBlock, rig: Rig, *, rate_hz: float, certificate: Certificate | None = None
) -> Iterator[str]:
    """Find what keeps a rig from playing the strongest tones of a threshold block, in one line per limit."""
    if not any(REDUCED in actuator.plays for actuator in rig.actuators):
        yield f"no actuator plays {REDUCED}, which session.threshold needs; add it to `plays`"
    sounds = render_tones(block, rig, rate_hz=rate_hz, certificate=certificate)
    strongest, limits = 10 ** (block.plan.highest_db / 20), rig.limits
    for actuator in rig.actuators:
        coil = certificate.coils[actuator.name] if certificate else None
        full_scale = coil.target if coil else actuator.full_scale_m_s2
        drives = [
            strongest * sound[:, actuator.channel - 1].astype(np.float64)
            for sound in sounds.values()
        ]
        # At a resonance the coil moves more than it is driven.
        moved = [full_scale * drive for drive in drives]
        moved += [coil.respond(drive, rate_hz=rate_hz) for drive in drives] if coil else []
        driven = full_scale * max(float(np.abs(drive).max()) for drive in drives)
        peak = max(float(np.abs(samples).max()) for samples in moved)
        rms = max(float(slide_rms(one, round(WINDOW_S * rate_hz)).max()) for one in moved)
        longest_s = max(len(sound) for sound in sounds.values()) / rate_hz if peak else 0.0
        for limit, got, allowed in (
            ("its full_scale_m_s2", driven, full_scale),
            ("limits.peak_m_s2", peak, limits.peak_m_s2),
            ("limits.rms_m_s2", rms, limits.rms_m_s2),
            ("limits.duration_s", longest_s, limits.duration_s),
        ):
            if got > allowed * (1 + ROUNDING):
                key = "duration_s" if limit.endswith("duration_s") else "highest_db"
                yield (
                    f"actuator {actuator.name!r}: the strongest tone of session.threshold will ask for {got:.4g}, "
                    f"above {limit} of {allowed:g}; lower session.threshold.{key} in study.toml"
                )
