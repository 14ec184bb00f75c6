"""Verbs that begin, check and build a study, and the demonstration."""

from __future__ import annotations

from pathlib import Path
from shlex import quote

import click

from study.commands.shared import (
    FILE,
    json_option,
    now,
    print_json,
    report_warnings,
    show_progress,
    study_argument,
    warn,
)
from study.folder import StudyFolder, create_study, list_bundled, read_template

DEMO_PARTICIPANTS = 16


@click.command(epilog="Example: feel321 new my-study --study park2019")
@click.argument("folder", metavar="DIR", type=FILE)
@click.option("--study", "bundled", type=click.Choice(list_bundled()), help="A published study to run again.")
def new(folder: Path, *, bundled: str | None) -> None:
    """Begin a study: a commented study.toml that works as it is."""
    study = create_study(folder, bundled=bundled)
    click.echo(f"{study.settings}: edit it, then: feel321 check {quote(str(folder))}")


@click.command(epilog="Example: feel321 check my-study")
@study_argument
@json_option
@click.pass_context
def check(context: click.Context, *, study: StudyFolder, as_json: bool) -> None:
    """Check settings, recordings, strength of the stimuli, rig and stimulus set, all at once."""
    from study.check import check_study, find_warnings

    with show_progress("check") as progress:
        recordings, problems, strength = check_study(study, progress=progress)
    report_warnings(recordings)
    warnings = [*strength.warnings, *([] if problems else find_warnings(study))]
    for warning in warnings:
        warn(warning)
    if as_json:
        print_json({"problems": problems, "warnings": warnings, "notes": strength.notes, **strength.figures})
    else:
        count = len(warnings) + sum(len(recording.warnings) for recording in recordings)
        good = f"{study.path}: no problems" + (f", {count} warning{'s' * (count > 1)}" if count else "")
        click.echo("\n".join([*(problems or [good]), *strength.notes]))
    context.exit(1 if problems else 0)


@click.command(epilog="Example: feel321 build my-study --workers 2")
@study_argument
@click.option("--workers", type=click.IntRange(min=1), default=1, show_default=True, help="Number of processes.")
@json_option
def build(*, study: StudyFolder, workers: int, as_json: bool) -> None:
    """Build the stimulus set; only what changed is made again."""
    from study.strength import describe_built
    from study.workflow import build_study

    with show_progress("build") as progress:
        recordings, stimuli = build_study(study, workers=workers, progress=progress)
    report_warnings(recordings)
    notes = describe_built(study.settings, recordings, stimuli)
    summary = {"stimuli": len(stimuli.stimuli), "folder": str(stimuli.folder), "sha256": stimuli.sha256}
    if as_json:
        print_json({**summary, "notes": notes})
    else:
        click.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli, set {stimuli.sha256[:12]}")
        for note in notes:
            click.echo(note)


@click.command(epilog="Example: feel321 demo --dir demo-study")
@click.option("--dir", "folder", type=FILE, default=Path("demo-study"), show_default=True, help="Where it goes.")
def demo(folder: Path) -> None:
    """Run the whole chain with simulated participants."""
    from study.workflow import analyze_study, build_study, simulate_study

    study = _open_demo(folder)
    with show_progress("build") as progress:
        _, stimuli = build_study(study, progress=progress)
    click.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    with show_progress("simulate") as progress:
        rows = simulate_study(study, participants=DEMO_PARTICIPANTS, seed=None, now=now, progress=progress, warn=warn)
    click.echo(f"{study.ratings}: {rows} ratings of {DEMO_PARTICIPANTS} simulated participants")
    click.echo(analyze_study(study) / "index.html")


def _open_demo(folder: Path) -> StudyFolder:
    """Begin the demonstration, or go on with one; anybody else's folder is left alone."""
    from study.casting import NUMBERED

    study = StudyFolder(folder)
    if not folder.exists() or not any(folder.iterdir()):
        return create_study(folder)
    if not study.settings.is_file() or study.settings.read_text(encoding="utf-8") != read_template():
        raise FileExistsError(f"{folder}: holds files that demo did not write; name another folder with --dir")
    if people := [entry.name for entry in study.participants if not NUMBERED.fullmatch(entry.name)]:
        told = f"{folder}: got {people[0]}, who is no simulated participant; name another folder with --dir"
        raise FileExistsError(told)
    return study
