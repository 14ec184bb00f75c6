"""ABX trials: how well what a reducer made is told from its reference."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.contrasts.discrimination import discriminate_pairs
from analysis.figures.pairs import draw_discrimination
from analysis.numbers import COUNT, Number, count_number, make_interval, make_number, name_path
from analysis.primary.influence import adjust
from analysis.report.lines import Line
from analysis.report.pictures import Picture
from analysis.report.sections.effects import SIGNIFICANCE
from analysis.report.sections.section import INTERVAL, Cell, Grid, Section
from analysis.table.scales import ANSWERED
from analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pandas import DataFrame

    from analysis.contrasts.discrimination import Discrimination
    from analysis.report.sections.choices import Choices
    from analysis.table.reading import Table

KEY, TITLE = "discrimination", "Telling stimuli apart (ABX)"
RIGHT, WRONG = 100.0, 0.0
HOW = (
    "ABX: share of correct answers with Wilson's interval, exact binomial test against guessing (one-sided, p "
    "adjusted by Holm over reducers), and d' of an observer who judges A, B and X each by itself (Macmillan & "
    "Creelman 2005). Trials are pooled over people and recordings and taken for independent, so that intervals are "
    "about these people.",
)


def compute(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer.

    Parameters
    ----------
    table : Table
        All ratings; those of ABX trials are 100 or 0.
    choices : Choices
        Leave nothing to decide here.

    Returns
    -------
    Section
        Share correct and d' per reducer and level, anchors included.
    """
    rows = table.rows[table.rows["scale"] == ANSWERED]
    if rows.empty:
        return Section(KEY, TITLE)
    strange = rows[~rows["rating"].isin([RIGHT, WRONG])]
    if len(strange):
        why = f"got {len(strange)} answers that are neither 100 (right) nor 0 (wrong)"
        return Section(KEY, TITLE, notes=(f"Scale '{ANSWERED}' is not evaluated: {why}.",))
    found = _evaluate(rows)
    adjusted = dict(zip(found, adjust([result.p for result in found.values()]), strict=True))
    answer, counts = _judge(found, adjusted)
    figure = draw_discrimination({f"{name} ({tell_name(level)})": result for (level, name), result in found.items()})
    return Section(
        key=KEY, title=TITLE, answers=(answer,), verdict=(Line(answer),), unseen=counts, grids=(_lay(found, adjusted),),
        tables={"discrimination": _tabulate(found, adjusted)},
        pictures=(Picture("discrimination", "discrimination", CAPTION, figure),),
        notes=tuple(f"ABX, {name}, {level}: {note}" for (level, name), one in found.items() for note in one.notes),
        how=HOW,
    )  # fmt: skip


CAPTION = (
    "d' in ABX trials of each reducer against its reference, with 95 % intervals that follow from Wilson's; 0 is "
    "guessing."
)
Found = dict[tuple[str, str], "Discrimination"]


def _evaluate(rows: DataFrame) -> Found:
    """Discriminate every reducer from whatever its reference was."""
    trials = rows.assign(first=rows["reducer"], second="reference", correct=rows["rating"] == RIGHT)
    return {
        (str(level), str(name)): discriminate_pairs(part)[None]
        for (level, name), part in trials[trials["role"] != "reference"].groupby(["level", "reducer"], observed=True)
    }


def _lay(found: Found, adjusted: Mapping[tuple[str, str], float]) -> Grid:
    caption = (
        "Share of correct answers (guessing: 0.50) with Wilson's 95 % interval, test against guessing, and d'. A "
        "dash for d': infinite, no answer was wrong."
    )
    head = ("Reducer", "Level", "Share", "Interval", "d'", "Interval", "p (Holm)", "Correct", "Trials")
    rows: list[tuple[str | Cell, ...]] = []
    for (level, reducer), one in found.items():
        name, n = name_path("abx", level, reducer), one.n_trials
        share = _bound(f"{name}.share", (one.share, one.wilson_low, one.wilson_high), "share of correct answers", n=n)
        ends = one.d_independent, one.d_independent_low, one.d_independent_high
        distance = _bound(f"{name}.d", ends, "d', independent observations", n=n)
        p = make_number(f"{name}.p_holm", adjusted[level, reducer], "exact binomial test, Holm's adjustment", n=n)
        counts = (count_number(f"{name}.{key}", getattr(one, key), n=n) for key in ("n_correct", "n_trials"))
        shown = (Cell(number, part=part) for number in (share, distance) for part in ("value", INTERVAL))
        rows.append((reducer, tell_name(level), *shown, Cell(p, "p"), *(Cell(count, COUNT) for count in counts)))
    return Grid(caption, head, tuple(rows))


def _judge(found: Found, adjusted: Mapping[tuple[str, str], float]) -> tuple[str, tuple[Number, ...]]:
    told, n = sum(p < SIGNIFICANCE for p in adjusted.values()), len(found)
    numbers = count_number("abx.n_told_apart", told, n=n), count_number("abx.n_compared", n, n=n)
    apart = f"ABX: {told} of {n} reducers and anchors are told from their reference better than by guessing"
    return f"{apart} (p (Holm) < {SIGNIFICANCE}). Of the others neither that nor likeness is shown.", numbers


def _bound(name: str, numbers: tuple[float, float, float], method: str, *, n: int) -> Number:
    value, low, high = numbers
    number = make_number(name, value, method, n=n)
    return make_interval(number, low, high, uncertainty="95 % interval that follows from Wilson's")


def _tabulate(found: Found, adjusted: Mapping[tuple[str, str], float]) -> DataFrame:
    from dataclasses import asdict

    import pandas as pd

    rows: list[dict[str, Any]] = [
        {"level": level, "reducer": name, **asdict(one), "p_holm": adjusted[level, name], "notes": " ".join(one.notes)}
        for (level, name), one in found.items()
    ]
    return pd.DataFrame(rows)
