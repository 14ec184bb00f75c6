from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress import diagnosis
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS, Diagnosis, diagnose, list_warnings
from feel321.analysis.tradeoff.stress.measures import StressCell
from feel321.stimuli.condition import Conditioning, condition
from feel321.stimuli.formats.read import read_recording

SHARED = Path(__file__).resolve().parents[4] / "shared" / "recordings"
needs_recordings = pytest.mark.skipif(
    not SHARED.is_dir(), reason="NO REAL RECORDINGS: ../shared/recordings is missing"
)


def test_signs_of_samples_that_are_known_by_heart(made: Any) -> None:
    assert diagnosis.eigenvalue_ratio(made([[2, -2, 0, 0], [0, 0, 1, -1], [0] * 4])) == 0.25
    assert diagnosis.silent_axes(made([[1, -1], [0, 0], [0.001, -0.001]])) == 2
    assert diagnosis.offset_share(made([[2, 0, 2, 0], [0] * 4, [0] * 4])) == 0.5
    assert diagnosis.clipped_share(made([[0, 1, 1, 1, 0, -1, 0, 1], [0] * 8, [0] * 8])) == 0.375
    assert diagnosis.step_over_rms(made([[1, -1, 1, -1], [0] * 4, [0] * 4])) == 2
    assert diagnosis.held_share(made([[1, 0, 0, 0, 2]] * 3)) == 0.5
    shown = [SIGNS["offset_share"].format(value) for value in (0.32, 4e-8, 0.0)]
    assert shown == ["32 %", "<0.01 %", "0 %"]


@pytest.mark.parametrize("share", [0.1, 0.32, 0.7])
def test_a_planted_share_of_undetermined_phase_is_recovered(share: float, made: Any) -> None:
    """Bands that cancel hold the planted share, bands in phase the rest."""
    rng = np.random.default_rng(3)
    spectrum = np.fft.rfft(rng.standard_normal(4000))
    low = np.arange(2001) < 900
    parts = [np.fft.irfft(np.where(chosen, spectrum, 0)) for chosen in (low, ~low)]
    together, against = (part / np.linalg.norm(part) for part in parts)
    x = np.sqrt(1 - share) * together + np.sqrt(share) * against
    y = np.sqrt(1 - share) * together - np.sqrt(share) * against
    assert diagnosis.undetermined_share(made([x, y, 0 * x])) == pytest.approx(share, abs=0.002)


def test_isotropic_axes_rarely_cancel(made: Any) -> None:
    """|sum|²/energy is 3 Beta(1, 2): below 0.01 in 0.7 % of the bins."""
    white = made(np.random.default_rng(0).standard_normal((3, 200_000)))
    assert diagnosis.undetermined_share(white) == pytest.approx(1 - (1 - 0.01 / 3) ** 2, abs=0.002)


def test_eigenvalue_ratios(made: Any) -> None:
    axes = np.random.default_rng(1).standard_normal((3, 40000)) * np.array([[1.0], [0.5], [0.1]])
    assert diagnosis.eigenvalue_ratio(made(axes)) == pytest.approx(0.25, abs=0.01)
    assert diagnosis.eigenvalue_ratio(made(np.zeros((3, 9)))) == 0


def test_windows_without_a_leading_axis_hold_the_planted_energy(made: Any) -> None:
    """Half a second along a line, half a second around a circle of the same power."""
    angle = 2 * np.pi * 200 * np.arange(20000) / 20000
    line = np.sqrt(2) * np.array([np.cos(angle), 0 * angle, 0 * angle])
    circle = np.array([np.cos(angle), np.sin(angle), 0 * angle])
    both = made(np.concatenate([line, circle], axis=-1), rate_hz=20000)
    assert diagnosis.ambiguous_windows(both) == pytest.approx(0.5, abs=0.03)


def test_clipping_steps_and_repeats(made: Any) -> None:
    u = np.sin(2 * np.pi * np.arange(1000) / 100)
    cut = np.clip(u, -0.5, 0.5)
    assert diagnosis.clipped_share(made([u, u, u])) == 0
    assert diagnosis.clipped_share(made([cut, u, 0 * u])) == pytest.approx(2 / 3, abs=0.03)
    assert diagnosis.step_over_rms(made([np.round(4 * u)] * 3)) == pytest.approx(
        1 / np.round(4 * u).std()
    )
    assert diagnosis.step_over_rms(made(np.zeros((3, 5)))) == 0
    assert diagnosis.held_share(
        made(np.repeat(np.random.default_rng(0).standard_normal((3, 50)), 2, axis=1))
    ) == (pytest.approx(50 / 99))
    assert diagnosis.held_share(made(np.ones((3, 1)))) == 0


def test_offsets_and_slow_motion(made: Any) -> None:
    time = np.arange(2000) / 1000
    tone = np.sqrt(2) * np.sin(2 * np.pi * 100 * time)
    slow = np.sqrt(2) * np.sin(2 * np.pi * 5 * time)
    assert diagnosis.offset_share(made([tone + 3, 0 * tone, 0 * tone])) == pytest.approx(0.9)
    assert diagnosis.slow_share(made([tone + 3, slow, 0 * tone])) == pytest.approx(0.5)


def test_spikes_tones_and_silence(made: Any) -> None:
    steady = np.ones((3, 100))
    spike = np.zeros((3, 100))
    spike[0, 7] = 1
    assert diagnosis.crest_factor(made(steady)) == pytest.approx(1)
    assert diagnosis.crest_factor(made(spike)) == pytest.approx(10)
    assert diagnosis.crest_factor(made(0 * spike)) == 0
    tone = np.sin(2 * np.pi * 50 * np.arange(1000) / 1000)
    assert diagnosis.tonal_share(made([tone, 0 * tone, 0 * tone])) == pytest.approx(1)
    assert diagnosis.tonal_share(made(np.random.default_rng(0).standard_normal((3, 1000)))) < 0.1
    assert diagnosis.tonal_share(made(np.ones((3, 1)))) == 0
    assert diagnosis.silence_share(
        made([np.where(np.arange(1000) < 500, tone, 0)] * 3)
    ) == pytest.approx(0.5, abs=0.05)
    assert diagnosis.n_windows(made(np.ones((3, 350)))) == pytest.approx(10)
    assert diagnosis.silent_axes(made(np.zeros((3, 5)))) == 3


def test_a_warning_names_the_share_and_the_reducers_that_suffer() -> None:
    figures = {name: (100.0 if sign.below else 0.0) for name, sign in SIGNS.items()} | {
        "undetermined_share": 0.32
    }
    gains = [
        StressCell("drag", name, "gain", gain, gain)
        for name, gain in (("dft321", 40.0), ("dft321_windowed", 1.0))
    ]
    expected = "32 % of the energy sits where the phase is undetermined: dft321 is sensitive here (gain 40)"
    assert list_warnings(Diagnosis("drag", figures), gains) == (expected,)
    assert list_warnings(Diagnosis("other", figures), gains) == (expected.partition(":")[0],)
    large = [StressCell("drag", "dft321", "gain", 1384.2, 1384.2)]
    assert "(gain 1384)" in list_warnings(Diagnosis("drag", figures), large)[0]


def test_conditioning_hides_what_the_sensor_shows(made: Any) -> None:
    rng = np.random.default_rng(0)
    sensor = made(np.round(rng.standard_normal((3, 4000)) + 20), rate_hz=4000)
    felt = condition(sensor, Conditioning())
    seen, hidden = diagnose(felt, sensor), diagnose(felt)
    assert {"offset_share", "step_over_rms"} <= {sign.name for sign in seen.near_signs}
    assert not {"offset_share", "step_over_rms"} & {sign.name for sign in hidden.near_signs}


@needs_recordings
def test_real_recordings_are_told_for_what_they_are() -> None:
    near = {}
    for name in ("shaker_x_5k.npz", "isotropic_noise_20k.wav", "knocks_26k.wav"):
        sensor = read_recording(SHARED / name)
        near[name] = {
            sign.name for sign in diagnose(condition(sensor, Conditioning()), sensor).near_signs
        }
    assert {"silent_axes", "tonal_share"} <= near["shaker_x_5k.npz"]
    assert "offset_share" in near["isotropic_noise_20k.wav"]
    assert {"offset_share", "crest_factor"} <= near["knocks_26k.wav"]
