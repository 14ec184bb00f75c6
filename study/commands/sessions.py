"""Verbs that run sessions and look after them."""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import TYPE_CHECKING

import click

from study.commands.shared import json_option, now, print_json, show_progress, study_argument, warn

if TYPE_CHECKING:
    from study.folder import StudyFolder
    from study.status import Progress


@click.command(epilog="Example: feel321 simulate my-study --participants 16 --seed 1")
@study_argument
@click.option(
    "--participants", type=click.IntRange(1, 10_000), default=16, show_default=True, help="How many take part."
)
@click.option("--seed", type=click.IntRange(min=0), help="Seed of the participants.  [default: the study's]")
@json_option
def simulate(*, study: StudyFolder, participants: int, seed: int | None, as_json: bool) -> None:
    """Run sessions with simulated participants, or resume them."""
    from stimuli.manifest import read_stimuli
    from study.casting import find_planted
    from study.settings.reading import read_settings
    from study.workflow import simulate_study

    with show_progress("simulate") as progress:
        rows = simulate_study(study, participants=participants, seed=seed, now=now, progress=progress, warn=warn)
    planted = find_planted(read_settings(study.settings), read_stimuli(study.stimuli))
    if as_json:
        facts = {"participants": participants, "ratings": rows, "file": str(study.ratings), "planted": planted}
        print_json(facts)
    else:
        click.echo(f"{study.ratings}: {rows} ratings")
        told = ", ".join(f"{slope:.2f} per +0.1 of {metric}" for metric, slope in planted.items())
        click.echo(f"planted in realism, in points: {told}" if planted else "planted: more than the two matches")


_rehearsals_option = click.option("--rehearsals", is_flag=True, help="Those of run --rehearse instead.")


@click.command(epilog="Example: feel321 status my-study")
@study_argument
@_rehearsals_option
@json_option
def status(*, study: StudyFolder, rehearsals: bool, as_json: bool) -> None:
    """Show how far every participant has come."""
    from study.realised import describe_balance
    from study.status import read_status

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
@click.option("--expect", metavar="DIGEST", help="The seal that an earlier audit printed; fail if it is another now.")
@_rehearsals_option
@json_option
@click.pass_context
def audit(
    context: click.Context, *, study: StudyFolder, expect: str | None, rehearsals: bool, as_json: bool
) -> None:
    """Verify plans, journals and stimuli; name every change."""
    from study.audit import audit_study
    from study.auditing.seal import make_seal

    study = replace(study, is_rehearsal=rehearsals)
    with show_progress("audit") as progress:
        findings = audit_study(study, progress=progress)
    seal = make_seal(study)
    if expect not in {None, seal}:
        findings.append(f"{study.path}: got seal {seal}, expected {expect}; something was recorded or changed since")
    if as_json:
        print_json({"findings": findings, "seal": seal})
    else:
        count = len(study.journals)
        click.echo("\n".join(findings) or f"{study.path}: {count} journals, all as they were written")
        click.echo(f"seal: {seal}; keep it elsewhere")
    context.exit(1 if findings else 0)
