from __future__ import annotations

import csv
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.people import write_roster
from feel321.study.persons.withdrawal import release_participant, withdraw_participant

if TYPE_CHECKING:
    from pathlib import Path


def read(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_one_row_per_participant_by_plan_and_journals(lab: Any, now: Any) -> None:
    for name in ("p01", "p02", "p03"):
        lab.begin(name)
    lab.begin("sim001", simulated=True)
    lab.work("sim001")
    lab.work("p02", 2)
    lab.begin("p02", session=2)
    release_participant(lab.study, "p02", now=now)
    withdraw_participant(lab.study, "p03", now=now)
    path = write_roster(lab.study)
    utc = "2026-01-01T12:00:00.000+00:00"
    columns = "participant,number,simulated,state,sessions,answered,given_up,total,grip,first_utc,last_utc"
    columns += ",training_passed,rig,calibration"
    assert path.read_bytes().decode().split("\r\n") == [
        columns,
        f"p01,1,false,running,1,0,0,4,pen,{utc},{utc},,,",
        f"p02,2,false,released,2,0,0,4,power,{utc},{utc},,,",
        f"sim001,1,true,finished,1,4,0,4,pen,{utc},{utc},,,",
        "",
    ]


def test_a_broken_journal_is_named_and_the_old_table_stays(lab: Any) -> None:
    journal = lab.begin("p01") / "session-01.jsonl"
    path = write_roster(lab.study)
    before = path.read_bytes()
    journal.write_bytes(b"{}\n")
    with pytest.raises(
        ValueError, match=r"session-01\.jsonl, line 1: was changed after it was written"
    ):
        write_roster(lab.study)
    assert path.read_bytes() == before
