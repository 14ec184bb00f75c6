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
            "protocol: got 'loudness', allowed: realism, similarity, dissimilarity, mushra, abx",
        ),
        ("mushra", {"timing": "strict"}, "tasks.mushra.timing: got 'strict', allowed: free"),
        (
            "similarity",
            {"timing": "free"},
            "tasks.similarity.timing: got 'free', allowed: replay, strict",
        ),
        (
            "realism",
            {"reference": "original"},
            "tasks.realism.reference: got 'original', allowed is none: each stimulus is judged by itself; leave it out",
        ),
        (
            "abx",
            {"reference": "surface"},
            "tasks.abx.reference: got 'surface', allowed: original, the name of a reducer",
        ),
        (
            "dissimilarity",
            {"reference": "dft321"},
            "tasks.dissimilarity.reference: got 'dft321', allowed: original",
        ),
        (
            "similarity",
            {"reference": ""},
            "tasks.similarity.reference: got '', allowed: original, surface, the name",
        ),
        (
            "similarity",
            {"surface": True},
            "tasks.similarity.surface: got true, allowed is false: nothing is judged by itself here; "
            "leave it out, or set reference = 'surface'",
        ),
        ("abx", {"surface": True}, "nothing is judged by itself here; leave it out"),
        (
            "abx",
            {"training": -1},
            "tasks.abx.training: got -1, allowed is a whole number of at least 0",
        ),
        (
            "abx",
            {"practice": -2},
            "tasks.abx.practice: got -2, allowed is a whole number of at least 0",
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
