"""Sections about pairs of stimuli: choices between two, ABX trials, one axis against three, maps of dissimilarities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from feel321.analysis import space as spaces
from feel321.analysis.choices import (
    CHANCE,
    EVERY,
    compare_with_original,
    discriminate,
    gather_votes,
    predict,
)
from feel321.analysis.contrasts.bradley_terry import bradley_terry
from feel321.analysis.primary.model import FEW, adjust_holm
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row, make_row
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Part, Table, split_arms
from feel321.analysis.table.schema import CHOSEN, HIGHEST, PAIRED
from feel321.analysis.words import format_count, format_level, format_name

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices
    from feel321.records import Statistic

# Choices between two stimuli: which metric predicts them, and what they say of the reducers.


def compute_choices(table: Table, choices: Choices) -> Found:
    """Evaluate triplets and preferences, per scale and level."""
    found, stimuli = Found(key="choices"), table.stimuli
    if stimuli is None:
        found.notes.append("Choices are not evaluated: the table has no stimuli, use read_table.")
        return found
    for part in split_arms(table.rows[table.rows["scale"].isin(CHOSEN)]):
        first, rows = len(found.notes), part.rows.reset_index(drop=True)
        rows = rows.assign(**{
            f"{which}_{fact}": rows[name].map(stimuli[fact])
            for which, name in (("first", STIMULUS), ("second", OTHER))
            for fact in ("reducer", ROLE)
        })  # fmt: skip
        anchors = [rows["first_role"] == "anchor", rows["second_role"] == "anchor"]
        is_catch = anchors[0] != anchors[1]
        if n := int(is_catch.sum()):
            wrong = int(anchors[0].where(rows["rating"] == HIGHEST, anchors[1])[is_catch].sum())
            sizes = {"anchors_chosen": wrong, "catch_trials": n, "n": n}
            found.add("choices_sizes", [sizes], **part.keys)
            found.notes.append(f"an anchor was chosen in {wrong} of {n} catch trials.")
        found.attempt("", _predict, found, part, replace(table, rows=rows))
        # Catch trials, which are won nearly always, have no part in abilities.
        votes = rows[~(anchors[0] | anchors[1])]
        rng = choices.make_rng("choices", *part.place)
        found.attempt("", _scale, found, part, votes, draws=choices.draws, rng=rng)
        notes = (note.strip().rstrip(".") for note in found.notes[first:])
        found.notes[first:] = [f"{part.lead}: {note}." for note in notes]
    return found


def _predict(found: Found, part: Part, table: Table) -> None:
    """Count how many choices each metric predicts."""
    one = predict(gather_votes(table, table.metrics))
    keys: Row = {**part.keys, "n": one.n_votes}
    shares = one.to_frame().sort_values("share", ascending=False, kind="stable")
    found.add("choices_predicted", one.to_frame().assign(n_choices=one.n_votes), **keys)
    ceilings = [
        {"metric": "majority_of_others", "share": one.others, "low": one.others_low, "high": one.others_high},
        {"metric": "majority_of_all", "share": one.majority, "low": np.nan, "high": np.nan},
    ]  # fmt: skip
    known = [row | {"p_holm": np.nan} for row in ceilings if np.isfinite(row["share"])]
    found.add("choices_predicted", known, **keys)
    found.add("choices_differences", one.differences, **keys)
    sizes = {name: one[name] for name in ("n_participants", "n_recordings", "n_pairs")}
    found.add("choices_sizes", [sizes | {"n": one.n_votes}], **part.keys)
    told = describe_prediction(part, table, one, shares=shares.to_dict("records"))
    found.tell(claims=True, **told)
    drawn = 100 * shares[["share", "low", "high"]]
    drawn["name"] = shares["metric"].map(format_name)
    places = [100 * row["share"] for row in known]
    band = (min(places), max(places)) if places else (np.nan, np.nan)
    says = {"subject": part.subject, "n": one.n_votes, **sizes}
    slug = parts.make_slug("choices", *part.place)
    found.draw("shares", slug, drawn, says=says, lines={"-": 50.0}, band=band)
    found.notes += one.notes


def describe_prediction(part: Part, table: Table, found: Statistic, *, shares: list[Row]) -> Row:
    """Decide which metrics may be said to predict the choices, and whether any predicts more than another."""
    sizes = {"participant": found.n_participants, "recording": found.n_recordings}
    clear = [row for row in shares if row["p_holm"] < parts.SIGNIFICANCE]
    right = [row for row in clear if row["share"] > CHANCE]
    best = right[0]["metric"] if right else ""
    pairs = [
        (row["first"], row["second"]) if row["difference"] >= 0 else (row["second"], row["first"])
        for row in found.differences.to_dict("records")
        if row["p_holm"] < parts.SIGNIFICANCE
    ]
    return {
        "scale": part.scale, "subject": part.subject, "level": part.level * part.several,
        "compared": len(found.differences), "estimable": not found.shares["p"].isna().all(),
        "n_metrics": len(shares), "units": [format_count(size, name) for name, size in sizes.items()],
        "few": parts.list_few(sizes, FEW), "others": found.others, "highest": shares[0], "right": right,
        "wrong": [row for row in clear if row["share"] < CHANCE],
        "worse": [smaller for larger, smaller in pairs if larger == best],
        "without": list(_find_turns(table, best, list(found.shares.index))) if right else [],
    }  # fmt: skip


def _find_turns(table: Table, metric: str, metrics: Sequence[str]) -> Iterator[str]:
    """Name the reducers without which the leading metric is no longer shown to predict."""
    rows = table.rows
    first, second = rows["first_reducer"], rows["second_reducer"]
    tested = {*first[rows["first_role"] == TEST], *second[rows["second_role"] == TEST]}
    for name in sorted(tested):
        rest = replace(table, rows=rows[(first != name) & (second != name)])
        try:
            left = predict(gather_votes(rest, metrics)).shares.loc[metric]
        except ValueError:
            continue
        if not (left["p_holm"] < parts.SIGNIFICANCE and left["share"] > CHANCE):
            yield name


def _scale(
    found: Found, part: Part, votes: DataFrame, *, draws: int, rng: np.random.Generator
) -> None:
    """Scale the reducers by Bradley-Terry; shrunken and without intervals where one always won or lost."""
    if len(votes["reference_reducer"].unique()) > 1:
        votes = votes[votes["matched"]]  # likeness to one reference is no likeness to another
    if votes.empty:
        return
    first, second = votes["first_reducer"], votes["second_reducer"]
    winner = first.where(votes["rating"] == HIGHEST, second)
    pairs = votes[["participant"]].assign(first=first, second=second, winner=winner)
    try:
        alone = len(pairs["participant"].unique()) == 1
        fit = bradley_terry(pairs, by_rater=not alone, order_effect=True, draws=draws, rng=rng)
    except ValueError as error:
        if "separation" not in str(error):
            raise
        shrunken = bradley_terry(pairs, prior=0.5, order_effect=True)
        fit = shrunken.replace(fixed=shrunken.fixed.assign(low=np.nan, high=np.nan))
    for row in fit.to_frame().to_dict("records"):
        met = (first == row["item"]) | (second == row["item"])
        if row["item"] != "order":
            share = float((winner[met] == row["item"]).mean())
            record = row | {"share": share, "n": int(met.sum())}
            found.add("choices_abilities", [record], **part.keys)
    found.notes += fit.notes


# ABX trials: how well what a reducer made is distinguished from its reference.


def compute_discrimination(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer, against whatever its reference was."""
    found, frame = Found(key="discrimination"), discriminate(table)
    if frame.empty:
        return found
    for one in frame.to_dict("records"):
        found.notes += [f"ABX, {one['reducer']}, {one['level']}: {note}" for note in one["notes"]]
    frame["p_holm"] = adjust_holm(frame["p"].tolist())
    found.add("discrimination", frame)
    apart, n = int((frame["p_holm"] < parts.SIGNIFICANCE).sum()), len(frame)
    found.facts = {"apart": apart, "n": n}
    for name, count in {"n_distinguished": apart, "n_compared": n}.items():
        found.rows["discrimination"].append(make_row(name, count, n=n))
    found.claim(**found.facts)
    levels = frame["level"].map(format_level) if len(frame["level"].unique()) > 1 else ""
    tried = frame["n_correct"].astype(str) + "/" + frame["n_trials"].astype(str)
    frame["name"] = frame["reducer"] + levels + " (" + tried + ")"
    found.draw("sensitivity", "discrimination", frame, says={})
    return found


# One axis against three: dissimilarities from the original beside those of identical pairs.


def compute_told_apart(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare dissimilarities from the original with those of identical pairs."""
    found = Found(key="told_apart")
    rows = table.rows[table.rows["scale"] == PAIRED]
    several = len(rows["level"].unique()) > 1
    for level, part in rows.groupby("level", observed=True):
        lead = f"{PAIRED}, {level}: one axis is not compared with three."
        own = found.attempt(lead, compare_with_original, part)
        if own is None:
            continue
        found.add("told_apart", own, level=level)
        single = own[own["reducer"] != EVERY]
        clear = (single["p_holm"] < parts.SIGNIFICANCE) & (single["difference"] > 0)
        apart, rest = (list(single.loc[which, "reducer"]) for which in (clear, ~clear))
        told = {"level": str(level) * several, "apart": apart, "n": len(single), "rest": rest}
        found.tell(claims=True, **told)
    return found


# Dissimilarities: the perceptual map, and what its axes are associated with.

DRAWS = 200  # Maps drawn anew; each takes a fit


def compute_space(table: Table, choices: Choices) -> Found:
    """Map the dissimilarities of every level."""
    found = Found(key="space")
    dissimilar = table.rows[table.rows["scale"] == PAIRED]

    def fit(rows: DataFrame, level: str) -> tuple[Any, Statistic, Sequence[float]]:
        rng, draws = choices.make_rng("space", level), min(DRAWS, max(choices.draws, 3))
        names, matrices = spaces.gather_dissimilarities(rows)
        space = spaces.fit_space(matrices, draws=draws, rng=rng)
        rng = choices.make_rng("space", level, "stress")
        return names, space, spaces.stress_by_dimension(matrices, rng=rng)

    for level in sorted(dissimilar["level"].unique()):
        rows, lead = dissimilar[dissimilar["level"] == level], f"{PAIRED}, {level}"
        mapped = found.attempt(f"{lead}: no map.", fit, rows, level)
        if mapped is None:
            continue
        names, space, stress = mapped
        found.draw("map", parts.make_slug("space", level), space, names, says={"level": level})
        keys: Row = {"level": level, "n": len(names)}
        places = pd.DataFrame(space.positions, columns=["x", "y"])
        places[["half_axis_1", "half_axis_2"]] = space.ellipses.half_axes
        found.add("space", places.assign(reducer=names, angle=space.ellipses.angle), **keys)
        sizes = ({"dimensions": n, "stress": value} for n, value in enumerate(stress, start=1))
        found.add("space_stress", sizes, **keys)
        why = f"{lead}: the map is compared with nothing else."
        one = found.attempt(why, _relate, table, space, names, level=level, choices=choices)
        if one is not None:
            found.add("space_metrics", [one], note=f"{one.permutations} pairings", **keys)
            shown = one.p < parts.SIGNIFICANCE
            found.tell(claims=True, level=level, r=one.correlation, p=one.p, shown=shown)
        why = f"{lead}: axes are not compared with attributes."
        found.attempt(why, _regress, found, table, rows, level=level, choices=choices)
    return found


def _relate(
    table: Table, space: Statistic, names: Sequence[str], *, level: str, choices: Choices
) -> Statistic:
    """Compare the map with the metrics of its stimuli."""
    rated = table.rows[table.rows["level"] == level].drop_duplicates("stimulus_id")
    means = rated.groupby("reducer", observed=True)[list(table.metrics)].mean()
    attributes = means.reindex(list(names))
    known = attributes.notna().all(axis=1).to_numpy()
    metrics = attributes[known]
    metrics = metrics.loc[:, metrics.std() > 0]
    scaled = ((metrics - metrics.mean()) / metrics.std()).to_numpy()
    rng = choices.make_rng("space", level, "procrustes")
    return spaces.align_spaces(space.positions[known], scaled, permutations=choices.draws, rng=rng)


def _regress(found: Found, table: Table, rows: DataFrame, *, level: str, choices: Choices) -> None:
    """Regress the attributes of stimuli on the axes of the recordings' maps; also note on how little that rests.

    p are adjusted over the metrics that were planned, and over the others; of those that could be small at all.
    """
    rng, draws = choices.make_rng("space", level, "attributes"), min(choices.draws, 1000)
    places, known = spaces.gather_points(rows, table.stimuli, rng=rng)
    regressed: list[Row] = spaces.regress_points(places, known, draws=draws, rng=rng)
    for is_planned in (True, False):
        group = [row for row in regressed if (row["property"] in table.metrics) == is_planned]
        p = [row["p"] if row["p_least"] < parts.SIGNIFICANCE else np.nan for row in group]
        for row, holm in zip(group, adjust_holm(p), strict=True):
            row["p_holm"] = holm
    recordings, n = places.shape[:2]
    if mute := [row["property"] for row in regressed if row["p_least"] >= parts.SIGNIFICANCE]:
        told = f"{PAIRED}, {level}: permutations of {n} stimuli cannot show an association of the axes with"
        found.notes.append(f"{told} {', '.join(mute)}.")
    if recordings * n < spaces.ENOUGH * len(regressed):
        found.notes.append(
            f"{PAIRED}, {level}: {len(regressed)} attributes are compared with {recordings * n} points ({n} stimuli in "
            f"{recordings} recordings); {spaces.ENOUGH} for each are recommended: R² is descriptive only."
        )
    found.add("space_attributes", regressed, level=level)
