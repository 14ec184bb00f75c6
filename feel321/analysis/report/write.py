"""Write a report: page, ``results.json``, tables and figures, all derived from two CSV files."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import chain, groupby
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.association.correlate import refuse_untested
from feel321.analysis.figures.style import list_undrawable
from feel321.analysis.page import render_template
from feel321.analysis.report import (
    association,
    delivered,
    front,
    maps,
    pairs,
    primary,
    raters,
    reducers,
    rivals,
    robustness,
    standard,
)
from feel321.analysis.report import choices as chosen
from feel321.analysis.report import paper as paper_section
from feel321.analysis.report.folder import ResultsFolder, list_files
from feel321.analysis.report.front import About
from feel321.analysis.report.section import Picture, Section, name_pictures
from feel321.analysis.report.standing import Standing, list_versions, mark_number, mark_section
from feel321.analysis.resampling import Choices
from feel321.analysis.screening.rules import RULES, find_rules
from feel321.analysis.table.items import find_sources, format_recordings
from feel321.analysis.table.reading import Further, Table, find_tables, read_table
from feel321.analysis.table.roster import ROSTER_FILE
from feel321.analysis.table.schema import RECAST
from feel321.doors import announce, as_seed, follow
from feel321.records import Result
from feel321.types import MetricInfo, PathLike, Progress, Rng

if TYPE_CHECKING:
    from markupsafe import Markup
    from pandas import DataFrame

    from feel321.analysis.replication.claims import Paper

SCHEMA_VERSION = 1
"""Version of ``results.schema.json``, which describes ``results.json``: raised when a field changes or goes."""


@dataclass(frozen=True, slots=True, repr=False, eq=False)
class Results(Result):
    """A report as data.

    Parameters
    ----------
    verdict : tuple of str
        The answer in words.
    verdicts : tuple of Claim
        The answer for programs: one per scale, level and metric.
    numbers : tuple of Number
        Every number shown.
    answers : Mapping of str to tuple of str
        What each section shows, in words, by its key.
    figures : Mapping of str to str
        Caption of each figure, by file name without suffix.
    captions : tuple of str
        What each table of the page shows.
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
    path : Path
        The report's folder.
    paper_claims : tuple of Mapping
        Where a paper is replicated, each of its claims with the verdict: a row of ``tables/paper_claims.csv``.
    about : Mapping of str to str
        Name of the study, and the day of the last rating, if known.
    headline : str
        The finding in one sentence.
    cards : tuple of MetricCard
        What the page opens with: effect, correlation and verdict of every metric on every scale.
    standing : Standing
        What was declared before the ratings, and whether that makes results confirmatory.
    """

    verdict: tuple[str, ...]
    verdicts: tuple[words.Claim, ...]
    numbers: tuple[words.Number, ...]
    answers: Mapping[str, tuple[str, ...]]
    figures: Mapping[str, str]
    captions: tuple[str, ...]
    notes: tuple[str, ...]
    how: tuple[str, ...]
    files: tuple[str, ...]
    simulated: bool
    inputs: Mapping[str, str]
    versions: Mapping[str, str]
    path: Path = Path()
    paper_claims: tuple[Mapping[str, Any], ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)
    headline: str = ""
    cards: tuple[front.MetricCard, ...] = ()
    standing: Standing = field(default_factory=Standing)

    def to_frame(self) -> DataFrame:
        """Return every number of the report.

        Returns
        -------
        DataFrame
            One row per number: its name and family, what it is of (scale, level, metric, and a column for each further
            key, such as reducer), statistic, value, interval, kind of interval, method and n.
        """
        import pandas as pd

        rows = [number.to_dict() for number in self.numbers]
        frame = pd.DataFrame([{**row["keys"], **row} for row in rows]).drop(columns="keys")
        first = list(rows[0]) if rows else []
        own = [name for name in first if name != "keys"]
        frame = frame[[*own, *(name for name in frame if name not in own)]]
        return frame.astype(dict.fromkeys(("value", "low", "high"), float))

    def summary(self) -> str:
        """Write the answer, a line per finding.

        Returns
        -------
        str
            What opens the report.
        """
        return "\n".join(self.verdict)

    def to_dict(self) -> dict[str, Any]:
        """Return what ``results.json`` holds.

        Returns
        -------
        dict
            A number that is not defined is None.
        """
        fields = {name: getattr(self, name) for name in self.__dataclass_fields__ if name != "path"}
        claims = [_without_nan(dict(one)) for one in self.paper_claims]
        return {
            "schema_version": SCHEMA_VERSION, "about": dict(self.about), "standing": self.standing.to_dict(),
            "headline": self.headline,
            "cards": [_without_nan(asdict(card)) for card in self.cards], "verdict": self.verdict,
            "verdicts": [asdict(claim) for claim in self.verdicts], "simulated": self.simulated,
            "numbers": [number.to_dict() for number in self.numbers],
            "answers": dict(self.answers), "figures": dict(self.figures),
            **{name: fields[name] for name in ("captions", "notes", "how", "files")},
            "inputs": dict(self.inputs), "versions": dict(self.versions),
        } | ({"paper_claims": claims} if claims else {})  # fmt: skip

    def to_json(self) -> str:
        """Write as JSON text, the same text for the same results.

        Returns
        -------
        str
            UTF-8 JSON; a number that is not defined is null.
        """
        return json.dumps(self.to_dict(), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def _without_nan(fields: dict[str, object]) -> dict[str, object]:
    return {
        key: None if isinstance(value, float) and math.isnan(value) else value
        for key, value in fields.items()
    }


def collect_numbers(table: Table, numbers: Iterable[words.Number]) -> tuple[words.Number, ...]:
    """Put the sizes of a table before the numbers of its sections."""
    gathered = {repr(number): number for number in chain(_count_table(table), numbers)}.values()
    times = Counter(number.name for number in gathered)
    if doubled := [name for name, count in times.items() if count > 1]:
        raise ValueError(
            f"results: got {len(doubled)} names twice, first {doubled[0]}; every number needs its own"
        )
    return tuple(gathered)


def _count_table(table: Table) -> Iterator[words.Number]:
    rows = table.rows
    columns = ("participant", "recording", "stimulus_id", "reducer", "scale")
    sizes = {name: rows[name].nunique() for name in columns}
    sizes |= {"source": find_sources(rows).nunique(), "judgements": len(rows)}
    sizes["simulated_judgements"] = int(rows["simulated"].sum())
    for name, size in sizes.items():
        yield words.count_number(f"size.{name}", size, n=len(rows))


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
            told |= {role: IN_MEMORY, f"{role}_sha256": _digest_rows(source)}
        elif source.is_file() or role != "participants":
            told |= {role: source.name, f"{role}_sha256": _digest(source.read_bytes())}
    found = find_sources(table.rows)
    if not found.is_unique:
        told["sources"] = format_recordings(len(found), found.nunique())
        told["sources_sha256"] = _digest(json.dumps(found.to_dict(), sort_keys=True).encode())
    if further is not None and not further.metrics.empty:
        told["further_metrics"] = ", ".join(map(str, further.metrics))
        told["further_metrics_sha256"] = _digest_rows(further.metrics.sort_index(), index=True)
    told["metrics"] = ", ".join(table.metrics)
    margin = "none" if choices.margin is None else str(choices.margin)
    told |= {"draws": str(choices.draws), "margin": margin, "seed": str(choices.seed)}
    for rule in choices.rules:
        told |= {f"rule_{rule.name}": rule.place, f"rule_{rule.name}_sha256": rule.sha256}
    return told


def _digest_rows(rows: DataFrame, *, index: bool = False) -> str:
    return _digest(rows.to_csv(index=index, float_format="%.17g", lineterminator="\n").encode())


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


SECTIONS: tuple[Callable[[Table, Choices], Section], ...] = (
    primary.compute,
    rivals.compute,
    association.compute_association,
    reducers.compute_levels,
    reducers.compute_profile,
    reducers.compute_contrasts,
    chosen.compute_choices,
    pairs.compute_discrimination,
    pairs.compute_told_apart,
    pairs.compute_space,
    maps.compute_maps,
    association.compute_further,
    delivered.compute,
    raters.compute,
    robustness.compute_robustness,
    standard.compute,
)
"""The one list of a report's sections, in its order; each takes all ratings and gives a section, or the reason why
there is none."""


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
    rules: Sequence[object] = (),
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
    rules : sequence of str, callable or Method
        The lab's own screening rules, beside feel321's (`screen_raters`).
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
    >>> print(results.summary())  # doctest: +SKIP
    """
    choices = Choices(draws=draws, margin=margin, seed=as_seed(rng), rules=find_rules(rules))
    with (
        ResultsFolder(folder, background=True) as target,
        follow(progress or False, "report") as move,
    ):
        choice = {"metrics": metrics, "sources": sources, "further": further, "info": info}
        table, given = _open(ratings_path, manifest_path, **choice)
        about = about or About()
        table = front.order_scales(table, about.protocols)
        inputs = describe_inputs(given, table=table, further=further, choices=choices)
        if paper is not None:
            inputs |= {"paper": f"{paper.citation} doi:{paper.doi} ({paper.seen})"}
        with words.declaring(table.info):
            results = _write(table, choices, target, move=move, given=(inputs, paper, about))
    return replace(results, path=target.path)


def _write(
    table: Table,
    choices: Choices,
    target: ResultsFolder,
    *,
    move: Callable[[int, int], None],
    given: tuple[Mapping[str, str], Paper | None, About],
) -> Results:
    """Compute all sections, and draw the figures of each meanwhile; given: inputs, paper and what the study is."""
    inputs, paper, about = given
    sections = []
    for section in _compute(table, choices, move):
        sections.append(section)
        target.draw(section.pictures)
    announce("figures and page")
    sections = _reconcile(sections)
    if paper is not None:
        sections = [paper_section.compute(table, choices, paper, sections=sections), *sections]
    sections = [mark_section(section, about.standing) for section in sections]
    results = gather_results(table, sections, inputs=inputs, about=about)
    target.write(
        results.to_dict(),
        page=lambda drawings: render_page(results, sections, drawings=drawings),
        tables={name: rows for section in sections for name, rows in section.tables.items()},
        info=table.info,
    )
    return results


def _open(
    ratings: PathLike | DataFrame | Table,
    manifest: PathLike | DataFrame | None,
    **choices: Any,  # noqa: ANN401 - those of read_table
) -> tuple[Table, dict[str, Path | DataFrame]]:
    """Read the ratings; return them with what they were read from."""
    if isinstance(ratings, Table):
        if manifest is not None or any(choice is not None for choice in choices.values()):
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
    return read_table(ratings, manifest, **choices), given | paths


def _compute(
    table: Table, choices: Choices, progress: Callable[[int, int], None]
) -> Iterator[Section]:
    """Compute section after section."""
    import scipy.linalg  # noqa: F401 - brings a second library of linear algebra, whose threads are held too
    from threadpoolctl import threadpool_limits

    refuse_untested(table)
    # Matrices here are small: threads of the linear algebra wait for each other most of the time, and take nine
    # times as long on a busy machine.
    with threadpool_limits(limits=1, user_api="blas"):
        for number, compute in enumerate(SECTIONS, start=1):
            module, name = compute.__module__.rpartition(".")[2], compute.__name__
            announce(words.format_name(name.removeprefix("compute_") if "_" in name else module))
            section = compute(table, choices)
            own = name_pictures(section.pictures)
            pictures = tuple(_declare(picture, table) for picture in own)
            yield replace(section, pictures=pictures)
            progress(number, len(SECTIONS))


def _declare(picture: Picture, table: Table) -> Picture:
    """Let a figure that is drawn later call metrics by their labels."""
    if not callable(picture.drawing):
        return picture
    return replace(picture, drawing=partial(words.make_declaring, table.info, picture.drawing))


def _reconcile(sections: Sequence[Section]) -> list[Section]:
    """Say in front where correlations over all stimuli pooled point elsewhere than the primary model."""
    claims = [claim for section in sections for claim in section.claims]
    several = len({claim.level for claim in claims}) > 1

    def add(section: Section) -> Section:
        told = {panel: association.reconcile(panel, claims) for panel in section.panels}
        lines = [
            words.Line(text, association.name_subject(panel, several=several), "pooled")
            for panel, text in told.items()
            if text
        ]
        return replace(section, verdict=(*section.verdict, *lines))

    return [add(section) if section.panels else section for section in sections]


def gather_results(
    table: Table, sections: Sequence[Section], *, inputs: Mapping[str, str], about: About
) -> Results:
    """Gather what ``results.json`` holds."""
    rows = table.rows
    standing = about.standing
    numbers = collect_numbers(table, _gather(sections, "numbers"))
    numbers = tuple(mark_number(number, standing) for number in numbers)
    cards = front.make_cards(table, sections, numbers)
    names = [*rows["scale"].unique(), RECAST, *rows["level"].unique()]
    names += [*table.metrics, *table.further, *table.rivals]
    own = [words.format_note(note, [*names, *RULES]) for note in _gather(sections, "notes")]
    pictures = _gather(sections, "pictures")
    return Results(
        verdict=tuple(dict.fromkeys(map(str, _gather(sections, "verdict")))),
        verdicts=tuple(_gather(sections, "claims")),
        numbers=numbers,
        answers={section.key: tuple(section.answers) for section in sections if section.answers},
        figures={picture.name: picture.caption for picture in pictures},
        captions=tuple(grid.caption for grid in _gather(sections, "grids")),
        notes=tuple(dict.fromkeys((*table.notes, *own, *_note_undrawable(table)))),
        how=tuple(dict.fromkeys(_gather(sections, "how"))),
        files=list_files([picture.name for picture in pictures], _gather(sections, "tables")),
        paper_claims=paper_section.list_claims(sections),
        simulated=bool(rows["simulated"].any()),
        inputs=inputs,
        versions=list_versions(),
        about={"name": about.name, "date": about.date},
        headline=front.write_headline(cards, sections, numbers),
        cards=cards,
        standing=about.standing,
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
    from markupsafe import Markup

    sizes = {
        number.name.removeprefix("size."): number.value
        for number in results.numbers
        if number.name.startswith("size.")
    }
    return render_template(
        "report.html",
        results=results,
        subjects={
            subject: list(own) for subject, own in groupby(results.cards, attrgetter("subject"))
        },
        lead=front.choose_picture(results.cards, sections),
        blocks=front.group_sections(sections),
        others=front.list_others(sections),
        lines={
            section.key: front.split_lines(section, {card.subject for card in results.cards})
            for section in sections
        },
        drawings=drawings,
        sizes=sizes,
        points=Markup().join(section.points for section in sections),
        front=front,
    )
