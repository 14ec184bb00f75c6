"""`methods.md`: the methods section of a paper, written from what was done; unrecorded details are in brackets."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.analysis.report.folder import METHODS
from feel321.files import write_text
from feel321.protocols.tasks import PROTOCOLS
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.sets.manifest import read_details, read_stimuli
from feel321.study.actuator.certificate import list_certificates, read_certificate
from feel321.study.freeze import read_frozen
from feel321.study.numbers import read_holders
from feel321.study.people import list_progress
from feel321.study.session.events import SessionBegun, SessionFinished, TrialRated
from feel321.study.session.plan import TOMBSTONE_FILE
from feel321.study.settings.read import make_design, read_settings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.study.actuator.certificate import Certificate
    from feel321.study.folder import StudyFolder

METHODS_FILE = METHODS


@dataclass(frozen=True, slots=True)
class ParticipantFlow:
    """How many people and judgements there were, from the first step to the last.

    simulated: whether they are programs, because no real person took part.
    """

    simulated: bool
    registered: int
    withdrew: int
    began: int
    finished: int
    analysed: int
    judgements: int
    rejected: int
    counted: int
    minutes: tuple[float, ...] = ()


def count_flow(study: StudyFolder) -> ParticipantFlow:
    """Count people and judgements, from plans, journals and `ratings.csv`; programs only where no person took part."""
    entries = read_holders(study)
    simulated = all(entry.simulated for entry in entries)
    names = {entry.participant for entry in entries if entry.simulated == simulated}
    gone = sum((study.sessions / name / TOMBSTONE_FILE).exists() for name in names)
    people = [one for one in study.read_people() if one.folder.name in names]
    begun = [one.records for one in people if one.records.has(SessionBegun)]
    done = [records for records in begun if records.has(SessionFinished)]
    with intake.open_text(study.ratings) as file:
        every = list(csv.DictReader(file))
    rows = [row for row in every if (row["simulated"] == "true") == simulated]
    counted = [row for row in rows if row["rejected"] != "true"]
    return ParticipantFlow(
        simulated=simulated,
        registered=len(names),
        withdrew=gone,
        began=sum(records.has(TrialRated) for records in begun),
        finished=len(done),
        analysed=len({row["participant"] for row in counted}),
        judgements=len(rows),
        rejected=len(rows) - len(counted),
        counted=len(counted),
        minutes=tuple(sorted(records.find_elapsed() / 60 for records in done)),
    )


def write_methods(study: StudyFolder, report: Path) -> None:
    """Write the methods section beside a report, whose `results.json` holds the numbers."""
    results = json.loads(intake.read_text(report / "results.json"))
    text = make_methods(study, results)
    write_text(report / METHODS_FILE, text, private=report == study.report)


def make_methods(study: StudyFolder, results: Mapping[str, Any], *, is_dated: bool = True) -> str:
    """Make the text of the methods section; without days where it goes along with a dataset."""
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli).stimuli
    with intake.open_text(study.manifest) as file:
        tests = [row for row in csv.DictReader(file) if row["role"] == "test"]
    recipe = read_details(study.stimuli).recipe
    filters = (("high", "high_pass_hz"), ("low", "low_pass_hz"))
    steps = ((word, recipe["conditioning"].get(key)) for word, key in filters)
    certificates, unknown = find_used(study)
    protocols = [task.protocol for task in make_design(settings, study.path).tasks]
    usual = {name: f"[{name}]" for name in ("metrics", "draws", "seed", "margin")}
    return render(
        "methods.md",
        count=_count,
        median=median,
        is_finite=math.isfinite,
        settings=settings,
        session=settings.session,
        flow=count_flow(study),
        certificates=certificates,
        unknown=unknown,
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
        levels=[float(row["sensation_level_db"]) for row in tests if row.get("sensation_level_db")],
        tasks=[one if one in PROTOCOLS else f"{one} (a task of the lab)" for one in protocols],
        results=results,
        inputs=usual | results["inputs"],
        frozen=read_frozen(study),
        is_dated=is_dated,
        flagged=[
            one
            for one in results["numbers"]
            if one["quantity"] == "n_flagged" and one["panel"] == "any"
        ],
    )


def render(name: str, **values: object) -> str:
    """Render a text of this folder, in which nothing is escaped."""
    from jinja2 import Environment, StrictUndefined

    pages = Environment(  # noqa: S701 - plain text
        undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True, keep_trailing_newline=True
    )
    pages.policies["json.dumps_kwargs"] = {"ensure_ascii": False}
    return pages.from_string(intake.read_text(Path(__file__).with_name(name))).render(**values)


def find_used(study: StudyFolder) -> tuple[list[Certificate], set[str]]:
    """Find the certificates that sessions were held with, and the names of those that are not there."""
    used = {one.calibration for one in list_progress(study) if one.calibration}
    found = [read_certificate(path) for path in list_certificates(study.calibration)]
    known = [one for one in found if one.id in used]
    return known, used - {one.id for one in known}


def _count(number: int, what: str, plural: str = "") -> str:
    return f"{number} {what if number == 1 else plural or f'{what}s'}"
