"""`frozen.json`: what was decided before the first session of a person; compared with today's settings one by one.

Parsed settings are compared, never the file's text: a comment, the order of keys or a default that is written out
changes nothing. Recordings count by their names and contents, methods of the lab's own by their names and code,
wherever the files lie. What affects neither the ratings nor their analysis does not count.

The file holds the digest of itself, and every session that begins after freezing names it in its header. So a file that
was edited, or written later with the clock set back, is seen.
"""

from __future__ import annotations

import csv
import json
import re
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321.arguments import name_of
from feel321.files import open_text
from feel321.records import to_json_value
from feel321.study.folder import Outcome
from feel321.study.participants.roster import read_holder, read_sealed, write_sealed
from feel321.study.session.events import SessionBegun, TrialRated
from feel321.study.session.journal import digest, list_journals
from feel321.study.session.opening import flatten
from feel321.study.terminal import format_facts
from feel321.types import MetricInfo

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from feel321.analysis.report.standing import Hypothesis, Standing
    from feel321.study.folder import OpenStudy, StudyFolder
    from feel321.study.session.journal import Clock
    from feel321.study.settings.schema import Settings

UNCOUNTED: Any = {
    "study": {"name"}, "session": {"consent", "language"}, "recordings": True, "reducers": True,
    "metrics": {"__all__": {"use", "command", "timeout_s", "label", "unit"}}, "observer": True, "stations": True,
    "paper": True, "publication": True,
}  # fmt: skip
"""Settings that do not count, or count by what they lead to: recordings and code by content, texts by their digest."""

ASIDE = (
    "study.seed", "analysis.draws", "analysis.margin", "analysis.hypotheses", "session.stale", "session.texts",
    "rig.certificate", "software.",
)  # fmt: skip
"""Settings that the declared tests do not depend on: a change of them is named and leaves the tests as declared."""

_MARKS = [f'"event": "{kind.event}"'.encode() for kind in (SessionBegun, TrialRated)]

MOST = 3  # changes that the report's sentence names before it only counts


@dataclass(frozen=True, slots=True)
class Frozen:
    """What was frozen; sha256: of itself."""

    utc: str
    settings: Mapping[str, Any]
    hypotheses: tuple[Hypothesis, ...]
    sha256: str = field(default="", compare=False)


def freeze_study(study: StudyFolder, *, now: Clock) -> tuple[Frozen, dict[str, str]]:
    """Write `frozen.json`, before the first session of a person; return what it holds and what differs from before."""
    from feel321.study.settings.read import read_settings, require_current_set

    former, settings = read_frozen(study), read_settings(study.settings)
    begun = [path.split("/")[1] for path, _ in _list_sessions(study)]
    if study.ratings.is_file():  # where the journals are gone
        with open_text(study.ratings) as file:
            rows = csv.DictReader(file)
            begun += [row["participant"] for row in rows if row.get("simulated") == "false"]
    place = quote(str(study.path))
    if begun:
        text = f"{begun[0]} has begun already, so it is too late to freeze; all results stay exploratory"
        remedy = f"if that was a trial, withdraw first: feel321 withdraw {place} --participant {begun[0]}"
        raise ValueError(f"{study.path}: {text}; {remedy}")
    if not study.manifest.is_file():
        raise FileNotFoundError(
            f"{study.manifest}: there is no stimulus set yet, which is part of what is frozen; build it first: "
            f"feel321 build {place}"
        )
    require_current_set(study, settings)
    named = list_settings(study, settings)
    changes = find_changes(former.settings, named) if former else {}
    if former and not changes:
        return former, {}
    own = Frozen(now().isoformat(timespec="seconds"), named, tuple(_list_hypotheses(settings)))
    entry = {name: value for name, value in asdict(own).items() if name != "sha256"}
    return replace(own, sha256=write_sealed(study.frozen, entry)), changes


def report_frozen(lab: OpenStudy, *, show: bool) -> Outcome:
    """Freeze a study, or only show what is frozen, and say what changed since."""
    from feel321.study.settings.read import read_settings

    study, path = lab.folder, lab.folder.path
    frozen, changes = (read_frozen(study), {}) if show else freeze_study(study, now=lab.now)
    if show and frozen:
        named = list_settings(study, read_settings(study.settings))
        changes = find_changes(frozen.settings, named)
    faults = find_faults(study)
    for fault in faults:
        lab.say(fault)
    lines = [f"{path}: nothing is frozen; before the first session: feel321 freeze"]
    if frozen is not None:
        lines = [f"{study.frozen}: frozen {frozen.utc}, SHA-256 {frozen.sha256}"]
    if frozen is not None and show:
        lines += format_facts({"hypotheses": frozen.hypotheses, "settings": frozen.settings})
    if changes:
        lines += ["changed:", *(f"  {one}" for one in changes.values())]
    facts = {"frozen": frozen and asdict(frozen), "changes": [*changes.values()]}
    return Outcome({**facts, "faults": faults}, lines)


def read_frozen(study: StudyFolder) -> Frozen | None:
    """Read the file, if there is one; one that is damaged or was edited is refused."""

    def make(entry: dict[str, Any]) -> Frozen:
        from feel321.analysis.report.standing import Hypothesis

        sha256 = digest(json.dumps(entry, sort_keys=True))
        hypotheses = tuple(Hypothesis(**one) for one in entry.pop("hypotheses"))
        return Frozen(**entry, hypotheses=hypotheses, sha256=sha256)

    return read_sealed(study.frozen, make)


# What counts, and what of it has changed.


def list_settings(study: StudyFolder, settings: Settings) -> dict[str, Any]:
    """List everything that counts by its dotted name, as JSON can hold it, in alphabetical order."""
    from feel321.analysis.report.standing import MODEL, list_versions
    from feel321.protocols.tasks import digest_protocols
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.settings.read import CONSENT, list_methods, make_recipe, read_study_texts

    stimuli = read_stimuli(study.stimuli)
    found = dict(flatten(settings.model_dump(mode="json", by_alias=True, exclude=UNCOUNTED)))
    for name in ("stimuli.reducers", "stimuli.metrics"):
        found[name] = [name_of(one) for one in found[name]]
    found["stimuli.reference"] = name_of(found["stimuli.reference"])
    # What participants read counts, but an ethics board may still reword the page of consent.
    texts = read_study_texts(settings, study.path)
    texts["pages"] = {key: page for key, page in texts["pages"].items() if key != CONSENT}
    read = digest(json.dumps(texts, sort_keys=True))
    found |= {"stimuli.set": stimuli.sha256, "session.texts": read}
    found |= {f"recordings.{row.recording}": row.recording_sha256 for row in stimuli.stimuli}
    # The lab's own code: what stimuli are made with, all metrics, and protocols.
    metrics = [one for one in list_methods(settings, study.path) if one.kind == "metric"]
    methods = (*make_recipe(settings, study.path).methods, *metrics)
    found |= {f"code.{one.kind}.{one.name}": one.sha256 for one in methods}
    protocols = digest_protocols(settings.session.protocols)
    found |= {f"code.{name}": sha256 for name, sha256 in protocols.items()}
    for claim in settings.paper.claims if settings.paper else ():
        numbers = {"paper": claim.paper._asdict()}
        found[f"paper.claims.{claim.name}"] = to_json_value(asdict(claim) | numbers)
    found |= {f"analysis.{name}": said for name, said in MODEL.items()}
    found |= {f"software.{name}": number for name, number in list_versions().items()}
    return dict(sorted(found.items()))


def _list_hypotheses(settings: Settings) -> Iterator[Hypothesis]:
    """List the declared slopes: one for each scale and level on which stimuli are rated, and each metric."""
    from feel321.analysis.report.standing import Hypothesis
    from feel321.analysis.table.schema import ANSWERED, CHOSEN, PAIRED, RECAST
    from feel321.types import METRIC_INFO

    tasks = settings.list_tasks()
    scales = dict.fromkeys(name for task in tasks for name in (task.scales or (task.protocol,)))
    rated = [RECAST if name == PAIRED else name for name in scales]
    known = {**METRIC_INFO, **list_info(settings)}
    for scale in (name for name in rated if name not in {ANSWERED, *CHOSEN}):
        for level in settings.stimuli.levels:
            for metric in settings.analysis.metrics:
                higher = known[metric].higher if metric in known else "better"
                yield Hypothesis(scale, level, metric, higher)


def list_info(settings: Settings) -> dict[str, MetricInfo]:
    """List what `[metrics.NAME]` declares; a table that only says where a metric's code is declares nothing."""
    from feel321.analysis.table.columns import make_info

    facts = {name: table.to_facts() for name, table in settings.metrics.items()}
    declared = {one.name for one in fields(MetricInfo)}
    return {name: make_info(name, one) for name, one in facts.items() if declared & set(one)}


def find_changes(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Name each changed setting in plain words: its dotted name -> "NAME: was ..., now ..."."""

    def describe(value: Any) -> str:  # noqa: ANN401 - whatever JSON holds
        several = value if isinstance(value, list | tuple) else [value]
        digests = (re.sub(r"^([0-9a-f]{12})[0-9a-f]{52}$", r"\1...", str(one)) for one in several)
        return "not set" if value is None else ", ".join(digests) or "none"

    return {
        name: f"{name}: was {describe(frozen.get(name))}, now {describe(now.get(name))}"
        for name in sorted({*frozen, *now})
        if _drop_unset(frozen.get(name)) != _drop_unset(now.get(name))
    }


def _drop_unset(value: Any) -> Any:  # noqa: ANN401 - whatever JSON holds
    """Drop what is not set: a key that came with a newer feel321 is no change."""
    if isinstance(value, dict):
        kept = {key: _drop_unset(one) for key, one in value.items()}
        return {key: one for key, one in kept.items() if one not in (None, {})}
    return [_drop_unset(one) for one in value] if isinstance(value, list | tuple) else value


# The state in a line, what is wrong with it, and what it makes of an analysis.


def describe_frozen(study: StudyFolder) -> str:
    """Describe in one line what is frozen, for check, status and audit; empty where nothing is."""
    try:
        frozen = read_frozen(study)
    except ValueError:
        return f"frozen: {study.frozen.name} cannot be trusted (feel321 audit)"
    when = frozen.utc[:16].replace("T", " ") if frozen else ""
    return f"frozen: {when} UTC, before any session" if when else ""


def find_faults(study: StudyFolder) -> list[str]:
    """Find reasons to distrust the frozen file: edits, and sessions whose headers name another one, or none."""
    if study.is_rehearsal:  # which may come before it
        return []
    try:
        frozen = read_frozen(study)
    except ValueError as error:
        return [str(error)]
    faults, sha256 = [], frozen.sha256 if frozen else ""
    for path, named in _list_sessions(study):
        fault = f"is not the one that {path} names in its header; restore that one"
        if not sha256:
            fault = f"is not there, though {path} names it in its header; restore it from a copy"
        elif not named:
            fault = f"is newer than the session of {path}, whose header knows of no frozen file"
        if named != sha256:
            faults.append(f"{study.frozen}: {fault}")
    return faults


def _list_sessions(study: StudyFolder) -> Iterator[tuple[str, str]]:
    """List the journals of people and the frozen file that each header names; damage must hide no session."""
    for folder in study.participants:
        holder = None  # one whose plan cannot be read counts as a person
        with suppress(OSError, ValueError):
            holder = read_holder(folder)
        for path in () if holder and holder.simulated else list_journals(folder):
            content, named = path.read_bytes() if path.is_file() else b"", ""
            line = next((one for one in content.split(b"\n") if _MARKS[0] in one), b"{}")
            with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                named = str(json.loads(line)["data"].get("frozen", ""))
            if any(mark in content for mark in _MARKS):
                yield path.relative_to(study.path).as_posix(), named


def make_standing(
    study: StudyFolder,
    settings: Settings,
    *,
    metrics: Sequence[str] = (),
    draws: int | None = None,
    own: bool = True,
) -> Standing:
    """Compare what is about to be analysed with the frozen file; own: whether the ratings are those of the study."""
    from feel321.analysis.report.standing import Standing

    if not own and study.frozen.exists():
        first = "These ratings come from elsewhere, so what the study froze does not hold for them"
        reason = "the ratings are not the study's own"
        return Standing(f"{first}: all results are exploratory.", "elsewhere", reason=reason)
    if own and (faults := find_faults(study)):
        said = faults[0].partition(": ")[2].partition(";")[0]
        verb = "was " if said.startswith("changed") else ""
        reason = f"{study.frozen.name} cannot be trusted"
        first = f"All results are exploratory, because {reason}: it {verb}{said}."
        return Standing(first, "unsound", reason=reason, changes=tuple(faults))
    frozen = read_frozen(study) if own else None
    if frozen is None:
        return Standing()
    given = {"metrics": tuple(metrics) or None, "draws": draws}
    named = {name: value for name, value in given.items() if value is not None}
    asked = settings.model_copy(update={"analysis": settings.analysis.model_copy(update=named)})
    changes = find_changes(frozen.settings, list_settings(study, asked))
    aside = [text for name, text in changes.items() if name.startswith(ASIDE)]
    weighty = [text for name, text in changes.items() if not name.startswith(ASIDE)]
    when, count, reason = frozen.utc[:10], len(frozen.hypotheses), ""
    slopes = "the declared slope is" if count == 1 else f"the {count} declared slopes are"
    first = (
        f"Hypotheses and analysis were frozen on {when}, before anybody came: {slopes} confirmatory, all else is "
        "exploratory."
    )
    if weighty:
        reason = "settings were changed after they were frozen"
        what = f"settings that were frozen on {when} have changed: {_shorten(weighty)}"
        first = f"All results are exploratory, because {what}."
    if aside:
        first += f" The declared tests do not depend on what else has changed: {_shorten(aside)}."
    changed = (*weighty, *aside)
    return Standing(first, "before", frozen.hypotheses, reason, changed, frozen.utc, frozen.sha256)


def _shorten(texts: Sequence[str]) -> str:
    left = len(texts) - MOST
    return "; ".join([*texts[:MOST], *([f"and {left} more"] if left > 0 else [])])
