"""`ratings.csv`: one row per completed judgement, derived from the journals and from nothing else.

It may be deleted at any time: it is written anew, byte for byte the same, from what the journals hold.
"""

from collections.abc import Iterator, Mapping
from operator import itemgetter
from pathlib import Path
from typing import Any

from feel321.files import write_table
from feel321.protocols.tasks import find_other, score_trial
from feel321.protocols.trial import Trial
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.study.columns import RATING_COLUMNS
from feel321.study.folder import StudyFolder
from feel321.study.sensation import find_own_levels
from feel321.study.session.codes import list_by_code
from feel321.study.session.events import (
    PartPlayed,
    SessionBegun,
    SessionSuperseded,
    TrialRated,
    TrialShown,
)
from feel321.study.session.journal import Records, list_journals, name_journal
from feel321.study.session.plan import TOMBSTONE_FILE, Dossier, Plan, read_as_written, read_dossier
from feel321.study.wide import write_wide

_KINDS = {kind.event for kind in (TrialShown, PartPlayed, TrialRated)}


def write_ratings(study: StudyFolder, stimuli: StimulusSet) -> int:
    """Write all completed judgements of a study, of unfinished sessions too, and count them.

    Training and practice are left out; they stand in the journals. An attempt that was bad, or a session that
    was begun anew, is there and marked as rejected.
    """
    rows = [row for one in study.read_people() for row in list_judgements(one, stimuli)]
    count = write_table(study.ratings, RATING_COLUMNS, rows, private=True)
    study.share(study.ratings)
    write_wide(study.path, rows)
    return count


def read_judgements(folder: Path, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """Read the completed judgements of one participant; a withdrawn one has none, even if a copy has come back."""
    if not list_journals(folder) or (folder / TOMBSTONE_FILE).exists():
        return []
    return list_judgements(read_dossier(folder), stimuli)


def list_judgements(dossier: Dossier, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """List the completed judgements of one participant, with names in the place of blind codes."""
    plan, folder = dossier.plan, dossier.folder
    if dossier.chains and plan.stimuli_sha256 != stimuli.sha256:
        raise ValueError(
            f"{folder}: was planned with stimulus set {plan.stimuli_sha256[:12]}, the study holds "
            f"{stimuli.sha256[:12]}; build the set of that session again"
        )
    by_code = list_by_code(stimuli, seed=plan.seed)
    rows = []
    for path, chain in zip(list_journals(folder), dossier.chains, strict=False):
        with read_as_written(path):
            if (header := chain.records.find_header()) is None:
                continue
            if fault := next(find_misplaced(path, header, plan), ""):
                remedy = "move a copy out of sessions/, or restore the plan from one"
                raise ValueError(f"{path}{fault}; {remedy}")
            levels = find_own_levels(plan, chain.records, stimuli)
            own = _decode_judgements(dossier, chain.records, by_code, levels=levels, path=path)
            rows += sorted(own, key=itemgetter("trial"))
    return rows


def find_misplaced(path: Path, header: SessionBegun, plan: Plan) -> Iterator[str]:
    """Find whether a journal was written elsewhere, or to another plan than the one beside it."""
    if (header.participant, name_journal(header.session)) != (plan.participant, path.name):
        yield f": is session {header.session} of {header.participant!r}, it was copied here"
    if header.plan_sha256 != plan.sha256:
        yield ": was begun with another plan than the one beside it"


def _decode_judgements(
    dossier: Dossier,
    records: Records,
    by_code: Mapping[str, Stimulus],
    *,
    levels: Mapping[str, float],
    path: Path,
) -> Iterator[dict[str, Any]]:
    """Decode the completed judgements of a journal that has a header, as they were made."""
    header = records.find_header()
    trials = {trial.number: trial for trial in dossier.plan.trials}
    superseded = records.has(SessionSuperseded)
    played: list[PartPlayed] = []
    for record in records:
        if record.event not in _KINDS or header is None:
            continue
        match record.content:
            case TrialShown():
                played = []
            case PartPlayed() as part:
                played.append(part)
            case TrialRated() as rated if (trial := trials[rated.trial]).phase == "main":
                felt = {part.part: part for part in played if part.completed}
                parts = dict.fromkeys(judgement.part for judgement in trial.judgements)
                if missing := [name for name in parts if name not in felt]:
                    raise ValueError(
                        f"{path}, line {record.sequence + 1}: trial {trial.number} is rated, but {', '.join(missing)} "
                        "was not played since it was shown; restore the file from a copy"
                    )
                facts = {
                    "participant": header.participant,
                    "session": header.session,
                    "simulated": _write_flag(header.identity["presenter"]["simulated"]),
                    "underruns": sum(part.underruns for part in played),
                    "rejected": _write_flag(rated.rejected or superseded),
                    "response_time_s": rated.response_time_s,
                }
                for row in _judge(trial, rated, felt):
                    yield facts | _name(row, by_code, levels)


def _judge(
    trial: Trial, rated: TrialRated, felt: Mapping[str, PartPlayed]
) -> Iterator[dict[str, Any]]:
    points = score_trial(trial, rated.values)
    for judgement in trial.judgements:
        yield {
            "protocol": trial.protocol,
            "block": trial.block,
            "trial": trial.number,
            "repeat": trial.repeat,
            "stimulus_id": judgement.stimulus_id,
            "reference_id": judgement.reference_id,
            "scale": judgement.scale or trial.scale,
            "rating": points[judgement.key],
            "onset_s": felt[judgement.part].onset_s,
            **_describe_delivered(felt[judgement.part].delivered),
            "other_id": find_other(trial, judgement),
        }


def _name(
    row: dict[str, Any], by_code: Mapping[str, Stimulus], levels: Mapping[str, float]
) -> dict[str, Any]:
    """Put names in the place of codes."""
    stimulus = by_code[row["stimulus_id"]]
    others = {name: by_code.get(row[name]) for name in ("reference_id", "other_id")}
    return row | {
        "stimulus_id": stimulus.stimulus_id,
        "recording": stimulus.recording,
        "reducer": stimulus.reducer,
        "level": stimulus.level,
        **{name: other.stimulus_id if other else row[name] for name, other in others.items()},
        "sensation_level_db": levels.get(stimulus.stimulus_id, ""),
    }


def _describe_delivered(delivered: Mapping[str, float]) -> dict[str, Any]:
    """Describe what the hand got of a playback; only a sensor gives a coherence."""
    matches = ("spectral_match", "temporal_match", "spectral_match_bounded")
    source = ("sensor" if "coherence" in delivered else "certificate") if delivered else ""
    return {
        **{f"{name}_delivered": delivered.get(name, "") for name in matches},
        "level_error_db": delivered.get("level_error_db", ""),
        "delivered_by": source,
    }


def _write_flag(flag: bool) -> str:  # noqa: FBT001 - the flag is the value, not an option
    return "true" if flag else "false"
