"""`methods.md`: the methods section of a paper, written from what was done; unrecorded details are in brackets."""

from __future__ import annotations

import json
import math
from collections import Counter
from pathlib import Path
from statistics import median
from typing import TYPE_CHECKING, Any

import pandas as pd

from feel321 import intake
from feel321.analysis.report.folder import METHODS
from feel321.files import write_text
from feel321.protocols.tasks import PROTOCOLS
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.sets.manifest import read_details, read_stimuli
from feel321.study.actuator.certificate import list_certificates, read_certificate
from feel321.study.freeze import read_frozen
from feel321.study.numbers import WITHDRAWN, read_holders
from feel321.study.people import list_progress
from feel321.study.session.events import SessionFinished, TrialRated
from feel321.study.settings.read import make_design, read_settings

if TYPE_CHECKING:
    from collections.abc import Mapping

    from feel321.study.folder import StudyFolder

METHODS_FILE = METHODS


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
    results = json.loads(intake.read_text(report / "results.json"))
    text = make_methods(study, results)
    write_text(report / METHODS_FILE, text, private=report == study.report)


def make_methods(study: StudyFolder, results: Mapping[str, Any], *, is_dated: bool = True) -> str:
    """Make the text of the methods section; without days where it goes along with a dataset."""
    settings, stimuli = read_settings(study.settings), read_stimuli(study.stimuli).stimuli
    manifest = pd.read_csv(study.manifest)
    tests = manifest[manifest["role"] == "test"].reindex(columns=["sensation_level_db"])
    recipe = read_details(study.stimuli).recipe
    filters = (("high", "high_pass_hz"), ("low", "low_pass_hz"))
    steps = ((word, recipe["conditioning"].get(key)) for word, key in filters)
    used = {one.calibration for one in list_progress(study) if one.calibration}
    found = [read_certificate(path) for path in list_certificates(study.calibration)]
    certificates = [one for one in found if one.id in used]
    protocols = [task.protocol for task in make_design(settings).tasks]
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
        tasks=[one if one in PROTOCOLS else f"{one} (a task of the lab)" for one in protocols],
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
    return pages.from_string(intake.read_text(Path(__file__).with_name(name))).render(**values)
