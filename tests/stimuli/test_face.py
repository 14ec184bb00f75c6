"""What the face adds to the methods: recordings in place of arrays, names in place of functions, tables out."""

from __future__ import annotations

import pickle
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest

from feel321 import stimuli

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.stimuli import Recording


@pytest.fixture(scope="module")
def scene() -> Recording:
    return stimuli.make_scene("bumps", duration_s=0.6)


def my321(acceleration: np.ndarray, _: float) -> np.ndarray:
    return acceleration[0] - acceleration[2]


def my_metric(acceleration: np.ndarray, reduced: np.ndarray, _: float) -> float:
    return float(np.ptp(reduced) / np.ptp(acceleration))


@pytest.mark.parametrize("name", stimuli.REDUCERS)
def test_a_name_a_function_and_a_dotted_name_reduce_alike(name: str, scene: Recording) -> None:
    expected = stimuli.REDUCERS[name](scene.acceleration, scene.rate_hz)
    module = stimuli.REDUCERS[name].__module__
    for reducer in (name, stimuli.REDUCERS[name], f"{module}:{name}"):
        reduced = stimuli.reduce(scene, reducer)
        np.testing.assert_array_equal(reduced, expected)
        assert (reduced.reducer.rpartition(":")[2], reduced.recording) == (name, "bumps")


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
    assert table.columns.tolist() == list(stimuli.METRICS)
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


def test_details_add_up_to_their_match(scene: Recording) -> None:
    details = stimuli.spectral_match_details(scene, stimuli.reduce(scene, "say321"))
    energy, reduced = details.energy, details.energy_reduced
    assert details.value == pytest.approx(1 - np.mean(np.abs(energy - reduced) / energy))
    assert details.value == pytest.approx(1 - details.deviation.mean())
    assert details.frequencies_hz[[0, -1]].tolist() == [details.lowest_hz, details.highest_hz]
    assert len(repr(details)) <= 200
    assert pickle.loads(pickle.dumps(details)) == details  # noqa: S301 - our own bytes


def test_rotations_are_a_table_and_the_former_call_gives_the_same_numbers(scene: Recording) -> None:
    table = stimuli.rotation_statistics(scene, ["sax321", my321], rng=3)
    former = stimuli.rotation_statistics(
        scene.acceleration, scene.rate_hz, reducer="sax321", rng=np.random.default_rng(3)
    )
    assert table.loc["sax321", "temporal_sd"] == former.temporal_sd > 0.01
    assert (table["rotations"] == 200).all()


@pytest.mark.parametrize("window_s", [0.05, 0.25, 10.0])
def test_a_density_holds_the_power(window_s: float) -> None:
    noise = np.random.default_rng(0).standard_normal((3, 40_000))
    recording = stimuli.Recording(noise, 8000.0)
    spectrum = stimuli.psd(recording, window_s=window_s)
    power = float((spectrum.density * spectrum.frequencies_hz[1]).sum())
    assert power == pytest.approx(3.0, rel=0.05)
    image = stimuli.spectrogram(recording, window_s=window_s)
    np.testing.assert_allclose(image.density.mean(axis=1), spectrum.density)
    assert image.to_frame().shape == (len(image.frequencies_hz), len(image.times_s))
    assert spectrum.to_frame().index.name == "frequency_hz"
    single = stimuli.psd(noise[0], rate_hz=8000.0, window_s=window_s)
    assert float((single.density * single.frequencies_hz[1]).sum()) == pytest.approx(1, rel=0.05)


@pytest.mark.parametrize("signal", [np.ones((2, 9)), np.ones((2, 3, 9)), np.full(9, np.nan), []])
def test_a_density_is_refused_where_there_is_none(signal: object) -> None:
    for estimate in (stimuli.psd, stimuli.spectrogram):
        with pytest.raises(ValueError, match="signal must"):
            estimate(signal, rate_hz=1000.0)


def test_a_recording_is_cut_changed_and_shown(scene: Recording) -> None:
    part = scene.crop(0.1, 0.3)
    np.testing.assert_array_equal(part.acceleration, scene.acceleration[:, 1000:3000])
    assert (part.name, part.times_s[1], part.sha256 == scene.sha256) == ("bumps", 1e-4, False)
    renamed, slower = scene.with_(name="taps"), scene.with_(rate_hz=5000.0)
    assert (renamed.name, renamed.sha256) == ("taps", scene.sha256)
    assert (slower.duration_s, slower.sha256 == scene.sha256) == (1.2, False)
    in_g = stimuli.Recording(scene.acceleration / 9.80665, 1e4, "bumps", unit="g")
    np.testing.assert_allclose(in_g.acceleration, scene.acceleration)
    assert in_g.unit == in_g.with_(name="a").unit == "m/s^2"
    np.testing.assert_array_equal(in_g.with_(name="a").acceleration, in_g.acceleration)
    frame = scene.to_frame()
    assert (frame.columns.tolist(), frame.index.name, len(frame)) == ([*"xyz"], "time_s", 6000)
    assert "RMS" in scene.summary()
    assert pickle.loads(pickle.dumps(scene)) == scene  # noqa: S301 - our own bytes
    with pytest.raises(ValueError, match=r"unit must be one of m/s\^2, g, mg; got 'kg'"):
        stimuli.Recording([[0], [0], [0]], 1.0, unit="kg")


def test_a_folder_is_read_and_every_problem_is_reported_at_once(
    scene: Recording, tmp_path: Path
) -> None:
    for name in ("b", "a"):
        stimuli.write_wav(tmp_path / f"{name}.wav", scene.acceleration, 10_000)
    (tmp_path / "notes.md").write_text("not a recording")
    assert [one.name for one in stimuli.read_recordings(str(tmp_path), unit="g")] == ["a", "b"]
    assert [one.name for one in stimuli.read_recordings([tmp_path / "b.wav"])] == ["b"]
    (tmp_path / "c.csv").write_text("x,y\n1,2\n")
    (tmp_path / "d.wav").write_bytes(b"")
    with pytest.raises(ValueError, match=r"(?s)^c\.csv: .*\nd\.wav: .*$"):
        stimuli.read_recordings(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(ValueError, match="holds no recording"):
        stimuli.read_recordings(tmp_path / "empty")


def test_levels_take_a_recording(scene: Recording) -> None:
    for level in (stimuli.felt_level, stimuli.sensation_level_db):
        assert level(scene) == level(scene.acceleration, scene.rate_hz)
        assert level(stimuli.reduce(scene)) < level(scene) + 1


def test_a_seed_is_an_int_or_a_generator() -> None:
    made = stimuli.make_scene("hard_taps", rng=1, duration_s=0.5)
    assert made == stimuli.make_scene("hard_taps", seed=1, duration_s=0.5)
    drawn = stimuli.make_scene("hard_taps", rng=np.random.default_rng(1), duration_s=0.5)
    assert not np.array_equal(drawn.acceleration, made.acceleration)


@pytest.mark.parametrize("name", ["fade", "resample", "golden_vectors", "UNITS", "__version__"])
def test_names_that_left_the_face_still_work(name: str) -> None:
    assert name not in dir(stimuli)
    with pytest.warns(DeprecationWarning, match=f"{name} is deprecated"):
        assert getattr(stimuli, name)


def test_registries_list_their_names_and_survive_pickling() -> None:
    for registry in (stimuli.REDUCERS, stimuli.METRICS, stimuli.INVARIANTS, stimuli.SCENES):
        assert dict(pickle.loads(pickle.dumps(registry))) == dict(registry)  # noqa: S301 - our own bytes
        with pytest.raises(KeyError, match=next(iter(registry))):
            registry["no such name"]
    assert stimuli.REDUCERS.dft321 is stimuli.REDUCERS["dft321"]


def mean321(acceleration: np.ndarray, rate_hz: float) -> np.ndarray:  # noqa: ARG001 - a reducer's form
    return np.asarray(acceleration.mean(axis=-2))


def test_one_function_and_named_functions_are_reducers(scene: Recording) -> None:
    listed = stimuli.match(scene, reducers=[mean321])
    pd.testing.assert_frame_equal(stimuli.match(scene, reducers=mean321), listed)
    assert stimuli.match(scene, reducers={"mine": mean321}).index.tolist() == ["mine"]


@pytest.mark.parametrize("wrong", ["dft321", stimuli.REDUCERS["dft321"]])
def test_a_reducer_is_no_reduced_signal(scene: Recording, wrong: Any) -> None:
    with pytest.raises(TypeError, match="reducers="):
        stimuli.match(scene, wrong)


def test_conditioning_is_changed_by_its_fields(scene: Recording) -> None:
    steps = stimuli.Conditioning(crop_s=(0, 0.2))
    assert stimuli.condition(scene, crop_s=(0, 0.2)) == stimuli.condition(scene, steps)


def test_a_stimulus_is_found_by_its_place(scene: Recording, tmp_path: Path) -> None:
    built = stimuli.build_stimuli(scene, tmp_path / "set", reducers=["dft321"], anchors=False)
    assert built[0] is built.stimuli[0]
