"""The verb that leads a person through a session."""

from __future__ import annotations

import signal
from contextlib import contextmanager
from dataclasses import dataclass, replace
from shlex import join
from typing import TYPE_CHECKING, NoReturn

import click

from study.commands.shared import now, study_argument, warn

if TYPE_CHECKING:
    from collections.abc import Iterator

    from study.folder import StudyFolder
    from study.session.ports import Place


class Terminated(KeyboardInterrupt):
    """The process was asked to end; that is met as Ctrl-C is."""


@click.command(epilog="Example: feel321 run my-study --participant p07")
@study_argument
@click.option("--participant", metavar="ID", required=True, help="The participant's code.")
@click.option("--windowed", is_flag=True, help="A window instead of the whole screen.")
@click.option("--device", metavar="NAME", help="Audio device; 'file' writes WAV files.  [default: rig.toml's]")
@click.option("--rehearse", is_flag=True, help="Try it out: the session lies in rehearsals/ and is no data.")
@click.option("--simulate-participant", "simulated", is_flag=True, help="A simulated participant presses the keys.")
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the simulated one.  [default: the study's]")
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
    from study.run import Visit, run_participant

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
            click.echo(f"{self.participant}: {done} (aborted: {reason}); go on with: {self.command}", err=True)


def _write_command(context: click.Context) -> str:
    """Write the command that goes on with a session: this one, as it was given."""
    values = context.params
    words = ["feel321", "run", str(values["study"].path), "--participant", values["participant"]]
    words += [word for name in ("device", "seed") if values[name] is not None for word in (f"--{name}", values[name])]
    flags = {"windowed": "--windowed", "rehearse": "--rehearse", "simulated": "--simulate-participant"}
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
