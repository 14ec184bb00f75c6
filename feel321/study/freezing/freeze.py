"""Freeze a study before its ratings are seen, amend that, and describe the state in a line."""

from __future__ import annotations

import json
from contextlib import suppress
from dataclasses import dataclass, replace
from shlex import quote
from typing import TYPE_CHECKING

from feel321.study.freezing import choices, record
from feel321.study.freezing.counted import count_ratings
from feel321.study.freezing.record import Frozen
from feel321.study.session.identity import FROZEN_FILE

if TYPE_CHECKING:
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Clock


@dataclass(frozen=True, slots=True)
class FreezeState:
    """What is frozen, what a freeze would write now, what differs between them, and reasons to distrust the file."""

    name: str
    frozen: Frozen | None
    now: Frozen
    changes: tuple[str, ...] = ()
    faults: tuple[str, ...] = ()


def compare_now(study: StudyFolder, *, participants: int | None = None) -> FreezeState:
    """Compare what is frozen with what the study says now."""
    from feel321.study.settings.read import read_settings

    faults = tuple(record.find_faults(study))
    frozen = record.read_frozen(study)
    now = _decide(study, participants, frozen)
    changes = () if frozen is None else tuple(list_differences(frozen, now))
    return FreezeState(read_settings(study.settings).study.name, frozen, now, changes, faults)


def freeze_study(
    study: StudyFolder,
    *,
    now: Clock,
    because: str = "",
    after_data: bool = False,
    participants: int | None = None,
) -> tuple[Frozen, list[str]]:
    """Write `frozen.json`; return what it holds, and the choices that differ from the former state."""
    former = record.read_frozen(study)
    rated = count_ratings(study)
    if (rated.judgements or rated.participants) and not after_data:
        raise ValueError(
            f"{study.path}: {record.describe_rated(rated)} came before, so it is too late to freeze before the data; "
            "--after-data freezes anyway, and every result is then exploratory"
        )
    own = replace(
        _decide(study, participants, former), utc=now().isoformat(timespec="seconds"), rated=rated
    )
    changes = [] if former is None else list_differences(former, own)
    if former is not None and not changes:
        return former, []
    if former is not None and not because:
        raise ValueError(
            f"{study.path / FROZEN_FILE}: frozen on {former.utc[:10]} with other choices ({'; '.join(changes)}); "
            'give the reason: --because "REASON"'
        )
    history = () if former is None else (*former.history, replace(former, history=()))
    if former is not None:
        history = tuple(_seal_alone(one) for one in history)
    return record.write_frozen(study, replace(own, because=because, history=history)), changes


def _seal_alone(one: Frozen) -> Frozen:
    """Give a former state the digest of itself without what came before it, which the file holds beside it."""
    return replace(one, sha256=record.digest_value(one.to_json()))


def _decide(study: StudyFolder, participants: int | None, former: Frozen | None) -> Frozen:
    """Gather the choices of today's settings and stimuli."""
    from feel321 import __version__
    from feel321.analysis.report.standing import list_versions
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.sessions import require_current_set
    from feel321.study.settings.read import read_settings

    settings = read_settings(study.settings)
    if not study.manifest.is_file():
        raise FileNotFoundError(
            f"{study.manifest}: there is no stimulus set yet, which is part of what is frozen; build it first: "
            f"feel321 build {quote(str(study.path))}"
        )
    require_current_set(study, settings)
    planned, source = (participants, "declared") if participants else _find_planned(study)
    if planned is None and former is not None:
        planned, source = former.participants, former.planned_by
    hypotheses = tuple(choices.list_hypotheses(settings))
    return Frozen(
        utc="", feel321=__version__, participants=planned, planned_by=source, rated=record.Seen(),
        choices=choices.list_choices(study, settings, read_stimuli(study.stimuli)), hypotheses=hypotheses,
        words=(*map(str, hypotheses), *settings.analysis.hypotheses), versions=list_versions(),
    )  # fmt: skip


def _find_planned(study: StudyFolder) -> tuple[int | None, str]:
    """Find the number of participants that `feel321 power` recommended, if it was run."""
    with suppress(OSError, ValueError, KeyError, TypeError):
        content = json.loads((study.path / "power" / "results.json").read_bytes())
        if best := content["recommended"]:
            return int(best["participants"]) * int(content["share"]), "feel321 power"
    return None, ""


def list_differences(former: Frozen, own: Frozen) -> list[str]:
    """Name everything in which two states differ that was decided; software is named by itself."""
    found = list(choices.find_changes(former.choices, own.choices).values())
    if former.participants != own.participants:
        was, now = map(choices.describe_value, (former.participants, own.participants))
        found.append(f"participants: was {was}, now {now}")
    if former.feel321 != own.feel321:
        found.append(f"feel321: was {former.feel321}, now {own.feel321}")
    return found
