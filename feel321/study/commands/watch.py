"""Verbs to look at sessions: monitor, replay, rehearse."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from feel321.files import write_text
from feel321.study.commands import shared
from feel321.study.folder import require_study

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.study.study import Study


@click.command(
    epilog="""\b
Example: feel321 monitor my-study
         feel321 monitor /lab/station1 /lab/station2 --port 8321
"""
)
@click.argument("folders", metavar="[STUDY]...", nargs=-1, type=shared.FILE)
@click.option(
    "--port", type=shared.WholeNumber(0, 65535), default=0, help="Port.  [default: a free one]"
)
@click.option(
    "--host", default="127.0.0.1", show_default=True, help="Loopback address to listen on."
)
@shared.rehearsals_option
def monitor(folders: Sequence[Path], *, port: int, host: str, rehearsals: bool) -> None:
    """Show running sessions on a live page, blind and read-only.

    The page has progress, time left, underruns, delivery errors, catch trials, training and notes, but no ratings and
    no condition names. It is served on this machine only, at an address with a secret token: do not share it. Ctrl-C
    ends it.
    """
    from feel321.study.monitor.live import serve_monitor
    from feel321.study.session.journal import utc_now

    studies = [
        replace(require_study(folder), is_rehearsal=rehearsals) for folder in folders or (Path(),)
    ]
    with _quiet_end("monitor"):
        serve_monitor(studies, host=host, port=port, now=utc_now, announce=shared.echo)


@click.command(
    epilog="""\b
Example: feel321 replay my-study --participant p07 --speed 8
         feel321 replay my-study --participant p07 --out p07.html
"""
)
@shared.study_argument
@shared.participant_option
@click.option(
    "--session", type=shared.WholeNumber(1, 10_000), help="Number.  [default: the newest]"
)
@click.option(
    "--speed",
    type=shared.BoundedNumber(0.1, 1000),
    default=1.0,
    show_default=True,
    help="Speed in the window.",
)
@shared.flag("--browser", "Serve it as a page for a local browser, with sound.")
@click.option(
    "--out", type=shared.FILE, metavar="FILE", help="Write that page, which opens offline."
)
@shared.flag("--windowed", "A window instead of the whole screen.")
@shared.flag("--while-running", "Even while the session runs.")
@shared.rehearsals_option
def replay(  # noqa: PLR0913 - one parameter per option
    *,
    study: Study,
    participant: str,
    session: int | None,
    speed: float,
    browser: bool,
    out: Path | None,
    windowed: bool,
    while_running: bool,
    rehearsals: bool,
) -> None:
    """Replay a session from its journal, at any speed.

    It is shown on the participant's own screens (without sound; Space pauses, arrows go from screen to screen, Esc ends
    it), or on a page. Nothing is written into the study. A replay shows the answers: it is not blind.
    """
    from feel321.study.monitor import replay as replays

    folder = replace(study.folder, is_rehearsal=rehearsals)
    if out is not None:
        replays.check_out(folder, out)
    film = replays.read_film(folder, participant, session=session, while_running=while_running)
    for change in film.changes:
        shared.echo(f"replay: the study has changed since this session began: {change}", err=True)
    if out is not None:
        with shared.recording(folder, "replay", out):
            write_text(out, replays.write_page(film))
        shared.echo(out)
    elif browser:
        from feel321.study.monitor.server import serve_pages

        pages = {"/": lambda nonce, _query: ("text/html", replays.write_page(film, nonce))}
        with _quiet_end("replay"):
            serve_pages("127.0.0.1", 0, pages, announce=shared.echo)
    else:
        from feel321.study.lab import start_clock
        from feel321.study.screen.window import open_screen

        clock = start_clock(0.0)
        with open_screen(clock=clock, windowed=windowed) as window:
            replays.play_in_window(film, window, clock=clock, speed=speed)


@click.command(
    epilog="""\b
Example: feel321 rehearse my-study --out rehearsal.html
         feel321 rehearse my-study --by-hand
"""
)
@shared.study_argument
@click.option("--out", type=shared.FILE, metavar="FILE", help="Write a page that opens offline.")
@shared.flag("--by-hand", "Answer yourself, at an address of this machine.")
@click.option(
    "--trials",
    type=shared.WholeNumber(1, 10_000),
    default=2,
    show_default=True,
    help="Trials of each task in training, in practice and in the main phase.",
)
@shared.seed_option(" of the simulated participant")
def rehearse(
    *, study: Study, out: Path | None, by_hand: bool, trials: int, seed: int | None
) -> None:
    """Show a session in a browser, without the lab.

    For co-authors and ethics boards: every screen in the participant's words, with scales and keys, and vibrations as
    sound. --out writes one file, answered by a simulated participant; with --by-hand the keys and the mouse answer.
    Each screen says that it is a rehearsal; nothing is stored in the study.
    """
    if by_hand == (out is not None):
        raise click.UsageError("give --out FILE or --by-hand, one of them")
    if by_hand:
        from feel321.study.monitor.hand import serve_rehearsal

        with _quiet_end("rehearse"):
            serve_rehearsal(study.folder, trials=trials, now=study.now, announce=shared.echo)
        return
    from feel321.study.monitor import replay as replays

    if out is not None:
        replays.check_out(study.folder, out)
        film = replays.rehearse(study.folder, trials=trials, seed=seed, now=study.now)
        write_text(out, replays.write_page(film))
        shared.echo(out)


@contextmanager
def _quiet_end(verb: str) -> Iterator[None]:
    """Take Ctrl-C as the usual end."""
    try:
        yield
    except KeyboardInterrupt:
        shared.echo(f"{verb}: ended", err=True)
