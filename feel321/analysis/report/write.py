"""Write a report: page, numbers, tables and figures, all derived from two CSV files."""

from __future__ import annotations

import hashlib
import json
import platform
import tempfile
from dataclasses import asdict, replace
from importlib.metadata import version
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

from feel321.analysis.association.correlate import refuse_untested
from feel321.analysis.figures.style import save_figure
from feel321.analysis.report import (
    association,
    pairs,
    primary,
    raters,
    reducers,
    robustness,
    standard,
)
from feel321.analysis.report.association import name_subject, reconcile
from feel321.analysis.report.folder import (
    Results,
    check_target,
    collect_numbers,
    list_files,
    replace_report,
)
from feel321.analysis.report.page import render_page
from feel321.analysis.report.pictures import note_undrawable, number_pictures
from feel321.analysis.report.section import Choices
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table.items import find_sources, tell_recordings
from feel321.analysis.table.reading import ROSTER_FILE, read_table
from feel321.analysis.words import Line, tell_note

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from feel321.analysis.report.section import Section
    from feel321.analysis.table.reading import Further, Table

# What a report was made from: files, choices and what was handed over, each with its digest, for ``results.json``.


def describe_inputs(
    ratings: Path, manifest: Path, *, table: Table, further: Further | None, choices: Choices
) -> dict[str, str]:
    """Describe everything that decides a report."""
    roster = ratings.with_name(ROSTER_FILE)
    return {
        **_describe_file("ratings", ratings),
        **_describe_file("manifest", manifest),
        **(_describe_file("participants", roster) if roster.is_file() else {}),
        **_describe_sources(table),
        **({} if further is None or further.metrics.empty else _describe_further(further)),
        "metrics": ", ".join(table.metrics),
        **_tell_choices(choices),
    }


def _describe_file(role: str, path: Path) -> dict[str, str]:
    return {role: path.name, f"{role}_sha256": _digest(path.read_bytes())}


def _describe_sources(table: Table) -> dict[str, str]:
    found = find_sources(table.rows)
    if found.is_unique:
        return {}
    told = json.dumps(found.to_dict(), sort_keys=True).encode()
    return {
        "sources": tell_recordings(len(found), found.nunique()),
        "sources_sha256": _digest(told),
    }


def _describe_further(further: Further) -> dict[str, str]:
    text = further.metrics.sort_index().to_csv(float_format="%.17g", lineterminator="\n").encode()
    return {
        "further_metrics": ", ".join(map(str, further.metrics)),
        "further_metrics_sha256": _digest(text),
    }


def _tell_choices(choices: Choices) -> dict[str, str]:
    return {
        name: "from repeated ratings" if value is None else str(value)
        for name, value in asdict(choices).items()
    }


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# SECTIONS: the one list of a report's sections, in its order.

SECTIONS: tuple[Callable[[Table, Choices], Section], ...] = (
    primary.compute,
    association.compute_association,
    reducers.compute_levels,
    reducers.compute_profile,
    reducers.compute_contrasts,
    pairs.compute_discrimination,
    pairs.compute_space,
    robustness.compute_refined,
    association.compute_further,
    raters.compute,
    robustness.compute_robustness,
    standard.compute,
)
"""Each takes all ratings and gives one section, or the reason why there is none."""


# The report: a page, its numbers, its tables and its figures, all derived from two CSV files.

COMPUTED_WITH = ("numpy", "scipy", "pandas", "statsmodels", "scikit-learn", "matplotlib", "jinja2")


def write_report(  # noqa: PLR0913 - every choice that changes a report has a name of its own
    ratings_path: Path | str,
    manifest_path: Path | str,
    folder: Path | str,
    *,
    draws: int = 2000,
    margin: float | None = None,
    metrics: Sequence[str] | None = None,
    sources: Mapping[str, str] | None = None,
    further: Further | None = None,
    seed: int,
    progress: Callable[[int, int], None] | None = None,
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
        Bootstrap draws per interval, and random pairings per permutation test; at least 2.
    margin : float, optional
        Points by which reducers may differ and still count as equivalent; half the standard deviation of repeated
        ratings if left out.
    metrics : sequence of str, optional
        Numeric columns of the manifest that the primary analysis is about, declared before the ratings were seen;
        ``spectral_match_bounded`` and ``temporal_match`` if left out (`read_table`).
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where several are one, turned, cut or edited, and the manifest has no column
        ``source``: intervals then draw sources.
    further : Further, optional
        Metrics to explore that neither file holds, such as rotation statistics.
    seed : int
        Of all randomness; the same files and choices give the same bytes.
    progress : callable, optional
        Called with the numbers of sections done and to do.

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
    check_target(target)
    choices = Choices(draws=draws, margin=margin, seed=seed)
    table = read_table(ratings, manifest, metrics=metrics, sources=sources, further=further)
    sections = compute_sections(table, choices, progress=progress)
    inputs = describe_inputs(ratings, manifest, table=table, further=further, choices=choices)
    results = gather_results(table, sections, inputs=inputs)
    target.parent.mkdir(parents=True, exist_ok=True)
    # Everything is written beside its place first: an interrupted run leaves the former report as it was.
    with tempfile.TemporaryDirectory(dir=target.parent, prefix=f".{target.name}-") as place:
        _write_parts(Path(place), results, sections)
        page = render_page(results, sections, figures=Path(place) / "figures")
        (Path(place) / "index.html").write_text(page, encoding="utf-8", newline="")
        replace_report(Path(place), target, files=results.files)
    return results


def compute_sections(
    table: Table, choices: Choices, *, progress: Callable[[int, int], None] | None = None
) -> tuple[Section, ...]:
    """Run the whole analysis.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        What was chosen beforehand.
    progress : callable, optional
        Called with the numbers of sections done and to do.

    Returns
    -------
    tuple of Section
        In the report's order, figures numbered through.

    Raises
    ------
    ValueError
        If no test stimulus was rated.
    """
    import scipy.linalg  # noqa: F401 - brings a second library of linear algebra, whose threads are held too
    from threadpoolctl import threadpool_limits

    refuse_untested(table)
    done = []
    # Matrices here are small: threads of the linear algebra wait for each other most of the time, and take nine
    # times as long on a busy machine.
    with threadpool_limits(limits=1, user_api="blas"):
        for number, compute in enumerate(SECTIONS, start=1):
            done.append(compute(table, choices))
            if progress is not None:
                progress(number, len(SECTIONS))
    done = _reconcile(done)
    pictures = number_pictures(picture for section in done for picture in section.pictures)
    return tuple(
        replace(section, pictures=tuple(islice(pictures, len(section.pictures))))
        for section in done
    )


def _reconcile(sections: Sequence[Section]) -> list[Section]:
    """Say in front where correlations over all stimuli pooled point elsewhere than the primary model."""
    claims = [claim for section in sections for claim in section.claims]
    several = len({claim.level for claim in claims}) > 1

    def add(section: Section) -> Section:
        told = {panel: reconcile(panel, claims) for panel in section.panels}
        lines = [
            Line(text, name_subject(panel, several=several), "pooled")
            for panel, text in told.items()
            if text
        ]
        return replace(section, verdict=(*section.verdict, *lines))

    return [add(section) if section.panels else section for section in sections]


def gather_results(
    table: Table, sections: Sequence[Section], *, inputs: Mapping[str, str]
) -> Results:
    """Gather what ``results.json`` holds."""
    pictures = [picture for section in sections for picture in section.pictures]
    tables = [name for section in sections for name in section.tables]
    names = [
        *table.rows["scale"].unique(),
        *table.rows["level"].unique(),
        *table.metrics,
        *table.further,
        *RULES,
    ]
    told = (tell_note(note, names) for section in sections for note in section.notes)
    notes = (*table.notes, *told, *note_undrawable(table))
    return Results(
        verdict=write_verdict(sections),
        verdicts=tuple(claim for section in sections for claim in section.claims),
        numbers=collect_numbers(
            table, (number for section in sections for number in section.numbers)
        ),
        answers={section.key: section.answers for section in sections if section.answers},
        figures={picture.name: picture.caption for picture in pictures},
        captions=tuple(grid.caption for section in sections for grid in section.grids),
        notes=tuple(dict.fromkeys(notes)),
        how=tuple(dict.fromkeys(line for section in sections for line in section.how)),
        files=list_files([picture.name for picture in pictures], tables),
        simulated=bool(table.rows["simulated"].any()),
        inputs=inputs,
        versions=_list_versions(),
    )


def write_verdict(sections: Sequence[Section]) -> tuple[str, ...]:
    """Gather the sentences that open the report."""
    return tuple(dict.fromkeys(str(line) for section in sections for line in section.verdict))


def _write_parts(place: Path, results: Results, sections: Sequence[Section]) -> None:
    (place / "tables").mkdir()
    for name, frame in (entry for section in sections for entry in section.tables.items()):
        text = frame.to_csv(index=False, float_format="%.10g", lineterminator="\n")
        (place / "tables" / f"{name}.csv").write_text(text, encoding="utf-8", newline="")
    (place / "figures").mkdir()
    for picture in (picture for section in sections for picture in section.pictures):
        save_figure(picture.figure, place / "figures" / picture.name)
    (place / "results.json").write_text(results.to_json(), encoding="utf-8", newline="")


def _list_versions() -> dict[str, str]:
    from feel321.stimuli.version import __version__

    libraries = {name: version(name) for name in COMPUTED_WITH}
    return {"feel321": __version__, "python": platform.python_version(), **libraries}
