"""The verb that sets ratings against metrics."""

from __future__ import annotations

from pathlib import Path

import click

from study.commands.shared import FILE, find_study, json_option
from study.folder import StudyFolder


@click.command(epilog="Example: feel321 analyze my-study")
@click.argument("folder", metavar="[STUDY]", default=Path(), type=FILE)
@click.option("--ratings", type=FILE, help="Ratings from elsewhere; with --manifest, no study is needed.")
@click.option("--manifest", type=FILE, help="The stimuli that were rated.  [default: the study's]")
@click.option("--out", type=FILE, help="Folder of the report.  [default: report/ in the study]")
@json_option
def analyze(folder: Path, *, ratings: Path | None, manifest: Path | None, out: Path | None, as_json: bool) -> None:
    """Set the ratings against both match metrics and write the report."""
    if ratings is None and manifest is None:
        from study.workflow import analyze_study

        report = analyze_study(find_study(folder), out=out)
    else:
        report = _analyze_tables(folder, ratings=ratings, manifest=manifest, out=out)
    if as_json:
        click.echo((report / "results.json").read_text(encoding="utf-8"))
    else:
        click.echo(report / "index.html")


def _analyze_tables(folder: Path, *, ratings: Path | None, manifest: Path | None, out: Path | None) -> Path:
    from analysis.report import write_report

    if ratings is None:
        raise click.UsageError("--manifest: got it without --ratings; give both, or --ratings alone in a study")
    if manifest is None:
        manifest = find_study(folder).manifest
    report = out or folder / "report"
    write_report(ratings, manifest, report, **_read_choices(folder))
    return report


def _read_choices(folder: Path) -> dict[str, int]:
    """Read how a study is analysed; tables from elsewhere are analysed with the defaults."""
    from study.settings.reading import read_settings
    from study.settings.tables import AnalysisTable

    study = StudyFolder(folder)
    if not study.settings.is_file():
        return {"draws": AnalysisTable().draws, "seed": 0}
    settings = read_settings(study.settings)
    return {"draws": settings.analysis.draws, "seed": settings.study.seed}
