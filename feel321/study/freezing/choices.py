"""The choices that a study freezes, by their dotted names in study.toml, and in plain words what has changed.

Parsed settings are compared, never the file's text: a comment, the order of keys or a default that is written out
changes nothing. Recordings count by their names and contents, methods of the lab's own by their names and code,
wherever the files lie. Whatever affects neither the ratings nor their analysis does not count: the study's
name, simulated observers, the ledger, pictures and labels.
"""

from __future__ import annotations

import hashlib
import json
from typing import TYPE_CHECKING, Any

from feel321.analysis.report.standing import MODEL, Hypothesis
from feel321.doors import name_of
from feel321.study.freezing.record import digest_value

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from feel321.stimuli.sets.manifest import StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.settings.schema import Settings

UNCOUNTED: Any = {
    "study": {"name"}, "session": {"consent", "language"}, "recordings": True, "reducers": True, "metrics": True,
    "formats": True, "observer": True, "ledger": True, "paper": True,
}  # fmt: skip
"""Settings that do not count, or count by what they lead to: recordings and code by content, texts by their digest."""

ASIDE = (
    "study.seed", "analysis.draws", "analysis.margin", "analysis.hypotheses", "session.stale", "session.texts",
    "rig.certificate",
)  # fmt: skip
"""Choices that the primary test does not depend on: a change of them is named and leaves it as it was declared."""

DIGITS = 12
"""Digits of a digest that are shown."""


def list_choices(study: StudyFolder, settings: Settings, stimuli: StimulusSet) -> dict[str, Any]:
    """List every choice that counts, as JSON can hold it, in alphabetical order."""
    found = dict(_flatten(settings.model_dump(mode="json", exclude=UNCOUNTED)))
    for name in ("stimuli.reducers", "stimuli.metrics", "analysis.screening"):
        found[name] = [name_of(one) for one in found[name]]
    found["stimuli.reference"] = name_of(found["stimuli.reference"])
    found |= {"stimuli.set": stimuli.sha256, "session.texts": _digest_texts(settings, study)}
    for row in stimuli.stimuli:
        found[f"recordings.{row.recording}"] = row.recording_sha256
    found |= dict(_list_code(settings, study)) | dict(_list_metrics(settings, stimuli))
    if settings.paper:
        found |= _flatten_claims(settings)
    return dict(sorted((found | {f"analysis.{key}": said for key, said in MODEL.items()}).items()))


def _flatten(entry: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in entry.items():
        if isinstance(value, dict):
            yield from _flatten(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}", value


def _digest_texts(settings: Settings, study: StudyFolder) -> str:
    """Digest what participants read, without the page of consent, which an ethics board may still reword."""
    from feel321.study.settings.read import CONSENT, read_study_texts

    texts = read_study_texts(settings, study.path)
    texts["pages"] = {key: page for key, page in texts["pages"].items() if key != CONSENT}
    return digest_value(texts)


def _list_code(settings: Settings, study: StudyFolder) -> Iterator[tuple[str, str]]:
    """List the digests of the lab's own code: reducers, metrics, screening rules and protocols."""
    from feel321.analysis.screening.rules import find_rules
    from feel321.protocols.tasks import digest_protocols
    from feel321.study.settings.read import find_metric, make_recipe

    rules = find_rules(settings.analysis.screening, study.path)
    code = [name for name, table in settings.metrics.items() if table.use or table.command]
    declared = [find_metric(settings, name, study.path) for name in code]
    own = [one for one in declared if not isinstance(one, str)]
    for method in (*make_recipe(settings, study.path).methods, *own, *rules):
        yield f"code.{method.kind.replace(' ', '_')}.{method.name}", method.sha256
    for name, sha256 in digest_protocols(settings.session.protocols).items():
        yield f"code.{name}", sha256


def _list_metrics(settings: Settings, stimuli: StimulusSet) -> Iterator[tuple[str, Any]]:
    """List what each metric of the primary analysis declares, and the step by which its slope is reported."""
    from feel321.analysis.table.metrics import find_steps

    info = list_metric_info(settings)
    tests = stimuli.to_frame().query("role == 'test'")
    known = [name for name in settings.analysis.metrics if name in tests]
    steps = find_steps(tests, known, info)
    for name in settings.analysis.metrics:
        yield f"metrics.{name}.higher", info[name].higher
        yield f"metrics.{name}.bounds", [str(info[name].low), str(info[name].high)]
        if name in steps:
            yield f"metrics.{name}.step", steps[name].per


def list_metric_info(settings: Settings) -> dict[str, Any]:
    """List what is declared of the metrics of the primary analysis."""
    from feel321.analysis.table.metrics import make_info
    from feel321.names import METRIC_INFO

    declared = {name: make_info(name, one.to_facts()) for name, one in settings.metrics.items()}
    return {
        name: declared.get(name) or METRIC_INFO.get(name) or make_info(name, {})
        for name in settings.analysis.metrics
    }


def _flatten_claims(settings: Settings) -> dict[str, Any]:
    claims = settings.paper.model_dump(mode="json")["claims"] if settings.paper else []
    return {f"paper.claims.{one['name']}": one for one in claims}


def list_hypotheses(settings: Settings) -> list[Hypothesis]:
    """List the primary hypotheses: one for each scale and level on which stimuli are rated, and each metric."""
    from feel321.analysis.table.schema import ANSWERED, CHOSEN, PAIRED, RECAST
    from feel321.study.settings.read import make_design

    tasks = make_design(settings).tasks
    scales = dict.fromkeys(name for task in tasks for name in (task.scales or (task.protocol,)))
    rated = [RECAST if name == PAIRED else name for name in scales]
    rated = [name for name in rated if name not in {ANSWERED, *CHOSEN}]
    info = list_metric_info(settings)
    return [
        Hypothesis(scale, level, metric, info[metric].higher)
        for scale in rated
        for level in settings.stimuli.levels
        for metric in settings.analysis.metrics
    ]


def find_changes(frozen: Mapping[str, Any], now: Mapping[str, Any]) -> dict[str, str]:
    """Name each changed choice in plain words: its dotted name -> "NAME: was ..., now ..."."""
    usual = _list_defaults()
    # A setting that came with a later version of feel321, and is at its default, is no change.
    before = {name: usual.get(name) for name in now} | dict(frozen)
    names = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    # What a metric declares says nothing new where the metric itself came or went.
    both = set(before.get("analysis.metrics") or ()) & set(now["analysis.metrics"])
    names = [one for one in names if one.split(".")[0] != "metrics" or one.split(".")[1] in both]
    return {
        name: f"{name}: was {describe_value(before.get(name))}, now {describe_value(now.get(name))}"
        for name in names
    }


def _list_defaults() -> dict[str, Any]:
    from feel321.study.settings.schema import SceneTable, Settings

    settings = Settings(recordings=(SceneTable(scene="bumps"),))
    return dict(_flatten(settings.model_dump(mode="json", exclude=UNCOUNTED)))


def is_aside(name: str) -> bool:
    """Check whether the primary test does not depend on a choice."""
    return name.startswith(ASIDE)


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
        return f"{value[:DIGITS]}..."
    if isinstance(value, dict):
        return json.dumps(value, ensure_ascii=False)
    return str(value)
