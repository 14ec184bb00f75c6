"""Answers of a whole study, derived and gone with who withdraws; personal ones are apart from the journal."""

import csv
import json
from pathlib import Path

import pytest

from feel321.study.evidence.audit import examine
from feel321.study.folder import StudyFolder
from feel321.study.participants import answers
from feel321.study.participants.answers import write_answers
from feel321.study.session.journal import read_journal, utc_now
from feel321.study.simulate import simulate_study
from feel321.study.withdrawal import withdraw_participant
from tests.study.conftest import audit_study
from tests.study.participants.conftest import ASKING, copy_study

SCALES = """
[tasks.realism]
scales = ["roughness", "realism"]
[scales.roughness]
question = "How rough did it feel?"
low = "Smooth"
high = "Rough"
"""


def read_table(study: StudyFolder, name: str = "answers.csv") -> list[dict[str, str]]:
    with (study.path / name).open(encoding="utf-8", newline="") as file:
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


def test_scales_and_answers_from_session_to_table(smallest: StudyFolder) -> None:
    with smallest.settings.open("a", encoding="utf-8") as file:
        file.write(SCALES + ASKING)
    simulate_study(smallest, participants=2, seed=3, now=utc_now)
    assert audit_study(smallest) == []
    ratings = read_table(smallest, "ratings.csv")
    assert [row["scale"] for row in ratings] == ["roughness", "realism"] * 4
    by_scale = {
        scale: [row["rating"] for row in ratings if row["scale"] == scale]
        for scale in ("roughness", "realism")
    }
    assert by_scale["roughness"] != by_scale["realism"]
    answered = read_table(smallest)
    assert [row["question"] for row in answered] == ["age", "hand"] * 2
    assert {row["personal"] for row in answered} == {"true"}
    assert all(5 <= float(row["answer"]) <= 120 for row in answered if row["question"] == "age")
    before = (smallest.path / answers.ANSWERS_FILE).read_bytes()
    simulate_study(
        smallest, participants=2, seed=3, now=utc_now
    )  # finished sessions stay as they are
    assert (smallest.path / answers.ANSWERS_FILE).read_bytes() == before
    withdraw_participant(smallest, "sim001", now=utc_now)
    assert {row["participant"] for row in read_table(smallest)} == {"sim002"}
    withdraw_participant(smallest, "sim002", now=utc_now)
    assert read_table(smallest) == write_answers(smallest) == []
