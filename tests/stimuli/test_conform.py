from __future__ import annotations

import json
import subprocess
import sys
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.stimuli.__main__ import main
from feel321.stimuli.conform import GoldenVector, check_dft321, golden_vectors, judge
from feel321.stimuli.port import check_port, write_port
from feel321.stimuli.reducers.axes import sqrt_hann
from feel321.stimuli.reducers.fourier import dft321, dft321_windowed
from feel321.stimuli.wav import read_wav, write_wav
from feel321.study.cli import main as feel321

if TYPE_CHECKING:
    from collections.abc import Callable
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
    assert check_dft321(dft321).verdict == "agrees"
    for window_s in (0.02, 0.035, 0.05):
        found = check_dft321(partial(dft321_windowed, window_s=window_s), form="windowed")
        assert found.verdict == "agrees"


def half_spectrum(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    """The routine as the paper states it: magnitude of equation 3, angle of the sum of equation 4."""
    spectra = np.fft.rfft(acceleration)
    magnitude = np.sqrt((np.abs(spectra) ** 2).sum(axis=0))
    angle = np.angle(spectra.sum(axis=0))
    return np.fft.irfft(magnitude * np.exp(1j * angle), acceleration.shape[1])


def two_sided(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    """The same over all frequencies: rounding may set the phases at f and -f each by its own."""
    return np.fft.ifft(merged(acceleration)).real


def in_frames(
    acceleration: np.ndarray, rate_hz: float, *, length: int = 36, both: bool = True
) -> np.ndarray:
    """The routine in frames that overlap by half, windowed before and after the transform, or before only."""
    n, hop = acceleration.shape[1], length // 2
    window = sqrt_hann(length) if both else sqrt_hann(length) ** 2
    padded = np.pad(acceleration, ((0, 0), (length, length + (-n) % hop)))
    total = np.zeros(padded.shape[1])
    for start in range(0, padded.shape[1] - length + 1, hop):
        part = slice(start, start + length)
        frame = half_spectrum(window * padded[:, part], rate_hz)
        total[part] += window * frame if both else frame
    return total[length : length + n]


@pytest.mark.parametrize("routine", [half_spectrum, two_sided])
def test_a_restatement_agrees_with_the_paper_and_differs_where_the_phase_is_open(
    routine: Callable[[np.ndarray, float], np.ndarray],
) -> None:
    ordinary = np.random.default_rng(4).standard_normal((3, 1000))
    np.testing.assert_allclose(routine(ordinary, 1e3), dft321(ordinary, 1e3), atol=1e-13)
    found = check_dft321(routine)
    assert found.verdict == (
        "agrees with the paper; differs where the paper leaves the phase open (13)"
    )
    assert all(name.startswith("anti_phase") for name in found.differing)
    assert found.off < 1e-9


@pytest.mark.parametrize("both", [True, False])
@pytest.mark.parametrize("length", [36, 50])
def test_a_restatement_in_frames_agrees_too(length: int, both: bool) -> None:
    found = check_dft321(partial(in_frames, length=length, both=both), form="windowed")
    assert len(found.differing) == 15
    # Zero phase moves a frame's energy to where the window is zero: worth a sentence.
    assert found.energy < 0.5
    assert any("of the energy is kept" in note for note in found.notes)


def where_open(change: Callable[[np.ndarray], np.ndarray]) -> object:
    """A routine that conforms, but for what it makes of its output where the axes cancel."""

    def routine(acceleration: np.ndarray, rate_hz: float) -> np.ndarray:
        output = half_spectrum(acceleration, rate_hz)
        return output if np.abs(acceleration.sum(axis=0)).max() > 1e-9 else change(output)

    return routine


def forget_high(output: np.ndarray) -> np.ndarray:
    spectrum = np.fft.rfft(output)
    spectrum[1:] = 0
    return np.fft.irfft(spectrum, output.size)


def keep_strongest(output: np.ndarray) -> np.ndarray:
    """A third of the energy, in few frequencies."""
    spectrum = np.fft.rfft(output)
    order = np.argsort(-np.abs(spectrum))
    shares = np.cumsum(np.abs(spectrum[order]) ** 2) / (np.abs(spectrum) ** 2).sum()
    spectrum[order[shares > max(0.3, float(shares[0]))]] = 0
    return np.fft.irfft(spectrum, output.size)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (np.abs, "stronger at a frequency than equation 3 allows"),
        (lambda output: 0.95 * output, "equation 3 not the magnitude"),
        (lambda output: 1.05 * output, "stronger at a frequency"),
        (np.zeros_like, "equation 3 not the magnitude"),
        (forget_high, "anti_phase_64: holds"),
        (keep_strongest, "silent at frequencies where the axes cancel"),
        (lambda output: output + 0j, "complex"),
        (lambda output: output[:-1], "got shape"),
    ],
)
def test_an_open_phase_is_no_licence(
    change: Callable[[np.ndarray], np.ndarray], fault: str
) -> None:
    with pytest.raises(ValueError, match=fault):
        check_dft321(where_open(change))


def test_frequencies_are_judged_one_by_one() -> None:
    """Where only low frequencies cancel, their phase is free, and that of the others is not."""
    time = np.arange(64)
    low, high = np.cos(2 * np.pi * 3 * time / 64), np.cos(2 * np.pi * 9 * time / 64)
    acceleration = np.array([low + high, -low + high, high])
    expected = 2**0.5 * low + 3**0.5 * high
    vector = GoldenVector("mixed", acceleration, expected)
    turned = 2**0.5 * np.sin(2 * np.pi * 3 * time / 64) + 3**0.5 * high
    found = judge(vector, turned, form="whole")
    assert not found.faults
    assert found.energy == pytest.approx(1.0)
    wrong = 2**0.5 * low + 3**0.5 * np.sin(2 * np.pi * 9 * time / 64)
    (fault,) = judge(vector, wrong, form="whole").faults
    assert "a frequency whose phase is decided" in fault


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


def single_precision(acceleration: np.ndarray, _rate_hz: float) -> np.ndarray:
    """The routine as the paper states it, all of it in 32 bits."""
    from scipy import fft

    spectra = fft.rfft(acceleration.astype(np.float32))
    size = np.sqrt((np.abs(spectra) ** 2).sum(axis=0))
    return fft.irfft(size * np.exp(1j * np.angle(spectra.sum(axis=0))), acceleration.shape[1])


def answer(folder: Path, port: object) -> None:
    for path in folder.glob("*.wav"):
        if not path.name.endswith(".out.wav"):
            samples, rate = read_wav(path)
            write_wav(path.with_suffix(".out.wav"), port(samples.reshape(3, -1), rate), rate)


def test_a_port_in_another_language_is_judged_by_its_files(tmp_path: Path) -> None:
    assert len(write_port(tmp_path)) == len(golden_vectors())
    with pytest.raises(ValueError, match=r"offset.out.wav is missing"):
        check_port(tmp_path)
    answer(tmp_path, dft321)
    assert check_port(tmp_path).verdict == "agrees"
    answer(tmp_path, half_spectrum)
    assert check_port(tmp_path).verdict.endswith("leaves the phase open (13)")
    answer(tmp_path, single_precision)
    assert check_port(tmp_path).verdict.startswith("agrees")
    answer(tmp_path, full_wave_rectified)
    with pytest.raises(ValueError, match="off by"):
        check_port(tmp_path)


def test_a_port_may_read_and_write_text(tmp_path: Path) -> None:
    write_port(tmp_path, form="windowed")
    for path in tmp_path.glob("*.csv"):
        table = np.loadtxt(path, delimiter=",", ndmin=2)
        np.savetxt(path.with_suffix(".out.csv"), dft321_windowed(table.T, 1e3))
    found = check_port(tmp_path)
    assert (found.form, found.verdict) == ("windowed", "agrees")
    assert found.off < 1e-9  # text keeps 64 bits
    (tmp_path / "offset.out.csv").write_text("1\n2\nmany\n", encoding="utf-8")
    with pytest.raises(ValueError, match=r"^dft321 does not conform: offset: not readable"):
        check_port(tmp_path)
    write_wav(tmp_path / "offset.out.wav", np.zeros(50), 1000)
    with pytest.raises(ValueError, match="offset: answered twice"):
        check_port(tmp_path)
    (tmp_path / "vectors.json").write_text("[]", encoding="utf-8")
    with pytest.raises(ValueError, match="not a list that feel321 port wrote"):
        check_port(tmp_path)


def test_the_verb_writes_and_checks(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = str(tmp_path / "vectors")
    assert feel321(["port", folder, "--check"]) == 1
    assert "write the vectors first: feel321 port" in capsys.readouterr().err
    assert feel321(["port", folder, "--reducer", "soc321"]) == 2
    assert feel321(["port", folder]) == 0
    answer(tmp_path / "vectors", half_spectrum)
    capsys.readouterr()
    assert feel321(["port", folder, "--check", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)
    assert facts["verdict"].endswith("(13)")
    assert len(facts["differing"]) == 13
    answer(tmp_path / "vectors", without_conjugates)
    assert feel321(["port", folder, "--check"]) == 1
    assert capsys.readouterr().err.startswith("feel321: dft321 does not conform: circular_motion")


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
