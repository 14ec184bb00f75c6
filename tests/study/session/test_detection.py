"""The threshold block in a session: adaptive levels, resumed from the journal wherever it breaks off."""

import os
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from feel321.protocols.tasks import make_task
from feel321.protocols.threshold import PROCEDURES, USUAL, ThresholdBlock
from feel321.protocols.trial import THRESHOLD, Flow
from feel321.stimuli.sets.manifest import StimulusSet
from feel321.study.evidence.replay import audit_steps
from feel321.study.observer import ObserverModel, SimulatedObserver
from feel321.study.session.engine import run_session
from feel321.study.session.journal import Record
from feel321.study.session.opening import open_session
from feel321.study.session.plan import (
    Design,
    Plan,
    Stale,
    create_plan,
    make_plan,
    recall_detection,
    require_plan,
)

FLOW = Flow(min_response_s=0.45, rest_s=1.0, break_s=1.0)
"""A random clicker answers faster than that in a third of the trials, which then come again."""

BLOCK = ThresholdBlock(
    "staircase", (40.0, 250.0), replace(USUAL, trials=4, catch_every=3), practice=1
)
DESIGN = Design(7, "williams", 1, (make_task("realism"),), {}, FLOW, BLOCK)


@pytest.fixture(autouse=True, scope="module")
def unsynced() -> Iterator[None]:
    """Kills are made by cutting the file; nothing here is about power cuts."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "fsync", lambda _: None)
        yield


def lead(folder: Path, plan: Plan, stimuli: StimulusSet, now: Any, **model: Any) -> list[Record]:
    """Lead a session to its end, from wherever its journal stands."""
    own = ObserverModel(random_clickers=1.0, **model)
    if not (folder / "plan.json").exists():
        folder.mkdir(parents=True, exist_ok=True)
        create_plan(folder / "plan.json", plan)
    with open_session(folder, plan, identity={}, now=now, stale=Stale()) as (stored, journal):
        elapsed_s = journal.records.find_elapsed()
        observer = SimulatedObserver(own, seed=3, number=1, elapsed_s=elapsed_s)
        run_session(stored, observer, stimuli=stimuli, journal=journal)
        return list(journal.records)


def list_sequence(records: list[Record]) -> list[Any]:
    """List what was presented and answered, without attempts that a kill cut off before their answer."""
    listed: list[Any] = []
    for record in records:
        if record.event == "tone":
            listed = [entry for entry in listed if entry[:2] != ("tone", record.data["trial"])]
            listed.append(("tone", record.data["trial"], record.data))
        if record.event == "rated":
            listed = [(*entry[:1], None, *entry[2:]) for entry in listed]
            data = record.data
            listed.append(("rated", None, data["trial"], data["values"], data["rejected"]))
    return listed


@pytest.mark.parametrize(
    ("procedure", "every"),
    [
        ("staircase", 3),
        ("bayesian", 9),
        *(pytest.param(name, 1, marks=pytest.mark.soak) for name in PROCEDURES),
    ],
)
def test_a_kill_at_any_record_changes_nothing(
    tmp_path: Path, stimuli: StimulusSet, now: Any, procedure: str, every: int
) -> None:
    design = replace(DESIGN, threshold=replace(BLOCK, procedure=procedure))
    plan = make_plan(design, stimuli, "p01", number=2, simulated=True)
    whole = lead(tmp_path / "p01", plan, stimuli, now)
    assert any(r.data["rejected"] for r in whole if r.event == "rated")
    assert sum(r.event == "tone" for r in whole) > len(BLOCK.frequencies_hz) * 5 + 1
    lines = (tmp_path / "p01" / "session-01.jsonl").read_bytes().splitlines(keepends=True)
    last = max(place for place, record in enumerate(whole) if record.event == "tone")
    for kill in range(1, last + 3, every):
        torn = lines[kill][: len(lines[kill]) // 2] if kill % 2 else b""
        folder = tmp_path / f"{kill}" / "p01"
        folder.mkdir(parents=True)
        (folder / "session-01.jsonl").write_bytes(b"".join(lines[:kill]) + torn)
        create_plan(folder / "plan.json", plan)
        again = lead(folder, plan, stimuli, now)
        assert list_sequence(again) == list_sequence(whole), kill
        assert list(audit_steps(again, require_plan(folder / "plan.json"))) == []


def test_rejected_answers_move_no_level(tmp_path: Path, stimuli: StimulusSet, now: Any) -> None:
    plan = make_plan(DESIGN, stimuli, "p01", number=1, simulated=True)
    records = lead(tmp_path / "p01", plan, stimuli, now)
    tones = [record.data for record in records if record.event == "tone"]
    rated = [record.data for record in records if record.event == "rated"][: len(tones)]
    counted = {trial.number for trial in plan.trials if trial.phase == THRESHOLD}
    own = [(t, r) for t, r in zip(tones, rated, strict=True) if t["trial"] in counted]
    for (tone, answer), (following, _) in pairwise(own):
        if answer["rejected"] and tone["frequency_hz"] == following["frequency_hz"]:
            assert {**following, "trial": 0, "attempt": 0} == {**tone, "trial": 0, "attempt": 0}
    given = Counter(t["frequency_hz"] for t, r in own if not r["rejected"])
    detection = recall_detection(plan, records)
    assert detection is not None
    found = {f: len(one.answers) for f, one in detection.list_procedures().items()}
    assert found == dict(given)


def test_audit_finds_another_level(tmp_path: Path, stimuli: StimulusSet, now: Any) -> None:
    plan = make_plan(DESIGN, stimuli, "p01", number=1, simulated=True)
    records = lead(tmp_path / "p01", plan, stimuli, now)
    assert list(audit_steps(records, plan)) == []
    tones = [n for n, record in enumerate(records) if record.event == "tone"]
    place = next(n for n in tones[2:] if records[n].data["level_db"] is not None)
    for name, value in (("level_db", -3.5), ("interval", 3 - records[place].data["interval"])):
        changed = replace(records[place], data={**records[place].data, name: value})
        (found,) = audit_steps([*records[:place], changed, *records[place + 1 :]], plan)
        assert found.startswith(f", line {place + 1}: ")
    (missing,) = audit_steps([*records[:place], *records[place + 1 :]], plan)
    assert missing.startswith(f", line {place + 1}: ")
