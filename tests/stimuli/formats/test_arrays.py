from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from scipy.io import savemat

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import UNITS

if TYPE_CHECKING:
    from pathlib import Path


SIGNAL = np.random.default_rng(5).normal(size=(3, 40))
AXES = dict(zip("xyz", SIGNAL, strict=True))
OTHER = {f"acc_{axis}": 1000 * values for axis, values in AXES.items()}
TIME = np.arange(40) / 100


def _write(path: Path, arrays: dict[str, Any]) -> Path:
    savemat(path, arrays) if path.suffix == ".mat" else np.savez(path, **arrays)
    return path


@pytest.mark.parametrize(
    ("arrays", "arguments", "unit"),
    [
        ({f"{axis}_g": values for axis, values in AXES.items()}, {}, "g"),
        ({f"acc_{axis}_mg": values for axis, values in AXES.items()}, {"unit": "mg"}, "mg"),
        ({"acceleration_g": SIGNAL}, {}, "g"),
        ({"acceleration_g": SIGNAL, "unit": "g"}, {}, "g"),
        ({"acceleration": SIGNAL, "unit": "g", "units": " G"}, {}, "g"),
        ({**AXES, **OTHER}, {"columns": ("x", "y", "z"), "unit": "g"}, "g"),
        ({"acceleration": 5 * SIGNAL, "data": SIGNAL}, {"columns": ("data",), "unit": "g"}, "g"),
        ({"acceleration": 5 * SIGNAL, **AXES}, {"columns": ("x", "y", "z"), "unit": "g"}, "g"),
        ({"acceleration": SIGNAL, "x": SIGNAL[0]}, {"unit": "g"}, "g"),
        ({"recorded": SIGNAL}, {"columns": ("recorded",), "unit": "g"}, "g"),
        ({"recorded_g": SIGNAL}, {"columns": (0,)}, "g"),
    ],
)
@pytest.mark.parametrize("suffix", [".npz", ".mat"])
def test_the_meant_arrays_are_read_in_their_unit(
    tmp_path: Path, suffix: str, arrays: dict[str, Any], arguments: dict[str, Any], unit: str
) -> None:
    recording = read_recording(
        _write(tmp_path / f"a{suffix}", {**arrays, "rate_hz": 100.0}), **arguments
    )
    np.testing.assert_array_equal(recording.acceleration, SIGNAL * UNITS[unit])
    assert not any("no unit" in line for line in recording.warnings)


REFUSALS = {
    "axes twice": ({**AXES, **OTHER}, {}, r"columns may be x \(x, acc_x\); say which, columns=\(time, x, y, z\)"),
    "two accelerations": (
        {"acceleration": SIGNAL, "data": SIGNAL}, {},
        r"several arrays may be the acceleration \(acceleration, data\); say which, e.g. columns=\('acceleration',\)",
    ),
    "axes beside": ({"data": SIGNAL, **AXES}, {}, r"several arrays may be the acceleration \(data, x, y, z\)"),
    "two rates": ({"data": SIGNAL, "fs": 2.0}, {}, r"that differ \(fs says 2.0, rate_hz says 100.0\)"),
    "two units": (
        {"data": SIGNAL, "unit": "g", "units": "mg"}, {},
        r"that differ \(unit says 'g', units says 'mg'\)",
    ),
    "mixed units": ({"x_g": TIME, "y_g": TIME, "z_mg": TIME}, {}, r"in one unit, got x_g, y_g, z_mg"),
    "no vector": ({"x": SIGNAL, "y": SIGNAL, "z": SIGNAL}, {}, r"'x' .*one value per sample, got shape \(3, 40\)"),
    "no such array": ({"data": SIGNAL}, {"columns": ("p",)}, "must be data, or a number from 0 to 0, got 'p'"),
    "above all numbers": ({"data": SIGNAL * 3e307}, {"unit": "g"}, "must be finite"),
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSALS)
def test_what_may_mean_two_things_is_refused_by_name(tmp_path: Path, case: str) -> None:
    arrays, arguments, message = REFUSALS[case]
    path = _write(tmp_path / "a.npz", {**arrays, "rate_hz": 100.0})
    with pytest.raises(ValueError, match=rf"^a\.npz: .*{message}"):
        read_recording(path, **arguments)


@pytest.mark.parametrize(("late", "passes"), [(0.009, True), (0.011, False)])
def test_jitter_up_to_one_per_cent_of_the_period_passes(
    tmp_path: Path, late: float, passes: bool
) -> None:
    time = TIME.copy()
    time[20:] += late * 0.01
    path = _write(tmp_path / "a.npz", {"acceleration": SIGNAL, "time": time})
    if passes:
        assert read_recording(path).rate_hz == pytest.approx(100, rel=1e-3)
    else:
        with pytest.raises(
            ValueError, match=r"jitter up to 1\.1% of the 10 ms period, 1 of 39 intervals off"
        ):
            read_recording(path)
