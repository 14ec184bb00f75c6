"""A study as a BIDS dataset of behavioural data (`beh`): what `feel321 export` writes."""

from __future__ import annotations

import csv
import hashlib
import hmac
import json
import math
import re
import secrets
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from feel321 import __version__, intake
from feel321.analysis.table.dictionary import describe_column
from feel321.analysis.table.metrics import gather_info
from feel321.files import (
    digest_file,
    make_folder,
    sync_folder,
    temporary_folder,
    write_bytes,
    write_text,
)
from feel321.protocols.texts import find_question
from feel321.records import to_json_value
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study.analyze import list_info
from feel321.study.checkpoints import find_newest
from feel321.study.export.narrative import METHODS_FILE, make_methods, render
from feel321.study.folder import RATING_COLUMNS
from feel321.study.people import Progress, list_progress
from feel321.study.persons.answers import list_answers
from feel321.study.ratings import list_judgements, write_ratings
from feel321.study.settings.read import (
    list_origins,
    make_design,
    read_settings,
    read_study_texts,
)  # fmt: skip

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.protocols.texts import Question
    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings
    from feel321.types import MetricInfo

Row = Mapping[str, str]
Meanings = Mapping[str, Mapping[str, Any]]
"""Column -> what its sidecar says of it."""

BIDS_VERSION = "1.11.0"
MISSING = "n/a"
"""What BIDS writes in a cell without a value."""

NO_METHODS = f"{METHODS_FILE}: left out, for no report is of these ratings; feel321 analyze, then export again"

FLAGS = {"rejected", "simulated", "training_passed"}
OWN = {
    "participant_id": "participant of this dataset; numbers are unrelated to the order of participation",
    "state": "how the session ended: finished, or running if it was interrupted",
    "answered": "trials with an answer that counts",
    "given_up": "trials given up after all attempts",
    "total": "trials planned",
    "age_band": "age in years, in bands of five years; 80 or more as one",
    "rig": "rig of the sessions, numbered",
    "calibration": "certificate of calibration of the rig, numbered",
    "training_passed": "whether the training criterion was met",
}
"""Meanings of columns that the data dictionary lacks or defines differently."""


KEY_FILE = ".export.key"
"""File in the study's folder: the key that draws the new numbers. It is never exported."""

LABEL = re.compile(r"[0-9A-Za-z]+")
"""What BIDS allows as the label of a participant."""

OLDEST, BAND = 80, 5
"""Ages are given in bands of five years, and from 80 on as one."""


def export_bids(
    study: StudyFolder, folder: Path, *, keep_ids: bool = False, simulated: bool = False
) -> list[str]:
    """Write the dataset into a new folder, and list what is missing from it.

    keep_ids: keep the study's codes of participants. simulated: simulated participants too.
    """
    is_empty = folder.is_dir() and not any(folder.iterdir())
    if folder.is_symlink() or (folder.exists() and not is_empty):
        raise FileExistsError(f"{folder}: already holds something; name a new or empty folder")
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli)
    people = gather_people(study, stimuli, keep_ids=keep_ids, simulated=simulated)
    write_ratings(study, stimuli)
    make_folder(folder.parent)
    with temporary_folder(beside=folder) as place:
        new = place / folder.name
        make_folder(new, private=True)
        missing = [*settings.publication.list_missing(), *_write_methods(study, new)]
        _write_words(study, settings, people, folder=new)
        _write_participants(people, new / "participants")
        _write_answers(people, make_design(settings, study.path).questions, folder=new)
        _write_stimuli(study, settings, new / "stimuli")
        _write_judgements(study, settings, people, folder=new)
        if folder.exists():
            folder.rmdir()
        new.rename(folder)
    sync_folder(folder.parent)
    return missing


# Participants, under new numbers.


@dataclass(frozen=True, slots=True)
class Person:
    """A participant of a dataset; label: after `sub-`; rows: the judgements, as `ratings.csv` has them."""

    label: str
    progress: Progress
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
    everybody = [one for one in list_progress(study) if simulated or not one.simulated]
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
        name, answer = row["question"], row["answer"]
        if name.casefold() == "age" and answer.replace(".", "", 1).isdigit():
            name, answer = "age_band", band_age(float(answer))
        answers[f"{name}_{row['occasion']}" if repeated else name] = answer
    return answers


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


# Files.


def _write(path: Path, content: str) -> None:
    make_folder(path.parent, private=True)
    write_bytes(path, content.encode(), private=True)


def _write_json(path: Path, entry: Mapping[str, Any]) -> None:
    known = {name: value for name, value in entry.items() if value}
    text = json.dumps(to_json_value(known), indent=2, ensure_ascii=False, allow_nan=False)
    _write(path, f"{text}\n")


def write_tsv(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write a table as BIDS has it: without quotes, `n/a` in an empty cell."""
    lines = [columns, *([row.get(name, "") or MISSING for name in columns] for row in rows)]
    for line in lines:
        if bad := next((cell for cell in line if any(one in cell for one in "\t\r\n\0")), None):
            raise ValueError(
                f"a cell of a TSV table must hold no tab and no line feed, got {bad[:60]!r}; rename it in the study"
            )
    _write(path, "".join("\t".join(line) + "\n" for line in lines))


def write_cell(value: object) -> str:
    """Write a value so that it reads back the same; NaN is a missing value."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return ""
    return repr(value) if isinstance(value, float) else str(value)


def describe(
    file: str, columns: Iterable[str], info: Mapping[str, MetricInfo] | None = None
) -> dict[str, dict[str, Any]]:
    """Describe columns for a sidecar, by the data dictionary; info: what a lab's own metrics declare."""
    import pandas as pd

    empty, found = pd.Series([], dtype=object), {}
    for name in columns:
        known = describe_column(file, name, empty, info=info or {})
        entry: dict[str, Any] = {"Description": OWN.get(name, known.meaning) or f"column {name}"}
        if known.unit and name not in OWN:
            entry["Units"] = known.unit
        if name in FLAGS:
            entry["Levels"] = {"true": "yes", "false": "no"}
        found[name] = entry
    return found


# Tables.


def _write_participants(people: Sequence[Person], path: Path) -> None:
    """Write the table of participants; without days, design numbers and names of rigs."""
    first = ("participant_id", "simulated", "state", "sessions", "answered", "given_up", "total")
    last = ("training_passed", "rig", "calibration")
    factors = dict.fromkeys(name for one in people for name in one.progress.groups)
    measured = dict.fromkeys(name for one in people for name in one.progress.thresholds)
    columns = (*first, *factors, *last, *measured)
    numbered = {
        name: number_names((getattr(one.progress, name) for one in people), name)
        for name in ("rig", "calibration")
    }
    rows = []
    for one in people:
        own: dict[str, Any] = {name: getattr(one.progress, name, "") for name in (*first, *last)}
        own |= {"participant_id": one.name, "sessions": len({row["session"] for row in one.rows})}
        own |= {name: numbers[own[name]] for name, numbers in numbered.items()}
        own |= {**one.progress.groups, **one.progress.thresholds}
        rows.append({name: write_cell(own.get(name)) for name in columns})
    group = {"Description": "group of the participant, a factor in which participants differ"}
    write_tsv(path.with_suffix(".tsv"), columns, rows)
    about = describe("participants.csv", columns) | dict.fromkeys(factors, group)
    _write_json(path.with_suffix(".json"), about)


def _write_answers(
    people: Sequence[Person], questions: Sequence[Question], *, folder: Path
) -> None:
    """Write the answers that may be passed on, a column per question and occasion, if there are any."""
    found = list(dict.fromkeys(name for one in people for name in one.answers))
    if not found:
        return
    known = {question.name: question for question in questions}
    meanings = describe("participants.csv", ["participant_id"])
    for name in found:
        stem = name.rpartition("_")[0]
        question = known.get(name) or known.get(stem)
        own = OWN.get(name) or OWN.get(stem)
        meanings[name] = {"Description": own or (question.question if question else name)}
        if question and question.kind == "likert":
            points = enumerate(question.options, start=1)
            meanings[name]["Levels"] = {str(n): text or f"point {n}" for n, text in points}
        elif question and question.kind == "choice":
            meanings[name]["Levels"] = {text: text for text in question.options}
    path = folder / "phenotype" / "questions.tsv"
    rows = [{"participant_id": one.name, **one.answers} for one in people]
    write_tsv(path, ("participant_id", *found), rows)
    tool = {"MeasurementToolMetadata": {"Description": "Question pages of the session"}}
    _write_json(path.with_suffix(".json"), {**tool, **meanings})


def _write_stimuli(study: StudyFolder, settings: Settings, folder: Path) -> None:
    """Write the vibrations and the manifest, with what its recordings are of and which are one and the same."""
    with intake.open_text(study.manifest) as file:
        reader = csv.DictReader(file)
        rows, header = list(reader), list(reader.fieldnames or ())
    origins = list_origins(settings)
    numbers = number_names(origins.values(), "source")
    further = {"source": {name: numbers[one] for name, one in origins.items()}}
    samples = {one.title: one.sample or "" for one in settings.recordings}
    further |= {"sample": samples} if any(samples.values()) else {}
    added = [name for name in further if name not in header]
    for row in rows:
        row.update({name: further[name].get(row["recording"], "") for name in added})
    info, _ = gather_info(settings.analysis.metrics, list_info(settings), study.manifest)
    columns = (*header, *added)
    write_tsv(folder / "stimuli.tsv", columns, rows)
    _write_json(folder / "stimuli.json", describe("stimuli/manifest.csv", columns, info))
    for stimulus in read_stimuli(study.stimuli).stimuli:
        make_folder((folder / stimulus.file).parent, private=True)
        write_bytes(
            folder / stimulus.file, (study.stimuli / stimulus.file).read_bytes(), private=True
        )


def _write_judgements(
    study: StudyFolder, settings: Settings, people: Sequence[Person], *, folder: Path
) -> None:
    """Write a table per participant, session and task, and a sidecar per task."""
    columns = RATING_COLUMNS[1:]
    parts: dict[tuple[str, int, str], list[dict[str, str]]] = defaultdict(list)
    for person in people:
        for row in person.rows:
            key = (person.name, int(row["session"]), str(row["protocol"]))
            parts[key].append({name: write_cell(row[name]) for name in columns})
    several = any(session > 1 for _, session, _ in parts)
    for (name, session, protocol), rows in parts.items():
        visit = [f"ses-{session:02}"] if several else []
        file = "_".join([name, *visit, f"task-{_make_label(protocol)}", "beh.tsv"])
        write_tsv(folder.joinpath(name, *visit, "beh", file), columns, rows)
    scales = {protocol: rows[0]["scale"] for (*_, protocol), rows in parts.items()}
    meanings = describe("ratings.csv", columns)
    texts = read_study_texts(settings, study.path)
    for protocol, scale in scales.items():
        about = _describe_task(protocol, scale, texts=texts, settings=settings)
        _write_json(folder / f"task-{_make_label(protocol)}_beh.json", {**about, **meanings})


def _describe_task(
    protocol: str, scale: str, *, texts: Mapping[str, Any], settings: Settings
) -> dict[str, Any]:
    asked, page = texts["scales"].get(scale, {}), texts["pages"].get(f"instructions.{protocol}", {})
    ends = f"0 ({asked.get('low_label', '')}) to 100 ({asked.get('high_label', '')})"
    return {
        "TaskName": _make_label(protocol),
        "TaskDescription": f"{asked.get('question', protocol)} The answer is given in points from {ends}.",
        "Instructions": " ".join(page.get("text", "").split()),
        "InstitutionName": settings.publication.institution,
        "InstitutionalDepartmentName": settings.publication.department,
        "InstitutionAddress": settings.publication.address,
        "StimulusPresentation": {"SoftwareName": "feel321", "SoftwareVersion": __version__},
    }


def _make_label(protocol: str) -> str:
    """Make the label that a task has in file names."""
    return "".join(letter for letter in protocol if letter.isalnum() and letter.isascii())


# Words.


def _write_words(
    study: StudyFolder, settings: Settings, people: Sequence[Person], *, folder: Path
) -> None:
    """Write what the dataset is, who made it and how it may be used."""
    own = settings.publication
    title = own.title or settings.study.name
    about: dict[str, Any] = {
        "Name": title,
        "BIDSVersion": BIDS_VERSION,
        "DatasetType": "raw",
        "License": None if own.authors else own.licence,  # else CITATION.cff says it, once
        "Acknowledgements": own.acknowledgements,
        "Funding": own.funding,
        "EthicsApprovals": own.ethics,
        "Keywords": own.keywords,
        "ReferencesAndLinks": () if own.authors else own.references,
        "DatasetDOI": own.doi and f"doi:{own.doi}",
        "GeneratedBy": [
            {"Name": "feel321", "Version": __version__, "Description": "feel321 export"}
        ],
    }
    if newest := find_newest(study):
        about["SourceDatasets"] = [{"Version": f"checkpoint {newest}"}]
    _write_json(folder / "dataset_description.json", about)
    _write(folder / ".bidsignore", f"/{METHODS_FILE}\n")
    simulated = sum(one.progress.simulated for one in people)
    facts = {"title": title, "own": own, "count": len(people), "simulated": simulated}
    _write(folder / "README", render("readme.txt", **facts))
    if own.authors:
        _write(folder / "CITATION.cff", render("citation.txt", **facts))


def _write_methods(study: StudyFolder, folder: Path) -> list[str]:
    """Write the methods section, if there is a report of these very ratings; else say that it is missing."""
    path = study.report / "results.json"
    results = json.loads(intake.read_text(path)) if path.is_file() else {}
    if results.get("inputs", {}).get("ratings_sha256") != digest_file(study.ratings):
        return [NO_METHODS]
    _write(folder / METHODS_FILE, make_methods(study, results, is_dated=False))
    return []
