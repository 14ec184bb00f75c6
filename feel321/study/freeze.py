"""`frozen.json`: what was decided before ratings were seen, and when; compared with today's settings one by one.

Parsed settings are compared, never the file's text: a comment, the order of keys or a default that is written out
changes nothing. Recordings count by their names and contents, methods of the lab's own by their names and code,
wherever the files lie. What affects neither the ratings nor their analysis does not count.

The file holds the digest of itself, and every session that begins after freezing names it in its header. So a file that
was edited, or written later with the clock set back, is seen.
"""

from __future__ import annotations

import csv
import hashlib
import json
from contextlib import suppress
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from shlex import quote
from typing import TYPE_CHECKING, Any

from feel321 import intake
from feel321.analysis.report.standing import MODEL, Hypothesis, Standing, list_versions
from feel321.doors import name_of
from feel321.files import write_text
from feel321.study.session.events import SessionBegun, TrialRated
from feel321.study.session.journal import list_journals
from feel321.study.session.opening import FROZEN_FILE
from feel321.study.session.plan import PLAN_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
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

MOST = 3
"""Changes that the report's sentence names before it only counts."""


@dataclass(frozen=True, slots=True)
class Frozen:
    """What was frozen; former: digests of the states that it replaced, sha256: of itself."""

    utc: str
    settings: Mapping[str, Any]
    hypotheses: tuple[Hypothesis, ...]
    former: tuple[str, ...] = ()
    sha256: str = field(default="", compare=False)

    @property
    def amended(self) -> str:
        """How often it replaced another one, for a sentence."""
        times = len(self.former)
        return f"amended {times} time{'s' * (times > 1)}" if times else ""


def freeze_study(study: StudyFolder, *, now: Clock) -> tuple[Frozen, dict[str, str]]:
    """Write `frozen.json`, before the first rating of a person; return what it holds and what differs from before."""
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.sessions import require_current_set
    from feel321.study.settings.read import read_settings

    former, settings = read_frozen(study), read_settings(study.settings)
    if rated := next(_list_rated(study), ""):
        raise ValueError(
            f"{study.path}: {rated} has rated already, so it is too late to freeze; all results stay exploratory"
        )
    if not study.manifest.is_file():
        raise FileNotFoundError(
            f"{study.manifest}: there is no stimulus set yet, which is part of what is frozen; build it first: "
            f"feel321 build {quote(str(study.path))}"
        )
    require_current_set(study, settings)
    named = list_settings(study, settings, read_stimuli(study.stimuli))
    own = Frozen(now().isoformat(timespec="seconds"), named, tuple(_list_hypotheses(settings)))
    changes: dict[str, str] = {}
    if former is not None:
        if not (changes := find_changes(former.settings, named)):
            return former, {}
        own = replace(own, former=(*former.former, former.sha256))
    entry = asdict(own)
    del entry["sha256"]
    sealed = replace(own, sha256=digest_value(entry))
    text = json.dumps(asdict(sealed), indent=1, ensure_ascii=False)
    write_text(study.path / FROZEN_FILE, f"{text}\n")
    return sealed, changes


def read_frozen(study: StudyFolder) -> Frozen | None:
    """Read the file, if there is one; one that is damaged or was edited is refused."""
    path = study.path / FROZEN_FILE
    if not path.is_file():
        return None
    try:
        own = json.loads(path.read_bytes())
        sha256 = own.pop("sha256")
        is_sealed = digest_value(own) == sha256
        hypotheses = tuple(Hypothesis(**one) for one in own.pop("hypotheses"))
        frozen = Frozen(
            **own | {"former": tuple(own["former"])}, hypotheses=hypotheses, sha256=sha256
        )
    except (AttributeError, KeyError, TypeError, ValueError, RecursionError):
        is_sealed, frozen = False, None
    if not is_sealed:
        raise ValueError(
            f"{path}: changed after it was written (its SHA-256 does not match), or not a file of feel321 freeze; "
            "restore it from a copy"
        )
    return frozen


def digest_value(value: object) -> str:
    """Digest a value that JSON can hold, whatever the order of its keys."""
    text = json.dumps(value, sort_keys=True, ensure_ascii=False, allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()


# What counts, and what of it has changed.


def list_settings(study: StudyFolder, settings: Settings, stimuli: StimulusSet) -> dict[str, Any]:
    """List everything that counts by its dotted name, as JSON can hold it, in alphabetical order."""
    from feel321.study.settings.read import CONSENT, read_study_texts

    found = dict(_flatten(settings.model_dump(mode="json", exclude=UNCOUNTED)))
    for name in ("stimuli.reducers", "stimuli.metrics"):
        found[name] = [name_of(one) for one in found[name]]
    found["stimuli.reference"] = name_of(found["stimuli.reference"])
    # What participants read counts, but an ethics board may still reword the page of consent.
    texts = read_study_texts(settings, study.path)
    texts["pages"] = {key: page for key, page in texts["pages"].items() if key != CONSENT}
    found |= {"stimuli.set": stimuli.sha256, "session.texts": digest_value(texts)}
    found |= {f"recordings.{row.recording}": row.recording_sha256 for row in stimuli.stimuli}
    found |= dict(_list_code(settings, study))
    if settings.paper:
        claims = settings.paper.model_dump(mode="json")["claims"]
        found |= {f"paper.claims.{one['name']}": one for one in claims}
    found |= {f"analysis.{name}": said for name, said in MODEL.items()}
    found |= {f"software.{name}": number for name, number in list_versions().items()}
    return dict(sorted(found.items()))


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in entry.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _list_code(settings: Settings, study: StudyFolder) -> Iterator[tuple[str, str]]:
    """List the digests of the lab's own code: reducers, metrics and protocols."""
    from feel321.protocols.tasks import digest_protocols
    from feel321.study.settings.read import find_metric, make_recipe

    code = [name for name, table in settings.metrics.items() if table.use or table.command]
    declared = [find_metric(settings, name, study.path) for name in code]
    own = [one for one in declared if not isinstance(one, str)]
    for method in (*make_recipe(settings, study.path).methods, *own):
        yield f"code.{method.kind}.{method.name}", method.sha256
    for name, sha256 in digest_protocols(settings.session.protocols).items():
        yield f"code.{name}", sha256


def _list_hypotheses(settings: Settings) -> Iterator[Hypothesis]:
    """List the declared slopes: one for each scale and level on which stimuli are rated, and each metric."""
    from feel321.analysis.table.metrics import make_info
    from feel321.analysis.table.schema import ANSWERED, CHOSEN, PAIRED, RECAST
    from feel321.names import METRIC_INFO
    from feel321.study.settings.read import make_design

    tasks = make_design(settings).tasks
    scales = dict.fromkeys(name for task in tasks for name in (task.scales or (task.protocol,)))
    rated = [RECAST if name == PAIRED else name for name in scales]
    for scale in (name for name in rated if name not in {ANSWERED, *CHOSEN}):
        for level in settings.stimuli.levels:
            for metric in settings.analysis.metrics:
                own = settings.metrics.get(metric)
                info = (
                    make_info(metric, own.to_facts())
                    if own
                    else METRIC_INFO.get(metric) or make_info(metric, {})
                )
                yield Hypothesis(scale, level, metric, info.higher)


def find_changes(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Name each changed setting in plain words: its dotted name -> "NAME: was ..., now ..."."""
    return {
        name: f"{name}: was {describe_value(frozen.get(name))}, now {describe_value(now.get(name))}"
        for name in sorted({*frozen, *now})
        if frozen.get(name) != now.get(name)
    }


def describe_value(value: object) -> str:
    """Write a value for reading.

    Examples
    --------
    >>> describe_value(None), describe_value(["a", "b"]), describe_value(0.05), describe_value("0" * 64)
    ('not set', 'a, b', '0.05', '000000000000...')
    """
    if value is None:
        return "not set"
    if isinstance(value, list | tuple):
        return ", ".join(map(describe_value, value)) or "none"
    if isinstance(value, str) and len(value) == hashlib.sha256().digest_size * 2:
        return f"{value[:12]}..."
    return json.dumps(value, ensure_ascii=False) if isinstance(value, dict) else str(value)


# The state in a line, and what is wrong with it.


def describe_frozen(study: StudyFolder) -> str:
    """Describe in one line what is frozen, for check, status and audit; empty where nothing is."""
    try:
        frozen = read_frozen(study)
    except ValueError:
        return f"frozen: {FROZEN_FILE} cannot be trusted (feel321 audit)"
    if frozen is None:
        return ""
    when = f"frozen: {frozen.utc[:16].replace('T', ' ')} UTC, before any rating"
    return ", ".join(filter(None, [when, frozen.amended]))


def find_faults(study: StudyFolder) -> list[str]:
    """Find reasons to distrust the frozen file: edits, and times that do not agree with the journals."""
    try:
        faults = list(_list_faults(study, read_frozen(study)))
    except ValueError as error:
        return [str(error)]
    return [f"{study.path / FROZEN_FILE}: {one}" for one in faults]


def _list_faults(study: StudyFolder, frozen: Frozen | None) -> Iterator[str]:
    lines = list(_list_lines(study, SessionBegun.event))
    if frozen is None:
        if path := next((path for path, _, data in lines if data.get("frozen")), ""):
            yield f"is not there, though {path} names it in its header; restore it from a copy"
        return
    when, known = datetime.fromisoformat(frozen.utc), {"", frozen.sha256, *frozen.former}
    first = min((utc for _, utc, _ in _list_lines(study, TrialRated.event)), default=when)
    if first < when:
        yield (
            f"says that it was frozen before any rating, on {frozen.utc}, but a person had rated by "
            f"{first.astimezone(UTC).isoformat()}"
        )
    for path, utc, data in lines:
        named = data.get("frozen", "")
        if named not in known:
            yield f"is not the one that {path} names in its header; restore the former file"
        elif not named and utc > when:
            yield f"says that it was written before the session of {path}, whose header knows of no frozen file"


def _list_lines(
    study: StudyFolder, event: str
) -> Iterator[tuple[str, datetime, Mapping[str, Any]]]:
    """List the records of an event of people: journal, time, data; damaged lines are found by the audit."""
    mark = f'"event": "{event}"'.encode()
    journals = []
    for folder in study.participants:
        is_simulated = False  # one whose plan cannot be read counts as a person
        with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
            is_simulated = json.loads((folder / PLAN_FILE).read_bytes())["simulated"] is True
        journals += [] if is_simulated else list_journals(folder)
    for path in journals:
        for line in (line for line in path.read_bytes().split(b"\n") if mark in line):
            with suppress(ValueError, KeyError, TypeError, AttributeError, RecursionError):
                entry = json.loads(line)
                utc = datetime.fromisoformat(entry["utc"]).astimezone(UTC)
                yield path.relative_to(study.path).as_posix(), utc, {**entry["data"]}


def _list_rated(study: StudyFolder) -> Iterator[str]:
    """List people who rated, by journals, or by the table where their journals are gone."""
    yield from (path.split("/")[1] for path, *_ in _list_lines(study, TrialRated.event))
    if study.ratings.is_file():
        with intake.open_text(study.ratings) as file:
            rows = csv.DictReader(file)
            yield from (row["participant"] for row in rows if row.get("simulated") == "false")


# What it makes of an analysis.


ELSEWHERE = Standing(
    "These ratings come from elsewhere, so what the study froze does not hold for them: all results are exploratory.",
    "elsewhere",
    reason="the ratings are not the study's own",
)


def list_changes(study: StudyFolder, settings: Settings, frozen: Frozen) -> dict[str, str]:
    """Name what differs from what was frozen."""
    from feel321.stimuli.sets.manifest import read_stimuli

    now = list_settings(study, settings, read_stimuli(study.stimuli))
    return find_changes(frozen.settings, now)


def make_standing(
    study: StudyFolder,
    settings: Settings,
    *,
    metrics: Sequence[str] = (),
    draws: int | None = None,
    own: bool = True,
) -> Standing:
    """Compare what is about to be analysed with the frozen file.

    metrics, draws: where they are not the settings'; own: whether the ratings are those of the study.
    """
    if not own:
        return ELSEWHERE if (study.path / FROZEN_FILE).exists() else Standing()
    if faults := find_faults(study):
        said = faults[0].partition(": ")[2].partition(";")[0]
        verb = "was " if said.startswith("changed") else ""
        first = f"All results are exploratory, because {FROZEN_FILE} cannot be trusted: it {verb}{said}."
        reason = f"{FROZEN_FILE} cannot be trusted"
        return Standing(first, "unsound", reason=reason, changes=tuple(faults))
    frozen = read_frozen(study)
    if frozen is None:
        return Standing()
    given = {"metrics": tuple(metrics) or None, "draws": draws}
    named = {name: value for name, value in given.items() if value is not None}
    asked = settings.model_copy(update={"analysis": settings.analysis.model_copy(update=named)})
    changes = list_changes(study, asked, frozen)
    aside = [text for name, text in changes.items() if name.startswith(ASIDE)]
    weighty = [text for name, text in changes.items() if not name.startswith(ASIDE)]
    when = f"on {frozen.utc[:10]}" + (f" ({frozen.amended})" if frozen.former else "")
    reason = ""
    if weighty:
        reason = "settings were changed after they were frozen"
        first = (
            f"All results are exploratory, because settings that were frozen {when} have changed: "
            f"{_shorten(weighty)}."
        )
    else:
        count = len(frozen.hypotheses)
        slopes = "the declared slope is" if count == 1 else f"the {count} declared slopes are"
        first = (
            f"Hypotheses and analysis were frozen {when}, before any person rated: {slopes} confirmatory, all else is "
            "exploratory."
        )
    if aside:
        first += f" The declared tests do not depend on what else has changed: {_shorten(aside)}."
    changed = (*weighty, *aside)
    return Standing(first, "before", frozen.hypotheses, reason, changed, frozen.utc, frozen.sha256)


def _shorten(texts: Sequence[str]) -> str:
    left = len(texts) - MOST
    return "; ".join([*texts[:MOST], *([f"and {left} more"] if left > 0 else [])])
