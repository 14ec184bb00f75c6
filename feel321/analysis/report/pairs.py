"""Sections about pairs of stimuli: choices between two, ABX trials, one axis against three, maps of dissimilarities."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import space as spaces
from feel321.analysis.choices import CHANCE, gather_votes, predict
from feel321.analysis.contrasts.bradley_terry import bradley_terry
from feel321.analysis.contrasts.told_apart import EVERY, compare_with_original, discriminate_pairs
from feel321.analysis.figures import kinds
from feel321.analysis.primary.model import FEW, adjust_holm
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Picture, Row, Section, list_rows, make_row
from feel321.analysis.table.items import OTHER, ROLE, STIMULUS, TEST, Part, split_arms
from feel321.analysis.table.schema import ANSWERED, CHOSEN, HIGHEST, PAIRED
from feel321.analysis.words import ONE_WAY, format_count, format_level, format_name, join_words

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from pandas import DataFrame

    from feel321.analysis.arrays import Values
    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

# Choices between two stimuli: which metric predicts them, and what they say of the reducers.

CLUSTERED = "95 % t interval, clustered by participants and recordings"
CHOICE_TABLES = ("predicted", "differences", "abilities", "sizes")
ASKED = {
    "triplet": "which of two stimuli feels more like the reference",
    "preference": "which of two stimuli is preferred",
}
"""Scale -> what people chose, within a sentence."""


def compute_choices(table: Table, choices: Choices) -> Found:
    """Evaluate triplets and preferences, per scale and level."""
    rows: dict[str, list[Row]] = {f"choices_{name}": [] for name in CHOICE_TABLES}
    told: list[Row] = []
    notes: list[str] = []
    pictures: list[Picture] = []
    for part in split_arms(table.rows[table.rows["scale"].isin(CHOSEN)]):
        own = replace(table, rows=part.rows.reset_index(drop=True))
        found: list[str] = [*_count_catches(part, own, rows["choices_sizes"])]
        rng = choices.make_rng("choices", *part.place)
        scale = partial(_scale, draws=choices.draws, rng=rng)
        for step in (partial(_predict, told=told, pictures=pictures), scale):
            try:
                found += step(part, own, rows)
            except ValueError as error:
                found.append(f"{str(error).removesuffix('.')}.")
        notes += [f"{part.lead}: {note}" for note in found]
    clauses = [_claim(one) for one in told]
    facts = {"parts": told} if any(rows.values()) else {}
    return Found(rows, facts, pictures, notes, clauses=clauses)


def _find_roles(table: Table) -> tuple[Any, Any]:
    """Find the roles of both stimuli of each choice."""
    roles: Any = {} if table.stimuli is None else table.stimuli[ROLE]
    return table.rows[STIMULUS].map(roles).to_numpy(), table.rows[OTHER].map(roles).to_numpy()


def _count_catches(part: Part, table: Table, rows: list[Row]) -> Iterator[str]:
    """Count how often an anchor was chosen, which nobody should."""
    one, other = _find_roles(table)
    is_catch = (one == "anchor") != (other == "anchor")
    if n := int(is_catch.sum()):
        first = (table.rows["rating"] == HIGHEST).to_numpy()
        wrong = int((np.where(first, one, other)[is_catch] == "anchor").sum())
        rows += parts.count_rows({"anchors_chosen": wrong, "catch_trials": n}, n=n, **part.keys)
        yield f"an anchor was chosen in {wrong} of {n} catch trials."


def _predict(
    part: Part, table: Table, rows: dict[str, list[Row]], *, told: list[Row], pictures: list[Picture]
) -> Sequence[str]:  # fmt: skip
    """Count how many choices each metric predicts."""
    metrics = list(dict.fromkeys([*table.metrics, *table.rivals]))
    found = predict(gather_votes(table, metrics=metrics))
    keys: Row = {**part.keys, "n": found.n_votes, "interval": CLUSTERED}
    shares = {"share": "share low high p_holm", "n_choices": "n"}
    records = [row | {"n": found.n_votes} for row in found.to_frame().to_dict("records")]
    rows["choices_predicted"] += list_rows(records, shares, ["metric"], **keys)
    others: Row = {"low": found.others_low, "high": found.others_high}
    ceiling = {"majority_of_others": (found.others, others), "majority_of_all": (found.majority, {})}  # fmt: skip
    for name, (value, ends) in ceiling.items():
        if np.isfinite(value):
            rows["choices_predicted"].append(make_row("share", value, metric=name, **ends, **keys))
    pair = {"metric": "first", "second_metric": "second"}
    quantities = {"difference": "difference low high p_holm"}
    rows["choices_differences"] += list_rows(found.differences, quantities, pair, **keys)
    sizes = ("n_participants", "n_recordings", "n_pairs")
    counts = [{name: getattr(found, name) for name in sizes}]
    rows["choices_sizes"] += list_rows(counts, sizes, n=found.n_votes, **part.keys)
    told.append(describe_prediction(part, table, found))
    caption = (
        f"{part.subject}: share of {found.n_votes} choices that each metric predicts, with 95 % intervals for other "
        f"people and other recordings ({found.n_participants} participants, {found.n_recordings} recordings). Line: "
        "chance. Band: the majority of the other participants, and of all."
    )
    slug = parts.make_slug("choices", *part.place)
    pictures.append(Picture(slug, caption, partial(_draw_shares, found)))
    return tuple(found.notes)


def _draw_shares(found: Statistic) -> Figure:
    table = found.to_frame().sort_values("share", ascending=False, kind="stable")
    frame = 100 * table[["share", "low", "high"]]
    frame["name"] = table["metric"].map(format_name)
    known = [100 * share for share in (found.others, found.majority) if np.isfinite(share)]
    band = (min(known), max(known)) if known else (np.nan, np.nan)
    label, columns = "Choices predicted (%)", "share low high"
    lines = {"-": 50.0}
    return kinds.draw_estimates(frame, label, columns=columns, lines=lines, band=band)


def describe_prediction(part: Part, table: Table, found: Statistic) -> Row:
    """Decide which metrics may be said to predict the choices, and whether any predicts more than another."""
    shares = found.shares
    sizes = {"participant": found.n_participants, "recording": found.n_recordings}
    listed = sorted(found.to_frame().to_dict("records"), key=lambda row: -row["share"])
    clear = [row for row in listed if row["p_holm"] < parts.SIGNIFICANCE]
    right = [row for row in clear if row["share"] > CHANCE]
    told: Row = {
        "scale": part.scale, "subject": part.subject, "level": part.level * part.several,
        "compared": len(found.differences), "estimable": not shares["p"].isna().all(), "n_metrics": len(shares),
        "units": [format_count(size, name) for name, size in sizes.items()],
        "few": [format_count(size, name) for name, size in sizes.items() if size < FEW],
        "others": found.others, "highest": listed[0], "right": right,
        "wrong": [row for row in clear if row["share"] < CHANCE], "worse": [], "without": [],
    }  # fmt: skip
    if not right:
        return told
    best = right[0]["metric"]
    for row in found.differences.to_dict("records"):
        larger, smaller = row["first"], row["second"]
        if row["difference"] < 0:
            larger, smaller = smaller, larger
        if row["p_holm"] < parts.SIGNIFICANCE and larger == best:
            told["worse"].append(smaller)
    return told | {"without": list(_find_turns(table, best, list(shares.index)))}


def _find_turns(table: Table, metric: str, metrics: Sequence[str]) -> Iterator[str]:
    """Name the reducers without which the leading metric is no longer shown to predict."""
    rows, stimuli = table.rows, table.stimuli
    if stimuli is None:
        return
    both = [rows[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER)]
    tested = sorted(stimuli.loc[stimuli[ROLE] == TEST, "reducer"].unique())
    for name in (name for name in tested if any((ids == name).any() for ids in both)):
        rest = rows[(both[0] != name) & (both[1] != name)]
        try:
            left = predict(gather_votes(replace(table, rows=rest), metrics=metrics)).shares
        except ValueError:
            continue
        own = left.loc[metric]
        if not (own["p_holm"] < parts.SIGNIFICANCE and own["share"] > CHANCE):
            yield name


def _claim(told: Row) -> str:
    """Say for the headline which metrics predict these choices."""
    asked, where = ASKED[told["scale"]], format_level(told["level"])
    if not told["estimable"]:
        return f"whether a metric predicts {asked} cannot be estimated with {join_words(told['units'])}"
    if not told["right"]:
        return f"no metric is shown to predict {asked}{where}"
    names = [
        f"{format_name(row['metric'])} ({100 * row['share']:.0f} % of the choices)"
        for row in told["right"]
    ]
    hint = f" (with {join_words(told['few'])}, a hint rather than a result)" if told["few"] else ""
    return f"{join_words(names)} predict{'s' * (len(names) == 1)} {asked}{where}{hint}"


def _scale(
    part: Part, table: Table, rows: dict[str, list[Row]], *, draws: int, rng: np.random.Generator
) -> Sequence[str]:
    """Scale the reducers by Bradley-Terry; catch trials, which are won nearly always, have no part in it."""
    one, other = _find_roles(table)
    votes, stimuli = table.rows[(one != "anchor") & (other != "anchor")], table.stimuli
    if len(votes["reference_reducer"].unique()) > 1:
        votes = votes[votes["matched"]]  # likeness to one reference is no likeness to another
    if stimuli is None or votes.empty:
        return ()
    first, second = (votes[name].map(stimuli["reducer"]) for name in (STIMULUS, OTHER))
    winner = first.where(votes["rating"] == HIGHEST, second)
    pairs = votes[["participant"]].assign(first=first, second=second, winner=winner)
    fitted = _fit_abilities(pairs, draws, rng)
    records = []
    for row in fitted.to_frame().to_dict("records"):
        met = (first == row["item"]) | (second == row["item"])
        if row["item"] != "order":
            share = float((winner[met] == row["item"]).mean())
            records.append(row | {"share": share, "n": int(met.sum())})
    quantities = {"ability": "estimate low high", "share_chosen": "share", "n_choices": "n"}
    keys = {"reducer": "item", "n": "n"}
    own = {"interval": ONE_WAY, **part.keys}
    rows["choices_abilities"] += list_rows(records, quantities, keys, **own)
    return tuple(fitted.notes)


def _fit_abilities(pairs: DataFrame, draws: int, rng: np.random.Generator) -> Statistic:
    """Fit abilities with intervals over participants; shrunken ones without, where a reducer always won or lost."""
    try:
        alone = len(pairs["participant"].unique()) == 1
        return bradley_terry(pairs, by_rater=not alone, order_effect=True, draws=draws, rng=rng)
    except ValueError as error:
        if "separation" not in str(error):
            raise
    shrunken = bradley_terry(pairs, prior=0.5, order_effect=True)
    return shrunken.replace(fixed=shrunken.fixed.assign(low=np.nan, high=np.nan))


# ABX trials: how well what a reducer made is distinguished from its reference.

WILSON = "95 % interval that follows from Wilson's"


def compute_discrimination(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Evaluate ABX trials per reducer, against whatever its reference was."""
    from pandas import DataFrame

    rows = table.rows[(table.rows["scale"] == ANSWERED) & (table.rows["role"] != "reference")]
    right = rows["rating"] == HIGHEST
    trials = rows.assign(first=rows["reducer"], second="reference", correct=right)
    found: dict[Any, Any] = {
        names: discriminate_pairs(part)[None]
        for names, part in trials.groupby(["level", "reducer"], observed=True)
    }
    if not found:
        return Found()
    notes, records = [], []
    adjusted = adjust_holm([one.p for one in found.values()])
    for ((level, reducer), one), p in zip(found.items(), adjusted, strict=True):
        records.append(dict(one) | {"level": level, "reducer": reducer, "p_holm": p})
        notes += [f"ABX, {reducer}, {level}: {note}" for note in one.notes]
    quantities = {
        "share_correct": "share wilson_low wilson_high p_holm",
        "d_prime": "d_independent d_independent_low d_independent_high",
        "n_correct": "n_correct", "n_trials": "n_trials",
    }  # fmt: skip
    keys = {"level": "level", "reducer": "reducer", "n": "n_trials"}
    listed = list_rows(records, quantities, keys, interval=WILSON)
    apart, n = sum(p < parts.SIGNIFICANCE for p in adjusted), len(found)
    listed += parts.count_rows({"n_distinguished": apart, "n_compared": n}, n=n)
    caption = (
        "d' in ABX trials of each reducer against its reference, with 95 % intervals that follow from Wilson's; 0 is "
        "guessing. In brackets: correct answers of trials."
    )
    frame = DataFrame(records).rename(columns={"d_independent": "d"})
    tried = frame["n_correct"].astype(str) + "/" + frame["n_trials"].astype(str)
    frame["name"] = frame["reducer"] + " (" + frame["level"].map(format_name) + ") (" + tried + ")"
    columns = "d d_independent_low d_independent_high"
    draw = partial(kinds.draw_estimates, frame, "d′", columns=columns)
    picture = Picture("discrimination", caption, draw)
    clause = f"{apart} of {n} reducers and anchors were distinguished from their reference"
    facts = {"apart": apart, "n": n}
    return Found({"discrimination": listed}, facts, [picture], notes, clauses=[clause])


# One axis against three: dissimilarities from the original beside those of identical pairs.


def compute_told_apart(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Compare dissimilarities from the original with those of identical pairs."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    listed: list[Row] = []
    told: list[Row] = []
    clauses: list[str] = []
    several = len(rows["level"].unique()) > 1
    quantities = {
        "difference": "difference low high p_holm", "area": "area area_low area_high",
        "d_prime": "d_prime d_prime_low d_prime_high",
    }  # fmt: skip
    names = ("t", "df", "n_participants", "n_judgements", "n_identical")
    quantities |= dict(zip(names, names, strict=True))
    for level, part in rows.groupby("level", observed=True):
        try:
            own = compare_with_original(part)
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: one axis is not compared with three. {error}")
            continue
        keys = {"reducer": "reducer", "n": "n_judgements"}
        interval = "95 % t interval over participants"
        listed += list_rows(own, quantities, keys, level=level, interval=interval)
        single = own[own["reducer"] != EVERY]
        clear = (single["p_holm"] < parts.SIGNIFICANCE) & (single["difference"] > 0)
        apart, rest = (list(single.loc[which, "reducer"]) for which in (clear, ~clear))
        where, n = str(level) * several, len(single)
        told.append({"level": where, "apart": apart, "n": n, "rest": rest})
        clauses.append(
            f"one axis was distinguished from three{format_level(where)} for {len(apart)} of {n} reducers"
        )
    facts = {"parts": told} if told else {}
    return Found({"told_apart": listed}, facts, notes=notes, clauses=clauses)


# Dissimilarities: the perceptual map, and what its axes are associated with.

DRAWS = 200
"""Maps drawn anew; each takes a fit."""


def compute_space(table: Table, choices: Choices) -> Found:
    """Map the dissimilarities of every level."""
    dissimilar = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    pictures: list[Picture] = []
    told: list[Row] = []
    tables = ("space", "space_stress", "space_metrics", "space_attributes")
    rows: dict[str, list[Row]] = {name: [] for name in tables}
    for level in sorted(dissimilar["level"].unique()):
        rng, draws = choices.make_rng("space", level), min(DRAWS, max(choices.draws, 3))
        try:
            own = dissimilar[dissimilar["level"] == level]
            names, matrices = spaces.gather_dissimilarities(own)
            ellipses = spaces.bootstrap_space(matrices, draws=draws, rng=rng)
            rng = choices.make_rng("space", level, "stress")
            stress = spaces.stress_by_dimension(matrices, rng=rng)
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no map. {error}")
            continue
        caption = (
            f"Map of the dissimilarities at level {format_name(level)}, with 95 % bootstrap ellipses over "
            "participants; only distances have a meaning."
        )
        draw = partial(kinds.draw_space, ellipses, names)
        pictures.append(Picture(parts.make_slug("space", level), caption, draw))
        keys: Row = {"level": level, "n": len(names)}
        rows["space"] += _list_places(names, ellipses.space, ellipses=ellipses, keys=keys)
        for number, value in enumerate(stress, start=1):
            rows["space_stress"].append(make_row("stress", value, dimensions=number, **keys))
        try:
            rated = table.rows[table.rows["level"] == level].drop_duplicates("stimulus_id")
            means = rated.groupby("reducer", observed=True)[list(table.metrics)].mean()
            attributes = means.reindex(list(names))
            rng = choices.make_rng("space", level, "procrustes")
            met = _relate(ellipses, attributes, rows, keys=keys, draws=choices.draws, rng=rng)
            told.append({"level": level, **met})
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: the map is compared with nothing else. {error}")
        rows["space_attributes"] += _relate_axes(own, table, level, choices=choices, notes=notes)
    clauses = [
        f"{'the metrics align' if one['shown'] else 'it is unclear whether the metrics align'} with the perceptual map "
        f"(level {format_name(one['level'])})"
        for one in told
    ]
    facts = {"parts": told} if any(rows.values()) else {}
    return Found(rows, facts, pictures, notes, clauses=clauses)


def _list_places(
    names: Sequence[str], space: Statistic, *, ellipses: Statistic | None, keys: Row
) -> list[Row]:
    """List the places on a map, with their ellipses where these were drawn."""
    records = [
        {"reducer": name, "x": x, "y": y}
        for name, (x, y) in zip(names, space.positions, strict=True)
    ]
    quantities = ["x", "y"]
    if ellipses:
        quantities += ["half_axis_1", "half_axis_2", "angle"]
        shapes = zip(records, ellipses.half_axes, ellipses.angle, strict=True)
        for record, (one, two), angle in shapes:
            record |= {"half_axis_1": one, "half_axis_2": two, "angle": angle}
    return list_rows(records, quantities, ["reducer"], **keys)


def _relate(
    ellipses: Statistic, attributes: DataFrame, rows: dict[str, list[Row]], *, keys: Row, draws: int,
    rng: np.random.Generator,
) -> Row:  # fmt: skip
    """Compare the map with the metrics of its stimuli."""
    known = attributes.notna().all(axis=1).to_numpy()
    metrics = attributes[known]
    metrics = metrics.loc[:, metrics.std() > 0]
    scaled = ((metrics - metrics.mean()) / metrics.std()).to_numpy()
    positions = ellipses.space.positions[known]
    aligned = spaces.align_spaces(positions, scaled, permutations=draws, rng=rng)
    note = f"{aligned.permutations} pairings"
    row = make_row("procrustes", aligned.correlation, p=aligned.p, note=note, **keys)
    rows["space_metrics"].append(row)
    return {"r": aligned.correlation, "p": aligned.p, "shown": aligned.p < parts.SIGNIFICANCE}


ATTRIBUTE = {
    "r2": "r2 - - p_holm", "axis_1": "axis_1", "axis_2": "axis_2", "p_unadjusted": "p", "p_least": "p_least",
}  # fmt: skip


def _relate_axes(
    rows: DataFrame, table: Table, level: str, *, choices: Choices, notes: list[str]
) -> list[Row]:
    """Regress the attributes of stimuli on the axes of the recordings' maps."""
    lead, rng = f"{PAIRED}, {level}", choices.make_rng("space", level, "attributes")
    try:
        places, known = spaces.gather_points(rows, table.stimuli, rng=rng)
        found = spaces.regress_points(places, known, draws=min(choices.draws, 1000), rng=rng)
    except ValueError as error:
        notes.append(f"{lead}: axes are not compared with attributes. {error}")
        return []
    _adjust(found, table.metrics)
    notes += [f"{lead}: {note}" for note in _note_points(places, found)]
    return list_rows(found, ATTRIBUTE, ["property", "n"], level=level)


def _adjust(rows: Sequence[Row], planned: Sequence[str]) -> None:
    """Adjust p by Holm over the metrics that were planned, and over the others; of those that could be small at all."""
    for row in rows:
        row["p_holm"] = np.nan
    tested = [row for row in rows if row["p_least"] < parts.SIGNIFICANCE]
    for is_planned in (True, False):
        own = [row for row in tested if (row["property"] in planned) == is_planned]
        for row, p in zip(own, adjust_holm([row["p"] for row in own]), strict=True):
            row["p_holm"] = p


def _note_points(places: Values, rows: Sequence[Row]) -> Iterator[str]:
    """Say on how little a regression of axes on attributes rests."""
    recordings, n = places.shape[:2]
    if mute := [row["property"] for row in rows if row["p_least"] >= parts.SIGNIFICANCE]:
        yield f"permutations of {n} stimuli cannot show an association of the axes with {', '.join(mute)}."
    if recordings * n < spaces.ENOUGH * len(rows):
        yield (
            f"{len(rows)} attributes are compared with {recordings * n} points ({n} stimuli in {recordings} "
            f"recordings); {spaces.ENOUGH} for each are recommended: R² is descriptive only."
        )


SECTIONS = (
    Section("choices", "Choices between two stimuli", "differ", compute_choices),
    Section("discrimination", "Telling stimuli apart (ABX)", "apart", compute_discrimination),
    Section("told_apart", "One axis against three", "apart", compute_told_apart),
    Section("space", "The space of what was felt", "apart", compute_space),
)
