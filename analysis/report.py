"""The report: a page, its numbers, its tables and its figures, all derived from two CSV files."""

from __future__ import annotations

import hashlib
import platform
import tempfile
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from analysis.findings import analyse, make_tables
from analysis.how import tell_how
from analysis.page import render_page
from analysis.pictures import Picture, draw_pictures, note_undrawable
from analysis.replacing import list_files, replace_report
from analysis.results import Results, collect_notes, collect_numbers
from analysis.figures.files import save_figure
from analysis.table import read_table
from analysis.verdict import write_verdict

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pandas import DataFrame

COMPUTED_WITH = ("numpy", "scipy", "pandas", "matplotlib", "jinja2")


def write_report(
    ratings_path: Path | str, manifest_path: Path | str, folder: Path | str, *, draws: int = 2000, seed: int
) -> Results:
    """Analyse ratings against the match metrics and write the report.

    Parameters
    ----------
    ratings_path : Path or str
        ``ratings.csv``, from feel321 or from elsewhere.
    manifest_path : Path or str
        ``manifest.csv`` of the stimuli that were rated.
    folder : Path or str
        The report's folder. The files of a former report, which its ``results.json`` lists, are replaced;
        all others stay.
    draws : int
        Bootstrap draws per interval, at least 2.
    seed : int
        Seed of the draws; the same files and seed give the same bytes.

    Returns
    -------
    Results
        What ``results.json`` holds.

    Raises
    ------
    ValueError
        If the tables cannot be analysed; names the file and the lines.
    OSError
        If a file cannot be read or written, or would replace one that is not of a former report.
    """
    ratings, manifest, target = Path(ratings_path), Path(manifest_path), Path(folder)
    table = read_table(ratings, manifest)
    findings = analyse(table, draws=draws, rng=np.random.default_rng(seed))
    pictures, tables = draw_pictures(table, findings), make_tables(findings)
    results = Results(
        verdict=write_verdict(findings),
        numbers=collect_numbers(table, findings),
        figures={picture.name: picture.caption for picture in pictures},
        notes=(*collect_notes(table, findings), *note_undrawable(table)),
        how=tell_how(draws, associated=bool(findings.panels)),
        files=list_files([picture.name for picture in pictures], tables),
        simulated=bool(table.rows["simulated"].any()),
        inputs={
            **_describe_file("ratings", ratings), **_describe_file("manifest", manifest),
            "seed": str(seed), "draws": str(draws),
        },
        versions=_list_versions(),
    )
    target.parent.mkdir(parents=True, exist_ok=True)
    # Everything is written beside its place first: an interrupted run leaves the former report as it was.
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as place:
        _write_parts(Path(place), results=results, pictures=pictures, tables=tables)
        page = render_page(results, findings, pictures=pictures, figures=Path(place) / "figures")
        (Path(place) / "index.html").write_text(page, encoding="utf-8", newline="")
        replace_report(Path(place), target, files=results.files)
    return results


def _write_parts(
    place: Path, *, results: Results, pictures: Sequence[Picture], tables: Mapping[str, DataFrame]
) -> None:
    (place / "tables").mkdir()
    for name, frame in tables.items():
        text = frame.to_csv(index=False, float_format="%.10g", lineterminator="\n")
        (place / "tables" / f"{name}.csv").write_text(text, encoding="utf-8", newline="")
    (place / "figures").mkdir()
    for picture in pictures:
        save_figure(picture.figure, place / "figures" / picture.name)
    (place / "results.json").write_text(results.to_json(), encoding="utf-8", newline="")


def _describe_file(role: str, path: Path) -> Mapping[str, str]:
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return {role: path.name, f"{role}_sha256": digest}


def _list_versions() -> dict[str, str]:
    from stimuli.version import __version__

    libraries = {name: version(name) for name in COMPUTED_WITH}
    return {"feel321": __version__, "python": platform.python_version(), **libraries}
