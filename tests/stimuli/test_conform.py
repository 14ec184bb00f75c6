from __future__ import annotations

import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.stimuli.__main__ import main
from feel321.stimuli.conform import check_dft321, check_outputs, golden_vectors, write_vectors
from feel321.stimuli.reducers.fourier import dft321, dft321_windowed
from feel321.stimuli.wav import read_wav, write_wav

if TYPE_CHECKING:
    from pathlib import Path


def merged(acceleration: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(acceleration)
    return np.sqrt((np.abs(spectra) ** 2).sum(axis=0)) * np.exp(1j * np.angle(spectra.sum(axis=0)))


def full_wave_rectified(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    return np.abs(np.fft.ifft(merged(acceleration)))


def mirrored_wrongly(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    half = merged(acceleration)[: acceleration.shape[1] // 2 + 1]
    return np.fft.ifft(np.concatenate([half, np.conj(half[::-1])])).real


def without_conjugates(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    spectra = np.fft.fft(acceleration)
    magnitude = np.abs(np.sqrt((spectra * spectra).sum(axis=0)))
    return np.fft.ifft(magnitude * np.exp(1j * np.angle(spectra.sum(axis=0)))).real


def divided_by_window_sum(
    acceleration: np.ndarray, _rate_hz: float, *, length: int = 36
) -> np.ndarray:
    n, hop = acceleration.shape[1], length // 2
    window = np.hanning(length)
    padded = np.pad(acceleration, ((0, 0), (0, length + (-n) % hop)))
    total, weight = np.zeros(padded.shape[1]), np.zeros(padded.shape[1])
    for start in range(0, padded.shape[1] - length + 1, hop):
        part = slice(start, start + length)
        total[part] += window * np.fft.ifft(merged(window * padded[:, part])).real
        weight[part] += window**2
    return (total / (weight + 1e-12))[:n]


def silent_where_the_sum_vanishes(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    spectra = np.fft.fft(acceleration)
    total = spectra.sum(axis=0)
    seen = np.abs(total) > 1e-9
    phase = np.divide(total, np.abs(total), out=np.zeros_like(total), where=seen)
    return np.fft.ifft(np.sqrt((np.abs(spectra) ** 2).sum(axis=0)) * phase).real


FAULTS = {
    "silent_where_the_sum_vanishes": silent_where_the_sum_vanishes,
    "full_wave_rectified": full_wave_rectified,
    "mirrored_wrongly": mirrored_wrongly,
    "without_conjugates": without_conjugates,
    "divided_by_window_sum": divided_by_window_sum,
}


def test_ours_conform() -> None:
    check_dft321(dft321)
    for window_s in (0.02, 0.035, 0.05):
        check_dft321(partial(dft321_windowed, window_s=window_s), form="windowed")


@pytest.mark.parametrize("form", ["whole", "windowed"])
@pytest.mark.parametrize("fault", sorted(FAULTS))
def test_every_fault_seen_in_public_code_fails(fault: str, form: str) -> None:
    with pytest.raises(ValueError, match="dft321 does not conform"):
        check_dft321(FAULTS[fault], form=form)


def test_the_whole_form_is_not_the_windowed_one() -> None:
    with pytest.raises(ValueError, match="by_definition"):
        check_dft321(dft321_windowed)


def test_faults_are_named_as_they_are() -> None:
    with pytest.raises(ValueError, match=r"equal_axes_64: got shape \(66,\), expected \(64,\)"):
        check_dft321(mirrored_wrongly)
    with pytest.raises(ValueError, match="offset: raised ZeroDivisionError"):
        check_dft321(lambda *_: 1 / 0)
    with pytest.raises(ValueError, match="complex or not finite"):
        check_dft321(lambda acceleration, rate_hz: dft321(acceleration, rate_hz) + 0j)


def test_energy_is_judged_where_the_shape_has_slack() -> None:
    def weaker(acceleration: np.ndarray, rate_hz: float) -> np.ndarray:
        reduced = dft321_windowed(acceleration, rate_hz)
        collinear = np.linalg.matrix_rank(acceleration, tol=1e-9) <= 1
        return reduced if collinear else 0.95 * reduced

    with pytest.raises(
        ValueError, match=r"circular_motion_in_frames: holds 0.90\d times the energy"
    ):
        check_dft321(weaker, form="windowed")


def test_an_unknown_form_is_refused() -> None:
    with pytest.raises(ValueError, match="form must be one of whole, windowed; got 'windowd'"):
        golden_vectors("windowd")


def test_the_vectors_cover_what_the_field_got_wrong() -> None:
    names = " ".join(vector.name for vector in golden_vectors())
    for topic in (
        "_1 ",
        "_2 ",
        "_3 ",
        "offset",
        "nyquist",
        "silent",
        "circular",
        "anti_phase",
        "window_edges",
    ):
        assert topic in names
    lengths = {vector.expected.size % 2 for vector in golden_vectors()}
    assert lengths == {0, 1}


def answer(folder: Path, port: object) -> None:
    for path in folder.glob("*.wav"):
        if not path.name.endswith(".out.wav"):
            samples, rate = read_wav(path)
            write_wav(path.with_suffix(".out.wav"), port(samples.reshape(3, -1), rate), rate)


def test_a_port_in_another_language_is_judged_by_its_files(tmp_path: Path) -> None:
    assert len(write_vectors(tmp_path)) == len(golden_vectors())
    with pytest.raises(ValueError, match=r"offset.out.wav is missing"):
        check_outputs(tmp_path)
    answer(tmp_path, dft321)
    check_outputs(tmp_path)
    answer(tmp_path, full_wave_rectified)
    with pytest.raises(ValueError, match="off by"):
        check_outputs(tmp_path)


def test_the_module_is_a_program(tmp_path: Path) -> None:
    program = [sys.executable, "-m", "stimuli"]
    assert subprocess.run([*program, "write-vectors", str(tmp_path)], check=False).returncode == 0
    refused = subprocess.run(
        [*program, "check-vectors", str(tmp_path)], check=False, capture_output=True, text=True
    )
    assert refused.returncode == 1
    assert refused.stderr.startswith(
        "dft321 does not conform: equal_axes_1: equal_axes_1.out.wav is missing"
    )


def test_the_module_runs_from_the_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["write-vectors", str(tmp_path), "--form", "windowed"]) == 0
    assert main(["check-vectors", str(tmp_path), "--form", "windowed"]) == 1
    assert "is missing" in capsys.readouterr().err
    answer(tmp_path, dft321_windowed)
    assert main(["check-vectors", str(tmp_path), "--form", "windowed"]) == 0
    assert "conforms" in capsys.readouterr().out
