"""Answers to question pages: `answers.csv`, and personal ones apart from the journal in `personal.jsonl`.

The journal's record of a personal answer holds the salted SHA-256 of it, the file the answer and the salt. So the file
can be removed, and the journal's chain still holds; without the salt the digest does not show what was answered. The
answer is on the disk before the record is: an answer without its record was never given, and is dropped at the next.
"""

import hashlib
import json
import secrets
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from feel321.files import write_text
from feel321.protocols.texts import PREFIX, find_question
from feel321.study.folder import StudyFolder
from feel321.study.session.events import QuestionAnswered, SessionSuperseded
from feel321.study.session.journal import Journal, Records
from feel321.study.session.plan import Dossier, read_as_written

Row = dict[str, Any]

ANSWERS_FILE, PERSONAL_FILE = "answers.csv", "personal.jsonl"

COLUMNS = (
    "participant", "session", "question", "kind", "when", "occasion", "answer", "personal", "response_time_s",
    "rejected", "simulated", "storage",
)  # fmt: skip

_PLACE = ("session", "question", "occasion")


def write_answers(study: StudyFolder) -> list[Row]:
    """Write all answers of a study, if it has or had any; those of a session begun anew are marked as rejected."""
    rows = [row for one in study.read_people() for row in list_answers(one)]
    study.write_table(ANSWERS_FILE, COLUMNS, rows, is_optional=True)
    return rows


def list_answers(dossier: Dossier) -> list[Row]:
    """List the answers of one participant."""
    plan, personal = dossier.plan, read_personal(dossier.folder)
    rows: list[Row] = []
    flags = {True: "true", False: "false"}
    for session, chain in enumerate(dossier.chains, start=1):
        is_rejected = chain.records.has(SessionSuperseded)
        with read_as_written(dossier.folder):
            answers = list(chain.records.find(QuestionAnswered))
        for one in answers:
            question = find_question(plan.questions, f"{PREFIX}{one.question}")
            value, storage = one.value, "journal"
            if one.sha256:
                value = personal.get(one.sha256)
                storage = "apart" if one.sha256 in personal else "removed"
            rows.append({
                "participant": plan.participant, "session": session, "question": one.question,
                "kind": question.kind if question else "", "when": question.when if question else "",
                "occasion": one.occasion, "answer": f"{value:.12g}" if isinstance(value, float | int) else value or "",
                "personal": flags[one.personal], "response_time_s": one.stood_s, "rejected": flags[is_rejected],
                "simulated": flags[plan.simulated], "storage": storage,
            })  # fmt: skip
    return rows


# Personal answers apart from the journal.


def make_keeper(folder: Path, journal: Journal) -> Callable[[str, int, float | str | None], str]:
    """Make what keeps a personal answer of a session before its record is written, and returns the digest for that."""
    header = journal.records.find_header()
    session = header.session if header else 1

    def keep(question: str, occasion: int, value: float | str | None) -> str:
        known = {event.sha256 for event in journal.records.find(QuestionAnswered)}
        row = {"session": session, "question": question, "occasion": occasion, "value": value}
        salt = secrets.token_hex(16)
        sha256 = _digest(folder.name, row, salt)
        # Without the answers of this session whose records were never written.
        others = _read_rows(folder)
        rows = [one for one in others if one["session"] != session or one["sha256"] in known]
        rows.append(row | {"salt": salt, "sha256": sha256})
        text = "".join(f"{json.dumps(one, ensure_ascii=False)}\n" for one in rows)
        write_text(folder / PERSONAL_FILE, text, private=True)
        return sha256

    return keep


def read_personal(folder: Path) -> dict[str, Any]:
    """Read the personal answers of a participant by their digests; none where the file was removed."""
    found = {}
    for row in _read_rows(folder):
        if _digest(folder.name, row, row["salt"]) != row["sha256"]:
            raise ValueError(
                f"{folder / PERSONAL_FILE}: {row['question']} was changed after it was written; restore it from a copy"
            )
        found[row["sha256"]] = row["value"]
    return found


def _digest(participant: str, row: Row, salt: str) -> str:
    text = json.dumps([salt, participant, *(row[name] for name in _PLACE), row["value"]])
    return hashlib.sha256(text.encode()).hexdigest()


def _read_rows(folder: Path) -> list[Row]:
    path = folder / PERSONAL_FILE
    if not path.is_file():
        return []
    try:
        rows = [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()]
        is_ours = all({*row} == {*_PLACE, "value", "salt", "sha256"} for row in rows)
    except (TypeError, ValueError, RecursionError):
        is_ours = False
    if not is_ours:
        raise ValueError(f"{path}: not as feel321 wrote it; restore it from a copy")
    return rows


def audit_personal(folder: Path, records: Records) -> Iterator[str]:
    """Check that the participant's file has each personal answer that a journal names, unless it was removed whole."""
    named = [one for one in records.find(QuestionAnswered) if one.sha256]
    if not named or not (folder / PERSONAL_FILE).is_file():
        return
    try:
        kept = read_personal(folder)
    except ValueError as error:
        yield f": {error}"
        return
    if gone := [one.question for one in named if one.sha256 not in kept]:
        yield f": personal answers {', '.join(gone)} are gone from {PERSONAL_FILE}; restore it from a copy"
