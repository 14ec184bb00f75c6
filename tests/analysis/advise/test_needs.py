"""What must hold: the needs of scenes that an engineer knows beforehand."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.advise.scene import Context, Tolerance
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rotation import random_rotations
from feel321.stimuli.synthesis import SCENES, make_scene

if TYPE_CHECKING:
    from collections.abc import Callable

    from feel321.analysis.tradeoff.advise.choice import SceneAdvice

    Tell = Callable[..., SceneAdvice]

AXIS = {"sax321", "say321", "saz321"}
RUNNING = {f"{name}_matched_running" for name in AXIS}
ENERGY = {name for name in REDUCERS if name.startswith("dft321") or "matched" in name}
WHOLE = {
    "pca321",
    "dft321",
    "dft321_principal",
    "dft321_bands",
    "pca321_matched",
    *(f"{name}_matched" for name in AXIS),
}
NO_DELAY = {"dft321_filtered"}
AS_RECORDED = Context(mounting="recorded")


def online(latency_ms: float, **options: Any) -> Context:
    return Context(online=True, latency_ms=latency_ms, block_ms=0.0, device_ms=0.0, **options)


@pytest.mark.parametrize(
    ("file", "axis"),
    [("shaker_x_5k.npz", "sax321"), ("shaker_y_5k.csv", "say321"), ("decay_5k.csv", "sax321")],
)
@pytest.mark.parametrize("axes", [1, 3])
def test_shakers_need_the_axis_that_carries_them_and_no_more(
    real: Callable[[str], Recording], tell: Tell, file: str, axis: str, axes: int
) -> None:
    advice = tell(real(file), Context(axes=axes, mounting="recorded"))
    assert advice.answer == axis
    assert advice.margin > 0.7


@pytest.mark.parametrize("file", ["shaker_x_5k.npz", "shaker_y_5k.csv", "decay_5k.csv"])
def test_shakers_need_their_axis_found_where_the_mounting_is_not_known(
    real: Callable[[str], Recording], tell: Tell, file: str
) -> None:
    advice = tell(real(file))
    assert advice.answer == "pca321"
    assert advice.margin > 0.7
    assert not advice.close


@pytest.mark.parametrize("seed", [1, 2])
def test_energy_before_a_tap_is_not_sufficient(tell: Tell, seed: int) -> None:
    """Taps whose axes ring at frequencies of their own: a spectrum of all of them puts energy before each."""
    rng = np.random.default_rng(seed)
    n, rate_hz = 8000, 4000.0
    t = np.arange(n) / rate_hz
    samples = 1e-3 * rng.standard_normal((3, n))
    for start in np.arange(0.2, 1.9, 0.35):
        later = np.maximum(t - start, 0)
        frequencies = rng.uniform(120, 400, (3, 1))
        samples += (
            rng.standard_normal((3, 1))
            * np.exp(-later / 0.012)
            * np.sin(2 * np.pi * frequencies * later)
        )
    verdicts = {each.name: each for each in tell(Recording(samples, rate_hz, "taps")).verdicts}
    for name in ("dft321", "dft321_principal"):
        whole, windowed = (verdicts[each].shortfall.envelope for each in (name, f"{name}_windowed"))
        assert whole > 2
        assert not verdicts[name].is_sufficient
        assert windowed < whole / 2


@pytest.mark.parametrize("name", ["circular_motion", "isotropic_rumble"])
def test_where_no_direction_leads_the_call_is_close(tell: Tell, name: str) -> None:
    advice = tell(make_scene(name, duration_s=2.0))
    assert advice.close
    assert "no direction leads" in advice.reason


def test_advice_holds_for_any_other_mounting(tell: Tell) -> None:
    recordings = [make_scene(name, duration_s=2.0) for name in SCENES]
    once = [tell(recording) for recording in recordings]
    for turn in random_rotations(2, np.random.default_rng(5)):
        turned = [
            replace(one, acceleration=turn @ one.acceleration, sha256="") for one in recordings
        ]
        for advice, other in zip(once, map(tell, turned), strict=True):
            assert advice.close or other.close or other.answer == advice.answer


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_isotropic_noise_needs_all_of_its_energy(
    real: Callable[[str], Recording], tell: Tell, seed: int
) -> None:
    white = Recording(np.random.default_rng(seed).standard_normal((3, 8000)), 4000.0, "white")
    for recording in (
        real("isotropic_noise_20k.wav"),
        make_scene("isotropic_rumble", rng=seed),
        white,
    ):
        advice = tell(recording, seed=seed)
        assert "matched" in str(advice.answer)
        assert {verdict.name for verdict in advice.verdicts if verdict.is_sufficient} <= ENERGY


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_constrained_drag_is_served_by_its_line(tell: Tell, seed: int) -> None:
    assert tell(make_scene("constrained_drag", rng=seed, duration_s=2.0)).answer == "pca321"


@pytest.mark.parametrize("ratio", [1.0, 0.9, 0.5])
@pytest.mark.parametrize("context", [Context(), Context(online=True), online(0)])
def test_axes_against_each_other_are_never_added(
    tell: Tell, wave: np.ndarray, ratio: float, context: Context
) -> None:
    advice = tell(
        Recording(np.array([wave, -ratio * wave, 0 * wave]), 4000.0, "anti-phase"), context
    )
    assert "soc321" not in {advice.answer, advice.closest, advice.runner_up}
    assert not next(
        verdict for verdict in advice.verdicts if verdict.name == "soc321"
    ).is_sufficient


def test_phase_that_noise_decides_is_not_advised(tell: Tell, wave: np.ndarray) -> None:
    # The sum of the axes vanishes, so dft321 has energy and spectrum right, and a phase that is noise.
    other = np.roll(wave, 700)
    mixed = np.array([wave + 0.6 * other, -wave + 0.6 * other, -1.2 * other])
    verdicts = {
        each.name: each
        for each in tell(Recording(mixed, 4000.0, "sum is nothing"), AS_RECORDED).verdicts
    }
    assert not verdicts["dft321"].is_sufficient
    assert verdicts["dft321"].shortfall.change > 1
    assert verdicts["dft321"].shortfall.spectrum == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("name", SCENES)
def test_whoever_drops_energy_of_three_axes_does_not_pass(tell: Tell, name: str) -> None:
    advice = tell(make_scene(name, duration_s=1.0))
    assert not AXIS & {verdict.name for verdict in advice.verdicts if verdict.is_sufficient}


def test_an_inaudible_difference_from_the_best_passes(tell: Tell, wave: np.ndarray) -> None:
    rng = np.random.default_rng(0)
    bit = 0.05 * wave.std() * rng.standard_normal((2, len(wave)))
    scene = Recording(np.array([wave, *bit]), 4000.0, "nearly one axis")
    assert tell(scene, AS_RECORDED).answer == "sax321"
    louder = {
        **REDUCERS,
        "sax321": lambda acceleration, rate_hz: 1.05 * REDUCERS["sax321"](acceleration, rate_hz),
    }
    assert tell(scene, AS_RECORDED, reducers=louder).answer == "sax321"
    too_loud = {
        **REDUCERS,
        "sax321": lambda acceleration, rate_hz: 1.2 * REDUCERS["sax321"](acceleration, rate_hz),
    }
    assert tell(scene, AS_RECORDED, reducers=too_loud).answer == "sax321_matched"
    assert tell(scene).answer == "pca321"


@pytest.mark.parametrize("name", SCENES)
def test_a_small_budget_leaves_out_what_waits(tell: Tell, name: str) -> None:
    recording = make_scene(name, duration_s=1.0)
    usual = {each.name for each in tell(recording, Context(online=True)).verdicts if each.in_budget}
    small = {each.name for each in tell(recording, online(5)).verdicts if each.in_budget}
    assert not usual & WHOLE
    assert small == AXIS | RUNNING | {"soc321", "mag321", "dft321_filtered"}


def test_the_budget_is_for_reducer_block_and_device(tell: Tell) -> None:
    recording = make_scene("constrained_drag", duration_s=1.0)
    for context, window_ms in (
        (Context(online=True, latency_ms=20), 10),
        (online(20), 20),
        (Context(online=True, latency_ms=20, block_ms=0, device_ms=4), 15),
    ):
        running = [each for each in tell(recording, context).verdicts if each.in_budget]
        windows = {name.partition("@")[2] for each in running if "@" in (name := each.name)}
        assert max(int(window.removesuffix("ms")) for window in windows) == window_ms
        assert max(each.cost.latency_ms for each in running) + context.overhead_ms <= 20


def test_windows_shorter_than_the_usual_are_advised_where_that_is_too_late(tell: Tell) -> None:
    for name in SCENES:
        advice = tell(make_scene(name, duration_s=2.0), Context(online=True, latency_ms=20))
        assert advice.answer is not None


def test_nothing_in_the_budget_says_so_and_what_would_do(tell: Tell) -> None:
    scene = make_scene("circular_motion", duration_s=1.0)
    assert tell(scene, online(5)).answer == "dft321_filtered"
    framed = {name: one for name, one in REDUCERS.items() if name not in NO_DELAY}
    advice = tell(scene, online(5), reducers=framed)
    assert advice.answer is None
    assert advice.margin < 0
    assert advice.line.startswith("circular_motion: nothing suffices, closest ")
    assert "pca321_matched_windowed would suffice, but needs 34.9 ms" in advice.line
    assert "\n" not in advice.line


def test_what_is_simpler_but_too_late_is_named(tell: Tell) -> None:
    advice = tell(make_scene("constrained_drag", duration_s=1.0), Context(online=True))
    assert advice.answer == "pca321_adaptive@10ms"


def test_ties_say_so(tell: Tell, wave: np.ndarray) -> None:
    alike = Recording(np.array([wave, wave, wave]), 4000.0, "alike")
    few = {name: REDUCERS[name] for name in ("dft321", *sorted(AXIS))}
    advice = tell(alike, online(0, mounting="recorded"), reducers=few)
    assert (advice.closest, advice.ties) == ("sax321", ("say321", "saz321"))
    assert "closest sax321 (tied with say321, saz321)" in advice.line
    noise = Recording(np.random.default_rng(2).standard_normal((3, 8000)), 4000.0, "white")
    # Over mountings the three are equal.
    assert tell(noise).ties == ("say321_matched", "saz321_matched")


@pytest.mark.parametrize("name", ["texture_drag", "hard_taps", "circular_motion"])
def test_order_unit_and_seed_of_the_noise_do_not_matter(tell: Tell, name: str) -> None:
    recording = make_scene(name, duration_s=1.0)
    first = tell(recording)
    turned = dict(reversed([*REDUCERS.items()]))
    in_mg = replace(recording, acceleration=recording.acceleration / 9.80665e-3, sha256="")
    for other in (
        tell(recording, reducers=turned),
        tell(in_mg),
        *(tell(recording, seed=seed) for seed in (1, 2)),
    ):
        assert (other.answer, other.closest) == (first.answer, first.closest)
        assert [each.name for each in other.verdicts] == [each.name for each in first.verdicts]
        assert other.margin == pytest.approx(first.margin, abs=1e-3)


def test_a_wider_tolerance_never_asks_for_more(tell: Tell) -> None:
    recording = make_scene("bumps", duration_s=1.0)
    places = []
    for weber in (0.05, 0.22, 0.5, 0.9):
        advice = tell(recording, Context(tolerance=Tolerance(weber)))
        sufficient = {each.name for each in advice.verdicts if each.is_sufficient}
        assert not places or places[-1] <= sufficient
        places.append(sufficient)
    assert places[0] < places[-1]


@pytest.mark.parametrize(
    ("samples", "problem"),
    [
        (np.zeros((3, 4000)), "it is silent from 20 to 1000 Hz"),
        (np.ones((3, 50)), r"it lasts 0.013 s and 20 Hz need 0.1 s"),
    ],
)
def test_a_scene_without_vibration_gets_no_advice(
    tell: Tell, samples: np.ndarray, problem: str
) -> None:
    advice = tell(Recording(samples, 4000.0, "calm"))
    assert advice.answer is advice.closest is None
    assert advice.line == f"calm: no advice, {problem}"


def test_a_rate_too_low_for_touch_gets_no_advice(tell: Tell) -> None:
    slow = Recording(np.random.default_rng(0).standard_normal((3, 300)), 30.0, "slow")
    assert tell(slow).line == "slow: no advice, it is silent from 20 to 1000 Hz"


def test_an_actuator_of_several_axes_is_used_only_where_it_helps(tell: Tell) -> None:
    answers = {
        name: tell(make_scene(name, duration_s=2.0), Context(axes=3)).answer for name in SCENES
    }
    assert answers["constrained_drag"] == "pca321"
    assert answers["circular_motion"] == "two_principal_axes"
    assert answers["isotropic_rumble"] == "three_axes"
    names = [
        each.name for each in tell(make_scene("bumps", duration_s=1.0), Context(axes=2)).verdicts
    ]
    assert names[-1] == "two_principal_axes"


def test_an_unknown_reducer_is_refused(tell: Tell) -> None:
    with pytest.raises(
        ValueError, match="reducer 'mine' must have its state and operations recorded"
    ):
        tell(make_scene("bumps", duration_s=1.0), reducers={"mine": REDUCERS["sax321"]})
