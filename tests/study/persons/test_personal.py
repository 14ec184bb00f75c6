"""Personal answers apart from the journal: bound to it, removable, whole after a kill."""

from __future__ import annotations

import csv
import json
from typing import TYPE_CHECKING

import pytest

from feel321.study.auditing.study import audit_study, examine
from feel321.study.persons import answers
from feel321.study.persons.answers import write_answers
from feel321.study.session.journal import read_journal
from tests.study.persons.conftest import copy_study

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.folder import StudyFolder


def read_table(study: StudyFolder) -> list[dict[str, str]]:
    with (study.path / "answers.csv").open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def list_values(study: StudyFolder) -> list[str]:
    return [row["answer"] for row in write_answers(study)]


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


def test_the_file_may_be_removed_and_the_ratings_stay(held: StudyFolder) -> None:
    ratings = held.ratings.read_bytes()
    (held.sessions / "sim001" / "personal.jsonl").unlink()
    assert "answers.csv" in "\n".join(examine(held).findings)  # which still holds them
    answers.write_answers(held)
    by_who = {(row["participant"], row["storage"], bool(row["answer"])) for row in read_table(held)}
    assert by_who == {("sim001", "removed", False), ("sim002", "apart", True)}
    assert audit_study(held) == []
    assert held.ratings.read_bytes() == ratings
