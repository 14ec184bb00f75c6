"""Participants of a dataset under new numbers, and which of their data may be passed on."""

from __future__ import annotations

import hashlib
import hmac
import re
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321.files import write_text
from feel321.protocols.texts import find_question
from feel321.study import people as progresses
from feel321.study.persons.answers import list_answers
from feel321.study.ratings import list_judgements

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder

KEY_FILE = ".export.key"
"""File in the study's folder: the key that draws the new numbers. It is never exported."""

LABEL = re.compile(r"[0-9A-Za-z]+")
"""What BIDS allows as the label of a participant."""

OLDEST, BAND = 80, 5
"""Ages are given in bands of five years, and from 80 on as one."""


@dataclass(frozen=True, slots=True)
class Person:
    """A participant of a dataset; label: after `sub-`; rows: the judgements, as `ratings.csv` has them."""

    label: str
    progress: progresses.Progress
    rows: tuple[dict[str, Any], ...]
    answers: dict[str, str]

    @property
    def name(self) -> str:
        """The name in every table."""
        return f"sub-{self.label}"


def gather_people(
    study: StudyFolder, stimuli: StimulusSet, *, keep_ids: bool, simulated: bool
) -> list[Person]:
    """Gather everybody who judged something and did not withdraw; simulated people only where they are asked for."""
    everybody = [one for one in progresses.list_progress(study) if simulated or not one.simulated]
    rows = {
        one.participant: list_judgements(
            study.read_person(study.sessions / one.participant), stimuli
        )
        for one in everybody
    }
    everybody = [one for one in everybody if rows[one.participant]]
    if not everybody:
        hint = "; simulated participants are exported with --simulated only" * bool(
            study.participants
        )
        raise ValueError(f"{study.path}: no ratings of real participants to export{hint}")
    labels = name_people(study, [one.participant for one in everybody], keep_ids=keep_ids)
    people = [
        Person(
            labels[one.participant],
            one,
            tuple(rows[one.participant]),
            list_passed_on(study, one.participant),
        )
        for one in everybody
    ]
    return sorted(people, key=lambda person: person.label)


def name_people(study: StudyFolder, names: Sequence[str], *, keep_ids: bool) -> dict[str, str]:
    """Give participants new numbers in an order that only the study's own key gives; or check their codes."""
    if keep_ids:
        if odd := [name for name in names if not LABEL.fullmatch(name)]:
            raise ValueError(
                f"--keep-ids: BIDS allows letters and digits in a participant's code, got {odd[0]!r}; export without it"
            )
        return {name: name for name in names}
    path = study.path / KEY_FILE
    if not path.exists():
        write_text(path, f"{secrets.token_hex(32)}\n", private=True)
    key = bytes.fromhex(path.read_text(encoding="utf-8").strip())
    drawn = sorted(names, key=lambda name: hmac.new(key, name.encode(), hashlib.sha256).hexdigest())
    width = max(2, len(str(len(drawn))))
    return {name: f"{number:0{width}}" for number, name in enumerate(drawn, start=1)}


def list_passed_on(study: StudyFolder, participant: str) -> dict[str, str]:
    """List the answers to question pages that may be passed on: nothing personal, nothing typed freely."""
    own = study.read_person(study.sessions / participant)
    answers = {}
    for row in list_answers(own):
        question = find_question(own.plan.questions, f"question.{row['question']}")
        is_open = row["personal"] == "true" or row["kind"] not in {"choice", "number", "likert"}
        if is_open or question is None or row["rejected"] == "true" or row["answer"] == "":
            continue
        repeated = row["occasion"] > 1 or question.when == "between"
        name, answer = blur(row["question"], row["answer"])
        answers[f"{name}_{row['occasion']}" if repeated else name] = answer
    return answers


def blur(question: str, answer: str) -> tuple[str, str]:
    """Give an answer as it may be passed on, and its name: an age as a band, everything else as it is."""
    if question.casefold() == "age" and answer.replace(".", "", 1).isdigit():
        return "age_band", band_age(float(answer))
    return question, answer


def band_age(years: float) -> str:
    """Give an age as a band of five years.

    Examples
    --------
    >>> band_age(23), band_age(91)
    ('20-24', '80+')
    """
    if years >= OLDEST:
        return f"{OLDEST}+"
    low = int(years // BAND) * BAND
    return f"{low}-{low + BAND - 1}"


def number_names(values: Iterable[str], stem: str) -> dict[str, str]:
    """Give numbers to names that tell where and when something was made; `uncalibrated` and nothing stay."""
    kept = {"", "uncalibrated"}
    found = [value for value in dict.fromkeys(values) if value not in kept]
    return {value: value for value in kept} | {
        value: f"{stem}{number}" for number, value in enumerate(sorted(found), start=1)
    }
