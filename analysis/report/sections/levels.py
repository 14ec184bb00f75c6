"""Level arms compared, for the question whether something felt good because it was strong."""

from __future__ import annotations

from dataclasses import asdict
from itertools import combinations
from typing import TYPE_CHECKING, Any

from analysis.mixed.model import contrast, fit_mixed
from analysis.numbers import name_path
from analysis.primary.cells import make_cells
from analysis.primary.influence import adjust
from analysis.report.sections.effects import (
    SIGNIFICANCE,
    count_units,
    lay_estimate,
    name_estimate,
    name_tests,
    tell_estimate,
    tell_p,
    tell_reach,
)
from analysis.report.sections.parts import ITEM
from analysis.report.sections.section import Cell, Grid, Section
from analysis.report.sections.thinning import thin_rows
from analysis.table.scales import APART
from analysis.table.sources import find_sources
from analysis.words import start, tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from analysis.report.sections.choices import Choices
    from analysis.table.reading import Table

    Row = dict[Hashable, Any]

KEY, TITLE = "levels", "Level arms compared"
HOW = (
    "Level arms: a mixed model per scale of ratings on level, each metric within recordings, and their product, with "
    "spreads between participants, participants' levels, recordings, what was reduced how (shared by the arms), and "
    "stimuli (and, where several recordings come from one source, the same between sources). The difference in rating "
    "is at the mean of the metrics; the difference in slope says whether a metric "
    "counts for less once levels are equal. Satterthwaite's degrees of freedom; p adjusted by Holm.",
)


def compute(table: Table, choices: Choices) -> Section:
    """Compare the levels at which stimuli were rated.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    choices : Choices
        Seed, for what is too large to be fitted as a whole.

    Returns
    -------
    Section
        Differences between levels in rating and in slope.
    """
    rows = table.rows
    tests = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    tests = tests[tests["matched"]] if "matched" in tests else tests
    if len(tests["level"].unique()) < 2:  # noqa: PLR2004 - one arm has nothing to be compared with
        return Section(KEY, TITLE)
    notes: list[str] = []
    found = list(_compare_scales(tests, table.metrics, choices=choices, notes=notes))
    if not found:
        return Section(KEY, TITLE, notes=tuple(notes))
    adjusted = adjust([row["p"] for row in found])
    found = [{**row, "p_holm": holm} for row, holm in zip(found, adjusted, strict=True)]
    caption = (
        "First level minus second: in rating (points), and in the slope on each metric (points per +0.1). 95 % "
        "intervals; p adjusted over this table."
    )
    head = ("Ratings", "First", "Second", "Of", "Difference", "Interval", "df", "p", "p (Holm)")
    return Section(
        key=KEY, title=TITLE, answers=tuple(map(_judge, found)),
        grids=(Grid(caption, head, tuple(map(_lay, found)), detail=False),), tables={"levels": _tabulate(found)},
        notes=tuple(notes), how=HOW,
    )  # fmt: skip


def _compare_scales(
    tests: DataFrame, metrics: tuple[str, ...], *, choices: Choices, notes: list[str]
) -> Iterator[Row]:
    for name, rows in tests.assign(**{ITEM: tests["stimulus_id"]}).groupby("scale", observed=True):
        scale = str(name)
        part, thinned = thin_rows(rows, n_slopes=len(metrics), rng=choices.make_rng(KEY, scale))
        notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        try:
            yield from [{"scale": scale, "reach": count_units(part), **row} for row in _compare(part, metrics)]
        except ValueError as error:
            notes.append(f"{scale}: levels are not compared. {error}")


def _tabulate(found: list[Row]) -> DataFrame:
    import pandas as pd

    return pd.DataFrame(found).drop(columns="reach")


def _compare(part: DataFrame, metrics: tuple[str, ...]) -> Iterator[Row]:
    levels = sorted(part["level"].unique())
    if len(levels) == 1:
        raise ValueError(f"All were rated at one level, '{levels[0]}'.")
    codes = {level: f"c{number}" for number, level in enumerate(levels)}
    cells = _gather(part, metrics)
    used = [name for name in metrics if cells[f"{name}_w"].std() > 0]
    slopes = [f"arm:`{name}_w`" for name in used]
    people = ["(1 | participant)", "(1 | participant:arm)"] if len(part["participant"].unique()) > 1 else []
    scenes = ["(1 | recording)"] if len(part["recording"].unique()) > 1 else []
    groups = [*people, *scenes, "(1 | base)", *_item_term(cells), *_source_terms(cells)]
    formula = " + ".join(["rating ~ 0 + arm", *slopes, *groups])
    fit = fit_mixed(formula, cells.assign(arm=cells["level"].map(codes)))
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        pair: Row = {"first": first, "second": second, "n": len(cells)}
        wanted = {"rating": {one: 1.0, two: -1.0}}
        wanted |= {name: {f"{one}:{name}_w": 0.1, f"{two}:{name}_w": -0.1} for name in used}
        for what, weights in wanted.items():
            found: Row = dict(asdict(contrast(fit, weights)).items())
            yield pair | {"of": what} | found


def _item_term(cells: DataFrame) -> list[str]:
    return [f"(1 | {ITEM})"] if len(cells[ITEM].unique()) < len(cells) else []


def _source_terms(cells: DataFrame) -> list[str]:
    """Name what recordings of one source share: as a whole, of what was reduced alike, and of that at one level."""
    recordings, sources = (len(cells[name].unique()) for name in ("recording", "source"))
    if sources == recordings:
        return []
    whole = ["source"] if sources > 1 else []
    return [f"(1 | {group})" for group in (*whole, "source:reducer", "source:reducer:level")]


def _gather(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    import pandas as pd

    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        cells = make_cells(arm, metrics).table
        means = cells.groupby(["participant", "recording", ITEM], observed=True).mean(numeric_only=True).reset_index()
        reducers = means[ITEM].map(arm.drop_duplicates(ITEM).set_index(ITEM)["reducer"])
        places = {"base": means["recording"] + "/" + reducers, "source": means["recording"].map(sources)}
        tables.append(means.assign(level=level, reducer=reducers, **places))
    return pd.concat(tables, ignore_index=True)


def _lay(row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path("level", row["scale"], row["first"], row["second"], row["of"]), row["n"]
    unit = "points of rating" if row["of"] == "rating" else "points per +0.1 of the metric"
    value = name_estimate(name, row, f"mixed model, {unit}, first level minus second", n=n)
    names = tell_name(row["scale"]), tell_name(row["first"]), tell_name(row["second"]), tell_name(row["of"])
    return (*names, *lay_estimate(value, "slope"), *map(Cell, name_tests(name, row, n=n), ("df", "p", "p")))


def _judge(row: Row) -> str:
    what = f"{tell_name(row['scale'])} ratings"
    arms = f"at {tell_name(row['first'])} than at {tell_name(row['second'])}"
    value = name_estimate("", row, "", n=row["n"])
    evidence = f"({tell_estimate(value, kind='slope')}; {tell_p(row['p_holm'])})"
    decided, more = row["p_holm"] < SIGNIFICANCE, row["estimate"] > 0
    if row["of"] == "rating":
        if not decided:
            between = f"between {tell_name(row['first'])} and {tell_name(row['second'])}"
            return f"Whether {what} differ {between} is undecided {evidence}."
        return f"{start(what)} are {'higher' if more else 'lower'} {arms} {evidence}{tell_reach(row['reach'])}."
    metric = tell_name(row["of"])
    if not decided:
        return f"Whether {metric} counts otherwise for {what} {arms} is undecided (difference of slopes {evidence[1:]}."
    slope = f"the slope on {metric} is {'larger' if more else 'smaller'}"
    return f"For {what} {slope} {arms} {evidence}{tell_reach(row['reach'])}."
