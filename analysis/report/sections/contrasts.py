"""Reducers against each other: differences, equivalence, non-inferiority of the simpler one."""

from __future__ import annotations

from dataclasses import asdict
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from analysis.contrasts.equivalence import equivalence, non_inferiority
from analysis.figures.contrasts import draw_equivalence
from analysis.mixed.model import contrast, fit_mixed
from analysis.numbers import count_number, make_number, name_path
from analysis.primary.influence import adjust
from analysis.report.pictures import Picture, make_slug
from analysis.report.sections.effects import (
    SIGNIFICANCE,
    count_units,
    lay_estimate,
    name_estimate,
    name_tests,
    tell_reach,
)
from analysis.report.sections.parts import ITEM
from analysis.report.sections.section import Cell, Grid, Section
from analysis.report.sections.thinning import thin_parts
from analysis.table.reading import order_reducers
from analysis.table.sources import find_sources
from analysis.words import start

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from analysis.contrasts.equivalence import Equivalence
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Row = dict[Hashable, Any]

KEY, TITLE = "contrasts", "Reducers against each other"
REDUCER = "reducer"
HOW = (
    "Reducers compared: a mixed model per scale and level of ratings on reducer, with spreads between participants, "
    "recordings, stimuli, participants' recordings and participants' reducers (and, where several recordings come from "
    "one source, between sources and sources' reducers); differences with Satterthwaite's "
    "degrees of freedom, p adjusted by Holm. Equivalence by two one-sided tests (Schuirmann 1987, doi "
    "10.1007/BF01068419): shown where the 90 % interval lies within the margin. Non-inferiority: the reducer named "
    "first, which is the simpler by the order of feel321's list, is not worse than the other by the margin or more "
    "(5 %, one-sided). Neither is adjusted for the number of pairs; no difference found is no proof of equivalence.",
)


class _Margin(NamedTuple):
    """The difference that does not matter, and where it comes from."""

    points: float
    source: str
    n: int


class _Pair(NamedTuple):
    """Two reducers and what tells them apart."""

    row: Row
    test: Equivalence | None


def compute(table: Table, choices: Choices) -> Section:
    """Compare every two reducers on every scale and level.

    Parameters
    ----------
    table : Table
        Ratings.
    choices : Choices
        The margin.

    Returns
    -------
    Section
        Differences with Holm's adjustment, equivalence, non-inferiority.
    """
    answers, notes, grids, numbers = [], [], [], []
    tables: dict[str, DataFrame] = {}
    pictures: list[Picture] = []
    # A person's reducers are so many effects.
    for part in thin_parts(table, choices, n_slopes=table.rows[REDUCER].nunique(), matched=False):
        notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        margin = _find_margin(part, choices)
        try:
            pairs = _compare(part.rows, margin)
        except ValueError as error:
            notes.append(f"{part.lead}: reducers are not compared. {error}")
            continue
        rows = [_lay_pair(pair, part) for pair in pairs]
        grids.append(Grid(_caption(part, margin, pairs), HEAD, tuple(rows)))
        numbers.append(make_number(name_path("margin", *part.place), margin.points, margin.source, n=margin.n))
        notes += [] if margin.points > 0 else [f"{part.lead}: no equivalence. {margin.source}"]
        answers.append(_judge(pairs, part))
        differ = count_number(name_path("contrasts", *part.place, "n_differ"), _count_different(pairs), n=len(pairs))
        numbers += [differ, count_number(name_path("contrasts", *part.place, "n_pairs"), len(pairs), n=len(pairs))]
        tables[part.lead] = _tabulate(pairs, part)
        pictures += _draw(pairs, part)
    return Section(
        key=KEY, title=TITLE, answers=tuple(answers), grids=tuple(grids), unseen=tuple(numbers), tables=_stack(tables),
        pictures=tuple(pictures), notes=tuple(notes), how=HOW if grids else (),
    )  # fmt: skip


HEAD = (
    "First", "Second", "Difference", "Interval", "df", "p", "p (Holm)", "Equivalence p", "Equivalent",
    "Non-inferiority p", "First not worse",
)  # fmt: skip


def find_repeat_sd(rows: DataFrame) -> tuple[float, int]:
    """Find the standard deviation with which people repeat their ratings of a stimulus.

    Parameters
    ----------
    rows : DataFrame
        One row per judgement: participant, item, rating.

    Returns
    -------
    sd : float
        √(Σ (y - cell mean)² / Σ (repeats - 1)); of two repeats √(Σ d²/(2n)). NaN without repeats.
    n : int
        Ratings of cells that were rated more than once.
    """
    cells = rows.groupby(["participant", ITEM], observed=True)["rating"]
    repeated = cells.transform("size") > 1
    freedom = int(repeated.sum()) - len(rows[repeated].groupby(["participant", ITEM], observed=True))
    left = (rows["rating"] - cells.transform("mean"))[repeated]
    return (float(np.sqrt((left**2).sum() / freedom)) if freedom else float("nan")), int(repeated.sum())


def _find_margin(part: Part, choices: Choices) -> _Margin:
    if choices.margin is not None:
        return _Margin(choices.margin, "margin fixed beforehand", len(part.rows))
    sd, n = find_repeat_sd(part.rows)
    if not n:
        return _Margin(float("nan"), "Nobody rated a stimulus twice, so there is no margin: fix `margin` (points).", n)
    if not sd > 0:
        return _Margin(float("nan"), "All repeats are alike, so there is no margin: fix `margin` (points).", n)
    return _Margin(sd / 2, "half the standard deviation with which people repeat their ratings", n)


def _compare(rows: DataFrame, margin: _Margin) -> list[_Pair]:
    names = order_reducers(rows[REDUCER])
    if len(names) == 1:
        raise ValueError(f"Only one was rated, '{names[0]}'.")
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    cells = rows.groupby(["participant", "recording", REDUCER, ITEM], observed=True)["rating"].mean().reset_index()
    cells["source"] = cells["recording"].map(find_sources(rows))
    fit = fit_mixed(_plan(cells), cells.assign(which=cells[REDUCER].map(codes)))
    found: list[Row] = []
    for first, second in combinations(names, 2):
        weights = {f"which{codes[first]}": 1, f"which{codes[second]}": -1}
        estimate: Row = dict(asdict(contrast(fit, weights)).items())
        found.append({"first": first, "second": second} | estimate)
    adjusted = adjust([row["p"] for row in found])
    rows_of = [{**row, "p_holm": holm, "n": len(cells)} for row, holm in zip(found, adjusted, strict=True)]
    return [_test(row, margin) for row in rows_of]


def _plan(cells: DataFrame) -> str:
    """Write the model; a spread that has one row per level is in the residual already."""
    groups = {
        "participant": ["participant"], "recording": ["recording"], ITEM: [ITEM],
        "participant:recording": ["participant", "recording"], "participant:which": ["participant", REDUCER],
        "source": ["source"], "source:which": ["source", REDUCER],
    }  # fmt: skip
    sizes = {name: len(cells.drop_duplicates(columns)) for name, columns in groups.items()}
    kept = [name for name, size in sizes.items() if 1 < size < len(cells)]
    if sizes["recording"] == 1:
        kept = [name for name in kept if name not in {ITEM, "participant:recording"}]
    if sizes["source"] in {1, sizes["recording"]}:
        kept = [name for name in kept if not name.startswith("source")]
    if sizes["participant"] == 1:
        kept = [name for name in kept if not name.startswith("participant")]
    if not kept:
        raise ValueError("One participant and one recording leave nothing to judge a difference by.")
    return " + ".join(["rating ~ 0 + which", *(f"(1 | {name})" for name in kept)])


def _test(row: Row, margin: _Margin) -> _Pair:
    if not (margin.points > 0 and 0 < row["se"] < np.inf):
        return _Pair(row | {"p_equivalence": np.nan, "p_non_inferiority": np.nan, "margin": margin.points}, None)
    numbers = row["estimate"], row["se"], row["df"]
    test = equivalence(*numbers, low=-margin.points, high=margin.points)
    worse = non_inferiority(*numbers, margin=-margin.points)
    return _Pair(row | {"p_equivalence": test.p, "p_non_inferiority": worse.p, "margin": margin.points}, test)


def _lay_pair(pair: _Pair, part: Part) -> tuple[str | Cell, ...]:
    row = pair.row
    name, n = name_path("contrast", *part.place, row["first"], row["second"]), row["n"]
    value = name_estimate(name, row, "mixed model, points of rating, first minus second", n=n)
    df, p, holm = name_tests(name, row, n=n)
    return (
        row["first"], row["second"], *lay_estimate(value, "rating"), Cell(df, "df"), Cell(p, "p"), Cell(holm, "p"),
        *_lay_test(name, row, "equivalence"), *_lay_test(name, row, "non_inferiority"),
    )  # fmt: skip


def _lay_test(name: str, row: Row, test: str) -> tuple[Cell, str]:
    p = row[f"p_{test}"]
    said = "–" if np.isnan(p) else "yes" if p < SIGNIFICANCE else "not shown"
    return Cell(make_number(f"{name}.p_{test}", p, test.replace("_", "-"), n=row["n"]), "p"), said


def _caption(part: Part, margin: _Margin, pairs: list[_Pair]) -> str:
    differ = (
        f"{start(part.subject)}: difference of the first reducer from the second in points, from the mixed model, with "
        f"95 % intervals for {_tell_others(part)}; p adjusted over {len(pairs)} pairs."
    )
    if not margin.points > 0:
        return f"{differ} {margin.source}"
    return f"{differ} Margin of equivalence and non-inferiority: {margin.points:.1f} points ({margin.source})."


def _tell_others(part: Part) -> str:
    """Say for whom and what else intervals hold."""
    several = [f"other {name}s" for name, count in count_units(part.rows).items() if count > 1]
    return " and ".join(several).replace("participants", "people")


def _count_different(pairs: list[_Pair]) -> int:
    return sum(pair.row["p_holm"] < SIGNIFICANCE for pair in pairs)


def _judge(pairs: list[_Pair], part: Part) -> str:
    alike = [f"{pair.row['first']} and {pair.row['second']}" for pair in pairs if pair.test and pair.test.equivalent]
    told = f"{_count_different(pairs)} of {len(pairs)} pairs of reducers differ after Holm's adjustment"
    tested = "none is shown to be equivalent" if any(pair.test for pair in pairs) else "equivalence is not tested"
    same = f"shown to be equivalent: {_list(alike)}" if alike else tested
    reach = tell_reach(count_units(part.rows), claimed=bool(alike) or _count_different(pairs) > 0)
    return f"{start(part.subject)}: {told}; {same}{reach}."


def _list(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more pairs" if len(names) > most else ""
    return "; ".join(names[:most]) + more


def _tabulate(pairs: list[_Pair], part: Part) -> DataFrame:
    import pandas as pd

    return pd.DataFrame([{"scale": part.scale, "level": part.level, **pair.row} for pair in pairs])


def _stack(tables: dict[str, DataFrame]) -> dict[str, DataFrame]:
    import pandas as pd

    return {"contrasts": pd.concat(tables.values(), ignore_index=True)} if tables else {}


def _draw(pairs: list[_Pair], part: Part) -> Iterator[Picture]:
    tests = {f"{pair.row['first']} − {pair.row['second']}": pair.test for pair in pairs if pair.test}
    if not tests:
        return
    people, scenes = len(part.rows["participant"].unique()), find_sources(part.rows)
    caption = (
        f"Differences between reducers in {part.ratings} with 90 % intervals; shaded: the margin of "
        "equivalence. Filled: equivalence is shown."
    )
    figure = draw_equivalence(tests, n_participants=people, n_recordings=len(scenes), n_sources=scenes.nunique())
    yield Picture(make_slug("equivalence", *part.place), "equivalence", caption, figure, detail=True)
