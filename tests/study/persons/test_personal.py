"""Personal answers apart from the journal: bound to it, removable, whole after a kill."""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

import pytest

from feel321.study.auditing.study import audit_study, examine
from feel321.study.checkpoints import read_own
from feel321.study.cli import main
from feel321.study.collect import collect_sessions
from feel321.study.persons import answers
from feel321.study.session.journal import list_journals, read_journal, utc_now
from feel321.study.simulation import simulate_study
from feel321.study.study import Study
from tests.study.persons.conftest import copy_study

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
def held(made_held: StudyFolder, tmp_path: Path) -> StudyFolder:
    """Two sessions with personal answers."""
    return copy_study(made_held, tmp_path / "study")


def test_personal_answers_are_in_no_journal(held: StudyFolder) -> None:
    assert {row["storage"] for row in read_table(held)} == {"apart"}
    assert all(list_values(held))
    records = [r for path in held.journals for r in read_journal(path).records]
    answered = [record.data for record in records if record.event == "answered"]
    assert {(one["value"], len(one["sha256"])) for one in answered} == {(None, 64)}
    assert len({one["sha256"] for one in answered}) == len(answered)
    assert audit_study(held) == []


def test_an_answer_cannot_be_changed_moved_or_exchanged(held: StudyFolder) -> None:
    path = held.sessions / "sim001" / "personal.jsonl"
    first, second, *rest = path.read_text().splitlines()
    one, two = json.loads(first), json.loads(second)
    swapped = [one | {"value": two["value"]}, two | {"value": one["value"]}]
    moved = [one | {"question": two["question"]}, two]
    for forged in (swapped, moved):
        path.write_text("\n".join([*map(json.dumps, forged), *rest]) + "\n")
        with pytest.raises(ValueError, match="was changed after it was written"):
            answers.read_personal(path.parent)
        assert "was changed after it was written" in "\n".join(audit_study(held))
    path.write_text("\n".join([second, *rest]) + "\n")
    assert f"personal answers {one['question']} are gone" in "\n".join(audit_study(held))
    path.write_text("nonsense")
    assert "not as feel321 wrote it" in "\n".join(audit_study(held))
    path.write_text("[1]\n")
    assert "not as feel321 wrote it" in "\n".join(audit_study(held))


def test_an_answer_whose_record_was_never_written_is_dropped(tmp_path: Path) -> None:
    row = {"session": 1, "question": "age", "occasion": 1, "value": 44.0}
    folder = tmp_path / "p01"
    folder.mkdir()
    lost = answers.keep_answer(folder, row, known=set())
    kept = answers.keep_answer(folder, row | {"value": 45.0}, known=set())
    other = answers.keep_answer(folder, row | {"session": 2}, known=set())
    assert lost not in (found := answers.read_personal(folder))
    assert [found[one] for one in (kept, other)] == [45.0, 44.0]


def test_the_file_may_be_removed_and_the_ratings_stay(held: StudyFolder) -> None:
    ratings = held.ratings.read_bytes()
    (held.sessions / "sim001" / "personal.jsonl").unlink()
    assert "answers.csv" in "\n".join(examine(held).findings)  # which still holds them
    answers.write_answers(held)
    by_who = {(row["participant"], row["storage"], bool(row["answer"])) for row in read_table(held)}
    assert by_who == {("sim001", "removed", False), ("sim002", "apart", True)}
    assert audit_study(held) == []
    assert held.ratings.read_bytes() == ratings


DYING = """
import os, signal, sys
from pathlib import Path
from feel321.study.folder import StudyFolder
from feel321.study.session.journal import utc_now
from feel321.study.simulation import simulate_study
import feel321.stimuli.sets.manifest, feel321.study.sessions, feel321.study.persons.answers, filelock
root, steps = Path(sys.argv[1]), [int(one) for one in sys.argv[2].split(",")]
watched = {"open", "os.remove", "os.rename", "os.rmdir", "os.truncate", "sqlite3.connect"}
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
        simulate_study(study, participants=1, seed=3, now=utc_now)
        os._exit(0)
    _, status = os.waitpid(child, 0)
    print(step, "whole" if os.WIFEXITED(status) else "killed", flush=True)
"""


def kill_at(study: StudyFolder, root: Path, steps: range) -> dict[int, str]:
    root.mkdir()
    for step in steps:
        shutil.copytree(study.path, root / str(step))
    command = [sys.executable, "-c", DYING, root, ",".join(map(str, steps))]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    return {int(line.split()[0]): line.split()[1] for line in done.stdout.splitlines()}


@pytest.mark.parametrize("stride", [150, pytest.param(2, marks=pytest.mark.soak)])
def test_after_any_kill_each_answer_has_its_record_and_each_record_its_answer(
    asking: StudyFolder, tmp_path: Path, stride: int
) -> None:
    ends = kill_at(asking, tmp_path / "kills", range(0, 200, stride))
    assert "killed" in ends.values()
    simulate_study(asking, participants=1, seed=3, now=utc_now)
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
            assert named <= answers.read_personal(folder).keys(), step
        simulate_study(study, participants=1, seed=3, now=utc_now)
        assert list_values(study) == whole, step
        assert audit_study(study) == [], step


def test_a_withdrawal_is_declared(held: StudyFolder) -> None:
    assert examine(held).findings == ()
    assert main(["seal", str(held.path)]) == 0
    assert main(["withdraw", str(held.path), "--participant", "sim001", "--yes"]) == 0
    last = read_own(held)[0][-1]
    assert (last.by, last.who) == ("withdraw", "sim001")
    assert examine(held).findings == ()


def test_answers_apart_are_collected_with_the_journal_that_names_them(
    held: StudyFolder, tmp_path: Path
) -> None:
    main_study = type(held)(tmp_path / "main")
    shutil.copytree(held.path, main_study.path)
    shutil.rmtree(main_study.sessions)
    for name in ("ratings.csv", "participants.csv", "answers.csv"):
        (main_study.path / name).unlink()
    found = collect_sessions(main_study, [held.path], now=utc_now)
    assert (found.refused, found.notes) == ([], [])
    assert list_values(main_study) == list_values(held)
    assert audit_study(main_study) == []
