"""What the face adds to the methods: recordings in place of arrays, names in place of functions, tables out."""

from dataclasses import replace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import welch
from scipy.signal.windows import hann

from feel321 import stimuli
from feel321.stimuli import Recording


@pytest.fixture(scope="module")
def scene() -> Recording:
    return stimuli.make_scene("bumps", duration_s=0.6)


def my321(acceleration: np.ndarray, _: float) -> np.ndarray:
    return acceleration[0] - acceleration[2]


def my_metric(acceleration: np.ndarray, reduced: np.ndarray, _: float) -> float:
    return float(np.ptp(reduced) / np.ptp(acceleration))


@pytest.mark.parametrize("name", stimuli.REDUCERS)
def test_a_name_and_a_function_reduce_alike(name: str, scene: Recording) -> None:
    expected = stimuli.REDUCERS[name](scene.acceleration, scene.rate_hz)
    for reducer in (name, stimuli.REDUCERS[name]):
        reduced = stimuli.reduce(scene, reducer)
        np.testing.assert_array_equal(reduced, expected)
        assert (reduced.reducer, reduced.recording) == (name, "bumps")


def test_plain_samples_need_a_rate_and_a_window_needs_a_reducer_that_has_one(
    scene: Recording,
) -> None:
    plain = stimuli.reduce(scene.acceleration, "dft321_windowed", rate_hz=1e4, window_s=0.05)
    found = stimuli.reduce(scene, "dft321_windowed", window_s=0.05)
    np.testing.assert_array_equal(plain, found)
    assert not np.array_equal(found, stimuli.reduce(scene, "dft321_windowed"))
    frame = found.to_frame()
    assert (frame.columns.tolist(), frame.index[1], len(found)) == (["dft321_windowed"], 1e-4, 6000)
    with pytest.raises(TypeError, match="rate_hz must be given with plain samples"):
        stimuli.reduce(scene.acceleration)
    for message, signal, options in (
        ("dft321 has no window", scene, {"window_s": 0.05}),
        ("rate_hz must be left out or 10000", scene, {"rate_hz": 8000.0}),
        ("must return the shape", scene, {"reducer": lambda samples, _: samples}),
        ("did you mean 'dft321'", scene, {"reducer": "dft312"}),
        ("'no_such:f' cannot be imported", scene, {"reducer": "no_such:f"}),
    ):
        with pytest.raises(ValueError, match=message):
            stimuli.reduce(signal, **options)


def test_a_match_is_a_table_of_reducers_and_metrics(scene: Recording) -> None:
    table = stimuli.match(scene)
    assert table.index.tolist() == list(stimuli.REDUCERS)
    assert table.columns.tolist() == list(stimuli.METRICS)[:3]
    every = stimuli.match(scene, reducers=["pca321"], metrics="all")
    assert every.columns.tolist() == list(stimuli.METRICS) == list(stimuli.METRIC_INFO)
    for name, row in table.iterrows():
        reduced = stimuli.reduce(scene, str(name))
        for metric, value in row.items():
            assert stimuli.METRICS[metric](scene, reduced, None) == value
    own = stimuli.match(scene, reducers=[my321, "dft321"], metrics=[my_metric, "temporal_match"])
    assert own.index.tolist() == ["my321", "dft321"]
    assert own.loc["my321", "my_metric"] == my_metric(
        scene.acceleration, my321(scene.acceleration, 1e4), 1e4
    )
    one = stimuli.match(scene.acceleration, stimuli.reduce(scene, "soc321"), rate_hz=1e4)
    pd.testing.assert_frame_equal(one, table.loc[["soc321"]])
    with pytest.raises(TypeError, match=r"write \['dft321'\]"):
        stimuli.match(scene, reducers="dft321")


@pytest.mark.parametrize(("n", "window_s"), [(4000, 0.1), (4001, 0.035), (1234, 0.5), (7, 1.0)])
def test_a_density_is_welchs_and_holds_the_energy_of_its_windows(n: int, window_s: float) -> None:
    samples = np.random.default_rng(n).standard_normal((3, n)) + 5.0
    found = stimuli.psd(samples, rate_hz=1000.0, window_s=window_s)
    length = min(2 * int(window_s * 500 + 0.5), n)  # even, to the nearest
    frequencies, density = welch(
        samples, 1000.0, nperseg=length, noverlap=length // 2, detrend=False
    )
    np.testing.assert_allclose(found.density, density.sum(axis=0), rtol=1e-12)
    np.testing.assert_array_equal(found.frequencies_hz, frequencies)
    assert found.window_s == length / 1000
    # Parseval's theorem, on one window that holds the whole signal.
    whole = stimuli.psd(samples, rate_hz=1000.0, window_s=n / 1000 + 1)
    window = hann(n, sym=False)
    energy = np.sum((samples * window) ** 2) / np.sum(window**2)
    assert whole.density.sum() * whole.frequencies_hz[1] == pytest.approx(energy, rel=1e-12)


@pytest.mark.parametrize("level", [stimuli.felt_level, stimuli.sensation_level_db, stimuli.psd])
@pytest.mark.parametrize(
    ("signal", "rate_hz", "message"),
    [
        ([], 1000.0, "n >= 1, got"),
        (np.ones((2, 3, 9)), 1000.0, "n >= 1, got"),
        ([1.0, np.nan], 1000.0, "finite, got 1 values"),
        ([1j, 2j], 1000.0, "real numbers, got values of type complex128"),
        (np.ma.masked_less([1.0, -1.0], 0), 1000.0, "masked"),
        ([1.0, 2.0], 0.0, "rate_hz must be a finite number of Hz above 0, got 0.0"),
    ],
)
def test_a_damaged_signal_has_no_level_and_is_not_taken_for_silence(
    level: Any, signal: object, rate_hz: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        level(signal, rate_hz=rate_hz)


@pytest.mark.parametrize("metric", [*stimuli.METRICS.values(), *stimuli.INVARIANTS.values()])
def test_a_reduced_signal_of_another_rate_is_refused_and_its_own_rate_counts(
    scene: Recording, metric: Any
) -> None:
    reduced = stimuli.reduce(scene, "say321")
    slower = stimuli.reduce(replace(scene, rate_hz=5000.0), "say321")
    assert metric(scene.acceleration, reduced) == metric(scene, reduced)
    for compare in (metric, stimuli.match):
        with pytest.raises(ValueError, match="the recording's rate, 10000 Hz; got 5000 Hz"):
            compare(scene, slower)
