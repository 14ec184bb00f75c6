"""Sections about pairs of stimuli: ABX trials, one axis against three, and maps of dissimilarities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis import maps
from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original, discriminate_pairs
from feel321.analysis.figures.kinds import draw_discrimination, draw_space
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.report.parts import SIGNIFICANCE
from feel321.analysis.report.section import (
    Found,
    Picture,
    Row,
    Section,
    count_rows,
    make_row,
    make_slug,
)
from feel321.analysis.space import (
    align_spaces,
    bootstrap_space,
    regress_attributes,
    stress_by_dimension,
)
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import ANSWERED, APART, LABELS, PAIRED
from feel321.analysis.words import format_name

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic


# ABX trials: how well what a reducer made is distinguished from its reference.

RIGHT, WRONG = 100.0, 0.0
WILSON = "95 % interval that follows from Wilson's"


def compute_discrimination(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer, against whatever its reference was."""
    rows = table.rows[table.rows["scale"] == ANSWERED]
    if strange := int((~rows["rating"].isin([RIGHT, WRONG])).sum()):
        why = f"{strange} answers are neither 100 (right) nor 0 (wrong)"
        return Found(notes=(f"Scale '{ANSWERED}' is not evaluated: {why}.",))
    trials = rows.assign(first=rows["reducer"], second="reference", correct=rows["rating"] == RIGHT)
    compared = trials[trials["role"] != "reference"].groupby(["level", "reducer"], observed=True)
    found: dict[Any, Statistic] = {
        names: discriminate_pairs(part)[None] for names, part in compared
    }
    if not found:
        return Found()
    adjusted = adjust_holm([one.p for one in found.values()])
    listed: list[Row] = []
    for ((level, reducer), one), p in zip(found.items(), adjusted, strict=True):
        keys: Row = {"level": level, "reducer": reducer, "n": one.n_trials, "interval": WILSON}
        listed.append(
            make_row(
                "share_correct", one.share, low=one.wilson_low, high=one.wilson_high, p=p, **keys
            )
        )
        ends = {"low": one.d_independent_low, "high": one.d_independent_high}
        listed.append(make_row("d_prime", one.d_independent, **ends, **keys))
        listed += count_rows({"n_correct": one.n_correct, "n_trials": one.n_trials}, **keys)
    apart = sum(p < SIGNIFICANCE for p in adjusted)
    listed += count_rows({"n_distinguished": apart, "n_compared": len(found)}, n=len(found))
    named = {
        f"{reducer} ({format_name(str(level))})": one for (level, reducer), one in found.items()
    }
    caption = (
        "d' in ABX trials of each reducer against its reference, with 95 % intervals that follow from Wilson's; 0 is "
        "guessing. In brackets: correct answers of trials."
    )
    notes = [
        f"ABX, {reducer}, {level}: {note}"
        for (level, reducer), one in found.items()
        for note in one.notes
    ]
    return Found(
        {"discrimination": listed}, {"apart": apart, "n": len(found)},
        (Picture("discrimination", caption, partial(draw_discrimination, named)),), notes,
        clauses=(f"{apart} of {len(found)} reducers and anchors were distinguished from their reference",),
    )  # fmt: skip


DISCRIMINATION = Section(
    "discrimination", "Telling stimuli apart (ABX)", "apart", compute_discrimination
)

# One axis against three: dissimilarities from the original beside those of identical pairs.

STUDENT_T = "95 % t interval over participants"


def compute_told_apart(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare dissimilarities from the original with those of identical pairs."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    listed: list[Row] = []
    told: list[Row] = []
    several = len(rows["level"].unique()) > 1
    for level, part in rows.groupby("level", observed=True):
        try:
            own = compare_with_original(part).to_dict("records")
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: one axis is not compared with three. {error}")
            continue
        for row in own:
            keys: Row = {
                "level": level,
                "reducer": row["reducer"],
                "n": row["n_judgements"],
                "interval": STUDENT_T,
            }
            for quantity, lead in (("difference", ""), ("area", "area_"), ("d_prime", "d_prime_")):
                ends = {end: row[f"{lead}{end}"] for end in ("low", "high")}
                p = row["p_holm"] if quantity == "difference" else np.nan
                listed.append(make_row(quantity, row[quantity], **ends, p=p, **keys))
            names = ("t", "df", "n_participants", "n_judgements", "n_identical")
            listed += count_rows({name: row[name] for name in names}, **keys)
        single = [row for row in own if row["reducer"] != EVERY]
        apart = [
            str(row["reducer"])
            for row in single
            if row["p_holm"] < SIGNIFICANCE and row["difference"] > 0
        ]
        rest = [str(row["reducer"]) for row in single if row["reducer"] not in apart]
        told.append({"level": str(level) * several, "apart": apart, "n": len(single), "rest": rest})
    where = [f" (level {format_name(one['level'])})" if one["level"] else "" for one in told]
    clauses = [
        f"one axis was distinguished from three{place} for {len(one['apart'])} of {one['n']} reducers"
        for place, one in zip(where, told, strict=True)
    ]
    facts = {"parts": told} if told else {}
    return Found({"told_apart": listed}, facts, notes=notes, clauses=clauses)


TOLD_APART = Section("told_apart", "One axis against three", "apart", compute_told_apart)

# Dissimilarities: the perceptual map, and what its axes are associated with.

DRAWS = 200
"""Maps drawn anew; each takes a fit."""


class _Arm(NamedTuple):
    """Dissimilarities of one level arm, and metrics and mean ratings of its reducers."""

    level: str
    names: tuple[str, ...]
    matrices: NDArray[np.float64]
    attributes: DataFrame


def compute_space(table: Table, choices: Choices) -> Found:
    """Map the dissimilarities of every level."""
    dissimilar = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    pictures: list[Picture] = []
    told: list[Row] = []
    rows: dict[str, list[Row]] = {
        f"space{part}": [] for part in ("", "_stress", "_metrics", "_properties")
    }
    for level in sorted(dissimilar["level"].unique()):
        try:
            arm = _gather(table, dissimilar[dissimilar["level"] == level], level)
            rng, draws = choices.make_rng("space", level), min(DRAWS, max(choices.draws, 3))
            ellipses = bootstrap_space(arm.matrices, draws=draws, rng=rng)
            stress = stress_by_dimension(
                arm.matrices, rng=choices.make_rng("space", level, "stress")
            )
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no map. {error}")
            continue
        caption = (
            f"Map of the dissimilarities at level {format_name(level)}, with 95 % bootstrap ellipses over "
            "participants; only distances have a meaning."
        )
        pictures.append(
            Picture(make_slug("space", level), caption, partial(draw_space, ellipses, arm.names))
        )
        n = len(arm.names)
        for reducer, place in zip(arm.names, list_places(ellipses), strict=True):
            rows["space"] += count_rows(place, level=level, reducer=reducer, n=n)
        rows["space_stress"] += [
            make_row("stress", value, level=level, dimensions=number, n=n)
            for number, value in enumerate(stress, start=1)
        ]
        try:
            told.append(_relate(arm, ellipses, choices, rows=rows))
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: the map is compared with nothing else. {error}")
    clauses = [
        f"{'the metrics align' if one['shown'] else 'it is unclear whether the metrics align'} with the perceptual map "
        f"(level {format_name(one['level'])})"
        for one in told
    ]
    return Found(
        rows, {"parts": told} if any(rows.values()) else {}, pictures, notes, clauses=clauses
    )


def list_places(ellipses: Statistic) -> Iterator[dict[str, float]]:
    """List the places on a map with their ellipses."""
    for (x, y), (one, two), angle in zip(
        ellipses.space.positions, ellipses.half_axes, ellipses.angle, strict=True
    ):
        yield {"x": x, "y": y, "half_axis_1": one, "half_axis_2": two, "angle": angle}


def _gather(table: Table, rows: DataFrame, level: str) -> _Arm:
    """Average each participant's ratings of every pair of reducers over recordings and both orders."""
    known = rows[rows["reference_reducer"] != ""].rename(columns={"reference_reducer": "other"})
    apart = known[known["reducer"] != known["other"]]
    if apart.empty:
        raise ValueError(
            "No judgement names two stimuli of different reducers, in stimulus_id and reference_id."
        )
    names = order_reducers([*apart["reducer"], *apart["other"]])
    place = {name: number for number, name in enumerate(names)}
    people = {name: number for number, name in enumerate(sorted(apart["participant"].unique()))}
    sums, counts = (np.zeros((len(people), len(names), len(names))) for _ in range(2))
    for one, two in (("reducer", "other"), ("other", "reducer")):
        axes = (("participant", people), (one, place), (two, place))
        index = tuple(apart[key].map(of).to_numpy() for key, of in axes)
        np.add.at(sums, index, apart["rating"].to_numpy())
        np.add.at(counts, index, 1)
    matrices = np.divide(sums, counts, out=np.full_like(sums, np.nan), where=counts > 0)
    matrices[:, np.arange(len(names)), np.arange(len(names))] = 0
    return _Arm(level, tuple(names), matrices, _measure(table, names, level))


def _measure(table: Table, names: list[str], level: str) -> DataFrame:
    """Average metrics and ratings per reducer; NaN where there are none."""
    import pandas as pd

    rows = table.rows[table.rows["level"] == level]
    stimuli = rows.drop_duplicates("stimulus_id").groupby("reducer", observed=True)
    single, ratings = rows[~rows["scale"].isin(APART)], pd.DataFrame()
    if len(single):
        ratings = single.pivot_table("rating", "reducer", "scale", observed=True)
    metrics = stimuli[list(table.metrics)].mean()
    return metrics.join(ratings.add_prefix("rated ")).reindex(names)


def _relate(arm: _Arm, ellipses: Statistic, choices: Choices, *, rows: dict[str, list[Row]]) -> Row:
    """Compare the map with metrics and mean ratings."""
    known = arm.attributes.notna().all(axis=1).to_numpy()
    attributes = arm.attributes[known]
    attributes = attributes.loc[:, attributes.std() > 0]
    metrics = attributes[[name for name in attributes if not str(name).startswith("rated ")]]
    positions, keys = ellipses.space.positions[known], {"level": arm.level, "n": len(arm.names)}
    scaled = ((metrics - metrics.mean()) / metrics.std()).to_numpy()
    rng = choices.make_rng("space", arm.level, "procrustes")
    aligned = align_spaces(positions, scaled, permutations=choices.draws, rng=rng)
    found = regress_attributes(positions, {str(name): attributes[name] for name in attributes})
    note = f"{aligned.permutations} pairings"
    rows["space_metrics"].append(
        make_row("procrustes", aligned.correlation, p=aligned.p, note=note, **keys)
    )
    for (name, row), p in zip(found.iterrows(), adjust_holm(found["p"].tolist()), strict=True):
        rows["space_properties"].append(make_row("r2", row["r2"], p=p, property=str(name), **keys))
    return {
        "level": arm.level,
        "r": aligned.correlation,
        "p": aligned.p,
        "shown": aligned.p < SIGNIFICANCE,
    }


SPACE = Section("space", "The space of what was felt", "apart", compute_space)

# Maps of groups of recordings: interactions and surfaces.

MAP_DRAWS = 100
"""Maps drawn anew for each group; each takes a fit."""


def compute_maps(table: Table, choices: Choices) -> Found:
    """Map dissimilarities per interaction and surface, beside the map of all recordings."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    told: list[Row] = []
    pictures: list[Picture] = []
    parts = ("_groups", "_agreement", "_attributes", "_axes", "_people", "")
    found: dict[str, list[Row]] = {f"maps{part}": [] for part in parts}
    for level in sorted(map(str, rows["level"].unique())):
        own = rows[rows["level"] == level]
        rng = choices.make_rng("maps", level)
        try:
            groups = maps.map_groups(own, draws=min(MAP_DRAWS, max(choices.draws, 3)), rng=rng)
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no maps of groups. {error}")
            continue
        agreement = list(maps.compare_groups(groups, permuted=choices.draws, rng=rng))
        attributes: list[Row] = []
        if not any(name in own and len(own[name].unique()) > 1 for name in LABELS):
            notes.append(
                f"{PAIRED}, {level}: maps are of all recordings together; name `interaction` and `sample` in "
                "[[recordings]], or in columns of the manifest, for maps of each."
            )
        for group in groups:
            _list_group(group, level, found)
            pictures += _draw(group, level)
        found["maps_agreement"] += [_list_agreement(row, level) for row in agreement]
        try:
            points = maps.gather_points(own, table.stimuli, groups[0], rng=rng)
            attributes = list(maps.regress_points(points, draws=min(choices.draws, 1000), rng=rng))
            _adjust(attributes, table.metrics)
            axes = list(maps.regress_axes(points, [*table.metrics, maps.DIRECTIONS]))
            _list_attributes(attributes, axes, level=level, found=found)
            notes += [f"{PAIRED}, {level}: {note}" for note in _note_points(points, attributes)]
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: axes are not compared with attributes. {error}")
        told.append({"level": level, "agreement": list(_find_least(agreement)), "attributes": attributes,
                     "clear": [row for row in attributes if row["p_holm"] < SIGNIFICANCE]})  # fmt: skip
    return Found(found, {"parts": told} if told else {}, pictures, notes)


def _list_agreement(row: Row, level: str) -> Row:
    keys: Row = {key: row[key] for key in ("kind", "p", "n")}
    keys |= {"level": level, "group": row["first"], "second_group": row["second"]}
    return make_row(
        "procrustes", row["correlation"], note=f"{row['permutations']} pairings", **keys
    )


def _list_group(group: maps.GroupMap, level: str, found: dict[str, list[Row]]) -> None:
    keys: Row = {"level": level, "kind": group.kind, "group": group.name, "n": len(group.matrices)}
    people = {row["participant"]: row["correlation"] for row in maps.map_people(group)}
    values = list(people.values())
    found["maps_groups"] += count_rows(
        {
            "stress": group.space.stress, "agreement_median": median(values) if values else np.nan,
            "agreement_least": min(values, default=np.nan), "n_participants": len(group.matrices),
            "n_recordings": group.n_recordings,
        }, **keys,
    )  # fmt: skip
    found["maps_people"] += [
        make_row("procrustes", r, participant=who, **keys) for who, r in people.items()
    ]
    places = [{"x": x, "y": y} for x, y in group.space.positions]
    if group.ellipses:
        ellipses = zip(group.ellipses.half_axes, group.ellipses.angle, strict=True)
        more = [
            {"half_axis_1": one, "half_axis_2": two, "angle": angle}
            for (one, two), angle in ellipses
        ]
        places = [place | own for place, own in zip(places, more, strict=True)]
    for reducer, place in zip(group.names, places, strict=True):
        found["maps"] += count_rows(place, reducer=reducer, **keys)


def _list_attributes(
    attributes: Sequence[Row], axes: Sequence[Row], *, level: str, found: dict[str, list[Row]]
) -> None:
    for row in attributes:
        keys: Row = {"level": level, "property": row["property"], "n": row["n"]}
        note = f"{row['permutations']} orders"
        found["maps_attributes"].append(
            make_row("r2", row["r2"], p=row["p_holm"], note=note, **keys)
        )
        names = {"axis_1": "axis_1", "axis_2": "axis_2", "p_unadjusted": "p", "p_least": "p_least"}
        found["maps_attributes"] += count_rows(
            {name: row[key] for name, key in names.items()}, **keys
        )
    for row in axes:
        keys = {"level": level, "axis": row["axis"], "property": row["property"], "n": row["n"]}
        found["maps_axes"] += count_rows({name: row[name] for name in ("weight", "r2")}, **keys)


def _adjust(rows: Sequence[Row], planned: Sequence[str]) -> None:
    """Adjust p by Holm over the metrics that were planned, and over the others; of those that could be small at all."""
    for is_planned in (True, False):
        own = [row for row in rows if (row["property"] in planned) == is_planned]
        tested = [row for row in own if row["p_least"] < SIGNIFICANCE]
        for row in own:
            row["p_holm"] = float("nan")
        for row, p in zip(tested, adjust_holm([row["p"] for row in tested]), strict=True):
            row["p_holm"] = p


def _draw(group: maps.GroupMap, level: str) -> Iterator[Picture]:
    if group.ellipses:
        caption = (
            f"Map of the dissimilarities of {group.kind} {group.name} at level {format_name(level)}, turned onto the "
            "map of all recordings, with 95 % bootstrap ellipses over participants."
        )
        slug = make_slug("maps", level, group.kind, group.name)
        yield Picture(slug, caption, partial(draw_space, group.ellipses, group.names), detail=True)


def _find_least(rows: Sequence[Row]) -> Iterator[Row]:
    """Find which maps of interactions, and which of samples, agree least."""
    for kind in LABELS:
        own = [row for row in rows if row["kind"] == kind and row["second"] != maps.ALL]
        if own:
            yield min(own, key=lambda row: row["correlation"]) | {"n_pairs": len(own)}


def _note_points(points: maps.Points, rows: Sequence[Row]) -> Iterator[str]:
    """Say on how little a regression of axes on attributes rests."""
    n = len(points.stimuli)
    if mute := [row["property"] for row in rows if row["p_least"] >= SIGNIFICANCE]:
        yield f"permutations of {n} stimuli cannot show an association of the axes with {', '.join(mute)}."
    if points.size < maps.ENOUGH * len(rows):
        yield (
            f"{len(rows)} attributes are compared with {points.size} points ({n} stimuli in {len(points.places)} "
            f"recordings); {maps.ENOUGH} for each are recommended: R² is descriptive only."
        )


MAPS = Section(
    "maps", "The space of what was felt, by interaction and surface", "apart", compute_maps
)
