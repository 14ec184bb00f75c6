"""Verbs of the lab: run, doctor."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, NoReturn

import click

from feel321.study.commands.shared import (
    FILE,
    find_study,
    json_option,
    now,
    print_json,
    show_progress,
    study_argument,
    warn,
)
from feel321.study.folder import StudyFolder

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from typing import Any

    from feel321.study.actuator.doctor import Examination
    from feel321.study.actuator.rig import Rig
    from feel321.study.session.ports import Place

# The verb that leads a person through a session.


class Terminated(KeyboardInterrupt):
    """The process was asked to end; that is met as Ctrl-C is."""


@click.command(epilog="Example: feel321 run my-study --participant p07")
@study_argument
@click.option("--participant", metavar="ID", required=True, help="The participant's code.")
@click.option("--windowed", is_flag=True, help="A window instead of the whole screen.")
@click.option(
    "--device", metavar="NAME", help="Audio device; 'file' writes WAV files.  [default: rig.toml's]"
)
@click.option(
    "--rehearse", is_flag=True, help="Try it out: the session lies in rehearsals/ and is no data."
)
@click.option(
    "--simulate-participant",
    "simulated",
    is_flag=True,
    help="A simulated participant presses the keys.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), help="Seed of the simulated one.  [default: the study's]"
)
@click.pass_context
def run(  # noqa: PLR0913 - one parameter per option
    context: click.Context,
    *,
    study: StudyFolder,
    participant: str,
    windowed: bool,
    device: str | None,
    rehearse: bool,
    simulated: bool,
    seed: int | None,
) -> None:
    """Lead a participant through a session, or go on where it stopped."""
    if seed is not None and not simulated:
        raise click.UsageError("--seed: got it without --simulate-participant; people have no seed")
    from feel321.study.sessions import Visit, run_participant

    visit = Visit(participant, windowed=windowed, device=device, simulated=simulated, seed=seed)
    log = _Log(participant, _write_command(context))
    with _heed_termination(), log.watch():
        outcome = run_participant(
            replace(study, is_rehearsal=rehearse), visit, now=now, on_step=log.note, warn=warn
        )
        if outcome.stopped:
            log.tell_how_to_go_on(outcome.stopped)
            context.exit(1)
    click.echo(f"{participant}: all {outcome.total} done")


@dataclass(slots=True)
class _Log:
    """Tells whoever leads the session how far it has come, and how to go on with it."""

    participant: str
    command: str
    place: Place | None = None

    def note(self, place: Place) -> None:
        if self.place is None:
            click.echo(f"{self.participant}: {place.done} of {place.total} done so far")
        self.place = place

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Tell how to go on with a session that something put an end to."""
        try:
            yield
        except (Exception, KeyboardInterrupt) as error:
            if not isinstance(error, click.exceptions.Exit):
                self.tell_how_to_go_on(type(error).__name__)
            raise

    def tell_how_to_go_on(self, reason: str) -> None:
        if self.place is not None:
            done = f"{self.place.done} of {self.place.total} done"
            click.echo(
                f"{self.participant}: {done} (aborted: {reason}); go on with: {self.command}",
                err=True,
            )


def _write_command(context: click.Context) -> str:
    """Write the command that goes on with a session: this one, as it was given."""
    values = context.params
    words = ["feel321", "run", str(values["study"].path), "--participant", values["participant"]]
    words += [
        word
        for name in ("device", "seed")
        if values[name] is not None
        for word in (f"--{name}", values[name])
    ]
    flags = {
        "windowed": "--windowed",
        "rehearse": "--rehearse",
        "simulated": "--simulate-participant",
    }
    return join([*map(str, words), *(flag for name, flag in flags.items() if values[name])])


@contextmanager
def _heed_termination() -> Iterator[None]:
    """Close device and window, and the journal with a last word, when the process is asked to end."""

    def stop(_number: int, _frame: object) -> NoReturn:
        raise Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


# The verb for the rig: what hangs on this machine, and whether it plays in time.

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


@click.command(epilog="Example: feel321 doctor my-study --seconds 10")
@click.argument("folder", metavar="[STUDY]", type=FILE, required=False)
@click.option(
    "--device",
    help="Another device than the rig's: its name, or a part of it that no other one has.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0, 3600),
    default=5.0,
    show_default=True,
    help="So long pulses play.",
)
@json_option
@click.pass_context
def doctor(
    context: click.Context,
    *,
    folder: Path | None,
    device: str | None,
    seconds: float,
    as_json: bool,
) -> None:
    """List audio devices, check rig.toml, and measure latency and jitter.

    Quiet pulses are played on every actuator, through the same stream as in a session. Without a study, or where the
    rig plays to files, --device names what to play on.
    """
    from feel321.study.actuator.doctor import survey_devices

    rig, rate_hz = _find_rig(folder, device=device)
    devices = survey_devices()
    examination = (
        _examine(rig, rate_hz=rate_hz, seconds=seconds) if rig is not None and seconds else None
    )
    if as_json:
        print_json({
            "devices": devices,
            "examination": None if examination is None else asdict(examination),
        })
    else:
        _print_devices(devices)
        _print_examination(examination)
    if examination is not None and (examination.n_failed or examination.n_underruns):
        context.exit(1)


def _find_rig(folder: Path | None, *, device: str | None) -> tuple[Rig | None, float]:
    """Read the study's rig, or make one of two coils for a device; None if there is nothing to play on."""
    from feel321.study.actuator.rig import FILE_DEVICE, LimitsTable, Rig, read_rig, take_device
    from feel321.study.settings.read import read_settings

    study = StudyFolder(Path()) if folder is None else find_study(folder)
    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    rig = rig if device is None else take_device(rig, device)
    return (None if rig.device.name == FILE_DEVICE else rig), rate_hz


def _examine(rig: Rig, *, rate_hz: float, seconds: float) -> Examination:
    from feel321.study.actuator.doctor import examine_rig

    with show_progress("pulses") as progress:
        return examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)


def _print_devices(devices: Sequence[Mapping[str, Any]]) -> None:
    for device in devices:
        rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
        channels = f"{device['outputs']} out, {device['inputs']} in"
        program = "; through a program" if device["is_program"] else ""
        click.echo(
            f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}"
        )


def _print_examination(found: Examination | None) -> None:
    if found is None:
        click.echo("nothing was played; name a device with --device, or in the study's rig.toml")
        return
    click.echo(
        f"{found.device} ({found.host_api}) played at {found.rate_hz:g} Hz; latency {found.latency_ms:.1f} ms"
    )
    click.echo(f"pulses {found.n_pulses}, failed {found.n_failed}, underruns {found.n_underruns}")
    jitter = f"jitter {found.jitter_ms:.2f} ms (median), {found.jitter_99_ms:.2f} ms (99 %)"
    click.echo(
        f"requested to onset {found.onset_ms:.1f} ms, {jitter}; longest block {found.callback_ms_max:.2f} ms"
    )
    if found.sensed_ms is not None:
        jitter = f"jitter {found.sensed_jitter_ms:.2f} ms (median), {found.sensed_jitter_99_ms:.2f} ms (99 %)"
        click.echo(f"onset's block to sensor {found.sensed_ms:.1f} ms, {jitter}")
    if found.stop_ms is not None:
        click.echo(
            f"a stop is silence after {found.stop_ms:.0f} ms at most; latency_s in rig.toml shortens it"
        )
    if found.is_program:
        warn(
            f"{found.device}: a program plays it (a sound server, say), which may convert the rate, and copy channels "
            "to others, without saying so; name the card itself, or give it as many channels there as the rig has"
        )
    if found.error:
        warn(found.error)
