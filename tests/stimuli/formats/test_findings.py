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


def test_smooth_and_quantised_crests_are_not_saturated() -> None:
    slow = np.round(40 * np.sin(2 * np.pi * 3 * TIME_S)) / 40  # crests of over 100 equal samples
    square = np.sign(np.sin(2 * np.pi * 50 * TIME_S) + 0.1)
    coarse = np.round(_noise(3))
    assert inspect_samples(np.stack([slow, square, coarse]), RATE_HZ) == ()


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
