from __future__ import annotations

from math import inf, nan

import numpy as np
import pytest

from analysis.tradeoff.advise.measures import SILENT_DB, Measures, find_change, find_level, make_trial, measure
from analysis.tradeoff.advise.scene import Context, split_recording
from analysis.tradeoff.advise.simplicity import Cost, find_cost
from analysis.tradeoff.advise.tolerance import Tolerance
from analysis.tradeoff.advise.verdict import Rated, Shortfall, Verdict, compare
from analysis.tradeoff.advise.wording import tell_choice, tell_closest, tell_doubt, tell_fault
from stimuli.recording import Recording
from stimuli.reduce import REDUCERS
from stimuli.synthesis import make_scene

COST = Cost("dft321", 1, 0.0, 0.0, 0.0, 0)
BEST = Measures(0.0, 1.0, 0.9, 1e-3, 1.0, 0.9)

MOTION = "the motion's energy"
HIDDEN = "loses 4.8 dB, which its gain hides (a sum of three axes is √3, 4.8 dB, louder)"


def order(*, online: bool, n: int = 40000, rate_hz: float = 10000.0) -> list[str]:
    costs = [find_cost(name, reducer, n_samples=n, rate_hz=rate_hz) for name, reducer in REDUCERS.items()]
    return [cost.name for cost in sorted(costs, key=lambda cost: cost.rank(online=online))]


def judged(shortfall: Shortfall, measures: Measures = BEST, **said: object) -> Verdict:
    return Verdict(COST, measures, shortfall, in_budget=True, **said)  # type: ignore[arg-type]  # fields of a test


@pytest.mark.parametrize("n", [1000, 40000, 3_000_000])
def test_offline_simplicity_goes_from_one_axis_to_the_transforms(n: int) -> None:
    names = order(online=False, n=n)
    known = ["sax321", "say321", "saz321", "soc321", "mag321", "pca321", "dft321", "pca321_adaptive", "dft321_windowed"]
    assert [name for name in names if name in known] == known


def test_online_what_waits_less_comes_first() -> None:
    names = order(online=True)
    known = ["sax321", "say321", "saz321", "soc321", "mag321", "pca321_adaptive", "dft321_windowed", "pca321", "dft321"]
    assert [name for name in names if name in known] == known


def test_every_reducer_has_a_record() -> None:
    assert set(order(online=False)) == set(REDUCERS)


def test_latency_and_parameters_are_the_reducers_own() -> None:
    windowed = find_cost("dft321_windowed", REDUCERS["dft321_windowed"], n_samples=5000, rate_hz=1000.0)
    assert (windowed.latency_ms, windowed.parameters) == (35.0, 1)
    assert find_cost("dft321", REDUCERS["dft321"], n_samples=5000, rate_hz=1000.0).latency_ms == inf


def test_one_axis_outranks_all_else() -> None:
    dear, two = Cost("a", 1, 1e9, inf, 1e9, 9), Cost("b", 2, 0.0, 0.0, 0.0, 0)
    assert all(dear.rank(online=online) < two.rank(online=online) for online in (True, False))


def test_tolerances_follow_from_the_weber_fraction() -> None:
    limits = Tolerance(0.21)
    assert limits.level_db == pytest.approx(10 * np.log10(1.21))
    assert limits.change == pytest.approx(0.1)
    assert (limits.spectrum, limits.time) == (0.21, 0.21)


@pytest.mark.parametrize("weber", [0, -0.1, 1, 22, nan])
def test_what_is_no_fraction_is_refused(weber: float) -> None:
    with pytest.raises(ValueError, match=r"tolerance: got .*, allowed is above 0 and below 1"):
        Tolerance(weber)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": 4}, "axes: got 4, allowed is 1, 2 or 3"),
        ({"axes": 0}, "axes: got 0, allowed is 1, 2 or 3"),
        ({"online": True, "latency_ms": -1.0}, "latency-ms: got -1, allowed is a finite time of 0 ms or more"),
        ({"online": True, "latency_ms": nan}, "latency-ms: got nan, allowed"),
        ({"latency_ms": 10.0}, "latency-ms: got 10 offline, where nobody waits; add --online"),
    ],
)
def test_a_context_that_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Context(**options)  # type: ignore[arg-type]  # that is the test


def test_budgets() -> None:
    assert Context().budget_ms == inf
    assert Context(online=True).budget_ms == 45.0
    assert Context(online=True, latency_ms=7.0).budget_ms == 7.0


@pytest.mark.parametrize(("segment_s", "lengths"), [(0.3, [300, 300, 400]), (0.4, [400, 400, 200]), (5.0, [1000])])
def test_segments_hold_every_sample_once(segment_s: float, lengths: list[int]) -> None:
    recording = Recording(np.random.default_rng(0).standard_normal((3, 1000)), 1000.0, "oak")
    scenes = list(split_recording(recording, segment_s))
    assert [scene.recording.n_samples for scene in scenes] == lengths
    together = np.concatenate([scene.recording.acceleration for scene in scenes], axis=1)
    assert np.array_equal(together, recording.acceleration)
    assert scenes[-1].name == ("oak" if len(lengths) == 1 else f"oak {1 - lengths[-1] / 1000:.2f}-1.00 s")


@pytest.mark.parametrize("segment_s", [0.05, 0.0, -1.0, nan])
def test_short_segments_are_refused(segment_s: float) -> None:
    with pytest.raises(ValueError, match=r"segment: got .* s, allowed is 0.1 s or more"):
        list(split_recording(make_scene("bumps", duration_s=1.0), segment_s))


def test_measures_of_known_outputs() -> None:
    u = np.random.default_rng(0).standard_normal(4000)
    trial = make_trial(Recording(np.array([2 * u, u, 0 * u]), 2000.0, "line"), "line", seed=0)
    found = measure("sax321", REDUCERS["sax321"], trial)
    assert found.level_db == pytest.approx(10 * np.log10(0.8))
    assert found.spectrum == pytest.approx(0.8)
    assert found.time == pytest.approx(1)
    assert found.temporal_match == pytest.approx(1)
    assert found.spectral_match == pytest.approx(0.8)
    assert found.spectral_match_bounded == pytest.approx(0.8)
    assert found.change == pytest.approx(1e-3 * np.sqrt(5 / 4 / 3), rel=0.05)


def test_silence_is_not_loud_and_changes_altogether() -> None:
    trial = make_trial(make_scene("bumps", duration_s=0.5), "bumps", seed=0)
    assert find_level(np.zeros(5000), trial) == SILENT_DB
    assert find_change(np.zeros(3), np.ones(3)) == 1.0
    assert find_change(np.ones(3), -np.ones(3)) == 0.0


def test_a_gain_does_not_make_up_for_what_is_lost() -> None:
    lucky = Measures(0.0, 1.0, 0.6, 0.0, 1.0, 0.6, gain_db=4.77)
    assert lucky.deviation_db == 4.77
    assert Measures(4.77, 1.0, 1.0, 0.0, 1.0, 1.0, gain_db=4.77).deviation_db == 4.77
    assert Measures(-1.0, 1.0, 1.0, 0.0, 1.0, 1.0).deviation_db == 1.0


def test_shortfalls_are_counted_from_the_best_in_tolerances() -> None:
    limits = Tolerance()
    other = Measures(-limits.level_db, 0.78, 0.9 * np.sqrt(0.78), 1e-3 + limits.change, 0.0, 0.0)
    best, found = compare([BEST, other], limits)
    assert best == Shortfall(0.0, 0.0, 0.0, 0.0)
    assert [found.level, found.spectrum, found.time, found.change] == pytest.approx([1, 1, 1, 1])
    nothing = Measures(SILENT_DB, 0.0, 0.0, 1.0, 0.0, 0.0)
    assert compare([nothing, nothing], limits)[0].worst == 0.0


@pytest.mark.parametrize(
    ("shortfall", "measures", "words"),
    [
        (Shortfall(2, 0, 0, 0), Measures(-2.0, 1, 1, 0, 1, 1), "is 2.0 dB too weak"),
        (Shortfall(2, 0, 0, 0), Measures(2.0, 1, 1, 0, 1, 1), "is 2.0 dB too strong"),
        (Shortfall(2, 0, 0, 0), Measures(0, 1, 1, 0, 1, 1, 4.77), HIDDEN),
        (Shortfall(0, 2, 0, 0), Measures(0, 0.5, 1, 0, 1, 1), "has 50 % of the spectrum right, the best 100 %"),
        (Shortfall(0, 0, 2, 0), Measures(0, 1, 0.5, 0, 1, 1), f"goes along with 25 % of {MOTION}, the best 81 %"),
        (Shortfall(0, 0, 0, 2), Measures(0, 1, 1, 0.4, 1, 1), "changes by 40 % with sensor noise of -60 dB"),
    ],
)  # fmt: skip
def test_every_fault_has_its_words(shortfall: Shortfall, measures: Measures, words: str) -> None:
    bad, best = judged(shortfall, measures), judged(Shortfall(0, 0, 0, 0))
    assert not bad.is_sufficient
    assert tell_fault(bad, [best, bad]) == words


def test_people_must_agree_where_they_were_asked() -> None:
    good = Shortfall(0.2, 0.0, 0.0, 0.0)
    best = Rated(is_best=True, best="dft321", p=nan)
    same, unlike, untested = (Rated(is_best=False, best="dft321", p=p) for p in (0.01, 0.3, nan))
    assert judged(good).is_sufficient
    assert judged(good, rated=best, needs_ratings=True).is_sufficient
    assert judged(good, rated=same, needs_ratings=True).is_sufficient
    said = {
        "is not shown to feel like dft321 (p of equivalence 0.3)": judged(good, rated=unlike, needs_ratings=True),
        "is not shown to feel like dft321, because so few ratings": judged(good, rated=untested, needs_ratings=True),
        "was not rated": judged(good, needs_ratings=True),
    }
    for words, verdict in said.items():
        assert not verdict.is_sufficient
        assert tell_fault(verdict, [verdict]).startswith(words)
    assert not judged(Shortfall(2, 0, 0, 0), rated=same, needs_ratings=True).is_sufficient


def test_reasons_name_close_calls_agreement_and_what_waits() -> None:
    near = judged(Shortfall(0.95, 0, 0, 0), rated=Rated(is_best=True, best="dft321", p=nan), needs_ratings=True)
    kept = "keeps 100 % of the spectrum, 81 % of the motion, the level to 0.0 dB"
    doubt = "a close call, another take may go the other way: dft321 passes by 5 % of the tolerance"
    assert tell_choice(near, [near]) == f"{kept}; nothing is simpler; people agree; {doubt}"
    robot = judged(Shortfall(0, 0, 0, 0), rated=Rated(is_best=True, best="dft321", p=nan, simulated=True))
    assert tell_choice(robot, [robot]) == f"{kept}; nothing is simpler; simulated participants agree"
    late = Verdict(Cost("pca321", 1, 0, inf, 0, 0), BEST, Shortfall(0, 0, 0, 0), in_budget=False)
    good = judged(Shortfall(0, 0, 0, 0))
    assert tell_choice(good, [late, good]).endswith("pca321 is simpler and would do, but needs the whole recording")
    missed = judged(Shortfall(1.1, 0, 0, 0), Measures(-0.95, 1, 1, 0, 1, 1))
    assert tell_doubt(good, [missed, good]).endswith(": dft321 misses by 10 % of the tolerance")
    assert tell_doubt(good, [good, missed]) == ""
    bad = judged(Shortfall(2, 0, 0, 0), Measures(-2.0, 1, 1, 0, 1, 1))
    assert tell_closest(bad, [bad]).endswith("no reducer is within tolerance of the best in everything")
