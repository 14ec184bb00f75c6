from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress.battery import BATTERY
from feel321.analysis.tradeoff.stress.measures import (
    LARGEST_DB,
    UNRELATED,
    edge_error,
    energy_error,
    fault_gain,
    flip_change,
    metric_spread,
    perturbation_gain,
    relative_change,
    rotation_change,
    shift_change,
)
from feel321.stimuli.reducers.registry import REDUCERS

POINTWISE = ("sax321", "say321", "saz321", "soc321", "mag321")


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


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


def test_an_unknown_freedom_is_refused() -> None:
    with pytest.raises(ValueError, match="free: got 'delay', allowed is 'sign' or 'phase'"):
        relative_change(np.ones(2), np.ones(2), free="delay")


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
    assert rotation_change(REDUCERS[name], drag, rng=rng()).worst < 1e-9
    assert flip_change(REDUCERS[name], drag).worst < 1e-9


@pytest.mark.parametrize("name", ["sax321", "soc321", "dft321"])
def test_what_rotations_change(name: str, drag: Any) -> None:
    assert rotation_change(REDUCERS[name], drag, rng=rng()).median > 0.05


def test_flips_change_single_axes_by_a_sign_and_sums_in_earnest(drag: Any) -> None:
    assert flip_change(REDUCERS["sax321"], drag).worst == 0
    assert flip_change(REDUCERS["soc321"], drag).worst > 0.5


@pytest.mark.parametrize("name", POINTWISE)
def test_pointwise_reducers_do_not_care_when_the_motion_begins(name: str, drag: Any) -> None:
    assert shift_change(REDUCERS[name], drag, rng=rng()).worst == 0


def test_whole_spectra_shift_with_the_motion_and_frames_do_not(drag: Any) -> None:
    assert shift_change(REDUCERS["dft321"], drag, rng=rng()).worst < 1e-12
    assert shift_change(REDUCERS["dft321_windowed"], drag, rng=rng()).median > 0.001


@pytest.mark.parametrize(
    "scene", ["equal_eigenvalues", "anti_phase", "circular", "chirp", "clipping"]
)
def test_dft321_keeps_the_energy(scene: str) -> None:
    assert energy_error(REDUCERS["dft321"], BATTERY[scene].make(4)) == pytest.approx(0, abs=1e-9)


def test_energy_errors_of_known_size(made: Any) -> None:
    u = np.sin(0.3 * np.arange(3000))
    same = made([u, u, u])
    assert energy_error(REDUCERS["soc321"], same) == pytest.approx(10 * np.log10(3))
    assert energy_error(REDUCERS["sax321"], same) == pytest.approx(-10 * np.log10(3))
    assert energy_error(REDUCERS["sax321"], made([0 * u, u, u])) == -LARGEST_DB
    assert energy_error(REDUCERS["dft321"], made([u + 100, u - 7, u])) == pytest.approx(0, abs=1e-9)


def test_window_edges_that_are_moved_are_found(drag: Any) -> None:
    """A planted fault: every second half window is lost, so half the energy is at the wrong time."""

    def lose(acceleration: Any, rate_hz: float) -> Any:
        hop = round(0.0175 * rate_hz)
        return REDUCERS["pca321"](acceleration, rate_hz) * (
            np.arange(acceleration.shape[-1]) // hop % 2
        )

    assert edge_error(REDUCERS["pca321"], drag) < 0.05
    assert edge_error(lose, drag) == pytest.approx(0.5, abs=0.1)
    assert edge_error(lambda a, rate_hz: 0 * a[..., 0, :], drag) == 1  # noqa: ARG005 - called as all reducers are


def test_linear_reducers_amplify_faults_by_their_weights(made: Any) -> None:
    u = rng().standard_normal(500)
    whole, cut = (made([v, 0 * u, 0 * u]) for v in (u, np.clip(u, -0.5, 0.5)))
    for name in ("sax321", "soc321"):
        assert fault_gain(REDUCERS[name], cut, clean=whole) == pytest.approx(1)
    assert np.isnan(fault_gain(REDUCERS["sax321"], whole, clean=whole))


def test_spread_of_metrics_is_that_of_the_rotation_statistics(drag: Any) -> None:
    from feel321.stimuli.rotation import rotation_statistics

    spectral, temporal = metric_spread(REDUCERS["soc321"], drag, rng=rng(), draws=200)
    samples = drag.acceleration
    known = rotation_statistics(samples, drag.rate_hz, reducer="soc321", rotations=200, rng=rng())
    assert (spectral, temporal) == pytest.approx((known.spectral_sd, known.temporal_sd))


def test_a_recording_without_vibration_frequencies_has_no_spectral_spread(made: Any) -> None:
    spectral, temporal = metric_spread(
        REDUCERS["soc321"], made(rng().standard_normal((3, 4)), rate_hz=30), rng=rng()
    )
    assert np.isnan(spectral)
    assert temporal > 0


def test_silence_is_refused(made: Any, drag: Any) -> None:
    silence, reduce = made(np.zeros((3, 50))), REDUCERS["soc321"]
    for measure in (edge_error, energy_error, flip_change):
        with pytest.raises(ValueError, match="recording 'made': is silent"):
            measure(reduce, silence)
    for measure in (perturbation_gain, rotation_change, shift_change, metric_spread):
        with pytest.raises(ValueError, match="recording 'made': is silent"):
            measure(reduce, silence, rng=rng())
    with pytest.raises(ValueError, match="recording 'made': is silent"):
        fault_gain(reduce, drag, clean=silence)


def test_doors(made: Any, drag: Any) -> None:
    reduce = REDUCERS["soc321"]
    with pytest.raises(ValueError, match="clean: got 2000 samples, allowed is 50"):
        fault_gain(reduce, made(np.ones((3, 50))), clean=drag)
    with pytest.raises(ValueError, match="draws: got 0, allowed is 1 or more"):
        perturbation_gain(reduce, drag, rng=rng(), draws=0)
    with pytest.raises(ValueError, match="draws: got 1, allowed is 2 or more"):
        metric_spread(reduce, drag, rng=rng(), draws=1)
    with pytest.raises(ValueError, match="level_db: got 0, allowed is below 0 dB"):
        perturbation_gain(reduce, drag, rng=rng(), level_db=0)


def test_an_offset_alone_has_no_energy_to_keep(made: Any) -> None:
    with pytest.raises(ValueError, match="has an offset and no vibration"):
        energy_error(REDUCERS["soc321"], made(np.ones((3, 50))))
