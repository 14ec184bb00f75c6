"""Tables derived from the journals and from nothing else: `ratings.csv` and `matches.csv`.

`ratings.csv` has one row per completed judgement. Each may be deleted at any time: it is written anew, byte for byte
the same, from what the journals hold.

`matches.csv` has one row per stimulus that was matched in strength. `offset_db` says how much stronger than in the
study it had to be played to be as strong as the recording itself; 0 where the study's levels are right. Of each reducer
it is averaged over a participant's recordings, then over participants; the interval is Student's, over participants.

`data/*.csv` has one file per participant and one row per trial, in the columns that PsychoPy's users know.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from statistics import fmean, stdev
from typing import Any

from feel321.files import make_folder, write_table
from feel321.protocols.tasks import find_other, score_trial
from feel321.protocols.threshold import SECOND, Matching
from feel321.protocols.trial import MATCHING, Trial
from feel321.stimuli.sets.manifest import Stimulus, StimulusSet
from feel321.study.folder import RATING_COLUMNS, StudyFolder
from feel321.study.session import events
from feel321.study.session.journal import Records, list_journals, name_journal
from feel321.study.session.plan import Dossier, Plan, list_by_code, read_as_written
from feel321.study.thresholds import find_own_levels
from feel321.types import MATCHES

MATCHES_FILE = "matches.csv"
MATCH_COLUMNS = (
    "participant", "trial", "stimulus_id", "recording", "reducer", "level", "offset_db",
)  # fmt: skip

_BY_TRIAL = itemgetter("trial")
_KINDS = {kind.event for kind in (events.TrialShown, events.PartPlayed, events.TrialRated)}


def write_ratings(study: StudyFolder, stimuli: StimulusSet) -> int:
    """Write and count all judgements of the main trials; of a bad attempt, or a session begun anew, as rejected."""
    rows = [row for one in study.read_people() for row in list_judgements(one, stimuli)]
    study.write_table(study.ratings.name, RATING_COLUMNS, rows)
    write_wide(study.path, rows)
    return len(rows)


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
            own = sorted(_decode_judgements(header, plan, chain.records, path=path), key=_BY_TRIAL)
            for row in own:
                others = {name: by_code.get(row[name]) for name in ("reference_id", "other_id")}
                row.update({name: one.stimulus_id for name, one in others.items() if one})
                row.update(_describe_stimulus(by_code[row["stimulus_id"]]))
                row["sensation_level_db"] = levels.get(row["stimulus_id"], "")
            rows += own
    return rows


def _describe_stimulus(stimulus: Stimulus) -> dict[str, Any]:
    names = ("stimulus_id", "recording", "reducer", "level")
    return {name: getattr(stimulus, name) for name in names}


def find_misplaced(path: Path, header: events.SessionBegun, plan: Plan) -> Iterator[str]:
    """Find whether a journal was written elsewhere, or to another plan than the one beside it."""
    if (header.participant, name_journal(header.session)) != (plan.participant, path.name):
        yield f": is session {header.session} of {header.participant!r}, it was copied here"
    if header.plan_sha256 != plan.sha256:
        yield ": was begun with another plan than the one beside it"


def _decode_judgements(
    header: events.SessionBegun, plan: Plan, records: Records, *, path: Path
) -> Iterator[dict[str, Any]]:
    """Decode the completed judgements of a journal, as they were made; stimuli keep their codes."""
    trials = {trial.number: trial for trial in plan.trials}
    superseded = records.has(events.SessionSuperseded)
    played: list[events.PartPlayed] = []
    for record in (one for one in records if one.event in _KINDS):
        match record.content:
            case events.TrialShown():
                played = []
            case events.PartPlayed() as part:
                played.append(part)
            case events.TrialRated() as rated if (trial := trials[rated.trial]).phase == "main":
                felt = {part.part: part for part in played if part.completed}
                if missing := [one.part for one in trial.judgements if one.part not in felt]:
                    named = ", ".join(dict.fromkeys(missing))
                    raise ValueError(
                        f"{path}, line {record.sequence + 1}: trial {trial.number} is rated, but {named} was not "
                        "played since it was shown; restore the file from a copy"
                    )
                facts = {
                    "participant": header.participant,
                    "session": header.session,
                    "simulated": str(bool(header.identity["presenter"]["simulated"])).lower(),
                    "underruns": sum(part.underruns for part in played),
                    "rejected": str(rated.rejected or superseded).lower(),
                    "response_time_s": rated.response_time_s,
                }
                yield from (facts | row for row in _judge(trial, rated, felt))


def _judge(
    trial: Trial, rated: events.TrialRated, felt: Mapping[str, events.PartPlayed]
) -> Iterator[dict[str, Any]]:
    """Describe each judgement of a trial, what the hand got of its playback included."""
    points = score_trial(trial, rated.values)
    for judgement in trial.judgements:
        got = felt[judgement.part].delivered
        source = "sensor" if "coherence" in got else "certificate"  # only a sensor gives one
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
            **{f"{name}_delivered": got.get(name, "") for name in MATCHES},
            "level_error_db": got.get("level_error_db", ""),
            "delivered_by": source if got else "",
            "other_id": find_other(trial, judgement),
        }


# Strength as participants matched it, and what it says of stimuli that should be equally strong.


def write_matches(study: StudyFolder, stimuli: StimulusSet) -> list[dict[str, Any]]:
    """Write all matches of a study, if it has or had any, and return them."""
    rows = [row for one in study.read_people() for row in list_matches(one, stimuli)]
    study.write_table(MATCHES_FILE, MATCH_COLUMNS, rows, is_optional=True)
    return rows


def list_matches(dossier: Dossier, stimuli: StimulusSet) -> Iterator[dict[str, Any]]:
    """List the matches of one participant that count, from the newest journal."""
    plan = dossier.plan
    if plan.matching is None:
        return
    matching, by_code = Matching(plan.matching, plan.trials), list_by_code(stimuli, seed=plan.seed)
    trials = {trial.number: trial for trial in plan.trials if trial.phase == MATCHING}
    for rated in dossier.records.find(events.TrialRated):
        if rated.trial not in trials or rated.rejected:
            continue
        stimulus = by_code[trials[rated.trial].judgements[0].stimulus_id]
        offset_db = matching.find_offset(rated.trial, float(rated.values[SECOND]))
        row = {"participant": plan.participant, "trial": rated.trial}
        yield row | _describe_stimulus(stimulus) | {"offset_db": round(offset_db, 3)}


def describe_matches(rows: Iterable[Mapping[str, Any]]) -> list[str]:
    """Describe in one note how well strength was matched; nothing where it was not asked."""
    from scipy.stats import t

    own: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for row in rows:
        own[row["reducer"]][row["participant"]].append(row["offset_db"])
    offsets = []
    for reducer in sorted(own):
        means = [fmean(offsets) for offsets in own[reducer].values()]
        n, mean, interval = len(means), fmean(means), ""
        if n > 1:
            half = float(t.ppf(0.975, n - 1)) * stdev(means) / math.sqrt(n)
            interval = f" ({mean - half:+.1f} to {mean + half:+.1f})"
        offsets.append(f"{reducer} {mean:+.1f} dB{interval}")
    if not offsets:
        return []
    n = max(map(len, own.values()))
    return [
        f"Strength matched by {n} participant{'s' * (n != 1)}: to feel as strong as the recording itself, stimuli had "
        f"to be played stronger by (95 % interval over participants) {', '.join(offsets)}. 0 dB means that the study's "
        "levels are right; 'original' is the recording matched with itself."
    ]


WIDE = "data"  # folder of the files, in a study's

ONCE = {  # column of a judgement -> column of a trial
    "participant": "participant", "session": "session", "protocol": "trials.protocol", "block": "trials.block",
    "trial": "trials.thisN", "repeat": "trials.thisRepN", "response_time_s": "response.rt", "underruns": "underruns",
    "rejected": "rejected", "simulated": "simulated",
}  # fmt: skip

EACH = {  # column of a judgement -> column of each judgement in a trial, which ends in its number
    "stimulus_id": "stimulus", "recording": "recording", "reducer": "reducer", "level": "level",
    "reference_id": "reference", "scale": "scale", "rating": "response", "onset_s": "started",
}  # fmt: skip


def write_wide(study: Path, rows: Iterable[Mapping[str, Any]]) -> None:
    """Write the trials of each participant, and remove the files of those who are no longer there."""
    folder = study / WIDE
    people = {name: list(own) for name, own in groupby(rows, itemgetter("participant"))}
    own_start = ",".join(ONCE.values()).encode()
    foreign = set()  # a recording, or a table of the lab's own, that lies here is left
    for path in folder.glob("*.csv"):
        if not path.read_bytes().startswith(own_start):
            foreign.add(path.stem)
        elif path.stem not in people:
            path.unlink()  # of nobody here
    if people:
        make_folder(folder, private=True)
    if taken := sorted(foreign & people.keys()):
        raise FileExistsError(f"{folder / taken[0]}.csv: is not feel321's; move it away")
    for name, own in people.items():
        key = itemgetter("session", "trial", "response_time_s")
        trials = [list(one) for _, one in groupby(own, key)]
        numbers = range(1, max(map(len, trials)) + 1)
        columns = [*ONCE.values(), *(f"{column}_{k}" for k in numbers for column in EACH.values())]
        rows = [
            {column: one[0][name] for name, column in ONCE.items()}
            | {
                f"{column}_{n}": judged[name]
                for n, judged in enumerate(one, start=1)
                for name, column in EACH.items()
            }
            for one in trials
        ]
        write_table(folder / f"{name}.csv", columns, rows, private=True)
