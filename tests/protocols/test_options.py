"""Several scales in a trial, and what a task's options refuse."""

from __future__ import annotations

from typing import Any

import pytest

from feel321.protocols.order import make_order, make_rehearsal
from feel321.protocols.tasks import PROTOCOLS, is_as_expected, make_task, refine_task, score_trial
from feel321.protocols.trial import Item, Judgement, ask_on_scales

ITEMS = [
    Item("oak-original", "oak", "original", "as_is", "reference"),
    Item("oak-sax321", "oak", "sax321", "as_is", "test"),
    Item("oak-anchor", "oak", "anchor_low", "as_is", "anchor"),
]
SLIDERS = [
    name
    for name, protocol in PROTOCOLS.items()
    if not (protocol.choices or "free" in protocol.timings)
]


@pytest.mark.parametrize("name", SLIDERS)
def test_each_judgement_is_asked_on_every_scale_in_order(name: str) -> None:
    plain = make_order(ITEMS, [make_task(name)], number=1)
    task = refine_task(make_task(name), scales=["roughness", name])
    trials = make_order(ITEMS, [task], number=1)
    assert [trial.parts for trial in trials] == [trial.parts for trial in plain]
    for trial, former in zip(trials, plain, strict=True):
        (part,) = former.judged
        assert trial.judged == [f"{part}:roughness", part]
        assert trial.scale == name
        assert trial.judgements[1] == former.judgements[0]
        assert trial.judgements[0].expected is None
        values = {part: 80.0, f"{part}:roughness": 10.0}
        assert score_trial(trial, values) == values
        assert is_as_expected(trial, values) == is_as_expected(former, {part: 80.0})


def test_training_knows_the_right_answer_on_the_own_scale_only() -> None:
    import numpy as np

    task = refine_task(make_task("similarity", training=2), scales=["similarity", "roughness"])
    trials = make_rehearsal(ITEMS, [task], first_number=1, rng=np.random.default_rng(1))
    assert [[bool(j.expected) for j in trial.judgements] for trial in trials] == [[True, False]] * 2
    frame = trials.to_frame()
    assert frame["scale"].tolist() == ["similarity", "roughness"] * 2


def test_without_scales_nothing_changes() -> None:
    judgements = (Judgement("test", "s"), Judgement("2", "s"))
    assert ask_on_scales(judgements, (), own="realism") == judgements
    assert refine_task(make_task("realism"), scales=["realism"]) == make_task("realism")


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
        ("mushra", {"answer_timeout_s": 9.0}, "mushra.answer_timeout_s must not be set: parts"),
    ],
)
def test_what_a_task_has_not_is_refused(name: str, options: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match="tasks") as caught:
        refine_task(make_task(name), **options)
    assert message in str(caught.value)


def test_no_fixed_onset_where_the_surface_is_touched() -> None:
    for task in (make_task("realism", surface=True), make_task("similarity", reference="surface")):
        with pytest.raises(ValueError, match=r"onset_s must not be set where the real surface"):
            refine_task(task, onset_s=5.0)
