"""Onsets on the lab streaming layer: each once, in order, at the time of the journal's clock."""

import json
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from feel321.study import lsl as outlets
from feel321.study.lsl import SENT, make_marker, name_source, open_outlet
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Record
from feel321.study.session.opening import open_session
from feel321.study.session.plan import Stale, create_plan

TOLERANCE_S = 0.002
"""Two clocks of one machine, read one after the other."""

INLET = """
import sys, json, pylsl
(found,) = pylsl.resolve_byprop("source_id", sys.argv[1], 1, 20)
inlet = pylsl.StreamInlet(found)
inlet.open_stream(20)
print("ready", flush=True)
for _ in range(int(sys.argv[2])):
    sample, stamp = inlet.pull_sample(20)
    print(json.dumps([sample[0], stamp]), flush=True)
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
    folder.mkdir()
    create_plan(folder / "plan.json", plan)
    with open_session(folder, plan, identity=identity, now=now, stale=Stale()) as (stored, journal):
        source = name_source(journal.path)
        assert plan.participant not in source
        with open_outlet(journal, presenter.pass_time):
            command = [sys.executable, "-c", INLET, source, "30"]
            with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as inlet:
                assert inlet.stdout is not None
                assert inlet.stdout.readline() == "ready\n"
                offset = pylsl.local_clock() - presenter.pass_time()
                run_session(stored, presenter, stimuli=stimuli, journal=journal)
                received = [json.loads(line) for line in inlet.stdout]
        records = list(journal.records)
    wanted = [make_marker(record) for record in records if record.event in SENT]
    assert [text for text, _ in received] == [text for text, _ in wanted]
    late = [
        abs(got - offset - time_s) for (_, got), (_, time_s) in zip(received, wanted, strict=True)
    ]
    assert max(late) < TOLERANCE_S


PLAYED = {
    "trial": 7, "attempt": 1, "part": "a", "requested_s": 0.5, "onset_s": 0.75, "completed": True, "error": "",
}  # fmt: skip


def test_a_playback_has_the_time_of_its_onset() -> None:
    text, time_s = make_marker(Record(4, "", "played", PLAYED))
    assert time_s == 0.75
    assert json.loads(text) == {
        "event": "played", "sequence": 4, "trial": 7, "attempt": 1, "part": "a", "completed": True,
    }  # fmt: skip
    unheard = Record(4, "", "prompted", PLAYED | {"onset_s": None})
    assert make_marker(unheard)[1] == 0.5


def test_a_lost_marker_is_named_and_ends_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pylsl = pytest.importorskip("pylsl", reason="pylsl is not installed: no marker was lost")
    sent = []

    class Broken:
        def __init__(self, _info: object) -> None: ...

        def push_sample(self, texts: list[str], stamp: float) -> None:
            sent.append((json.loads(texts[0])["event"], stamp))
            raise RuntimeError("gone")

    monkeypatch.setattr(pylsl, "StreamOutlet", Broken)
    monkeypatch.setattr(pylsl, "local_clock", lambda: 5.0)
    journal: Any = SimpleNamespace(path=tmp_path / "a.jsonl", listeners=[])
    records = [
        Record(4, "", "played", PLAYED),
        *(
            Record(5, "", name, {"value": "secret"})
            for name in ("shown", "answered", "note", "begun")
        ),
    ]

    def lead() -> None:
        with open_outlet(journal, lambda: 1.0):
            for record in records:
                journal.listeners[0](record)

    with pytest.warns(UserWarning, match=r"LSL: 1 markers were lost \(gone\)"):
        lead()
    assert sent == [("played", 4.75)]
    assert journal.listeners == []


def test_a_missing_library_is_named_before_the_session(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(outlets, "find_spec", lambda _: None)
    with pytest.raises(OSError, match=r"pylsl not found, which \[session\] lsl and --lsl need"):
        outlets.check_lsl()
