"""A study as a BIDS dataset of behavioural data (`beh`), and `methods.md`: the methods section of a paper."""

import hashlib
import hmac
import json
import math
import re
import secrets
from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from statistics import median
from typing import Any

import pandas as pd

from feel321 import __version__
from feel321.analysis.export import export_r
from feel321.analysis.report.folder import METHODS
from feel321.analysis.table.columns import describe_column, gather_info
from feel321.files import (
    digest_file,
    make_folder,
    open_text,
    read_text,
    sync_folder,
    temporary_folder,
    write_bytes,
    write_text,
)
from feel321.records import to_json_value
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.sets.manifest import read_details, read_stimuli
from feel321.study.analyze import read_study_table
from feel321.study.evidence.checkpoints import find_newest
from feel321.study.evidence.freeze import list_info, read_frozen
from feel321.study.folder import RATING_COLUMNS, OpenStudy, Outcome, StudyFolder
from feel321.study.own_protocols import OURS
from feel321.study.participants.roster import WITHDRAWN, list_progress, read_holders, write_roster
from feel321.study.participants.traces import recording_output
from feel321.study.ratings import write_ratings
from feel321.study.session.events import SessionFinished, TrialRated
from feel321.study.settings.read import list_origins, read_settings, read_study_texts
from feel321.study.settings.schema import Settings
from feel321.types import MetricInfo

BIDS_VERSION = "1.11.0"
MISSING = "n/a"  # what BIDS writes in a cell without a value

NO_METHODS = (
    f"{METHODS}: left out, for no report is of these ratings; feel321 analyze, then export again"
)

NEEDS = (  # of `[publication]`: what a reader of the data needs
    "title", "description", "authors", "licence", "ethics", "institution", "funding", "released",
)  # fmt: skip

WITHHELD = ["participant", "number", "first_utc", "last_utc"]
"""Columns of `participants.csv` that tell who somebody is, or when they came."""

FLAGS = {"rejected", "simulated", "training_passed"}
OWN = {  # meanings of columns that the data dictionary lacks or defines differently
    "participant_id": "participant of this dataset; numbers are unrelated to the order of participation",
    "state": "how the session ended: finished, or running if it was interrupted",
    "answered": "trials with an answer that counts",
    "given_up": "trials given up after all attempts",
    "total": "trials planned",
    "rig": "rig of the sessions, numbered",
    "calibration": "certificate of calibration of the rig, numbered",
    "training_passed": "whether the training criterion was met",
}

KEY_FILE = ".export.key"  # file in the study's folder: the key that draws the new numbers. It is never exported.


def export_study(lab: OpenStudy, path: Path, *, simulated: bool, for_r: bool) -> Outcome:
    """Write a study's data for others, as BIDS or as tables for R."""
    study, notices = lab.folder, list[str]()
    with recording_output(study, "export", path, now=lab.now):
        if for_r:
            table, step = read_study_table(study), "next, in that folder: Rscript model.R"
            if "simulated" in table.rows and table.rows["simulated"].any():
                said = "ratings of simulated participants are among these"
                notices.append(f"{said}; see the column simulated")
            export_r(table, path, rng=read_settings(study.settings).study.seed)
        else:
            step = f"check it with: bids-validator-deno {path}"
            notices += export_bids(study, path, simulated=simulated)
    for notice in notices:
        lab.say(notice)
    facts = {"folder": str(path), "kind": "R" if for_r else "BIDS", "warnings": notices}
    return Outcome(facts, [f"{path}: {step}"])


def export_bids(study: StudyFolder, folder: Path, *, simulated: bool = False) -> list[str]:
    """Write the dataset into a new folder, of simulated participants too if asked; list what is missing from it."""
    is_empty = folder.is_dir() and not any(folder.iterdir())
    if folder.is_symlink() or (folder.exists() and not is_empty):
        raise FileExistsError(f"{folder}: already holds something; name a new or empty folder")
    settings = read_settings(study.settings)
    write_ratings(study, read_stimuli(study.stimuli))
    rated = _read_table(study.ratings)
    judgements = rated if simulated else rated[rated["simulated"] == "false"]
    if judgements.empty:
        hint = "; simulated participants are exported with --simulated only" * (len(rated) > 0)
        raise ValueError(f"{study.path}: no ratings of real participants to export{hint}")
    names = _name_people(study, set(judgements["participant"]))
    people = _read_table(write_roster(study))
    people = people[people["participant"].isin([*names])]
    make_folder(folder.parent)
    with temporary_folder(beside=folder) as place:
        new = place / folder.name
        make_folder(new, private=True)
        missing = [
            f"publication.{name}: missing; write it into study.toml, [publication]"
            for name in NEEDS
            if not getattr(settings.publication, name)
        ]
        # The methods section, if there is a report of these very ratings.
        path = study.report / "results.json"
        results = json.loads(read_text(path)) if path.is_file() else {}
        if results.get("inputs", {}).get("ratings_sha256") == digest_file(study.ratings):
            _write(new / METHODS, make_methods(study, results, is_dated=False))
        else:
            missing.append(NO_METHODS)
        _write_words(study, settings, people, folder=new)
        _write_participants(people, names, path=new / "participants")
        _write_stimuli(study, settings, new / "stimuli")
        judgements = judgements.assign(participant=judgements["participant"].map(names))
        _write_judgements(study, settings, judgements, folder=new)
        if folder.exists():
            folder.rmdir()
        new.rename(folder)
    sync_folder(folder.parent)
    return missing


def _name_people(study: StudyFolder, codes: Iterable[str]) -> dict[str, str]:
    """Give participants new numbers in an order that only the study's own key gives."""
    path = study.path / KEY_FILE
    if not path.exists():
        write_text(path, f"{secrets.token_hex(32)}\n", private=True)
    key = bytes.fromhex(path.read_text(encoding="utf-8").strip())
    drawn = sorted(codes, key=lambda code: hmac.new(key, code.encode(), hashlib.sha256).hexdigest())
    width = max(2, len(str(len(drawn))))
    return {code: f"sub-{number:0{width}}" for number, code in enumerate(drawn, start=1)}


def _number(values: pd.Series, stem: str) -> pd.Series:
    """Put numbers in the place of names that tell where and when something was made."""
    kept = {"": "", "uncalibrated": "uncalibrated"}
    found = sorted({*values} - {*kept})
    return values.map(kept | {name: f"{stem}{n}" for n, name in enumerate(found, start=1)})


def _read_table(path: Path) -> pd.DataFrame:
    """Read one of the study's own tables, every cell as it is written."""
    with open_text(path) as file:
        return pd.read_csv(file, dtype=str, keep_default_na=False)


def _write(path: Path, content: str) -> None:
    make_folder(path.parent, private=True)
    write_bytes(path, content.encode(), private=True)


def _write_json(path: Path, entry: Mapping[str, Any]) -> None:
    known = {name: value for name, value in entry.items() if value}
    text = json.dumps(to_json_value(known), indent=2, ensure_ascii=False, allow_nan=False)
    _write(path, f"{text}\n")


def _write_tsv(path: Path, table: pd.DataFrame) -> None:
    """Write a table as BIDS has it: without quotes, `n/a` in an empty cell."""
    cells = [*table.columns, *table.to_numpy().ravel()]
    if odd := next((one for one in cells if re.search(r"[\t\r\n\0]", one)), None):
        raise ValueError(
            f"a cell of a TSV table must hold no tab and no line feed, got {odd[:60]!r}; rename it in the study"
        )
    rows = table.replace("", MISSING).to_numpy()
    _write(path, "".join("\t".join(line) + "\n" for line in (table.columns, *rows)))


def _describe(
    file: str, columns: Iterable[str], info: Mapping[str, MetricInfo] | None = None
) -> dict[str, Any]:
    """Describe columns for a sidecar, by the data dictionary; info: what a lab's own metrics declare."""
    empty, found = pd.Series([], dtype=object), {}
    for name in columns:
        known = describe_column(file, name, empty, info=info or {})
        entry: dict[str, Any] = {"Description": OWN.get(name, known.meaning) or f"column {name}"}
        entry |= {"Units": known.unit} if known.unit and name not in OWN else {}
        entry |= {"Levels": {"true": "yes", "false": "no"}} if name in FLAGS else {}
        found[name] = entry
    return found


def _write_participants(people: pd.DataFrame, names: Mapping[str, str], *, path: Path) -> None:
    """Write the table of participants; without days, design numbers and names of rigs."""
    shown = people.drop(columns=WITHHELD)
    shown = shown.assign(**{name: _number(people[name], name) for name in ("rig", "calibration")})
    shown.insert(0, "participant_id", people["participant"].map(names))
    _write_tsv(path.with_suffix(".tsv"), shown.sort_values("participant_id"))
    about = _describe("participants.csv", shown.columns)
    for entry in (one for one in about.values() if one["Description"].startswith("column ")):
        entry["Description"] = "group of the participant, a factor in which participants differ"
    _write_json(path.with_suffix(".json"), about)


def _write_stimuli(study: StudyFolder, settings: Settings, folder: Path) -> None:
    """Write the vibrations and the manifest, with what its recordings are of and which are one and the same."""
    table = _read_table(study.manifest)
    samples = {one.title: one.sample or "" for one in settings.recordings}
    further = {"source": _number(table["recording"].map(list_origins(settings)), "source")}
    further |= {"sample": table["recording"].map(samples)} if any(samples.values()) else {}
    new = {name: own.fillna("") for name, own in further.items() if name not in table}
    table = table.assign(**new)
    info, _ = gather_info(settings.analysis.metrics, list_info(settings), study.manifest)
    _write_tsv(folder / "stimuli.tsv", table)
    _write_json(folder / "stimuli.json", _describe("stimuli/manifest.csv", table.columns, info))
    for name in table["file"]:
        make_folder((folder / name).parent, private=True)
        write_bytes(folder / name, (study.stimuli / name).read_bytes(), private=True)


def _write_judgements(
    study: StudyFolder, settings: Settings, judgements: pd.DataFrame, *, folder: Path
) -> None:
    """Write a table per participant, session and task, and a sidecar per task."""
    columns, texts = [*RATING_COLUMNS[1:]], read_study_texts(settings, study.path)
    labels = {name: re.sub("[^0-9A-Za-z]", "", name) for name in judgements["protocol"].unique()}
    several = (judgements["session"].astype(int) > 1).any()
    for place, rows in judgements.groupby(["participant", "session", "protocol"]):
        name, session, protocol = map(str, place)
        visit = [f"ses-{int(session):02}"] if several else []
        file = "_".join([name, *visit, f"task-{labels[protocol]}", "beh.tsv"])
        _write_tsv(folder.joinpath(name, *visit, "beh", file), rows[columns])
    for protocol, label in labels.items():
        scale = judgements.loc[judgements["protocol"] == protocol, "scale"].iloc[0]
        asked = texts["scales"].get(scale, {})
        page = texts["pages"].get(f"instructions.{protocol}", {})
        ends = f"0 ({asked.get('low_label', '')}) to 100 ({asked.get('high_label', '')})"
        answer = f"The answer is given in points from {ends}."
        about = {
            "TaskName": label,
            "TaskDescription": f"{asked.get('question', protocol)} {answer}",
            "Instructions": " ".join(page.get("text", "").split()),
            "InstitutionName": settings.publication.institution,
            "InstitutionalDepartmentName": settings.publication.department,
            "InstitutionAddress": settings.publication.address,
            "StimulusPresentation": {"SoftwareName": "feel321", "SoftwareVersion": __version__},
        }
        about |= _describe("ratings.csv", columns)
        _write_json(folder / f"task-{label}_beh.json", about)


def _write_words(
    study: StudyFolder, settings: Settings, people: pd.DataFrame, *, folder: Path
) -> None:
    """Write what the dataset is, who made it and how it may be used."""
    own, newest = settings.publication, find_newest(study)
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
        "SourceDatasets": [{"Version": f"checkpoint {newest.id}"}] if newest else None,
    }
    _write_json(folder / "dataset_description.json", about)
    _write(folder / ".bidsignore", f"/{METHODS}\n")
    simulated = int((people["simulated"] == "true").sum())
    facts = {"title": title, "own": own, "count": len(people), "simulated": simulated}
    _write(folder / "README", render("readme.txt", **facts))
    if own.authors:
        _write(folder / "CITATION.cff", render("citation.txt", **facts))


# The methods section of a paper, written from what was done; unrecorded details are in brackets.


def count_flow(study: StudyFolder) -> dict[str, Any]:
    """Count people and judgements, from plans, journals and `ratings.csv`; programs only where no person took part."""
    holders = read_holders(study)
    simulated = all(one.simulated for one in holders)
    own = [one for one in holders if one.simulated == simulated]
    records = [one.records for one in study.read_people() if one.plan.simulated == simulated]
    done = [one for one in records if one.has(SessionFinished)]
    rows = pd.read_csv(study.ratings)
    rows = rows[rows["simulated"] == simulated]
    counted = rows[~rows["rejected"]]
    return {
        "simulated": simulated,
        "registered": len(own),
        "withdrew": sum(one.state == WITHDRAWN for one in own),
        "began": sum(one.has(TrialRated) for one in records),
        "finished": len(done),
        "analysed": counted["participant"].nunique(),
        "judgements": len(rows),
        "rejected": len(rows) - len(counted),
        "counted": len(counted),
        "minutes": sorted(one.find_elapsed() / 60 for one in done),
    }


def write_methods(study: StudyFolder, report: Path) -> None:
    """Write the methods section beside a report, whose `results.json` holds the numbers."""
    text = make_methods(study, json.loads(read_text(report / "results.json")))
    write_text(report / METHODS, text, private=report == study.report)


def make_methods(study: StudyFolder, results: Mapping[str, Any], *, is_dated: bool = True) -> str:
    """Make the text of the methods section; without days where it goes along with a dataset."""
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli).stimuli
    manifest = pd.read_csv(study.manifest)
    tests = manifest[manifest["role"] == "test"].reindex(columns=["sensation_level_db"])
    recipe = read_details(study.stimuli).recipe
    filters = (("high", "high_pass_hz"), ("low", "low_pass_hz"))
    steps = ((word, recipe["conditioning"].get(key)) for word, key in filters)
    used = {one.calibration for one in list_progress(study) if one.calibration}
    certificates = []
    if used:
        from feel321.study.actuator.certificate import list_certificates, read_certificate

        found = map(read_certificate, list_certificates(study.calibration))
        certificates = [one for one in found if one.id in used]
    usual = {name: f"[{name}]" for name in ("metrics", "draws", "seed", "margin")}
    flags = [one for one in results["numbers"] if one["quantity"] == "n_flagged"]
    return render(
        "methods.md",
        count=lambda number, what, plural="": (
            f"{number} {what if number == 1 else plural or f'{what}s'}"
        ),
        median=median,
        is_finite=math.isfinite,
        settings=settings,
        session=settings.session,
        flow=count_flow(study),
        certificates=certificates,
        unknown=used - {one.id for one in certificates},
        recipe=recipe,
        bands=[f"{word}-pass filtered at {hz:g} Hz" for word, hz in steps if hz],
        stimuli=stimuli,
        recordings=list(dict.fromkeys(one.recording for one in stimuli)),
        lengths=[one.duration_s for one in stimuli],
        roles=Counter(one.role for one in stimuli),
        highest_hz=HIGHEST_HZ,
        narrow={
            one.recording: one.band_high_hz for one in stimuli if one.band_high_hz < HIGHEST_HZ
        },
        levels=list(tests["sensation_level_db"].dropna()),
        tasks=[
            name if name in OURS else f"{name} (a task of the lab)"
            for name in settings.session.protocols
        ],
        results=results,
        inputs=usual | results["inputs"],
        frozen=read_frozen(study),
        is_dated=is_dated,
        flagged=[one for one in flags if one["panel"] == "any"],
    )


def render(name: str, **values: object) -> str:
    """Render a text of this folder, in which nothing is escaped."""
    from jinja2 import Environment, StrictUndefined

    pages = Environment(  # noqa: S701 - plain text
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    pages.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    return pages.from_string(read_text(Path(__file__).parent / "templates" / name)).render(**values)
