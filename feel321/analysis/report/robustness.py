"""Section: the primary slopes under other choices."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping
from functools import cache, partial
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.figures.choices import draw_multiverse
from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.multiverse import Multiverse, UniverseEstimate, run_universes
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.primary.sensitivity import MOVED, RIGS, vary_primary
from feel321.analysis.report.parts import (
    ITEM,
    RatingsPart,
    add_step,
    find_table_steps,
    fit_rest,
    is_large,
    join_steps,
    split_parts,
)
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    RATINGS,
    Column,
    P,
    Picture,
    Section,
    TableForm,
    estimate,
    make_slug,
    read_methods,
    stack,
    word_steps,
)
from feel321.analysis.screening.screen import screen_raters
from feel321.analysis.table.items import recast_pairs
from feel321.analysis.words import COUNT, Line

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.metrics import Step
    from feel321.analysis.table.reading import Table

Row = dict[Any, Any]
Universes = dict[tuple[str, str], tuple[RatingsPart, Multiverse]]

# The primary slopes under other choices: of data, of scale, of raters.

KEY_ROBUSTNESS = "robustness"
MOST_CELLS = 20_000
"""Participants x stimuli beyond which some sixty models would take many minutes."""

FLAT = "the metric does not differ within recordings"
VARIANTS = TableForm(
    "Standardised slope under other choices, with 95 % t intervals (Satterthwaite's df); p not adjusted. Only "
    "standardised slopes can be compared across units. A dash: no model; the notes say why.",
    (
        RATINGS, Column("Choice", "variant", NAME), METRIC,
        estimate("Standardised slope", "standardised", "standardised slope", ends="standardised_"), P,
    ),
    path="variant.{scale}.{level}.{variant}.{metric}",
)  # fmt: skip
OVER_SETS = {
    "median": ("Median", "slope"), "smallest": ("Smallest", "slope"), "largest": ("Largest", "slope"),
    "same_sign": ("Same sign", "correlation"), "beyond_zero": ("Excludes zero", "correlation"),
}  # fmt: skip
UNIVERSES = TableForm(
    "Slope (points per +0.1) across the distinct sets of raters that combinations of screening rules leave: "
    "median, smallest, largest, share with the same sign as with everyone, share of intervals that exclude zero, "
    "number of combinations, of distinct sets, and of sets with enough raters to fit the model.",
    (
        RATINGS, METRIC,
        *(
            Column(head, key, kind, key, f"{key} over distinct sets of raters")
            for key, (head, kind) in OVER_SETS.items()
        ),
        Column("Combinations of rules", "n_combinations", COUNT, "n_combinations"),
        Column("Sets of raters", "n_distinct", COUNT, "n_distinct"),
        Column("With a model", "n_defined", COUNT, "n_defined"),
    ),
    path="multiverse.{scale}.{level}.{metric}", n="n_distinct",
)  # fmt: skip


def compute_robustness(table: Table, choices: Choices) -> Section:
    """Repeat the primary analysis under other choices."""
    notes: list[str] = []
    varied: dict[str, DataFrame] = {}
    universes: Universes = {}
    pictures: list[Picture] = []
    parts, steps = {part.lead: part for part in split_parts(table)}, find_table_steps(table)
    for part in parts.values():
        try:
            _check_size(part, len(table.metrics))
            varied[part.lead] = vary_primary(part.rows, table.metrics, leave_out=False)
            pictures.append(_picture_variants(part, steps, varied[part.lead]))
            universes |= _run_universes(table, part, choices)
        except ValueError as error:
            notes.append(f"{part.lead}: no variants. {error}")
    pictures += _draw_universes(universes, steps)
    return Section(
        key=KEY_ROBUSTNESS,
        title="Robustness to other choices",
        verdict=list(_name_rigs(parts, varied)),
        answers=list(_describe_all(universes, steps)),
        grids=(
            VARIANTS.build(_list_variants(parts, varied)),
            word_steps(UNIVERSES, steps).build(
                _read_universe(metric, *found) | {"_per": steps[metric].per}
                for (_, metric), found in universes.items()
            ),
        ),
        tables={
            "variants": stack(({"ratings": lead}, frame) for lead, frame in varied.items()),
            "multiverse": stack(
                ({"ratings": lead, "metric": metric}, _join_excluded(result.table))
                for (lead, metric), (_, result) in universes.items()
            ),
        },
        pictures=pictures,
        notes=(*notes, *_note_variants(varied)),
        how=read_methods(KEY_ROBUSTNESS),
    )


def _describe_all(universes: Universes, steps: Mapping[str, Step]) -> Iterator[str]:
    for (_, metric), found in universes.items():
        yield _describe_universes(metric, *found, per=steps[metric].per)


def _draw_universes(universes: Universes, steps: Mapping[str, Step]) -> Iterator[Picture]:
    for (_, metric), found in universes.items():
        if len(found[1].curve):
            yield _picture_universes(metric, *found, per=steps[metric].per)


def _list_variants(
    parts: Mapping[str, RatingsPart], varied: Mapping[str, DataFrame]
) -> Iterator[Row]:
    for lead, frame in varied.items():
        more = {**parts[lead].keys, "n": len(parts[lead].rows)}
        yield from (more | row for row in frame.to_dict("records"))


def _check_size(part: RatingsPart, n_slopes: int) -> None:
    cells = len(part.rows.groupby(["participant", ITEM], observed=True))
    if cells > MOST_CELLS:
        why = f"They are left out for {cells} participant x stimulus cells"
        raise ValueError(f"{why}; up to {MOST_CELLS} are varied.")
    if is_large(part.rows, n_slopes):
        raise ValueError("They are left out, for these ratings are too many for one fit.")


def _join_excluded(table: DataFrame) -> DataFrame:
    return table.assign(excluded=[" ".join(map(str, who)) for who in table["excluded"]])


def _read_universe(metric: str, part: RatingsPart, result: Multiverse) -> Row:
    keys = (*OVER_SETS, "n_combinations", "n_distinct")
    found = {key: getattr(result, key) for key in keys}
    return {**part.keys, "metric": metric, **found, "n_defined": len(result.curve)}


def _run_universes(table: Table, part: RatingsPart, choices: Choices) -> Universes:
    rows = recast_pairs(table.rows)
    own = rows[(rows["scale"] == part.scale) & (rows["level"] == part.level)]
    estimate_slope = _remember_slopes(own, find_table_steps(table))
    screening = screen_raters(
        own, own=choices.rules, rng=choices.make_rng(KEY_ROBUSTNESS, *part.place)
    )
    return {
        (part.lead, metric): (
            part,
            run_universes(own, partial(estimate_slope, metric=metric), screening),
        )
        for metric in table.metrics
    }


def _remember_slopes(rows: DataFrame, steps: Mapping[str, Step]) -> Callable[..., UniverseEstimate]:
    """Fit each set of raters once, whichever metric is asked for; slopes are per step."""
    known: dict[frozenset[Hashable], dict[str, UniverseEstimate]] = {}
    tests, people = rows[rows["role"] == "test"], frozenset(rows["participant"])
    make = cache(lambda: make_cells(tests.assign(**{ITEM: tests["stimulus_id"]}), tuple(steps)))

    def fit(who: frozenset[Hashable]) -> dict[str, UniverseEstimate]:
        try:
            slopes = fit_rest(make(), people - who, people=len(people))
        except ValueError as error:
            return dict.fromkeys(steps, UniverseEstimate(float("nan"), note=str(error)))
        found = {}
        for row in slopes.reset_index().to_dict("records"):
            own = add_step(row, steps[row["metric"]])
            found[row["metric"]] = UniverseEstimate(
                *(own[f"_step{end}"] for end in ("", "_low", "_high"))
            )
        return found

    def estimate_slope(rows: DataFrame, *, metric: str) -> UniverseEstimate:
        who = frozenset(rows["participant"])
        if who not in known:
            known[who] = fit(who)
        none = UniverseEstimate(float("nan"), note=FLAT)
        found = known[who].get(metric, none)
        if found.note:
            raise ValueError(found.note)
        return found

    return estimate_slope


def _picture_variants(part: RatingsPart, steps: Mapping[str, Step], table: DataFrame) -> Picture:
    caption = (
        f"Slopes of {part.ratings} within recordings: above in points per {join_steps(steps)} of the metric, below "
        "standardised, under other choices; 95 % Satterthwaite intervals."
    )
    models = {part.lead: fit_primary(part.rows, tuple(steps), explain=False)}
    draw = partial(draw_slopes, models, variants=table, steps=steps)
    return Picture(make_slug("variants", *part.place), caption, draw)


def _picture_universes(metric: str, part: RatingsPart, result: Multiverse, *, per: str) -> Picture:
    caption = (
        f"Slope of {part.ratings} on {words.format_name(metric)}, points per {per}, for every distinct set of raters "
        "that the screening rules leave, from the smallest up; 95 % Satterthwaite intervals. Below: the rules applied."
    )
    counts = (result.n_combinations, len(result.table) - len(result.curve))
    rules = tuple(result.screening.rules)
    draw = partial(draw_multiverse, result.curve, rules=rules, counts=counts, per=per)
    return Picture(make_slug("multiverse", *part.place, metric), caption, draw, detail=True)


def _describe_universes(
    metric: str, part: RatingsPart, result: Multiverse, *, per: str = "+0.1"
) -> str:
    what = f"Slope of {part.ratings} on {words.format_name(metric)}"
    if not len(result.curve):
        large = "no set of raters is large enough to fit the model"
        return f"{what}: {FLAT if set(result.table['note']) == {FLAT} else large}."
    if result.n_distinct == 1:
        alone = f"the {result.n_combinations} combinations of screening rules leave 1 distinct set of raters, everyone"
        return (
            f"{what}: {words.format_number(result.median, kind='slope')} points per {per}; {alone}."
        )
    reach = words.format_interval(result.smallest, result.largest, kind="slope")
    sets = f"{result.n_distinct} distinct sets of raters"
    some = f"{len(result.curve)} of " if len(result.curve) < result.n_distinct else ""
    few = "; the others leave too few raters to fit the model" if some else ""
    rules = f"{result.n_combinations} combinations of screening rules"
    return f"{what}: {reach} points per {per} across {some}{sets} from {rules}{few}."


def _name_rigs(parts: Mapping[str, RatingsPart], varied: Mapping[str, DataFrame]) -> Iterator[Line]:
    """Say where a slope hinges on the rig: it moves by more than its standard error with another choice."""
    for lead, table in varied.items():
        moved = [
            f"{words.format_name(name)} by {words.format_number(abs(shift), kind='slope')} ({variant})"
            for name in table["metric"].unique()
            for shift, variant in [_find_rig_shift(table[table["metric"] == name])]
            if abs(shift) > MOVED
        ]
        if moved:
            subject = words.capitalise(parts[lead].subject)
            text = f"slopes depend on the rig. In standard errors they change: {'; '.join(moved)}."
            yield Line(text, subject=subject, lead="rigs")


def _find_rig_shift(table: DataFrame) -> tuple[float, str]:
    """Find by how many standard errors a slope moves with the choice about rigs that moves it most, and which."""
    own = table.set_index("variant")
    whole = own.loc["primary"]
    shifts = ((own["estimate"] - whole["estimate"]) / whole["se"]).filter(
        regex=rf"\b({'|'.join(RIGS)})\b"
    )
    shifts = shifts[shifts.notna()]
    if shifts.empty:
        return 0.0, ""
    most = str(shifts.abs().idxmax())
    return float(shifts[most]), most


def _note_variants(varied: Mapping[str, DataFrame]) -> Iterator[str]:
    for lead, table in varied.items():
        own = table.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said in its own section.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            yield f"{lead}, {'; '.join(names)}: {reason}"
