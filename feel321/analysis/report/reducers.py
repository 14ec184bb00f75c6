"""Sections about reducers: profile of mean ratings, differences and equivalence, levels compared."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.contrasts.compare import (
    compare_terms,
    equivalence,
    find_interval90,
    fit_reducers,
    non_inferiority,
    participant_means,
    profile_reducers,
)
from feel321.analysis.figures.kinds import draw_equivalence, draw_profiles
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.model import FEW, adjust_holm
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report.parts import (
    ITEM,
    SIGNIFICANCE,
    RatingsPart,
    count_units,
    find_table_steps,
    select_tests,
    split_arms,
    thin_parts,
    thin_rows,
)
from feel321.analysis.report.section import (
    Found,
    Picture,
    Row,
    Section,
    count_rows,
    make_row,
    make_slug,
    name_subject,
)
from feel321.analysis.table.items import find_sources, format_recordings
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


def compute_profile(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer."""
    single = table.rows[table.rows["role"] != PAIR]
    profile, people = profile_reducers(single), participant_means(single)
    if profile.empty:
        return Found(notes=("Only pairs of two test stimuli were rated: no ratings per reducer.",))
    order, scales = order_reducers(profile["reducer"]), list(single["scale"].unique())
    listed = sorted(profile.to_dict("records"), key=lambda row: (
        scales.index(row["scale"]), row["level"], ROLES.index(row["role"]), order.index(row["reducer"]),
    ))  # fmt: skip
    rows = {"profiles": [row for one in listed for row in _list_profile(one)]}
    rows["participants"] = [
        make_row("mean", one["rating"], n=1, **{key: one[key] for key in PERSONAL})
        for one in people.to_dict("records")
    ]
    parts = [
        (scale, level) for scale, level, _ in split_arms(table.rows[table.rows["role"] == ROLES[0]])
    ]
    several = len({level for _, level in parts}) > 1
    told, drawn = [], []
    for scale, level in parts:
        own, whose = (_choose(frame, scale, level) for frame in (profile, people))
        subject = name_subject(scale, level * several)
        drawn.append((subject, own, whose))
        told.append({"subject": subject, **describe_extremes(own)})
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    pictures = (
        [Picture("profile", _caption_profiles(drawn), partial(draw_profiles, drawn, looks))]
        if drawn
        else []
    )
    return Found(rows, {"parts": told}, pictures)


def _list_profile(one: Mapping[Any, Any]) -> Iterator[Row]:
    keys: Row = {key: one[key] for key in ("scale", "level", "role", "reducer")} | {
        "n": one["n_ratings"]
    }
    yield make_row("mean", one["mean"], low=one["low"], high=one["high"], interval=STUDENT, **keys)
    yield from count_rows(
        {name: one[name] for name in ("n_participants", "n_stimuli", "n_ratings")}, **keys
    )


def _choose(frame: DataFrame, scale: str, level: str) -> DataFrame:
    return frame[(frame["scale"] == scale) & (frame["level"] == level)]


def describe_extremes(profile: DataFrame) -> Row:
    """Find which reducers are at either end; clear: whether their intervals are apart."""
    tests, means = (own := profile[profile["role"] == ROLES[0]]), own["mean"]
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
    caption += " Grey: each participant's mean; clouds: their distribution."
    if any((rows["scale"] == ANSWERED).any() for _, rows, _ in drawn):
        caption += " Guessing gives 50 in ABX."
    apart = {"reference": "the hidden reference", "anchor": "anchors"}
    roles = [
        name
        for role, name in apart.items()
        if any((rows["role"] == role).any() for _, rows, _ in drawn)
    ]
    return caption + (f" Below the dotted line: {' and '.join(roles)}." if roles else "")


PROFILES = Section("reducers", "Ratings per reducer", "differ", compute_profile)

# Reducers against each other: differences, equivalence, non-inferiority of the simpler one.

REDUCER = "reducer"


def compute_contrasts(table: Table, choices: Choices) -> Found:
    """Compare every two reducers on every scale and level."""
    told: list[Row] = []
    notes: list[str] = []
    pictures: list[Picture] = []
    rows: dict[str, list[Row]] = {"contrasts": [], "reducers_together": []}
    # A person's reducers are so many effects.
    for part in thin_parts(table, choices, n_slopes=table.rows[REDUCER].nunique(), matched=False):
        notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        try:
            pairs, joint = compare_all(part.rows, choices.margin)
        except ValueError as error:
            notes.append(f"{part.lead}: reducers are not compared. {error}")
            continue
        rows["contrasts"] += [row for pair in pairs for row in _list_pair(part, pair)]
        differ = sum(pair["p_holm"] < SIGNIFICANCE for pair in pairs)
        people, n = part.rows["participant"].nunique(), len(pairs)
        rows["reducers_together"] += [
            make_row("f", joint["statistic"], p=joint["p"], n=people, **part.keys),
            *count_rows(
                {"df_1": joint["df_1"], "df_2": joint["df_2"], "n_differ": differ, "n_pairs": n},
                n=people,
                **part.keys,
            ),
        ]
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
    fit, terms, n = fit_reducers(rows, names)
    pairs: list[Row] = [
        {"first": one, "second": two, "n": n} | dict(contrast(fit, {terms[one]: 1, terms[two]: -1}))
        for one, two in combinations(names, 2)
    ]
    for pair, holm in zip(pairs, adjust_holm([pair["p"] for pair in pairs]), strict=True):
        numbers = pair["estimate"], pair["se"], pair["df"]
        pair |= {
            "p_holm": holm,
            "p_equivalence": np.nan,
            "p_not_worse": np.nan,
            "equivalent": False,
        }
        pair["low90"], pair["high90"] = find_interval90(*numbers)
        if margin is not None and 0 < pair["se"] < np.inf:
            test = equivalence(*numbers, low=-margin, high=margin)
            pair |= {"p_equivalence": test.p, "equivalent": test.equivalent, "test": test}
            pair["p_not_worse"] = non_inferiority(*numbers, margin=-margin).p
    return pairs, dict(compare_terms(fit, list(terms.values())))


def _list_pair(part: RatingsPart, pair: Row) -> Iterator[Row]:
    keys: Row = {
        **part.keys,
        "reducer": pair["first"],
        "second_reducer": pair["second"],
        "n": pair["n"],
    }
    ends = {"low": pair["low"], "high": pair["high"], "interval": SATTERTHWAITE}
    yield make_row("difference", pair["estimate"], **ends, p=pair["p_holm"], **keys)
    yield make_row("t", pair["t"], p=pair["p"], **keys)
    yield make_row("df", pair["df"], **keys)
    ends = {"low": pair["low90"], "high": pair["high90"], "interval": "90 % t interval"}
    yield make_row("difference_90", pair["estimate"], **ends, p=pair["p_equivalence"], **keys)
    if np.isfinite(pair["p_equivalence"]):
        yield make_row("equivalent", note="yes" if pair["equivalent"] else "not shown", **keys)
        yield make_row("non_inferiority", pair["low90"], p=pair["p_not_worse"], **keys)
        yield make_row(
            "not_worse", note="yes" if pair["p_not_worse"] < SIGNIFICANCE else "not shown", **keys
        )


def _picture_equivalence(
    part: RatingsPart, pairs: list[Row], margin: float | None
) -> Iterator[Picture]:
    tests = {
        f"{pair['first']} − {pair['second']}": pair["test"] for pair in pairs if "test" in pair
    }
    if not tests:
        return
    scenes = find_sources(part.rows)
    size = format_count(part.rows["participant"].nunique(), "participant")
    size += f", {format_recordings(len(scenes), scenes.nunique())}"
    caption = (
        f"Differences between reducers in {part.ratings} with 90 % intervals, of two one-sided tests at 5 %; shaded: "
        f"the margin of equivalence, {margin:g} points. Filled: equivalence is shown. {size}."
    )
    yield Picture(
        make_slug("equivalence", *part.place),
        caption,
        partial(draw_equivalence, tests),
        detail=True,
    )


def describe_hint(rows: DataFrame) -> list[str]:
    """List the units of which there are so few that a finding is a hint."""
    return [format_count(count, name) for name, count in count_units(rows).items() if count < FEW]


CONTRASTS = Section("contrasts", "Reducers against each other", "differ", compute_contrasts)

# Level arms compared, for the question whether something felt good because it was strong.


def compute_levels(table: Table, choices: Choices) -> Found:
    """Compare the levels at which stimuli were rated."""
    tests, steps = select_tests(table), find_table_steps(table)
    if tests["level"].nunique() < NAMED:
        return Found()
    tests = tests.assign(**{ITEM: tests["stimulus_id"]})
    found: list[Row] = []
    notes: list[str] = []
    for scale, rows in tests.groupby("scale", observed=True, sort=False):
        rng = choices.make_rng("levels", str(scale))
        part, thinned = thin_rows(rows, n_slopes=len(steps), rng=rng)
        notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        try:
            own = list(_compare_levels(part, steps))
        except ValueError as error:
            notes.append(f"{scale}: levels are not compared. {error}")
            continue
        found += [{"scale": scale, "hint": describe_hint(part)} | row for row in own]
    for row, holm in zip(found, adjust_holm([row["p"] for row in found]), strict=True):
        row |= {"p_holm": holm, "decided": holm < SIGNIFICANCE}
    listed: list[Row] = []
    for row in found:
        keys: Row = {key: row[key] for key in ("scale", "first_level", "second_level", "of", "n")}
        ends = {"low": row["low"], "high": row["high"], "interval": SATTERTHWAITE}
        listed.append(
            make_row(
                "difference", row["estimate"], **ends, p=row["p_holm"], note=row["unit"], **keys
            )
        )
        listed.append(make_row("t", row["t"], p=row["p"], **keys))
        listed.append(make_row("df", row["df"], **keys))
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
    groups += [ITEM] * (cells[ITEM].nunique() < len(cells))
    if sizes["source"] < sizes["recording"]:
        # What recordings of one source share: as a whole, of what was reduced alike, and of that at one level.
        groups += ["source"] * (sizes["source"] > 1) + ["source:reducer", "source:reducer:level"]
    terms = [*(f"arm:`{name}_w`" for name in used), *(f"(1 | {group})" for group in groups)]
    fit = fit_mixed(
        " + ".join(["rating ~ 0 + arm", *terms]), cells.assign(arm=cells["level"].map(codes))
    )
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        wanted = {"rating": ({one: 1.0, two: -1.0}, "points of rating")}
        for name in used:
            size = steps[name].size
            weights = {f"{one}:{name}_w": size, f"{two}:{name}_w": -size}
            wanted[name] = weights, f"points per {steps[name].per} of the metric"
        for what, (weights, unit) in wanted.items():
            pair = {
                "first_level": first,
                "second_level": second,
                "n": len(cells),
                "of": what,
                "unit": unit,
            }
            yield pair | dict(contrast(fit, weights))


def _gather_arms(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    import pandas as pd

    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        cells = make_cells(arm, metrics).table.groupby(
            ["participant", "recording", ITEM], observed=True
        )
        means = cells.mean(numeric_only=True).reset_index()
        means = means.astype(dict.fromkeys(["participant", "recording", ITEM], object))
        reducers = means[ITEM].map(arm.drop_duplicates(ITEM).set_index(ITEM)["reducer"])
        base, source = means["recording"] + "/" + reducers, means["recording"].map(sources)
        tables.append(means.assign(level=level, reducer=reducers, base=base, source=source))
    return pd.concat(tables, ignore_index=True)


LEVELLED = Section("levels", "Level arms compared", "differ", compute_levels)
