from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from feel321.analysis.tradeoff.stress.battery import ADXL345_STEP, BATTERY
from feel321.analysis.tradeoff.stress.diagnosis import SIGNS, diagnose
from feel321.analysis.tradeoff.stress.measures import (
    FLIPS,
    MEASURES,
    StressCell,
    make_takes,
    measure_gains,
    measure_scene,
    measure_takes,
    relative_change,
)
from feel321.stimuli.reducers.registry import REDUCERS

KNOWN = [(scene.name, failing) for scene in BATTERY.values() for failing in scene.failing]
NEAR_A_LIMIT = 1.4


TIED = ("circular", "equal_eigenvalues")
"""Scenes whose two largest eigenvalues are equal."""


def test_two_scenes_have_no_principal_axis() -> None:
    for name, scene in BATTERY.items():
        variances = np.linalg.eigvalsh(np.cov(scene.make(8).acceleration))
        assert (variances[-1] - variances[-2] < 1e-9 * variances[-1]) == (name in TIED)


def find_cell(cells: Any, recording: str, reducer: str, *, measure: str) -> StressCell:
    (found,) = [
        cell
        for cell in cells
        if (cell.recording, cell.reducer, cell.measure) == (recording, reducer, measure)
    ]
    return found


def rests_on_rounding(cell: StressCell) -> bool:
    """Whether rounding chose the axis; another processor finds another figure then, but `gain` fails everywhere."""
    return cell.recording in TIED and cell.reducer == "pca321" and cell.measure != "gain"


def find_firm_failures(result: Any) -> set[tuple[str, str, str]]:
    """Failures that are not near their limit."""
    found = set()
    for cell in result:
        if abs(cell.value) >= NEAR_A_LIMIT * MEASURES[cell.measure].fails and not rests_on_rounding(
            cell
        ):
            found.add((cell.recording, cell.reducer, cell.measure))
    return found


@pytest.mark.parametrize(("scene", "failing"), KNOWN)
def test_what_must_fail_fails(scene: str, failing: Any, result: Any) -> None:
    assert find_cell(result.cells, scene, failing.reducer, measure=failing.measure).grade == "fails"


def test_every_scene_says_why_and_by_what_it_is_recognised() -> None:
    for name, scene in BATTERY.items():
        assert scene.name == name
        assert scene.reason.endswith(".")
        assert "\n" not in scene.reason
        assert set(scene.signs) <= set(SIGNS)
        assert bool(scene.signs) == (name not in {"ordinary_drag", "rate_mismatch"})
        assert {failing.reducer for failing in scene.failing} <= set(REDUCERS)


@pytest.mark.parametrize("name", BATTERY)
def test_scenes_are_seeded(name: str) -> None:
    first, again, other = (BATTERY[name].make(seed).acceleration for seed in (1, 1, 2))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("name", [name for name, scene in BATTERY.items() if scene.signs])
def test_every_scene_is_recognised_by_its_own_signs(name: str) -> None:
    assert name in diagnose(BATTERY[name].make(0)).near_scenes


def test_the_control_comes_near_nothing() -> None:
    assert diagnose(BATTERY["ordinary_drag"].make(0)).near_scenes == ()


def test_faults_do_what_they_say() -> None:
    steps = BATTERY["quantisation"].make(0).acceleration / ADXL345_STEP
    assert np.allclose(steps, np.round(steps), atol=1e-9)
    clipped, whole = (
        BATTERY["clipping"].make(0).acceleration,
        BATTERY["clipping"].make_clean(0).acceleration,
    )
    assert np.abs(clipped).max() == pytest.approx(0.35 * np.abs(whole).max())
    missing = BATTERY["missing_samples"]
    gone = ~missing.make(0).acceleration.any(axis=0)
    assert 0.03 < gone.mean() <= 0.06
    assert np.array_equal(
        missing.make(0).acceleration[:, ~gone], missing.make_clean(0).acceleration[:, ~gone]
    )
    plain = BATTERY["circular"]
    assert np.array_equal(plain.make(0).acceleration, plain.make_clean(0).acceleration)


def test_conclusions_hold_for_another_seed(result: Any) -> None:
    """No firm failure of one seed is good in the other; the very short scene is another motion every time.

    A standard deviation over four orientations is not firm.
    """
    names = ("say321", "soc321", "pca321", "pca321_adaptive", "dft321")
    few = {name: REDUCERS[name] for name in names}
    other = {
        (cell.recording, cell.reducer, cell.measure): cell
        for scene in BATTERY
        for cell in measure_scene(scene, few, takes=4, seed=8)
        if cell.measure != "spread" and cell.recording != "very_short"
    }
    firm = [key for key in find_firm_failures(result.cells) if key in other]
    assert len(firm) > 50
    assert [key for key in firm if other[key].grade == "good"] == []
    here = [
        find_cell(result.cells, key[0], key[1], measure=key[2])
        for key in find_firm_failures(other.values())
    ]
    assert [cell for cell in here if cell.grade == "good"] == []


def test_a_gain_depends_on_its_own_recording_alone(drag: Any, made: Any) -> None:
    other = made(np.random.default_rng(0).standard_normal((3, 300)), name="other")
    few = {name: REDUCERS[name] for name in ("soc321", "dft321")}
    together = [measure_gains(one, few, draws=3, seed=1) for one in (other, drag)]
    one = {"dft321": REDUCERS["dft321"]}
    alone = measure_gains(drag, one, draws=3, seed=1)
    assert together[1][-1:] == alone


def test_a_figure_is_judged_by_its_median_and_a_caution_where_one_take_in_ten_fails() -> None:
    assert StressCell("a", "b", "shift", value=0.0, worst=1.0).grade == "good"
    # One take in ten fails.
    assert StressCell("a", "b", "shift", value=0.0, worst=1.0, p90=0.3).grade == "caution"
    assert StressCell("a", "b", "energy", value=-4.0, worst=-4.0).grade == "fails"
    assert (
        StressCell("a", "b", "fault", value=float("nan"), worst=float("nan")).grade == "undefined"
    )


def test_limits_are_in_order_and_argued() -> None:
    letters = [measure.letter for measure in MEASURES.values()]
    assert len(set(letters)) == len(letters)
    for name, measure in MEASURES.items():
        assert measure.name == name
        assert 0 < measure.caution < measure.fails
        assert measure.why.endswith(".")
        assert measure.what.endswith(".")


@pytest.mark.parametrize(
    "name", ["soc321", "dft321", "pca321_adaptive", "mag321", "pca321_matched_windowed"]
)
@pytest.mark.parametrize("scene", ["missing_samples", "impulse_at_edge", "very_short"])
def test_takes_are_measured_as_single_recordings_are(name: str, scene: str) -> None:
    takes, reduce = make_takes(scene, takes=3, seed=2), REDUCERS[name]
    found = measure_takes(reduce, takes)
    for place in range(3):
        take = BATTERY[scene].make(2000 + place)
        np.testing.assert_array_equal(takes.samples[place], take.acceleration)
        samples, output = take.acceleration, reduce(take.acceleration, take.rate_hz)
        shares = [find_shares(samples, take.rate_hz), find_shares(output[None], take.rate_hz)]
        apart = np.abs(shares[0] - shares[1]).sum() / 2
        assert found["edge"][place] == pytest.approx(apart, abs=1e-9)
        energy_db = 10 * np.log10(output.var() / samples.var(axis=-1).sum())
        assert found["energy"][place] == pytest.approx(energy_db, abs=1e-9)
        flipped = [
            relative_change(reduce(signs[:, None] * samples, take.rate_hz), output)
            for signs in FLIPS
        ]
        assert found["flip"][place] == pytest.approx(max(flipped), abs=1e-9)
        noisy = reduce(samples + takes.noise[place], take.rate_hz)
        gain = relative_change(noisy, output) / 1e-3
        assert found["gain"][place] == pytest.approx(gain, rel=1e-6)
        if BATTERY[scene].fault:
            clean = BATTERY[scene].make_clean(2000 + place).acceleration
            share = np.linalg.norm(samples - clean) / np.linalg.norm(clean)
            damage = relative_change(output, reduce(clean, take.rate_hz)) / share
            assert found["fault"][place] == pytest.approx(damage, rel=1e-6)
        else:
            assert np.isnan(found["fault"][place])


def find_shares(signal: np.ndarray, rate_hz: float) -> np.ndarray:
    """Share of the energy about the mean in each half window, one after the other."""
    hop = round(0.0175 * rate_hz)
    energy = np.square(signal - signal.mean(axis=-1, keepdims=True)).sum(axis=0)
    parts = [energy[start : start + hop].sum() for start in range(0, len(energy), hop)]
    return np.array(parts) / energy.sum()


def test_quantiles_are_those_over_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes = np.arange(1.0, 41.0)

    def measured(*_: Any) -> dict[str, np.ndarray]:
        return {key: -sizes if key == "energy" else sizes for key in (*MEASURES, "phase")}

    monkeypatch.setattr("feel321.analysis.tradeoff.stress.measures.measure_takes", measured)
    few = {"mag321": REDUCERS["mag321"]}
    gain, *_ = cells = measure_scene("circular", few, takes=40, seed=0)
    assert (gain.value, gain.p90, gain.p95, gain.worst) == pytest.approx((20.5, 36.1, 38.05, 40.0))
    assert gain.up_to_phase == 20.5
    energy = next(cell for cell in cells if cell.measure == "energy")
    assert (energy.value, energy.p90, energy.worst) == pytest.approx((-20.5, 36.1, 40.0))
