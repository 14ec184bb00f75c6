"""Verbs of the lab: run, doctor."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from shlex import join
from typing import TYPE_CHECKING, Any, NoReturn

import click

from feel321.study.commands import shared
from feel321.study.folder import StudyFolder, require_study

if TYPE_CHECKING:
    from feel321.study.actuator.doctor import Examination
    from feel321.study.actuator.rig import Rig
    from feel321.study.session.ports import Place
    from feel321.study.study import Study


class Terminated(KeyboardInterrupt):
    """The process was asked to end; that is treated as Ctrl-C is."""


@click.command(epilog="Example: feel321 run my-study --participant p07")
@shared.study_argument
@shared.participant_option
@shared.flag("--windowed", "A window instead of the whole screen.")
@click.option(
    "--screen",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    help="The participant's monitor; 0 is the main one.",
)
@click.option(
    "--device", metavar="NAME", help="Audio device; 'file' writes WAV files.  [default: rig.toml's]"
)
@shared.flag("--rehearse", "Try it out: the session is stored in rehearsals/ and never analysed.")
@shared.flag("--simulate-participant", "A simulated participant presses the keys.", "simulated")
@shared.seed_option(" of the simulated participant")
@click.pass_context
def run(  # noqa: PLR0913 - one parameter per option
    context: click.Context,
    *,
    study: Study,
    participant: str,
    windowed: bool,
    screen: int,
    device: str | None,
    rehearse: bool,
    simulated: bool,
    seed: int | None,
) -> None:
    """Run a session with a participant, or resume it."""
    if seed is not None and not simulated:
        raise click.UsageError("--seed needs --simulate-participant; people have no seed")
    from feel321.study.lab import Visit, run_participant

    visit = Visit(
        participant, windowed=windowed, screen=screen, device=device, simulated=simulated, seed=seed
    )
    folder = replace(study.folder, is_rehearsal=rehearse)
    log = _Log(participant, _write_command(context), folder.rig)
    with _catch_termination(), log.watch():
        outcome = run_participant(folder, visit, now=study.now, on_step=log.note, warn=shared.warn)
        if outcome.stopped:
            log.say_how_to_resume(outcome.stopped)
            context.exit(1)
    click.echo(f"{participant}: all {outcome.total} done")


LINE = 60  # characters of the line that says what is left; it is overwritten by the next


@dataclass(slots=True)
class _Log:
    """Prints how far the session is, and how to resume it."""

    participant: str
    command: str
    rig: Path
    place: Place | None = None

    def note(self, place: Place) -> None:
        if self.place is None:
            click.echo(f"{self.participant}: {place.done} of {place.total} done so far")
        if place.fault:
            self._call(place.fault)
        elif shared.is_terminal():
            minutes = "" if place.left_s is None else f", about {place.left_s / 60:.0f} min left"
            line = f"{self.participant}: {place.done} of {place.total} done{minutes}"
            click.echo(f"\r{line:<{LINE}}", nl=place.done == place.total, err=True)
        self.place = place

    def _call(self, fault: str) -> None:
        from feel321.study.actuator.rig import read_rig
        from feel321.study.keys import label_key

        key = label_key(read_rig(self.rig).keys.find_key("experimenter"), {})
        begin = "\n" if shared.is_terminal() else ""
        click.echo(
            f"{begin}{self.participant}: the device failed ({fault}); check it, then press "
            f"{key} in the participant's window",
            err=True,
        )

    @contextmanager
    def watch(self) -> Iterator[None]:
        """Say how to resume a session that something ended."""
        try:
            yield
        except (Exception, KeyboardInterrupt) as error:
            if not isinstance(error, click.exceptions.Exit):
                self.say_how_to_resume(type(error).__name__)
            raise

    def say_how_to_resume(self, reason: str) -> None:
        if self.place is not None:
            if shared.is_terminal():
                click.echo(err=True)  # what is left stays where it is
            done = f"{self.place.done} of {self.place.total} done"
            click.echo(
                f"{self.participant}: {done} (aborted: {reason}); resume with: {self.command}",
                err=True,
            )


def _write_command(context: click.Context) -> str:
    """Write the command that resumes a session: this one, as it was given."""
    words = ["feel321", "run", str(context.params["study"].folder.path)]
    for parameter in context.command.params:
        value = context.params.get(str(parameter.name))
        is_given = value is not None and value is not False and value != parameter.default
        if isinstance(parameter, click.Option) and is_given:
            words += parameter.opts if value is True else [*parameter.opts, str(value)]
    return join(words)


@contextmanager
def _catch_termination() -> Iterator[None]:
    """Close device and window, and the journal with a last record, when the process is asked to end."""

    def stop(_number: int, _frame: object) -> NoReturn:
        raise Terminated

    before = signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


# The verb for the rig: what is connected to this machine, and whether it plays in time.

RATE_HZ = 48000.0
"""At which a device is tried that belongs to no study."""


@click.command(epilog="Example: feel321 doctor my-study --seconds 10")
@click.argument("folder", metavar="[STUDY]", type=shared.FILE, required=False)
@click.option(
    "--device",
    help="Another device than the rig's: its name, or a part of it that no other one has.",
)
@click.option(
    "--seconds",
    type=click.FloatRange(0, 3600),
    default=5.0,
    show_default=True,
    help="Duration of the pulse train, in s.",
)
@shared.json_option
@click.pass_context
def doctor(
    context: click.Context,
    *,
    folder: Path | None,
    device: str | None,
    seconds: float,
    as_json: bool,
) -> None:
    """Test the rig: list devices, measure latency and jitter.

    Checks rig.toml and plays quiet pulses on every actuator, through the same stream as in a session. A sensor named in
    rig.toml must show the pulses, about as strong as they were sent; otherwise the exit code is 1. Without a study, or
    where the rig plays to files, --device names what to play on.
    """
    from feel321.study.actuator.doctor import examine_rig, survey_devices

    rig, rate_hz = _find_rig(folder, device=device)
    devices, found = survey_devices(rig), None
    if rig is not None and seconds:
        with shared.show_progress("pulses") as progress:
            found = examine_rig(rig, rate_hz=rate_hz, seconds=seconds, on_step=progress)
    if as_json:
        shared.print_json({
            "devices": devices,
            "examination": None if found is None else asdict(found),
        })
    else:
        for one in devices:
            click.echo(_describe_device(one))
        _print_examination(found)
    if found is not None and found.sensor is not None and found.sensor.fault:
        raise OSError(found.sensor.fault)
    if found is not None and (found.n_failed or found.n_underruns):
        context.exit(1)


def _find_rig(folder: Path | None, *, device: str | None) -> tuple[Rig | None, float]:
    """Read the study's rig, or make one of two coils for a device; None if there is nothing to play on."""
    from feel321.study.actuator.rig import FILE_DEVICE, LimitsTable, Rig, read_rig, take_device
    from feel321.study.settings.read import read_settings

    study = StudyFolder(Path()) if folder is None else require_study(folder)
    rate_hz = read_settings(study.settings).rig.rate_hz if study.settings.is_file() else RATE_HZ
    if study.rig.is_file():
        rig = read_rig(study.rig)
    elif device is not None:
        rig = Rig(limits=LimitsTable(peak_m_s2=100.0, rms_m_s2=50.0, duration_s=30.0))
    else:
        return None, rate_hz
    rig = rig if device is None else take_device(rig, device)
    return (None if rig.device.name == FILE_DEVICE else rig), rate_hz


def _describe_device(device: Mapping[str, Any]) -> str:
    rates = ", ".join(f"{rate_hz:g}" for rate_hz in device["rates_hz"]) or "none of those tried"
    channels = f"{device['outputs']} out, {device['inputs']} in"
    program = "; through a program" if device["is_program"] else ""
    return f"{device['name']} ({device['host_api']}): {channels}; plays at {rates} Hz{program}"


def _describe_times(found: Examination) -> str:
    if not found.n_estimated:
        return "onset times are the device's own"
    return (
        f"{found.n_estimated} of {found.n_pulses} onset times are estimated from the latency: "
        "the device gives none"
    )


def _print_examination(found: Examination | None) -> None:
    if found is None:
        click.echo("nothing was played; name a device with --device, or in the study's rig.toml")
        return
    lines = [
        f"{found.device} ({found.host_api}) played at {found.rate_hz:g} Hz; latency {found.latency_ms:.1f} ms",
        f"pulses {found.n_pulses}, failed {found.n_failed}, underruns {found.n_underruns}",
        f"requested to onset {found.onset_ms:.1f} ms, jitter {found.jitter_ms:.2f} ms (median), "
        f"{found.jitter_99_ms:.2f} ms (99 %); longest block {found.callback_ms_max:.2f} ms; "
        + _describe_times(found),
    ]
    if found.sensor is not None:
        lines.append(
            f"sensor: pulse found in {len(found.sensor.lags_ms)} of {found.sensor.n_recorded} recordings, "
            f"{found.sensor.level_m_s2:.2g} m/s² RMS; noise before it {found.sensor.noise_m_s2:.2g} m/s²"
        )
    if found.sensed_ms is not None:
        lines.append(
            f"onset's block to sensor {found.sensed_ms:.1f} ms, jitter {found.sensed_jitter_ms:.2f} ms (median), "
            f"{found.sensed_jitter_99_ms:.2f} ms (99 %)"
        )
    if found.stop_ms is not None:
        lines.append(
            f"a stop is silent after {found.stop_ms:.0f} ms at most; latency_s in rig.toml shortens it"
        )
    click.echo("\n".join(lines))
    if found.is_program:
        shared.warn(
            f"{found.device}: a program plays it (a sound server, say), which may convert the rate and copy channels "
            "to others without notice; name the card itself, or give it as many channels there as the rig has"
        )
    if found.error:
        shared.warn(found.error)
