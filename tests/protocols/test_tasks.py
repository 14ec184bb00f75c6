from __future__ import annotations

import re
from typing import Any

import pytest

from feel321.protocols.tasks import PROTOCOLS, make_task
from feel321.protocols.trial import Task


@pytest.mark.parametrize("name", PROTOCOLS)
def test_a_task_takes_the_first_of_everything_unless_told_otherwise(name: str) -> None:
    protocol = PROTOCOLS[name]
    assert make_task(name) == Task(name, protocol.timings[0], "original")


@pytest.mark.parametrize("name", PROTOCOLS)
def test_every_timing_and_reference_that_a_protocol_declares_is_taken(name: str) -> None:
    protocol = PROTOCOLS[name]
    for timing in protocol.timings:
        assert make_task(name, timing=timing).timing == timing
    for kind in protocol.references:
        reference = "dft321" if kind == "reducer" else kind
        assert make_task(name, reference=reference).reference == reference


def test_what_is_asked_for_is_what_the_task_says() -> None:
    assert make_task("realism", timing="strict", surface=True, training=4, practice=2) == Task(
        "realism", "strict", surface=True, training=4, practice=2
    )


@pytest.mark.parametrize(
    ("name", "changes", "message"),
    [
        (
            "loudness",
            {},
            "protocol must be one of realism, similarity, dissimilarity, mushra, abx, triplet, preference; got "
            "'loudness'",
        ),
        ("mushra", {"timing": "strict"}, "tasks.mushra.timing must be one of free; got 'strict'"),
        (
            "similarity",
            {"timing": "free"},
            "tasks.similarity.timing must be one of replay, strict; got 'free'",
        ),
        (
            "realism",
            {"reference": "original"},
            "tasks.realism.reference must not be set, got 'original': nothing is compared with a reference "
            "here; leave it out",
        ),
        (
            "abx",
            {"reference": "surface"},
            "tasks.abx.reference must be one of original, the name of a reducer; got 'surface'",
        ),
        (
            "dissimilarity",
            {"reference": "dft321"},
            "tasks.dissimilarity.reference must be one of original; got 'dft321'",
        ),
        (
            "similarity",
            {"reference": ""},
            "tasks.similarity.reference must be one of original, surface, the name of a reducer; got ''",
        ),
        (
            "similarity",
            {"surface": True},
            "tasks.similarity.surface must be false, got true: nothing is judged by itself here; "
            "leave it out, or set reference = 'surface'",
        ),
        ("abx", {"surface": True}, "nothing is judged by itself here; leave it out"),
        ("abx", {"training": -1}, "tasks.abx.training must be a whole number from 0, got -1"),
        ("abx", {"practice": -2}, "tasks.abx.practice must be a whole number from 0, got -2"),
        ("preference", {"reference": "original"}, "nothing is compared with a reference here"),
        ("triplet", {"pairs": 0}, "tasks.triplet.pairs must be a whole number from 1, got 0"),
        (
            "abx",
            {"pairs": 3},
            "tasks.abx.pairs must not be set, got 3: only triplet and preference have it; leave it out",
        ),
    ],
)
def test_what_a_protocol_does_not_have_is_refused(
    name: str, changes: dict[str, Any], message: str
) -> None:
    with pytest.raises(ValueError, match=re.escape(message)) as refusal:
        make_task(name, **changes)
    assert "\n" not in str(refusal.value)
    assert ("reference = " in str(refusal.value)) == (name == "similarity" and "surface" in changes)
