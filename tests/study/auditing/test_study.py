"""What was once written and is no longer so: audit finds it, names the file, and the line where there is one."""

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path
from typing import get_args

import pytest

from feel321.files import digest_file
from feel321.study.check import build_study
from feel321.study.evidence.audit import audit_journals, examine
from feel321.study.folder import StudyFolder
from feel321.study.participants.roster import write_roster
from feel321.study.session import events
from feel321.study.session.journal import Record, create_journal, read_journal, utc_now
from feel321.study.session.plan import Plan, Policy, Stale, require_plan
from feel321.study.simulate import simulate_study
from feel321.study.withdrawal import withdraw_participant
from tests.study.auditing.cheats import chain, reseal, shift_times
from tests.study.conftest import audit_study, make_settings

Present = Callable[..., list[Record]]

STUDY = make_settings("bumps", reducers=("sax321", "dft321"), stimuli="", protocol="similarity")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> StudyFolder:
    """A study that three participants have finished; to be copied, not touched."""
    study = StudyFolder(tmp_path_factory.mktemp("whole"))
    study.settings.write_text(STUDY, encoding="utf-8")
    build_study(study)
    simulate_study(study, participants=3, seed=None, now=utc_now)
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


def test_a_study_as_it_was_written_gives_no_finding(copy: StudyFolder, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    found = examine(copy, progress=lambda done, total: told.append((done, total)))
    assert found.findings == ()
    assert told == [(1, 3), (2, 3), (3, 3)]
    (tmp_path / "empty").mkdir()
    assert audit_study(StudyFolder(tmp_path / "empty")) == []


def change_wav(study: StudyFolder) -> None:
    wav = min(study.stimuli.glob("*.wav"))
    content = bytearray(wav.read_bytes())
    content[-5] ^= 1
    wav.write_bytes(content)


def forge_seed(study: StudyFolder) -> None:
    reseal(study.sessions / "sim001" / "plan.json", lambda plan: plan.update(seed=322))


def change_manifest(study: StudyFolder) -> None:
    path = study.stimuli / "manifest.json"
    entry = json.loads(path.read_text(encoding="utf-8"))
    entry["stimuli"][0]["spectral_match"] = 0.99
    path.write_text(json.dumps(entry, indent=1), encoding="utf-8")


def bring_back(study: StudyFolder) -> None:
    back = (study.sessions / "sim002" / "plan.json").read_bytes()
    withdraw_participant(study, "sim002", now=utc_now)
    assert audit_study(study) == []
    (study.sessions / "sim002" / "plan.json").write_bytes(back)


def make_time_run_backwards(study: StudyFolder) -> None:
    records = list(read_journal(study.journals[0]).records)
    records[4] = replace(records[4], utc="2001-01-01T00:00:00.000+00:00")
    chain(study.journals[0], records)


def rate_twice(study: StudyFolder) -> None:
    records = list(read_journal(study.journals[0]).records)
    chain(study.journals[0], [*records[:9], *records[8:]])


def lose_journal(study: StudyFolder) -> None:
    write_roster(study)
    (study.sessions / "sim001" / "session-01.jsonl").unlink()


def copy_as(study: StudyFolder, old: str, new: str) -> None:
    place = shutil.copytree if (study.sessions / old).is_dir() else shutil.copy
    place(study.sessions / old, study.sessions / new)


CHANGES: dict[str, tuple[Callable[[StudyFolder], object], list[str]]] = {
    "a wav": (change_wav, ["bumps__"]),
    "a plan": (
        lambda s: (s.sessions / "sim001/plan.json").write_bytes(b"{}"),
        ["{sim001}/plan.json: not a plan, or changed after it was stored"],
    ),
    "no plan": (
        lambda s: (s.sessions / "sim001/plan.json").unlink(),
        ["{sim001}/plan.json: is gone; restore the file"],
    ),
    "a plan forged with its digest": (
        forge_seed,
        [
            "{sim001}/session-01.jsonl: was begun with another plan than the one beside it",
            "{sim001}/session-01.jsonl, line 1: has seed 321, the plan says 322",
        ],
    ),
    "a journal copied as the next one": (
        lambda s: copy_as(s, "sim001/session-01.jsonl", "sim001/session-02.jsonl"),
        [
            "{sim001}/session-02.jsonl: is session 1 of 'sim001', it was copied here",
            "{sim001}/session-01.jsonl: does not mention session-02.jsonl",
        ],
    ),
    "a journal in the place of another": (
        lambda s: copy_as(s, "sim002/session-01.jsonl", "sim001/session-01.jsonl"),
        ["{sim001}/session-01.jsonl: is session 1 of 'sim002', it was copied here"],
    ),
    "a copied participant": (
        lambda s: copy_as(s, "sim002", "sim009"),
        [
            "{study}/sessions/sim009/plan.json: is the plan of 'sim002', it was copied here",
            "number 2 of simulated ones is that of sim002 and sim009",
        ],
    ),
    "a folder in the place of a journal": (
        lambda s: (s.sessions / "sim001/session-02.jsonl").mkdir(),
        ["{sim001}/session-02.jsonl: there is no such journal"],
    ),
    "a manifest": (change_manifest, ["{study}/stimuli: manifest.csv and manifest.json differ"]),
    "a manifest in UTF-16": (
        lambda s: s.manifest.write_text("a", encoding="utf-16"),
        ["{study}/stimuli/manifest.csv, line 1: the text is in UTF-16"],
    ),
    "a journal that is gone": (lose_journal, ["{study}/participants.csv, line 2: last_utc is "]),
    "no manifest": (lambda s: (s.stimuli / "manifest.json").unlink(), ["{study}/stimuli/manifest.json: "]),
    "a stimulus set that nobody was planned with": (
        lambda s: s.manifest.write_bytes(s.manifest.read_bytes().replace(b"\r\n", b"\n")),
        ["{sim001}/plan.json: names another stimulus set than the one that is built"],
    ),
    "a rating that stands there twice": (rate_twice, ["{sim001}/session-01.jsonl, line 10: holds 'rated', by "]),
    "time that runs backwards": (
        make_time_run_backwards,
        ["{sim001}/session-01.jsonl, line 5: is older than the line before"],
    ),
    "what lies beside a tombstone": (bring_back, ["{study}/sessions/sim002/plan.json: lies beside a tombstone"]),
    "a stranger": (
        lambda s: copy_as(s, "sim002", "sim001 backup"),
        ["{study}/sessions/sim001 backup: not a participant's folder"],
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", CHANGES)
def test_what_was_changed_is_named_and_another_change_is_found_still(
    copy: StudyFolder, what: str
) -> None:
    change, named = CHANGES[what]
    change(copy)
    third = copy.sessions / "sim003" / "session-01.jsonl"
    third.write_bytes(third.read_bytes().replace(b"test", b"tent"))
    found = audit_study(copy)
    for one in named:
        text = one.format(study=copy.path, sim001=copy.sessions / "sim001")
        assert any(line.startswith(text) for line in found), found
    assert any(line.startswith(f"{third}, line ") for line in found)


def test_a_journal_that_never_got_its_header_is_no_finding(copy: StudyFolder) -> None:
    path = copy.journals[0]
    path.write_bytes(b"")
    assert audit_study(copy) == []
    path.unlink()
    journal = create_journal(path, now=utc_now)
    own = (events.LineRecovered(1, "a"), events.ClockStepped(1.0), events.SessionReleased())
    for event in own:
        journal.write(event)
        assert audit_study(copy) == []
    journal.write(events.SessionFinished(0, 0))
    assert find_only(copy) == f"{path}: has no header"


@pytest.mark.parametrize("policy", get_args(Policy))
def test_who_comes_back_after_a_day_gives_no_finding(
    present: Present, scripted: type, now: Callable[[], datetime], tmp_path: Path, policy: str
) -> None:
    with pytest.raises(KeyboardInterrupt):
        present(scripted(stop_after=4))
    present(scripted(), now=lambda: now() + timedelta(days=1), stale=Stale(6.0, policy))
    folder = tmp_path / "sessions" / "p01"
    plan, journals = require_plan(folder / "plan.json"), sorted(folder.glob("*.jsonl"))
    assert len(journals) == 1 + (policy == "restart")
    assert list(audit_journals(folder, plan)) == []
    if policy == "restart":  # and the first says which took its place
        first, second = journals
        chain(first, [one for one in read_journal(first).records if one.event != "superseded"])
        said = f"{first}: does not mention {second.name}, which stands beside it"
        assert list(audit_journals(folder, plan)) == [said]
        first.unlink()
        said = f"{second}: is there without {first.name} before it"
        assert list(audit_journals(folder, plan)) == [said]


def test_a_time_of_day_that_parts_from_the_clock_of_a_session_with_a_person_is_found(
    present: Present, scripted: type, plan: Plan, tmp_path: Path
) -> None:
    plan = replace(plan, simulated=False)
    header, *others = present(scripted(), plan=plan)
    own = [replace(header, data=header.data | {"presenter": {"simulated": False}}), *others]
    path = tmp_path / "sessions" / "p01" / "session-01.jsonl"
    chain(path, own)
    assert list(audit_journals(path.parent, require_plan(path.with_name("plan.json")))) == []
    chain(path, shift_times(own))
    (found,) = audit_journals(path.parent, require_plan(path.with_name("plan.json")))
    assert found.endswith("by the clock of the session, and nothing says why")


def test_a_report_that_was_made_of_another_table_is_remarked(copy: StudyFolder) -> None:
    copy.report.mkdir()
    inputs = {"ratings": "ratings.csv", "ratings_sha256": "", "manifest": "manifest.csv"}
    for sha256, count in ((digest_file(copy.manifest), 0), ("0" * 64, 1)):
        told = {"inputs": inputs | {"manifest_sha256": sha256}}
        (copy.report / "results.json").write_text(json.dumps(told), encoding="utf-8")
        remarks = examine(copy).remarks
        assert sum("was computed from another manifest.csv" in one for one in remarks) == count
