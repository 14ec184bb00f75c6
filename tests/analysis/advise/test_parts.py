from __future__ import annotations

from dataclasses import replace
from math import inf, nan

import numpy as np
import pytest

from feel321.analysis.tradeoff.advise.choice import (
    describe_doubt,
    describe_fault,
    explain_choice,
    explain_closest,
    find_deciding,
)
from feel321.analysis.tradeoff.advise.measures import (
    SILENT_DB,
    TREATS_ALIKE,
    TURNS_ALONG,
    Complexity,
    Contender,
    MountedSegment,
    Scores,
    Segment,
    complete_scores,
    cut_segments,
    find_change,
    find_complexity,
    score_scene,
    spread_turns,
)
from feel321.analysis.tradeoff.advise.scene import (
    Context,
    Rated,
    Shortfall,
    Tolerance,
    Verdict,
    compare,
    split_recording,
)
from feel321.stimuli.recording import Recording
from feel321.stimuli.reducers.registry import REDUCERS
from feel321.stimuli.rivals.envelope import modulation_distance
from feel321.stimuli.rotation import (
    random_rotations,
    spectral_match_energy_weighted,
    temporal_match_invariant,
)
from feel321.stimuli.sets.anchors import felt_level
from feel321.stimuli.synthesis import make_scene

COST = Complexity("dft321", 1, 0.0, 0.0, 0.0, 0)
BEST = Scores(0.0, 1.0, 0.9, 1e-3, 1.0, 0.9)

MOTION = "the motion's energy"
HIDDEN = "loses 4.8 dB, which its gain hides (a sum of three axes is √3, 4.8 dB, louder)"


def order(*, online: bool, n: int = 40000, rate_hz: float = 10000.0) -> list[str]:
    costs = [
        find_complexity(name, reducer, n_samples=n, rate_hz=rate_hz)
        for name, reducer in REDUCERS.items()
    ]
    return [cost.name for cost in sorted(costs, key=lambda cost: cost.rank(online=online))]


def judged(shortfall: Shortfall, measures: Scores = BEST, **said: object) -> Verdict:
    return Verdict(COST, measures, shortfall, in_budget=True, **said)  # type: ignore[arg-type]  # fields of a test


@pytest.mark.parametrize("n", [1000, 40000, 3_000_000])
def test_offline_simplicity_goes_from_one_axis_to_the_transforms(n: int) -> None:
    names = order(online=False, n=n)
    known = [
        "sax321",
        "say321",
        "saz321",
        "soc321",
        "mag321",
        "pca321",
        "dft321",
        "pca321_adaptive",
        "dft321_windowed",
    ]
    assert [name for name in names if name in known] == known


def test_online_what_waits_less_comes_first() -> None:
    names = order(online=True)
    known = [
        "sax321",
        "say321",
        "saz321",
        "soc321",
        "mag321",
        "pca321_adaptive",
        "dft321_windowed",
        "pca321",
        "dft321",
    ]
    assert [name for name in names if name in known] == known


def test_every_reducer_has_a_record() -> None:
    assert set(order(online=False)) == set(REDUCERS)


def test_latency_and_parameters_are_the_reducers_own() -> None:
    windowed = find_complexity(
        "dft321_windowed", REDUCERS["dft321_windowed"], n_samples=5000, rate_hz=1000.0
    )
    assert (windowed.latency_ms, windowed.parameters) == (35.0, 1)
    assert (
        find_complexity("dft321", REDUCERS["dft321"], n_samples=5000, rate_hz=1000.0).latency_ms
        == inf
    )


def test_one_axis_outranks_all_else() -> None:
    dear, two = Complexity("a", 1, 1e9, inf, 1e9, 9), Complexity("b", 2, 0.0, 0.0, 0.0, 0)
    assert all(dear.rank(online=online) < two.rank(online=online) for online in (True, False))


def test_tolerances_follow_from_the_weber_fraction() -> None:
    limits = Tolerance(0.21)
    assert limits.level_db == pytest.approx(10 * np.log10(1.21))
    assert limits.change == limits.envelope == pytest.approx(0.1)
    assert (limits.spectrum, limits.time) == (0.21, 0.21)


@pytest.mark.parametrize("weber", [0, -0.1, 1, 22, nan])
def test_what_is_no_fraction_is_refused(weber: float) -> None:
    with pytest.raises(ValueError, match="weber must be above 0 and below 1, got"):
        Tolerance(weber)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"axes": 4}, "axes must be 1, 2 or 3, got 4"),
        ({"axes": 0}, "axes must be 1, 2 or 3, got 0"),
        (
            {"online": True, "latency_ms": -1.0},
            "latency_ms must be a finite time of 0 ms or more, got -1",
        ),
        (
            {"online": True, "device_ms": -1.0},
            "device_ms must be a finite time of 0 ms or more, got -1",
        ),
        (
            {"online": True, "latency_ms": 5.0},
            r"latency_ms must be at least 6.33, which block \(1.33 ms\) and device \(5 ms\) alone",
        ),
        ({"mounting": "turned"}, "mounting must be any or recorded, got 'turned'"),
        ({"online": True, "latency_ms": nan}, "latency_ms must be a finite time .*, got nan"),
        (
            {"latency_ms": 10.0},
            "latency_ms must be left out offline, where nobody waits, got 10; set online=True",
        ),
    ],
)
def test_a_context_that_cannot_be_is_refused(options: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Context(**options)  # type: ignore[arg-type]  # that is the test


def test_budgets() -> None:
    assert Context().budget_ms == inf
    assert Context(online=True).budget_ms == 45.0
    assert Context(online=True, latency_ms=7.0).budget_ms == 7.0
    assert Context(online=True, latency_ms=7.0, block_ms=1.0, device_ms=2.5).room_ms == 3.5


@pytest.mark.parametrize(
    ("segment_s", "lengths"), [(0.3, [300, 300, 400]), (0.4, [400, 400, 200]), (5.0, [1000])]
)
def test_segments_hold_every_sample_once(segment_s: float, lengths: list[int]) -> None:
    recording = Recording(np.random.default_rng(0).standard_normal((3, 1000)), 1000.0, "oak")
    scenes = list(split_recording(recording, segment_s))
    assert [scene.recording.n_samples for scene in scenes] == lengths
    together = np.concatenate([scene.recording.acceleration for scene in scenes], axis=1)
    assert np.array_equal(together, recording.acceleration)
    assert scenes[-1].name == (
        "oak" if len(lengths) == 1 else f"oak {1 - lengths[-1] / 1000:.2f}-1.00 s"
    )


@pytest.mark.parametrize("segment_s", [0.05, 0.0, -1.0, nan])
def test_short_segments_are_refused(segment_s: float) -> None:
    with pytest.raises(ValueError, match=r"segment_s must be 0.1 s or more, got"):
        list(split_recording(make_scene("bumps", duration_s=1.0), segment_s))


def test_measures_of_known_outputs() -> None:
    u = np.random.default_rng(0).standard_normal(4000)
    segment = Segment(np.array([2 * u, u, 0 * u]), 2000.0, np.random.default_rng(1))
    sax = Contender("sax321", REDUCERS["sax321"])
    found = complete_scores(
        sax, MountedSegment(segment, np.eye(3)), segment.score(sax.reduce, segment.both)
    )
    assert found.level_db == pytest.approx(10 * np.log10(0.8))
    assert found.spectrum == pytest.approx(0.8)
    assert found.time == pytest.approx(1)
    assert found.temporal_match == pytest.approx(1)
    assert found.spectral_match == pytest.approx(0.8)
    assert found.spectral_match_bounded == pytest.approx(0.8)
    assert found.change == pytest.approx(1e-3 * np.sqrt(5 / 4 / 3), rel=0.05)


@pytest.mark.parametrize("name", REDUCERS)
def test_scores_are_the_published_metrics(name: str) -> None:
    scene = make_scene("bumps", duration_s=0.5)
    samples, rate_hz = scene.acceleration, scene.rate_hz
    segment = Segment(samples, rate_hz, np.random.default_rng(1))
    reduced = REDUCERS[name](samples, rate_hz)
    level_db, spectrum, time, _, envelope = segment.score(REDUCERS[name], segment.both)
    felt = felt_level(reduced, rate_hz) / felt_level(samples, rate_hz)
    assert level_db == pytest.approx(20 * np.log10(felt), abs=0.02)
    assert spectrum == pytest.approx(spectral_match_energy_weighted(samples, reduced, rate_hz))
    assert time == pytest.approx(temporal_match_invariant(samples, reduced))
    assert envelope == pytest.approx(modulation_distance(samples, reduced, rate_hz))


def test_silence_is_not_loud_and_changes_altogether() -> None:
    scene = make_scene("bumps", duration_s=0.5)
    segment = Segment(scene.acceleration, scene.rate_hz, np.random.default_rng(1))
    silent = segment.score(lambda samples, _: 0 * samples[..., 0, :], segment.both)
    assert silent[:4].tolist() == [SILENT_DB, 0.0, 0.0, 1.0]
    assert (
        silent[4] > 0.4
    )  # of a silent output nothing is known: the recording's depths, or what they lack
    assert find_change(np.zeros(3), np.ones(3)) == 1.0
    assert find_change(np.ones(3), -np.ones(3)) == 0.0


@pytest.mark.parametrize("name", sorted(TREATS_ALIKE & set(REDUCERS)))
def test_what_is_said_of_turns_and_permutations_is_true(name: str) -> None:
    rng = np.random.default_rng(4)
    acceleration = np.diag([1.0, 2.0, 0.6]) @ rng.standard_normal((3, 900))
    turns = (
        spread_turns(4, rng)
        if name in TURNS_ALONG
        else [np.roll(np.eye(3), step, axis=0) for step in (1, 2)]
    )
    once = REDUCERS[name](acceleration, 1000.0)
    assert all(
        find_change(once, REDUCERS[name](turn @ acceleration, 1000.0)) < 1e-9 for turn in turns
    )


def test_orientations_are_rotations_spread_evenly() -> None:
    turns = spread_turns(24, np.random.default_rng(0))
    np.testing.assert_allclose(
        turns @ np.swapaxes(turns, 1, 2), np.broadcast_to(np.eye(3), turns.shape), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(turns), 1)
    drawn = [
        np.linalg.norm(random_rotations(24, np.random.default_rng(seed)).mean(axis=0))
        for seed in range(40)
    ]
    spread = [
        np.linalg.norm(spread_turns(24, np.random.default_rng(seed)).mean(axis=0))
        for seed in range(40)
    ]
    assert np.median(spread) < 0.6 * np.median(drawn)  # the mean over all rotations is 0


def test_leaving_out_what_has_failed_changes_nothing_for_the_others(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = make_scene("circular_motion", duration_s=1.0)
    candidates = {
        name: Contender(name, REDUCERS[name]) for name in ("say321", "dft321", "pca321_matched")
    }

    def judge_levels(scores: np.ndarray) -> np.ndarray:
        return np.abs(scores[..., :1]) / Tolerance().level_db

    draws, scores = score_scene(scene, candidates, judge_levels, any_mounting=True, seed=0)
    monkeypatch.setattr("feel321.analysis.tradeoff.advise.measures.HOPELESS", np.inf)
    _, full = score_scene(scene, candidates, judge_levels, any_mounting=True, seed=0)
    assert len(draws) == 72
    assert np.isnan(scores[0]).any()
    assert not np.isnan(scores[1:]).any()
    known = ~np.isnan(scores)
    np.testing.assert_array_equal(scores[known], full[known])


@pytest.mark.parametrize(
    ("duration_s", "count"), [(0.5, 1), (2.9, 1), (3.1, 2), (4.9, 2), (9.0, 5)]
)
def test_segments_of_about_two_seconds(duration_s: float, count: int) -> None:
    samples = np.random.default_rng(0).standard_normal((3, round(1009 * duration_s)))
    parts = cut_segments(Recording(samples, 1009.0, "oak"))
    assert len(parts) == count
    assert sum(part.shape[1] for part in parts) > 0.95 * samples.shape[1]


def test_quiet_segments_do_not_count() -> None:
    samples = np.random.default_rng(0).standard_normal((3, 6000)) * np.repeat(
        [1.0, 0.05, 0.5], 2000
    )
    first, last = cut_segments(Recording(samples, 1000.0, "oak"))
    np.testing.assert_array_equal(first, samples[:, :2000])
    np.testing.assert_array_equal(last, samples[:, 4000:])


def test_the_worst_mounting_of_the_worst_segment_decides_or_of_that_at_the_90th_percentile() -> (
    None
):
    scene = make_scene("bumps", duration_s=0.2)
    segments = [
        Segment(scene.acceleration, scene.rate_hz, np.random.default_rng(0)) for _ in range(10)
    ]
    draws = [MountedSegment(segment, np.eye(3)) for segment in segments for _ in range(2)]
    worst = np.arange(20.0) / 10
    worst[3] = np.nan
    # Of ten segments the worst but one.
    assert find_deciding(draws, worst) == (17, [True] * 5 + [False] * 5)
    assert find_deciding(draws[:6], worst[:6]) == (5, [True] * 3)


def test_a_gain_does_not_make_up_for_what_is_lost() -> None:
    lucky = Scores(0.0, 1.0, 0.6, 0.0, 1.0, 0.6, gain_db=4.77)
    assert lucky.deviation_db == 4.77
    assert Scores(4.77, 1.0, 1.0, 0.0, 1.0, 1.0, gain_db=4.77).deviation_db == 4.77
    assert Scores(-1.0, 1.0, 1.0, 0.0, 1.0, 1.0).deviation_db == 1.0


def test_shortfalls_are_counted_from_the_best_in_tolerances() -> None:
    limits = Tolerance()
    other = [-limits.level_db, 0.78, 0.9 * np.sqrt(0.78), 1e-3 + limits.change]
    other += [0.02 + limits.envelope]
    scores = np.array([[[0.0, 1.0, 0.9, 1e-3, 0.02]], [other], [[np.nan] * 5]])
    best, found, untried = compare(scores, np.zeros((3, 1)), limits)
    np.testing.assert_allclose(best, 0.0)
    np.testing.assert_allclose(found, 1.0)
    assert np.isnan(untried).all()
    nothing = np.array([[[SILENT_DB, 0.0, 0.0, 1.0, 1.0]]] * 2)
    np.testing.assert_array_equal(compare(nothing, np.zeros((2, 1)), limits), 0.0)
    lucky = compare(scores[:1], np.array([[4.77]]), limits)
    np.testing.assert_allclose(lucky, 0.0)  # it is its own best
    hidden = compare(scores[[0, 0]], np.array([[0.0], [4.77]]), limits)
    assert hidden[1, 0, 0] == pytest.approx(4.77 / limits.level_db)


@pytest.mark.parametrize(
    ("shortfall", "measures", "words"),
    [
        (Shortfall(2, 0, 0, 0), Scores(-2.0, 1, 1, 0, 1, 1), "is 2.0 dB too weak"),
        (Shortfall(2, 0, 0, 0), Scores(2.0, 1, 1, 0, 1, 1), "is 2.0 dB too strong"),
        (Shortfall(2, 0, 0, 0), Scores(0, 1, 1, 0, 1, 1, 4.77), HIDDEN),
        (
            Shortfall(0, 2, 0, 0),
            Scores(0, 0.5, 1, 0, 1, 1),
            "gets 50 % of the spectrum right, the best 100 %",
        ),
        (
            Shortfall(0, 0, 2, 0),
            Scores(0, 1, 0.5, 0, 1, 1),
            f"carries 25 % of {MOTION}, the best 81 %",
        ),
        (
            Shortfall(0, 0, 0, 2),
            Scores(0, 1, 1, 0.4, 1, 1),
            "changes by 40 % with sensor noise of -60 dB",
        ),
        (
            Shortfall(0, 0, 0, 0, 2),
            Scores(0, 1, 1, 0, 1, 1, envelope=0.4),
            "smears the envelope: the depth of its modulation is off by 40 %",
        ),
    ],
)
def test_every_fault_has_its_words(shortfall: Shortfall, measures: Scores, words: str) -> None:
    bad = judged(shortfall, measures, best_time=0.9)
    assert not bad.is_sufficient
    assert describe_fault(bad) == words


def test_people_must_agree_where_they_were_asked() -> None:
    good = Shortfall(0.2, 0.0, 0.0, 0.0)
    best = Rated(is_best=True, best="dft321", p=nan)
    same, unlike, untested = (Rated(is_best=False, best="dft321", p=p) for p in (0.01, 0.3, nan))
    assert judged(good).is_sufficient
    assert judged(good, rated=best, needs_ratings=True).is_sufficient
    assert judged(good, rated=same, needs_ratings=True).is_sufficient
    said = {
        "is not shown to feel like dft321 (p of equivalence 0.3)": judged(
            good, rated=unlike, needs_ratings=True
        ),
        "is not shown to feel like dft321: too few ratings": judged(
            good, rated=untested, needs_ratings=True
        ),
        "was not rated": judged(good, needs_ratings=True),
    }
    for words, verdict in said.items():
        assert not verdict.is_sufficient
        assert describe_fault(verdict).startswith(words)
    assert not judged(Shortfall(2, 0, 0, 0), rated=same, needs_ratings=True).is_sufficient


def test_reasons_name_close_calls_agreement_and_what_waits() -> None:
    near = judged(
        Shortfall(0.95, 0, 0, 0),
        rated=Rated(is_best=True, best="dft321", p=nan),
        needs_ratings=True,
    )
    kept = "keeps 100 % of the spectrum, 81 % of the motion, the level to 0.0 dB"
    doubt = "a close call, another take could reverse it: dft321 passes by 5 % of the tolerance"
    assert explain_choice(near, [near]) == f"{kept}; nothing is simpler; people agree"
    assert describe_doubt(near, [near], 0.5) == doubt
    robot = judged(
        Shortfall(0, 0, 0, 0), rated=Rated(is_best=True, best="dft321", p=nan, simulated=True)
    )
    assert (
        explain_choice(robot, [robot])
        == f"{kept}; nothing is simpler; simulated participants agree"
    )
    late = Verdict(
        Complexity("pca321", 1, 0, inf, 0, 0), BEST, Shortfall(0, 0, 0, 0), in_budget=False
    )
    good = judged(Shortfall(0, 0, 0, 0))
    assert explain_choice(good, [late, good]).endswith(
        "pca321 is simpler and would suffice, but needs the whole recording"
    )
    missed = judged(Shortfall(1.1, 0, 0, 0), Scores(-0.95, 1, 1, 0, 1, 1))
    assert describe_doubt(good, [missed, good], 0.5).endswith(
        ": dft321 misses by 10 % of the tolerance"
    )
    assert describe_doubt(good, [good, missed], 0.5) == ""
    partly = judged(Shortfall(1.5, 0, 0, 0), suits=1, segments=2)
    # Dft321: that may be the mountings that were tried.
    assert describe_doubt(good, [partly, good], 0.5) == ""
    leading = Verdict(
        Complexity("pca321@20ms", 1, 0, 0, 0, 0),
        BEST,
        Shortfall(2, 0, 0, 0),
        True,
        suits=1,
        segments=2,
    )
    assert describe_doubt(good, [leading, good], 0.5).endswith(
        "could reverse it: pca321@20ms suffices in 1 of 2 segments"
    )
    both = [
        replace(leading, segments=3),
        leading,
        good,
    ]  # the last, which is the least simple, is named
    assert describe_doubt(good, both, 0.5).endswith(": pca321@20ms suffices in 1 of 2 segments")
    assert describe_doubt(good, [good], 0.97).endswith("no direction leads (λ₂ / λ₁ is 0.97)")
    bad = judged(Shortfall(2, 0, 0, 0), Scores(-2.0, 1, 1, 0, 1, 1))
    assert explain_closest(bad, [bad]).endswith(
        "no reducer is within tolerance of the best in everything"
    )
