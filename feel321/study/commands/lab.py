"""Verbs that run sessions and look after them: run, simulate, status, note, collect, withdraw."""

import sys
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, Participant, Rehearsals, Seed, within

if TYPE_CHECKING:
    from feel321.study.session.ports import Place


def run(  # noqa: PLR0913 - one parameter per option
    study: File = Path(),
    /,
    *,
    participant: Participant,
    windowed: bool = False,
    screen: Annotated[int, within(0, 99)] = 0,
    device: Annotated[str | None, Parameter(metavar="NAME")] = None,
    accept_rig: bool = False,
    lsl: bool = False,
    rehearse: bool = False,
    simulated: Annotated[bool, Parameter(name="--simulate-participant")] = False,
    seed: Seed = None,
) -> int:
    """Run a session with a participant, or resume it.

    Example: feel321 run my-study --participant p07

    Parameters
    ----------
    windowed
        A window instead of the whole screen.
    screen
        The participant's monitor; 0: the main one.
    device
        Device instead of the rig's; 'file' writes WAV files.
    accept_rig
        Resume on a changed rig or certificate; the journal records it.
    lsl
        Send events to the lab streaming layer.
    rehearse
        Stored in rehearsals/ and never analysed.
    simulated
        A simulated participant presses the keys.
    """
    if seed is not None and not simulated:
        shared.refuse_use("--seed needs --simulate-participant; people have no seed")
    from feel321.study.lab import Visit, run_participant

    opened = shared.open_study(study)
    visit = Visit(
        participant,
        windowed=windowed,
        screen=screen,
        device=device,
        simulated=simulated,
        seed=seed,
        accept_rig=accept_rig,
        lsl=lsl,
    )
    folder = replace(opened.folder, is_rehearsal=rehearse)
    log = SessionLog(participant, folder.rig)
    try:
        outcome = run_participant(folder, visit, now=opened.now, on_step=log.note, warn=shared.warn)
    except (Exception, KeyboardInterrupt) as error:
        log.end(type(error).__name__)
        raise
    log.end(outcome.stopped)
    if outcome.stopped:
        return 1
    shared.echo(f"{participant}: all {outcome.total} done")
    return 0


LINE = 60  # characters of the line that says what is left; it is overwritten by the next


@dataclass(slots=True)
class SessionLog:
    """Prints how far the session is, and how to resume it."""

    participant: str
    rig: Path
    place: "Place | None" = None

    def note(self, place: "Place") -> None:
        """Print where the session is now."""
        done = f"{self.participant}: {place.done} of {place.total} done"
        if self.place is None:
            shared.echo(f"{done} so far")
        self.place = place
        if place.fault:
            from feel321.study.actuator.rig import read_rig
            from feel321.study.keys import label_key

            key = label_key(read_rig(self.rig).keys.find_key("experimenter"), {})
            begin = "\n" if shared.is_terminal() else ""
            failed = f"{begin}{self.participant}: the device failed ({place.fault}); check it"
            shared.echo(f"{failed}, then press {key} in the participant's window", err=True)
        elif shared.is_terminal():
            minutes = "" if place.left_s is None else f", about {place.left_s / 60:.0f} min left"
            shared.echo(f"{done + minutes:<{LINE}}", over=True, err=True)

    def end(self, reason: str) -> None:
        """Leave what was left as it stands; where something ended the session, say how to resume it."""
        if self.place is not None and shared.is_terminal():
            shared.echo(err=True)
        if self.place is not None and reason:
            # A change of the rig is accepted only once.
            words = [word for word in shared.CALL.get().words if word != "--accept-rig"]
            done = f"{self.place.done} of {self.place.total} done (aborted: {reason})"
            command = join(["feel321", *words])
            shared.echo(f"{self.participant}: {done}; resume with: {command}", err=True)


def simulate(
    study: File = Path(),
    /,
    *,
    participants: Annotated[int, within(1, 10_000)] = 16,
    seed: Seed = None,
    as_json: Json = False,
) -> None:
    """Run sessions with simulated participants, or resume them.

    Example: feel321 simulate my-study --participants 16 --seed 1

    Parameters
    ----------
    participants
        Number of simulated participants.
    """
    from feel321.study.simulation import regress_planted

    opened = shared.open_study(study)
    rows = opened.simulate_sessions(participants, seed)
    planted = regress_planted(opened.settings, opened.stimuli())
    file = str(opened.folder.ratings)
    facts: dict[str, object] = {"participants": participants, "ratings": rows, "file": file}
    facts |= {"planted_reducers": planted.reducers} if planted.reducers else {}
    terms = [f"{slope:.2f} per +0.1 of {metric}" for metric, slope in planted.slopes.items()]
    terms += [f"{points:+.1f} for {reducer}" for reducer, points in planted.reducers.items()]
    said = f"planted in realism, in points: {', '.join(terms)}"
    more = "planted: more than the two matches"
    lines = [f"{file}: {rows} ratings", said if terms else more]
    shared.print_facts(facts | {"planted": planted.slopes}, lines, as_json=as_json)


def status(
    study: File = Path(),
    /,
    *,
    with_notes: Annotated[bool, Parameter(name="--notes")] = False,
    page: Annotated[File | None, Parameter(name="--watch", metavar="PAGE")] = None,
    rehearsals: Rehearsals = False,
    as_json: Json = False,
) -> None:
    """Show the progress of every participant.

    Example: feel321 status my-study
             feel321 status my-study --watch sessions.html

    Parameters
    ----------
    with_notes
        Also the experimenter's notes.
    page
        Keep a blind page of running sessions until Ctrl-C.
    """
    opened = shared.open_study(study, rehearsals=rehearsals, clears=False)
    if page is not None:
        from feel321.study.watch import watch_study

        if with_notes or as_json:
            shared.refuse_use("--watch does not go with --notes or --json; leave them out")
        with shared.recording(opened.folder, "status", page):
            watch_study(opened.folder, page, now=opened.now, announce=shared.echo)
        shared.echo("status: ended", err=True)
        return
    state = opened.status()
    notes = state.list_notes() if with_notes else []
    shared.print_facts(asdict(state), [state.summary(), *notes], as_json=as_json)


def note(
    *study_text: Annotated[str, Parameter(name="[STUDY] TEXT")],
    participant: Participant,
    rehearsals: Rehearsals = False,
) -> None:
    """Write an experimenter's note into a participant's journal.

    One line between two openings of a session or after its end, never while it runs. It is kept like all that was
    recorded: never edited, removed only by withdraw, and it changes the seal of audit. Write no names. Shown by
    status --notes.

    Example: feel321 note my-study --participant p07 "left coil rattled in block 2"
    """
    from feel321.study.persons.withdrawal import take_note

    study, text = shared.split_study(study_text, "one text in quotes")
    opened = shared.open_study(Path(study or "."), rehearsals=rehearsals)
    if notice := take_note(opened.folder, participant, text, now=opened.now):
        shared.warn(notice)
    shared.echo(f"{participant}: noted")


def collect(
    *sources: Annotated[File, Parameter(name="FROM...")],
    folder: Annotated[File, Parameter(name="--into", metavar="STUDY")] = Path(),
    as_json: Json = False,
) -> int:
    """Collect the sessions of other stations into one study.

    FROM are study folders, mounted or copied; they are only read. Plans, journals and what was delivered are
    verified before and after the copy; a longer journal takes the place of one that it continues. Sessions that
    conflict with the study are refused by name; nothing is overwritten. If interrupted, run it again; a second run
    copies nothing. A participant who withdrew at one station is withdrawn here.

    Example: feel321 collect /mnt/lab2/my-study /media/usb/my-study --into my-study

    Parameters
    ----------
    folder
        The study to collect into.  [default: .]
    """
    from feel321.study.collect import collect_sessions

    if not sources:
        shared.refuse_use("name the study folders to collect from")
    opened = shared.open_study(folder)
    with shared.show_progress("collect") as progress:
        found = collect_sessions(opened.folder, sources, now=opened.now, follow=progress)
    size, who = f"{found.size / 1e6:.1f} MB", ", ".join(found.participants)
    copied = f"{found.files} files ({size}) of {who}" if found.files else "nothing to copy"
    refused = [f"refused: {line}" for line in found.refused]
    shared.print_facts(
        asdict(found), [f"{folder}: {copied}", *refused, *found.notes], as_json=as_json
    )
    return 1 if found.refused else 0


def withdraw(
    study: File = Path(),
    /,
    *,
    participant: Participant,
    reason: str = "",
    keep_data: bool = False,
    is_sure: Annotated[bool, Parameter(name="--yes")] = False,
) -> int:
    """Remove the data of a participant for good, and free the design slot.

    Data go from sessions, rehearsals, tables and results; outputs elsewhere are listed, to be removed by hand. The code
    is not reused. --keep-data, for somebody who will not return: what was recorded stays, the next participant gets the
    slot.

    Example: feel321 withdraw my-study --participant p07 --yes
             feel321 withdraw my-study --participant p07 --keep-data

    Parameters
    ----------
    reason
        Kept with the code; write no name.
    keep_data
        Only free the design slot.
    is_sure
        Do not ask.
    """
    from feel321.study.persons.withdrawal import release_participant, withdraw_participant

    opened = shared.open_study(study)
    folder = opened.folder
    if keep_data:
        number = release_participant(folder, participant, now=opened.now)
        shared.echo(f"{folder.path}: {participant} is released, number {number} is free")
        return 0
    if not is_sure:
        if not sys.stdin.isatty():
            shared.refuse_use("no terminal to ask for confirmation; add --yes")
        question = f"Remove all data of {participant} in {folder.path} for good? [y/N]: "
        shared.echo(question, err=True)
        if sys.stdin.readline().strip().lower() not in {"y", "yes"}:
            shared.echo(f"{folder.path}: nothing was removed")
            return 1
    removed = withdraw_participant(
        folder, participant, now=opened.now, reason=reason, warn=shared.warn
    )
    place = folder.sessions / participant
    kept = "; a tombstone keeps the code" if place.exists() else ""
    shared.echo(
        f"{folder.path}: removed {len(removed)} files of {participant}{kept}. "
        "Copies that feel321 did not make must be removed by hand"
    )
    return 0
