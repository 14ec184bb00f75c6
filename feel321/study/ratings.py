"""`ratings.csv`: one row per completed judgement, derived from the journals and from nothing else.

It may be deleted at any time: it is written anew, byte for byte the same, from what the journals hold.
"""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

from feel321.files import write_text
from feel321.protocols.tasks import score_trial
from feel321.study.columns import RATING_COLUMNS
from feel321.study.session.journal import read_journal
from feel321.study.session.opening import TOMBSTONE_FILE, read_as_written, require_own_plan
from feel321.study.session.plan import (
    find_header,
    has_event,
    list_codes,
    list_journals,
    name_journal,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from feel321.protocols.trial import Trial
    from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Record
    from feel321.study.session.plan import Plan


def write_ratings(study: StudyFolder, stimuli: StimulusSet) -> int:
    """Write all completed judgements of a study, of unfinished sessions too.

    Training and practice are left out; they stand in the journals. An attempt that was bad, or a session that
    was begun anew, is there and marked as rejected.

    Parameters
    ----------
    study : StudyFolder
        Where the journals are and the table goes; the table is replaced in one step.
    stimuli : StimulusSet
        The set that was judged.

    Returns
    -------
    int
        Number of rows.

    Raises
    ------
    ValueError
        If a plan or journal is broken or was written with another stimulus set.
    """
    rows = [row for folder in study.participants for row in read_judgements(folder, stimuli)]
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, RATING_COLUMNS)
    table.writeheader()
    table.writerows(rows)
    write_text(study.ratings, text.getvalue())
    return len(rows)


def read_judgements(folder: Path, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """Read the completed judgements of one participant."""
    journals = list_journals(folder)
    # Who withdrew has no ratings, even while the removal is not finished or a copy has come back.
    if not journals or (folder / TOMBSTONE_FILE).exists():
        return []
    plan = require_own_plan(folder)
    if plan.stimuli_sha256 != stimuli.sha256:
        raise ValueError(
            f"{folder}: was planned with stimulus set {plan.stimuli_sha256[:12]}, the study holds "
            f"{stimuli.sha256[:12]}; build the set of that session again"
        )
    codes = list_codes(stimuli, seed=plan.seed)
    by_code = {codes[row.stimulus_id]: row for row in stimuli.stimuli}
    rows = []
    for path in journals:
        records = read_journal(path).records
        if header := find_header(records):
            with read_as_written(path):
                require_own(path, header, plan)
                rows += [
                    _name_row(row, header, by_code) for row in _replay(plan, records, path=path)
                ]
    return rows


def require_own(path: Path, header: Mapping[str, Any], plan: Plan) -> None:
    """Refuse a journal that was written elsewhere, or to another plan than the one beside it."""
    if (header["participant"], name_journal(header["session"])) != (path.parent.name, path.name):
        raise ValueError(
            f"{path}: is session {header['session']} of {header['participant']!r}, it was copied here; "
            "move the copy out of sessions/"
        )
    if header["plan_sha256"] != plan.sha256:
        raise ValueError(
            f"{path}: was begun with another plan than the one beside it; restore that from a copy"
        )


def _name_row(
    row: dict[str, Any], header: Mapping[str, Any], by_code: Mapping[str, Stimulus]
) -> dict[str, Any]:
    """Put names for codes: what was blind is told here and nowhere before."""
    stimulus, reference = by_code[row["stimulus_id"]], by_code.get(row["reference_id"])
    return row | {
        "participant": header["participant"],
        "session": header["session"],
        "stimulus_id": stimulus.stimulus_id,
        "recording": stimulus.recording,
        "reducer": stimulus.reducer,
        "level": stimulus.level,
        "reference_id": reference.stimulus_id if reference else row["reference_id"],
        "simulated": _write_flag(header["presenter"]["simulated"]),
    }


def _replay(plan: Plan, records: Sequence[Record], *, path: Path) -> list[dict[str, Any]]:
    """List what the columns of each judgement owe to its own events."""
    trials = {trial.number: trial for trial in plan.trials}
    superseded = has_event(records, "superseded")
    rows: list[dict[str, Any]] = []
    playbacks: list[Mapping[str, Any]] = []
    for record in records:
        match record.event:
            case "shown":
                playbacks = []
            case "played":
                playbacks.append(record.data)
            case "rated" if (trial := trials[record.data["trial"]]).phase == "main":
                _require_played(trial, playbacks, where=f"{path}, line {record.sequence + 1}")
                rows += _judge(trial, record.data, playbacks, superseded=superseded)
    return sorted(rows, key=lambda row: row["trial"])


def _require_played(trial: Trial, playbacks: Iterable[Mapping[str, Any]], *, where: str) -> None:
    played = {playback["part"] for playback in playbacks if playback["completed"]}
    if missing := [
        judgement.part for judgement in trial.judgements if judgement.part not in played
    ]:
        raise ValueError(
            f"{where}: trial {trial.number} is rated, but {', '.join(missing)} was not played since it was shown; "
            "restore the file from a copy"
        )


def _judge(
    trial: Trial,
    rated: Mapping[str, Any],
    playbacks: Sequence[Mapping[str, Any]],
    *,
    superseded: bool,
) -> Iterator[dict[str, Any]]:
    points = score_trial(trial, rated["values"])
    onsets = {
        playback["part"]: playback["onset_s"] for playback in playbacks if playback["completed"]
    }
    for judgement in trial.judgements:
        yield {
            "protocol": trial.protocol,
            "block": trial.block,
            "trial": trial.number,
            "repeat": trial.repeat,
            "stimulus_id": judgement.stimulus_id,
            "reference_id": judgement.reference_id,
            "scale": trial.scale,
            "rating": points[judgement.part],
            "response_time_s": rated["response_time_s"],
            "onset_s": onsets[judgement.part],
            "underruns": sum(playback["underruns"] for playback in playbacks),
            "rejected": _write_flag(rated["rejected"] or superseded),
        }


def _write_flag(flag: bool) -> str:  # noqa: FBT001 - the flag is the value, not an option
    return "true" if flag else "false"
