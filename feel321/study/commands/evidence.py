"""Verbs that keep evidence: freeze."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared

if TYPE_CHECKING:
    from feel321.study.study import Study


@click.command(
    epilog="""\b
Example: feel321 freeze my-study
         feel321 freeze my-study --because "one recording was too weak to feel"
         feel321 freeze my-study --text > preregistration.md
"""
)
@shared.study_argument
@click.option(
    "--because", default="", metavar="TEXT", help="Why choices change that were frozen before."
)
@click.option(
    "--participants",
    type=click.IntRange(1, 100_000),
    help="Planned number of participants.  [default: as power says]",
)
@shared.flag(
    "--after-data",
    "Freeze although people have rated; every result is then exploratory.",
    "after_data",
)
@shared.flag("--show", "Only show what is frozen, and what has changed since.", "only_show")
@shared.flag(
    "--text", "Print the text of a pre-registration, for OSF, and write nothing.", "as_text"
)
@shared.json_option
def freeze(  # noqa: PLR0913 - one per option
    *,
    study: Study,
    because: str,
    participants: int | None,
    after_data: bool,
    only_show: bool,
    as_text: bool,
    as_json: bool,
) -> None:
    """Freeze hypotheses, design and analysis before the first rating is seen.

    Writes frozen.json: design, stimuli, protocols, metrics, rules, seeds and hypotheses, with their digests. analyze
    then marks results as confirmatory or exploratory, and names every choice that was changed. Freezing again before
    the first rating keeps the former state as history and asks for a reason. Ratings are counted, never shown.
    """
    from feel321.study.freezing import freeze as freezing
    from feel321.study.freezing import text

    if only_show or as_text:
        state = freezing.compare_now(study.folder, participants=participants)
        if as_json:
            shared.print_json(text.describe_json(state))
        else:
            shared.echo(text.write_registration(state) if as_text else text.write_state(state))
        return
    frozen, changes = freezing.freeze_study(
        study.folder,
        now=study.now,
        because=because,
        after_data=after_data,
        participants=participants,
    )
    state = replace(freezing.compare_now(study.folder), changes=tuple(changes))
    if as_json:
        shared.print_json(text.describe_json(state))
        return
    shared.echo(
        "\n".join([
            *changes,
            f"{study.folder.path / 'frozen.json'}: {text.describe_written(frozen)}",
        ])
    )
