"""Verbs of the lab: sessions (run, simulate, status, note, collect, withdraw) and the rig (calibrate, doctor)."""

import math
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from feel321.study.commands import shared
from feel321.study.commands.shared import File, Json, Participant, Rehearsals, Seed, within
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.certificate import Certificate
    from feel321.study.actuator.mixer import Frames
    from feel321.study.actuator.rig import Rig
    from feel321.study.session.engine import Outcome
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
        Send onsets to the lab streaming layer.
    rehearse
        Stored in rehearsals/ and never analysed.
    simulated
        A simulated participant presses the keys.
    """
    if seed is not None and not simulated:
        shared.refuse_use("--seed needs --simulate-participant; people have no seed")
    from feel321.study.lab import run_participant
    from feel321.study.sessions import read_room

    opened = shared.open_study(study)
    folder = replace(opened.folder, is_rehearsal=rehearse)
    log = SessionLog(participant, folder.rig)
    try:
        outcome = run_participant(
            replace(
                read_room(folder, now=opened.now),
                windowed=windowed,
                screen=screen,
                device=device,
                accept_rig=accept_rig,
                lsl=lsl,
            ),
            participant,
            simulated=simulated,
            seed=seed,
            on_step=log.note,
            warn=shared.warn,
        )
    except (Exception, KeyboardInterrupt) as error:
        log.end(type(error).__name__)
        raise
    log.end(outcome.stopped)
    if outcome.stopped:
        return 1
    shared.echo(f"{participant}: {_count(outcome)}")
    return 0


LINE = 60  # characters of the line that says what is left; it is overwritten by the next


def _count(place: "Place | Outcome") -> str:
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
        if self.place is not None and shared.is_terminal():
            shared.echo(err=True)
        if self.place is not None and reason:
            # A change of the rig is accepted only once.
            words = [word for word in shared.CALL.get().words if word != "--accept-rig"]
            done = f"{_count(self.place)} (aborted: {reason})"
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

    One line, not while a session runs. It is never edited, and removed only by withdraw: write no names. Shown by
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

    FROM are study folders, mounted or copied; they are only read. A longer journal takes the place of one that it
    continues; sessions that conflict with the study are refused by name. A participant who withdrew at one station is
    withdrawn here.

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


Device = Annotated[
    str | None,
    Parameter(
        metavar="NAME", help="Device instead of the rig's: its name, or a unique part of it."
    ),
]

ARRAYS = {"frequency_hz", "response", "coherence", "distortion", "equalised", "fir"}
"""Fields of a coil's certificate that are too long to print."""

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


def calibrate(
    study: File = Path(),
    /,
    *,
    device: Device = None,
    manual: Annotated[tuple[str, ...], Parameter(metavar="NAME=GAIN")] = (),
    redesign: bool = False,
    as_json: Json = False,
) -> int:
    """Measure the coils of the rig and make filters for them.

    Plays sweeps on one coil after another, recorded by the sensor of rig.toml; proposes the band and the gain of each
    filter, says what that costs in level, and asks; verifies the filters by playing through them, and stores a
    certificate, of which run uses the newest that is valid. Ctrl-C stops; coils that are done are kept. The exit code
    is 1 if the limits of [calibration] in rig.toml are not met; run then does not use the certificate.

    Example: feel321 calibrate my-study

    Parameters
    ----------
    manual
        Type a gain instead of measuring, in m/s² at full scale; once for each.
    redesign
        Design anew from the stored sweeps, without playing.
    """
    from feel321.study.actuator.certificate import draw_certificate, write_certificate

    folder = require_study(study)
    rig, rate_hz = _find_rig(folder, device) if folder.rig.is_file() else (None, RATE_HZ)
    if rig is None:
        raise FileNotFoundError(
            f"{folder.rig}: there is none; feel321 new DIR writes one, copy it from there and name your actuators in it"
        )
    if manual:
        made = _type_gains(rig, manual, rate_hz=rate_hz)
    else:
        made = _measure(folder, rig, rate_hz=rate_hz, redesign=redesign)
    certificate = write_certificate(made, folder.path)
    if not manual:  # of which there is nothing to see
        draw_certificate(certificate, folder.calibration / certificate.id)
    facts = asdict(certificate) | {"passed": certificate.passed}
    for coil in facts["coils"].values():
        for name in ARRAYS & coil.keys():
            del coil[name]
    verdict = "passed" if certificate.passed else "did not pass"
    until = f"valid until {certificate.expires_utc[:10]}"
    lines = [f"certificate {certificate.id} ({certificate.method}): {verdict}; {until}"]
    shared.print_facts(facts, [*lines, *shared.lay_facts(facts["coils"])], as_json=as_json)
    for failure in certificate.failures:
        shared.warn(failure)
    return 0 if certificate.passed else 1


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


def _type_gains(rig: "Rig", manual: Sequence[str], *, rate_hz: float) -> "Certificate":
    from feel321.study.actuator.certificate import make_manual
    from feel321.study.actuator.render import find_directions

    typed = {}
    for text in manual:
        name, _, gain = text.rpartition("=")
        try:
            typed[name.strip()] = float(gain)
        except ValueError:
            shared.refuse_use(f"--manual must be NAME=GAIN, such as 'left coil=12.5', got {text!r}")
    directions, _ = find_directions(rig)
    return make_manual(rig, typed, directions=directions, made=datetime.now(UTC), rate_hz=rate_hz)


def _measure(folder: StudyFolder, rig: "Rig", *, rate_hz: float, redesign: bool) -> "Certificate":
    from feel321.study.actuator.calibrate import KEPT, Calibration
    from feel321.study.actuator.rig import FILE_DEVICE

    own = Calibration(
        rig=rig,
        rate_hz=rate_hz,
        made=datetime.now(UTC),
        folder=folder.path,
        agree=partial(agree, folder, rig),
    )
    if redesign:
        return own.redesign()
    if rig.device.name == FILE_DEVICE:
        raise ValueError(
            'rig.toml plays to files, which no sensor measures; name a device there or with --device ("simulated" '
            "needs no hardware), or type gains with --manual"
        )
    if kept := own.find_runs(within=KEPT):
        shared.echo(f"kept, as they were measured a while ago: {', '.join(kept)}", err=True)
    with shared.show_progress("s of sweeps") as own.on_step:
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
    shared.echo(
        "Enter takes it; n stops: --redesign tries other settings of [calibration].", err=True
    )
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
    sounds: dict[str, Frames] = {}
    find_rig_problems(
        rig,
        stimuli,
        rate_hz=own.rate_hz,
        full_scale_m_s2=own.full_scale_m_s2,
        certificate=proposed,
        sounds=sounds,
    )
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
    seconds: Annotated[float, within(0, 3600)] = 5.0,
    as_json: Json = False,
) -> int:
    """Test the rig: list devices, measure latency and jitter, try each coil.

    Plays quiet pulses on every actuator, through the same stream as in a session, and, with a sensor, a probe on each
    coil: by name, what is dead, inverted, swapped, loose or too strong against the certificate or rig.toml, a wrong
    rate, a missing channel, hum; the exit code is then 1. Without a study, --device names what to play on.

    Example: feel321 doctor my-study --seconds 10

    Parameters
    ----------
    seconds
        Duration of the pulse train, in s.
    """
    from feel321.study.actuator.doctor import examine_rig, probe_coils, survey_devices
    from feel321.study.actuator.rig import FILE_DEVICE, SIMULATED_DEVICE

    rig, rate_hz = _find_rig(StudyFolder(Path()) if study is None else require_study(study), device)
    if rig is not None and rig.device.name == FILE_DEVICE:
        rig = None
    is_simulated = rig is not None and rig.device.name == SIMULATED_DEVICE
    devices, found, known = [] if is_simulated else survey_devices(), None, None
    faults: list[str] = []
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
        if rig.sensor is not None and found["n_failed"] < found["n_pulses"]:
            certificate, faults = _find_certificate(study, rig, rate_hz=rate_hz)
            probes, hum = probe_coils(rig, certificate, rate_hz=rate_hz)
            faults += [f"{name}: {one['fault']}" for name, one in probes.items() if one["fault"]]
            faults += [hum] if hum else []
            known = {
                "certificate": certificate and certificate.id,
                "coils": probes,
                "faults": faults,
            }
    facts = {"devices": devices, "examination": found, "rig": known}
    lines = [*shared.lay_facts(facts)]
    if found is None:
        lines.append("nothing was played; name a device with --device, or in the study's rig.toml")
    shared.print_facts(facts, lines, as_json=as_json)
    if found is not None and found["is_program"]:
        shared.warn(
            f"{found['device']}: a program plays it (a sound server, say), which may convert the rate and copy "
            "channels to others without notice; name the card itself, or give it as many channels as the rig has"
        )
    if found is not None and found["error"]:
        shared.warn(found["error"])
    if faults:
        raise OSError("\n".join(faults))
    return 1 if found is not None and (found["n_failed"] or found["n_underruns"]) else 0


def _find_certificate(
    study: Path | None, rig: "Rig", *, rate_hz: float
) -> tuple["Certificate | None", list[str]]:
    """Find the certificate that run would use; what is wrong with those that are there."""
    from feel321.study.actuator.certificate import judge_certificates, list_certificates

    if study is None or not list_certificates(study):
        return None, []
    return judge_certificates(study, rig, now=datetime.now(UTC), rate_hz=rate_hz)
