from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.order import make_rehearsal
from feel321.protocols.tasks import PROTOCOLS, is_as_expected, make_task
from feel321.protocols.trial import Item

if TYPE_CHECKING:
    from feel321.protocols.trial import Trial

ROLES = {"original": "reference", "low": "anchor", "mid": "anchor"}
ITEMS = [
    Item(f"{recording}-{name}", recording, name, "as_is", ROLES.get(name, "test"))
    for recording in ("bumps", "drag", "taps")
    for name in ("sax321", "soc321", "dft321", "original", "low", "mid")
]


def rehearse(
    *names: str, seed: int = 1, items: list[Item] = ITEMS, **counts: Any
) -> tuple[Trial, ...]:
    tasks = [make_task(name, **counts) for name in names]
    return make_rehearsal(items, tasks, first_number=50, rng=np.random.default_rng(seed))


def get_side(trial: Trial) -> str:
    (judgement,) = trial.judgements
    return "" if judgement.expected is None else "high" if sum(judgement.expected) > 100 else "low"


@given(st.integers(0, 30), st.integers(0, 30), st.integers(0, 999))
def test_each_task_has_its_training_then_its_practice_and_never_more_than_there_is(
    training: int, practice: int, seed: int
) -> None:
    trials = rehearse(*PROTOCOLS, training=training, practice=practice, seed=seed)
    n_comparisons = {
        "realism": 18,
        "similarity": 18,
        "dissimilarity": 21,
        "mushra": 3,
        "abx": 15,
        "triplet": 15,
        "preference": 24,
    }
    asked = {"training": training, "practice": practice}
    expected = {
        (name, phase): min(n, asked[phase]) for name, n in n_comparisons.items() for phase in asked
    }
    # Anchors are felt in training only.
    expected["dissimilarity", "training"] = min(21 + 6, training)
    for name in ("abx", "triplet", "preference"):  # half of the guesses are right
        expected[name, "training"] = min(n_comparisons[name], 2 * training)
    assert Counter((t.protocol, t.phase) for t in trials) == Counter(expected)
    assert list(dict.fromkeys((t.protocol, t.phase) for t in trials)) == [
        key for key, n in expected.items() if n
    ]
    assert [t.number for t in trials] == list(range(50, 50 + len(trials)))
    assert {(t.block, t.repeat) for t in trials} <= {(0, 0)}


@given(st.integers(1, 18), st.integers(0, 999))
def test_trials_with_a_known_answer_come_first_and_no_answer_is_right_for_most(
    training: int, seed: int
) -> None:
    sides = [get_side(t) for t in rehearse("similarity", training=training, seed=seed)]
    n_known = sum(map(bool, sides))
    assert all(sides[:n_known])
    assert n_known >= min(training, 7)
    assert max(sides.count("high"), sides.count("low")) <= (training + 1) // 2


@given(st.integers(0, 999))
def test_anchors_are_what_differs_from_the_original_in_the_training_of_dissimilarity(
    seed: int,
) -> None:
    trials = rehearse("dissimilarity", training=4, practice=21, seed=seed)
    training = [t for t in trials if t.phase == "training"]
    assert Counter((t.catch, t.judgements[0].expected) for t in training) == {
        ("identical", (0, 25)): 2,
        ("anchor", (50, 100)): 2,
    }
    practised = {part.stimulus_id for t in trials if t.phase == "practice" for part in t.parts}
    assert not {item.stimulus_id for item in ITEMS if item.role == "anchor"} & practised


@given(st.integers(1, 8), st.booleans(), st.integers(0, 999))
def test_every_choice_in_training_is_right_or_wrong_and_the_plainest_come_first(
    training: int, with_anchors: bool, seed: int
) -> None:
    items = ITEMS if with_anchors else [item for item in ITEMS if item.role != "anchor"]
    trials = rehearse("abx", training=training, practice=2, seed=seed, items=items)
    assert {t.judgements[0].expected for t in trials if t.phase == "training"} == {(100, 100)}
    plain = [t.catch == "anchor" for t in trials if t.phase == "training"]
    assert plain == sorted(plain, reverse=True)
    assert sum(plain) == (min(2 * training, 6) if with_anchors else 0)
    assert {t.judgements[0].expected for t in trials if t.phase == "practice"} <= {None, (100, 100)}


@pytest.mark.parametrize("name", ["realism", "similarity", "dissimilarity", "mushra"])
@given(training=st.integers(2, 12), points=st.floats(0, 100), seed=st.integers(0, 999))
def test_nobody_passes_training_who_always_answers_the_same(
    name: str, training: int, points: float, seed: int
) -> None:
    rounds = [t for t in rehearse(name, training=training, seed=seed) if t.phase == "training"]
    met = [is_as_expected(t, {j.part: points for j in t.judgements}) for t in rounds]
    right = [understood for understood in met if understood is not None]
    assert sum(right) < 0.75 * len(right)
