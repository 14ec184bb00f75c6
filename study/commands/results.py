"""The verb that sets ratings against metrics."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from study.commands.shared import FILE, find_study, json_option, show_progress
from study.folder import StudyFolder

if TYPE_CHECKING:
    from collections.abc import Sequence

    from study.settings.tables import AnalysisTable

EXAMPLE = """\b
Example: feel321 analyze my-study
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --out report
         feel321 analyze --ratings ratings.csv --manifest manifest.csv --metric roughness_match --metric temporal_match
"""


@click.command(epilog=EXAMPLE)
@click.argument("folder", metavar="[STUDY]", default=Path(), type=FILE)
@click.option("--ratings", type=FILE, help="Ratings from elsewhere; with --manifest, no study is needed.")
@click.option("--manifest", type=FILE, help="The stimuli that were rated.  [default: the study's]")
@click.option("--out", type=FILE, help="Folder of the report.  [default: report/ in the study]")
@click.option(
    "--metric", "metrics", multiple=True, metavar="NAME",
    help="A numeric column of the manifest as a metric of the primary analysis; repeatable.  [default: as declared]",
)  # fmt: skip
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
        from study.workflow import analyze_study

        study = find_study(folder)
        with show_progress("analyze") as progress:
            report = analyze_study(study, metrics=metrics or None, out=out, progress=progress)
    else:
        report = _analyze_tables(folder, ratings=ratings, manifest=manifest, out=out, metrics=metrics)
    if as_json:
        click.echo((report / "results.json").read_text(encoding="utf-8"))
    else:
        click.echo(report / "index.html")


def _analyze_tables(
    folder: Path, *, ratings: Path | None, manifest: Path | None, out: Path | None, metrics: Sequence[str]
) -> Path:
    from analysis.report.write import write_report

    if ratings is None:
        raise click.UsageError("--manifest: got it without --ratings; give both, or --ratings alone in a study")
    if manifest is None:
        manifest = find_study(folder).manifest
    report = out or folder / "report"
    chosen, seed, origins = _read_choices(folder)
    with show_progress("analyze") as progress:
        write_report(
            ratings, manifest, report, draws=chosen.draws, margin=chosen.margin, metrics=metrics or chosen.metrics,
            sources=origins, seed=seed, progress=progress,
        )  # fmt: skip
    return report


def _read_choices(folder: Path) -> tuple[AnalysisTable, int, dict[str, str]]:
    """Read how a study is analysed; tables from elsewhere are analysed with the defaults."""
    from study.settings.reading import read_settings
    from study.settings.sources import list_origins
    from study.settings.tables import AnalysisTable

    study = StudyFolder(folder)
    if not study.settings.is_file():
        return AnalysisTable(), 0, {}
    settings = read_settings(study.settings)
    return settings.analysis, settings.study.seed, list_origins(settings)
