"""Answers of a whole study: simulated, derived, and gone with who withdraws."""

from __future__ import annotations

import csv
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from feel321.study.auditing.study import audit_study
from feel321.study.persons.answers import ANSWERS_FILE, write_answers
from feel321.study.persons.withdrawal import withdraw_participant
from feel321.study.simulation import simulate_study

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder

ASKING = """
[tasks.realism]
scales = ["roughness", "realism"]
[scales.roughness]
question = "How rough did it feel?"
low = "Smooth"
high = "Rough"
[[session.questions]]
name = "age"
kind = "number"
question = "How old are you?"
low = 5
high = 120
personal = true
required = false
[[session.questions]]
name = "hand"
kind = "choice"
question = "Which hand?"
options = ["left", "right"]
personal = true
"""


def now() -> datetime:
    return datetime.now(UTC)


def read(study: StudyFolder, name: str) -> list[dict[str, str]]:
    with (study.path / name).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_scales_and_answers_from_session_to_table(smallest: StudyFolder) -> None:
    with smallest.settings.open("a", encoding="utf-8") as file:
        file.write(ASKING)
    simulate_study(smallest, participants=2, seed=3, now=now)
    assert audit_study(smallest) == []
    ratings = read(smallest, "ratings.csv")
    assert [row["scale"] for row in ratings] == ["roughness", "realism"] * 4
    by_scale = {
        scale: [row["rating"] for row in ratings if row["scale"] == scale]
        for scale in ("roughness", "realism")
    }
    assert by_scale["roughness"] != by_scale["realism"]
    answers = read(smallest, ANSWERS_FILE)
    assert [row["question"] for row in answers] == ["age", "hand"] * 2
    assert {row["personal"] for row in answers} == {"true"}
    assert all(5 <= float(row["answer"]) <= 120 for row in answers if row["question"] == "age")
    before = (smallest.path / ANSWERS_FILE).read_bytes()
    simulate_study(
        smallest, participants=2, seed=3, now=now
    )  # finished sessions stay what they are
    assert (smallest.path / ANSWERS_FILE).read_bytes() == before
    withdraw_participant(smallest, "sim001", now=now)
    assert {row["participant"] for row in read(smallest, ANSWERS_FILE)} == {"sim002"}
    withdraw_participant(smallest, "sim002", now=now)
    assert read(smallest, ANSWERS_FILE) == write_answers(smallest) == []
