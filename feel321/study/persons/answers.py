"""`answers.csv`: one row per answer to a question page, derived from the journals and from nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feel321.files import write_table
from feel321.protocols.questions import PREFIX, find_question
from feel321.study.session.events import QuestionAnswered, SessionSuperseded
from feel321.study.session.plan import TOMBSTONE_FILE, read_as_written, read_dossier

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from feel321.study.folder import StudyFolder

ANSWERS_FILE = "answers.csv"

COLUMNS = (
    "participant", "session", "question", "kind", "when", "occasion", "answer", "personal", "response_time_s",
    "rejected", "simulated",
)  # fmt: skip


def write_answers(study: StudyFolder) -> list[dict[str, Any]]:
    """Write all answers of a study, if it has or had any, and return them.

    Those of a session that was begun anew are there and marked as rejected.
    """
    rows = [row for folder in study.participants for row in read_answers(folder)]
    path = study.path / ANSWERS_FILE
    if rows or path.exists():
        write_table(path, COLUMNS, rows)
    return rows


def read_answers(folder: Path) -> Iterator[dict[str, Any]]:
    """Read the answers of one participant; a withdrawn one has none."""
    if (folder / TOMBSTONE_FILE).exists():
        return
    dossier = read_dossier(folder)
    plan = dossier.plan
    for number, chain in enumerate(dossier.chains, start=1):
        is_superseded = chain.records.has(SessionSuperseded)
        with read_as_written(folder):
            for answered in chain.records.find(QuestionAnswered):
                question = find_question(plan.questions, f"{PREFIX}{answered.question}")
                yield {
                    "participant": plan.participant,
                    "session": number,
                    "question": answered.question,
                    "kind": question.kind if question else "",
                    "when": question.when if question else "",
                    "occasion": answered.occasion,
                    "answer": _write_value(answered.value),
                    "personal": _write_flag(is_so=answered.personal),
                    "response_time_s": answered.stood_s,
                    "rejected": _write_flag(is_so=is_superseded),
                    "simulated": _write_flag(is_so=plan.simulated),
                }


def _write_value(value: float | str | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.12g}"


def _write_flag(*, is_so: bool) -> str:
    return "true" if is_so else "false"
