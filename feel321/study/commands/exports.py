"""Verb `export`: a study's data for other programs, one option per format."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared
from feel321.study.folder import StudyFolder

if TYPE_CHECKING:
    from pathlib import Path

EXAMPLE = """\b
Example: feel321 export my-study --bids dataset
         feel321 export my-study --r for-r
         feel321 export --ratings ratings.csv --manifest manifest.csv --r for-r
"""


@click.command(epilog=EXAMPLE)
@shared.folder_argument
@click.option(
    "--r",
    "r_folder",
    metavar="DIR",
    type=shared.FILE,
    help="Folder for R and JASP: judgements as the primary models use them, wide tables, model.R.",
)
@click.option(
    "--bids",
    "bids_folder",
    metavar="DIR",
    type=shared.FILE,
    help="Folder for a dataset to publish: BIDS, Psych-DS and RO-Crate, de-identified.",
)
@shared.flag("--keep-ids", "With --bids: keep the study's codes instead of random numbers.")
@shared.flag("--simulated", "With --bids: simulated participants too, marked as such.")
@shared.flag("--report", "With --bids: the report too; it needs --keep-ids.")
@shared.ratings_option
@shared.manifest_option
@shared.metric_option
def export(  # noqa: PLR0913 - one per option
    folder: Path,
    *,
    r_folder: Path | None,
    bids_folder: Path | None,
    keep_ids: bool,
    simulated: bool,
    report: bool,
    ratings: Path | None,
    manifest: Path | None,
    metrics: tuple[str, ...],
) -> None:
    """Write a study's data for other programs.

    --bids writes a dataset for a repository: judgements, participants, stimuli and a description of every column, in
    folders that the validators of BIDS and Psych-DS accept. Participants get random numbers; personal answers, typed
    texts, notes, days and names of machines are left out. Authors and licence come from [publication] in study.toml.

    --r writes CSV files that R, JASP and jamovi read without options, and model.R, which fits the primary models with
    lme4 and prints their slopes beside those of feel321.
    """
    if (r_folder is None) == (bids_folder is None):
        raise click.UsageError("export needs one format; give --bids DIR or --r DIR")
    if r_folder is None or bids_folder is not None:
        if ratings is not None or metrics:
            raise click.UsageError(
                "--bids exports a whole study; leave out --ratings, --manifest and --metric"
            )
        _export_bids(
            folder, bids_folder or folder, keep_ids=keep_ids, simulated=simulated, report=report
        )
        return
    if keep_ids or simulated or report:
        raise click.UsageError(
            "--keep-ids, --simulated and --report go with --bids; leave them out"
        )
    if manifest is not None and ratings is None:
        raise click.UsageError(
            "--manifest needs --ratings; give both, or --ratings alone in a study"
        )
    from feel321.analysis.export import export_r
    from feel321.study.analyze import read_study_table

    table, seed = read_study_table(
        StudyFolder(folder), ratings=ratings, manifest=manifest, metrics=metrics or None
    )
    with shared.recording(StudyFolder(folder), "export", r_folder):
        export_r(table, r_folder, rng=seed)
    shared.echo(f"{r_folder}: next, in that folder: Rscript model.R")


def _export_bids(
    folder: Path, target: Path, *, keep_ids: bool, simulated: bool, report: bool
) -> None:
    """Write the dataset, and list what `[publication]` lacks."""
    from feel321.study.export.dataset import ExportChoices, export_bids
    from feel321.study.folder import require_study

    choices = ExportChoices(keep_ids=keep_ids, simulated=simulated, report=report)
    study = require_study(folder)
    with shared.recording(study, "export", target):
        for line in export_bids(study, target, choices):
            shared.warn(line)
    shared.echo(f"{target}: check it with: bids-validator-deno {target}")
