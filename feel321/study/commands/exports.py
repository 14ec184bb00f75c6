"""Verb `export`: a study's data for others."""

from __future__ import annotations

from pathlib import Path

import click

from feel321.study.commands import shared

EXAMPLE = """\b
Example: feel321 export my-study dataset
         feel321 export my-study for-r --r
"""


@click.command(epilog=EXAMPLE)
@click.argument("places", metavar="[STUDY] DIR", nargs=-1, required=True, type=shared.FILE)
@shared.flag("--keep-ids", "Keep the study's codes of participants instead of random numbers.")
@shared.flag("--simulated", "Simulated participants too, marked as such.")
@shared.flag("--r", "Write for R and JASP instead: judgements, wide tables, and model.R.", "for_r")
def export(places: tuple[Path, ...], *, keep_ids: bool, simulated: bool, for_r: bool) -> None:
    """Write a study's data for others, into the folder DIR.

    Writes a BIDS dataset for a repository: judgements, participants, stimuli, a description of every column, and the
    methods section. Participants get random numbers; personal answers, typed texts, notes, days and names of machines
    are left out. Authors and licence come from [publication] in study.toml.

    --r writes CSV files that R, JASP and jamovi read without options, and model.R, which fits the primary models with
    lme4 and prints their slopes beside those of feel321. They hold the study's codes of participants.
    """
    *studies, target = places
    if len(studies) > 1:
        raise click.UsageError(f"export takes a study and a folder, got {len(places)} names")
    if for_r and (keep_ids or simulated):
        raise click.UsageError("--keep-ids and --simulated are for BIDS; leave them out with --r")
    from feel321.analysis.export import export_r
    from feel321.study.analyze import read_study_table
    from feel321.study.export.dataset import export_bids
    from feel321.study.folder import require_study

    if not studies and (target / "study.toml").is_file():
        need = f"name the folder to write, too: feel321 export {target} DIR"
        raise click.UsageError(f"{target} is a study; {need}")
    study = require_study(studies[0] if studies else Path())
    with shared.recording(study, "export", target):
        if for_r:
            table, seed = read_study_table(study)
            if "simulated" in table.rows and table.rows["simulated"].any():
                shared.warn(
                    "ratings of simulated participants are among these; see the column simulated"
                )
            export_r(table, target, rng=seed)
            shared.echo(f"{target}: next, in that folder: Rscript model.R")
            return
        for line in export_bids(study, target, keep_ids=keep_ids, simulated=simulated):
            shared.warn(line)
    shared.echo(f"{target}: check it with: bids-validator-deno {target}")
