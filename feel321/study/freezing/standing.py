"""Compare an analysis with what was frozen, and say in one sentence what that makes of its results."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.report.standing import Standing
from feel321.study.freezing import choices, record
from feel321.study.session.identity import FROZEN_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from feel321.study.folder import StudyFolder
    from feel321.study.freezing.record import Frozen
    from feel321.study.settings.schema import Settings

ELSEWHERE = Standing(
    "These ratings come from elsewhere, so what the study froze does not hold for them: all results are exploratory.",
    "elsewhere",
    reason="the ratings are not the study's own",
)


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
    if faults := record.find_faults(study):
        said = faults[0].partition(": ")[2].partition(";")[0]
        verb = "was " if said.startswith("changed") else ""
        first = (
            f"All results are exploratory, because frozen.json cannot be trusted: it {verb}{said}."
        )
        return Standing(
            first, "unsound", reason="frozen.json cannot be trusted", changes=tuple(faults)
        )
    frozen = record.read_frozen(study)
    if frozen is None:
        return Standing()
    given = {"metrics": tuple(metrics) or None, "draws": draws}
    named = {name: value for name, value in given.items() if value is not None}
    asked = settings.model_copy(update={"analysis": settings.analysis.model_copy(update=named)})
    return _judge(study, frozen, _find_changes(study, frozen, asked))


def _find_changes(study: StudyFolder, frozen: Frozen, settings: Settings) -> dict[str, str]:
    from feel321.stimuli.sets.manifest import read_stimuli

    now = choices.list_choices(study, settings, read_stimuli(study.stimuli))
    return choices.find_changes(frozen.choices, now)


def _judge(study: StudyFolder, frozen: Frozen, changes: Mapping[str, str]) -> Standing:
    weighty = [text for name, text in changes.items() if not choices.is_aside(name)]
    aside = [text for name, text in changes.items() if choices.is_aside(name)]
    software = list(_compare_software(frozen))
    day, state, reason = frozen.utc[:10], "before", ""
    times = len(frozen.history)
    amended = f" (amended {times} time{'s' * (times > 1)})" if times else ""
    if frozen.is_late:
        state, reason = "after", "the hypotheses were frozen after the first ratings"
        first = (
            f"Hypotheses were frozen on {day}, after {record.describe_rated(frozen.rated)}, so all results are "
            "exploratory."
        )
    elif weighty:
        reason = "choices were changed after they were frozen"
        first = (
            f"All results are exploratory, because choices that were frozen on {day}{amended} have changed: "
            f"{'; '.join(_shorten(weighty))}."
        )
    else:
        count = len(frozen.hypotheses)
        slopes = "the declared slope is" if count == 1 else f"the {count} declared slopes are"
        first = (
            f"Hypotheses and analysis were frozen on {day}{amended}, before any person rated: {slopes} confirmatory, "
            "all else is exploratory."
        )
    more = [first, *_describe_aside(aside, software), *_describe_people(study, frozen)]
    return Standing(
        " ".join(more),
        state,
        frozen.hypotheses,
        reason,
        (*weighty, *aside, *software),
        frozen.utc,
        frozen.sha256,
    )


MOST = 3
"""Changes that the sentence names before it only counts."""


def _shorten(texts: Sequence[str]) -> list[str]:
    left = len(texts) - MOST
    return [*texts[:MOST], *([f"and {left} more"] if left > 0 else [])]


def _describe_aside(aside: Sequence[str], software: Sequence[str]) -> Iterator[str]:
    if aside:
        yield f"The declared tests do not depend on what else has changed: {'; '.join(_shorten(aside))}."
    if software:
        yield f"Other software than when it was frozen: {'; '.join(software)}."


def _compare_software(frozen: Frozen) -> Iterator[str]:
    from feel321.analysis.report.standing import list_versions

    for name, number in list_versions().items():
        if (former := frozen.versions.get(name)) != number:
            yield f"{name}: was {former or 'not there'}, now {number}"


def _describe_people(study: StudyFolder, frozen: Frozen) -> Iterator[str]:
    if frozen.participants is None:
        return
    rated = record.find_first(study).participants
    if rated and rated != frozen.participants:
        yield f"{frozen.participants} participants were planned, {rated} have rated."
