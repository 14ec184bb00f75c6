"""The verb of the lab: run."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from shlex import join
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from pathlib import Path

    from feel321.study.session.ports import Place
    from feel321.study.study import Study


@click.command(epilog="Example: feel321 run my-study --participant p07")
@shared.study_argument
@shared.participant_option
@shared.flag("--windowed", "A window instead of the whole screen.")
@click.option(
    "--screen",
    type=shared.WholeNumber(0, 99),
    default=0,
    show_default=True,
    metavar="N",
    help="The participant's monitor; 0 is the main one.",
)
@click.option(
    "--device", metavar="NAME", help="Audio device; 'file' writes WAV files.  [default: rig.toml's]"
)
@shared.flag("--accept-rig", "Resume on a rig or certificate that changed; the journal records it.")
@shared.flag("--lsl", "Send the session's events to the lab streaming layer (pylsl).")
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
    accept_rig: bool,
    lsl: bool,
    rehearse: bool,
    simulated: bool,
    seed: int | None,
) -> None:
    """Run a session with a participant, or resume it."""
    if seed is not None and not simulated:
        raise click.UsageError("--seed needs --simulate-participant; people have no seed")
    from feel321.study.lab import Visit, run_participant

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
    folder = replace(study.folder, is_rehearsal=rehearse)
    log = _Log(participant, _write_command(context), folder.rig)
    with log.watch():
        outcome = run_participant(folder, visit, now=study.now, on_step=log.note, warn=shared.warn)
        if outcome.stopped:
            log.say_how_to_resume(outcome.stopped)
            context.exit(1)
    log.end_line()
    shared.echo(f"{participant}: all {outcome.total} done")


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
            shared.echo(f"{self.participant}: {place.done} of {place.total} done so far")
        if place.fault:
            self._call(place.fault)
        elif shared.is_terminal():
            minutes = "" if place.left_s is None else f", about {place.left_s / 60:.0f} min left"
            line = f"{self.participant}: {place.done} of {place.total} done{minutes}"
            shared.echo(f"{line:<{LINE}}", over=True, err=True)
        self.place = place

    def _call(self, fault: str) -> None:
        from feel321.study.actuator.rig import read_rig
        from feel321.study.keys import label_key

        key = label_key(read_rig(self.rig).keys.find_key("experimenter"), {})
        begin = "\n" if shared.is_terminal() else ""
        shared.echo(
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

    def end_line(self) -> None:
        """Leave what was left as it stands, and begin a new line."""
        if self.place is not None and shared.is_terminal():
            shared.echo(err=True)

    def say_how_to_resume(self, reason: str) -> None:
        if self.place is not None:
            self.end_line()
            done = f"{self.place.done} of {self.place.total} done"
            shared.echo(
                f"{self.participant}: {done} (aborted: {reason}); resume with: {self.command}",
                err=True,
            )


def _write_command(context: click.Context) -> str:
    """Write the command that resumes a session: this one, as it was given."""
    words = ["feel321", "run", str(context.params["study"].folder.path)]
    for parameter in context.command.params:
        value = context.params.get(str(parameter.name))
        is_given = value is not None and value is not False and value != parameter.default
        if parameter.name == "accept_rig":  # of this change, not of the next one
            continue
        if isinstance(parameter, click.Option) and is_given:
            words += parameter.opts if value is True else [*parameter.opts, str(value)]
    return join(words)
