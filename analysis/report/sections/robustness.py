"""The primary slopes under other choices: of data, of scale, of raters."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.figures.slopes import draw_slopes
from analysis.figures.universes import draw_multiverse
from analysis.numbers import COUNT, count_number, make_number, name_path
from analysis.primary.model import fit_primary
from analysis.primary.multiverse import Estimate, run_multiverse
from analysis.primary.sensitivity import vary_primary
from analysis.report.pictures import Picture, make_slug
from analysis.report.sections.effects import fit_rest, lay_estimate, name_estimate
from analysis.report.sections.parts import ITEM, split_parts
from analysis.report.sections.section import Cell, Grid, Section
from analysis.words import tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from pandas import DataFrame

    from analysis.primary.model import Primary
    from analysis.primary.multiverse import Multiverse
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Row = dict[Hashable, Any]

KEY, TITLE = "robustness", "Under other choices"
MOST_CELLS = 20_000
"""Participants x stimuli beyond which some sixty models would take many minutes."""

SIZES = ("Combinations of rules", "Sets of raters", "With a model")

HOW = (
    "The primary slopes are re-estimated under other choices: correlated slopes of participants; no terms for "
    "reducers; ratings standardised within raters; ratings as logits; and, as a multiverse, without the raters flagged "
    "by each screening rule, each pair of rules, and all of them. Combinations that leave the same raters are one set "
    "and count once.",
)


def compute(table: Table, choices: Choices) -> Section:
    """Repeat the primary analysis under other choices.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Seed.

    Returns
    -------
    Section
        Range of the slopes over variants and over screening rules.
    """
    notes: list[str] = []
    varied: dict[str, DataFrame] = {}
    universes: dict[tuple[str, str], tuple[Part, Multiverse]] = {}
    pictures: list[Picture] = []
    parts = {part.lead: part for part in split_parts(table)}
    for part in parts.values():
        try:
            _check_size(part)
            varied[part.lead] = vary_primary(part.rows, table.metrics, leave_out=False)
            pictures.append(_draw_variants(part, table.metrics, varied[part.lead]))
            universes |= _run_universes(table, part, choices)
        except ValueError as error:
            notes.append(f"{part.lead}: no variants. {error}")
    grids = [_lay_variants(parts, varied)] if varied else []
    grids += [_lay_universes(universes)] if universes else []
    pictures += [_draw_universes(metric, *found) for (_, metric), found in universes.items() if len(found[1].curve)]
    return Section(
        key=KEY, title=TITLE, answers=tuple(map(_judge, universes.items())), grids=tuple(grids),
        tables=_make_tables(varied, universes), pictures=tuple(pictures),
        notes=(*notes, *_note_variants(varied)), how=HOW if grids else (),
    )  # fmt: skip


def _check_size(part: Part) -> None:
    cells = len(part.rows.groupby(["participant", ITEM], observed=True))
    if cells > MOST_CELLS:
        raise ValueError(f"They are left out for {cells} participant x stimulus cells; up to {MOST_CELLS} are varied.")


def _run_universes(table: Table, part: Part, choices: Choices) -> dict[tuple[str, str], tuple[Part, Multiverse]]:
    rows = table.rows
    own = rows[(rows["scale"] == part.scale) & (rows["level"] == part.level)]
    estimate = _remember_slopes(table.metrics, people=own["participant"].nunique())
    return {
        (part.lead, metric): (part, run_multiverse(own, estimate(metric), rng=choices.make_rng(KEY, *part.place)))
        for metric in table.metrics
    }


def _remember_slopes(metrics: tuple[str, ...], *, people: int) -> Callable[[str], Callable[[DataFrame], Estimate]]:
    """Fit each set of raters once, whichever metric is asked for."""
    known: dict[frozenset[Hashable], dict[str, Estimate]] = {}

    def fit(tests: DataFrame) -> dict[str, Estimate]:
        try:
            slopes = fit_rest(tests.assign(**{ITEM: tests["stimulus_id"]}), metrics, people=people).slopes
        except ValueError as error:
            return dict.fromkeys(metrics, Estimate(float("nan"), note=str(error)))
        ends = slopes[["tenth", "tenth_low", "tenth_high"]].itertuples(index=False)
        return {str(name): Estimate(*row) for name, row in zip(slopes.index, ends, strict=True)}

    def of_metric(metric: str) -> Callable[[DataFrame], Estimate]:
        def estimate(rows: DataFrame) -> Estimate:
            who = frozenset(rows["participant"])
            if who not in known:
                known[who] = fit(rows[rows["role"] == "test"])
            found = known[who].get(metric, Estimate(float("nan"), note=f"{metric} does not differ within recordings"))
            if found.note:
                raise ValueError(found.note)
            return found

        return estimate

    return of_metric


def _draw_variants(part: Part, metrics: tuple[str, ...], table: DataFrame) -> Picture:
    model: Primary = fit_primary(part.rows, metrics, explain=False)
    caption = (
        f"Slopes of {part.ratings} within recordings: above in points per +0.1 of the metric, below "
        "standardised, under other choices; 95 % Satterthwaite intervals."
    )
    figure = draw_slopes({part.lead: model}, variants={part.lead: table})
    return Picture(make_slug("variants", *part.place), "variants", caption, figure)


def _draw_universes(metric: str, part: Part, result: Multiverse) -> Picture:
    caption = (
        f"Slope of {part.ratings} on {tell_name(metric)}, points per +0.1, for every distinct set of raters that the "
        "screening rules leave, from the smallest up; 95 % Satterthwaite intervals. Below: the rules applied."
    )
    figure = draw_multiverse(result, estimate="Points per +0.1")
    return Picture(make_slug("multiverse", *part.place, metric), "multiverse", caption, figure, detail=True)


def _judge(found: tuple[tuple[str, str], tuple[Part, Multiverse]]) -> str:
    (_, metric), (part, result) = found
    what = f"Slope of {part.ratings} on {tell_name(metric)}"
    if not len(result.curve):
        return f"{what}: no set of raters is large enough to fit the model."
    if result.n_distinct == 1:
        alone = f"the {result.n_combinations} combinations of screening rules leave 1 distinct set of raters, everyone"
        return f"{what}: {tell_number(result.median, kind='slope')} points per +0.1; {alone}."
    reach = tell_range(result.smallest, result.largest, kind="slope")
    sets = f"{result.n_distinct} distinct sets of raters"
    some = f"{len(result.curve)} of " if len(result.curve) < result.n_distinct else ""
    few = "; the others leave too few raters to fit the model" if some else ""
    rules = f"{result.n_combinations} combinations of screening rules"
    return f"{what}: {reach} points per +0.1 across {some}{sets} from {rules}{few}."


def _lay_variants(parts: dict[str, Part], varied: dict[str, DataFrame]) -> Grid:
    caption = (
        "Standardised slope under other choices, with 95 % t intervals (Satterthwaite's df); p not adjusted. Only "
        "standardised slopes can be compared across units. A dash: no model; the notes say why."
    )
    head = ("Ratings", "Choice", "Metric", "Standardised slope", "Interval", "p")
    rows = [_lay_variant(parts[lead], row) for lead, table in varied.items() for row in table.to_dict("records")]
    return Grid(caption, head, tuple(rows))


def _lay_variant(part: Part, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path("variant", *part.place, row["variant"], row["metric"]), len(part.rows)
    value = name_estimate(name, row, "standardised slope", n=n, prefix="standardised")
    p = Cell(make_number(f"{name}.p", row["p"], "two-sided t test", n=n), "p")
    return (tell_name(part.lead), row["variant"], tell_name(row["metric"]), *lay_estimate(value, "slope"), p)


UNIVERSES = (
    "Slope (points per +0.1) across the distinct sets of raters that combinations of screening rules leave: "
    "median, smallest, largest, share with the same sign as with everyone, share of intervals that exclude zero, "
    "number of combinations, of distinct sets, and of sets with enough raters to fit the model."
)


def _lay_universes(universes: dict[tuple[str, str], tuple[Part, Multiverse]]) -> Grid:
    head = ("Ratings", "Metric", "Median", "Smallest", "Largest", "Same sign", "Excludes zero", *SIZES)
    rows: list[tuple[str | Cell, ...]] = []
    for (_, metric), (part, result) in universes.items():
        name, n = name_path("multiverse", *part.place, metric), result.n_distinct
        kinds = {"median": "slope", "smallest": "slope", "largest": "slope", "same_sign": "correlation",
                 "beyond_zero": "correlation"}  # fmt: skip
        values = [
            Cell(make_number(f"{name}.{key}", getattr(result, key), f"{key} over distinct sets of raters", n=n), kind)
            for key, kind in kinds.items()
        ]
        counts = {"n_combinations": result.n_combinations, "n_distinct": n, "n_defined": len(result.curve)}
        sizes = [Cell(count_number(f"{name}.{key}", count, n=n), COUNT) for key, count in counts.items()]
        rows.append((tell_name(part.lead), tell_name(metric), *values, *sizes))
    return Grid(UNIVERSES, head, tuple(rows))


def _note_variants(varied: dict[str, DataFrame]) -> Iterator[str]:
    for lead, table in varied.items():
        own = table.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said where it is told.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            yield f"{lead}, {'; '.join(names)}: {reason}"


def _make_tables(
    varied: dict[str, DataFrame], universes: dict[tuple[str, str], tuple[Part, Multiverse]]
) -> dict[str, DataFrame]:
    import pandas as pd

    tables = {}
    if varied:
        tables["variants"] = pd.concat(
            [table.assign(ratings=lead) for lead, table in varied.items()], ignore_index=True
        )
    if universes:
        found = [result.table.assign(ratings=lead, metric=metric) for (lead, metric), (_, result) in universes.items()]
        whole = pd.concat(found, ignore_index=True)
        tables["multiverse"] = whole.assign(excluded=[" ".join(map(str, who)) for who in whole["excluded"]])
    return tables
