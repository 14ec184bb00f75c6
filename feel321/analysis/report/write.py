"""Write a report: two pages, ``results.json``, tables and figures, all of them rows of one frame."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
from pandas import DataFrame

from feel321.analysis import words
from feel321.analysis.figures import list_undrawable
from feel321.analysis.mixed.optimum import POOLS
from feel321.analysis.report import answer
from feel321.analysis.report.folder import DETAILS, PAGE, check_target, list_files, write_folder
from feel321.analysis.report.section import FIXED, Found, Row, Section, TableForm, make_row
from feel321.analysis.report.standing import About, Standing, list_versions
from feel321.analysis.resampling import Choices
from feel321.analysis.screening import RULES
from feel321.analysis.table.columns import DICTIONARY, make_dictionary
from feel321.analysis.table.items import Table, find_sources, format_recordings
from feel321.analysis.table.reading import ROSTER_FILE, Further, find_tables, read_table
from feel321.analysis.table.schema import ANSWERED, CHOSEN, PAIR, PAIRED, RECAST
from feel321.analysis.words import render_template, render_words
from feel321.arguments import as_path, as_seed, follow
from feel321.records import Result, to_json_value
from feel321.types import MetricInfo, PathLike, Progress, Rng

if TYPE_CHECKING:
    from feel321.analysis.replication import Paper

# Version of ``results.schema.json``, which describes ``results.json``: raised when a field changes or goes
SCHEMA_VERSION = 2
TITLE = "Do the metrics predict the ratings?"
# Anchor of each question -> how it is put; sections name the one that they answer
QUESTIONS: Mapping[str, str] = {
    "paper": "The paper's questions",
    "predict": TITLE,
    "differ": "How do the reducers differ?",
    "apart": "Can people tell them apart?",
    "trust": "Can the raters be trusted?",
    "hinge": "How much does it hinge on choices?",
    "computed": "How was it computed?",
}
# The one list of a report's sections, by question
SECTIONS = (
    Section("primary", "Change in rating with each metric, within recordings", "predict", "primary:compute"),
    Section("metrics", "Correlations of mean ratings with metrics", "predict", "means:compute_correlations"),
    Section("levels", "Level arms compared", "differ", "means:compute_levels"),
    Section("reducers", "Ratings per reducer", "differ", "means:compute_profile"),
    Section("contrasts", "Reducers against each other", "differ", "means:compute_contrasts"),
    Section("choices", "Choices between two stimuli", "differ", "pairs:compute_choices", CHOSEN),
    Section("discrimination", "Telling stimuli apart (ABX)", "apart", "pairs:compute_discrimination", (ANSWERED,)),
    Section("told_apart", "One axis against three", "apart", "pairs:compute_told_apart", (PAIRED,)),
    Section("space", "The space of what was felt", "apart", "pairs:compute_space", (PAIRED,)),
    Section("delivered", "Delivered vibration", "trust", "raters:compute_delivered"),
    Section("raters", "Raters", "trust", "raters:compute"),
    Section("robustness", "Robustness to other choices", "hinge", "primary:compute_robustness"),
)  # fmt: skip
# Of a replication, and first on its pages; it needs what the others found
PAPER = Section("paper", QUESTIONS["paper"], "paper", "answer:compute_paper")
Everything = Mapping[Section, Found]  # What every section found, in the order of the pages


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Results(Result):
    """A report as data.

    headline: the finding in one sentence. verdicts: the answer for programs: one per scale, level and metric, with
    verdict (``predicts``, ``open`` or ``not_estimable``), direction, the units that it hinges on, and status. cards: of
    every verdict the effect, the correlation and the noise ceiling. numbers: every number: table, quantity, its keys,
    value, low, high, p, n, interval, note and status. answers: what each section shows, in words, by its key. figures,
    captions: caption of each figure and of each table, by file name. notes: what was left out or assumed. how: how it
    was computed. files: every file, relative to the folder: what a later report may replace. inputs, versions: file
    names and digests, seed and draws; software. about: name of the study, day of the last rating. standing: what was
    declared before the ratings. path: the folder.
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
        """Return a copy of every number of the report, one row each."""
        return self.numbers.copy()

    def summary(self) -> str:
        """Write the headline, and the first sentence of every section."""
        return "\n".join([self.headline, *(lines[0] for lines in self.answers.values() if lines)])

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds; a row has only the keys that its table has."""
        told = {name: getattr(self, name) for name in self.__dataclass_fields__}
        del told["path"]
        parts = told.pop("numbers").groupby("table", sort=False)
        rows = [row for _, part in parts for row in _tidy(part, ["table"]).to_dict("records")]
        told |= {"standing": self.standing.to_dict(), "numbers": rows}
        content: dict[str, Any] = to_json_value({"schema_version": SCHEMA_VERSION, **told})
        return content


def _tidy(part: DataFrame, lead: Sequence[str] = ()) -> DataFrame:
    """Keep the columns that a table has: quantity first, then its keys, then the number."""
    apart = {"table", "status", *FIXED}
    keys = [str(name) for name in part if name not in apart and part[name].notna().any()]
    return part[[*lead, "quantity", *keys, *FIXED[1:], "status"]]


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
    metrics, sources, further, info : optional
        The metrics of the primary analysis, what recordings were made from, metrics that neither file holds, and what
        metrics declare, all as `read_table` takes them; left out with a Table, which has them.
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
    """
    chosen, about = Choices(draws=draws, margin=margin, seed=as_seed(rng)), about or About()
    check_target(target := as_path(folder, "folder"))
    choice = {"metrics": metrics, "sources": sources, "further": further, "info": info}
    with follow(progress or False, "report") as move:
        table, given = _open(ratings_path, manifest_path, **choice)
        table = order_scales(table, about.protocols)
        inputs = describe_inputs(given, table=table, further=further, choices=chosen)
        if paper is not None:
            inputs |= {"paper": f"{paper.citation} doi:{paper.doi} ({paper.seen})"}
        if not table.rows["role"].isin(["test", PAIR]).any():
            must = "ratings must be of one stimulus or more with role 'test'"
            raise ValueError(f"{must}, got none of such")
        with words.declaring(table.info):
            found = _compute(table, chosen, paper=paper, move=move)
            results = _gather_results(table, found, inputs=inputs, about=about, choices=chosen)
            _write(table, results, found=found, target=target)
    return replace(results, path=target)


def _open(
    ratings: PathLike | DataFrame | Table,
    manifest: PathLike | DataFrame | None,
    **choice: Any,  # noqa: ANN401 - those of read_table
) -> tuple[Table, dict[str, Path | DataFrame]]:
    """Read the ratings; return them with what they were read from."""
    if isinstance(ratings, Table):
        if manifest is not None or any(one is not None for one in choice.values()):
            what = "manifest, metrics, sources, further and info"
            raise ValueError(
                f"{what} must be left out with a Table, which has them; give them to read_table"
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
    if "protocol" not in table.rows or not protocols:
        return table
    place = {name: number for number, name in enumerate(protocols)}
    ranks = table.rows["protocol"].map(place).fillna(len(place)).sort_values(kind="stable")
    return replace(table, rows=table.rows.loc[ranks.index].reset_index(drop=True))


def describe_inputs(
    given: Mapping[str, Path | DataFrame], *, table: Table, further: Further | None, choices: Choices
) -> dict[str, str]:  # fmt: skip
    """Describe everything that decides a report: files, choices and what was handed over, each with its digest."""
    parts, told = list[tuple[str, str, Any]](), dict[str, str]()
    for role, source in given.items():
        if not isinstance(source, Path):
            parts.append((role, "a table in memory", source))
        elif source.is_file() or role != "participants":
            parts.append((role, source.name, source))
    found = find_sources(table.rows)
    if not found.is_unique:
        parts.append(("sources", format_recordings(len(found), found.nunique()), found.to_frame()))
    if further is not None and not further.metrics.empty:
        names = ", ".join(map(str, further.metrics))
        parts.append(("further_metrics", names, further.metrics.sort_index()))
    for role, name, source in parts:
        if isinstance(source, Path):
            content = source.read_bytes()
        else:
            content = source.to_csv(float_format="%.17g", lineterminator="\n").encode()
        told |= {role: name, f"{role}_sha256": hashlib.sha256(content).hexdigest()}
    margin = "none" if choices.margin is None else str(choices.margin)
    told |= {"metrics": ", ".join(table.metrics), "draws": str(choices.draws), "margin": margin}
    return told | {"seed": str(choices.seed)}


def _compute(
    table: Table, chosen: Choices, *, paper: Paper | None, move: Callable[[int, int], None]
) -> Everything:
    """Compute section after section."""
    found: dict[Section, Found] = {}
    # Matrices here are small: threads of the linear algebra wait for each other most of the time, and take nine
    # times as long on a busy machine.
    with POOLS.limit(limits=1, user_api="blas"):
        for number, section in enumerate(SECTIONS, start=1):
            found[section] = section.compute(table, chosen)
            move(number, len(SECTIONS))
        by_key = {section.key: one for section, one in found.items()}
        if paper is not None:
            own = answer.compute_paper(table, chosen, paper=paper, others=by_key)
            found = {PAPER: own, **found}
    return found


# What was found, as rows and words.


def _gather_results(
    table: Table, found: Everything, *, inputs: Mapping[str, str], about: About, choices: Choices
) -> Results:
    """Gather what ``results.json`` holds."""

    def mark(one: Row) -> Row:
        status, reason = about.standing.judge(*(one[key] for key in answer.PLACE))
        return {**one, "status": status, "reason": reason}

    by_key = {section.key: one for section, one in found.items()}
    shown = {key: one for key, one in by_key.items() if not one.is_empty}
    answers = {key: render_words(key, **one.facts) for key, one in shown.items()}
    cards = [mark(card) for card in answer.make_cards(by_key)]
    first = [lines[0] for lines in answers.values() if lines]
    headline = (*first, "These ratings do not answer the question.")[0]
    if clauses := answer.list_clauses(cards, by_key):
        (headline,) = render_words("headline", clauses=clauses)
    pictures = [picture for one in found.values() for picture in one.pictures]
    frame = make_frame(table, found.values(), about.standing)
    return Results(
        headline=headline,
        verdicts=tuple(mark(one) for own in found.values() for one in own.verdicts),
        cards=tuple(cards),
        numbers=frame,
        answers=answers,
        figures={picture.name: picture.caption for picture in pictures},
        captions={form.name: form.caption for form in chain(*map(list_shown, found.items()))},
        notes=tuple(_gather_notes(table, found.values())),
        how=tuple(chain(*(render_words(key, "how", draws=choices.draws) for key in shown))),
        files=list_files([one.name for one in pictures], frame["table"].unique(), (PAGE, DETAILS)),
        simulated=bool(table.rows["simulated"].any()),
        inputs=inputs,
        versions=list_versions(),
        about={"name": about.name, "date": about.date},
        standing=about.standing,
    )


def list_shown(one: tuple[Section, Found]) -> list[TableForm]:
    """List the tables of a section that a page shows."""
    section, found = one
    forms = section.tables.values()
    return [form for form in forms if form.caption and found.rows.get(form.name)]


def make_frame(table: Table, found: Iterable[Found], standing: Standing) -> DataFrame:
    """Make the frame: every number of the report, one row each."""
    sizes = ("sizes", count_table(table))
    rows = [
        {"table": name, **row, "status": standing.mark(name, row)}
        for name, own in (sizes, *(pair for one in found for pair in one.rows.items()))
        for row in own
    ]
    frame = _tidy(pd.DataFrame(rows), ["table"])
    keys = [name for name in frame if name not in {*FIXED[1:], "status"}]
    if len(twice := frame[frame.duplicated(keys)]):
        first = twice.iloc[0].dropna().to_dict()
        raise ValueError(f"results: {len(twice)} rows have the same keys, first {first}")
    return frame


def count_table(table: Table) -> list[Row]:
    """Count what was rated, by whom."""
    rows, columns = table.rows, ("participant", "recording", "stimulus_id", "reducer", "scale")
    names = ("n_participants", "n_recordings", "n_stimuli", "n_reducers", "n_scales")
    sizes = {name: rows[column].nunique() for name, column in zip(names, columns, strict=True)}
    sizes |= {"n_sources": find_sources(rows).nunique(), "n_judgements": len(rows)}
    sizes |= {"n_simulated": int(rows["simulated"].sum())}
    return [make_row(name, size, n=len(rows)) for name, size in sizes.items()]


def _gather_notes(table: Table, found: Iterable[Found]) -> Iterator[str]:
    """List what was left out or assumed: names in words, and what several ratings share said once."""
    rows = table.rows
    scales, levels = rows["scale"].unique(), rows["level"].unique()
    names = [*scales, RECAST, *levels, *table.metrics, *table.further, *RULES]
    arms = sorted({f"{scale}, {level}" for scale in scales for level in levels})
    told: dict[str, list[str]] = {}
    for note in dict.fromkeys(chain(table.notes, *(one.notes for one in found))):
        lead = next((arm for arm in arms if re.match(rf"{re.escape(arm)}[,:; ]", note)), "")
        told.setdefault(note[len(lead) :], []).append(lead)
    for rest, leads in told.items():
        yield words.format_note("; ".join(leads) + rest, names)
    shown = [name for key in ("scale", "level", "reducer") for name in rows[key].unique()]
    if letters := list_undrawable(shown):
        yield f"The figures' font has no {' '.join(letters)}: boxes stand for them; captions and tables show them."


def _write(table: Table, results: Results, *, found: Everything, target: Path) -> None:
    """Draw the figures, and write pages, tables and ``results.json``."""
    blocks: dict[str, list[Row]] = {question: [] for question in QUESTIONS}
    for section, one in found.items():
        if section.key in results.answers:
            blocks[section.question].append({
                "key": section.key, "title": section.title,
                "lines": results.answers[section.key], "pictures": one.pictures,
                "tables": [form.show(one.rows[form.name]) for form in list_shown((section, one))],
                "confirmatory": sum(row["status"] == words.CONFIRMATORY for row in results.verdicts if one.verdicts),
            })  # fmt: skip
    pictures = [picture for one in found.values() for picture in one.pictures]
    values: dict[str, Any] = {
        "results": results, "title": TITLE, "questions": QUESTIONS, "blocks": blocks,
        "sizes": {row["quantity"]: row["value"] for row in count_table(table)},
        "lead": next((one for one in pictures if one.name == "scatter"), None),
    }  # fmt: skip
    frames = {str(name): _tidy(part) for name, part in results.numbers.groupby("table", sort=False)}
    write_folder(
        target,
        results.to_dict(),
        page=lambda drawings: render_template("report.html", drawings=drawings, **values),
        details=render_template("details.html", **values),
        pictures=pictures,
        tables=frames | {DICTIONARY.removesuffix(".csv"): describe_tables([*found], frames)},
    )


def describe_tables(sections: Sequence[Section], frames: Mapping[str, DataFrame]) -> DataFrame:
    """Describe every column of every table, and every quantity that its column ``value`` holds."""
    described = make_dictionary({f"report/{name}.csv": frame for name, frame in frames.items()})
    known = {(form.name, one.name): (one.meaning, one.p) for section in sections
             for form in section.tables.values() for one in form.quantities}  # fmt: skip
    meaning = "in the column value: the quantity that is described"
    rows = [{"file": DICTIONARY, "column": "quantity", "type": "text", "meaning": meaning}]
    for name, frame in frames.items():
        for quantity in frame["quantity"].unique():
            meaning, p = known.get((name, quantity), ("", ""))
            meaning = meaning or quantity.replace("_", " ")
            meaning += "; p by Holm" * ("Holm" in p and "Holm" not in meaning)  # headed as adjusted
            row = {"file": f"{name}.csv", "column": "value", "quantity": quantity, "type": "number"}
            rows.append(row | {"meaning": meaning})
    return pd.concat([described, pd.DataFrame(rows)], ignore_index=True).fillna("")
