"""Write a report: page, numbers, tables and figures, all derived from two CSV files."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.analysis.association.correlate import refuse_untested
from feel321.analysis.figures.style import list_undrawable
from feel321.analysis.report import (
    association,
    pairs,
    primary,
    raters,
    reducers,
    robustness,
    standard,
)
from feel321.analysis.report.folder import ResultsFolder, list_files
from feel321.analysis.report.page import render_template
from feel321.analysis.report.parts import Choices
from feel321.analysis.report.results import Results, collect_numbers, describe_inputs, list_versions
from feel321.analysis.report.section import number_pictures
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table.reading import read_table
from feel321.analysis.words import Line, tell_note
from feel321.doors import as_path, as_seed, follow

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence

    from markupsafe import Markup

    from feel321.analysis.report.section import Section
    from feel321.analysis.table.reading import Further, Table
    from feel321.types import PathLike, Progress, Rng

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
"""The one list of a report's sections, in its order; each takes all ratings and gives a section, or the reason why
there is none."""


def write_report(  # noqa: PLR0913 - every choice that changes a report has a name of its own
    ratings_path: PathLike,
    manifest_path: PathLike,
    folder: PathLike,
    *,
    draws: int = 2000,
    margin: float | None = None,
    metrics: Sequence[str] | None = None,
    sources: Mapping[str, str] | None = None,
    further: Further | None = None,
    rng: Rng = 0,
    seed: int | None = None,
    progress: Progress | None = False,
) -> Results:
    """Analyse ratings against the match metrics and write the report.

    Parameters
    ----------
    ratings_path : str or path
        ``ratings.csv``, from feel321 or from elsewhere.
    manifest_path : str or path
        ``manifest.csv`` of the stimuli that were rated.
    folder : str or path
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
    rng : int or Generator
        Seed of all randomness; the same files, choices and seed give the same bytes.
    seed : int, optional
        Older name of `rng`.
    progress : bool or callable
        Whether to show a progress bar; or called with the numbers of sections done and to do.

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

    Examples
    --------
    >>> from feel321 import analysis
    >>> results = analysis.write_report("ratings.csv", "manifest.csv", "report")  # doctest: +SKIP
    >>> print(results.summary())  # doctest: +SKIP
    """
    ratings, manifest = as_path(ratings_path, "ratings"), as_path(manifest_path, "manifest")
    seed = as_seed(rng) if seed is None else seed
    choices = Choices(draws=draws, margin=margin, seed=seed)
    with (
        ResultsFolder(folder, background=True) as target,
        follow(progress or False, "report") as move,
    ):
        table = read_table(ratings, manifest, metrics=metrics, sources=sources, further=further)
        sections = []
        for section in _compute(table, choices, move):
            sections.append(section)
            target.draw(section.pictures)
        sections = _reconcile(sections)
        inputs = describe_inputs(ratings, manifest, table=table, further=further, choices=choices)
        results = gather_results(table, sections, inputs=inputs)
        target.write(
            results.to_dict(),
            page=lambda drawings: render_page(results, sections, drawings=drawings),
            tables={name: rows for section in sections for name, rows in section.tables.items()},
        )
    return replace(results, path=target.path)


def compute_sections(
    table: Table, choices: Choices, *, progress: Progress | None = False
) -> tuple[Section, ...]:
    """Run the whole analysis; returns its sections in the report's order, figures numbered through."""
    with follow(progress or False, "report") as move:
        return tuple(_reconcile(list(_compute(table, choices, move))))


def _compute(
    table: Table, choices: Choices, progress: Callable[[int, int], None]
) -> Iterator[Section]:
    """Compute section after section, figures numbered through."""
    import scipy.linalg  # noqa: F401 - brings a second library of linear algebra, whose threads are held too
    from threadpoolctl import threadpool_limits

    refuse_untested(table)
    drawn = 0
    # Matrices here are small: threads of the linear algebra wait for each other most of the time, and take nine
    # times as long on a busy machine.
    with threadpool_limits(limits=1, user_api="blas"):
        for number, compute in enumerate(SECTIONS, start=1):
            section = compute(table, choices)
            pictures = tuple(number_pictures(section.pictures, start=drawn + 1))
            drawn += len(pictures)
            yield replace(section, pictures=pictures)
            progress(number, len(SECTIONS))


def _reconcile(sections: Sequence[Section]) -> list[Section]:
    """Say in front where correlations over all stimuli pooled point elsewhere than the primary model."""
    claims = [claim for section in sections for claim in section.claims]
    several = len({claim.level for claim in claims}) > 1

    def add(section: Section) -> Section:
        told = {panel: association.reconcile(panel, claims) for panel in section.panels}
        lines = [
            Line(text, association.name_subject(panel, several=several), "pooled")
            for panel, text in told.items()
            if text
        ]
        return replace(section, verdict=(*section.verdict, *lines))

    return [add(section) if section.panels else section for section in sections]


def gather_results(
    table: Table, sections: Sequence[Section], *, inputs: Mapping[str, str]
) -> Results:
    """Gather what ``results.json`` holds."""
    rows = table.rows
    names = [*rows["scale"].unique(), *rows["level"].unique(), *table.metrics, *table.further]
    own = [tell_note(note, [*names, *RULES]) for note in _gather(sections, "notes")]
    pictures = _gather(sections, "pictures")
    return Results(
        verdict=tuple(dict.fromkeys(map(str, _gather(sections, "verdict")))),
        verdicts=tuple(_gather(sections, "claims")),
        numbers=collect_numbers(table, _gather(sections, "numbers")),
        answers={section.key: tuple(section.answers) for section in sections if section.answers},
        figures={picture.name: picture.caption for picture in pictures},
        captions=tuple(grid.caption for grid in _gather(sections, "grids")),
        notes=tuple(dict.fromkeys((*table.notes, *own, *_note_undrawable(table)))),
        how=tuple(dict.fromkeys(_gather(sections, "how"))),
        files=list_files([picture.name for picture in pictures], _gather(sections, "tables")),
        simulated=bool(rows["simulated"].any()),
        inputs=inputs,
        versions=list_versions(),
    )


def _gather(sections: Iterable[Section], name: str) -> list:  # type: ignore[type-arg]  # of whatever sections hold
    return [one for section in sections for one in getattr(section, name)]


def _note_undrawable(table: Table) -> Iterator[str]:
    """Say which characters of names the figures cannot show."""
    names = [name for key in ("scale", "level", "reducer") for name in table.rows[key].unique()]
    if letters := list_undrawable(names):
        boxes = "boxes stand for them; captions and tables show them"
        yield f"The figures' font has no {' '.join(letters)}: {boxes}."


def render_page(
    results: Results, sections: Sequence[Section], *, drawings: Mapping[str, Markup]
) -> str:
    """Render the page."""
    sizes = {
        number.name.removeprefix("size."): number.value
        for number in results.numbers
        if number.name.startswith("size.")
    }
    return render_template(
        "report.html",
        results=results,
        sections=sections,
        answer=group_lines(sections),
        drawings=drawings,
        sizes=sizes,
    )


def group_lines(sections: Iterable[Section]) -> dict[str, list[Line]]:
    """Put together what opens the page about the same ratings; what is about all of them comes last."""
    lines = dict.fromkeys(_gather(sections, "verdict"))
    subjects = dict.fromkeys(line.subject for line in lines)
    return {
        subject: [line for line in lines if line.subject == subject]
        for subject in sorted(subjects, key=lambda subject: not subject)
    }
