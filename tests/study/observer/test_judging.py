from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.trial import SURFACE, Judgement, Part, Trial
from feel321.study.observer.model import REAL, Experience, Location, ObserverModel, Touch
from feel321.study.observer.percepts import Percept, Sensation


def vary(model: ObserverModel, **changes: object) -> ObserverModel:
    return ObserverModel(**{**model.model_dump(), **changes})


WEIGHTS = {
    "spectral": 40.0,
    "temporal": 30.0,
    "threshold_spectral": 2.0,
    "envelope": 50.0,
    "level": 3.0,
}
MODEL = ObserverModel(**WEIGHTS)
TOUCH = Touch(MODEL, {})
WEAK = Location(0.6, 0.5, Percept(4.0, 0.2, -1.0))
STRONG = Location(0.2, 0.9, Percept(1.0, 0.1, 2.0))

shares = st.floats(0, 1)
points = st.builds(
    Location, shares, shares, st.builds(Percept, st.floats(0, 40), shares, st.floats(-30, 30))
)


def make_experience(
    protocol: str, felt: dict[str, Location], *, reference: str | None = None
) -> Experience:
    parts = tuple(Part(name, f"code-{name}") for name in felt)
    judgement = Judgement("test", "code-test", reference and f"code-{reference}")
    trial = Trial(1, 1, 1, protocol, protocol, "replay", "oak", parts, (judgement,))
    return Experience(trial, felt)


def ask(experience: Experience, *, touch: Touch = TOUCH) -> float:
    return touch.judge(experience, experience.trial.judgements[0])


def test_realism_is_the_stated_sum() -> None:
    assert TOUCH.feel(WEAK) == pytest.approx(10 + 24 + 15 - 8 - 10 - 3)
    assert TOUCH.feel(REAL) == pytest.approx(80)
    assert ask(make_experience("realism", {"test": WEAK})) == TOUCH.feel(WEAK)


def test_distance_is_the_stated_sum() -> None:
    assert TOUCH.measure_distance(WEAK, STRONG) == pytest.approx(16 + 12 + 6 + 5 + 9)


@pytest.mark.parametrize("level", [3.0, -3.0])
@given(a=points, b=points, c=points)
def test_distance_is_a_metric(level: float, a: Location, b: Location, c: Location) -> None:
    measure = Touch(vary(MODEL, level=level), {}).measure_distance
    assert measure(a, a) == 0
    assert measure(a, b) == measure(b, a) >= 0
    assert measure(a, c) <= measure(a, b) + measure(b, c) + 1e-9


@pytest.mark.parametrize("protocol", ["dissimilarity", "similarity", "abx"])
def test_two_that_lose_as_much_in_different_ways_are_apart(protocol: str) -> None:
    low, high = (
        Sensation(2.0, np.array([100.0, 1.0]), np.ones(4)),
        Sensation(2.0, np.array([1.0, 100.0]), np.ones(4)),
    )
    one, other = (Location(0.5, 0.5, Percept(14.0, 0.1, 0.0, sensed)) for sensed in (low, high))
    experience = make_experience(
        protocol, {"first": one, "test": other, "x": other}, reference="first"
    )
    expected = MODEL.threshold_spectral * 20.0  # dB, in both bands
    if protocol == "abx":
        assert TOUCH.compare(experience, Judgement("x", "?"), ("first", "test")) == pytest.approx({
            "first": expected,
            "test": 0.0,
        })
    else:
        answer = ask(experience)
        assert (100 - answer if protocol == "similarity" else answer) == pytest.approx(expected)


@given(points)
def test_similarity_to_the_original_loses_what_realism_loses_unless_stronger(
    point: Location,
) -> None:
    similarity = ask(
        make_experience("similarity", {"reference": REAL, "test": point}, reference="reference")
    )
    louder = max(point.percept.level_db, 0.0)
    lost = TOUCH.feel(REAL) - TOUCH.feel(point)
    assert similarity == pytest.approx(100 - lost - 2 * MODEL.level * louder)


@pytest.mark.parametrize("protocol", ["similarity", "mushra"])
def test_the_reference_is_as_similar_to_itself_as_anything_can_be(protocol: str) -> None:
    assert (
        ask(make_experience(protocol, {"reference": WEAK, "test": WEAK}, reference="reference"))
        == 100
    )
    assert ask(
        make_experience(protocol, {"reference": WEAK, "test": STRONG}, reference="reference")
    ) == pytest.approx(100 - TOUCH.measure_distance(WEAK, STRONG))


def test_dissimilarity_is_the_distance() -> None:
    assert ask(
        make_experience("dissimilarity", {"first": WEAK, "test": STRONG}, reference="first")
    ) == pytest.approx(48)
    assert (
        ask(make_experience("dissimilarity", {"first": WEAK, "test": WEAK}, reference="first"))
        == 0.0
    )


def test_an_explicit_reference_may_be_judged_hidden_too() -> None:
    parts = (Part("reference", "code"), Part("1", "code"))
    judgement = Judgement("1", "code", "code")
    trial = Trial(1, 1, 1, "mushra", "mushra", "free", "oak", parts, (judgement,))
    experience = Experience(trial, {"reference": WEAK, "1": WEAK})
    assert TOUCH.judge(experience, judgement) == 100


def test_the_real_surface_is_where_the_original_is() -> None:
    parts = (Part("reference", surface="oak"), Part("test", "code"))
    judgement = Judgement("test", "code", SURFACE)
    trial = Trial(1, 1, 1, "similarity", "similarity", "replay", "oak", parts, (judgement,))
    experience = Experience(trial, {"reference": TOUCH.locate(None), "test": WEAK})
    assert TOUCH.judge(experience, judgement) == pytest.approx(20 + TOUCH.feel(WEAK))


def test_candidates_are_as_far_as_they_feel_from_what_is_asked() -> None:
    experience = make_experience("abx", {"a": WEAK, "b": STRONG, "x": STRONG})
    assert TOUCH.compare(experience, Judgement("x", "?"), ("a", "b")) == {
        "a": pytest.approx(48),
        "b": 0.0,
    }


def test_of_two_the_distances_from_the_reference_count() -> None:
    parts = {"reference": REAL, "a": WEAK, "b": STRONG}
    experience = make_experience("triplet", parts, reference="reference")
    judgement = replace(experience.trial.judgements[0], part="a")
    assert TOUCH.compare(experience, judgement, ("a", "b")) == {
        "a": pytest.approx(TOUCH.measure_distance(REAL, WEAK)),
        "b": pytest.approx(TOUCH.measure_distance(REAL, STRONG)),
    }


def test_what_was_not_felt_cannot_be_judged() -> None:
    experience = make_experience("realism", {"test": WEAK})
    with pytest.raises(
        ValueError,
        match=r"part 'test' of trial 1 was to be rated before it was felt; play it first",
    ):
        ask(replace(experience, points={}))


def test_a_reference_that_no_part_holds_is_refused() -> None:
    experience = make_experience("similarity", {"test": WEAK}, reference="elsewhere")
    with pytest.raises(
        ValueError,
        match=r"trial 1: the reference must be the stimulus of one of its parts, got 'code-elsewhere'",
    ):
        ask(experience)


def test_an_unknown_protocol_is_refused() -> None:
    with pytest.raises(
        ValueError, match=r"protocol of a slider must be one of realism, similarity.*got 'pinching'"
    ):
        ask(make_experience("pinching", {"test": WEAK}))
