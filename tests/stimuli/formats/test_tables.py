from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from feel321.stimuli.formats.read import read_recording
from feel321.stimuli.recording import STANDARD_GRAVITY

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

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


def test_a_decimal_comma_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("x_g;y_g;z_g\n0,5;1,25;-2\n1;2;3,5\n")
    recording = read_recording(tmp_path / "a.csv", rate_hz=1000)
    np.testing.assert_allclose(
        recording.acceleration.T / STANDARD_GRAVITY, [[0.5, 1.25, -2], [1, 2, 3.5]]
    )


def test_columns_may_stand_in_any_order_among_others(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("label,z,force,y,x\na,3,9,2,1\nb,6,8,5,4\n")
    recording = read_recording(tmp_path / "a.csv", rate_hz=1000)
    np.testing.assert_array_equal(recording.acceleration.T, [[1, 2, 3], [4, 5, 6]])


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


def test_three_columns_without_header_are_the_axes(tmp_path: Path) -> None:
    signal = _signal()
    path = _write(tmp_path / "a.txt", None, signal.T)
    np.testing.assert_array_equal(read_recording(path, rate_hz=1000).acceleration, signal)
    np.testing.assert_array_equal(
        read_recording(path, rate_hz=1000, columns=(2, 1, 0)).acceleration, signal[::-1]
    )


@pytest.mark.parametrize(
    "content",
    ["\ufeffx_g,y_g,z_g\r\n1,2,3\r\n4,5,6\r\n", "\n# lab\nx_g,y_g,z_g\n1,2,3\n4,5,6\n\n\n"],
)
def test_marks_line_ends_and_comments_do_not_matter(tmp_path: Path, content: str) -> None:
    (tmp_path / "a.csv").write_bytes(content.encode())
    recording = read_recording(tmp_path / "a.csv", rate_hz=1000)
    np.testing.assert_allclose(recording.acceleration.T / STANDARD_GRAVITY, [[1, 2, 3], [4, 5, 6]])


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


def test_cluster_files_are_in_g_and_resampled_on_request(tmp_path: Path) -> None:
    rng = np.random.default_rng(5)
    time = np.cumsum(rng.choice([1.3e-4, 2.1e-4, 1.6e-4], p=[0.25, 0.25, 0.5], size=400))
    rows = np.vstack([time, np.sin(2 * np.pi * 50 * time + np.array([[0], [1], [2]]))]).T
    path = _write(tmp_path / "0_135_40_500_0.csv", "time,X,Y,Z", rows)
    with pytest.raises(
        ValueError, match=r"got jitter up to 31\.\d% .* of 399 intervals off.*resample=True"
    ):
        read_recording(path)
    recording = read_recording(path, resample=True)
    expected = np.sin(
        2 * np.pi * 50 * (time[0] + np.arange(recording.n_samples) / 6250)
        + np.array([[0], [1], [2]])
    )
    assert recording.rate_hz == pytest.approx(6250)
    np.testing.assert_allclose(recording.acceleration / STANDARD_GRAVITY, expected, atol=2e-5)
    assert any("Cluster" in line for line in recording.warnings)
    assert any(
        re.search(r"resampled on request to \d+ samples at 6250 Hz by cubic spline", w)
        for w in recording.warnings
    )
    in_metres = read_recording(path, resample=True, unit="m/s^2")
    np.testing.assert_allclose(
        in_metres.acceleration * STANDARD_GRAVITY, recording.acceleration, atol=1e-12
    )


def test_rounded_stamps_are_not_jitter_but_coarse_ones_are_reported(tmp_path: Path) -> None:
    signal = _signal(400)
    for digits, reported in ((7, False), (4, True)):
        stamps = (np.arange(400) / 1601.57).round(digits)
        path = _write(tmp_path / "a.csv", "time_s,x_g,y_g,z_g", np.vstack([stamps, signal]).T)
        recording = read_recording(path)
        assert recording.rate_hz == pytest.approx(1601.57, rel=1e-3)
        assert any("finer jitter cannot be seen" in line for line in recording.warnings) == reported


def test_milliseconds_that_pass_for_seconds_are_noticed(tmp_path: Path) -> None:
    path = _write(tmp_path / "a.csv", "time,x_g,y_g,z_g", _timed(_signal(), 1e-3))
    assert any("call it time_ms" in line for line in read_recording(path).warnings)


TABLE_REFUSALS = {
    "blank cell": ("x,y,z\n1,2,3\n4,,6\n", {}, r"line 3: column 1 'y' .*got ''"),
    "word": ("x,y,z\n1,2,3\n4,5,6\n7,8,oops\n", {}, r"line 4: column 2 'z' .*got 'oops'"),
    "NaN": ("1,2,3\n4,nan,6\n", {}, r"line 2: column 1 must be a finite number, got 'nan'"),
    "underscores": ("x,y,z\n1_0,2,3\n", {}, r"line 2: column 0 'x' .*got '1_0'"),
    "other digits": ("x,y,z\n1,2,3\n4,\uff15,6\n", {}, "line 3: column 1 'y' .*got '\uff15'"),
    "long cell": ("x,y,z\n1,2,3\n4," + "5" * 200000 + ",6\n1,2,x\n", {}, "line 3: the row cannot be split"),
    "long first cell": ("x,y,z\n" + "5" * 200000 + ",5,6\n", {}, "row cannot be split into cells .*field limit"),
    "one column number": ("x,y,z\n1,2,3\n", {"columns": 5}, r"columns must be \(x, y, z\) or .* got 5"),
    "raised column number": ("x,y,z\n1,2,3\n", {"columns": (0, 1, "\xb2")}, "must be x, y, z, .*got '\xb2'"),
    "infinity": ("1,2,3\n4,inf,6\n", {}, r"line 2: .*got 'inf'"),
    "blank line": ("x,y,z\n1,2,3\n\n4,5,6\n", {}, r"line 3: the line is blank"),
    "short row": ("x,y,z\n1,2,3\n4,5\n", {}, r"line 3: there must be 3 cells, got 2; is the file truncated"),
    "long row": ("x,y,z\n1,2,3\n4,5,6,7\n", {}, r"line 3: there must be 3 cells, got 4"),
    "long row of blanks": ("x y z\n1 2 3\n4 5 6 7\n", {}, r"line 3: there must be 3 cells, got 4"),
    "header only": ("x,y,z\n", {}, "no row of numbers"),
    "words only": ("a\nb\nc\n", {}, "no row of numbers"),
    "two headers": ("a b\nc d\n1 2 3\n", {}, "one header line above the numbers, got 2"),
    "short header": ("x,y\n1,2,3\n", {}, "got 2 names but 3 cells on line 2"),
    "two axes": ("x,y\n1,2\n", {}, r"only the axes x, y \(x, y\)"),
    "two columns": ("1,2\n3,4\n", {}, "three axes x, y, z, got 2 columns without a header"),
    "reduced": ("t,vibration\n0,1\n0.1,2\n", {}, r"columns t, vibration is one channel, so already reduced"),
    "one column": ("1\n2\n3\n", {}, "one column without a header is one channel, so already reduced"),
    "ambiguous": (
        "1,2,3,4\n5,6,7,8\n", {},
        r"4 columns without a header are ambiguous; .*columns=\(0, 1, 2, 3\)",
    ),
    "unknown names": ("u,v,w\n1,2,3\n", {}, r"no columns named x, y, z \(u, v, w\)"),
    "twice": ("x,acc_x,y,z\n1,2,3,4\n", {}, r"several columns may be x \(x, acc_x\)"),
    "two clocks": ("t,time,x,y,z\n1,2,3,4,5\n", {}, r"several columns may be time \(t, time\)"),
    "mixed units": ("x_g,y_g,z_mg\n1,2,3\n", {}, "axes must be in one unit"),
    "volts": ("x [V],y [V],z [V]\n1,2,3\n", {}, r"unit must be one of m/s\^2, g, mg; got 'v'"),
    "hours": ("time [h],x,y,z\n1,2,3,4\n2,2,3,4\n", {}, r"time column must be in s, ms, us or ns, got 'time \[h\]'"),
    "no rate": ("x,y,z\n1,2,3\n4,5,6\n", {}, "no sampling rate and no time column.*give rate_hz"),
    "bad rate": ("x,y,z\n1,2,3\n", {"rate_hz": -1}, "rate_hz must be a finite number of Hz above 0, got -1"),
    "other rate": (
        "t,x,y,z\n0,2,3,4\n1,1,1,1\n", {"rate_hz": 2},
        "2 Hz, but 1 Hz by the time stamps; they may differ by 1%",
    ),
    "other unit": ("x_g,y_g,z_g\n1,2,3\n", {"unit": "mg", "rate_hz": 1}, "gives the unit 'g', but unit='mg'"),
    "no such unit": ("x,y,z\n1,2,3\n", {"unit": "ft", "rate_hz": 1}, r"unit must be one of m/s\^2, g, mg; got 'ft'"),
    "one sample": ("t,x,y,z\n0,1,2,3\n", {}, "must be 2 time stamps or more, .* got 1"),
    "clock stops": ("t,x,y,z\n0,1,1,1\n1,1,1,1\n1,1,1,1\n", {}, "must increase, got 1 after 1 s at line 4"),
    "clock goes back": (
        "t,x,y,z\n0,1,1,1\n2,1,1,1\n1,1,1,1\n", {"resample": True},
        "must increase, got 1 after 2 s at line 4",
    ),
    "too short to resample": ("t,x,y,z\n0.00,1,1,1\n1,1,1,1\n3,1,1,1\n", {"resample": True}, "4 samples .*, got 3"),
    "two column names": ("x,y,z\n1,2,3\n", {"columns": (0, 1)}, r"columns must be .*got \(0, 1\)"),
    "no such column": (
        "x,y,z\n1,2,3\n", {"columns": (0, 1, 3)},
        "must be x, y, z, or a number from 0 to 2, got 3",
    ),
    "no such name": ("1,2,3\n4,5,6\n", {"columns": ("x", 1, 2)}, "must be a number from 0 to 2, got 'x'"),
    "same column": ("x,y,z\n1,2,3\n", {"columns": (0, "x", 2)}, "name each column once"),
    "text for columns": ("x,y,z\n1,2,3\n", {"columns": "xyz"}, "columns must be .*got 'xyz'"),
    "full scale": ("x,y,z\n1,2,3\n", {"full_scale": 2.0}, "full_scale .*got a table file"),
}  # fmt: skip


@pytest.mark.parametrize("case", TABLE_REFUSALS)
def test_what_is_no_three_axis_table_is_refused_in_one_line(tmp_path: Path, case: str) -> None:
    content, arguments, message = TABLE_REFUSALS[case]
    (tmp_path / "bad.csv").write_text(content, encoding="utf-8")
    with pytest.raises(ValueError, match=message) as refusal:
        read_recording(tmp_path / "bad.csv", **arguments)
    assert str(refusal.value).startswith("bad.csv: ")
    assert "\n" not in str(refusal.value)


def test_a_picked_column_may_have_any_name(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("Ch8 X (40g),Ch8 Y (40g),Ch8 Z (40g)\n1,2,3\n")
    recording = read_recording(tmp_path / "a.csv", columns=(0, 1, 2), unit="mg", rate_hz=1000)
    np.testing.assert_allclose(recording.acceleration[:, 0] / STANDARD_GRAVITY, [1e-3, 2e-3, 3e-3])
