"""`ratings.csv`: one row per completed judgement, derived from the journals and from nothing else.

It may be deleted at any time: it is written anew, byte for byte the same, from what the journals hold.
"""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

from study.files import write_text
from study.journal import read_journal
from study.session import find_header, name_journal

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping
    from pathlib import Path

    from stimuli.manifest import StimulusSet
    from study.chain import Record
    from study.folder import StudyFolder

COLUMNS = (
    "participant",
    "session",
    "protocol",
    "block",
    "trial",
    "repeat",
    "stimulus_id",
    "recording",
    "reducer",
    "level",
    "reference_id",
    "scale",
    "rating",
    "response_time_s",
    "onset_s",
    "underruns",
    "rejected",
    "simulated",
)
"""The table's columns, in order."""

TRIAL_COLUMNS = ("protocol", "block", "repeat", "stimulus_id", "reference_id", "scale")
"""Those that stand in the plan under the same name."""


def write_ratings(study: StudyFolder, stimuli: StimulusSet) -> int:
    """Write all completed judgements of a study, of unfinished sessions too.

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
        If a journal is broken or was written with another stimulus set.
    """
    rows = [row for path in study.journals for row in read_judgements(path, stimuli)]
    text = io.StringIO(newline="")
    table = csv.DictWriter(text, COLUMNS)
    table.writeheader()
    table.writerows(rows)
    write_text(study.ratings, text.getvalue())
    return len(rows)


def read_judgements(path: Path, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """Read the completed judgements of one session.

    Parameters
    ----------
    path : Path
        The session's journal.
    stimuli : StimulusSet
        The set that was judged.

    Returns
    -------
    list of dict
        One row of the table per judgement, in the order of the trials.

    Raises
    ------
    ValueError
        If the journal is broken, lies elsewhere than it was written, or was written with another stimulus set.
    """
    records = read_journal(path).records
    header = find_header(records)
    if header is None:
        return []  # Broken off before it began.
    if header["stimuli_sha256"] != stimuli.sha256:
        raise ValueError(
            f"{path}: was written with stimulus set {header['stimuli_sha256'][:12]}, the folder holds "
            f"{stimuli.sha256[:12]}; build the set of that session again"
        )
    if (header["participant"], name_journal(header["session"])) != (path.parent.name, path.name):
        raise ValueError(
            f"{path}: is session {header['session']} of {header['participant']!r}, it was copied here; "
            "move the copy out of sessions/"
        )
    by_id = {stimulus.stimulus_id: stimulus for stimulus in stimuli.stimuli}
    rows = []
    for judgement in _replay(records):
        stimulus = by_id[judgement["stimulus_id"]]
        rows.append(
            {
                "participant": header["participant"],
                "session": header["session"],
                "recording": stimulus.recording,
                "reducer": stimulus.reducer,
                "level": stimulus.level,
                "simulated": _write_flag(header["presenter"]["simulated"]),
                **judgement,
            }
        )
    return sorted(rows, key=lambda row: row["trial"])


def _replay(records: Iterable[Record]) -> Iterator[dict[str, Any]]:
    """Yield what the columns of each judgement owe to its own events."""
    trial: dict[str, Any] = {}
    playbacks: list[Mapping[str, Any]] = []
    for record in records:
        match record.event:
            case "shown":
                trial, playbacks = dict(record.data), []
            case "played":
                playbacks.append(record.data)
            case "rated":
                tests = [playback for playback in playbacks if playback["part"] == "test"]
                yield {
                    **{name: trial[name] for name in TRIAL_COLUMNS},
                    "trial": trial["number"],
                    "rating": record.data["rating"],
                    "response_time_s": record.data["response_time_s"],
                    "onset_s": tests[-1]["onset_s"],
                    "underruns": sum(playback["underruns"] for playback in playbacks),
                    "rejected": _write_flag(record.data["rejected"]),
                }


def _write_flag(flag: bool) -> str:  # noqa: FBT001 - the flag is the value, not an option
    return "true" if flag else "false"
