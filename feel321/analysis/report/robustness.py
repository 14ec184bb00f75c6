"""Sections: the primary slopes under other choices, and refined metrics."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.figures.choices import draw_multiverse
from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.multiverse import Estimate, run_multiverse
from feel321.analysis.primary.sensitivity import vary_primary
from feel321.analysis.refined.candidates import EQUAL
from feel321.analysis.refined.refine import refine_metric
from feel321.analysis.report._old import INTERVAL, Cell, Grid, lay_estimate, name_estimate
from feel321.analysis.report.parts import ITEM, fit_rest, split_parts
from feel321.analysis.report.section import Picture, Section, make_slug
from feel321.analysis.words import (
    COUNT,
    TWO_WAY,
    Line,
    count_number,
    make_interval,
    make_number,
    name_path,
    start,
    tell_name,
    tell_number,
    tell_range,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterator

    from pandas import DataFrame

    from feel321.analysis.primary.model import Primary
    from feel321.analysis.primary.multiverse import Multiverse
    from feel321.analysis.refined.refine import Refined
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.table.reading import Table

    Row = dict[Hashable, Any]
    Found = list[tuple[Part, Refined]]

# The primary slopes under other choices: of data, of scale, of raters.

KEY_ROBUSTNESS, TITLE_ROBUSTNESS = "robustness", "Under other choices"
MOST_CELLS = 20_000
"""Participants x stimuli beyond which some sixty models would take many minutes."""

SIZES = ("Combinations of rules", "Sets of raters", "With a model")

HOW_ROBUSTNESS = (
    "The primary slopes are re-estimated under other choices: correlated slopes of participants; no terms for "
    "reducers; ratings standardised within raters; ratings as logits; and, as a multiverse, without the raters flagged "
    "by each screening rule, each pair of rules, and all of them. Combinations that leave the same raters are one set "
    "and count once.",
)


def compute_robustness(table: Table, choices: Choices) -> Section:
    """Repeat the primary analysis under other choices."""
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
    pictures += [
        _draw_universes(metric, *found)
        for (_, metric), found in universes.items()
        if len(found[1].curve)
    ]
    return Section(
        key=KEY_ROBUSTNESS,
        title=TITLE_ROBUSTNESS,
        answers=tuple(map(_judge_robustness, universes.items())),
        grids=tuple(grids),
        tables=_make_tables_robustness(varied, universes),
        pictures=tuple(pictures),
        notes=(*notes, *_note_variants(varied)),
        how=HOW_ROBUSTNESS if grids else (),
    )


def _check_size(part: Part) -> None:
    cells = len(part.rows.groupby(["participant", ITEM], observed=True))
    if cells > MOST_CELLS:
        raise ValueError(
            f"They are left out for {cells} participant x stimulus cells; up to {MOST_CELLS} are varied."
        )


def _run_universes(
    table: Table, part: Part, choices: Choices
) -> dict[tuple[str, str], tuple[Part, Multiverse]]:
    rows = table.rows
    own = rows[(rows["scale"] == part.scale) & (rows["level"] == part.level)]
    estimate = _remember_slopes(table.metrics, people=own["participant"].nunique())
    return {
        (part.lead, metric): (
            part,
            run_multiverse(
                own, estimate(metric), rng=choices.make_rng(KEY_ROBUSTNESS, *part.place)
            ),
        )
        for metric in table.metrics
    }


def _remember_slopes(
    metrics: tuple[str, ...], *, people: int
) -> Callable[[str], Callable[[DataFrame], Estimate]]:
    """Fit each set of raters once, whichever metric is asked for."""
    known: dict[frozenset[Hashable], dict[str, Estimate]] = {}

    def fit(tests: DataFrame) -> dict[str, Estimate]:
        try:
            slopes = fit_rest(
                tests.assign(**{ITEM: tests["stimulus_id"]}), metrics, people=people
            ).slopes
        except ValueError as error:
            return dict.fromkeys(metrics, Estimate(float("nan"), note=str(error)))
        ends = slopes[["tenth", "tenth_low", "tenth_high"]].itertuples(index=False)
        return {str(name): Estimate(*row) for name, row in zip(slopes.index, ends, strict=True)}

    def of_metric(metric: str) -> Callable[[DataFrame], Estimate]:
        def estimate(rows: DataFrame) -> Estimate:
            who = frozenset(rows["participant"])
            if who not in known:
                known[who] = fit(rows[rows["role"] == "test"])
            found = known[who].get(
                metric, Estimate(float("nan"), note=f"{metric} does not differ within recordings")
            )
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
    return Picture(make_slug("variants", *part.place), caption, figure)


def _draw_universes(metric: str, part: Part, result: Multiverse) -> Picture:
    caption = (
        f"Slope of {part.ratings} on {tell_name(metric)}, points per +0.1, for every distinct set of raters that the "
        "screening rules leave, from the smallest up; 95 % Satterthwaite intervals. Below: the rules applied."
    )
    figure = draw_multiverse(result, estimate="Points per +0.1")
    return Picture(make_slug("multiverse", *part.place, metric), caption, figure, detail=True)


def _judge_robustness(found: tuple[tuple[str, str], tuple[Part, Multiverse]]) -> str:
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
    rows = [
        _lay_variant(parts[lead], row)
        for lead, table in varied.items()
        for row in table.to_dict("records")
    ]
    return Grid(caption, head, tuple(rows))


def _lay_variant(part: Part, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path("variant", *part.place, row["variant"], row["metric"]), len(part.rows)
    value = name_estimate(name, row, "standardised slope", n=n, prefix="standardised")
    p = Cell(make_number(f"{name}.p", row["p"], "two-sided t test", n=n), "p")
    return (
        tell_name(part.lead),
        row["variant"],
        tell_name(row["metric"]),
        *lay_estimate(value, "slope"),
        p,
    )


UNIVERSES = (
    "Slope (points per +0.1) across the distinct sets of raters that combinations of screening rules leave: "
    "median, smallest, largest, share with the same sign as with everyone, share of intervals that exclude zero, "
    "number of combinations, of distinct sets, and of sets with enough raters to fit the model."
)


def _lay_universes(universes: dict[tuple[str, str], tuple[Part, Multiverse]]) -> Grid:
    head = (
        "Ratings",
        "Metric",
        "Median",
        "Smallest",
        "Largest",
        "Same sign",
        "Excludes zero",
        *SIZES,
    )
    rows: list[tuple[str | Cell, ...]] = []
    for (_, metric), (part, result) in universes.items():
        name, n = name_path("multiverse", *part.place, metric), result.n_distinct
        kinds = {"median": "slope", "smallest": "slope", "largest": "slope", "same_sign": "correlation",
                 "beyond_zero": "correlation"}  # fmt: skip
        values = [
            Cell(
                make_number(
                    f"{name}.{key}",
                    getattr(result, key),
                    f"{key} over distinct sets of raters",
                    n=n,
                ),
                kind,
            )
            for key, kind in kinds.items()
        ]
        counts = {
            "n_combinations": result.n_combinations,
            "n_distinct": n,
            "n_defined": len(result.curve),
        }
        sizes = [
            Cell(count_number(f"{name}.{key}", count, n=n), COUNT) for key, count in counts.items()
        ]
        rows.append((tell_name(part.lead), tell_name(metric), *values, *sizes))
    return Grid(UNIVERSES, head, tuple(rows))


def _note_variants(varied: dict[str, DataFrame]) -> Iterator[str]:
    for lead, table in varied.items():
        own = table.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said where it is told.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            yield f"{lead}, {'; '.join(names)}: {reason}"


def _make_tables_robustness(
    varied: dict[str, DataFrame], universes: dict[tuple[str, str], tuple[Part, Multiverse]]
) -> dict[str, DataFrame]:
    import pandas as pd

    tables = {}
    if varied:
        tables["variants"] = pd.concat(
            [table.assign(ratings=lead) for lead, table in varied.items()], ignore_index=True
        )
    if universes:
        found = [
            result.table.assign(ratings=lead, metric=metric)
            for (lead, metric), (_, result) in universes.items()
        ]
        whole = pd.concat(found, ignore_index=True)
        tables["multiverse"] = whole.assign(
            excluded=[" ".join(map(str, who)) for who in whole["excluded"]]
        )
    return tables


# Refined metrics: whether a combination of metrics, or another shape of one, is worth having.

KEY_REFINED, TITLE_REFINED = "refined", "Would a refined metric predict better?"
DRAWS = 400
"""Each draw repeats the whole search, and more of them change the interval's width by a few hundredths only."""

AMPLITUDE, LEVEL = "rms_m_s2", "level in dB"
"""The amplitude that a manifest may tell, and the term made of it."""

OUT_OF_FOLD = "of differences within recordings, out of fold"
HOW_REFINED = (
    "Refined metrics: each metric, metrics to the power 0.5 or 2, their sum with equal weights, and weighted sums are "
    "compared by nested cross-validation of differences within recordings: the inner one takes the simplest candidate "
    "within one standard error of the least squared error, the outer one judges that on recordings and participants "
    "that had no part in it (Varma & Simon 2006, doi 10.1186/1471-2105-7-91). Intervals are two-way bootstrap "
    f"intervals that repeat the search, of at most {DRAWS} draws. A refinement is recommended only where its gain over "
    "every single metric is above zero with its whole interval; intervals are not adjusted for their number.",
)


def compute_refined(table: Table, choices: Choices) -> Section:
    """Search a refined metric for every scale and level."""
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
        return Section(KEY_REFINED, TITLE_REFINED, notes=tuple(notes))
    return Section(
        key=KEY_REFINED,
        title=TITLE_REFINED,
        answers=tuple(_judge_refined(part, result) for part, result in found),
        verdict=tuple(_sum_up(found)),
        grids=(_lay_scores(found), _lay_gains(found), _lay_candidates(found), _lay_weights(found)),
        tables=_make_tables_refined(found),
        notes=tuple(notes),
        how=HOW_REFINED,
    )


def _search(part: Part, table: Table, choices: Choices) -> Refined:
    rows, others = part.rows, list(table.further)
    if AMPLITUDE in rows and (rows[AMPLITUDE] > 0).all():
        rows, others = rows.assign(**{LEVEL: 20 * np.log10(rows[AMPLITUDE])}), [LEVEL, *others]
    rng = choices.make_rng(KEY_REFINED, *part.place)
    return refine_metric(
        rows, table.metrics, others=others, draws=min(choices.draws, DRAWS), rng=rng
    )


def _sum_up(found: Found) -> Iterator[Line]:
    """Open the report with what is recommended; of all the rest, in one line, that it is not."""
    for part, result in found:
        if result.recommended:
            yield Line(_judge_refined(part, result))
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


def _judge_refined(part: Part, result: Refined) -> str:
    gain = _find_best(result)
    told = f"{tell_number(gain['value'])} (95 % two-way interval {tell_range(gain['low'], gain['high'])})"
    pair = (
        f"{tell_number(result.value)} with what the search finds, {tell_number(gain['plain'])} with"
    )
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
    return (
        f"the weighted sum of {tell_name(result.chosen)}"
        if " + " in result.chosen
        else tell_name(result.chosen)
    )


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
    name, n = name_path(KEY_REFINED, *part.place), result.n_items
    value = make_number(
        f"{name}.value", result.value, f"correlation with the refined metric {OUT_OF_FOLD}", n=n
    )
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
    rows = [
        _lay_gain(part, result, row)
        for part, result in found
        for row in result.gains.to_dict("records")
    ]
    return Grid(caption, head, tuple(rows))


def _lay_gain(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY_REFINED, *part.place, "over", row["metric"]), result.n_items
    plain = make_number(
        f"{name}.plain", row["plain"], "correlation of differences within recordings", n=n
    )
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
    rows = [
        _lay_candidate(part, result, row)
        for part, result in found
        for row in result.candidates.to_dict("records")
    ]
    return Grid(caption, head, tuple(rows))


def _lay_candidate(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY_REFINED, *part.place, "candidate", row["name"]), result.n_items
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
    rows = [
        _lay_weight(part, result, row)
        for part, result in found
        for row in result.weights.to_dict("records")
    ]
    return Grid(caption, head, tuple(rows))


def _lay_weight(part: Part, result: Refined, row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path(KEY_REFINED, *part.place, "weight", row["term"]), result.n_items
    methods = {
        "weight": "least squares, points per standard deviation", "lowest": "smallest over outer folds",
        "highest": "largest over outer folds", "per_unit": "least squares, points per unit",
    }  # fmt: skip
    cells = [
        Cell(make_number(f"{name}.{key}", row[key], how, n=n), "slope")
        for key, how in methods.items()
    ]
    return (_tell_place(part), tell_name(row["term"]), *cells)


def _tell_place(part: Part) -> str:
    return f"{tell_name(part.scale)}, {tell_name(part.level)}"


def _make_tables_refined(found: Found) -> dict[str, DataFrame]:
    import pandas as pd

    def stack(name: str) -> DataFrame:
        return pd.concat(
            [_place(getattr(result, name), part) for part, result in found], ignore_index=True
        )

    return {f"refined_{name}": stack(name) for name in ("gains", "candidates", "weights")}


def _place(table: DataFrame, part: Part) -> DataFrame:
    placed = table.assign(scale=part.scale, level=part.level)
    return placed[["scale", "level", *table.columns]]
