"""Refined metrics: whether a combination of metrics, or another shape of one, is worth having."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from analysis.numbers import COUNT, TWO_WAY, count_number, make_interval, make_number, name_path
from analysis.refined.candidates import EQUAL
from analysis.refined.refine import refine_metric
from analysis.report.lines import Line
from analysis.report.sections.parts import split_parts
from analysis.report.sections.section import INTERVAL, Cell, Grid, Section
from analysis.words import start, tell_name, tell_number, tell_range

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator

    from pandas import DataFrame

    from analysis.refined.refine import Refined
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

    Row = dict[Hashable, Any]
    Found = list[tuple[Part, Refined]]

KEY, TITLE = "refined", "Would a refined metric predict better?"
DRAWS = 400
"""Each draw repeats the whole search, and more of them change the interval's width by a few hundredths only."""

AMPLITUDE, LEVEL = "rms_m_s2", "level in dB"
"""The amplitude that a manifest may tell, and the term made of it."""

OUT_OF_FOLD = "of differences within recordings, out of fold"
HOW = (
    "Refined metrics: each metric, metrics to the power 0.5 or 2, their sum with equal weights, and weighted sums are "
    "compared by nested cross-validation of differences within recordings: the inner one takes the simplest candidate "
    "within one standard error of the least squared error, the outer one judges that on recordings and participants "
    "that had no part in it (Varma & Simon 2006, doi 10.1186/1471-2105-7-91). Intervals are two-way bootstrap "
    f"intervals that repeat the search, of at most {DRAWS} draws. A refinement is recommended only where its gain over "
    "every single metric is above zero with its whole interval; intervals are not adjusted for their number.",
)


def compute(table: Table, choices: Choices) -> Section:
    """Search a refined metric for every scale and level.

    Parameters
    ----------
    table : Table
        Ratings and metrics; with a column ``rms_m_s2``, the level may enter a sum, and so may further metrics.
    choices : Choices
        Draws and seed.

    Returns
    -------
    Section
        What the search is worth out of fold, gains over each metric, candidates, weights.
    """
    found: Found = []
    notes: list[str] = []
    for part in split_parts(table):
        lead = f"{part.lead}, refined metrics"
        try:
            result = _search(part, table, choices)
        except ValueError as error:
            notes.append(f"{lead}: none is searched. {error}")
            continue
        found.append((part, result))
        notes += [f"{lead}: {note}" for note in result.notes]
    if not found:
        return Section(KEY, TITLE, notes=tuple(notes))
    return Section(
        key=KEY, title=TITLE, answers=tuple(_judge(part, result) for part, result in found),
        verdict=tuple(_sum_up(found)),
        grids=(_lay_scores(found), _lay_gains(found), _lay_candidates(found), _lay_weights(found)),
        tables=_make_tables(found), notes=tuple(notes), how=HOW,
    )  # fmt: skip


def _search(part: Part, table: Table, choices: Choices) -> Refined:
    rows, others = part.rows, list(table.further)
    if AMPLITUDE in rows and (rows[AMPLITUDE] > 0).all():
        rows, others = rows.assign(**{LEVEL: 20 * np.log10(rows[AMPLITUDE])}), [LEVEL, *others]
    rng = choices.make_rng(KEY, *part.place)
    return refine_metric(rows, table.metrics, others=others, draws=min(choices.draws, DRAWS), rng=rng)


def _sum_up(found: Found) -> Iterator[Line]:
    """Open the report with what is recommended; of all the rest, in one line, that it is not."""
    for part, result in found:
        if result.recommended:
            yield Line(_judge(part, result))
    rest = [_find_best(result) for _, result in found if not result.recommended]
    if not rest:
        return
    others = "further " if len(rest) < len(found) else ""
    claim = f"No {others}refined metric is recommended"
    gains = sorted(gain["value"] for gain in rest if np.isfinite(gain["low"]))
    if not gains:
        yield Line(f"{claim}: gains have no interval here.")
        return
    reach = tell_range(gains[0], gains[-1]) if len(gains) > 1 else tell_number(gains[0])
    covering = sum(gain["low"] <= 0 <= gain["high"] for gain in rest)
    each = "its interval covers" if len(rest) == 1 else "each 95 % two-way interval covers"
    shown = f"; {each} zero" if covering == len(rest) else ""
    gained = f"gain{'s' if len(gains) > 1 else ''} in correlation over the best single metric {reach}, out of fold"
    yield Line(f"{claim} ({gained}{shown}).")


def _find_best(result: Refined) -> Row:
    """Find the gain over the metric that correlates most by itself."""
    best: Row = result.gains.sort_values("plain", ascending=False).to_dict("records")[0]
    return best


def _judge(part: Part, result: Refined) -> str:
    gain = _find_best(result)
    told = f"{tell_number(gain['value'])} (95 % two-way interval {tell_range(gain['low'], gain['high'])})"
    pair = f"{tell_number(result.value)} with what the search finds, {tell_number(gain['plain'])} with"
    scored = "differences within recordings, of recordings and people left out, correlate by"
    reach = f"{scored} {pair} {tell_name(gain['metric'])}, the best single metric here, a gain of {told}"
    if result.recommended:
        return f"{start(part.subject)}: {_tell_choice(result)} predicts better than each metric: {reach}."
    if np.isfinite(gain["low"]) and gain["low"] > 0:
        simple = "but one is not chosen on all ratings, or does not gain over every single metric"
        return f"{start(part.subject)}: no refined metric is recommended: {reach}, {simple}."
    if np.isnan(gain["low"]):
        return f"{start(part.subject)}: no refined metric is recommended: its gain has no interval here."
    below = "is below" if gain["high"] < 0 else "covers"
    return f"{start(part.subject)}: no refined metric is recommended: {reach}; the interval {below} zero."


def _tell_choice(result: Refined) -> str:
    if result.chosen == EQUAL:
        return "the sum of the metrics, each in standard deviations, with equal weights,"
    return f"the weighted sum of {tell_name(result.chosen)}" if " + " in result.chosen else tell_name(result.chosen)


def _lay_scores(found: Found) -> Grid:
    caption = (
        "What a refined metric is worth on recordings and participants that had no part in making it, for differences "
        "within recordings: correlation, its share of the noise ceiling, error in points. 95 % two-way intervals."
    )
    head = (
        "Ratings", "Chosen", "Recommended", "r", "Interval", "Noise ceiling", "r / ceiling", "rmse", "Interval",
        "Stimuli", "Participants", "Recordings", "Folds", "Draws",
    )  # fmt: skip
    return Grid(caption, head, tuple(_lay_score(part, result) for part, result in found))


def _lay_score(part: Part, result: Refined) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY, *part.place), result.n_items
    value = make_number(f"{name}.value", result.value, f"correlation with the refined metric {OUT_OF_FOLD}", n=n)
    value = make_interval(value, result.low, result.high, uncertainty=TWO_WAY)
    error = make_number(f"{name}.rmse", result.rmse, f"root mean squared error {OUT_OF_FOLD}", n=n)
    error = make_interval(error, result.rmse_low, result.rmse_high, uncertainty=TWO_WAY)
    ceiling = make_number(f"{name}.ceiling", result.ceiling, "noise ceiling within recordings", n=n)
    share = make_number(f"{name}.share", result.share, "correlation / ceiling", n=n)
    counts = [
        Cell(count_number(f"{name}.{what}", getattr(result, what), n=n), COUNT)
        for what in ("n_items", "n_participants", "n_recordings", "n_folds", "draws")
    ]
    recommended = "yes" if result.recommended else "no"
    return (
        _tell_place(part), tell_name(result.chosen), recommended, Cell(value), Cell(value, part=INTERVAL),
        Cell(ceiling), Cell(share), Cell(error, "rating"), Cell(error, "rating", INTERVAL), *counts,
    )  # fmt: skip


def _lay_gains(found: Found) -> Grid:
    caption = (
        "Gain in correlation of the refined metric out of fold over each metric as it is, to which nothing is fitted; "
        "and the error of that metric, mapped to points out of fold. 95 % two-way intervals, not adjusted."
    )
    head = ("Ratings", "Metric", "r of the metric", "Gain", "Interval", "rmse of the metric")
    rows = [_lay_gain(part, result, row) for part, result in found for row in result.gains.to_dict("records")]
    return Grid(caption, head, tuple(rows))


def _lay_gain(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY, *part.place, "over", row["metric"]), result.n_items
    plain = make_number(f"{name}.plain", row["plain"], "correlation of differences within recordings", n=n)
    gain = make_number(f"{name}.gain", row["value"], f"gain in correlation {OUT_OF_FOLD}", n=n)
    gain = make_interval(gain, row["low"], row["high"], uncertainty=TWO_WAY)
    error = make_number(f"{name}.rmse", row["rmse"], f"root mean squared error {OUT_OF_FOLD}", n=n)
    return (
        _tell_place(part), tell_name(row["metric"]), Cell(plain), Cell(gain), Cell(gain, part=INTERVAL),
        Cell(error, "rating"),
    )  # fmt: skip


def _lay_candidates(found: Found) -> Grid:
    caption = (
        "Candidates, each as if it had been the only one: correlation and error out of fold, and the share of outer "
        "folds in which it was chosen. The best of this table flatters; what the search is worth stands above."
    )
    head = ("Ratings", "Candidate", "Parameters", "r", "rmse", "Chosen")
    rows = [_lay_candidate(part, result, row) for part, result in found for row in result.candidates.to_dict("records")]
    return Grid(caption, head, tuple(rows))


def _lay_candidate(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY, *part.place, "candidate", row["name"]), result.n_items
    return (
        _tell_place(part), tell_name(row["name"]),
        Cell(count_number(f"{name}.parameters", row["parameters"], n=n), COUNT),
        Cell(make_number(f"{name}.value", row["value"], f"correlation {OUT_OF_FOLD}", n=n)),
        Cell(make_number(f"{name}.rmse", row["rmse"], f"root mean squared error {OUT_OF_FOLD}", n=n), "rating"),
        Cell(make_number(f"{name}.chosen", row["chosen"], "share of outer folds", n=result.n_folds)),
    )  # fmt: skip


def _lay_weights(found: Found) -> Grid:
    caption = (
        "Weights of what is chosen on all ratings: points per standard deviation of each term within recordings, the "
        "smallest and the largest over the outer folds, and points per unit of the term."
    )
    head = ("Ratings", "Term", "Weight", "Smallest", "Largest", "Per unit")
    rows = [_lay_weight(part, result, row) for part, result in found for row in result.weights.to_dict("records")]
    return Grid(caption, head, tuple(rows))


def _lay_weight(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY, *part.place, "weight", row["term"]), result.n_items
    methods = {
        "weight": "least squares, points per standard deviation", "lowest": "smallest over outer folds",
        "highest": "largest over outer folds", "per_unit": "least squares, points per unit",
    }  # fmt: skip
    cells = [Cell(make_number(f"{name}.{key}", row[key], how, n=n), "slope") for key, how in methods.items()]
    return (_tell_place(part), tell_name(row["term"]), *cells)


def _tell_place(part: Part) -> str:
    return f"{tell_name(part.scale)}, {tell_name(part.level)}"


def _make_tables(found: Found) -> dict[str, DataFrame]:
    import pandas as pd

    def stack(name: str) -> DataFrame:
        return pd.concat([_place(getattr(result, name), part) for part, result in found], ignore_index=True)

    return {f"refined_{name}": stack(name) for name in ("gains", "candidates", "weights")}


def _place(table: DataFrame, part: Part) -> DataFrame:
    placed = table.assign(scale=part.scale, level=part.level)
    return placed[["scale", "level", *table.columns]]
