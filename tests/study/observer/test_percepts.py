from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.sets.build import build_stimuli
from feel321.stimuli.sets.recipe import Recipe
from feel321.stimuli.synthesis import make_scene
from feel321.stimuli.thresholds import acceleration_threshold, felt_level
from feel321.study.observer.percepts import (
    Percept,
    Sensation,
    compare_percepts,
    compare_sensations,
    read_percepts,
    sense,
)

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from feel321.stimuli.sets.manifest import StimulusSet

RATE_HZ = 8000.0
TIME_S = np.arange(8000) / RATE_HZ


def measure(stimulus: NDArray[np.float64], original: NDArray[np.float64]) -> Percept:
    return compare_sensations(sense(stimulus, RATE_HZ), sense(original, RATE_HZ))


def make_tone(frequency_hz: float, amplitude: float = 10.0) -> NDArray[np.float64]:
    return amplitude * np.sin(2 * np.pi * frequency_hz * TIME_S)


def make_bursts(*starts_s: float, frequency_hz: float = 200.0) -> NDArray[np.float64]:
    window = sum(np.exp(-(((TIME_S - start) / 0.02) ** 2)) for start in starts_s)
    return make_tone(frequency_hz) * window


def make_noise(seed: int = 1) -> NDArray[np.float64]:
    return np.random.default_rng(seed).normal(0, 5, (3, TIME_S.size))


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> StimulusSet:
    scenes = [make_scene(name, duration_s=1.0) for name in ("bumps", "texture_drag")]
    recipe = Recipe(
        reducers=("sax321", "mag321", "dft321"),
        levels=("as_is", "equal_intensity"),
        anchors=True,
        rate_hz=8000.0,
    )
    return build_stimuli(scenes, tmp_path_factory.mktemp("set"), recipe=recipe)


@pytest.fixture(scope="module")
def percepts(built: StimulusSet) -> dict[str, Percept]:
    return read_percepts(built)


def test_the_original_does_not_differ_from_itself() -> None:
    lost = measure(make_noise(), make_noise())
    assert (lost.spectral_db, lost.level_db) == (0.0, 0.0)
    assert lost.envelope == pytest.approx(0.0, abs=1e-12)


@given(st.floats(0.2, 50))
def test_a_factor_changes_the_level_alone(factor: float) -> None:
    original, tone = make_noise(), make_tone(120.0)
    before, after = measure(tone, original), measure(factor * tone, original)
    assert after.level_db - before.level_db == pytest.approx(20 * np.log10(factor))
    assert after.spectral_db == pytest.approx(before.spectral_db)
    assert after.envelope == pytest.approx(before.envelope)


def test_the_level_is_that_of_the_equal_intensity_arm() -> None:
    first, second = make_noise(1), make_tone(80.0)
    expected = 20 * np.log10(felt_level(second, RATE_HZ) / felt_level(first, RATE_HZ))
    assert measure(second, first).level_db == pytest.approx(expected)


def test_axes_count_by_energy_and_not_by_direction() -> None:
    one = make_noise()
    rotated = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0] @ one
    lost = measure(rotated, one)
    assert (lost.spectral_db, lost.envelope, lost.level_db) == pytest.approx((0, 0, 0), abs=1e-9)


def test_a_band_holds_a_tone_s_level_above_threshold() -> None:
    amplitude = 10.0
    bands = sense(make_tone(100.0, amplitude), RATE_HZ).bands
    # Smoothed by the mean over 22 % around it, a tone spreads flat over its band, with all its power in each.
    above = 10 * np.log10(bands.max())
    assert above == pytest.approx(20 * np.log10(amplitude / acceleration_threshold(100.0)), abs=0.2)


def test_a_tone_at_another_frequency_is_as_far_as_both_stand_above_threshold() -> None:
    near, far, farther = (measure(make_tone(f), make_tone(100.0)) for f in (105.0, 130.0, 160.0))
    assert 0 < near.spectral_db < far.spectral_db == pytest.approx(farther.spectral_db, rel=0.1)
    assert far.envelope < 0.1


def test_what_is_below_threshold_or_beyond_the_range_does_not_count() -> None:
    tone = make_tone(100.0)
    for unfelt in (make_tone(600.0, 0.1), make_tone(5.0, 30.0), make_tone(3000.0, 30.0)):
        lost = measure(tone + unfelt, tone)
        assert (lost.spectral_db, lost.envelope, lost.level_db) == pytest.approx(
            (0, 0, 0), abs=0.02
        )


def test_moved_bursts_change_the_envelope_and_hardly_the_spectrum() -> None:
    original = make_bursts(0.2, 0.6)
    moved, apart = (
        measure(make_bursts(0.2, 0.75), original),
        measure(make_bursts(0.35, 0.85), original),
    )
    assert 0.5 < moved.envelope < apart.envelope == pytest.approx(1.0, abs=0.01)
    assert max(moved.spectral_db, apart.spectral_db) < 1.5
    same_times = measure(make_bursts(0.2, 0.6, frequency_hz=320.0), original)
    assert same_times.envelope < 0.05
    assert same_times.spectral_db > 5


def test_a_small_delay_is_a_small_change() -> None:
    original = make_bursts(0.2, 0.6)
    lost = [
        measure(make_bursts(0.2 + delay, 0.6 + delay), original).envelope
        for delay in (0.002, 0.01, 0.03)
    ]
    assert 0 < lost[0] < 0.15 < lost[1] < 0.6 < lost[2]


def test_roughness_is_not_envelope() -> None:
    beating = make_tone(200.0) + make_tone(205.0)
    buzzing = make_tone(200.0) + make_tone(400.0)
    steady = make_tone(200.0)
    assert measure(beating, steady).envelope > 0.4
    assert measure(buzzing, steady).envelope < 0.05


@pytest.mark.parametrize("share_of_threshold", [0.0, 0.01, 0.9])
def test_silence_is_finite_and_shares_nothing(share_of_threshold: float) -> None:
    original, silence = (
        make_noise(),
        make_tone(100.0, share_of_threshold * float(acceleration_threshold(100.0))),
    )
    lost = measure(silence, original)
    sensed = sense(original, RATE_HZ)
    assert lost.envelope == 1.0
    assert lost.level_db == pytest.approx(-20 * np.log10(felt_level(original, RATE_HZ)))
    above = 10 * np.log10(np.maximum(sensed.bands, 1.0))
    assert lost.spectral_db == pytest.approx(np.sqrt(np.mean(above**2)))
    assert measure(silence, silence) == Percept(0.0, 0.0, 0.0)


def test_two_that_are_equally_far_from_the_original_are_not_the_same() -> None:
    original = make_tone(100.0)
    low, high, again = (measure(make_tone(f), original) for f in (60.0, 250.0, 250.0))
    assert low.spectral_db == pytest.approx(high.spectral_db, rel=0.2)
    assert compare_percepts(low, high).spectral_db > 0.8 * low.spectral_db
    same = compare_percepts(high, again)
    assert (same.spectral_db, same.envelope, same.level_db) == pytest.approx((0, 0, 0), abs=1e-9)


def test_a_pair_differs_as_much_in_either_order() -> None:
    one, other = (measure(tone, make_noise()) for tone in (make_tone(120.0), make_bursts(0.3, 0.5)))
    assert compare_percepts(one, other) == compare_percepts(other, one)


def test_what_is_compared_with_the_original_differs_from_it_as_its_percept_says() -> None:
    original, lost = (
        measure(make_noise(), make_noise()),
        measure(0.4 * make_tone(120.0), make_noise()),
    )
    for pair in [(original, lost), (lost, original)]:
        assert compare_percepts(*pair) == lost


def test_without_the_vibrations_the_distances_are_compared() -> None:
    apart = compare_percepts(Percept(4.0, 0.2, -1.0), Percept(1.0, 0.5, 2.0))
    assert (apart.spectral_db, apart.envelope, apart.level_db) == pytest.approx((3, 0.3, -3))


def test_envelopes_are_smoothed_to_below_50_hz() -> None:
    # A beat at the limit is left with half its power, one well above it with next to none.
    steady = make_tone(400.0)
    depths = [
        sense(make_tone(400.0) + make_tone(400.0 + beat), RATE_HZ).envelope[100:-100]
        for beat in (50.0, 150.0)
    ]
    energies = [depth**2 for depth in depths]
    swings = [(energy.max() - energy.min()) / (energy.max() + energy.min()) for energy in energies]
    thresholds = acceleration_threshold(np.array([400.0, 450.0, 550.0]))
    full = [2 * (t / thresholds[0]) / (1 + (t / thresholds[0]) ** 2) for t in thresholds[1:]]
    assert swings[0] / full[0] == pytest.approx(np.sqrt(0.5), abs=0.03)
    assert swings[1] < 0.1 * full[1]
    assert (
        np.ptp(sense(steady, RATE_HZ).envelope[100:-100])
        < 0.05 * sense(steady, RATE_HZ).envelope[500]
    )


def test_another_length_is_refused() -> None:
    first, second = (Sensation(1.0, np.ones(5), np.ones(n)) for n in (10, 12))
    with pytest.raises(ValueError, match="the same length and rate, got 10 ms and 12 ms; build"):
        compare_sensations(first, second)


def test_every_stimulus_of_a_set_has_a_percept_and_references_none_lost(
    built: StimulusSet, percepts: dict[str, Percept]
) -> None:
    assert list(percepts) == [stimulus.stimulus_id for stimulus in built.stimuli]
    for stimulus in built.stimuli:
        if stimulus.role == "reference":
            lost = percepts[stimulus.stimulus_id]
            assert (lost.spectral_db, lost.envelope, lost.level_db) == pytest.approx(
                (0, 0, 0), abs=1e-9
            )


@pytest.mark.parametrize("recording", ["bumps", "texture_drag"])
def test_dft321_keeps_the_felt_spectrum_and_mag321_does_not(
    percepts: dict[str, Percept], recording: str
) -> None:
    dft, mag, axis = (
        percepts[f"{recording}__{name}__as_is"] for name in ("dft321", "mag321", "sax321")
    )
    assert dft.spectral_db < 0.5 < axis.spectral_db < mag.spectral_db
    assert mag.spectral_db > 4
    assert dft.level_db == pytest.approx(0.0, abs=0.1)
    assert axis.level_db < -1
    assert dft.envelope < mag.envelope


def test_the_level_arms_differ_in_level_alone(
    built: StimulusSet, percepts: dict[str, Percept]
) -> None:
    raised = {}
    for row in built.stimuli:
        factor = row.gain if row.level == "equal_intensity" else 1 / row.gain
        raised[row.recording, row.reducer] = raised.get((row.recording, row.reducer), 1.0) * factor
    for stimulus in built.stimuli:
        if stimulus.level == "equal_intensity":
            factor = (
                raised[stimulus.recording, stimulus.reducer]
                / raised[stimulus.recording, "original"]
            )
            equal = percepts[stimulus.stimulus_id]
            as_is = percepts[stimulus.stimulus_id.replace("equal_intensity", "as_is")]
            assert equal.level_db - as_is.level_db == pytest.approx(20 * np.log10(factor), abs=0.01)
            assert equal.envelope == pytest.approx(as_is.envelope, abs=1e-4)


def test_files_are_taken_at_the_acceleration_that_the_rig_gives(built: StimulusSet) -> None:
    louder = replace(
        built,
        stimuli=tuple(
            replace(s, rms_m_s2=s.rms_m_s2 * (2 if s.role == "test" else 1)) for s in built.stimuli
        ),
    )
    before, after = read_percepts(built), read_percepts(louder)
    for stimulus in built.stimuli:
        gained = after[stimulus.stimulus_id].level_db - before[stimulus.stimulus_id].level_db
        assert gained == pytest.approx(20 * np.log10(2) if stimulus.role == "test" else 0.0)


def test_a_common_original_serves_all_level_arms(built: StimulusSet) -> None:
    rows = tuple(s for s in built.stimuli if s.role != "reference" or s.level == "as_is")
    percepts = read_percepts(replace(built, stimuli=rows))
    equal, as_is = (percepts[f"bumps__dft321__{level}"] for level in ("equal_intensity", "as_is"))
    gains = {
        row.level: row.gain for row in rows if (row.recording, row.reducer) == ("bumps", "dft321")
    }
    assert equal.level_db - as_is.level_db == pytest.approx(
        20 * np.log10(gains["equal_intensity"] / gains["as_is"])
    )
    assert equal.spectral_db < 0.5


def test_a_set_without_originals_is_refused(built: StimulusSet) -> None:
    tests = replace(built, stimuli=tuple(s for s in built.stimuli if s.role == "test"))
    with pytest.raises(
        ValueError,
        match=r"recording 'bumps': the stimulus set must hold its three-axis original.* reference = \"original\"",
    ):
        read_percepts(tests)


def test_a_file_that_is_gone_is_named(built: StimulusSet, tmp_path: Path) -> None:
    with pytest.raises(OSError, match=r"bumps__reference__as_is\.wav"):
        read_percepts(replace(built, folder=tmp_path))


def test_all_reducers_are_worse_than_the_original_and_better_than_the_low_anchor(
    tmp_path: Path,
) -> None:
    recipe = Recipe(reducers=tuple(REDUCERS), rate_hz=8000.0)
    built = build_stimuli([make_scene("bumps", duration_s=1.0)], tmp_path, recipe=recipe)
    lost = read_percepts(built)
    low = lost["bumps__anchor_low__as_is"]
    for name in REDUCERS:
        percept = lost[f"bumps__{name}__as_is"]
        assert 0 < percept.spectral_db < low.spectral_db
        assert 0 < percept.envelope < low.envelope


def test_one_axis_loses_the_energy_outside_the_strongest_direction() -> None:
    line, tone = np.array([0.6, 0.0, -0.8])[:, None], make_tone(150.0)
    circle = np.array([tone, make_bursts(0.2, 0.7), np.roll(tone, 100)])
    rng = np.random.default_rng(3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    for moving, expected in ((line * tone, 0.0), (make_noise(), 2 / 3)):
        lost = measure(tone, moving).direction
        assert lost == pytest.approx(expected, abs=0.08)
    assert measure(tone, turn @ circle).direction == pytest.approx(measure(tone, circle).direction)
    assert 0.1 < measure(tone, circle).direction < 2 / 3
    assert measure(make_tone(90.0), tone).direction == 0
    assert measure(0 * tone, 0 * circle).direction == 0


def test_the_vector_magnitude_is_known_by_its_waveform(
    built: StimulusSet, percepts: dict[str, Percept]
) -> None:
    for stimulus in built:
        followed = percepts[stimulus.stimulus_id].vector_magnitude
        assert 0 <= followed <= 1
        if stimulus.reducer == "mag321":
            assert followed > 0.95
        elif stimulus.role == "test":
            assert followed < 0.5
        elif stimulus.reducer == "original":
            assert followed == 0
