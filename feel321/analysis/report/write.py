"""Write a report: two pages, ``results.json``, tables and figures, all of them rows of one frame."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.association.correlate import refuse_untested
from feel321.analysis.figures.style import list_undrawable
from feel321.analysis.page import render_template, render_words
from feel321.analysis.report import answer, correlations, pairs, primary, raters, reducers
from feel321.analysis.report import section as parts
from feel321.analysis.report.folder import DETAILS, PAGE, ResultsFolder, list_files
from feel321.analysis.report.section import FIXED, Found, Row, Section
from feel321.analysis.report.standing import About, Standing, list_versions
from feel321.analysis.resampling import Choices
from feel321.analysis.screening.rules import RULES
from feel321.analysis.table.items import Table, find_sources, format_recordings
from feel321.analysis.table.reading import ROSTER_FILE, Further, find_tables, read_table
from feel321.analysis.table.schema import RECAST
from feel321.doors import announce, as_seed, follow
from feel321.records import Result, to_json_value
from feel321.types import MetricInfo, PathLike, Progress, Rng

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication import Paper

SCHEMA_VERSION = 2
"""Version of ``results.schema.json``, which describes ``results.json``: raised when a field changes or goes."""

TITLE = "Do the metrics predict the ratings?"
QUESTIONS: Mapping[str, str] = {
    "paper": "The paper's questions",
    "predict": TITLE,
    "differ": "How do the reducers differ?",
    "apart": "Can people tell them apart?",
    "trust": "Can the raters be trusted?",
    "hinge": "How much does it hinge on choices?",
    "computed": "How was it computed?",
}
"""Anchor of each question -> how it is put; sections name the one that they answer."""

SECTIONS: tuple[Section, ...] = tuple(
    sorted(
        chain.from_iterable(
            one.SECTIONS for one in (primary, correlations, reducers, pairs, raters)
        ),
        key=lambda section: list(QUESTIONS).index(section.question),
    )
)
"""The one list of a report's sections: a module lists its own, and each names its question."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Results(Result):
    """A report as data.

    Parameters
    ----------
    headline : str
        The finding in one sentence.
    verdicts : tuple of Mapping
        The answer for programs: one per scale, level and metric, with verdict (``predicts``, ``open`` or
        ``not_estimable``), direction, the units that it hinges on, and status.
    cards : tuple of Mapping
        What the page opens with: of every verdict the effect, the correlation and the noise ceiling.
    numbers : DataFrame
        Every number: table, quantity, its keys (scale, level, metric, ...), value, low, high, p, n, interval, note and
        status.
    answers : Mapping of str to tuple of str
        What each section shows, in words, by its key.
    figures : Mapping of str to str
        Caption of each figure, by file name without suffix.
    captions : Mapping of str to str
        What each table shows, by file name without suffix.
    notes : tuple of str
        What was left out or assumed.
    how : tuple of str
        How it was computed.
    files : tuple of str
        Every file of the report, relative to its folder: what a later report may replace.
    simulated : bool
        Whether any rating came from a simulated participant.
    inputs : Mapping of str to str
        File names and digests, seed and draws.
    versions : Mapping of str to str
        Software that computed it.
    about : Mapping of str to str
        Name of the study, and the day of the last rating, if known.
    standing : Standing
        What was declared before the ratings, and whether that makes results confirmatory.
    path : Path
        The report's folder.
    """

    headline: str
    verdicts: tuple[Mapping[str, Any], ...]
    cards: tuple[Mapping[str, Any], ...]
    numbers: DataFrame
    answers: Mapping[str, tuple[str, ...]]
    figures: Mapping[str, str]
    captions: Mapping[str, str]
    notes: tuple[str, ...]
    how: tuple[str, ...]
    files: tuple[str, ...]
    simulated: bool
    inputs: Mapping[str, str]
    versions: Mapping[str, str]
    about: Mapping[str, str] = field(default_factory=dict)
    standing: Standing = field(default_factory=Standing)
    path: Path = Path()

    def to_frame(self) -> DataFrame:
        """Return every number of the report.

        Returns
        -------
        DataFrame
            A copy of the numbers, one row each.
        """
        return self.numbers.copy()

    def summary(self) -> str:
        """Write the answer, a line per finding.

        Returns
        -------
        str
            The headline, and the first sentence of every section.
        """
        return "\n".join([self.headline, *(lines[0] for lines in self.answers.values() if lines)])

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds.

        Returns
        -------
        dict
            A number that is not defined is None; a row has only the keys that its table has.
        """
        told = {name: getattr(self, name) for name in self.__dataclass_fields__}
        del told["path"]
        rows = [
            row
            for _, part in told.pop("numbers").groupby("table", sort=False)
            for row in _tidy(part, ["table"]).to_dict("records")
        ]
        told |= {"standing": self.standing.to_dict(), "numbers": rows}
        content: dict[str, Any] = to_json_value({"schema_version": SCHEMA_VERSION, **told})
        return content


def _tidy(part: DataFrame, lead: Sequence[str] = ()) -> DataFrame:
    """Keep the columns that a table has: quantity first, then its keys, then the number."""
    apart = {"table", "status", *FIXED}
    keys = [str(name) for name in part if name not in apart and part[name].notna().any()]
    return part[[*lead, "quantity", *keys, *FIXED[1:], "status"]]


# What decides a report.

IN_MEMORY = "a table in memory"


def describe_inputs(
    given: Mapping[str, Path | DataFrame],
    *,
    table: Table,
    further: Further | None,
    choices: Choices,
) -> dict[str, str]:
    """Describe everything that decides a report: files, choices and what was handed over, each with its digest."""
    told: dict[str, str] = {}
    for role, source in given.items():
        if not isinstance(source, Path):
            told |= {role: IN_MEMORY, f"{role}_sha256": _digest(source)}
        elif source.is_file() or role != "participants":
            told |= {role: source.name, f"{role}_sha256": _digest(source)}
    found = find_sources(table.rows)
    if not found.is_unique:
        told["sources"] = format_recordings(len(found), found.nunique())
        told["sources_sha256"] = _digest(found.to_frame())
    if further is not None and not further.metrics.empty:
        told["further_metrics"] = ", ".join(map(str, further.metrics))
        told["further_metrics_sha256"] = _digest(further.metrics.sort_index())
    margin = "none" if choices.margin is None else str(choices.margin)
    told |= {"metrics": ", ".join(table.metrics), "draws": str(choices.draws), "margin": margin}
    told |= {"seed": str(choices.seed)}
    return told


def _digest(source: Path | DataFrame) -> str:
    if isinstance(source, Path):
        return hashlib.sha256(source.read_bytes()).hexdigest()
    text = source.to_csv(float_format="%.17g", lineterminator="\n")
    return hashlib.sha256(text.encode()).hexdigest()


def write_report(  # noqa: PLR0913 - every choice that changes a report has a name of its own
    ratings_path: PathLike | DataFrame | Table,
    manifest_path: PathLike | DataFrame | None = None,
    folder: PathLike = "report",
    *,
    draws: int = 2000,
    margin: float | None = None,
    metrics: Sequence[str] | None = None,
    sources: Mapping[str, str] | None = None,
    further: Further | None = None,
    info: Mapping[str, MetricInfo] | None = None,
    paper: Paper | None = None,
    about: About | None = None,
    rng: Rng = 0,
    progress: Progress | None = False,
) -> Results:
    """Analyse ratings against the match metrics and write the report.

    Parameters
    ----------
    ratings_path : path, DataFrame or Table
        Ratings, as `read_table` takes them: ``ratings.csv``, from feel321 or from elsewhere, or a study's folder. Or
        the Table that it returned.
    manifest_path : path or DataFrame, optional
        ``manifest.csv`` of the stimuli that were rated; left out for a study or a Table.
    folder : str or path
        The report's folder; "report" in the current one if left out. The files of a former report, which its
        ``results.json`` lists, are replaced; all others stay.
    draws : int
        Bootstrap draws per interval, and random pairings per permutation test; at least 2.
    margin : float, optional
        Points by which reducers may differ and still count as equivalent; equivalence is not tested if left out.
    metrics : sequence of str, optional
        Numeric columns of the manifest that the primary analysis is about, declared before the ratings were seen;
        ``spectral_match_bounded`` and ``temporal_match`` if left out (`read_table`).
    sources : Mapping of str to str, optional
        Recording -> what it was made from, where several are one, turned, cut or edited, and the manifest has no column
        ``source``: intervals then draw sources.
    further : Further, optional
        Metrics to explore that neither file holds, such as rotation statistics.
    info : Mapping of str to MetricInfo, optional
        What metrics declare: which way each points, its bounds, label and unit (`read_table`).
    paper : Paper, optional
        The paper that is replicated: its claims are answered first.
    about : About, optional
        The study's name, the day of its last rating, and the order of its protocols.
    rng : int or Generator
        Seed of all randomness; the same files, choices and seed give the same bytes.
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
    >>> print(results.headline)  # doctest: +SKIP
    """
    chosen = Choices(draws=draws, margin=margin, seed=as_seed(rng))
    with ResultsFolder(folder) as target, follow(progress or False, "report") as move:
        choice = {"metrics": metrics, "sources": sources, "further": further, "info": info}
        table, given = _open(ratings_path, manifest_path, **choice)
        about = about or About()
        table = order_scales(table, about.protocols)
        inputs = describe_inputs(given, table=table, further=further, choices=chosen)
        with words.declaring(table.info):
            found = _compute(table, chosen, move)
            sections = list(SECTIONS)
            if paper is not None:
                from feel321.analysis.report.paper import make_section

                inputs |= {"paper": f"{paper.citation} doi:{paper.doi} ({paper.seen})"}
                sections.insert(0, section := make_section(paper, found))
                found = {section.key: section.compute(table, chosen), **found}
            announce("figures and pages")
            results = gather_results(
                table, sections, found, inputs=inputs, about=about, choices=chosen
            )
            _write(table, results, sections=sections, found=found, target=target)
    return replace(results, path=target.path)


def _open(
    ratings: PathLike | DataFrame | Table,
    manifest: PathLike | DataFrame | None,
    **choice: Any,  # noqa: ANN401 - those of read_table
) -> tuple[Table, dict[str, Path | DataFrame]]:
    """Read the ratings; return them with what they were read from."""
    if isinstance(ratings, Table):
        if manifest is not None or any(one is not None for one in choice.values()):
            raise ValueError(
                "manifest, metrics, sources, further and info must be left out with a Table, which has them; give them "
                "to read_table"
            )
        return ratings, {"ratings": ratings.rows}
    if manifest is None:
        ratings, manifest = find_tables(ratings)
    given: dict[str, Any] = {"ratings": ratings, "manifest": manifest}
    paths = {role: Path(one) for role, one in given.items() if isinstance(one, str | os.PathLike)}
    if "ratings" in paths:
        paths["participants"] = paths["ratings"].with_name(ROSTER_FILE)
    return read_table(ratings, manifest, **choice), given | paths


def order_scales(table: Table, protocols: Sequence[str]) -> Table:
    """Put the ratings of protocols in the study's order, where the first participant had another."""
    rows = table.rows
    if "protocol" not in rows or not protocols:
        return table
    place = {name: number for number, name in enumerate(protocols)}
    ranks = rows["protocol"].map(place).fillna(len(place))
    if ranks.drop_duplicates().is_monotonic_increasing:
        return table
    order = ranks.sort_values(kind="stable").index
    return replace(table, rows=rows.loc[order].reset_index(drop=True))


def _compute(table: Table, chosen: Choices, move: Callable[[int, int], None]) -> dict[str, Found]:
    """Compute section after section."""
    import scipy.linalg  # noqa: F401 - brings a second library of linear algebra, whose threads are held too
    from threadpoolctl import threadpool_limits

    refuse_untested(table)
    found: dict[str, Found] = {}
    # Matrices here are small: threads of the linear algebra wait for each other most of the time, and take nine
    # times as long on a busy machine.
    with threadpool_limits(limits=1, user_api="blas"):
        for number, section in enumerate(SECTIONS, start=1):
            announce(section.title.lower())
            found[section.key] = section.compute(table, chosen)
            move(number, len(SECTIONS))
    if "metrics" in found:
        panels = found["metrics"].facts.get("panels", ())
        answer.reconcile(panels, [one for own in found.values() for one in own.verdicts])
    return found


# What was found, as rows and words.


def gather_results(
    table: Table, sections: Sequence[Section], found: Mapping[str, Found], *, inputs: Mapping[str, str], about: About,
    choices: Choices,
) -> Results:  # fmt: skip
    """Gather what ``results.json`` holds."""
    standing, shown = about.standing, [one for one in sections if not found[one.key].is_empty]

    def mark(one: Row) -> Row:
        status, reason = standing.judge(*(one[key] for key in answer.PLACE))
        return {**one, "status": status, "reason": reason}

    cards = [mark(card) for card in answer.make_cards(found)]
    answers = {one.key: render_words(one.key, **found[one.key].facts) for one in shown}
    first = [lines[0] for lines in answers.values() if lines]
    headline = (*first, "These ratings do not answer the question.")[0]
    if clauses := answer.list_clauses(cards, found):
        (headline,) = render_words("headline", clauses=clauses)
    pictures = [picture for one in found.values() for picture in one.pictures]
    frame = make_frame(table, found, standing)
    how: list[str] = []
    for one in shown:
        how += render_words(one.key, "how", draws=choices.draws)
    return Results(
        headline=headline,
        verdicts=tuple(mark(one) for own in found.values() for one in own.verdicts),
        cards=tuple(cards),
        numbers=frame,
        answers=answers,
        figures={picture.name: picture.caption for picture in pictures},
        captions={
            form.name: form.caption
            for one in shown
            for form in one.tables
            if found[one.key].rows.get(form.name)
        },
        notes=tuple(_gather_notes(table, found)),
        how=tuple(how),
        files=list_files([one.name for one in pictures], frame["table"].unique(), (PAGE, DETAILS)),
        simulated=bool(table.rows["simulated"].any()),
        inputs=inputs,
        versions=list_versions(),
        about={"name": about.name, "date": about.date},
        standing=standing,
    )


def make_frame(table: Table, found: Mapping[str, Found], standing: Standing) -> DataFrame:
    """Make the frame: every number of the report, one row each."""
    import pandas as pd

    tables = {"sizes": count_table(table)}
    for one in found.values():
        tables |= {name: list(rows) for name, rows in one.rows.items() if rows}
    rows = [
        {"table": name, **row, "status": standing.mark(name, row)}
        for name, own in tables.items()
        for row in own
    ]
    frame = _tidy(pd.DataFrame(rows), ["table"])
    keys = [name for name in frame if name not in {*FIXED[1:], "status"}]
    if len(twice := frame[frame.duplicated(keys)]):
        raise ValueError(
            f"results: {len(twice)} rows have the same keys, first {twice.iloc[0].dropna().to_dict()}"
        )
    return frame


def count_table(table: Table) -> list[Row]:
    """Count what was rated, by whom."""
    rows, columns = table.rows, ("participant", "recording", "stimulus_id", "reducer", "scale")
    names = ("n_participants", "n_recordings", "n_stimuli", "n_reducers", "n_scales")
    sizes = {name: rows[column].nunique() for name, column in zip(names, columns, strict=True)}
    sizes |= {"n_sources": find_sources(rows).nunique(), "n_judgements": len(rows)}
    return parts.count_rows(sizes | {"n_simulated": int(rows["simulated"].sum())}, n=len(rows))


def _gather_notes(table: Table, found: Mapping[str, Found]) -> Iterator[str]:
    """List what was left out or assumed: names in words, and what several ratings share said once."""
    rows = table.rows
    scales, levels = rows["scale"].unique(), rows["level"].unique()
    names = [*scales, RECAST, *levels, *table.metrics, *table.further, *table.rivals, *RULES]
    arms = sorted({f"{scale}, {level}" for scale in scales for level in levels})
    told: dict[str, list[str]] = {}
    notes = chain(table.notes, *(one.notes for one in found.values()))
    for note in dict.fromkeys(notes):
        lead = next((arm for arm in arms if re.match(rf"{re.escape(arm)}[,:; ]", note)), "")
        told.setdefault(note[len(lead) :], []).append(lead)
    for rest, leads in told.items():
        yield words.format_note("; ".join(leads) + rest, names)
    shown = [name for key in ("scale", "level", "reducer") for name in rows[key].unique()]
    if letters := list_undrawable(shown):
        yield f"The figures' font has no {' '.join(letters)}: boxes stand for them; captions and tables show them."


# Pages and files.


def _write(
    table: Table, results: Results, *, sections: Sequence[Section], found: Mapping[str, Found], target: ResultsFolder,
) -> None:  # fmt: skip
    """Draw the figures, and write pages, tables and ``results.json``."""
    target.draw(picture for one in found.values() for picture in one.pictures)
    shown = [_show(one, results, found[one.key]) for one in sections if one.key in results.answers]
    blocks = [
        {"key": key, "title": title, "sections": [one for one in shown if one["question"] == key]}
        for key, title in QUESTIONS.items()
    ]
    fronts = [block for block in blocks if block["sections"] and block["key"] != "computed"]
    lead = next((one for one in found.get("metrics", Found()).pictures if not one.detail), None)
    told = [text for one in found.values() for text in one.clauses]
    sizes = {row["quantity"]: row["value"] for row in count_table(table)}
    common: dict[str, Any] = {"results": results, "sizes": sizes, "title": TITLE}
    frames = {str(name): _tidy(part) for name, part in results.numbers.groupby("table", sort=False)}
    target.write(
        results.to_dict(),
        page=lambda drawings: render_template(
            "report.html", blocks=fronts, drawings=drawings, lead=lead, others=told, **common
        ),
        details=render_template("details.html", blocks=blocks, **common),
        tables=frames | {"dictionary": parts.describe_tables(sections, frames)},
    )


def _show(section: Section, results: Results, found: Found) -> dict[str, Any]:
    """Gather what the pages show of a section."""
    verdicts = results.verdicts if found.verdicts else ()
    return {
        "key": section.key, "title": section.title, "question": section.question, "front": section.front,
        "lines": results.answers[section.key], "pictures": found.pictures,
        "tables": [
            parts.show_table(form, found.rows[form.name]) for form in section.tables if found.rows.get(form.name)
        ],
        "confirmatory": sum(one["status"] == words.CONFIRMATORY for one in verdicts),
    }  # fmt: skip
