"""Sections about reducers: profile of mean ratings, differences and equivalence, levels compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.contrasts import compare
from feel321.analysis.figures import kinds
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.model import FEW, adjust_holm
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Picture, Row, Section, list_rows, make_row
from feel321.analysis.table.items import (
    Part,
    find_sources,
    format_recordings,
    select_tests,
    split_arms,
)
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import ANSWERED, PAIR, PAIRED, ROLES
from feel321.analysis.words import SATTERTHWAITE, STUDENT, format_count, join_words

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.analysis.table.metrics import Step


# Ratings per reducer: means, their intervals over participants, hidden reference and anchors beside them.

WAYS = {
    PAIRED: ("least like the reference", "most like it"),
    ANSWERED: ("told apart most", "least"),
}
NAMED = 2
PERSONAL = ("scale", "level", "participant", "role", "reducer")
TEST = ROLES[0]


def compute_profile(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer."""
    single = table.rows[table.rows["role"] != PAIR]
    profile, people = compare.profile_reducers(single), compare.participant_means(single)
    if profile.empty:
        return Found(notes=("Only pairs of two test stimuli were rated: no ratings per reducer.",))
    order, scales = order_reducers(profile["reducer"]), list(single["scale"].unique())
    listed = sorted(profile.to_dict("records"), key=lambda row: (
        scales.index(row["scale"]), row["level"], ROLES.index(row["role"]), order.index(row["reducer"]),
    ))  # fmt: skip
    names = ("n_participants", "n_stimuli", "n_ratings")
    quantities = {"mean": "mean low high"} | dict(zip(names, names, strict=True))
    keys = {key: key for key in ("scale", "level", "role", "reducer")} | {"n": "n_ratings"}
    rows = {
        "profiles": list_rows(listed, quantities, keys, interval=STUDENT),
        "participants": list_rows(people, {"mean": "rating"}, PERSONAL, n=1),
    }
    told, drawn = [], []
    for part in split_arms(table.rows[table.rows["role"] == TEST]):
        own, whose = (
            frame[(frame["scale"] == part.scale) & (frame["level"] == part.level)]
            for frame in (profile, people)
        )
        drawn.append((part.subject, own, whose))
        told.append({"subject": part.subject, **describe_extremes(own)})
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    draw = partial(kinds.draw_profiles, drawn, looks)
    pictures = [Picture("profile", _caption_profiles(drawn), draw)] if drawn else []
    return Found(rows, {"parts": told}, pictures)


def describe_extremes(profile: DataFrame) -> Row:
    """Find which reducers are at either end; clear: whether their intervals are apart."""
    tests = profile[profile["role"] == TEST]
    means = tests["mean"]
    if means.nunique() < NAMED:
        return {"high": [], "low": [], "clear": False}
    high, low = (tests[means == end] for end in (means.max(), means.min()))
    known = not tests[["low", "high"]].isna().any(axis=None)
    ways = WAYS.get(profile["scale"].iloc[0], ("highest", "lowest"))
    return {
        "high": list(high["reducer"]), "low": list(low["reducer"]), "top": means.max(), "bottom": means.min(),
        "ways": ways, "clear": bool(known and high["low"].min() > low["high"].max()),
    }  # fmt: skip


def _caption_profiles(drawn: list[tuple[str, DataFrame, DataFrame]]) -> str:
    caption = f"Mean rating per reducer: {join_words([subject for subject, _, _ in drawn])}"
    if max(rows["n_participants"].max() for _, rows, _ in drawn) < SMALLEST:
        caption += "; one participant each, so no intervals."
    else:
        caption += ", with 95 % t intervals over participants: other people, these recordings."
    caption += " Grey: each participant's mean."
    if any((rows["scale"] == ANSWERED).any() for _, rows, _ in drawn):
        caption += " Guessing gives 50 in ABX."
    there = {role for _, rows, _ in drawn for role in rows["role"]}
    apart = {"reference": "the hidden reference", "anchor": "anchors"}
    roles = [name for role, name in apart.items() if role in there]
    return caption + (f" Below the dotted line: {' and '.join(roles)}." if roles else "")


# Reducers against each other: differences, equivalence, non-inferiority of the simpler one.

REDUCER = "reducer"


def compute_contrasts(table: Table, choices: Choices) -> Found:
    """Compare every two reducers on every scale and level."""
    told: list[Row] = []
    notes: list[str] = []
    pictures: list[Picture] = []
    rows: dict[str, list[Row]] = {"contrasts": [], "reducers_together": []}
    # A person's reducers are so many effects.
    n_slopes = table.rows[REDUCER].nunique()
    for part in parts.thin_parts(table, choices, n_slopes=n_slopes, matched=False):
        notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        try:
            pairs, joint = compare_all(part.rows, choices.margin)
        except ValueError as error:
            notes.append(f"{part.lead}: reducers are not compared. {error}")
            continue
        for pair in pairs:
            rows["contrasts"] += _list_pair(part, pair)
        differ = sum(pair["p_holm"] < parts.SIGNIFICANCE for pair in pairs)
        people, n = part.rows["participant"].nunique(), len(pairs)
        sizes = {"f": "statistic - - p"} | {
            name: name for name in ("df_1", "df_2", "n_differ", "n_pairs")
        }
        joint |= {"n_differ": differ, "n_pairs": n}
        rows["reducers_together"] += list_rows([joint], sizes, n=people, **part.keys)
        same = [[pair["first"], pair["second"]] for pair in pairs if pair["equivalent"]]
        told.append({
            "subject": part.subject, "differ": differ, "n_pairs": n, "same": same,
            "tested": choices.margin is not None, "margin": choices.margin,
            "hint": describe_hint(part.rows) if differ or same else [],
        })  # fmt: skip
        pictures += _picture_equivalence(part, pairs, choices.margin)
    return Found(rows, {"parts": told} if told else {}, pictures, notes)


def compare_all(rows: DataFrame, margin: float | None) -> tuple[list[Row], Row]:
    """Compare every two reducers of one scale and level, and all at once."""
    names = order_reducers(rows[REDUCER])
    if len(names) == 1:
        raise ValueError(f"Only one was rated, '{names[0]}'.")
    fit, terms, n = compare.fit_reducers(rows, names)
    pairs: list[Row] = []
    for one, two in combinations(names, 2):
        found = dict(contrast(fit, {terms[one]: 1, terms[two]: -1}))
        pairs.append({"first": one, "second": two, "n": n, **found})
    adjusted = adjust_holm([pair["p"] for pair in pairs])
    for place, holm in enumerate(adjusted):
        pair = pairs[place]
        numbers = pair["estimate"], pair["se"], pair["df"]
        pair |= dict.fromkeys(("p_equivalence", "p_not_worse"), np.nan)
        pair |= {"p_holm": holm, "equivalent": False}
        pair["low90"], pair["high90"] = compare.find_interval90(*numbers)
        if margin is not None and 0 < pair["se"] < np.inf:
            test = compare.equivalence(*numbers, low=-margin, high=margin)
            pair |= {"p_equivalence": test.p, "equivalent": test.equivalent, "test": test}
            pair["p_not_worse"] = compare.non_inferiority(*numbers, margin=-margin).p
    return pairs, dict(compare.compare_terms(fit, list(terms.values())))


def _list_pair(part: Part, pair: Row) -> Iterator[Row]:
    keys: Row = {"reducer": pair["first"], "second_reducer": pair["second"], "n": pair["n"]}
    keys |= part.keys
    quantities = {"difference": "estimate low high p_holm", "t": "t - - p", "df": "df"}
    yield from list_rows([pair], quantities, interval=SATTERTHWAITE, **keys)
    quantities = {"difference_90": "estimate low90 high90 p_equivalence"}
    yield from list_rows([pair], quantities, interval="90 % t interval", **keys)
    if np.isfinite(pair["p_equivalence"]):
        better = pair["p_not_worse"] < parts.SIGNIFICANCE
        yield make_row("equivalent", "yes" if pair["equivalent"] else "not shown", **keys)
        yield make_row("non_inferiority", pair["low90"], p=pair["p_not_worse"], **keys)
        yield make_row("not_worse", "yes" if better else "not shown", **keys)


def _picture_equivalence(part: Part, pairs: list[Row], margin: float | None) -> Iterator[Picture]:
    from pandas import DataFrame

    tested = [one | {"name": f"{one['first']} − {one['second']}"} for one in pairs if "test" in one]
    if not tested or margin is None:
        return
    scenes = find_sources(part.rows)
    people = format_count(part.rows["participant"].nunique(), "participant")
    caption = (
        f"Differences between reducers in {part.ratings} with 90 % intervals, of two one-sided tests at 5 %; shaded: "
        f"the margin of equivalence, {margin:g} points. Filled: equivalence is shown. {people}, "
        f"{format_recordings(len(scenes), scenes.nunique())}."
    )
    slug = parts.make_slug("equivalence", *part.place)
    frame = DataFrame(tested).rename(columns={"equivalent": "filled"})
    label, columns = "Difference (points of rating)", "estimate low90 high90"
    band = (-margin, margin)
    draw = partial(kinds.draw_estimates, frame, label, columns=columns, band=band)
    yield Picture(slug, caption, draw, detail=True)


def describe_hint(rows: DataFrame) -> list[str]:
    """List the units (participants, and recordings or their sources) so few of which make a finding a hint."""
    sources = find_sources(rows)
    scene = "recording" if sources.is_unique else "source"
    units = {"participant": rows["participant"].nunique(), scene: sources.nunique()}
    return [format_count(count, name) for name, count in units.items() if count < FEW]


# Level arms compared, for the question whether something felt good because it was strong.


def compute_levels(table: Table, choices: Choices) -> Found:
    """Compare the levels at which stimuli were rated."""
    tests, steps = select_tests(table), parts.find_table_steps(table)
    if tests["level"].nunique() < NAMED:
        return Found()
    found: list[Row] = []
    notes: list[str] = []
    for scale, rows in tests.groupby("scale", observed=True, sort=False):
        rng = choices.make_rng("levels", str(scale))
        part, thinned = parts.thin_rows(rows, n_slopes=len(steps), rng=rng)
        notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        try:
            own = list(_compare_levels(part, steps))
        except ValueError as error:
            notes.append(f"{scale}: levels are not compared. {error}")
            continue
        found += [{"scale": scale, "hint": describe_hint(part)} | row for row in own]
    for row, holm in zip(found, adjust_holm([row["p"] for row in found]), strict=True):
        row |= {"p_holm": holm, "decided": holm < parts.SIGNIFICANCE}
    keys = {key: key for key in ("scale", "first_level", "second_level", "of", "n")}
    difference = {"difference": "estimate low high p_holm"}
    listed = list_rows(found, difference, keys | {"note": "unit"}, interval=SATTERTHWAITE)
    listed += list_rows(found, {"t": "t - - p", "df": "df"}, keys)
    return Found({"levels": listed}, {"found": found} if found else {}, notes=notes)


def _compare_levels(part: DataFrame, steps: Mapping[str, Step]) -> Iterator[Row]:
    levels = sorted(part["level"].unique())
    if len(levels) == 1:
        raise ValueError(f"All were rated at one level, '{levels[0]}'.")
    codes = {level: f"c{number}" for number, level in enumerate(levels)}
    cells = _gather_arms(part, tuple(steps))
    used = [name for name in steps if cells[f"{name}_w"].std() > 0]
    sizes = {name: cells[name].nunique() for name in ("participant", "recording", "source")}
    groups = ["participant", "participant:arm"] * (sizes["participant"] > 1)
    groups += ["recording"] * (sizes["recording"] > 1) + ["base"]
    groups += ["item"] * (cells["item"].nunique() < len(cells))
    if sizes["source"] < sizes["recording"]:
        # What recordings of one source share: as a whole, of what was reduced alike, and of that at one level.
        groups += ["source"] * (sizes["source"] > 1) + ["source:reducer", "source:reducer:level"]
    terms = [*(f"arm:`{name}_w`" for name in used), *(f"(1 | {group})" for group in groups)]
    formula = " + ".join(["rating ~ 0 + arm", *terms])
    fit = fit_mixed(formula, cells.assign(arm=cells["level"].map(codes)))
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        wanted = {"rating": ({one: 1.0, two: -1.0}, "points of rating")}
        for name in used:
            size = steps[name].size
            weights = {f"{one}:{name}_w": size, f"{two}:{name}_w": -size}
            wanted[name] = weights, f"points per {steps[name].per} of the metric"
        pair: Row = {"first_level": first, "second_level": second, "n": len(cells)}
        for what, (weights, unit) in wanted.items():
            yield pair | {"of": what, "unit": unit} | dict(contrast(fit, weights))


def _gather_arms(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    import pandas as pd

    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        keys = ["participant", "recording", "item"]
        cells = make_cells(arm, metrics).table.groupby(keys, observed=True)
        means = cells.mean(numeric_only=True).reset_index()
        means = means.astype(dict.fromkeys(keys, object))
        reducers = means["item"].map(arm.drop_duplicates("item").set_index("item")["reducer"])
        base, source = means["recording"] + "/" + reducers, means["recording"].map(sources)
        tables.append(means.assign(level=level, reducer=reducers, base=base, source=source))
    return pd.concat(tables, ignore_index=True)


SECTIONS = (
    Section("levels", "Level arms compared", "differ", compute_levels),
    Section("reducers", "Ratings per reducer", "differ", compute_profile),
    Section("contrasts", "Reducers against each other", "differ", compute_contrasts),
)
