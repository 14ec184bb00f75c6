"""What is known of participants: rows of the roster, remarks on rigs, tombstones."""

import json
from pathlib import Path
from typing import Any

import pytest

from feel321.study.participants.roster import (
    REMOVED,
    Progress,
    Tombstone,
    describe_rigs,
    find_leftovers,
    list_remarks,
    read_tombstone,
    write_roster,
    write_tombstone,
)
from feel321.study.session.journal import Anchor
from feel321.study.withdrawal import release_participant, withdraw_participant


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


def test_who_is_alone_with_a_rig_or_a_certificate_is_named() -> None:
    everybody = [
        Progress("p01", rig="aa", calibration="c1"),
        Progress("p02", rig="bb", calibration="c9"),
        Progress("p03", rig="aa", calibration="c1"),
        Progress("p04", rig="aa", calibration="uncalibrated", estimated=7),
        Progress("sim001"),
    ]
    assert list(describe_rigs(everybody)) == [
        "p02: another rig (bb) than the other 3 (aa)",
        "p04: another certificate (uncalibrated) than the other 2 (c1)",
        "p04: 7 onset times are estimated from the latency: the device gave none",
    ]


def test_the_report_says_whose_onsets_are_estimates_and_who_gave_up_trials() -> None:
    some = [Progress("p01"), Progress("p02", estimated=7, given_up=3), Progress("p03", estimated=1)]
    assert list(list_remarks(some)) == [
        "Onset times of participants p02 (7), p03 (1) are estimated from the latency: their device gave none.",
        "Trials without a valid answer after all attempts, of participants p02 (3): no ratings.",
    ]
    assert list(list_remarks(some[:1])) == []


TOMBSTONE = Tombstone(
    "p01", 1, False, "2026-01-01T12:00:00+00:00", "zog weg, müde", (Anchor("a", 1, "0"),), REMOVED
)


def test_what_was_written_is_read(tmp_path: Path) -> None:
    assert read_tombstone(tmp_path) is None
    write_tombstone(tmp_path, TOMBSTONE)
    assert read_tombstone(tmp_path) == TOMBSTONE


FORGED = ({"number": 2}, {"journals": []}, {"sha256": "0"}, {"more": 1}, "", "[" * 99999, "{}")


@pytest.mark.parametrize("change", FORGED)
def test_an_edit_is_one_line(tmp_path: Path, change: dict[str, Any] | str) -> None:
    write_tombstone(tmp_path, TOMBSTONE)
    path = tmp_path / "withdrawn.json"
    is_text = isinstance(change, str)
    path.write_text(change if is_text else json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(
        ValueError, match=r"withdrawn\.json: changed after it was written"
    ) as caught:
        read_tombstone(tmp_path)
    assert "\n" not in str(caught.value)


def test_whatever_lies_beside_a_tombstone_is_named(tmp_path: Path) -> None:
    (tmp_path / "notes").mkdir()
    for name in ("plan.json", ".lock", ".plan.json.part", "notes/age.txt"):
        (tmp_path / name).touch()
    assert find_leftovers(tmp_path) == []
    write_tombstone(tmp_path, TOMBSTONE)
    ending = "lies beside a tombstone, the participant withdrew; remove it"
    names = (".plan.json.part", "notes/age.txt", "plan.json")
    assert find_leftovers(tmp_path) == [f"{tmp_path / name}: {ending}" for name in names]
