from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from feel321.analysis.tradeoff.chart.accuracy import (
    ReducerVariant,
    change_rate,
    cut_piece,
    draw_turns,
    list_variants,
    measure_accuracy,
)
from feel321.analysis.tradeoff.chart.compute import FULL
from feel321.stimuli.match import spectral_match_bounded
from feel321.stimuli.metrics import METRICS
from feel321.stimuli.reducers.axes import sqrt_hann
from feel321.stimuli.reducers.fourier import dft321_windowed
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import INVARIANTS, rotation_statistics

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.stimuli.recording import Recording

    Make = Callable[[str], Recording]


@pytest.mark.parametrize("reducer", ["soc321", "dft321_windowed"])
def test_the_papers_metrics_are_those_of_the_rotation_statistics(
    reducer: str, make_recording: Make
) -> None:
    bumps = cut_piece(make_recording("bumps"), 0.1)
    spectral, temporal, *_ = measure_accuracy(
        bumps, [ReducerVariant(reducer)], turns=draw_turns(200, 5)
    )
    expected = rotation_statistics(bumps, [reducer], rng=np.random.default_rng(5)).loc[reducer]
    assert (spectral["mean"], spectral["sd"]) == pytest.approx(
        (expected.spectral_mean, expected.spectral_sd), rel=1e-9
    )
    assert (temporal["mean"], temporal["sd"]) == pytest.approx(
        (expected.temporal_mean, expected.temporal_sd), rel=1e-9
    )
    assert spectral["rotations"] == 200


@pytest.mark.parametrize("reducer", REDUCERS)
def test_as_mounted_is_what_the_metrics_themselves_say(reducer: str, make_recording: Make) -> None:
    scene = make_recording("bumps")
    found = {
        row["measure"]: row["as_mounted"]
        for row in measure_accuracy(scene, [ReducerVariant(reducer)], turns=draw_turns(2, 0))
    }
    reduced = REDUCERS[reducer](scene.acceleration, scene.rate_hz)
    bounded = spectral_match_bounded(scene.acceleration, reduced, scene.rate_hz)
    assert found["spectral_match_bounded"] == pytest.approx(bounded, abs=1e-9)
    for name in INVARIANTS:
        assert found[name] == pytest.approx(
            METRICS[name](scene.acceleration, reduced, scene.rate_hz), abs=1e-9
        )
        invariant = INVARIANTS[name](scene.acceleration, reduced, scene.rate_hz)
        own = "spectral_match_energy_weighted" if name == "spectral_match" else f"{name}_invariant"
        assert found[own] == pytest.approx(invariant, abs=1e-9)


def test_the_same_seed_gives_the_same_accuracies_and_another_does_not(make_recording: Make) -> None:
    scene, methods = make_recording("circular_motion"), list_variants()
    first, again, other = (
        measure_accuracy(scene, methods, turns=draw_turns(3, seed)) for seed in (1, 1, 2)
    )
    assert first == again
    assert first != other


def test_silence_is_refused(make_recording: Make) -> None:
    silent = replace(make_recording("bumps"), acceleration=np.zeros((3, 1000)), sha256="")
    with pytest.raises(
        ValueError, match="recording 'bumps': the recording has no energy from 20 to 1000 Hz"
    ):
        measure_accuracy(silent, [ReducerVariant("soc321")], turns=draw_turns(2, 0))


def test_bad_input_is_refused_by_name(make_recording: Make) -> None:
    with pytest.raises(ValueError, match="rotations must be 2 or more, got 1"):
        measure_accuracy(make_recording("bumps"), [], turns=draw_turns(1, 0))
    short = cut_piece(make_recording("bumps"), 0.0003)
    with pytest.raises(
        ValueError, match="recording 'bumps': the recording is too short, or its rate too low"
    ):
        measure_accuracy(short, [ReducerVariant("soc321")], turns=draw_turns(2, 0))


def test_a_piece_is_the_middle_and_another_rate_keeps_the_motion(make_recording: Make) -> None:
    bumps = make_recording("bumps")
    assert np.array_equal(cut_piece(bumps, 0.2).acceleration, bumps.acceleration[:, 1000:3000])
    assert cut_piece(bumps, FULL.longest_s) is bumps
    assert cut_piece(bumps, 0.4) is bumps
    faster = change_rate(bumps, 20_000.0)
    assert (faster.rate_hz, faster.n_samples) == (20_000.0, 8000)
    assert (
        np.abs(faster.acceleration[:, ::2] - bumps.acceleration).max()
        < 0.02 * np.abs(bumps.acceleration).max()
    )


def test_a_smaller_hop_is_overlap_add_with_that_hop() -> None:
    rate, window, families = 1000.0, 0.04, 4
    signal = np.random.default_rng(0).standard_normal((3, 400))
    found = ReducerVariant("dft321_windowed", window, families).reduce(signal, rate)
    length = 40
    hop, taper = length // 2 // families, sqrt_hann(length)
    padded = np.pad(signal, [(0, 0), (length, length)])
    expected = np.zeros(padded.shape[1])
    for start in range(0, padded.shape[1] - length + 1, hop):
        spectra = np.fft.rfft(padded[:, start : start + length] * taper)
        merged = np.sqrt((np.abs(spectra) ** 2).sum(axis=0)) * np.exp(
            1j * np.angle(spectra.sum(axis=0))
        )
        expected[start : start + length] += taper * np.fft.irfft(merged, length) / families
    assert np.allclose(found, expected[length:-length], atol=1e-12)


def test_methods_are_named_apart_and_the_usual_one_is_the_reducer() -> None:
    methods = [*list_variants(), *list_variants("window")]
    assert len({method.label for method in methods}) == len(methods)
    windowed = {method.reducer for method in list_variants("window")}
    assert windowed >= {"pca321_adaptive", "dft321_windowed"}
    signal = np.random.default_rng(0).standard_normal((3, 300))
    assert np.array_equal(
        list_variants("hop")[0].reduce(signal, 1000.0), dft321_windowed(signal, 1000.0)
    )


def test_latency_is_none_for_whole_signals_and_a_window_for_windows() -> None:
    assert ReducerVariant("mag321").find_latency(1000.0) == 0.0
    assert ReducerVariant("dft321").find_latency(1000.0) is None
    assert ReducerVariant("dft321_windowed", 0.1).find_latency(1000.0) == pytest.approx(0.099)
