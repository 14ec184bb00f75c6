"""Verbs of a study: new, check, build, demo, simulate, status, audit, ledger, release, withdraw, analyze."""

from __future__ import annotations

import sys
from dataclasses import asdict, replace
from pathlib import Path
from shlex import quote
from typing import TYPE_CHECKING

import click

from feel321.study.commands.shared import (
    FILE,
    find_study,
    json_option,
    now,
    print_json,
    report_warnings,
    show_progress,
    study_argument,
    warn,
)
from feel321.study.folder import StudyFolder, create_study, list_bundled, read_template

if TYPE_CHECKING:
    from collections.abc import Sequence

    from feel321.study.settings.schema import AnalysisTable
    from feel321.study.status import Progress

# Verbs that begin, check and build a study, and the demonstration.

DEMO_PARTICIPANTS = 16


@click.command(epilog="Example: feel321 new my-study --study park2019")
@click.argument("folder", metavar="DIR", type=FILE)
@click.option(
    "--study", "bundled", type=click.Choice(list_bundled()), help="A published study to run again."
)
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
    from feel321.study.workflow import check_study, find_warnings

    with show_progress("check") as progress:
        recordings, problems, strength = check_study(study, progress=progress)
    report_warnings(recordings)
    warnings = [*strength.warnings, *([] if problems else find_warnings(study))]
    for warning in warnings:
        warn(warning)
    if as_json:
        print_json({
            "problems": problems,
            "warnings": warnings,
            "notes": strength.notes,
            **strength.figures,
        })
    else:
        count = len(warnings) + sum(len(recording.warnings) for recording in recordings)
        good = f"{study.path}: no problems" + (
            f", {count} warning{'s' * (count > 1)}" if count else ""
        )
        click.echo("\n".join([*(problems or [good]), *strength.notes]))
    context.exit(1 if problems else 0)


@click.command(epilog="Example: feel321 build my-study --workers 2")
@study_argument
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    default=1,
    show_default=True,
    help="Number of processes.",
)
@json_option
def build(*, study: StudyFolder, workers: int, as_json: bool) -> None:
    """Build the stimulus set; only what changed is made again."""
    from feel321.study.strength import describe_built
    from feel321.study.workflow import build_study

    with show_progress("build") as progress:
        recordings, stimuli = build_study(study, workers=workers, progress=progress)
    report_warnings(recordings)
    notes = describe_built(study.settings, recordings, stimuli)
    summary = {
        "stimuli": len(stimuli.stimuli),
        "folder": str(stimuli.folder),
        "sha256": stimuli.sha256,
    }
    if as_json:
        print_json({**summary, "notes": notes})
    else:
        click.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli, set {stimuli.sha256[:12]}")
        for note in notes:
            click.echo(note)


@click.command(epilog="Example: feel321 demo --dir demo-study")
@click.option(
    "--dir",
    "folder",
    type=FILE,
    default=Path("demo-study"),
    show_default=True,
    help="Where it goes.",
)
def demo(folder: Path) -> None:
    """Run the whole chain with simulated participants."""
    from feel321.study.analyze import analyze_study
    from feel321.study.workflow import build_study, simulate_study

    study = _open_demo(folder)
    with show_progress("build") as progress:
        _, stimuli = build_study(study, progress=progress)
    click.echo(f"{stimuli.folder}: {len(stimuli.stimuli)} stimuli")
    with show_progress("simulate") as progress:
        rows = simulate_study(
            study, participants=DEMO_PARTICIPANTS, seed=None, now=now, progress=progress, warn=warn
        )
    click.echo(f"{study.ratings}: {rows} ratings of {DEMO_PARTICIPANTS} simulated participants")
    click.echo(analyze_study(study) / "index.html")


def _open_demo(folder: Path) -> StudyFolder:
    """Begin the demonstration, or go on with one; anybody else's folder is left alone."""
    from feel321.study.sessions import NUMBERED

    study = StudyFolder(folder)
    if not folder.exists() or not any(folder.iterdir()):
        return create_study(folder)
    if (
        not study.settings.is_file()
        or study.settings.read_text(encoding="utf-8") != read_template()
    ):
        raise FileExistsError(
            f"{folder}: holds files that demo did not write; name another folder with --dir"
        )
    if people := [entry.name for entry in study.participants if not NUMBERED.fullmatch(entry.name)]:
        told = f"{folder}: got {people[0]}, who is no simulated participant; name another folder with --dir"
        raise FileExistsError(told)
    return study


# Verbs that run sessions and look after them.


@click.command(epilog="Example: feel321 simulate my-study --participants 16 --seed 1")
@study_argument
@click.option(
    "--participants",
    type=click.IntRange(1, 10_000),
    default=16,
    show_default=True,
    help="How many take part.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), help="Seed of the participants.  [default: the study's]"
)
@json_option
def simulate(*, study: StudyFolder, participants: int, seed: int | None, as_json: bool) -> None:
    """Run sessions with simulated participants, or resume them."""
    from feel321.stimuli.sets.manifest import read_stimuli
    from feel321.study.sessions import find_planted
    from feel321.study.settings.read import read_settings
    from feel321.study.workflow import simulate_study

    with show_progress("simulate") as progress:
        rows = simulate_study(
            study, participants=participants, seed=seed, now=now, progress=progress, warn=warn
        )
    planted = find_planted(read_settings(study.settings), read_stimuli(study.stimuli))
    if as_json:
        facts = {
            "participants": participants,
            "ratings": rows,
            "file": str(study.ratings),
            "planted": planted,
        }
        print_json(facts)
    else:
        click.echo(f"{study.ratings}: {rows} ratings")
        told = ", ".join(f"{slope:.2f} per +0.1 of {metric}" for metric, slope in planted.items())
        click.echo(
            f"planted in realism, in points: {told}"
            if planted
            else "planted: more than the two matches"
        )


_rehearsals_option = click.option(
    "--rehearsals", is_flag=True, help="Those of run --rehearse instead."
)


@click.command(epilog="Example: feel321 status my-study")
@study_argument
@_rehearsals_option
@json_option
def status(*, study: StudyFolder, rehearsals: bool, as_json: bool) -> None:
    """Show how far every participant has come."""
    from feel321.study.status import describe_balance, read_status

    with show_progress("status") as progress:
        state = read_status(replace(study, is_rehearsal=rehearsals), progress=progress)
    if as_json:
        print_json(asdict(state))
        return
    click.echo(f"{'participant':<14}{'state':<11}{'done':>5}{'left':>6}  last activity")
    for entry in state.participants:
        click.echo(_describe(entry))
        for warning in entry.warnings:
            click.echo(f"{'':<14}{warning}")
    click.echo("\n".join(describe_balance(state.balance)))


def _describe(entry: Progress) -> str:
    if entry.problem:
        return f"{entry.participant:<14}{'?':<11}{'?':>5}{'?':>6}  {entry.problem}"
    notes = "; ".join(filter(None, ("simulated" if entry.simulated else "", entry.groups)))
    tail = f"  {entry.last_activity}{f' ({notes})' if notes else ''}".rstrip()
    return f"{entry.participant:<14}{entry.state:<11}{entry.done:>5}{entry.left:>6}{tail}"


@click.command(epilog="Example: feel321 audit my-study --expect 5fe2c1...")
@study_argument
@click.option(
    "--expect",
    metavar="DIGEST",
    help="The seal that an earlier audit printed; fail if it is another now.",
)
@_rehearsals_option
@json_option
@click.pass_context
def audit(
    context: click.Context,
    *,
    study: StudyFolder,
    expect: str | None,
    rehearsals: bool,
    as_json: bool,
) -> None:
    """Verify plans, journals and stimuli; name every change."""
    from feel321.study.audit import audit_study, make_seal

    study = replace(study, is_rehearsal=rehearsals)
    with show_progress("audit") as progress:
        findings = audit_study(study, progress=progress)
    seal = make_seal(study)
    if expect not in {None, seal}:
        findings.append(
            f"{study.path}: got seal {seal}, expected {expect}; something was recorded or changed since"
        )
    if as_json:
        print_json({"findings": findings, "seal": seal})
    else:
        count = len(study.journals)
        click.echo(
            "\n".join(findings) or f"{study.path}: {count} journals, all as they were written"
        )
        click.echo(f"seal: {seal}; keep it elsewhere")
    context.exit(1 if findings else 0)


# Verbs that look after who takes part.

participant_option = click.option(
    "--participant", metavar="ID", required=True, help="The participant's code."
)


@click.command(epilog="Example: feel321 withdraw my-study --participant p07 --yes")
@study_argument
@participant_option
@click.option("--reason", default="", help="Why, for the tombstone.")
@click.option("--yes", "is_sure", is_flag=True, help="Do not ask.")
@click.pass_context
def withdraw(
    context: click.Context, *, study: StudyFolder, participant: str, reason: str, is_sure: bool
) -> None:
    """Remove the data of one participant for good; the code stays taken, the slot is free."""
    from feel321.study.ledger.withdrawal import withdraw_participant

    if not is_sure and not _ask(f"Remove all data of {participant} in {study.path} for good?"):
        click.echo(f"{study.path}: nothing was removed")
        context.exit(1)
    removed = withdraw_participant(study, participant, now=now, reason=reason, warn=warn)
    click.echo(
        f"{study.sessions / participant}: removed {len(removed)} files; a tombstone keeps the code"
    )


@click.command(epilog="Example: feel321 release my-study --participant p07")
@study_argument
@participant_option
def release(*, study: StudyFolder, participant: str) -> None:
    """Give up one participant who will not come back: data stay, the next one gets the slot."""
    from feel321.study.ledger.withdrawal import release_participant

    number = release_participant(study, participant, now=now)
    click.echo(f"{study.path}: {participant} is released, number {number} is free")


@click.command(epilog="Example: feel321 ledger my-study")
@study_argument
@click.option("--rebuild", is_flag=True, help="Make it anew from plans, journals and tombstones.")
@json_option
def ledger(*, study: StudyFolder, rebuild: bool, as_json: bool) -> None:
    """Show who takes part under which number; rebuild the ledger."""
    from feel321.study.ledger.slots import read_study_ledger, rebuild_ledger

    for line in rebuild_ledger(study, now=now) if rebuild else []:
        warn(line)
    entries = read_study_ledger(study)
    if as_json:
        print_json([asdict(entry) for entry in entries])
        return
    click.echo(f"{'number':>6}  {'participant':<16}{'state':<12}{'done':>5} of")
    for entry in entries:
        mark = " (simulated)" if entry.simulated else ""
        click.echo(
            f"{entry.number:>6}  {entry.participant:<16}{entry.state:<12}{entry.done:>5} {entry.total}{mark}"
        )


def _ask(question: str) -> bool:
    if not sys.stdin.isatty():
        raise click.UsageError("got no terminal to ask on; if it is meant for good, say --yes")
    return click.confirm(question, err=True)


# The verb that sets ratings against metrics.

EXAMPLE = """\b
Example: feel321 analyze my-study
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --out report
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --metric roughness_match --metric temporal_match
"""


@click.command(epilog=EXAMPLE)
@click.argument("folder", metavar="[STUDY]", default=Path(), type=FILE)
@click.option(
    "--ratings", type=FILE, help="Ratings from elsewhere; with --manifest, no study is needed."
)
@click.option("--manifest", type=FILE, help="The stimuli that were rated.  [default: the study's]")
@click.option("--out", type=FILE, help="Folder of the report.  [default: report/ in the study]")
@click.option(
    "--metric",
    "metrics",
    multiple=True,
    metavar="NAME",
    help="A numeric column of the manifest as a metric of the primary analysis; repeatable.  [default: as declared]",
)
@json_option
def analyze(
    folder: Path,
    *,
    ratings: Path | None,
    manifest: Path | None,
    out: Path | None,
    metrics: tuple[str, ...],
    as_json: bool,
) -> None:
    """Relate the ratings to the match metrics and write the report.

    Fits the mixed models, correlations with two-way bootstrap intervals, contrasts of reducers, screening of raters
    and all else that the ratings allow. Writes index.html, results.json (every number of the page; --json prints it),
    tables/ and figures/. Metrics, bootstrap draws and margin of equivalence are declared in study.toml, [analysis].
    """
    if ratings is None and manifest is None:
        from feel321.study.analyze import analyze_study

        study = find_study(folder)
        with show_progress("analyze") as progress:
            report = analyze_study(study, metrics=metrics or None, out=out, progress=progress)
    else:
        report = _analyze_tables(
            folder, ratings=ratings, manifest=manifest, out=out, metrics=metrics
        )
    if as_json:
        click.echo((report / "results.json").read_text(encoding="utf-8"))
    else:
        click.echo(report / "index.html")


def _analyze_tables(
    folder: Path,
    *,
    ratings: Path | None,
    manifest: Path | None,
    out: Path | None,
    metrics: Sequence[str],
) -> Path:
    from feel321.analysis.report.write import write_report

    if ratings is None:
        raise click.UsageError(
            "--manifest: got it without --ratings; give both, or --ratings alone in a study"
        )
    if manifest is None:
        manifest = find_study(folder).manifest
    report = out or folder / "report"
    chosen, seed, origins = _read_choices(folder)
    with show_progress("analyze") as progress:
        write_report(
            ratings,
            manifest,
            report,
            draws=chosen.draws,
            margin=chosen.margin,
            metrics=metrics or chosen.metrics,
            sources=origins,
            seed=seed,
            progress=progress,
        )
    return report


def _read_choices(folder: Path) -> tuple[AnalysisTable, int, dict[str, str]]:
    """Read how a study is analysed; tables from elsewhere are analysed with the defaults."""
    from feel321.study.settings.read import list_origins, read_settings
    from feel321.study.settings.schema import AnalysisTable

    study = StudyFolder(folder)
    if not study.settings.is_file():
        return AnalysisTable(), 0, {}
    settings = read_settings(study.settings)
    return settings.analysis, settings.study.seed, list_origins(settings)
