"""What was once written and is no longer so: audit finds it, names the file, and the line where there is one."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING, Any

import pytest

from feel321.study.auditing.study import audit_study, examine
from feel321.study.folder import StudyFolder
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.session.journal import (
    START,
    create_journal,
    digest,
    read_chain,
    read_journal,
    require_journal,
    write_line,
)
from feel321.study.simulation import simulate_study
from feel321.study.workflow import build_study

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from feel321.study.session.journal import Record

    Edit = Callable[[list[bytes]], list[bytes]]

STUDY = """
[[recordings]]
scene = "bumps"
duration_s = 0.1
[stimuli]
reducers = ["sax321", "dft321"]
[session]
protocols = ["similarity"]
[session.rehearsal]
training = 0
practice = 0
"""


def tell_time() -> datetime:
    return datetime.now(UTC)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that three participants have finished; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=3, seed=None, now=tell_time)
    for name in ("ratings.csv", "participants.csv"):
        (study.path / name).unlink()  # what plans and journals show by themselves
    shutil.rmtree(study.path / ".evidence")
    return study


@pytest.fixture
def copy(whole: StudyFolder, tmp_path: Path) -> StudyFolder:
    shutil.copytree(whole.path, tmp_path / "copy")
    return StudyFolder(tmp_path / "copy")


def find_only(study: StudyFolder) -> str:
    (finding,) = audit_study(study)
    return finding


def find_rated(lines: list[bytes]) -> int:
    return next(place for place, line in enumerate(lines) if b'"event": "rated"' in line)


def chain_anew(records: list[Record]) -> bytes:
    """Write records as a chain that holds, whatever they say."""
    content, tip = b"", START
    for sequence, record in enumerate(records):
        line = write_line(replace(record, sequence=sequence), tip)
        content, tip = content + line, digest(line.rstrip(b"\n"))
    return content


def test_a_study_as_it_was_written_gives_no_finding(copy: StudyFolder) -> None:
    assert audit_study(copy) == []


@pytest.mark.parametrize(
    ("edit", "finding"),
    [
        (
            lambda lines: [*lines[:8], lines[8].replace(b'"test": ', b'"test": 1'), *lines[9:]],
            ", line 9: was changed",
        ),
        (lambda lines: lines[:5] + lines[6:], ", line 6: does not follow the line before"),
        (
            lambda lines: [*lines[:5], lines[6], lines[5], *lines[7:]],
            ", line 6: does not follow the line before",
        ),
        (lambda lines: [*lines, lines[-1]], ": does not follow the line before"),
        (lambda lines: lines[1:], ", line 1: does not follow the line before"),
        (lambda lines: [*lines, b'{"torn'], ": ends in 6 bytes of an unfinished line"),
    ],
    ids=[
        "a changed rating",
        "a deleted line",
        "swapped lines",
        "a doubled line",
        "a lost header",
        "a torn line",
    ],
)
def test_an_edited_journal_is_named_with_its_line(
    copy: StudyFolder, edit: Edit, finding: str
) -> None:
    journal = copy.journals[0]
    lines = journal.read_bytes().splitlines(keepends=True)
    assert find_rated(lines) == 8, "the changed line is the first rating"
    journal.write_bytes(b"".join(edit(lines)))
    findings = [line for line in audit_study(copy) if str(journal) in line]
    assert finding in findings[0]


def test_a_changed_wav_is_found(copy: StudyFolder) -> None:
    wav = next(copy.stimuli.glob("*.wav"))
    content = bytearray(wav.read_bytes())
    content[-5] ^= 1
    wav.write_bytes(content)
    assert wav.name in find_only(copy)


def test_a_changed_or_missing_plan_is_found(copy: StudyFolder) -> None:
    changed, missing = (copy.sessions / name / "plan.json" for name in ("sim001", "sim002"))
    changed.write_bytes(changed.read_bytes().replace(b'"seed": 321', b'"seed": 322'))
    missing.unlink()
    findings = audit_study(copy)
    assert len(findings) == 2
    assert findings[0].startswith(f"{changed}: not a plan, or changed after it was stored")
    assert str(missing) in findings[1]


def test_a_plan_forged_with_its_digest_is_betrayed_by_the_journal(copy: StudyFolder) -> None:
    path = copy.sessions / "sim001" / "plan.json"
    body = path.read_bytes().replace(b'"seed": 321', b'"seed": 322').rpartition(b',\n "sha256"')[0]
    path.write_bytes(body + b',\n "sha256": "' + digest(body + b"\n}").encode() + b'"\n}\n')
    assert audit_study(copy) == [
        f"{copy.journals[0]}: was begun with another plan than the one beside it",
        f"{copy.journals[0]}, line 1: has seed 321, the plan says 322",
    ]


@pytest.mark.parametrize(
    ("body", "problem"),
    [
        (b'{\n "format": 2', "not a plan as this version writes it ("),
        (b'{\n "format": 99', "the plan's format must be 2, got 99; use the feel321 that wrote it"),
    ],
)
def test_a_sealed_file_that_is_no_plan_is_told(
    copy: StudyFolder, body: bytes, problem: str
) -> None:
    path = copy.sessions / "sim001" / "plan.json"
    path.write_bytes(body + b',\n "sha256": "' + digest(body + b"\n}").encode() + b'"\n}\n')
    assert any(finding.startswith(f"{path}: {problem}") for finding in audit_study(copy))


def test_a_copied_journal_is_found(copy: StudyFolder) -> None:
    target = copy.sessions / "sim001" / "session-02.jsonl"
    shutil.copy(copy.journals[0], target)
    assert f"{target}: is session 1 of 'sim001', it was copied here" in audit_study(copy)


def test_a_journal_put_into_the_place_of_another_is_found(copy: StudyFolder) -> None:
    shutil.copy(copy.journals[0], copy.journals[1])
    findings = audit_study(copy)
    assert f"{copy.journals[1]}: is session 1 of 'sim001', it was copied here" in findings
    assert f"{copy.journals[1]}: was begun with another plan than the one beside it" in findings


def test_a_copied_participant_is_found(copy: StudyFolder) -> None:
    shutil.copytree(copy.sessions / "sim002", copy.sessions / "sim009")
    findings = audit_study(copy)
    assert (
        f"{copy.sessions / 'sim009' / 'plan.json'}: is the plan of 'sim002', it was copied here"
        in findings
    )
    assert (
        "number 2 of simulated ones is that of sim002 and sim009; release one, or move its folder away"
        in findings
    )


def test_a_changed_manifest_is_found(copy: StudyFolder) -> None:
    path = copy.stimuli / "manifest.json"
    entry = json.loads(path.read_text(encoding="utf-8"))
    entry["stimuli"][0]["spectral_match"] = 0.99
    path.write_text(json.dumps(entry, indent=1), encoding="utf-8")
    assert find_only(copy) == (
        f"{copy.stimuli}: manifest.csv and manifest.json differ; one was changed, build the set again"
    )


@pytest.mark.parametrize(
    ("events", "finding"),
    [
        ([("page", {"key": "welcome", "time_s": 0.0, "stood_s": 0.0})], ": has no header"),
        (
            [("begun", None), ("shown", {"trial": 1, "attempt": 1})],
            ", line 2: holds 'shown' where page 'welcome' is due",
        ),
        (
            [("begun", None), ("page", {"key": "end", "time_s": 0.0, "stood_s": 0.0})],
            ", line 2: 'page' has key 'end', by the plan and what came before it is 'welcome'",
        ),
        (
            [("begun", None), ("finished", {"trials": 0, "given_up": 0})],
            ", line 2: holds 'finished' where page 'welcome' is due",
        ),
    ],
)
def test_gaps_in_a_chain_that_holds_are_found(
    copy: StudyFolder, events: list[tuple[str, Any]], finding: str
) -> None:
    header = read_journal(copy.journals[0]).records[0].data
    path = copy.journals[0]
    path.unlink()
    journal = create_journal(path, now=tell_time)
    for event, data in events:
        journal.write(event, header if data is None else data)
    assert find_only(copy) == f"{path}{finding}"


def test_a_rating_given_twice_in_a_chain_that_holds_is_found(copy: StudyFolder) -> None:
    path = copy.journals[0]
    records = list(read_journal(path).records)
    place = find_rated(path.read_bytes().splitlines())
    path.write_bytes(chain_anew([*records[: place + 1], *records[place:]]))
    assert find_only(copy).startswith(f"{path}, line {place + 2}: holds 'rated', by ")


def test_a_journal_that_never_got_its_header_is_no_finding(copy: StudyFolder) -> None:
    copy.journals[0].write_bytes(b"")
    assert audit_study(copy) == []


def test_a_clock_set_back_is_recorded_and_explained(copy: StudyFolder) -> None:
    path = copy.journals[0]
    hour_ago = tell_time() - timedelta(hours=1)
    require_journal(path, now=lambda: hour_ago).write(
        "aborted", {"reason": "KeyboardInterrupt", "time_s": 0.0}
    )
    stepped, aborted = read_journal(path).records[-2:]
    assert (stepped.event, aborted.event) == ("clock_stepped", "aborted")
    assert stepped.data["back_s"] == pytest.approx(3600, abs=60)
    assert audit_study(copy) == []


def test_time_that_runs_backwards_without_a_word_is_found(copy: StudyFolder) -> None:
    path = copy.journals[0]
    records = list(read_journal(path).records)
    records[4] = replace(records[4], utc="2001-01-01T00:00:00.000+00:00")
    path.write_bytes(chain_anew(records))
    assert len(read_chain(path.read_bytes(), "").records) == len(records)
    assert find_only(copy) == f"{path}, line 5: is older than the line before, and nothing says why"


@pytest.mark.parametrize("events", [(), ("aborted",), ("released",)])
def test_a_session_killed_in_its_opening_is_no_finding(
    copy: StudyFolder, events: tuple[str, ...]
) -> None:
    path = copy.journals[1]
    path.write_bytes(path.read_bytes().splitlines(keepends=True)[0])
    for event in events:
        require_journal(path, now=tell_time).write(event, {"reason": "", "time_s": 0.0})
    assert audit_study(copy) == []


def test_what_lies_beside_a_tombstone_is_named(copy: StudyFolder) -> None:
    back = (copy.sessions / "sim002" / "plan.json").read_bytes()
    withdraw_participant(copy, "sim002", now=tell_time)
    assert audit_study(copy) == []
    (copy.sessions / "sim002" / "plan.json").write_bytes(back)
    assert find_only(copy).startswith(
        f"{copy.sessions / 'sim002' / 'plan.json'}: lies beside a tombstone"
    )


def test_strangers_are_named_once_and_the_others_are_audited_still(copy: StudyFolder) -> None:
    shutil.copytree(copy.sessions / "sim002", copy.sessions / "sim001 backup")
    (copy.sessions / "@eaDir").mkdir()
    (copy.sessions / "sim002" / "plan.json").write_bytes(b"{}")
    findings = audit_study(copy)
    assert [line.partition(": ")[0] for line in findings] == [
        str(copy.sessions / name) for name in ("@eaDir", "sim001 backup", "sim002/plan.json")
    ]
    assert findings[0].endswith(f"not a participant's folder; move it out of {copy.sessions}")


@pytest.mark.parametrize(
    "body", [b'{\n "a": 1\n}', b'{\n "format": 2\n}', b'{\n "format": 2, "flow": 1\n}']
)
def test_a_sealed_plan_of_other_fields_is_a_finding(copy: StudyFolder, body: bytes) -> None:
    path = copy.sessions / "sim001" / "plan.json"
    path.write_bytes(
        body.removesuffix(b"\n}") + b',\n "sha256": "' + digest(body).encode() + b'"\n}\n'
    )
    assert find_only(copy).startswith(f"{path}: ")


@pytest.mark.parametrize("changes", [{"utc": None}, {"utc": "now"}, {"event": 5}, {"data": []}])
def test_a_malformed_record_hides_nobody_else(copy: StudyFolder, changes: dict[str, Any]) -> None:
    first, second = copy.journals[:2]
    records = list(read_journal(first).records)
    records[-1] = replace(records[-1], **changes)
    first.write_bytes(chain_anew(records))
    second.write_bytes(second.read_bytes().replace(b"test", b"tent"))
    findings = audit_study(copy)
    assert any(line.startswith(str(first)) for line in findings)
    assert any(line.startswith(f"{second}, line ") for line in findings)


def test_progress_is_told_per_participant(copy: StudyFolder) -> None:
    told: list[tuple[int, int]] = []
    examine(copy, progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_a_manifest_that_is_gone_is_found(copy: StudyFolder) -> None:
    (copy.stimuli / "manifest.json").unlink()
    assert find_only(copy).startswith(f"{copy.stimuli / 'manifest.json'}: is missing or damaged")
    copy.manifest.unlink()
    assert find_only(copy).startswith(f"{copy.manifest}: there is no manifest")


def test_a_study_in_which_nothing_was_done_gives_no_finding(tmp_path: Path) -> None:
    assert audit_study(StudyFolder(tmp_path)) == []


def test_a_set_that_nobody_was_planned_with_is_found(copy: StudyFolder) -> None:
    copy.manifest.write_bytes(copy.manifest.read_bytes().replace(b"\r\n", b"\n"))
    plans = [copy.sessions / f"sim00{number}" / "plan.json" for number in (1, 2, 3)]
    assert audit_study(copy) == [
        f"{path}: names another stimulus set than the one that is built" for path in plans
    ]
