"""Verbs of a study: new, check, build, demo, simulate, status, note, withdraw, analyze."""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from feel321 import intake
from feel321.study.commands import shared
from feel321.study.folder import (
    StudyFolder,
    create_study,
    list_bundled,
    read_template,
    require_study,
)
from feel321.study.study import Study

if TYPE_CHECKING:
    from feel321.jobs import Workers

DEMO_PARTICIPANTS = 16


@click.command(
    epilog="""\b
Example: feel321 new my-study
         feel321 new my-study --study park2019
         feel321 new my-study --texts de
         feel321 new --all-settings
"""
)
@click.argument("folder", metavar="[DIR]", type=shared.FILE, required=False)
@click.option("--study", "bundled", type=click.Choice(list_bundled()), help="A ready study.")
@shared.flag("--methods", "Also examples of methods of your own, in methods/.")
@click.option(
    "--texts",
    metavar="LANGUAGE",
    help="Only write the participants' texts, en or de, to texts.toml.",
)
@shared.flag("--all-settings", "Only print every setting, with its default and meaning.")
@click.pass_context
def new(
    context: click.Context,
    *,
    folder: Path | None,
    bundled: str | None,
    methods: bool,
    texts: str | None,
    all_settings: bool,
) -> None:
    """Begin a study: a commented study.toml, ready to use."""
    from feel321.study.folder import add_methods

    if all_settings:
        from feel321.study.all_settings import FILES, write_list

        shared.echo("\n".join(write_list(file) for file in FILES).rstrip("\n"))
        return
    if texts is not None:
        _write_texts(require_study(folder or Path()), texts)
        return
    if folder is None:
        raise click.MissingParameter(ctx=context, param_hint="'DIR'", param_type="argument")
    if bundled and methods:
        raise click.UsageError("--methods adds to a study of your own; leave out --study")
    study = Study.create(folder, like=bundled).folder
    if methods:
        add_methods(study)
    shared.echo(f"{study.settings}: edit it, then: feel321 check {quote(str(folder))}")


def _write_texts(study: StudyFolder, language: str) -> None:
    """Write the participants' texts of a language, each as a comment, for a study that changes some of them."""
    from feel321.doors import check_name
    from feel321.files import create_text
    from feel321.protocols.texts import COPY_FILE, list_languages, write_copy

    check_name(language, list_languages(), "--texts")
    path = study.path / COPY_FILE
    create_text(path, write_copy(language))
    shared.echo(f'{path}: edit it, then in study.toml under [session]: language = "{COPY_FILE}"')


@click.command(
    epilog="""\b
Example: feel321 check my-study
         feel321 check --method mylab.haptics:my321
         feel321 check my-study --method methods/psnr.py:psnr --kind metric
"""
)
@shared.folder_argument
@click.option(
    "--method",
    metavar="NAME",
    help="Check this reducer or metric of your own instead: mylab:my321, methods/my321.py:my321, or its table's name.",
)
@click.option(
    "--kind",
    type=click.Choice(["reducer", "metric"]),
    help="Kind of method.  [default: guessed from its parameters]",
)
@shared.json_option
@click.pass_context
def check(
    context: click.Context, *, folder: Path, method: str | None, kind: str | None, as_json: bool
) -> None:
    """Check everything that a study needs.

    Settings, recordings, strength of the stimuli, rig and stimulus set: every problem is listed at once. With
    --method: whether a reducer or metric of your own meets feel321's requirements.
    """
    if method is not None:
        context.exit(_check_method(folder, method, kind, as_json=as_json))
    study = shared.open_study(folder)
    found = study.check()
    for text in (*shared.cap(found.remarks), *shared.cap(found.warnings)):
        shared.warn(text)
    if as_json:
        shared.print_json({
            "problems": found.problems,
            "warnings": found.warnings,
            "notes": found.notes,
            **found.figures,
        })
    else:
        count = len(found.warnings) + len(found.remarks)
        counted = f", {count} warning{'s' * (count > 1)}" if count else ""
        good = f"{study.folder.path}: no problems{counted}"
        shared.echo("\n".join([*(shared.cap(found.problems) or [good]), *found.notes]))
    context.exit(1 if found.problems else 0)


def _check_method(folder: Path, name: str, kind: str | None, *, as_json: bool) -> int:
    """Check one of the lab's own methods, and print a line for each check."""
    from feel321.stimuli.conform import check_method
    from feel321.study.methods import open_method

    method = open_method(name, folder, kind)
    found = check_method(method)
    failed = sum(not one.passed for one in found)
    if as_json:
        shared.print_json({
            "kind": method.kind, "name": method.name, **method.to_json(), "checks": found, "failed": failed,
        })  # fmt: skip
    else:
        outcome = (
            f"{failed} of {len(found)} checks failed"
            if failed
            else f"all {len(found)} checks passed"
        )
        shared.echo(f"{method.kind} {method.name}: {outcome}")
        for one in found:
            shared.echo(f"  {'ok    ' if one.passed else 'FAILED'}  {one.check}: {one.text}")
    return 1 if failed else 0


@click.command(epilog="Example: feel321 build my-study --workers 2")
@shared.study_argument
@shared.workers_option
@shared.flag("--no-page", "Do not write stimuli/index.html, the page of the set.")
@shared.json_option
def build(*, study: Study, workers: Workers, no_page: bool, as_json: bool) -> None:
    """Build the stimulus set; only what changed is made again.

    Open stimuli/index.html in a browser to see, measure and hear every stimulus.
    """
    from feel321.stimuli.sets.build import find_copies
    from feel321.study.strength import describe_built
    from feel321.study.workflow import build_study

    with shared.show_progress("build") as progress:
        facts, stimuli = build_study(
            study.folder, workers=workers, page=not no_page, progress=progress
        )
    shared.report_warnings(facts)
    for copies in find_copies(facts):
        shared.warn(copies)
    notes = describe_built(study.settings, stimuli)
    count, sha256 = len(stimuli.stimuli), stimuli.sha256
    if as_json:
        folder = str(stimuli.folder)
        shared.print_json({"stimuli": count, "folder": folder, "sha256": sha256, "notes": notes})
    else:
        lines = [f"{stimuli.folder}: {count} stimuli, set {sha256[:12]}", *shared.cap(notes)]
        shared.echo("\n".join(lines))


@click.command(epilog="Example: feel321 demo --out demo-study")
@click.option(
    "--out",
    "folder",
    type=shared.FILE,
    default=Path("demo-study"),
    show_default=True,
    help="Folder of the study.",
)
def demo(folder: Path) -> None:
    """Run a whole study with simulated participants."""
    study = Study(_open_demo(folder), shared.wants_bar(), warn=shared.warn)
    stimuli = study.build()
    shared.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    rows = _simulate(study, DEMO_PARTICIPANTS)
    shared.echo(
        f"{study.folder.ratings}: {rows} ratings of {DEMO_PARTICIPANTS} simulated participants"
    )
    study.analyze()
    shared.print_results(study.folder.report, as_json=False)


def _simulate(study: Study, participants: int, seed: int | None = None) -> int:
    from feel321.study.simulation import (
        simulate_study,  # no pandas: a table of ratings is not wanted
    )

    with shared.show_progress("simulate") as progress:
        return simulate_study(
            study.folder,
            participants=participants,
            seed=seed,
            now=study.now,
            progress=progress,
            warn=shared.warn,
        )


def _open_demo(folder: Path) -> StudyFolder:
    """Begin the demonstration, or resume it; a folder with anything else in it is left alone."""
    from feel321.study.observer.casting import NUMBERED

    study = StudyFolder(folder)
    if not folder.exists() or not any(folder.iterdir()):
        return create_study(folder)
    if not study.settings.is_file():
        raise FileExistsError(
            f"{folder}: holds files that demo did not write; name another folder with --out"
        )
    if intake.read_small(study.settings) != read_template():
        raise FileExistsError(
            f"{study.settings}: edited, or written by another version of feel321, so this is not the study that demo "
            "runs; name another folder with --out, or delete this one"
        )
    if people := [entry.name for entry in study.participants if not NUMBERED.fullmatch(entry.name)]:
        raise FileExistsError(
            f"{folder}: holds a session of {people[0]}, who is no simulated participant; "
            "name another folder with --out"
        )
    return study


# Verbs that run sessions and look after them.


@click.command(epilog="Example: feel321 simulate my-study --participants 16 --seed 1")
@shared.study_argument
@click.option(
    "--participants",
    type=shared.WholeNumber(1, 10_000),
    default=16,
    show_default=True,
    help="Number of simulated participants.",
)
@shared.seed_option(" of the participants")
@shared.json_option
def simulate(*, study: Study, participants: int, seed: int | None, as_json: bool) -> None:
    """Run sessions with simulated participants, or resume them."""
    from feel321.study.simulation import regress_planted

    rows = _simulate(study, participants, seed)
    planted = regress_planted(study.settings, study.stimuli())
    file = str(study.folder.ratings)
    if as_json:
        facts: dict[str, object] = {"participants": participants, "ratings": rows, "file": file}
        facts |= {"planted_reducers": planted.reducers} if planted.reducers else {}
        shared.print_json(facts | {"planted": planted.slopes})
        return
    terms = [f"{slope:.2f} per +0.1 of {metric}" for metric, slope in planted.slopes.items()]
    terms += [f"{points:+.1f} for {reducer}" for reducer, points in planted.reducers.items()]
    shared.echo(f"{file}: {rows} ratings")
    shared.echo(
        f"planted in realism, in points: {', '.join(terms)}"
        if terms
        else "planted: more than the two matches"
    )


@click.command(
    epilog="""\b
Example: feel321 status my-study
         feel321 status my-study --watch sessions.html
"""
)
@shared.study_argument
@shared.flag("--notes", "Also the experimenter's notes (feel321 note).", "with_notes")
@click.option(
    "--watch", "page", type=shared.FILE, metavar="PAGE",
    help="Write a blind page of the running sessions, and renew it until Ctrl-C.",
)  # fmt: skip
@shared.rehearsals_option
@shared.json_option
def status(
    *, study: Study, with_notes: bool, page: Path | None, rehearsals: bool, as_json: bool
) -> None:
    """Show the progress of every participant."""
    study = _choose(study, rehearsals=rehearsals)
    if page is not None:
        from feel321.study.watch import watch_study

        if with_notes or as_json:
            raise click.UsageError("--watch does not go with --notes or --json; leave them out")
        with shared.recording(study.folder, "status", page):
            watch_study(study.folder, page, now=study.now, announce=shared.echo)
        shared.echo("status: ended", err=True)
        return
    state = study.status()
    if as_json:
        shared.print_json(asdict(state))
        return
    notes = state.list_notes() if with_notes else []
    shared.echo("\n".join([state.summary(), *notes]))


@click.command(
    epilog='Example: feel321 note my-study --participant p07 "left coil rattled in block 2"'
)
@click.argument("places", metavar="[STUDY] TEXT", nargs=-1, required=True)
@shared.participant_option
@shared.rehearsals_option
def note(places: tuple[str, ...], *, participant: str, rehearsals: bool) -> None:
    """Write an experimenter's note into a participant's journal.

    One line between two openings of a session or after its end, never while it runs. It is kept like all that was
    recorded: never edited, removed only by withdraw, and it changes the seal of audit. Write no names. Shown by
    status --notes.
    """
    from feel321.study.persons.withdrawal import take_note

    *studies, text = places
    if len(studies) > 1:
        raise click.UsageError(
            f"note takes a study and one text, got {len(places)}; quote the text"
        )
    study = shared.open_study(Path(*studies))
    folder = _choose(study, rehearsals=rehearsals).folder
    if notice := take_note(folder, participant, text, now=study.now):
        shared.warn(notice)
    shared.echo(f"{participant}: noted")


def _choose(study: Study, *, rehearsals: bool) -> Study:
    return replace(study, folder=replace(study.folder, is_rehearsal=rehearsals))


@click.command(
    epilog="""\b
Example: feel321 withdraw my-study --participant p07 --yes
         feel321 withdraw my-study --participant p07 --keep-data
"""
)
@shared.study_argument
@shared.participant_option
@click.option(
    "--reason", default="", help="The reason, kept with the participant's code; write no name."
)
@shared.flag("--keep-data", "Keep what was recorded; only free the design slot.")
@shared.flag("--yes", "Do not ask.", "is_sure")
@click.pass_context
def withdraw(
    context: click.Context,
    *,
    study: Study,
    participant: str,
    reason: str,
    keep_data: bool,
    is_sure: bool,
) -> None:
    """Remove the data of a participant for good, and free the design slot.

    Data go from sessions, rehearsals, tables and results; outputs elsewhere are listed, to be removed by hand. The code
    is not reused. --keep-data, for somebody who will not return: what was recorded stays, the next participant gets the
    slot.
    """
    from feel321.study.persons.withdrawal import release_participant, withdraw_participant

    folder = study.folder
    if keep_data:
        number = release_participant(folder, participant, now=study.now)
        shared.echo(f"{folder.path}: {participant} is released, number {number} is free")
        return
    if not is_sure and not sys.stdin.isatty():
        raise click.UsageError("no terminal to ask for confirmation; add --yes")
    question = f"Remove all data of {participant} in {folder.path} for good?"
    if not is_sure and not click.confirm(question, err=True):
        shared.echo(f"{folder.path}: nothing was removed")
        context.exit(1)
    removed = withdraw_participant(
        folder, participant, now=study.now, reason=reason, warn=shared.warn
    )
    place = folder.sessions / participant
    kept = "; a tombstone keeps the code" if place.exists() else ""
    shared.echo(
        f"{folder.path}: removed {len(removed)} files of {participant}{kept}. "
        "Copies that feel321 did not make must be removed by hand"
    )


EXAMPLE = """\b
Example: feel321 analyze my-study
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --out report
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --metric roughness_match --metric temporal_match
         feel321 analyze my-study --rivals
"""


@click.command(epilog=EXAMPLE)
@shared.folder_argument
@shared.ratings_option
@shared.manifest_option
@shared.out_option("STUDY/report")
@shared.metric_option
@click.option(
    "--rivals",
    is_flag=True,
    help="Also rank all metrics by how well they predict, corrected for how many were tried.",
)
@shared.json_option
def analyze(  # noqa: PLR0913 - one per option
    folder: Path,
    *,
    ratings: Path | None,
    manifest: Path | None,
    out: Path | None,
    metrics: tuple[str, ...],
    rivals: bool,
    as_json: bool,
) -> None:
    """Relate the ratings to the match metrics and write the report.

    Fits the mixed models, correlations with two-way bootstrap intervals, contrasts of reducers, screening of raters
    and all else that the ratings allow. Writes index.html, results.json (every number of the page; --json prints it),
    tables/ and figures/. Metrics, bootstrap draws and margin of equivalence are declared in study.toml, [analysis];
    which way a metric points, its bounds, label and unit in [metrics.NAME].
    """
    if manifest is not None and ratings is None:
        raise click.UsageError(
            "--manifest needs --ratings; give both, or --ratings alone in a study"
        )
    study = StudyFolder(folder)
    if ratings is not None and manifest is None:
        _require_stimuli(study)
    from feel321.study.analyze import analyze_study
    from feel321.study.export.narrative import write_methods

    recording = shared.recording(study, "analyze", out or study.report)
    with shared.show_progress("analyze") as progress, recording:
        analyze_study(
            study,
            ratings=ratings,
            manifest=manifest,
            metrics=metrics or None,
            rivals=rivals,
            out=out,
            progress=progress,
        )
        if ratings is None:
            write_methods(study, out or study.report)
    shared.print_results(out or study.report, as_json=as_json)


def _require_stimuli(study: StudyFolder) -> None:
    """Refuse ratings from elsewhere whose stimuli nothing tells."""
    if not study.settings.is_file():
        raise click.UsageError(
            "--ratings needs the table of the stimuli that were rated: add --manifest FILE, or name the study first"
        )
