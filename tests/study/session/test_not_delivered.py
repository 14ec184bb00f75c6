"""A stimulus that did not reach the sensor as asked: named, tried again, and kept with the digest of its file."""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any

import pytest

from feel321.protocols.trial import Flow
from feel321.study.auditing.journals import audit_journals
from feel321.study.session.events import find_loss
from feel321.study.session.plan import require_plan
from feel321.study.session.ports import Playback

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    Present = Callable[..., list[Any]]

GOOD = {
    "level_error_db": 0.5,
    "coherence": 0.95,
    "polarity": 1.0,
    "rms_m_s2": 2.0,
    "lag": 960.0,
    "is_calibrated": 1.0,
    "is_measured": 1.0,
}


def fail(**changes: float) -> dict[str, float]:
    return {**GOOD, **changes}


@pytest.mark.parametrize(
    ("delivered", "fault"),
    [
        ({}, ""),
        ({"level_error_db": -60.0}, ""),  # predicted: nothing says that it was so
        (GOOD, ""),
        (fail(rms_m_s2=0.0, coherence=0.0), "the sensor is silent"),
        (fail(coherence=0.05), "no trace of the stimulus (coherence 0.05, at least 0.3)"),
        (fail(level_error_db=-6.0), "6.0 dB too weak (at most 3.0 dB)"),
        (fail(level_error_db=6.0), "6.0 dB too strong"),
        (fail(polarity=-1.0), "inverted"),
        (fail(level_error_db=-6.0, polarity=-1.0, is_calibrated=0.0, is_measured=0.0), ""),
        (fail(coherence=0.05, is_calibrated=0.0), "no trace"),
        (fail(polarity=-1.0, is_measured=0.0), ""),  # typed gains know no polarity
    ],
)
def test_a_loss_is_named(delivered: dict[str, float], fault: str) -> None:
    found = find_loss(delivered, Flow())
    assert fault in found
    assert bool(found) == bool(fault)


def test_limits_are_those_of_the_study() -> None:
    weak = fail(level_error_db=-6.0, coherence=0.2)
    assert find_loss(weak, Flow(level_error_db=None, min_coherence=0.1)) == ""
    assert "weak" in find_loss(weak, Flow(level_error_db=5.9, min_coherence=0.1))
    assert "no trace" in find_loss(weak, Flow(level_error_db=None, min_coherence=0.25))


def test_what_was_not_delivered_comes_again_unanswered(present: Present, scripted: type) -> None:
    lost = [Playback(1.0, 1.5, delivered=fail(coherence=0.01))]
    presenter = scripted(playbacks={(11, 1): list(lost)})
    records = present(presenter)
    own = [r for r in records if r.data.get("trial") == 11]
    assert [r.event for r in own] == [
        "shown",
        "played",
        "spoiled",
        "shown",
        "played",
        "played",
        "rated",
    ]
    assert own[2].data["flags"] == ["not_delivered"]
    assert own[1].data["delivered"] == fail(coherence=0.01)
    assert "delivered" not in own[4].data
    assert records[-1].data == {"trials": 20, "given_up": 0}


def test_a_stimulus_that_is_never_delivered_is_given_up(present: Present, scripted: type) -> None:
    lost = {(3, n): [Playback(1.0, 1.5, delivered=fail(coherence=0.01))] for n in (1, 2, 3)}
    records = present(scripted(playbacks=lost))
    assert records[-1].data == {"trials": 20, "given_up": 1}


def test_a_dead_coil_uses_up_no_trials(present: Present, scripted: type) -> None:
    lost = {
        (trial, attempt): [Playback(1.0, 1.5, delivered=fail(coherence=0.01))]
        for trial in range(1, 11)
        for attempt in range(1, 5)
    }
    records = present(scripted(playbacks=lost))
    assert records[-1].data == {"trials": 20, "given_up": 0}


def test_twice_in_a_row_calls_the_experimenter_and_says_why(
    present: Present, scripted: type
) -> None:
    lost = {(n, 1): [Playback(1.0, 1.5, delivered=fail(level_error_db=-6.0))] for n in (3, 4)}
    presenter = scripted(playbacks=lost)
    records = present(presenter)
    (failure,) = (r.data for r in records if r.event == "device_failed")
    assert "6.0 dB too weak" in failure["reason"]
    assert any(line.startswith("page call_us") for line in presenter.log)
    assert records[-1].data == {"trials": 20, "given_up": 0}


def test_a_file_of_what_was_delivered_is_as_it_was_written(
    present: Present, scripted: type, tmp_path: Path
) -> None:
    folder = tmp_path / "sessions" / "p01"
    (folder / "delivered").mkdir(parents=True)
    file = folder / "delivered" / "0001.wav"
    file.write_bytes(b"measured")
    sha256 = hashlib.sha256(b"measured").hexdigest()
    played = Playback(1.0, 1.5, measured={"file_number": 1.0}, delivered_sha256=sha256)
    records = present(scripted(playbacks={(1, 1): [played]}))
    line = next(r.sequence + 1 for r in records if r.data.get("delivered_sha256"))
    place = f"{folder / 'session-01.jsonl'}, line {line}: delivered/0001.wav"

    def audit() -> list[str]:
        return list(audit_journals(folder, require_plan(folder / "plan.json")))

    assert audit() == []
    file.write_bytes(b"measures")
    assert audit() == [f"{place} was changed since it was written; restore it from a copy"]
    file.unlink()
    assert audit() == [f"{place} is gone; restore it from a copy"]
