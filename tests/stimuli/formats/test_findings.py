from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from feel321.stimuli.formats.read import inspect_samples, read_recording
from feel321.stimuli.recording import UNITS

RECORDINGS = Path(__file__).parents[4] / "shared" / "recordings"
RATE_HZ = 8000.0
TIME_S = np.arange(8000) / RATE_HZ


def _noise(seed: int) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=TIME_S.size)


def test_a_clipped_axis_is_counted_and_placed() -> None:
    wave = np.sin(2 * np.pi * 100 * TIME_S)
    lines = inspect_samples(np.stack([np.clip(wave, -0.9, 0.9), _noise(1), _noise(2)]), RATE_HZ)
    assert len(lines) == 2
    samples = int((wave > 0.9).sum())
    first = np.argmax(wave > 0.9) / RATE_HZ
    assert (
        lines[1]
        == f"axis x: saturated at 0.9 m/s^2 in 100 runs ({samples} samples), the first at {first:g} s"
    )


@pytest.mark.parametrize("samples", [2, 3])
def test_three_equal_samples_at_the_extreme_are_saturated(samples: int) -> None:
    axes = np.stack([_noise(1), _noise(2), _noise(3)])
    axes[1, 4000 : 4000 + samples] = 9.0
    line = "axis y: saturated at 9 m/s^2 in 1 runs (3 samples), the first at 0.5 s"
    assert inspect_samples(axes, RATE_HZ) == ((line,) if samples == 3 else ())


def test_smooth_and_quantised_crests_are_not_saturated() -> None:
    slow = np.round(40 * np.sin(2 * np.pi * 3 * TIME_S)) / 40  # crests of over 100 equal samples
    square = np.sign(np.sin(2 * np.pi * 50 * TIME_S) + 0.1)
    coarse = np.round(_noise(3))
    assert inspect_samples(np.stack([slow, square, coarse]), RATE_HZ) == ()


def test_a_frozen_axis_is_placed_and_silence_is_not() -> None:
    axes = np.stack([_noise(1), _noise(2), _noise(3)])
    axes[:, 1000:3000] = 0.25
    assert inspect_samples(axes, RATE_HZ) == ()
    axes[2, 4000:4800] = axes[2, 4000]
    assert inspect_samples(axes, RATE_HZ) == (
        "axis z: stands still while another moves, 1 times for 50 ms or longer (800 samples), the first at 0.5 s",
    )


def test_findings_reach_the_recording_in_metres_per_second_squared(tmp_path: Path) -> None:
    wave = np.minimum(np.sin(2 * np.pi * 100 * TIME_S), 0.5)
    np.savez(
        tmp_path / "a.npz",
        acceleration=np.stack([_noise(1), wave, _noise(2)]),
        rate_hz=RATE_HZ,
        unit="g",
    )
    assert re.search(
        r"axis y: saturated at 4\.90332 m/s\^2 in 100 runs",
        read_recording(tmp_path / "a.npz").warnings[0],
    )


def _listed() -> list[tuple[str, float, int, str]]:
    readme = RECORDINGS / "README.md"
    text = readme.read_text(encoding="utf-8") if readme.is_file() else ""
    rows = re.findall(
        r"^\| (\S+\.\w+) \| ([\d.]+) \| (\d+) \| [\d.]+ \| (\S+) \|", text, re.MULTILINE
    )
    return [(name, float(rate), int(samples), unit) for name, rate, samples, unit in rows]


@pytest.mark.skipif(
    not _listed(),
    reason=f"the real recordings are missing: no {RECORDINGS.name} folder with a README",
)
def test_every_real_recording_reads_as_its_list_says() -> None:
    listed = _listed()
    assert len(listed) == 11
    for name, rate_hz, n_samples, unit in listed:
        recording = read_recording(RECORDINGS / name)
        assert recording.acceleration.shape == (3, n_samples), name
        assert recording.rate_hz == pytest.approx(rate_hz, abs=0.6), name
        assert recording.warnings == (), name
        assert read_recording(RECORDINGS / name, unit=unit).sha256 == recording.sha256
        with pytest.raises(ValueError, match="the file gives the unit"):
            read_recording(RECORDINGS / name, unit=next(other for other in UNITS if other != unit))


@pytest.mark.skipif(not RECORDINGS.is_dir(), reason="the real recordings are missing")
def test_a_real_table_has_the_values_that_another_reader_finds() -> None:
    expected = np.loadtxt(RECORDINGS / "handheld_1600.csv", delimiter=",", skiprows=1)
    recording = read_recording(RECORDINGS / "handheld_1600.csv")
    np.testing.assert_allclose(recording.acceleration.T, expected[:, 1:] * UNITS["g"], rtol=1e-14)
    assert recording.rate_hz == pytest.approx((len(expected) - 1) / expected[-1, 0])
