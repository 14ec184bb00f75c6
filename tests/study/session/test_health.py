"""No session is wasted in silence: what the device loses comes again, is named, and costs no attempt."""

import hashlib
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from feel321.protocols.trial import MOST_LOST, Flow
from feel321.study.evidence.audit import audit_journals
from feel321.study.evidence.replay import audit_steps
from feel321.study.participants.roster import make_progress
from feel321.study.session.events import find_loss
from feel321.study.session.journal import Chain
from feel321.study.session.plan import Plan, read_dossier, replay, require_plan
from feel321.study.session.ports import Abort, Confirm, Playback
from feel321.study.status import find_flags
from tests.study.conftest import list_events

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
WHOLE = Playback(1.0, 1.5)
LEAVE = Abort(1.0, "the window was closed")


def fail(**changes: float) -> dict[str, float]:
    return {**GOOD, **changes}


CAUSES = {
    "underrun": (replace(WHOLE, underruns=2), "the device ran dry (2 underruns)"),
    "clipped": (replace(WHOLE, clipped=9), "9 samples were limited"),
    "device_error": (replace(WHOLE, error="device is gone"), "device is gone"),
    "not_delivered": (replace(WHOLE, delivered=fail(level_error_db=-6.0)), "6.0 dB too weak"),
}
DEAD = replace(WHOLE, delivered=fail(), fault="left: dead (-40 dB); check its cable")
ALL = frozenset({"underrun", "clipped", "device_error", "too_fast", "not_felt"})


@pytest.mark.parametrize(
    ("delivered", "fault"),
    [
        ({}, ""),
        (fail(), ""),
        ({"level_error_db": 9.0}, ""),  # predicted by a certificate
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


@pytest.mark.parametrize(
    ("cause", "bad", "words"),
    [*((cause, *one) for cause, one in CAUSES.items()), ("not_delivered", DEAD, "left: dead")],
)
def test_two_in_a_row_call_the_experimenter_with_the_cause_and_cost_no_attempt(
    present: Present, scripted: type, plan: Plan, cause: str, bad: Playback, words: str
) -> None:
    """Then after each further one, and no longer once it played again."""
    plan = replace(plan, flow=replace(plan.flow, reject=tuple(ALL)))
    presenter = scripted(playbacks={(number, 1): [bad] for number in (3, 4, 5, 8)})
    records = present(presenter, plan=plan)
    told = [line for line in presenter.log if line.startswith(("page call_us", "show"))]
    assert told[:8] == [
        *(f"show {number}.1 realism" for number in range(1, 5)),
        "page call_us 2/20",
        "show 5.1 realism",
        "page call_us 2/20",
        "show 3.2 realism",
    ]
    calls = list_events(records, "device_failed")
    assert [words in call["reason"] for call in calls] == [True, True]
    lost = {r.data["trial"]: r.data["flags"] for r in records if r.data.get("flags")}
    assert lost == {number: [cause] for number in (3, 4, 5, 8)}
    assert replay(plan, records).given_up == 0
    warnings = list(find_flags(Chain(records, "", b"")))
    assert f"4 x {cause.replace('_', ' ')}" in warnings
    assert "experimenter called: 2 x" in warnings
    assert list(audit_steps(records, plan)) == []


def test_most_playbacks_may_be_spoiled_and_no_rating_is_missing(
    present: Present, scripted: type, plan: Plan
) -> None:
    """67 of 81 playbacks, as once on a laptop: every trial still has its answer, and none is given up."""

    class Spoiling(scripted):  # type: ignore[misc] - a fixture hands the class over
        rng = np.random.default_rng(4)

        def play(self, part: Any, stimulus: Any, *, gap_s: float) -> Playback:
            playback = super().play(part, stimulus, gap_s=gap_s)
            return replace(playback, underruns=int(self.rng.random() < 67 / 81))

    presenter = Spoiling()
    records = present(presenter, plan=replace(plan, trials=plan.trials[:10]))
    good = [data["trial"] for data in list_events(records, "rated") if not data["rejected"]]
    assert sorted(good) == list(range(1, 11))
    assert records[-1].data == {"trials": 10, "given_up": 0}
    assert len(list_events(records, "device_failed")) > 10
    assert list(audit_steps(records, replace(plan, trials=plan.trials[:10]))) == []


def test_what_was_not_delivered_comes_again_unanswered(present: Present, scripted: type) -> None:
    lost = [replace(WHOLE, delivered=fail(coherence=0.01))]
    records = present(scripted(playbacks={(11, 1): lost}))
    own = [r for r in records if r.data.get("trial") == 11]
    told = "shown played spoiled shown played played rated"
    assert [r.event for r in own] == told.split()
    assert own[1].data["delivered"] == fail(coherence=0.01)
    assert "delivered" not in own[4].data


def test_answered_and_given_up_are_counted_apart(
    present: Present, scripted: type, plan: Plan, tmp_path: Path
) -> None:
    """Trial 3 is answered too fast in all its attempts, and the device loses trial 5 again and again."""
    fast = {(3, n): [Confirm(0.0, {"test": 50.0}, 0.1)] for n in (1, 2, 3)}
    lost = {(5, n): [CAUSES["not_delivered"][0]] for n in range(1, MOST_LOST + 1)}
    presenter = scripted(acts=fast, playbacks=lost)
    records = present(presenter)
    assert records[-1].data == {"trials": 20, "given_up": 2}
    folder = tmp_path / "sessions" / "p01"
    progress = make_progress(read_dossier(folder))
    assert (progress.answered, progress.given_up, progress.total) == (18, 2, 20)
    attempts = Counter(data["trial"] for data in list_events(records, "shown"))
    assert (attempts[3], attempts[5]) == (3, MOST_LOST)
    assert list(audit_steps(records, plan)) == []


def test_a_fault_within_tolerance_is_said_once_and_spoils_nothing(
    present: Present, scripted: type, plan: Plan
) -> None:
    """One that goes on through all trials, its figures changing; beyond the tolerance it is part of the cause."""
    hums = {
        (n, 1): [replace(WHOLE, delivered=fail(), notice=f"hum of 5{n % 2} Hz")]
        for n in range(1, 9)
    }
    weak = replace(WHOLE, delivered=fail(level_error_db=-6.0), notice="right: gain -6.1 dB")
    places: list[Any] = []
    presenter = scripted(playbacks={**hums, (9, 1): [weak], (10, 1): [weak]})
    records = present(presenter, on_step=places.append)
    assert [place.notice for place in places if place.notice] == [
        "hum of 51 Hz",
        "right: gain -6.1 dB",
    ]
    (call,) = list_events(records, "device_failed")
    assert "6.0 dB too weak" in call["reason"]
    assert call["reason"].endswith("right: gain -6.1 dB")
    spoiled = [data["trial"] for data in list_events(records, "spoiled")]
    assert spoiled == [9, 10]
    assert "8 x hum of 51 Hz" in list(find_flags(Chain(records, "", b"")))
    assert replay(plan, records).answered == 20
    assert list(audit_steps(records, plan)) == []


def test_faults_that_do_not_matter_call_nobody(
    present: Present, scripted: type, plan: Plan
) -> None:
    """A study that does not reject underruns takes the answers to them."""
    plan = replace(plan, flow=replace(plan.flow, reject=("too_fast",)))
    dry = {(number, 1): [CAUSES["underrun"][0]] for number in range(1, 8)}
    records = present(scripted(playbacks=dry), plan=plan)
    assert list_events(records, "device_failed") == []
    assert replay(plan, records).answered == 20


def test_who_leaves_instead_of_retrying_ends_the_session_for_today(
    present: Present, scripted: type
) -> None:
    dead = {(number, 1): [CAUSES["device_error"][0]] for number in (3, 4)}
    records = present(scripted(playbacks=dead, pages={"call_us": [LEAVE]}))
    assert records[-1].data["reason"] == "the device failed twice in a row; check it, then resume"
    again = scripted()
    records = present(again)
    assert again.log[0] == "page ready 2/20"
    assert sorted(r["trial"] for r in list_events(records, "rated")) == list(range(1, 21))


def test_a_dead_device_uses_no_trial_up(present: Present, scripted: type) -> None:
    gone = CAUSES["device_error"][0]
    dead = {(number, attempt): [gone] for number in range(1, 21) for attempt in range(1, 60)}
    for n_retries in (0, 3, 12):
        retries = [Confirm(1.0, {})] * n_retries
        records = present(scripted(playbacks=dead, pages={"call_us": [*retries, LEAVE]}))
        assert records[-1].event == "aborted"
    records = present(scripted())
    assert sorted(r["trial"] for r in list_events(records, "rated")) == list(range(1, 21))
    assert records[-1].data == {"trials": 20, "given_up": 0}


def test_a_file_of_what_was_delivered_is_as_it_was_written(
    present: Present, scripted: type, tmp_path: Path
) -> None:
    folder = tmp_path / "sessions" / "p01"
    (folder / "delivered").mkdir(parents=True)
    file = folder / "delivered" / "0001.wav"
    file.write_bytes(b"measured")
    sha256 = hashlib.sha256(b"measured").hexdigest()
    played = replace(WHOLE, measured={"file_number": 1.0}, delivered_sha256=sha256)
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
