"""Personal answers apart from the journal: bound to it, encrypted with a passphrase, removable, whole after a kill."""

from __future__ import annotations

import csv
import json
import shutil
import stat
import subprocess
import sys
from datetime import date, timedelta
from typing import TYPE_CHECKING

import pytest

from feel321.study.auditing.study import audit_study, examine
from feel321.study.cli import main
from feel321.study.collect import collect_sessions
from feel321.study.persons import retention, vault
from feel321.study.persons.backup import back_up, read_manifest
from feel321.study.persons.inventory import read_inventory
from feel321.study.persons.modes import list_wide, tighten
from feel321.study.persons.outputs import recording_output
from feel321.study.persons.places import DataPlace, list_places
from feel321.study.persons.vault import UNLOCK_VARIABLE, Vault
from feel321.study.session.events import PersonalRemoved
from feel321.study.session.journal import list_journals, read_journal
from feel321.study.simulation import simulate_study
from feel321.study.study import Study
from tests.study.persons.conftest import TRUE, copy_study, now

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder


def read_table(study: StudyFolder) -> list[dict[str, str]]:
    with (study.path / "answers.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def list_values(study: StudyFolder) -> list[str]:
    return Study(study).answers()["answer"].tolist()


@pytest.fixture
def asking(made_asking: StudyFolder, tmp_path: Path) -> StudyFolder:
    return copy_study(made_asking, tmp_path / "study")


@pytest.fixture
def held(made_sealed: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> StudyFolder:
    """Two sessions whose personal answers are encrypted."""
    monkeypatch.setenv(UNLOCK_VARIABLE, TRUE)
    return copy_study(made_sealed, tmp_path / "study")


def test_the_same_answers_lie_apart_in_clear_and_encrypted(
    asking: StudyFolder, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    other = type(asking)(tmp_path / "other")
    shutil.copytree(asking.path, other.path)
    simulate_study(asking, participants=2, seed=3, now=now)
    values = list_values(asking)
    assert {row["storage"] for row in read_table(asking)} == {"apart"}
    assert all(values)
    monkeypatch.setenv(UNLOCK_VARIABLE, TRUE)
    simulate_study(other, participants=2, seed=3, now=now)
    assert list_values(other) == values
    assert {row["storage"] for row in read_table(other)} == {"encrypted"}
    for study in (asking, other):
        records = [r for path in study.journals for r in read_journal(path).records]
        answered = [record.data for record in records if record.event == "answered"]
        assert {(one["value"], len(one["sha256"])) for one in answered} == {(None, 64)}
        assert len({one["sha256"] for one in answered}) == len(answered)
        assert audit_study(study) == []
    salts = {
        json.loads((f / "personal.jsonl").read_text().split("\n")[0])["cost"]["salt"]
        for f in other.participants
    }
    assert len(salts) <= 2  # the first sessions begin side by side, all later ones share a key
    monkeypatch.delenv(UNLOCK_VARIABLE)
    assert set(list_values(other)) == {""}
    assert audit_study(other) == []
    text = (other.sessions / "sim001" / "personal.jsonl").read_text()
    assert '"value"' not in text
    assert '"salt"' not in text.split("\n", 1)[1]


def test_encrypted_answers_are_in_no_table_and_no_backup(
    held: StudyFolder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert all(list_values(held))
    assert {row["answer"] for row in read_table(held)} == {""}
    table = held.path / "answers.csv"
    header, first, *rest = table.read_text().splitlines()
    edited = first.split(",")
    edited[header.split(",").index("answer")] = "76"
    table.write_text("\n".join([header, ",".join(edited), *rest]) + "\n")
    assert "answer is '76'" in "\n".join(examine(held).findings)
    back_up(held, tmp_path / "safe", now=now)
    assert "answers.csv" not in read_manifest(tmp_path / "safe")["files"]
    monkeypatch.delenv(UNLOCK_VARIABLE)
    found = examine(held)
    assert found.findings == ()
    assert "1 encrypted answers stand there in clear and could not be compared" in "\n".join(
        found.remarks
    )


def test_another_passphrase_is_one_line(
    held: StudyFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(UNLOCK_VARIABLE, "a guess")
    assert main(["simulate", str(held.path), "--participants", "3"]) == 1
    told = capsys.readouterr().err
    assert "is not the passphrase that it was encrypted with" in told
    assert told.count("\n") == 1
    assert "a guess" not in told
    monkeypatch.delenv(UNLOCK_VARIABLE)
    assert main(["simulate", str(held.path), "--participants", "3"]) == 1
    assert "are encrypted, got no passphrase" in capsys.readouterr().err
    assert not (held.sessions / "sim003").exists()


def test_encryption_can_be_demanded(
    asking: StudyFolder, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with asking.settings.open("a", encoding="utf-8") as file:
        file.write("[data]\nencrypt_personal = true\n")
    monkeypatch.delenv(UNLOCK_VARIABLE, raising=False)
    assert main(["simulate", str(asking.path), "--participants", "1"]) == 1
    assert f"put it into the environment: {UNLOCK_VARIABLE}" in capsys.readouterr().err


def test_an_answer_cannot_be_changed_moved_or_exchanged(held: StudyFolder) -> None:
    path = held.sessions / "sim001" / "personal.jsonl"
    head, first, second, *rest = path.read_text().splitlines()
    one, two = json.loads(first), json.loads(second)
    swapped = [one | {"sealed": two["sealed"]}, two | {"sealed": one["sealed"]}]
    moved = [one | {"question": two["question"]}, two]
    for forged in (swapped, moved):
        path.write_text("\n".join([head, *map(json.dumps, forged), *rest]) + "\n")
        with pytest.raises(ValueError, match="was changed after it was written"):
            vault.read_answers_apart(path.parent, Vault(TRUE))
    path.write_text("\n".join([head, second, *rest]) + "\n")
    assert f"personal answers {one['question']} are gone" in "\n".join(audit_study(held))
    path.write_text("nonsense")
    assert "not as feel321 wrote it" in "\n".join(audit_study(held))


def test_a_passphrase_that_comes_in_mid_study_seals_what_is_there(tmp_path: Path) -> None:
    rows = [
        {"session": 1, "question": q, "occasion": 1, "value": v}
        for q, v in (("a", 44.0), ("b", None))
    ]
    folder = tmp_path / "p01"
    folder.mkdir()
    first = vault.keep_answer(folder, rows[0], known=set(), vault=None)
    second = vault.keep_answer(folder, rows[1], known={first}, vault=Vault("x"))
    assert vault.read_answers_apart(folder, Vault("x")) == {
        first: ("encrypted", 44.0), second: ("encrypted", None),
    }  # fmt: skip
    text = (folder / "personal.jsonl").read_text()
    assert '"value"' not in text
    assert text.count('"sealed"') == 2
    with pytest.raises(ValueError, match="is encrypted, got no passphrase"):
        vault.keep_answer(folder, rows[0], known=set(), vault=None)


def test_an_answer_whose_record_was_never_written_is_dropped(tmp_path: Path) -> None:
    row = {"session": 1, "question": "age", "occasion": 1, "value": 44.0}
    folder = tmp_path / "p01"
    folder.mkdir()
    lost = vault.keep_answer(folder, row, known=set(), vault=None)
    kept = vault.keep_answer(folder, row | {"value": 45.0}, known=set(), vault=None)
    other = vault.keep_answer(folder, row | {"session": 2}, known=set(), vault=None)
    assert lost not in (found := vault.read_answers_apart(folder, None))
    assert [found[one][1] for one in (kept, other)] == [45.0, 44.0]


def test_removal_leaves_ratings_and_a_record_that_stays_auditable(
    held: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    ratings = held.ratings.read_bytes()
    before = (held.sessions / "sim001" / "session-01.jsonl").read_bytes()
    assert main(["withdraw", str(held.path), "--participant", "sim001", "--personal", "--yes"]) == 0
    assert "removed the answers to age" in capsys.readouterr().out
    journal = held.sessions / "sim001" / "session-01.jsonl"
    assert journal.read_bytes().startswith(before)
    assert read_journal(journal).records[-1].event == PersonalRemoved.event
    assert held.ratings.read_bytes() == ratings
    by_who = {(row["participant"], row["storage"], bool(row["answer"])) for row in read_table(held)}
    assert by_who == {("sim001", "removed", False), ("sim002", "encrypted", False)}
    assert audit_study(held) == []
    assert main(["withdraw", str(held.path), "--participant", "sim001", "--personal", "--yes"]) == 1
    assert "no personal answers are kept" in capsys.readouterr().err
    shutil.copyfile(
        held.sessions / "sim002" / "personal.jsonl", held.sessions / "sim001" / "personal.jsonl"
    )
    assert (
        main(["audit", str(held.path)]) == 0
    )  # nothing of hers: another's answers name nobody here


def test_what_an_earlier_version_kept_in_the_journal_is_read_and_not_taken_out(
    asking: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("feel321.study.sessions.make_keeper", lambda *_, **__: None)
    simulate_study(asking, participants=1, seed=3, now=now)
    assert not (asking.sessions / "sim001" / "personal.jsonl").exists()
    assert {row["storage"] for row in read_table(asking)} == {"journal"}
    assert all(list_values(asking))
    assert audit_study(asking) == []
    with pytest.raises(ValueError, match="cannot be taken out of its chain"):
        retention.remove_personal(asking, "sim001", now=now)


DYING = """
import os, signal, sys
from datetime import UTC, datetime
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.persons import retention
from feel321.study.simulation import simulate_study
import feel321.stimuli.sets.manifest, feel321.study.sessions, feel321.study.persons.vault, filelock
verb, root, steps = sys.argv[1], Path(sys.argv[2]), [int(one) for one in sys.argv[3].split(",")]
watched = {"open", "os.remove", "os.rename", "os.rmdir", "os.truncate", "sqlite3.connect"}
def now():
    return datetime.now(UTC)
def die_at(last):
    left = last
    def count(event, arguments):
        nonlocal left
        if event in watched and "sessions" in str(arguments[0]):
            left -= 1
            if left < 0:
                os.kill(os.getpid(), signal.SIGKILL)
    sys.addaudithook(count)
for step in steps:
    study, child = StudyFolder(root / str(step)), os.fork()
    if not child:
        die_at(step)
        if verb == "simulate":
            simulate_study(study, participants=1, seed=3, now=now)
        else:
            retention.remove_personal(study, "sim001", now=now)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    print(step, "whole" if os.WIFEXITED(status) else "killed", flush=True)
"""


def kill_at(study: StudyFolder, root: Path, verb: str, steps: range) -> dict[int, str]:
    root.mkdir()
    for step in steps:
        shutil.copytree(study.path, root / str(step))
    command = [sys.executable, "-c", DYING, verb, root, ",".join(map(str, steps))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {int(line.split()[0]): line.split()[1] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("stride", [150, pytest.param(2, marks=pytest.mark.soak)])
def test_after_any_kill_each_answer_has_its_record_and_each_record_its_answer(
    asking: StudyFolder, tmp_path: Path, stride: int
) -> None:
    ends = kill_at(asking, tmp_path / "kills", "simulate", range(0, 200, stride))
    assert "killed" in ends.values()
    simulate_study(asking, participants=1, seed=3, now=now)
    whole = list_values(asking)
    for step in ends:
        study = type(asking)(tmp_path / "kills" / str(step))
        for folder in study.participants:
            named = {
                record.data["sha256"]
                for path in list_journals(folder)
                for record in read_journal(path).records
                if record.event == "answered"
            }
            assert named <= vault.read_answers_apart(folder, None).keys(), step
        simulate_study(study, participants=1, seed=3, now=now)
        assert list_values(study) == whole, step
        assert audit_study(study) == [], step


@pytest.mark.parametrize("stride", [40, pytest.param(1, marks=pytest.mark.soak)])
def test_a_removal_that_is_killed_is_finished_by_the_same_call(
    asking: StudyFolder, tmp_path: Path, stride: int
) -> None:
    simulate_study(asking, participants=1, seed=3, now=now)
    ends = kill_at(asking, tmp_path / "kills", "remove", range(0, 60, stride))
    assert set(ends.values()) == {"killed", "whole"}
    for step in ends:
        study = type(asking)(tmp_path / "kills" / str(step))
        folder = study.sessions / "sim001"
        if (folder / "personal.jsonl").exists():
            retention.remove_personal(study, "sim001", now=now)
        removed = [
            r
            for r in read_journal(folder / "session-01.jsonl").records
            if r.event == "personal_removed"
        ]
        assert len(removed) == 1, step
        assert set(list_values(study)) == {""}, step
        assert audit_study(study) == [], step


@pytest.mark.parametrize(
    ("settings", "later", "found"),
    [
        ("keep_personal_months = 12", 364, []),
        ("keep_personal_months = 12", 367, ["personal", "personal"]),
        ('keep_until = "2031-12-31"', 0, []),
        ('keep_until = "2025-12-31"', 0, ["all", "all"]),
    ],
)
def test_what_is_due_is_said_and_goes_when_asked(
    held: StudyFolder,
    settings: str,
    later: int,
    found: list[str],
    capsys: pytest.CaptureFixture[str],
) -> None:
    with held.settings.open("a", encoding="utf-8") as file:
        file.write(f"[data]\n{settings}\n")
    today = now().date() + timedelta(days=later)
    assert [one.what for one in retention.list_due(held, today=today)] == found
    told = read_inventory(held, today=today).due
    assert len(told) == (len(found) + 1 if found else 0)
    if found and not later:
        assert main(["status", str(held.path)]) == 0
        assert "all data due for removal since 2025-12-31" in capsys.readouterr().out
        assert main(["withdraw", str(held.path), "--due", "--yes"]) == 0
        assert {path.name for f in held.participants for path in f.iterdir()} == {"withdrawn.json"}
        assert main(["inventory", str(held.path), "--due"]) == 0
        assert "nothing is due" in capsys.readouterr().out


def test_a_month_ends_where_it_ends() -> None:
    assert retention.add_months(date(2028, 1, 31), 1) == date(2028, 2, 29)
    assert retention.add_months(date(2027, 12, 5), 13) == date(2029, 1, 5)


def test_inventory_says_what_the_ethics_form_asks(held: StudyFolder) -> None:
    found = read_inventory(held, today=now().date())
    rows = {row.kind: row for row in found.rows}
    assert rows["personal"].encrypted == "yes"
    assert rows["personal"].participants == ("sim001", "sim002")
    assert rows["journal"].origin == "source"
    assert rows["ratings"].origin == "derived"
    assert found.wide == ()
    alone = read_inventory(held, today=now().date(), participant="sim002")
    assert {name for row in alone.rows for name in row.participants} == {"sim002"}
    assert "SSD" in found.summary()
    json.dumps(found.to_dict())


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no modes")
def test_what_an_earlier_version_left_open_is_named_and_closed(held: StudyFolder) -> None:
    journal = held.sessions / "sim001" / "session-01.jsonl"
    for path, mode in ((held.sessions, 0o755), (journal, 0o644), (held.ratings, 0o666)):
        path.chmod(mode)
    wide = read_inventory(held, today=now().date()).wide
    assert [line.partition(": ")[0] for line in wide[:-1]] == sorted(
        map(str, (held.sessions, journal, held.ratings))
    )
    assert wide[-1] == "mend: feel321 inventory --tighten"
    tighten(held)
    assert [oct(p.stat().st_mode)[-3:] for p in (held.sessions, journal, held.ratings)] == [
        "700", "600", "600",
    ]  # fmt: skip
    assert read_inventory(held, today=now().date()).wide == ()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows knows no modes")
@pytest.mark.parametrize(("shared", "modes"), [("false", (0o700, 0o600)), ("true", (0o750, 0o640))])
def test_results_are_as_private_as_the_sessions(
    asking: StudyFolder, shared: str, modes: tuple[int, int]
) -> None:
    with asking.settings.open("a", encoding="utf-8") as file:
        file.write(f"[data]\ngroup_readable = {shared}\n")
    with recording_output(asking, "analyze", asking.report, now=now):
        (asking.report / "tables").mkdir()
        (asking.report / "tables" / "raters.csv").touch()
    found = [asking.report, *asking.report.rglob("*")]
    assert [stat.S_IMODE(path.stat().st_mode) for path in found] == [modes[0], *modes]
    (asking.report / "tables" / "raters.csv").chmod(0o644)
    assert [path.name for path, *_ in list_wide(asking)] == ["raters.csv"]


def test_an_inventory_skips_what_is_just_removed(
    held: StudyFolder, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = DataPlace(held.path / "feel321-1-gone", "temporary")
    listed = [*list_places(held), gone]
    monkeypatch.setattr("feel321.study.persons.places.list_places", lambda _: iter(listed))
    assert "temporary" not in {row.kind for row in read_inventory(held, today=now().date()).rows}


def test_a_withdrawal_is_in_the_chain_and_what_is_due_in_check(
    held: StudyFolder, capsys: pytest.CaptureFixture[str]
) -> None:
    assert examine(held).findings == ()
    assert main(["seal", str(held.path)]) == 0
    before = read_journal(held.path / "checkpoints.jsonl").records
    assert main(["withdraw", str(held.path), "--participant", "sim001", "--yes"]) == 0
    after = read_journal(held.path / "checkpoints.jsonl").records
    assert len(after) == len(before) + 1
    assert any("sim001" in name for name in after[-1].data["marks"])
    assert examine(held).findings == ()
    with held.settings.open("a", encoding="utf-8") as file:
        file.write('[data]\nkeep_until = "2025-12-31"\n')
    capsys.readouterr()
    main(["check", str(held.path)])
    assert "sim002: all data due for removal since 2025-12-31" in capsys.readouterr().err


def test_answers_apart_are_collected_with_the_journal_that_names_them(
    held: StudyFolder, tmp_path: Path
) -> None:
    main_study = type(held)(tmp_path / "main")
    shutil.copytree(held.path, main_study.path)
    shutil.rmtree(main_study.sessions)
    for name in ("ratings.csv", "participants.csv", "answers.csv"):
        (main_study.path / name).unlink()
    found = collect_sessions(main_study, [held.path], now=now)
    assert (found.refused, found.notes) == ([], [])
    assert list_values(main_study) == list_values(held)
    assert audit_study(main_study) == []
