"""Golden vectors of streams: ours pass, an independent stream passes, and every planted fault is found."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.stimuli.__main__ import main
from feel321.stimuli.conform_stream import BLOCKS, MISSING, STREAMING, check_stream, stream_vectors
from feel321.stimuli.port import LIST, check_port, write_port
from feel321.stimuli.reducers.registry import REDUCERS, WHY_NOT_STREAMING, StreamingReducer
from feel321.stimuli.wav import read_wav, write_wav

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

HOP = 18


def sum_phase(spectra: np.ndarray) -> np.ndarray:
    """The phase of the sum, or that of the strongest component where it vanishes."""
    total, size = spectra.sum(axis=0), np.abs(spectra).sum(axis=0)
    strongest = np.take_along_axis(spectra, np.abs(spectra).argmax(axis=0)[None], axis=0)[0]
    return np.angle(np.where(np.abs(total) > 1e-9 * size, total, strongest))


def length(spectra: np.ndarray) -> np.ndarray:
    return np.sqrt((np.abs(spectra) ** 2).sum(axis=0))


def right(frame: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(frame)
    return np.fft.ifft(length(spectra) * np.exp(1j * sum_phase(spectra))).real


def full_wave_rectified(frame: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(frame)
    return np.abs(np.fft.ifft(length(spectra) * np.exp(1j * sum_phase(spectra))))


def mirrored_wrongly(frame: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(frame)
    half = (length(spectra) * np.exp(1j * sum_phase(spectra)))[: frame.shape[1] // 2 + 1]
    return np.fft.ifft(np.concatenate([half, np.conj(half[::-1])])).real[: frame.shape[1]]


def without_conjugates(frame: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(frame)
    size = np.abs(np.sqrt((spectra * spectra).sum(axis=0)))
    return np.fft.ifft(size * np.exp(1j * sum_phase(spectra))).real


def phase_of_rounding(frame: np.ndarray) -> np.ndarray:
    spectra = np.fft.fft(frame + 1e-9 * np.random.default_rng(0).standard_normal(frame.shape))
    return np.fft.ifft(length(spectra) * np.exp(1j * np.angle(spectra.sum(axis=0)))).real


@dataclass
class Naive:
    """DFT321 in frames, sample by sample, written without looking at ours; a fault may be planted."""

    reduce: Callable[[np.ndarray], np.ndarray] = right
    on_gap: str = "raise"
    fault: str = ""
    latency_samples: int = 2 * HOP
    _seen: np.ndarray = field(default_factory=lambda: np.zeros((3, 2 * HOP)))
    _sum: np.ndarray = field(default_factory=lambda: np.zeros(2 * HOP))
    _ready: list[float] = field(default_factory=list)
    _count: int = 0
    _last: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def process(self, block: np.ndarray) -> np.ndarray:
        if self.fault == "forgets between blocks":
            self._seen[:] = 0.0
        if self.fault == "changes its input":
            block *= 2.0
        out = []
        for sample in block.T:
            there = not np.isnan(sample).any()
            if not there and self.fault == "time stops in a gap":
                out.append(0.0)
                continue
            if there:
                self._last = sample
            elif self.on_gap != "hold" or self.fault == "always zero":
                self._last = np.zeros(3)
            out.append(self._push(self._last))
        if self.fault == "late by one in long blocks" and len(out) > 100:
            out = [0.0, *out[:-1]]
        return np.array(out)

    def flush(self) -> np.ndarray:
        if self.fault == "no flush":
            return np.zeros(0)
        rest = np.array([self._push(np.zeros(3)) for _ in range(2 * HOP)])
        return np.zeros(2 * HOP) if self.fault == "silent flush" else rest

    def _push(self, sample: np.ndarray) -> float:
        self._seen = np.concatenate([self._seen[:, 1:], sample[:, None]], axis=1)
        self._count += 1
        if self._count % HOP == 0:
            window = np.sin(np.pi * (np.arange(2 * HOP) + 0.5) / (2 * HOP))
            self._sum += self._finish(window)
            self._ready += list(self._sum[:HOP])
            self._sum = np.concatenate([self._sum[HOP:], np.zeros(HOP)])
        # The frame that ends now gives its first half; one more sample is kept back so that there always is one.
        delayed = self._count - 1 - HOP
        return self._ready[delayed] if 0 <= delayed < len(self._ready) else 0.0

    def _finish(self, window: np.ndarray) -> np.ndarray:
        if self.fault == "divided by the window":
            hann = np.hanning(2 * HOP)
            weight = hann**2 + np.roll(hann, HOP) ** 2 * (self._count > HOP)
            return hann * self.reduce(hann * self._seen) / (weight + 1e-12)
        return window * self.reduce(window * self._seen)


def ours(name: str, **options: Any) -> Callable[..., Any]:
    return lambda rate_hz, on_gap: StreamingReducer(name, rate_hz, on_gap=on_gap, **options)


def test_every_stream_has_vectors() -> None:
    assert set(STREAMING) == set(REDUCERS) - set(WHY_NOT_STREAMING)
    assert {vector.block for vector in stream_vectors("mag321")} == {1, 7, 64, 480} == set(BLOCKS)
    holed = next(one for one in stream_vectors("mag321") if one.on_gap == "hold")
    assert int(np.isnan(holed.acceleration[0]).sum()) == sum(end - first for first, end in MISSING)


@pytest.mark.parametrize("name", STREAMING)
def test_ours_conform(name: str) -> None:
    check_stream(ours(name), name)
    if "windowed" in name or name == "pca321_adaptive":
        check_stream(ours(name, window_s=0.02), name)


def test_an_independent_stream_conforms() -> None:
    check_stream(lambda _rate_hz, on_gap: Naive(on_gap=on_gap), "dft321_windowed")


def test_an_open_phase_is_told_from_a_fault() -> None:
    found = check_stream(
        lambda _rate_hz, on_gap: Naive(phase_of_rounding, on_gap), "dft321_windowed"
    )
    assert found.verdict.endswith("differs where the paper leaves the phase open (3)")
    assert all(name.startswith("anti_phase") for name in found.differing)


REDUCING = (full_wave_rectified, mirrored_wrongly, without_conjugates)


@pytest.mark.parametrize("reduce", REDUCING, ids=lambda one: one.__name__)
def test_the_faults_of_public_code_are_found(reduce: Any) -> None:
    with pytest.raises(ValueError, match=r"does not conform: \w+: (off by|holds)"):
        check_stream(lambda _rate_hz, on_gap: Naive(reduce, on_gap), "dft321_windowed")


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("divided by the window", "off by"),
        ("forgets between blocks", "positive_b1: off by"),
        ("changes its input", "changes its input"),
        ("time stops in a gap", "_hold: off by"),
        ("always zero", "positive_b1_hold: off by"),
        ("late by one in long blocks", "positive_b480: off by"),
        ("no flush", r"got shape \(600,\), expected"),
        ("silent flush", "off by"),
    ],
)
def test_the_faults_of_streams_are_found(fault: str, message: str) -> None:
    with pytest.raises(ValueError, match=message) as found:
        check_stream(lambda _rate_hz, on_gap: Naive(right, on_gap, fault), "dft321_windowed")
    text = str(found.value)
    assert "\n" not in text
    if "b480" in message:
        assert "_b64:" not in text
    if "gap" in fault or "zero" in fault:
        assert "positive_b1:" not in text


@pytest.mark.parametrize("claimed", [0, 2 * HOP - 1, 2 * HOP + 1, -1])
def test_a_wrong_latency_is_found(claimed: int) -> None:
    with pytest.raises(ValueError, match="does not conform"):
        check_stream(
            lambda _rate_hz, on_gap: Naive(right, on_gap, latency_samples=claimed),
            "dft321_windowed",
        )


@pytest.mark.parametrize("name", STREAMING)
def test_no_stream_passes_for_another(name: str) -> None:
    """The forms that follow the motion's axis are alike along a line; their laws in space are tested elsewhere."""
    for other in {"mag321", "say321_matched_running"} - {name}:
        with pytest.raises(ValueError, match=f"{other} does not conform"):
            check_stream(ours(name), other)
    if name == "dft321_windowed":
        with pytest.raises(ValueError, match="turned_1: changes by"):
            check_stream(ours(name), "dft321_principal_windowed")


def test_32_bits_are_allowed_their_rounding() -> None:
    class Rough:
        def __init__(self, on_gap: Any, bits: int) -> None:
            self._stream = StreamingReducer("mag321", 1000, on_gap=on_gap)
            self._bits, self.latency_samples = bits, 0

        def process(self, block: np.ndarray) -> np.ndarray:
            mantissa, exponent = np.frexp(self._stream.process(block))
            return np.ldexp(np.round(mantissa * 2**self._bits) / 2**self._bits, exponent)

        def flush(self) -> np.ndarray:
            return self._stream.flush()

    check_stream(lambda _, gap: Rough(gap, 23), "mag321", precision="float32")
    with pytest.raises(ValueError, match="off by"):
        check_stream(lambda _, gap: Rough(gap, 23), "mag321")
    with pytest.raises(ValueError, match="off by"):
        check_stream(lambda _, gap: Rough(gap, 12), "mag321", precision="float32")


def answer(folder: Path, name: str, *, extra: int = 0) -> None:
    """A port: reads the list and the files, feeds the blocks, writes the answers in 32 bits."""
    content = json.loads((folder / LIST).read_text(encoding="utf-8"))
    for entry in content["vectors"]:
        samples = np.asarray(read_wav(folder / entry["input"])[0], dtype=np.float64)
        for first, end in entry["missing"]:
            samples[:, first:end] = np.nan
        stream = StreamingReducer(name, content["rate_hz"], on_gap=entry["on_gap"])
        starts = range(0, samples.shape[1], entry["block"])
        parts = [stream.process(samples[:, at : at + entry["block"]]) for at in starts]
        late = np.zeros(extra if entry["block"] == 7 else 0)
        output = np.concatenate([late, *parts, stream.flush()])
        write_wav(folder / entry["output"], output, content["rate_hz"])


@pytest.mark.parametrize("name", ["dft321_windowed", "sax321_matched_running"])
def test_a_port_by_files(name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = [str(tmp_path), "--form", "streaming", "--reducer", name]
    assert main(["write-vectors", *words]) == 0
    answer(tmp_path, name)
    assert main(["check-vectors", *words]) == 0
    assert f"conforms: {len(stream_vectors(name))} vectors" in capsys.readouterr().out
    assert main(["check-vectors", str(tmp_path), "--form", "streaming", "--reducer", "soc321"]) == 1
    answer(tmp_path, name, extra=1)
    with pytest.raises(ValueError, match="latency must be one number, got"):
        check_port(tmp_path, form="streaming", reducer=name)
    (tmp_path / "impulses_b7.out.wav").unlink()
    with pytest.raises(ValueError, match=r"impulses_b7\.out\.wav is missing"):
        check_port(tmp_path, form="streaming", reducer=name)


def test_files_hold_the_vectors_in_32_bits(tmp_path: Path) -> None:
    """The waveforms have so few bits that nothing is lost on the way to a port."""
    write_port(tmp_path, form="streaming", reducer="soc321")
    for vector in stream_vectors("soc321")[:12]:
        written = np.asarray(read_wav(tmp_path / f"{vector.name}.wav")[0], dtype=np.float64)
        there = np.isfinite(vector.acceleration)
        np.testing.assert_array_equal(written[there], vector.acceleration[there])
        assert np.all(written[~there] == 999.0)
