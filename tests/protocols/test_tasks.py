"""Options of tasks, several scales in a trial, and the groups of a design."""

from __future__ import annotations

import re
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from feel321.protocols.order import make_order, make_rehearsal
from feel321.protocols.tasks import is_as_expected, make_task, score_trial
from feel321.protocols.trial import Item, place_in_groups, select_group, select_items

ITEMS = [
    Item("oak-original", "oak", "original", "as_is", "reference"),
    Item("oak-sax321", "oak", "sax321", "as_is", "test"),
    Item("oak-anchor", "oak", "anchor_low", "as_is", "anchor"),
]


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "loudness",
            {},
            "protocol must be one of realism, similarity, dissimilarity, mushra, abx,",
        ),
        ("mushra", {"timing": "strict"}, "tasks.mushra.timing must be one of free; got 'strict'"),
        ("similarity", {"timing": "free"}, "must be one of replay, strict; got 'free'"),
        (
            "realism",
            {"reference": "original"},
            "tasks.realism.reference must not be set, got 'orig",
        ),
        ("preference", {"reference": "original"}, "nothing is compared with a reference here"),
        ("abx", {"reference": "surface"}, "one of original, the name of a reducer; got 'surface'"),
        ("dissimilarity", {"reference": "dft321"}, "must be one of original; got 'dft321'"),
        ("similarity", {"reference": ""}, "original, surface, the name of a reducer; got ''"),
        ("similarity", {"surface": True}, "leave it out, or set reference = 'surface'"),
        ("abx", {"surface": True}, "nothing is judged by itself here; leave it out"),
        ("abx", {"training": -1}, "tasks.abx.training must be a whole number from 0, got -1"),
        ("abx", {"practice": -2}, "tasks.abx.practice must be a whole number from 0, got -2"),
        ("triplet", {"pairs": 0}, "tasks.triplet.pairs must be a whole number from 1, got 0"),
        ("abx", {"pairs": 3}, "must not be set, got 3: only triplet and preference have it; leave"),
    ],
)
def test_what_a_protocol_does_not_have_is_refused(
    name: str, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as refusal:
        make_task(name, **changes)
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("abx", {"scales": ["abx", "sure"]}, "several scales are for tasks with one slider"),
        ("mushra", {"scales": ["mushra", "rough"]}, "several scales are for tasks with one slider"),
        ("realism", {"scales": ["roughness"]}, "must hold 'realism', the protocol's own, got"),
        ("realism", {"scales": ["realism", "rough", "rough"]}, "at most 4 names, each once"),
        ("realism", {"scales": ["realism", *"abcd"]}, "at most 4 names, each once"),
        ("realism", {"scales": ["realism", "abx", "mushra"]}, "another task, got 'abx', 'mushra'"),
        ("realism", {"scales": ["realism", "matching"]}, "another task, got 'matching'"),
        ("realism", {"gap_s": 31.0}, "tasks.realism.gap_s must be 0 to 30, got 31"),
        ("realism", {"answer_timeout_s": 0.1}, "answer_timeout_s must be 0.5 to 600, got 0.1"),
        ("realism", {"onset_s": 601.0}, "onset_s must be 0.5 to 600, got 601"),
        ("mushra", {"gap_s": 1.0}, "tasks.mushra.gap_s must not be set: parts are felt at will"),
        ("mushra", {"onset_s": 9.0}, "tasks.mushra.onset_s must not be set: parts are felt at"),
    ],
)
def test_scales_and_paces_that_a_task_has_not_are_refused(
    name: str, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)):
        make_task(name, **options)


def test_no_fixed_onset_where_the_surface_is_touched() -> None:
    for name, options in (("realism", {"surface": True}), ("similarity", {"reference": "surface"})):
        with pytest.raises(ValueError, match=r"onset_s must not be set where the real surface"):
            make_task(name, onset_s=5.0, **options)


@pytest.mark.parametrize("name", ["realism", "similarity", "dissimilarity"])
def test_each_judgement_is_asked_on_every_scale_in_order(name: str) -> None:
    plain = make_order(ITEMS, [make_task(name)], number=1)
    task = make_task(name, training=2, scales=["roughness", name])
    trials = make_order(ITEMS, [task], number=1)
    assert [trial.parts for trial in trials] == [trial.parts for trial in plain]
    assert trials.to_frame()["scale"].tolist() == ["roughness", name] * len(trials)
    for trial, former in zip(trials, plain, strict=True):
        (part,) = former.judged
        assert (trial.judged, trial.scale) == ([f"{part}:roughness", part], name)
        assert trial.judgements[1] == former.judgements[0]
        assert trial.judgements[0].expected is None
        values = {part: 80.0, f"{part}:roughness": 10.0}
        assert score_trial(trial, values) == values
        assert is_as_expected(trial, values) == is_as_expected(former, {part: 80.0})
    lessons = make_rehearsal(ITEMS, [task], first_number=1, rng=np.random.default_rng(1))
    assert [[bool(j.expected) for j in one.judgements] for one in lessons] == [[False, True]] * 2
    assert make_task(name, scales=[name]) == make_task(name)


@given(st.lists(st.integers(1, 4), max_size=4), st.integers(1, 600))
def test_successive_participants_go_through_all_combinations_in_order(
    sizes: list[int], number: int
) -> None:
    between = {f"factor{f}": [f"level{n}" for n in range(size)] for f, size in enumerate(sizes)}
    combinations = list(product(*between.values()))
    groups, place = place_in_groups(between, number)
    assert list(groups) == list(between)
    assert tuple(groups.values()) == combinations[(number - 1) % len(combinations)]
    assert place == (number - 1) // len(combinations) + 1


def test_a_group_has_its_own_levels_and_tasks_and_shared_references() -> None:
    items = [Item("t-x", "t", "dft321", "x", "test"), Item("t-y", "t", "dft321", "y", "test")]
    shared = Item("t-o", "t", "original", "x", "reference")
    tasks = [make_task("realism"), make_task("abx")]
    assert select_items([*items, shared], {"level": "y"}) == (items[1], shared)
    assert select_items([*items, shared], {"grip": "pen"}) == (*items, shared)
    own = select_group([*items, shared], tasks, {"protocol": "abx", "level": "y"})
    assert own == ((items[1], shared), (tasks[1],))
    assert select_group(items, tasks, {}) == (tuple(items), tuple(tasks))
