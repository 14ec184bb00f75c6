from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import STANDARD_GRAVITY

RATE_HZ = 2000.0


def _signal(n: int = 50) -> NDArray[np.float64]:
    return np.random.default_rng(3).normal(size=(3, n)).round(6)


def _write(path: Path, header: str | None, rows: NDArray[np.float64], mark: str = ",") -> Path:
    lines = [] if header is None else [header]
    lines += [mark.join(repr(float(value)) for value in row) for row in rows]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def _timed(signal: NDArray[np.float64], second: float = 1.0) -> NDArray[np.float64]:
    time = np.arange(signal.shape[1]) / RATE_HZ / second
    return np.vstack([time.round(9), signal]).T


@pytest.mark.parametrize(
    ("header", "size"),
    [
        ("time_s,x_g,y_g,z_g", STANDARD_GRAVITY),
        ("t,ax,ay,az", 1.0),
        ("Time,AccX,AccY,AccZ", 1.0),
        ("timestamp,acc_x_mg,acc_y_mg,acc_z_mg", STANDARD_GRAVITY / 1000),
        ("time [s],x [m/s^2],y [m/s^2],z [m/s^2]", 1.0),
        ("Time (s),x (g),y (g),z (g)", STANDARD_GRAVITY),
        ("t_s,acc_x_m_s2,acc_y_m_s2,acc_z_m_s2", 1.0),
        (
            '"Time (s)","Linear Acceleration x (m/s²)","Linear Acceleration y (m/s²)","Linear Acceleration z (m/s²)"',
            1.0,
        ),
        ("# t,x,y,z", 1.0),
    ],
)
def test_headers_name_axes_time_and_unit(tmp_path: Path, header: str, size: float) -> None:
    signal = _signal()
    recording = read_recording(_write(tmp_path / "a.csv", header, _timed(signal)))
    np.testing.assert_allclose(recording.acceleration, signal * size, rtol=1e-14)
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-9)
    assert any("no unit" in line for line in recording.warnings) == (
        "g" not in header and "m" not in header[5:]
    )


@pytest.mark.parametrize(
    ("label", "second"),
    [("time_ms", 1e-3), ("time (us)", 1e-6), ("t_µs", 1e-6), ("t [ns]", 1e-9), ("time_s", 1.0)],
)
def test_time_is_read_in_its_unit(tmp_path: Path, label: str, second: float) -> None:
    path = _write(tmp_path / "a.csv", f"{label},x_g,y_g,z_g", _timed(_signal(), second))
    assert read_recording(path).rate_hz == pytest.approx(RATE_HZ, rel=1e-9)


@pytest.mark.parametrize("mark", [",", ";", "\t", " ", "  "])
@pytest.mark.parametrize("suffix", [".csv", ".tsv", ".txt"])
def test_delimiters_are_found(tmp_path: Path, mark: str, suffix: str) -> None:
    signal = _signal()
    path = _write(
        tmp_path / f"a{suffix}", mark.join(["t_s", "x_g", "y_g", "z_g"]), _timed(signal), mark
    )
    np.testing.assert_allclose(
        read_recording(path).acceleration, signal * STANDARD_GRAVITY, rtol=1e-14
    )


@pytest.mark.parametrize(
    "columns", [(0, 1, 2, 3), ("0", "1", "2", "3"), ("clock", "p", "q", "r"), ("CLOCK", 1, "q", 3)]
)
def test_columns_are_picked_by_name_or_number(
    tmp_path: Path, columns: tuple[str | int, ...]
) -> None:
    signal = _signal()
    path = _write(tmp_path / "a.csv", "clock,p,q,r", _timed(signal))
    recording = read_recording(path, columns=columns)
    np.testing.assert_array_equal(recording.acceleration, signal)
    assert recording.rate_hz == pytest.approx(RATE_HZ, rel=1e-9)


@settings(max_examples=60)
@given(
    signal=arrays(
        np.float64,
        st.tuples(st.just(3), st.integers(2, 30)),
        elements=st.floats(-1e6, 1e6, width=32),
    ),
    mark=st.sampled_from([",", ";", "\t", " "]),
)
def test_any_table_comes_back_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, signal: NDArray[np.float64], mark: str
) -> None:
    path = _write(tmp_path_factory.mktemp("t") / "a.csv", mark.join("xyz"), signal.T, mark)
    np.testing.assert_allclose(read_recording(path, rate_hz=1000).acceleration, signal, rtol=1e-15)


TABLE_REFUSALS = {
    "blank cell": ("x,y,z\n1,2,3\n4,,6\n", {}, r"line 3: column 1 'y' .*got ''"),
    "long cell": ("x,y,z\n1,2,3\n4," + "5" * 200000 + ",6\n1,2,x\n", {}, "line 3: the row cannot be split"),
    "blank line": ("x,y,z\n1,2,3\n\n4,5,6\n", {}, r"line 3: the line is blank"),
    "short row": ("x,y,z\n1,2,3\n4,5\n", {}, r"line 3: there must be 3 cells, got 2; is the file truncated"),
    "header only": ("x,y,z\n", {}, "no row of numbers"),
    "two headers": ("a b\nc d\n1 2 3\n", {}, "one header line above the numbers, got 2"),
    "two axes": ("x,y\n1,2\n", {}, r"only the axes x, y \(x, y\)"),
    "reduced": ("t,vibration\n0,1\n0.1,2\n", {}, r"columns t, vibration is one channel, so already reduced"),
    "ambiguous": (
        "1,2,3,4\n5,6,7,8\n", {},
        r"4 columns without a header are ambiguous; .*columns=\(0, 1, 2, 3\)",
    ),
    "twice": ("x,acc_x,y,z\n1,2,3,4\n", {}, r"several columns may be x \(x, acc_x\)"),
    "mixed units": ("x_g,y_g,z_mg\n1,2,3\n", {}, "axes must be in one unit"),
    "volts": ("x [V],y [V],z [V]\n1,2,3\n", {}, r"unit must be one of m/s\^2, g, mg; got 'v'"),
    "no rate": ("x,y,z\n1,2,3\n4,5,6\n", {}, "no sampling rate and no time column.*give rate_hz"),
    "other rate": (
        "t,x,y,z\n0,2,3,4\n1,1,1,1\n", {"rate_hz": 2},
        "2 Hz, but 1 Hz by the time stamps; they may differ by 1%",
    ),
    "other unit": ("x_g,y_g,z_g\n1,2,3\n", {"unit": "mg", "rate_hz": 1}, "gives the unit 'g', but unit='mg'"),
    "one sample": ("t,x,y,z\n0,1,2,3\n", {}, "must be 2 time stamps or more, .* got 1"),
    "clock goes back": (
        "t,x,y,z\n0,1,1,1\n2,1,1,1\n1,1,1,1\n", {"resample": True},
        "must increase, got 1 after 2 s at line 4",
    ),
    "too short to resample": ("t,x,y,z\n0.00,1,1,1\n1,1,1,1\n3,1,1,1\n", {"resample": True}, "4 samples .*, got 3"),
    "no such column": (
        "x,y,z\n1,2,3\n", {"columns": (0, 1, 3)},
        "must be x, y, z, or a number from 0 to 2, got 3",
    ),
    "same column": ("x,y,z\n1,2,3\n", {"columns": (0, "x", 2)}, "name each column once"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE_REFUSALS)
def test_what_is_no_three_axis_table_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, arguments, message = TABLE_REFUSALS[case]
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refusal:
        read_recording(tmp_path / "bad.csv", **arguments)
    assert str(refusal.value).startswith("bad.csv: ")
    assert "\n" not in str(refusal.value)
