from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.measures import (
    LARGEST_DB,
    UNRELATED,
    find_spread,
    measure_takes,
    perturbation_gain,
    relative_change,
    vary,
)
from feel321.stimuli.match import OriginalSpectrum
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import random_rotations, rotation_statistics

POINTWISE = ("sax321", "say321", "saz321", "soc321", "mag321")


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def measure(reducer: Any, recording: Any, measure: str, *, clean: Any = None) -> np.ndarray:
    """One measure on six takes that are the same recording, each with its own noise, orientations and shift."""
    takes = vary([recording] * 6, [clean] * 6 if clean else (), rng=rng())
    return measure_takes(REDUCERS.get(reducer, reducer), takes)[measure]


def test_the_change_is_free_of_sign_and_scales_with_the_difference() -> None:
    output = rng().standard_normal(400)
    small = 0.01 * rng(1).standard_normal(400)
    expected = np.linalg.norm(small) / np.linalg.norm(output)
    assert relative_change(output + small, output) == pytest.approx(expected)
    assert relative_change(-(output + small), output) == pytest.approx(expected)
    assert relative_change(1e6 * output, output) == UNRELATED


def test_silence_that_stays_has_not_changed_and_silence_that_ends_has_in_full() -> None:
    silence = np.zeros(10)
    changed = relative_change(np.array([silence, silence + 1e-30]), silence)
    assert changed.tolist() == [0.0, UNRELATED]


def test_a_constant_phase_is_forgiven_where_asked() -> None:
    time = np.arange(1000) / 1000
    tones = [
        np.cos(2 * np.pi * (50 * time) + phase) + 0.5 * np.cos(2 * np.pi * 120 * time + phase)
        for phase in (0, 1)
    ]
    assert relative_change(tones[1], tones[0]) > 0.9
    assert relative_change(tones[1], tones[0], free="phase") < 1e-6


@pytest.mark.parametrize("name", ["sax321", "say321", "saz321", "soc321"])
def test_gain_of_a_linear_reducer_is_that_of_its_weights(name: str, drag: Any) -> None:
    """|R(n)| |a| / (|R(a)| |n|) to the last digit, draw by draw; white noise makes it sqrt(weights / 3)."""
    reduce = REDUCERS[name]
    gain = perturbation_gain(reduce, drag, rng=rng(), draws=1)
    noise = rng().standard_normal((1, *drag.acceleration.shape))[0]
    ratios = [
        np.linalg.norm(one)
        for one in (reduce(noise, 1), drag.acceleration, reduce(drag.acceleration, 1), noise)
    ]
    assert gain.median == pytest.approx(ratios[0] * ratios[1] / (ratios[2] * ratios[3]), rel=1e-9)
    assert gain.median == gain.worst


def test_gain_of_an_axis_that_holds_a_third_is_one(made: Any) -> None:
    axes = made(rng().standard_normal((3, 60000)))
    assert perturbation_gain(REDUCERS["say321"], axes, rng=rng(1)).median == pytest.approx(
        1, abs=0.02
    )


def test_a_gain_of_small_noise_does_not_depend_on_its_level(drag: Any) -> None:
    gains = [
        perturbation_gain(REDUCERS["pca321"], drag, rng=rng(), level_db=level).median
        for level in (-60, -80)
    ]
    assert gains[0] == pytest.approx(gains[1], rel=0.01)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_anti_phase_axes_upset_equation_4(seed: int) -> None:
    scene = BATTERY["anti_phase"].make(seed)
    for name in ("dft321", "dft321_windowed"):
        assert perturbation_gain(REDUCERS[name], scene, rng=rng(seed)).median > 100
    assert perturbation_gain(REDUCERS["pca321"], scene, rng=rng(seed)).median < 1


def test_on_circular_motion_the_gain_of_a_principal_axis_is_a_phase() -> None:
    scene = BATTERY["circular"].make(0)
    assert perturbation_gain(REDUCERS["pca321"], scene, rng=rng()).median > 100
    assert perturbation_gain(REDUCERS["pca321"], scene, rng=rng(), free="phase").median < 1


@pytest.mark.parametrize("name", ["pca321", "pca321_adaptive", "mag321"])
def test_what_no_rotation_changes(name: str, drag: Any) -> None:
    assert measure(name, drag, "rotation").max() < 1e-9
    assert measure(name, drag, "flip").max() < 1e-9


@pytest.mark.parametrize("name", ["sax321", "soc321", "dft321"])
def test_what_rotations_change(name: str, drag: Any) -> None:
    assert np.median(measure(name, drag, "rotation")) > 0.05


def test_flips_change_single_axes_by_a_sign_and_sums_in_earnest(drag: Any) -> None:
    assert measure("sax321", drag, "flip").max() == 0
    assert measure("soc321", drag, "flip").min() > 0.5


@pytest.mark.parametrize("name", POINTWISE)
def test_pointwise_reducers_do_not_care_when_the_motion_begins(name: str, drag: Any) -> None:
    assert measure(name, drag, "shift").max() == 0


def test_whole_spectra_shift_with_the_motion_and_frames_do_not(drag: Any) -> None:
    assert measure("dft321", drag, "shift").max() < 1e-12
    assert np.median(measure("dft321_windowed", drag, "shift")) > 0.001


@pytest.mark.parametrize(
    "scene", ["equal_eigenvalues", "anti_phase", "circular", "chirp", "clipping"]
)
def test_dft321_keeps_the_energy(scene: str) -> None:
    assert measure("dft321", BATTERY[scene].make(4), "energy") == pytest.approx(0, abs=1e-9)


def test_energy_errors_of_known_size(made: Any) -> None:
    u = np.sin(0.3 * np.arange(3000))
    same = made([u, u, u])
    assert measure("soc321", same, "energy") == pytest.approx(10 * np.log10(3))
    assert measure("sax321", same, "energy") == pytest.approx(-10 * np.log10(3))
    assert set(measure("sax321", made([0 * u, u, u]), "energy")) == {-LARGEST_DB}
    offset = made([u + 100, u - 7, u])
    assert measure("dft321", offset, "energy") == pytest.approx(0, abs=1e-9)


def test_window_edges_that_are_moved_are_found(drag: Any, made: Any) -> None:
    """A planted fault: every second half window is lost, so half the energy is at the wrong time."""

    def lose(acceleration: Any, rate_hz: float) -> Any:
        hop = round(0.0175 * rate_hz)
        kept = np.arange(acceleration.shape[-1]) // hop % 2
        return REDUCERS["pca321"](acceleration, rate_hz) * kept

    assert measure("pca321", drag, "edge").max() < 0.05
    assert measure(lose, drag, "edge") == pytest.approx(0.5, abs=0.1)
    silent = measure(lambda a, rate_hz: 0 * a[..., 0, :], drag, "edge")  # noqa: ARG005 - called as all reducers are
    assert set(silent) == {1.0}
    tap = np.zeros(200)
    tap[[50, 51]] = 1.0, -1.0
    assert measure("pca321", made([tap, 2 * tap, -tap]), "edge").max() < 1e-12


def test_linear_reducers_amplify_faults_by_their_weights(made: Any) -> None:
    u = rng().standard_normal(500)
    whole, cut = (made([v, 0 * u, 0 * u]) for v in (u, np.clip(u, -0.5, 0.5)))
    for name in ("sax321", "soc321"):
        assert measure(name, cut, "fault", clean=whole) == pytest.approx(1)
    assert np.isnan(measure("sax321", whole, "fault")).all()


def test_spread_of_metrics_is_that_of_the_rotation_statistics(drag: Any) -> None:
    turns, samples = random_rotations(200, rng())[None], drag.acceleration
    takes = vary([drag], rng=rng())._replace(turns=turns)
    (found,) = measure_takes(REDUCERS["soc321"], takes)["spread"]
    known = rotation_statistics(samples, ["soc321"], rng=rng(), rate_hz=drag.rate_hz).loc["soc321"]
    assert found == pytest.approx(max(known.spectral_sd, known.temporal_sd))


def test_a_recording_without_vibration_frequencies_has_a_temporal_spread_only() -> None:
    samples = rng().standard_normal((3, 4))
    turned = random_rotations(20, rng()) @ samples
    spread = find_spread(OriginalSpectrum(samples, 30), turned, REDUCERS["soc321"](turned, 30))
    assert spread > 0


def test_silence_has_no_gain(made: Any) -> None:
    with pytest.raises(ValueError, match="recording 'made' must have motion, got silence"):
        perturbation_gain(REDUCERS["soc321"], made(np.zeros((3, 50))), rng=rng())
