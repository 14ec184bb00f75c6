"""Anchors: where they hum, how strong they are, and what they follow."""

from dataclasses import replace

import numpy as np
import pytest

from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.match import spectral_match, temporal_match
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.recipe import ANCHORS, weigh_bands
from feel321.stimuli.synthesis import SCENES, make_scene


def with_gaps(*gaps: tuple[float, float, float]) -> Recording:
    """Noise that holds less, by a factor, near some frequencies: (centre, half width, factor)."""
    spectrum = np.fft.rfft(np.random.default_rng(0).standard_normal((3, 20000)))
    frequency = np.fft.rfftfreq(20000, 1 / 5000)
    for centre, half, factor in gaps:
        spectrum[:, abs(frequency - centre) < half] *= factor
    return Recording(np.fft.irfft(spectrum, 20000), 5000.0, "gaps")


@pytest.mark.parametrize("name", SCENES)
def test_anchors_have_the_recordings_energy_and_the_lowest_scores(name: str) -> None:
    recording = condition(make_scene(name), Conditioning())
    acceleration, rate = recording.acceleration, recording.rate_hz
    scores = [spectral_match(acceleration, f(acceleration, rate), rate) for f in REDUCERS.values()]
    for make in ANCHORS.values():
        anchor = make(recording, np.random.default_rng(0))
        assert (anchor**2).sum() == pytest.approx((acceleration**2).sum(), rel=1e-9)
        assert temporal_match(acceleration, anchor) < 1e-9
        assert spectral_match(acceleration, anchor, rate) < min(scores)


def test_the_mid_anchor_keeps_the_envelope_and_the_low_one_does_not() -> None:
    taps = condition(make_scene("hard_taps"), Conditioning())
    blocks = np.sqrt((taps.acceleration**2).sum(axis=0).reshape(-1, 400).mean(axis=1))
    follows = {}
    for name, make in ANCHORS.items():
        hum = make(taps, np.random.default_rng(0))
        follows[name] = np.corrcoef(blocks, np.sqrt((hum**2).reshape(-1, 400).mean(axis=1)))[0, 1]
    assert follows["anchor_mid"] > 0.8
    assert abs(follows["anchor_low"]) < 0.3


@pytest.mark.parametrize(
    ("gaps", "anywhere", "easily_felt"),
    [
        (((150, 20, 0.01), (700, 90, 0.001)), 700, 150),
        # At 320 Hz the threshold is 3.5 times the lowest.
        (((150, 20, 0.01), (320, 40, 0.001)), 320, 150),
        # A band of 22 % around it must lie in the felt range.
        (((20, 3, 1e-5), (150, 20, 0.01), (700, 90, 0.001)), 700, 150),
    ],
)
def test_anchors_hum_where_the_recording_is_quiet(
    gaps: tuple[tuple[float, float, float], ...], anywhere: float, easily_felt: float
) -> None:
    frequencies, shares = weigh_bands(with_gaps(*gaps))
    for centre, share in ((anywhere, 0.1), (easily_felt, 0.9)):
        assert shares[abs(frequencies / centre - 1) < 0.05].sum() == pytest.approx(share, abs=0.01)


@pytest.mark.parametrize(
    "recording",
    [
        *(make_scene(name, duration_s=0.5) for name in SCENES),
        # Two gaps that are equally deep, and silence.
        with_gaps((70, 15, 0.01), (140, 30, 0.01), (700, 90, 0.001)),
        with_gaps((60, 41, 0.0), (700, 200, 0.0)),
        Recording(np.outer([1, 2, 0], make_scene("hard_taps").acceleration[0]), 1e4, "one_axis"),
    ],
    ids=lambda one: one.name,
)
def test_a_change_in_the_last_digits_changes_an_anchor_by_as_little(recording: Recording) -> None:
    acceleration = recording.acceleration
    noise = np.random.default_rng(1).standard_normal(acceleration.shape)
    nearly = replace(recording, acceleration=acceleration * (1 + 1e-13 * noise), sha256="")
    for make in ANCHORS.values():
        one, other = (make(condition(two), np.random.default_rng(0)) for two in (recording, nearly))
        assert np.linalg.norm(one - other) < 1e-9 * np.linalg.norm(one)


@pytest.mark.parametrize(("frequency", "depth"), [(10, 0.980), (50, 0.607), (100, 0.135)])
def test_the_mid_anchor_follows_envelopes_up_to_50_hz(frequency: float, depth: float) -> None:
    time_s = np.arange(80_000) / 20_000
    noise = np.random.default_rng(1).standard_normal((3, len(time_s)))
    swelling = np.sqrt(1 + np.cos(2 * np.pi * frequency * time_s))
    swelling = Recording(noise * swelling, 20_000.0, "swelling")
    low, mid = (make(swelling, np.random.default_rng(0)) for make in ANCHORS.values())
    loud = np.abs(low) > np.median(np.abs(low))
    energy = (mid[loud] / low[loud]) ** 2
    turning = 2 * np.pi * frequency * time_s[loud]
    terms = np.stack([np.ones(len(turning)), np.cos(turning), np.sin(turning)], axis=1)
    mean, *swing = np.linalg.lstsq(terms, energy, rcond=None)[0]
    # A Gaussian with a deviation of 1 / (2 pi 50 Hz): exp(-1/2) at 50 Hz.
    assert np.hypot(*swing) / mean == pytest.approx(depth, abs=0.05)
