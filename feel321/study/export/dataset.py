"""A study as a dataset that BIDS and Psych-DS accept, with an RO-Crate; `export --bids`."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.analysis.bids import CHOICES
from feel321.files import digest_file
from feel321.names import METRIC_INFO
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import analyze
from feel321.study.actuator import certificate as certificates
from feel321.study.export import credit, people, tables, writing
from feel321.study.export.crate import make_crate
from feel321.study.export.narrative import METHODS_FILE, make_methods
from feel321.study.ledger.progress import note_estimates
from feel321.study.settings import read

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.analysis.table.items import Table
    from feel321.analysis.table.sheets import Further
    from feel321.study.export.people import Person
    from feel321.study.export.tables import DataSheet
    from feel321.study.export.writing import Content
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

OWN = "derivatives/feel321"
"""What feel321 makes of the data, a derivative dataset of its own."""

IGNORED = "/data\n/ro-crate-metadata.json\n"
"""`.bidsignore`: what Psych-DS and RO-Crate want and BIDS has no place for."""


NO_METHODS = f"{METHODS_FILE}: left out, for no report is of these ratings; feel321 analyze, then export again"


@dataclass(frozen=True, slots=True)
class ExportChoices:
    """What goes into an export: everybody's own codes, simulated people, the report."""

    keep_ids: bool = False
    simulated: bool = False
    report: bool = False


@dataclass(frozen=True, slots=True)
class _Gathered:
    """All that an export is made of."""

    study: StudyFolder
    settings: Settings
    people: Sequence[Person]
    table: Table
    further: Further
    renamed: Mapping[str, Mapping[str, str]]


def export_bids(study: StudyFolder, folder: Path, choices: ExportChoices) -> list[str]:
    """Write the dataset, and list what `[publication]` does not say."""
    writing.check_target(folder)
    gathered = _gather(study, choices)
    files = dict(_list_files(gathered, choices))
    writing.write_folder(folder, files)
    old = [] if f"{OWN}/docs/{METHODS_FILE}" in files else [NO_METHODS]
    return [*gathered.settings.publication.list_missing(), *old]


def _gather(study: StudyFolder, choices: ExportChoices) -> _Gathered:
    settings, stimuli = read.read_settings(study.settings), read_stimuli(study.stimuli)
    everybody = people.gather_people(
        study, stimuli, keep_ids=choices.keep_ids, simulated=choices.simulated
    )
    further, _ = analyze.gather_study(study, settings)
    notes = people.leave_out_names(further.notes, everybody)
    if len(notes) < len(further.notes):
        shown = (replace(one.progress, participant=one.name) for one in everybody)
        notes += note_estimates(shown)
    table, _ = analyze.read_study_table(study)
    renamed = {
        name: people.rename((getattr(one.progress, name) for one in everybody), name)
        for name in ("rig", "calibration")
    }
    return _Gathered(
        study, settings, everybody, table, replace(further, notes=tuple(notes)), renamed
    )


def _list_files(gathered: _Gathered, choices: ExportChoices) -> Iterator[tuple[str, Content]]:
    """List every file of the dataset with its content; the crate comes last, for it lists them."""
    from feel321.analysis.report.standing import list_versions
    from feel321.study.auditing.seal import make_seal

    seal, settings = make_seal(gathered.study), gathered.settings
    files = {
        **dict(_list_tables(gathered, seal=seal)),
        **dict(_list_words(gathered)),
        **dict(_list_derived(gathered, choices)),
    }
    found = [
        certificates.read_certificate(path)
        for path in certificates.list_certificates(gathered.study.calibration)
        if path.is_file()
    ]
    used = [one for one in found if one.id in gathered.renamed["calibration"]]
    crate = make_crate(settings, files, seal=seal, versions=list_versions(), certificates=used)
    yield from files.items()
    yield writing.CRATE, tables.write_json(crate)


def _list_tables(gathered: _Gathered, *, seal: str) -> Iterator[tuple[str, Content]]:
    """List the tables: as BIDS wants them, and once more as Psych-DS does."""
    judged = tables.make_judgements(gathered.people, gathered.table.info)
    roster = tables.make_roster(gathered.people, gathered.renamed)
    stimuli = _make_stimuli(gathered)
    questions = read.make_design(gathered.settings, gathered.study.path).questions
    answers = tables.make_answers(gathered.people, questions)
    yield from _write_judgements(judged, gathered)
    yield from _write_sheet("participants", roster)
    yield from _write_sheet("stimuli/stimuli", stimuli)
    if answers:
        tool = {"MeasurementToolMetadata": {"Description": "Question pages of the session"}}
        yield from _write_sheet("phenotype/questions", answers, tool)
    sheets = {"description-participants": roster, "description-stimuli": stimuli}
    sheets |= {"description-questions": answers} if answers else {}
    sheets |= dict(_merge(judged))
    for name, sheet in sheets.items():
        yield f"data/{name}_data.csv", sheet.to_csv()
    about = credit.describe_dataset(
        gathered.settings, tables.list_variables(list(sheets.values())), seal=seal
    )
    yield "dataset_description.json", tables.write_json(about)


def _write_sheet(
    name: str, sheet: DataSheet, more: Mapping[str, Any] | None = None
) -> Iterator[tuple[str, Content]]:
    yield f"{name}.tsv", sheet.to_tsv()
    yield f"{name}.json", tables.write_json({**(more or {}), **sheet.to_sidecar()})


def label_task(protocol: str) -> str:
    """Make the label that a task has in file names."""
    return "".join(letter for letter in protocol if letter.isalnum() and letter.isascii())


def _write_judgements(
    judged: Mapping[tuple[str, int, str], DataSheet], gathered: _Gathered
) -> Iterator[tuple[str, Content]]:
    """Write a table per participant, session and task, and a sidecar per task."""
    several = any(session > 1 for _, session, _ in judged)
    texts = read.read_study_texts(gathered.settings, gathered.study.path)
    for (label, session, protocol), sheet in judged.items():
        task = label_task(protocol)
        visit = f"ses-{session:02}" if several else ""
        names = "_".join(filter(None, (f"sub-{label}", visit, f"task-{task}", "beh.tsv")))
        yield "/".join(filter(None, (f"sub-{label}", visit, "beh", names))), sheet.to_tsv()
        scale = texts["scales"].get(sheet.rows[0]["scale"], {})
        page = texts["pages"].get(f"instructions.{protocol}", {})
        own = gathered.settings.publication
        about = credit.describe_task(scale, page, name=task, own=own)
        yield f"task-{task}_beh.json", tables.write_json({**about, **sheet.to_sidecar()})


def _merge(judged: Mapping[tuple[str, int, str], DataSheet]) -> Iterator[tuple[str, DataSheet]]:
    """Merge the judgements of everybody by task."""
    for protocol in dict.fromkeys(protocol for *_, protocol in judged):
        own = {key: sheet for key, sheet in judged.items() if key[2] == protocol}
        rows = tuple(
            {"participant_id": f"sub-{key[0]}", **row}
            for key, sheet in own.items()
            for row in sheet.rows
        )
        first = next(iter(own.values()))
        meanings = {**tables.describe("ratings.csv", ["participant_id"]), **first.meanings}
        yield (
            f"task-{label_task(protocol)}",
            tables.DataSheet(("participant_id", *first.columns), rows, meanings),
        )


def _make_stimuli(gathered: _Gathered) -> DataSheet:
    """Make the table of stimuli: the manifest, with what its recordings are of and which are one and the same."""
    with intake.open_text(gathered.study.manifest) as file:
        reader = csv.DictReader(file)
        rows, header = list(reader), list(reader.fieldnames or ())
    origins = read.list_origins(gathered.settings)
    numbered = people.rename(origins.values(), "source")
    labels = gathered.further.labels
    further = {"source": {name: numbered[one] for name, one in origins.items()}}
    further |= (
        {} if labels is None else {str(name): dict(labels[name].fillna("")) for name in labels}
    )
    return tables.make_stimuli(header, rows, further=further, info=gathered.table.info)


def _list_words(gathered: _Gathered) -> Iterator[tuple[str, Content]]:
    """List the files in plain words, and the vibrations."""
    own = gathered.settings.publication
    simulated = sum(one.progress.simulated for one in gathered.people)
    missing = own.list_missing()
    readme = credit.write_readme(
        gathered.settings, people=len(gathered.people), simulated=simulated, missing=missing
    )
    yield "README", readme.encode()
    yield "CHANGES", credit.write_changes(own).encode()
    yield ".bidsignore", IGNORED.encode()
    if citation := credit.write_citation(gathered.settings):
        yield "CITATION.cff", citation.encode()
    if own.licence:
        holders = ", ".join(author.name for author in own.authors)
        yield "LICENSE", credit.write_licence(own, holders).encode()
    for stimulus in read_stimuli(gathered.study.stimuli).stimuli:
        yield f"stimuli/{stimulus.file}", gathered.study.stimuli / stimulus.file


def _list_derived(gathered: _Gathered, choices: ExportChoices) -> Iterator[tuple[str, Content]]:
    """List what feel321 made of the data: choices of the analysis, methods, and the report where it is asked for."""
    title = credit.find_title(gathered.settings)
    about = {
        "Name": f"{title}: analysis by feel321",
        "BIDSVersion": credit.BIDS_VERSION,
        "DatasetType": "derivative",
        "GeneratedBy": [credit.SOFTWARE],
        "SourceDatasets": [{"URL": "../.."}],
    }
    yield f"{OWN}/dataset_description.json", tables.write_json(about)
    yield f"{OWN}/README", credit.write_derived_readme(title).encode()
    yield CHOICES, tables.write_json(describe_choices(gathered))
    report = gathered.study.report
    if (results := _read_current(gathered.study)) is not None:
        methods = make_methods(gathered.study, results, is_dated=False)
        yield f"{OWN}/docs/{METHODS_FILE}", methods.encode()
    if not choices.report:
        return
    if not (report / "results.json").is_file():
        raise FileNotFoundError(f"{report}: no report yet; run feel321 analyze first")
    if not choices.keep_ids:
        raise ValueError(
            "--report: a report names participants by the study's codes; add --keep-ids, or leave it out"
        )
    for name in sorted(writing.list_files(report)):
        yield f"{OWN}/docs/report/{name}", report / name


def _read_current(study: StudyFolder) -> dict[str, Any] | None:
    """Read the results of a report that was made from these very ratings."""
    path = study.report / "results.json"
    if not path.is_file():
        return None
    results: dict[str, Any] = json.loads(intake.read_text(path))
    made_from = results.get("inputs", {}).get("ratings_sha256")
    return results if made_from == digest_file(study.ratings) else None


def describe_choices(gathered: _Gathered) -> dict[str, Any]:
    """Describe what an analysis needs besides the tables, so that it can be done again without the study."""
    settings, further = gathered.settings, gathered.further
    frames = {"metrics": further.metrics.reset_index(), "mountings": further.mountings}
    paper = settings.paper
    ours = {name: one for name, one in gathered.table.info.items() if name not in METRIC_INFO}
    info = {**ours, **analyze.list_info(settings)}
    return {
        "name": settings.study.name,
        "seed": settings.study.seed,
        "protocols": settings.session.protocols,
        "keep_ids": all(one.label == one.progress.participant for one in gathered.people),
        "analysis": settings.analysis.model_dump(mode="json", exclude={"screening"}),
        "screening_left_out": len(settings.analysis.screening),
        "info": {name: _dump(one) for name, one in info.items()},
        "further": {
            name: None if frame is None else frame.to_dict("list") for name, frame in frames.items()
        },
        "notes": further.notes,
        "paper": paper.model_dump(mode="json") if paper else None,
        "manifest_sha256": digest_file(gathered.study.manifest),
    }


def _dump(info: Any) -> dict[str, Any]:  # noqa: ANN401 - a MetricInfo
    """Write what a metric declares; a bound that is infinite is left out."""
    from dataclasses import asdict
    from math import isfinite

    found = asdict(info).items()
    return {name: one for name, one in found if not isinstance(one, float) or isfinite(one)}
