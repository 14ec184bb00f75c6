"""`methods.md`: the methods section of a paper, written from what was done; unrecorded details are in brackets."""

from __future__ import annotations

import csv
import json
import math
from collections import Counter
from dataclasses import dataclass
from statistics import median
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.analysis.report.folder import METHODS
from feel321.files import write_text
from feel321.protocols.tasks import PROTOCOLS
from feel321.stimuli.match import HIGHEST_HZ
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import people as progresses
from feel321.study.actuator import certificate as certificates
from feel321.study.folder import read_recipe
from feel321.study.freeze import read_frozen
from feel321.study.numbers import read_holders
from feel321.study.session import plan as plans
from feel321.study.session.events import SessionBegun, SessionFinished, TrialRated
from feel321.study.settings.read import make_design, read_settings

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from feel321.study.actuator.certificate import Certificate
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

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

    def to_rows(self) -> list[tuple[str, str, str]]:
        """List the steps: step, people, judgements."""
        return [
            ("invited", "[number]", ""),
            ("registered (given a place in the design)", str(self.registered), ""),
            ("withdrew, all data removed", str(self.withdrew), ""),
            ("began", str(self.began), ""),
            ("finished", str(self.finished), ""),
            ("completed judgements", "", str(self.judgements)),
            ("judgements rejected during the session, and repeated", "", str(self.rejected)),
            ("analysed", str(self.analysed), str(self.counted)),
        ]


def count_flow(study: StudyFolder) -> ParticipantFlow:
    """Count people and judgements, from plans, journals and `ratings.csv`; programs only where no person took part."""
    entries = read_holders(study)
    simulated = all(entry.simulated for entry in entries)
    names = [entry.participant for entry in entries if entry.simulated == simulated]
    folders = [folder for folder in study.participants if folder.name in set(names)]
    gone = [folder for folder in folders if (folder / plans.TOMBSTONE_FILE).exists()]
    dossiers = [plans.read_dossier(folder) for folder in folders if folder not in gone]
    begun = [one for one in dossiers if one.records.has(SessionBegun)]
    done = [one for one in begun if one.records.has(SessionFinished)]
    rows = [row for row in _read_csv(study) if (row["simulated"] == "true") == simulated]
    counted = [row for row in rows if row["rejected"] != "true"]
    return ParticipantFlow(
        simulated=simulated,
        registered=len(names),
        withdrew=len(gone),
        began=sum(one.records.has(TrialRated) for one in begun),
        finished=len(done),
        analysed=len({row["participant"] for row in counted}),
        judgements=len(rows),
        rejected=len(rows) - len(counted),
        counted=len(counted),
        minutes=tuple(sorted(one.records.find_elapsed() / 60 for one in done)),
    )


def _read_csv(study: StudyFolder) -> list[dict[str, str]]:
    with intake.open_text(study.ratings) as file:
        return list(csv.DictReader(file))


def write_methods(study: StudyFolder, report: Path) -> None:
    """Write the methods section beside a report, whose `results.json` holds the numbers."""
    results = json.loads(intake.read_text(report / "results.json"))
    text = make_methods(study, results)
    write_text(report / METHODS_FILE, text, private=report == study.report)


def make_methods(study: StudyFolder, results: Mapping[str, Any], *, is_dated: bool = True) -> str:
    """Make the text of the methods section; without days where it goes along with a dataset."""
    settings, flow = read_settings(study.settings), count_flow(study)
    parts = {
        "Participants": _tell_participants(settings, flow),
        "Apparatus": _tell_apparatus(study, settings),
        "Stimuli": _tell_stimuli(study),
        "Procedure": _tell_procedure(study, settings, flow),
        "Analysis": _tell_analysis(study, results, is_dated=is_dated),
        "Data and software": _tell_software(settings, results),
    }
    lines = [f"# Methods: {settings.publication.title or settings.study.name}", ""]
    for title, told in parts.items():
        lines += [f"## {title}", "", *told, ""]
    return "\n".join(lines)


def _count(number: int, what: str) -> str:
    return f"{number} {what}{'' if number == 1 else 's'}"


def _tell_participants(settings: Settings, flow: ParticipantFlow) -> Iterator[str]:
    """Describe who took part, and how many were left at each step."""
    ethics = "; ".join(settings.publication.ethics) or "[ethics committee and number]"
    if flow.simulated:
        programs = _count(flow.analysed, "simulated participant")
        yield f"No people took part: the ratings come from {programs}, which are programs."
    else:
        yield (
            f"The ratings of {_count(flow.analysed, 'participant')} were analysed ([age, gender, handedness: personal "
            f"answers are not read]). [Informed consent: how given]; the study was approved by {ethics}. "
            f"{_count(flow.registered, 'person')} had registered, {flow.began} began, {flow.finished} finished and "
            f"{flow.withdrew} withdrew; the data of those who withdrew were removed."
        ).replace("persons", "people")
    if settings.between:
        groups = "; ".join(
            f"{name}: {', '.join(levels)}" for name, levels in settings.between.items()
        )
        yield f"Participants were assigned to groups in the order of the design ({groups})."
    yield from ["", "| step | people | judgements |", "|---|---|---|"]
    yield from (f"| {' | '.join(row)} |" for row in flow.to_rows())
    yield from [
        "",
        "No participant was excluded from the primary analysis after screening; see Analysis.",
    ]


def find_used(study: StudyFolder) -> tuple[list[Certificate], set[str]]:
    """Find the certificates that sessions were held with, and the names of those that are not there."""
    everybody = progresses.list_progress(study)
    used = {one.calibration for one in everybody if one.calibration}
    paths = certificates.list_certificates(study.calibration)
    found = [certificates.read_certificate(path) for path in paths]
    known = [one for one in found if one.id in used]
    return known, used - {one.id for one in known}


def _tell_apparatus(study: StudyFolder, settings: Settings) -> Iterator[str]:
    """Describe the rig by its certificates."""
    used, unknown = find_used(study)
    yield f"Vibrations were played at {settings.rig.rate_hz:g} Hz by feel321 on [actuator, amplifier, stylus]."
    for one in used:
        low, high = one.band_hz
        yield (
            f"{_count(len(one.coils), 'actuator')} had been calibrated ({one.method}) from {low:g} to {high:g} Hz: "
            + "; ".join(
                _tell_coil(number, coil) for number, coil in enumerate(one.coils.values(), start=1)
            )
            + "."
        )
    if unknown:
        where = "or with one that is not in the study's folder"
        yield f"Some sessions were held without a valid certificate of calibration, {where}."
    if not used and not unknown:
        yield "[Calibration: no session names a certificate.]"


def _tell_coil(number: int, coil: certificates.CoilCertificate) -> str:
    parts = [f"actuator {number}, {coil.target:.4g} m/s² at full scale"]
    if math.isfinite(coil.largest_db):
        parts.append(f"residual error at most {coil.largest_db:.2f} dB")
    if math.isfinite(coil.uncertainty_db):
        parts.append(f"standard uncertainty {coil.uncertainty_db:.2f} dB")
    return ", ".join(parts)


def _tell_stimuli(study: StudyFolder) -> Iterator[str]:
    """Describe the set: what it was made from and how, and how far it is above the threshold."""
    recipe, stimuli = read_recipe(study.stimuli), read_stimuli(study.stimuli).stimuli
    names = list(dict.fromkeys(one.recording for one in stimuli))
    lengths = [one.duration_s for one in stimuli]
    roles = Counter(one.role for one in stimuli)
    steps = recipe["conditioning"]
    bands = [
        f"{word}-pass filtered at {steps[key]:g} Hz"
        for word, key in (("high", "high_pass_hz"), ("low", "low_pass_hz"))
        if steps.get(key)
    ]
    yield (
        f"{_count(len(names), 'recording')} of three-axis acceleration ([tool, interaction]; {', '.join(names)}) were "
        f"{' and '.join(bands) or 'not filtered'} and reduced to one axis by {len(recipe['reducers'])} transforms "
        f"({', '.join(map(str, recipe['reducers']))}). The set has {_count(len(stimuli), 'stimulus')} "
        f"({', '.join(f'{n} {role}' for role, n in roles.items())}), {min(lengths):.2f} to {max(lengths):.2f} s long, "
        f"at the levels {', '.join(recipe['levels'])}; gain: {recipe['gain']}."
    ).replace("stimuluss", "stimuli")
    narrow = {one.recording: one.band_high_hz for one in stimuli if one.band_high_hz < HIGHEST_HZ}
    if narrow:
        named = ", ".join(f"{name} ({high:g} Hz)" for name, high in narrow.items())
        yield (
            f"Matches compare 20 to {HIGHEST_HZ:g} Hz; recordings with a lower Nyquist frequency were compared up to "
            f"that: {named}."
        )
    yield from _tell_sensation(study)


def _tell_sensation(study: StudyFolder) -> Iterator[str]:
    with intake.open_text(study.manifest) as file:
        rows = [row for row in csv.DictReader(file) if row["role"] == "test"]
    levels = [float(row["sensation_level_db"]) for row in rows if row.get("sensation_level_db")]
    if levels:
        yield (
            f"Test stimuli were {min(levels):.1f} to {max(levels):.1f} dB (median {median(levels):.1f} dB) above the "
            "detection threshold of the recipe in their loudest 200 ms."
        )


def _tell_procedure(study: StudyFolder, settings: Settings, flow: ParticipantFlow) -> Iterator[str]:
    """Describe tasks, order, rehearsal, breaks and durations."""
    design, session = make_design(settings, study.path), settings.session
    tasks = []
    for task in design.tasks:
        known = PROTOCOLS.get(task.protocol)
        tasks.append(f"{task.protocol}{'' if known else ' (a task of the lab)'}")
    yield (
        f"Participants worked on {_count(len(tasks), 'task')}: {', '.join(tasks)}. Each comparison was judged "
        f"{_count(session.repeats, 'time')}, in the order `{session.order}`; tasks came in {session.task_order} order. "
        f"Before the trials came {_count(session.rehearsal.training, 'training trial')} with feedback and "
        f"{_count(session.rehearsal.practice, 'practice trial')} per task."
    )
    breaks = session.breaks
    if breaks.every_trials:
        yield f"There was a break of at least {breaks.break_s:g} s after every {breaks.every_trials} trials."
    faults = ", ".join(session.quality.reject) or "nothing"
    yield f"Trials were rejected and repeated for: {faults}. This affected {flow.rejected} judgements."
    if flow.minutes:
        low, high = flow.minutes[0], flow.minutes[-1]
        yield f"Completed sessions took {median(flow.minutes):.0f} min (median; {low:.0f} to {high:.0f})."


def _tell_analysis(
    study: StudyFolder, results: Mapping[str, Any], *, is_dated: bool
) -> Iterator[str]:
    """Describe the analysis as it was run, in the report's own sentences."""
    inputs = results["inputs"]
    yield (
        f"Predictors: {inputs.get('metrics', '[metrics]')}. Bootstrap draws: {inputs.get('draws', '[draws]')}; seed: "
        f"{inputs.get('seed', '[seed]')}; margin of equivalence: {inputs.get('margin', '[margin]')}."
    )
    yield _tell_frozen(study, is_dated=is_dated)
    flagged = [
        one
        for one in results["numbers"]
        if one["quantity"] == "n_flagged" and one["panel"] == "any"
    ]
    for one in flagged:
        yield f"Screening flagged {one['value']:g} of {one['n']} participants by any rule; all results include these."
    yield from ["", *(f"- {sentence}" for sentence in results["how"])]


def _tell_frozen(study: StudyFolder, *, is_dated: bool) -> str:
    """Say whether the choices had been written down before ratings were seen."""
    if (frozen := read_frozen(study)) is None:
        return "The choices of the analysis were not frozen beforehand."
    day = f" on {frozen.utc[:10]}" if is_dated else ""
    when = f"The choices of the analysis were frozen{day}"
    return f"{when}, before any rating was given (frozen.json, SHA-256 {frozen.sha256[:12]})."


def _tell_software(settings: Settings, results: Mapping[str, Any]) -> Iterator[str]:
    """Name the software, and where the data are."""
    names = ", ".join(f"{name} {version}" for name, version in results["versions"].items())
    doi = settings.publication.doi
    place = f"https://doi.org/{doi}" if doi else "[address of the dataset]"
    licence = settings.publication.licence or "[licence]"
    yield f"Stimuli, sessions and analysis were made with {names}. Data: {place} ({licence})."
    funding = "; ".join(settings.publication.funding) or "[funding]"
    yield f"Funding: {funding}."
