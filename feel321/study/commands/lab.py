"""Verbs of the lab: sessions (run, simulate, status, note, collect, withdraw) and the rig (calibrate, doctor)."""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter

from feel321.doors import follow
from feel321.study.commands import shared
from feel321.study.commands.shared import (
    File,
    Json,
    Name,
    Participant,
    Rehearsals,
    Seed,
    about,
    within,
)
from feel321.study.folder import StudyFolder, require_study
from feel321.study.session.journal import PARTICIPANT_ID

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.mixer import Frames
    from feel321.study.actuator.rig import Rig
    from feel321.study.session.ports import Place


def run(  # noqa: PLR0913 - one parameter per option
    study: File = Path(),
    /,
    *,
    participant: Participant,
    windowed: Annotated[bool, about("A window instead of the whole screen.")] = False,
    screen: Annotated[int, within(0, 99), about("The participant's monitor; 0: the main one.")] = 0,
    device: Annotated[Name, about("Instead of the rig's; 'file' writes WAV files.")] = None,
    accept_rig: Annotated[bool, about("Resume on a changed rig or certificate; noted.")] = False,
    lsl: Annotated[bool, about("Send onsets to the lab streaming layer.")] = False,
    rehearse: Annotated[bool, about("Stored in rehearsals/ and never analysed.")] = False,
    simulate_participant: Annotated[bool, about("A simulated participant presses keys.")] = False,
    seed: Annotated[Seed, about("Of --simulate-participant; the study's by default.")] = None,
) -> int:
    """Run a session with a participant, or resume it.

    Example: feel321 run my-study --participant p07
    """
    if seed is not None and not simulate_participant:
        shared.refuse_use("--seed needs --simulate-participant; people have no seed")
    if not PARTICIPANT_ID.fullmatch(participant):
        allowed = "letters (A-Z), digits, - and _"
        shared.refuse_use(f"--participant must be {allowed}, got {participant!r}")
    from feel321.study.lab import run_participant
    from feel321.study.sessions import read_room

    opened = shared.open_study(study)
    folder = replace(opened.folder, is_rehearsal=rehearse)
    log = SessionLog(participant, folder.rig)
    try:
        outcome = run_participant(
            replace(
                read_room(folder, now=opened.now), windowed=windowed, screen=screen, device=device,
                accept_rig=accept_rig, lsl=lsl,
            ),
            participant,
            simulated=simulate_participant,
            seed=seed,
            on_step=log.note,
            warn=shared.warn,
        )  # fmt: skip
    except (Exception, KeyboardInterrupt) as error:
        log.end(type(error).__name__)
        raise
    log.end(outcome.stopped)
    if outcome.stopped:
        return 1
    shared.echo(f"{participant}: {_count(outcome)}")
    return 0


LINE = 60  # characters of the line that says what is left; it is overwritten by the next


def _count(place: "Place") -> str:
    """Count answered trials, and those that were given up apart from them."""
    gone = f", {place.given_up} given up" if place.given_up else ""
    return f"{place.answered} of {place.total} answered{gone}"


@dataclass(slots=True)
class SessionLog:
    """Prints how far the session is, and how to resume it."""

    participant: str
    rig: Path
    place: "Place | None" = None

    def note(self, place: "Place") -> None:
        """Print where the session is now."""
        done = f"{self.participant}: {_count(place)}"
        if self.place is None:
            shared.echo(f"{done} so far")
        self.place = place
        begin = "\n" if shared.is_terminal() else ""
        if place.notice:
            wrong = f"{begin}{self.participant}: look after the rig in a break ({place.notice})"
            shared.echo(f"{wrong}; what the hand gets is within tolerance, trials count", err=True)
        if place.fault:
            from feel321.study.actuator.rig import read_rig
            from feel321.study.keys import label_key

            key = label_key(read_rig(self.rig).keys.find_key("experimenter"), {})
            failed = f"{begin}{self.participant}: the device failed ({place.fault}); check it"
            shared.echo(f"{failed}, then press {key} in the participant's window", err=True)
        elif shared.is_terminal():
            minutes = "" if place.left_s is None else f", about {place.left_s / 60:.0f} min left"
            shared.echo(f"{done + minutes:<{LINE}}", over=True, err=True)

    def end(self, reason: str) -> None:
        """Leave what was left as it stands; where something ended the session, say how to resume it."""
        if self.place is None:
            return
        if shared.is_terminal():
            shared.echo(err=True)
        if reason:
            # A change of the rig is accepted only once.
            words = [word for word in shared.CALL.get().words if word != "--accept-rig"]
            done = f"{self.participant}: {_count(self.place)} (aborted: {reason})"
            shared.echo(f"{done}; resume with: {join(['feel321', *words])}", err=True)


def simulate(
    study: File = Path(),
    /,
    *,
    participants: Annotated[int, within(1, 10_000), about("How many take part.")] = 16,
    seed: Seed = None,
    as_json: Json = False,
) -> None:
    """Run sessions with simulated participants, or resume them.

    Example: feel321 simulate my-study --participants 16 --seed 1
    """
    from feel321.study.simulation import regress_planted

    opened = shared.open_study(study)
    rows = shared.simulate_sessions(opened, participants, seed)
    slopes, reducers = regress_planted(opened.settings, opened.stimuli())
    file = str(opened.folder.ratings)
    facts: dict[str, object] = {"participants": participants, "ratings": rows, "file": file}
    facts |= {"planted_reducers": reducers} if reducers else {}
    terms = [f"{slope:.2f} per +0.1 of {metric}" for metric, slope in slopes.items()]
    terms += [f"{points:+.1f} for {reducer}" for reducer, points in reducers.items()]
    said = f"in realism, in points: {', '.join(terms)}" if terms else "more than the two matches"
    lines = [f"{file}: {rows} ratings", f"planted{'' if terms else ':'} {said}"]
    shared.print_facts(facts | {"planted": slopes}, lines, as_json=as_json)


def status(
    study: File = Path(),
    /,
    *,
    notes: Annotated[bool, about("Also the experimenter's notes.")] = False,
    watch: Annotated[File | None, about("Keep a blind page until Ctrl-C.", metavar="PAGE")] = None,
    rehearsals: Rehearsals = False,
    as_json: Json = False,
) -> None:
    """Show the progress of every participant.

    Example: feel321 status my-study
             feel321 status my-study --watch sessions.html
    """
    opened = shared.open_study(study, rehearsals=rehearsals, clears=False)
    if watch is not None:
        from feel321.study.persons.withdrawal import recording_output
        from feel321.study.watch import watch_study

        if notes or as_json:
            shared.refuse_use("--watch does not go with --notes or --json; leave them out")
        with recording_output(opened.folder, "status", watch, now=opened.now):
            watch_study(opened.folder, watch, now=opened.now, announce=shared.echo)
        shared.echo("status: ended", err=True)
        return
    state = opened.status()
    said = state.list_notes() if notes else []
    shared.print_facts(asdict(state), [state.summary(), *said], as_json=as_json)


def note(
    *study_text: Annotated[str, Parameter(name="[STUDY] TEXT")],
    participant: Participant,
    rehearsals: Rehearsals = False,
    as_json: Json = False,
) -> None:
    """Write an experimenter's note into a participant's journal.

    One line, not while a session runs. It is never edited, and removed only by withdraw: write no names. Shown by
    status --notes.

    Example: feel321 note my-study --participant p07 "left coil rattled in block 2"
    """
    from feel321.study.persons.withdrawal import take_note

    study, text = shared.split_study(study_text, "one text in quotes")
    opened = shared.open_study(study, rehearsals=rehearsals)
    if notice := take_note(opened.folder, participant, text, now=opened.now):
        shared.warn(notice)
    facts = {"participant": participant, "text": text, "warning": notice}
    shared.print_facts(facts, [f"{participant}: noted"], as_json=as_json)


def collect(
    *sources: Annotated[File, Parameter(name="FROM...")],
    into: Annotated[File, about("Study to collect into. [default: .]", metavar="STUDY")] = Path(),
    as_json: Json = False,
) -> int:
    """Collect the sessions of other stations into one study.

    FROM are study folders, mounted or copied; they are only read. A longer journal takes the place of one that it
    continues; sessions that conflict with the study are refused by name. A participant who withdrew at one station is
    withdrawn here.

    Example: feel321 collect /mnt/lab2/my-study /media/usb/my-study --into my-study
    """
    from feel321.study.collect import collect_sessions

    if not sources:
        shared.refuse_use("name the study folders to collect from")
    opened = shared.open_study(into)
    with follow(shared.wants_bar(), "collect") as progress:
        found = collect_sessions(opened.folder, sources, now=opened.now, follow=progress)
    size, who = f"{found.size / 1e6:.1f} MB", ", ".join(found.participants)
    copied = f"{found.files} files ({size}) of {who}" if found.files else "nothing to copy"
    refused = [f"refused: {line}" for line in found.refused]
    lines = [f"{into}: {copied}", *refused, *found.notes]
    shared.print_facts(asdict(found), lines, as_json=as_json)
    return 1 if found.refused else 0


def withdraw(
    study: File = Path(),
    /,
    *,
    participant: Participant,
    reason: Annotated[str, about("Kept with the code; write no name.")] = "",
    keep_data: Annotated[bool, about("Only free the design slot.")] = False,
    is_sure: Annotated[bool, about("Do not ask.", name="--yes")] = False,
    as_json: Json = False,
) -> int:
    """Remove the data of a participant for good, and free the design slot.

    Data go from sessions, rehearsals, tables and results; outputs elsewhere are listed, to be removed by hand. The code
    is not reused. --keep-data, for somebody who will not return: what was recorded stays, the next participant gets the
    slot.

    Example: feel321 withdraw my-study --participant p07 --yes
             feel321 withdraw my-study --participant p07 --keep-data
    """
    from feel321.study.persons.withdrawal import release_participant, withdraw_participant

    opened = shared.open_study(study)
    folder = opened.folder
    if keep_data:
        number = release_participant(folder, participant, now=opened.now)
        line = f"{folder.path}: {participant} is released, number {number} is free"
        facts: dict[str, object] = {"participant": participant, "number": number, "removed": []}
        shared.print_facts(facts, [line], as_json=as_json)
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
    has_tombstone = (folder.sessions / participant).exists()
    kept = "; a tombstone keeps the code" if has_tombstone else ""
    line = (
        f"{folder.path}: removed {len(removed)} files of {participant}{kept}. "
        "Copies that feel321 did not make must be removed by hand"
    )
    facts = {"participant": participant, "removed": removed, "tombstone": has_tombstone}
    shared.print_facts(facts, [line], as_json=as_json)
    return 0


Device = Annotated[Name, about("Device instead of the rig's: its name, or a unique part of it.")]

TYPED = "Type a gain instead of measuring, in m/s² at full scale; once for each."
ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""

RATE_HZ = 48000.0  # at which a device is tried that belongs to no study


def calibrate(
    study: File = Path(),
    /,
    *,
    device: Device = None,
    manual: Annotated[tuple[str, ...], about(TYPED, metavar="NAME=GAIN")] = (),
    redesign: Annotated[bool, about("From the stored sweeps, without playing.")] = False,
    as_json: Json = False,
) -> int:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps on one coil after another, recorded by the sensor of rig.toml; proposes the band and the gain of each
    filter, says what that costs in level, and asks; verifies the filters by playing through them, and stores a
    certificate, of which run uses the newest that is valid. Ctrl-C stops; coils that are done are kept. The exit code
    is 1 if the limits of [calibration] in rig.toml are not met; run then does not use the certificate.

    Example: feel321 calibrate my-study
    """
    from feel321.study.actuator.certificate import draw_certificate, make_manual, write_certificate
    from feel321.study.actuator.render import find_directions

    folder = require_study(study)
    rig, rate_hz = _find_rig(folder, device) if folder.rig.is_file() else (None, RATE_HZ)
    if rig is None:
        raise FileNotFoundError(
            f"{folder.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    if manual:
        typed, directions, now = _read_gains(manual), find_directions(rig)[0], datetime.now(UTC)
        made = make_manual(rig, typed, directions=directions, made=now, rate_hz=rate_hz)
    else:
        made = _measure(folder, rig, rate_hz=rate_hz, redesign=redesign)
    certificate = write_certificate(made, folder.path)
    if not manual:  # of which there is nothing to see
        draw_certificate(certificate, folder.calibration / certificate.id)
    passed = not certificate.failures
    facts = asdict(certificate) | {"passed": passed}
    for coil in facts["coils"].values():
        for name in ARRAYS & coil.keys():
            del coil[name]
    verdict = "passed" if passed else "did not pass"
    until = f"valid until {certificate.expires_utc[:10]}"
    lines = [f"certificate {certificate.id} ({certificate.method}): {verdict}; {until}"]
    shared.print_facts(facts, [*lines, *shared.lay_facts(facts["coils"])], as_json=as_json)
    for failure in certificate.failures:
        shared.warn(failure)
    return 0 if passed else 1


def _find_rig(study: StudyFolder, device: str | None) -> tuple["Rig | None", float]:
    """Read the study's rig, or make one of two coils for a device; None if neither is named."""
    from feel321.study.actuator.rig import LimitsTable, Rig, read_rig, take_device
    from feel321.study.settings.read import read_settings

    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    return (rig if device is None else take_device(rig, device)), rate_hz


def _read_gains(manual: Sequence[str]) -> dict[str, float]:
    typed = {}
    for text in manual:
        name, _, gain = text.rpartition("=")
        try:
            typed[name.strip()] = float(gain)
        except ValueError:
            shared.refuse_use(f"--manual must be NAME=GAIN, such as 'left coil=12.5', got {text!r}")
    return typed


def _measure(folder: StudyFolder, rig: "Rig", *, rate_hz: float, redesign: bool) -> "Certificate":
    from feel321.study.actuator.calibrate import KEPT, Calibration
    from feel321.study.actuator.rig import FILE_DEVICE

    ask, now = partial(agree, folder, rig), datetime.now(UTC)
    own = Calibration(rig=rig, rate_hz=rate_hz, made=now, folder=folder.path, agree=ask)
    if redesign:
        return own.redesign()
    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    if kept := own.find_runs(within=KEPT):
        shared.echo(f"kept, as they were measured a while ago: {', '.join(kept)}", err=True)
    with follow(shared.wants_bar(), "s of sweeps") as own.on_step:
        return own.run()


def agree(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> bool:
    """Show what is proposed for each coil and what it costs in level; ask, where somebody is there."""
    lines = []
    for coil in proposed.coils.values():
        low, high = coil.band_hz
        least = coil.target * 10 ** (-coil.gain_db / 20)
        lines.append(
            f"{coil.name}: flat from {low:.0f} to {high:.0f} Hz within {coil.largest_db:.1f} dB by a gain of up to "
            f"{coil.gain_db:.0f} dB; so it plays up to {coil.target:.3g} m/s², and {least:.2g} where it is weakest"
        )
    shared.echo("\n".join([*lines, *_find_cost(folder, rig, proposed)]), err=True)
    if sys.stdin is None or not sys.stdin.isatty():
        return True
    asked = "Enter takes it; n stops: --redesign tries another max_gain_db of [calibration]."
    shared.echo(asked, err=True)
    return not sys.stdin.readline().strip().lower().startswith("n")


def _find_cost(folder: StudyFolder, rig: "Rig", proposed: "Certificate") -> Iterator[str]:
    """Say how much of full scale the study's stimuli take through the filters, and how weak the weakest then is."""
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.actuator.render import find_rig_problems
    from feel321.study.settings.read import read_settings

    if not (folder.stimuli.is_dir() and folder.settings.is_file()):
        yield "the study has no stimuli yet; build them, and calibrate --redesign says how strong they come"
        return
    stimuli, own = read_stimuli(folder.stimuli), read_settings(folder.settings).rig
    scale, sounds = own.full_scale_m_s2, dict[str, "Frames"]()
    find_rig_problems(
        rig, stimuli, rate_hz=own.rate_hz, full_scale_m_s2=scale, certificate=proposed, sounds=sounds
    )  # fmt: skip
    peaks = {name: float(abs(sound).max()) for name, sound in sounds.items()}
    strongest = max(peaks, key=peaks.__getitem__)
    headroom_db = -20 * math.log10(max(peaks[strongest], 1e-9))
    told = f"headroom {headroom_db:.1f} dB"
    if headroom_db < 0:
        told = f"{-headroom_db:.1f} dB too much: lower gain or headroom in study.toml by that, and build again"
    yield f"strongest stimulus {strongest}: {peaks[strongest]:.0%} of full scale, {told}"
    levels = {one.stimulus_id: one.sensation_level_db for one in stimuli}
    felt = {name: level for name, level in levels.items() if math.isfinite(level)}
    if felt:
        weakest = min(felt, key=felt.__getitem__)
        left_db = felt[weakest] + min(headroom_db, 0.0)
        yield f"weakest stimulus {weakest}: {left_db:.1f} dB over the threshold of feeling"


def doctor(
    study: File | None = None,
    /,
    *,
    device: Device = None,
    seconds: Annotated[float, within(0, 3600), about("Duration of the pulse train, in s.")] = 5.0,
    as_json: Json = False,
) -> int:
    """Test the rig: list devices, measure latency and jitter, try each coil.

    Plays quiet pulses on every actuator, through the same stream as in a session, and, with a sensor, a probe on each
    coil: by name, what is dead, inverted, swapped, loose or too strong against the certificate or rig.toml, a wrong
    rate, a missing channel, hum; the exit code is then 1. Without a study, --device names what to play on.

    Example: feel321 doctor my-study --seconds 10
    """
    from feel321.study.actuator.certificate import judge_certificates, list_certificates
    from feel321.study.actuator.doctor import examine_rig, probe_coils, survey_devices
    from feel321.study.actuator.rig import FILE_DEVICE, SIMULATED_DEVICE

    rig, rate_hz = _find_rig(StudyFolder(Path()) if study is None else require_study(study), device)
    name = rig.device.name if rig else FILE_DEVICE
    devices = [] if name == SIMULATED_DEVICE else survey_devices()
    found: dict[str, Any] = {}
    known: dict[str, Any] = {}
    faults: list[str] = []
    if rig is not None and name != FILE_DEVICE and seconds:
        with follow(shared.wants_bar(), "pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            certificate = None
            if study is not None and list_certificates(study):
                now = datetime.now(UTC)
                certificate, faults = judge_certificates(study, rig, now=now, rate_hz=rate_hz)
            coils, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
            faults += [f"{name}: {one['fault']}" for name, one in coils.items() if one["fault"]]
            faults += [hum] if hum else []
            known = {
                "certificate": certificate and certificate.id,
                "coils": coils,
                "faults": faults,
            }
    facts = {"devices": devices, "examination": found or None, "rig": known or None}
    nothing = "nothing was played; name a device with --device, or in the study's rig.toml"
    lines = [*shared.lay_facts(facts), *([] if found else [nothing])]
    shared.print_facts(facts, lines, as_json=as_json)
    if found and found["is_program"]:
        shared.warn(
            f"{found['device']}: a program plays it (a sound server, say), which may convert the rate and copy "
            "channels to others without notice; name the card itself, or give it as many channels as the rig has"
        )
    if found and found["error"]:
        shared.warn(found["error"])
    if faults:
        raise OSError("\n".join(faults))
    return 1 if found and (found["n_failed"] or found["n_underruns"]) else 0
