"""Verb `export`: a study's data for other programs, one option per format."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from feel321.study.commands import shared
from feel321.study.folder import StudyFolder

if TYPE_CHECKING:
    from pathlib import Path

EXAMPLE = """\b
Example: feel321 export my-study --r for-r
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
@shared.ratings_option
@shared.manifest_option
@shared.metric_option
def export(
    folder: Path,
    *,
    r_folder: Path | None,
    ratings: Path | None,
    manifest: Path | None,
    metrics: tuple[str, ...],
) -> None:
    """Write a study's data for other programs.

    --r writes CSV files that R, JASP and jamovi read without options, and model.R, which fits the primary models with
    lme4 and prints their slopes beside those of feel321.
    """
    if r_folder is None:
        raise click.UsageError("export needs a format; give --r DIR")
    if manifest is not None and ratings is None:
        raise click.UsageError(
            "--manifest needs --ratings; give both, or --ratings alone in a study"
        )
    from feel321.analysis.export import export_r
    from feel321.study.analyze import read_study_table

    table, seed = read_study_table(
        StudyFolder(folder), ratings=ratings, manifest=manifest, metrics=metrics or None
    )
    shared.echo(f"{export_r(table, r_folder, rng=seed)}: next, in that folder: Rscript model.R")
