"""Progress of every participant, and balance of the design as it was run: as a table, or as a page that renews itself.

Both are blind: no ratings and no names of conditions. Journals are only read.
"""

from __future__ import annotations

import time
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import asdict, dataclass, fields, replace
from datetime import datetime
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.files import is_held, write_text
from feel321.protocols.agenda import SECONDS
from feel321.protocols.order import TASK_ORDERS, measure_balance
from feel321.protocols.tasks import find_other, is_as_expected
from feel321.records import Result
from feel321.stimuli.sets.manifest import read_stimuli
from feel321.study import minutes
from feel321.study.participants.roster import LOCK_FILE, Progress, describe_rigs, make_progress
from feel321.study.session import events
from feel321.study.session.journal import Records
from feel321.study.session.plan import TOMBSTONE_FILE, Dossier, Plan, read_as_written
from feel321.study.terminal import echo
from feel321.study.thresholds import find_warnings, read_thresholds

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from pandas import DataFrame

    from feel321.protocols.trial import Trial
    from feel321.study.folder import StudyFolder
    from feel321.study.session.journal import Chain, Clock

    # What was derived of each participant, and the trials that count for the balance; kept while no file changes.
    Known = dict[Path, tuple[Dossier, Progress, list[Trial]]]

CALLED = "called"  # state of a session whose device failed until the experimenter comes
GOING_ON = {"claimed", "running", "aborted", CALLED}  # states of those who have something left

STATES = (CALLED, "", "running", "aborted", "claimed", "finished", "released", "withdrawn")
"""States, those first that somebody should look at; without one, files cannot be read."""

CALLED_FOR = "last called for: "  # begins a warning with words of the device, which are not blind
EVERY_S = 5.0  # how often the page is renewed, and how often a browser reads it again
OWN_PAGE = '<meta name="generator" content="feel321 status --watch">'  # marks pages of this module


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Status(Result):
    """Progress of a study; frozen: whether its choices are, in a line; shows_notes: in its summary.

    balance: of all sessions so far, drop-outs and second attempts included; by task, how often conditions met positions
    and each other, the least and the most.
    """

    participants: tuple[Progress, ...]
    balance: Mapping[str, Any] | None
    length: minutes.Length | None = None
    frozen: str = ""
    shows_notes: bool = False

    def to_frame(self) -> DataFrame:
        """Return one row per participant."""
        import pandas as pd

        columns = [field.name for field in fields(Progress)]
        return pd.DataFrame([asdict(entry) for entry in self.participants], columns=columns)

    def summary(self) -> str:
        """Write what `feel321 status` prints."""
        form = "{:<14}{:<11}{:>9}{:>9}{:>5}{:>5}  {}"
        head = ("participant", "state", "answered", "given up", "left", "min", "last activity")
        lines = [form.format(*head)]
        for one in self.participants:
            groups = ", ".join(f"{factor}={level}" for factor, level in one.groups.items())
            notes = "; ".join(filter(None, ["simulated" if one.simulated else "", groups]))
            tail = one.last_activity + f" ({notes})" * bool(notes)
            left = "" if one.left_min is None else f"{one.left_min:.0f}"
            row: tuple[object, ...] = (one.state, one.answered, one.given_up, one.left, left, tail)
            row = ("?", "?", "?", "?", "", one.problem) if one.problem else row
            lines.append(form.format(one.participant, *row).rstrip())
            lines += [f"{'':<14}{warning}" for warning in one.warnings]
        length = [] if self.length is None else [self.length.describe()]
        lines += [*describe_rigs(self.participants), *length, *filter(None, [self.frozen])]
        lines += describe_balance(self.balance)
        if self.shows_notes:
            taken = [(one.participant, note) for one in self.participants for note in one.notes]
            said = [f"  {who:<12}{note.utc}  {note.text}" for who, note in taken]
            lines += ["notes:", *said] if said else ["notes: none"]
        return "\n".join(lines)

    def __repr__(self) -> str:
        """Count the participants in each state."""
        counts = Counter(entry.state or "unreadable" for entry in self.participants)
        states = ", ".join(f"{count} {state}" for state, count in counts.items())
        return f"Status({states or 'no participants'})"


def look(
    study: StudyFolder,
    known: Known,
    progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> tuple[list[Progress], minutes.Length | None]:
    """Read the progress of everybody, and how long sessions take, where there is a stimulus set; known: is updated."""
    folders = study.participants
    entries = dict[Path, Progress]()
    for done, folder in enumerate(folders, start=1):
        entries[folder] = _read(study, folder, known)
        progress(done, len(folders))
    dossiers, length = {folder: known[folder][0] for folder in known}, None
    with suppress(OSError, ValueError):
        durations = minutes.find_durations(read_stimuli(study.stimuli))
        pace = minutes.observe_pace(dossiers.values(), durations)
        for folder, one in dossiers.items():
            if entries[folder].state in GOING_ON:
                left = minutes.find_left(one.plan, one.records, durations=durations, pace=pace)
                left_min = max(left.values()) / SECONDS
                entries[folder] = replace(entries[folder], left_min=left_min)
        plans = [one.plan for one in dossiers.values()]
        length = minutes.measure_length(plans, durations, pace) if plans else None
    return list(entries.values()), length


def _read(study: StudyFolder, folder: Path, known: Known) -> Progress:
    """Read a participant; a session that no live process writes is `aborted`, not `running`."""
    before = known.pop(folder, None)
    if (folder / TOMBSTONE_FILE).exists():
        return Progress(folder.name, state="withdrawn")
    try:
        dossier = study.read_person(folder)
        if before is None or before[0] is not dossier:
            before = dossier, *_derive(dossier)
    except (OSError, ValueError) as error:
        return Progress(folder.name, problem=str(error))
    known[folder] = before
    own, failed = before[1], events.DeviceFailed.event
    calls = [
        one.event
        for one in dossier.records
        if one.event == failed
        or (one.event == events.PageRead.event and one.data.get("key") == "call_us")
    ]
    if own.state != "released" and calls[-1:] == [failed]:
        return replace(own, state=CALLED)
    is_left = own.state == "running" and not is_held(folder / LOCK_FILE)
    return replace(own, state="aborted") if is_left else own


def read_status(
    study: StudyFolder, *, progress: Callable[[int, int], None] = lambda _done, _total: None
) -> Status:
    """Read the progress of a study, also while sessions run."""
    known: Known = {}
    entries, length = look(study, known, progress)
    run = [(dossier, trials) for dossier, _, trials in known.values()]
    return Status(tuple(entries), measure_realised(run), length)


def watch_study(study: StudyFolder, page: Path, *, now: Clock) -> None:
    """Write the page and renew it until Ctrl-C, each time whole; its last version says that it ended."""
    from feel321.study.participants.traces import recording_output

    if page.exists() and OWN_PAGE not in page.read_text(encoding="utf-8", errors="replace"):
        raise FileExistsError(
            f"{page}: exists and is no page of status --watch, so it is not overwritten; choose another name"
        )
    known: Known = {}
    with recording_output(study, "status", page, now=now):
        write_text(page, write_page(study, known, now()), private=True)
        echo(page, err=True)
        with suppress(KeyboardInterrupt):
            while True:
                time.sleep(EVERY_S)
                write_text(page, write_page(study, known, now()), private=True)
        write_text(page, write_page(study, known, now(), is_over=True), private=True)


def write_page(study: StudyFolder, known: Known, now: datetime, *, is_over: bool = False) -> str:
    """Write the page; nothing that was written in free words is shown."""
    from feel321.analysis.words import render_template

    rows: list[dict[str, Any]] = []
    for one in sorted(look(study, known)[0], key=lambda one: STATES.index(one.state)):
        warnings = [text for text in one.warnings if not text.startswith(CALLED_FOR)]
        quiet_min = None
        if one.state in GOING_ON and one.last_activity:
            quiet = now - datetime.fromisoformat(one.last_activity)
            quiet_min = max(0.0, quiet.total_seconds() / 60)
        rows.append({"own": one, "warnings": warnings, "quiet_min": quiet_min})
    return render_template(
        "watch.html",
        study=study.path.resolve().name,
        is_rehearsal=study.is_rehearsal,
        now=now.astimezone(),
        every_s=None if is_over else EVERY_S,
        rows=rows,
    )


# What is derived of one participant.


def _derive(dossier: Dossier) -> tuple[Progress, list[Trial]]:
    """Derive the progress of a participant, and the trials that count for the balance."""
    own, warnings = make_progress(dossier), list[str]()
    trials = {trial.number: trial for trial in dossier.plan.trials if trial.phase == "main"}
    with read_as_written(dossier.newest):
        found = dossier.records.find(events.TrialRated)
        rated = [
            (trials[one.trial], one) for one in found if one.trial in trials and not one.rejected
        ]
        if dossier.chains:
            warnings += find_flags(dossier.chains[-1])
            warnings += find_warnings(read_thresholds(dossier.plan, dossier.records))
        answers = [is_as_expected(trial, one.values) for trial, one in rated if trial.catch]
    if missed := answers.count(False):
        checked = sum(answer is not None for answer in answers)
        warnings.append(f"{missed} of {checked} catch trials not as expected")
    return replace(own, warnings=tuple(warnings)), [trial for trial, _ in rated]


def find_flags(chain: Chain) -> Iterator[str]:
    """List what went wrong in a session, without looking at any answer."""
    if chain.torn:
        yield f"{len(chain.torn)} bytes of an unfinished line, moved aside on resuming"
    counts = Counter(flag for record in chain.records for flag in record.data.get("flags", ()))
    yield from (f"{count} x {flag.replace('_', ' ')}" for flag, count in counts.items())
    if any(page.key == "training_failed" for page in chain.records.find(events.PageRead)):
        yield "training not passed"
    if calls := list(chain.records.find(events.DeviceFailed)):
        yield f"experimenter called: {len(calls)} x"
        yield f"{CALLED_FOR}{calls[-1].reason}"
    noticed = Records(record for record in chain.records if record.data.get("notice"))
    for said in events.find_notices(noticed.find(events.PartPlayed)).values():
        yield f"{len(said)} x {said[0]}"


def measure_realised(everybody: Iterable[tuple[Dossier, list[Trial]]]) -> dict[str, Any] | None:
    """Measure the balance of the trials that counted, of real participants if there are any."""
    begun = [(dossier, trials) for dossier, trials in everybody if trials]
    simulated = all(dossier.plan.simulated for dossier, _ in begun)
    run = [(dossier, trials) for dossier, trials in begun if dossier.plan.simulated == simulated]
    if not run:
        return None
    groups: dict[tuple[str, str], dict[tuple[str, ...], list[list[str]]]]
    groups = defaultdict(lambda: defaultdict(list))
    for dossier, trials in run:
        for task, what, among, conditions in _split(dossier.plan, trials):
            groups[task, what][among].append(conditions)
    evenness = []
    for (task, what), sequences in groups.items():
        positions, carry_over = measure_balance(sequences.values())
        own = {"task": task, "what": what, "positions": positions, "carry_over": carry_over}
        evenness.append(own)
    over = [one.records for one, _ in run if one.records.has(events.SessionFinished)]
    finished = sum(not records.has(events.SessionReleased) for records in over)
    counted = {"simulated": simulated, "participants": len(run), "finished": finished}
    return {**counted, "evenness": evenness}


def describe_balance(realised: Mapping[str, Any] | None) -> list[str]:
    """Describe the balance of a study so far."""
    if realised is None:
        return ["balance: no trial was run yet"]
    who = " (simulated)" if realised["simulated"] else ""
    lines = [f"balance: {realised['finished']} finished{who}"]
    for one in realised["evenness"]:
        places, neighbours = ("{} to {}".format(*one[ends]) for ends in ("positions", "carry_over"))
        counts = f"{places} at each position, {neighbours} after each other"
        lines.append(f"  {one['task']}, {one['what']}: {counts}")
    return lines


def _split(
    plan: Plan, trials: Sequence[Trial]
) -> Iterator[tuple[str, str, tuple[str, ...], list[str]]]:
    """Yield task (or `session`), what was put in order, among which, and the order that it was run in."""
    if plan.task_order != TASK_ORDERS[0] and len(plan.tasks) > 1:
        among = tuple(sorted(task.protocol for task in plan.tasks))
        yield "session", "tasks", among, list(dict.fromkeys(trial.protocol for trial in trials))
    planned: dict[int, list[Trial]] = defaultdict(list)
    run: dict[int, list[Trial]] = defaultdict(list)
    recordings = defaultdict[str, set[str]](set)
    for trial in plan.trials:
        recordings[trial.protocol].add(trial.recording)
        if trial.phase == "main":
            planned[trial.block].append(trial)
    for trial in trials:  # a second attempt may come after other blocks, it is the last of its own
        run[trial.block].append(trial)
    for block, own in run.items():
        if len({judgement.part for judgement in own[0].judgements}) == 1:
            # Only what was planned together can meet.
            among = tuple(sorted(map(_name_condition, planned[block])))
            yield own[0].protocol, "stimuli", among, [_name_condition(trial) for trial in own]
    heads = [own[0] for own in run.values() if len({trial.recording for trial in own}) == 1]
    for (task, _), turn in groupby(heads, key=lambda trial: (trial.protocol, trial.repeat)):
        order = [head.recording for head in turn]
        yield task, "recordings", tuple(sorted(recordings[task])), order


def _name_condition(trial: Trial) -> str:
    """Name the two stimuli that are compared, whichever comes first."""
    about = trial.judgements[0]
    other = find_other(trial, about) or about.reference_id or about.stimulus_id
    return "|".join(sorted({about.stimulus_id, other}))
