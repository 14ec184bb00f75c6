"""Events on the lab streaming layer: each once, in order, at the time of the journal's clock, and nobody waits."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.session import outlet as outlets
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Record
from feel321.study.session.outlet import EventOutlet, make_markers, name_source, open_outlet
from feel321.study.session.plan import Stale, open_session

if TYPE_CHECKING:
    from pathlib import Path

TOLERANCE_S = 0.002
"""Two clocks of one machine, read one after the other."""

INLET = """
import sys, json, pylsl
(found,) = pylsl.resolve_byprop("source_id", sys.argv[1], 1, 20)
inlet = pylsl.StreamInlet(found)
inlet.open_stream(20)
print("ready", flush=True)
while True:
    sample, stamp = inlet.pull_sample(20)
    if sample is None:
        break
    print(json.dumps([json.loads(sample[0]), stamp]), flush=True)
    if json.loads(sample[0])["event"] == "finished":
        break
"""


def test_another_process_receives_every_event_once_in_order_and_in_time(
    tmp_path: Path, plan: Any, stimuli: Any, now: Any, scripted: type[Any]
) -> None:
    pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed: no marker was received")
    begun = time.perf_counter()
    presenter = scripted()
    presenter.pass_time = lambda: time.perf_counter() - begun
    folder = tmp_path / plan.participant
    identity = {"presenter": {"simulated": True}}
    with open_session(folder, plan, identity=identity, now=now, stale=Stale()) as (stored, journal):
        source = name_source(journal.path)
        assert plan.participant not in source
        with open_outlet(journal, presenter.pass_time) as outlet:
            command = [sys.executable, "-c", INLET, source]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as inlet:
                assert inlet.stdout is not None
                assert inlet.stdout.readline() == "ready\n"
                offset = pylsl.local_clock() - presenter.pass_time()
                run_session(stored, presenter, stimuli=stimuli, journal=journal)
                received = [json.loads(line) for line in inlet.stdout]
        assert outlet.fault == ""
        records = list(journal.records)
    wanted = [one for record in records for one in make_markers(record, now=0.0, offset_s=offset)]
    assert [one for one, _ in received] == [json.loads(json.dumps(one)) for one, _ in wanted]
    assert len({(one["sequence"], one["event"]) for one, _ in received}) == len(received) > 60
    late = [
        abs(got - meant) for (_, got), (_, meant) in zip(received, wanted, strict=True) if meant
    ]
    assert len(late) > 40
    assert max(late) < TOLERANCE_S


def test_a_journal_does_not_wait_for_a_layer_that_hangs() -> None:
    """A send that takes a second per marker delays nobody: thousands are taken in much less."""
    outlet = EventOutlet(lambda *_: time.sleep(1), lambda: 5.0, lambda: 1.0)
    outlet.start()
    record = Record(
        0, "", "rated", {"trial": 1, "attempt": 1, "values": {}, "rejected": False, "time_s": 2.0}
    )
    begun = time.process_time()
    for _ in range(2000):
        outlet.take(record)
    assert (time.process_time() - begun) / 2000 < 0.0005


def test_a_gone_layer_is_named_and_ends_nothing() -> None:
    sent = []

    def send(text: str, stamp: float) -> None:
        sent.append((text, stamp))
        raise RuntimeError("lost")

    outlet = EventOutlet(send, lambda: 5.0, lambda: 1.0)
    outlet.start()
    outlet.take(Record(3, "", "shown", {"trial": 7, "attempt": 1}))
    outlet.take(Record(4, "", "played", {
        "trial": 7, "attempt": 1, "part": "a", "requested_s": 0.5, "onset_s": 0.75, "completed": True,
    }))  # fmt: skip
    outlet.close()
    assert outlet.fault == "RuntimeError: lost"
    assert [(json.loads(text)["event"], stamp) for text, stamp in sent] == [
        ("shown", 5.0), ("playback_began", 4.75), ("playback_ended", 5.0),
    ]  # fmt: skip


def test_answers_to_questions_and_notes_are_not_sent() -> None:
    for name in ("answered", "note", "begun", "device"):
        record = Record(1, "", name, {"value": "secret", "text": "secret", "time_s": 1.0})
        assert list(make_markers(record, now=1.0, offset_s=0.0)) == []


def test_a_missing_library_is_named_before_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlets, "find_spec", lambda _: None)
    with pytest.raises(OSError, match=r"pylsl not found, which \[session\] lsl and --lsl need"):
        outlets.check_lsl()
