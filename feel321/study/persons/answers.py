"""`answers.csv`: one row per answer to a question page, derived from the journals and from nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from feel321.files import write_table
from feel321.protocols.questions import PREFIX, find_question
from feel321.study.persons.vault import Vault, find_vault, read_answers_apart
from feel321.study.session.events import QuestionAnswered, SessionSuperseded
from feel321.study.session.plan import TOMBSTONE_FILE, read_as_written, read_dossier

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.folder import StudyFolder
    from feel321.study.session.plan import Plan

ANSWERS_FILE = "answers.csv"

COLUMNS = (
    "participant", "session", "question", "kind", "when", "occasion", "answer", "personal", "response_time_s",
    "rejected", "simulated", "storage",
)  # fmt: skip


def write_answers(study: StudyFolder) -> list[dict[str, Any]]:
    """Write all answers of a study, if it has or had any, and return them.

    Those of a session that was begun anew are there and marked as rejected; `storage` says how each is kept. Personal
    answers that are encrypted are returned with the passphrase only (environment variable FEEL321_PASSPHRASE), and
    never written.
    """
    vault = find_vault(study)
    rows = [row for folder in study.participants for row in read_answers(folder, vault)]
    path = study.path / ANSWERS_FILE
    if rows or path.exists():
        sealed = {"answer": ""}
        kept = (row | sealed if row["storage"] == "encrypted" else row for row in rows)
        write_table(path, COLUMNS, kept, private=True)
        study.share(path)
    return rows


def try_vault(study: StudyFolder) -> Vault | None:
    """Take the passphrase of the environment; none where it is another, or files of answers are damaged."""
    try:
        return find_vault(study)
    except (OSError, ValueError):
        return None


def read_answers(folder: Path, vault: Vault | None = None) -> Iterator[dict[str, Any]]:
    """Read the answers of one participant; a withdrawn one has none."""
    if (folder / TOMBSTONE_FILE).exists():
        return
    dossier = read_dossier(folder)
    plan, apart = dossier.plan, read_answers_apart(folder, vault)
    for number, chain in enumerate(dossier.chains, start=1):
        facts = {
            "session": number,
            "rejected": _write_flag(is_so=chain.records.has(SessionSuperseded)),
            "simulated": _write_flag(is_so=plan.simulated),
        }
        with read_as_written(folder):
            answers = list(chain.records.find(QuestionAnswered))
        yield from ({**_describe(one, plan, apart), **facts} for one in answers)


def _describe(
    answered: QuestionAnswered, plan: Plan, apart: Mapping[str, tuple[str, Any]]
) -> dict[str, Any]:
    question = find_question(plan.questions, f"{PREFIX}{answered.question}")
    storage, value = "journal", answered.value
    if answered.sha256:
        storage, value = apart.get(answered.sha256, ("removed", None))
    return {
        "participant": plan.participant,
        "question": answered.question,
        "kind": question.kind if question else "",
        "when": question.when if question else "",
        "occasion": answered.occasion,
        "answer": _write_value(value),
        "personal": _write_flag(is_so=answered.personal),
        "response_time_s": answered.stood_s,
        "storage": storage,
    }


def _write_value(value: float | str | None) -> str:
    return "" if value is None else value if isinstance(value, str) else f"{value:.12g}"


def _write_flag(*, is_so: bool) -> str:
    return "true" if is_so else "false"
