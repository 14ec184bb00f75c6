"""Sections about reducers: profile of mean ratings, levels compared, differences and equivalence."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis import words
from feel321.analysis.agreement import SMALLEST
from feel321.analysis.contrasts.compare import (
    Equivalence,
    JointTest,
    compare_terms,
    equivalence,
    find_interval90,
    fit_reducers,
    non_inferiority,
    participant_means,
    profile_reducers,
)
from feel321.analysis.figures.estimates import draw_equivalence, draw_profiles
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report.parts import (
    ITEM,
    SIGNIFICANCE,
    RatingsPart,
    count_units,
    describe_reach,
    find_table_steps,
    format_p,
    join_steps,
    select_tests,
    split_arms,
    thin_parts,
    thin_rows,
)
from feel321.analysis.report.section import (
    DF,
    MEAN,
    NAME,
    P_HOLM,
    RATINGS,
    TEXT,
    Column,
    P,
    Picture,
    Section,
    TableForm,
    estimate,
    make_slug,
    read_methods,
)
from feel321.analysis.table.items import find_sources
from feel321.analysis.table.metrics import order_reducers
from feel321.analysis.table.schema import ANSWERED, PAIR, ROLES
from feel321.analysis.words import COUNT, Number

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.metrics import Step
    from feel321.analysis.table.reading import Table

Row = dict[Any, Any]

# Ratings per reducer: means, their intervals over participants, hidden reference and anchors beside them.

PROFILE = TableForm(
    "Mean rating per reducer in points, with its 95 % t interval over participants: other people, these recordings. "
    "Roles: what was tested, hidden references and anchors.",
    (
        RATINGS, Column("Role", "role", NAME), Column("Reducer", "reducer", NAME), MEAN,
        Column("Participants", "n_participants", COUNT, "n_participants"),
        Column("Stimuli", "n_stimuli", COUNT, "n_stimuli"), Column("Judgements", "n_ratings", COUNT, "n_ratings"),
    ),
    path="profile.{scale}.{level}.{role}.{reducer}", n="n_ratings",
)  # fmt: skip


def compute_profile(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer."""
    single = table.rows[table.rows["role"] != PAIR]
    profile, people = profile_reducers(single), participant_means(single)
    key, title = "reducers", "Ratings per reducer"
    if profile.empty:
        why = "Only pairs of two test stimuli were rated: no ratings per reducer."
        return Section(key, title, notes=(why,))
    order, scales = order_reducers(profile["reducer"]), list(single["scale"].unique())
    rows = sorted(
        ({**row, "_ratings": f"{row['scale']}, {row['level']}"} for row in profile.to_dict("records")),
        key=lambda row: (
            scales.index(row["scale"]), row["level"], ROLES.index(row["role"]), order.index(row["reducer"]),
        ),
    )  # fmt: skip
    return Section(
        key=key,
        title=title,
        grids=(PROFILE.build(rows),),
        tables={"profiles": profile, "participants": people},
        pictures=tuple(_picture_profiles(table.rows, profile, people)),
        how=read_methods(key),
    )


def _picture_profiles(
    ratings: DataFrame, profile: DataFrame, people: DataFrame
) -> Iterator[Picture]:
    """Show every scale and level in one figure."""
    looks = assign_looks(order_reducers(ratings["reducer"]))
    arms = [(scale, level) for scale, level, _ in split_arms(ratings[ratings["role"] == ROLES[0]])]
    parts = [
        (_choose(profile, scale, level), _choose(people, scale, level)) for scale, level in arms
    ]
    if parts:
        draw = partial(draw_profiles, parts, looks=looks)
        yield Picture("profile", _caption_profiles(arms, [rows for rows, _ in parts]), draw)


def _choose(frame: DataFrame, scale: str, level: str) -> DataFrame:
    return frame[(frame["scale"] == scale) & (frame["level"] == level)]


def _caption_profiles(arms: Sequence[tuple[str, str]], profiles: Sequence[DataFrame]) -> str:
    several = len({level for _, level in arms}) > 1
    names = [
        words.format_name(scale) + f" ({words.format_name(level)})" * several
        for scale, level in arms
    ]
    measures = dict.fromkeys(words.MEASURES.get(scale, "rating") for scale, _ in arms)
    caption = f"Mean {' or '.join(measures)} per reducer: {words.join_words(names)}"
    if max(rows["n_participants"].max() for rows in profiles) < SMALLEST:
        caption += "; one participant each, so no intervals."
    else:
        caption += ", with 95 % t intervals over participants: other people, these recordings."
    caption += " Grey: each participant's mean."
    if ANSWERED in dict(arms):
        caption += f" Guessing gives 50{' in ABX' * (len(dict(arms)) > 1)}."
    # A manifest may have any of these roles, or none.
    roles = {"reference": "the hidden reference", "anchor": "anchors"}
    apart = [
        name
        for role, name in roles.items()
        if any((rows["role"] == role).any() for rows in profiles)
    ]
    return caption + (f" Below the dotted line: {' and '.join(apart)}." if apart else "")


# Level arms compared, for the question whether something felt good because it was strong.

KEY_LEVELS, TITLE_LEVELS = "levels", "Level arms compared"
LEVELS = TableForm(
    "First level minus second: in rating (points), and in the slope on each metric (points per +0.1). 95 % intervals; "
    "p adjusted over this table.",
    (
        Column("Ratings", "scale", TEXT), Column("First", "first", TEXT), Column("Second", "second", TEXT),
        Column("Of", "of", TEXT),
        estimate("Difference", "estimate", "mixed model, {_unit}, first level minus second"), DF, P, P_HOLM,
    ),
    path="level.{scale}.{first}.{second}.{of}", detail=False,
)  # fmt: skip


def compute_levels(table: Table, choices: Choices) -> Section:
    """Compare the levels at which stimuli were rated."""
    tests = select_tests(table)
    notes: list[str] = []
    found, steps = [], find_table_steps(table)
    if len(tests["level"].unique()) > 1:
        found = list(_compare_scales(tests, steps, choices=choices, notes=notes))
    adjusted = adjust_holm([row["p"] for row in found]) if found else []
    rows = [{**row, "p_holm": holm} for row, holm in zip(found, adjusted, strict=True)]
    return Section(
        key=KEY_LEVELS,
        title=TITLE_LEVELS,
        answers=tuple(map(_describe_levels, rows)),
        grids=(LEVELS.build(rows, caption=LEVELS.caption.replace("+0.1", join_steps(steps))),),
        tables={"levels": rows},
        notes=notes,
        how=read_methods(KEY_LEVELS),
    )


def _compare_scales(
    tests: DataFrame, steps: Mapping[str, Step], *, choices: Choices, notes: list[str]
) -> Iterator[Row]:
    tests = tests.assign(**{ITEM: tests["stimulus_id"]})
    for name, rows in tests.groupby("scale", observed=True, sort=False):
        rng = choices.make_rng(KEY_LEVELS, scale := str(name))
        part, thinned = thin_rows(rows, n_slopes=len(steps), rng=rng)
        notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        more = {"scale": scale, "_reach": count_units(part)}
        try:
            yield from [more | row for row in _compare_levels(part, steps)]
        except ValueError as error:
            notes.append(f"{scale}: levels are not compared. {error}")


def _compare_levels(part: DataFrame, steps: Mapping[str, Step]) -> Iterator[Row]:
    levels = sorted(part["level"].unique())
    if len(levels) == 1:
        raise ValueError(f"All were rated at one level, '{levels[0]}'.")
    codes = {level: f"c{number}" for number, level in enumerate(levels)}
    cells = _gather_arms(part, tuple(steps))
    used = [name for name in steps if cells[f"{name}_w"].std() > 0]
    sizes = {name: len(cells[name].unique()) for name in ("participant", "recording", "source")}
    groups = ["participant", "participant:arm"] * (sizes["participant"] > 1)
    groups += ["recording"] * (sizes["recording"] > 1) + ["base"]
    groups += [ITEM] * (len(cells[ITEM].unique()) < len(cells))
    if sizes["source"] < sizes["recording"]:
        # What recordings of one source share: as a whole, of what was reduced alike, and of that at one level.
        groups += ["source"] * (sizes["source"] > 1) + ["source:reducer", "source:reducer:level"]
    terms = [*(f"arm:`{name}_w`" for name in used), *(f"(1 | {group})" for group in groups)]
    formula = " + ".join(["rating ~ 0 + arm", *terms])
    fit = fit_mixed(formula, cells.assign(arm=cells["level"].map(codes)))
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        wanted = {"rating": {one: 1.0, two: -1.0}}
        wanted |= {
            name: {f"{one}:{name}_w": steps[name].size, f"{two}:{name}_w": -steps[name].size}
            for name in used
        }
        for what, weights in wanted.items():
            unit = "points of rating"
            unit = unit if what == "rating" else f"points per {steps[what].per} of the metric"
            pair = {"first": first, "second": second, "n": len(cells), "of": what, "_unit": unit}
            yield pair | asdict(contrast(fit, weights))


def _gather_arms(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    import pandas as pd

    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        cells = make_cells(arm, metrics).table.groupby(
            ["participant", "recording", ITEM], observed=True
        )
        means = cells.mean(numeric_only=True).reset_index()
        reducers = means[ITEM].map(arm.drop_duplicates(ITEM).set_index(ITEM)["reducer"])
        base, source = means["recording"] + "/" + reducers, means["recording"].map(sources)
        tables.append(means.assign(level=level, reducer=reducers, base=base, source=source))
    return pd.concat(tables, ignore_index=True)


def _describe_levels(row: Row) -> str:
    what, metric = f"{words.format_name(row['scale'])} ratings", words.format_name(row["of"])
    first, second = words.format_name(row["first"]), words.format_name(row["second"])
    value, interval = words.format_estimate(row["estimate"], row["low"], row["high"], kind="slope")
    found = f"{value} points, 95 % CI {interval}; {format_p(row['p_holm'])}"
    decided, more = row["p_holm"] < SIGNIFICANCE, row["estimate"] > 0
    if not decided and row["of"] == "rating":
        return f"It is unclear whether {what} differ between {first} and {second} ({found})."
    if not decided:
        differs = f"the effect of {metric} on {what} differs between {first} and {second}"
        return f"It is unclear whether {differs} (difference of slopes {found})."
    reach = describe_reach(row["_reach"])
    if row["of"] == "rating":
        way = "higher" if more else "lower"
        return f"{words.capitalise(what)} are {way} at {first} than at {second} ({found}){reach}."
    size = "larger" if more else "smaller"
    slope = f"the slope on {metric} is {size} at {first} than at {second}"
    return f"For {what} {slope} ({found}){reach}."


# Reducers against each other: differences, equivalence, non-inferiority of the simpler one.

REDUCER = "reducer"
CONTRASTS = TableForm(
    "{}: difference of the first reducer from the second in points, from the mixed model, with 95 % intervals for "
    "{}; p adjusted over {} pairs.",
    (
        Column("First", "first", NAME), Column("Second", "second", NAME),
        estimate("Difference", "estimate", "mixed model, points of rating, first minus second", kind="rating"),
        DF, P, P_HOLM,
    ),
    path="contrast.{scale}.{level}.{first}.{second}",
)  # fmt: skip
TESTED = replace(
    CONTRASTS,
    columns=(
        *CONTRASTS.columns,
        Column("Equivalence p", "p_equivalence", "p", "p_equivalence", "equivalence"),
        Column("Equivalent", "_equivalent", NAME),
        Column("Non-inferiority p", "p_non_inferiority", "p", "p_non_inferiority", "non-inferiority"),
        Column("First not worse", "_not_worse", NAME),
    ),
)  # fmt: skip
"""The same where a margin was chosen: a difference within it does not matter."""


class _Pair(NamedTuple):
    """Two reducers, their difference, and the test of their equivalence."""

    row: Row
    test: Equivalence | None


TOGETHER = TableForm(
    "Do reducers differ at all? F test of all reducers at once in the mixed model, with Satterthwaite's degrees of "
    "freedom.",
    (
        RATINGS, Column("F", "statistic", end="statistic", method="mixed model, F of all reducers"),
        Column("df", "df_1", "df", "df_1", "degrees of freedom of the effect"),
        Column("df of error", "df_2", "df", "df_2", "degrees of freedom of the error"),
        Column("p", "p", "p", "p", "F test"), Column("Participants", "n_participants", COUNT, "n_participants"),
    ),
    path="contrasts.{scale}.{level}", n="n_participants",
)  # fmt: skip


def compute_contrasts(table: Table, choices: Choices) -> Section:
    """Compare every two reducers on every scale and level."""
    answers, notes, grids, rows = [], [], [], []
    together: list[Row] = []
    numbers: list[Number] = []
    pictures: list[Picture] = []
    # A person's reducers are so many effects.
    for part in thin_parts(table, choices, n_slopes=table.rows[REDUCER].nunique(), matched=False):
        notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        try:
            pairs, joint = _compare_reducers(part.rows, choices.margin)
        except ValueError as error:
            notes.append(f"{part.lead}: reducers are not compared. {error}")
            continue
        own = [_word_tests(part.keys | pair.row) for pair in pairs]
        form = CONTRASTS if choices.margin is None else TESTED
        grids.append(form.build(own, caption=_caption_contrasts(part, choices.margin, len(pairs))))
        numbers += _list_numbers(part, pairs)
        answers.append(_describe_contrasts(pairs, part))
        rows += own
        pictures += _picture_equivalence(pairs, part)
        people = part.rows["participant"].nunique()
        together.append(part.keys | joint._asdict() | {"n_participants": people})
    return Section(
        "contrasts",
        "Reducers against each other",
        answers=answers,
        grids=[*grids, TOGETHER.build(together)],
        unseen=numbers,
        tables={"contrasts": rows, "reducers_together": together},
        pictures=pictures,
        notes=notes,
        how=read_methods("contrasts"),
    )


def _list_numbers(part: RatingsPart, pairs: list[_Pair]) -> Iterator[Number]:
    for what, count in {"n_differ": _count_different(pairs), "n_pairs": len(pairs)}.items():
        name = words.name_path("contrasts", *part.place, what)
        yield words.count_number(name, count, n=len(pairs), keys="scale level")


def _compare_reducers(rows: DataFrame, margin: float | None) -> tuple[list[_Pair], JointTest]:
    names = order_reducers(rows[REDUCER])
    if len(names) == 1:
        raise ValueError(f"Only one was rated, '{names[0]}'.")
    fit, terms, n = fit_reducers(rows, names)
    found: list[Row] = [
        {"first": one, "second": two} | asdict(contrast(fit, {terms[one]: 1, terms[two]: -1}))
        for one, two in combinations(names, 2)
    ]
    adjusted = adjust_holm([row["p"] for row in found])
    pairs = [
        _test(row | {"p_holm": holm, "n": n}, margin)
        for row, holm in zip(found, adjusted, strict=True)
    ]
    return pairs, compare_terms(fit, list(terms.values()))


def _test(row: Row, margin: float | None) -> _Pair:
    numbers = row["estimate"], row["se"], row["df"]
    row |= dict(zip(("low90", "high90"), find_interval90(*numbers), strict=True))
    row |= {"p_equivalence": np.nan, "p_non_inferiority": np.nan, "margin": margin}
    if margin is None or not 0 < row["se"] < np.inf:
        return _Pair(row, None)
    test = equivalence(*numbers, low=-margin, high=margin)
    worse = non_inferiority(*numbers, margin=-margin)
    return _Pair(row | {"p_equivalence": test.p, "p_non_inferiority": worse.p}, test)


def _word_tests(row: Row) -> Row:
    def say(p: float) -> str:
        return "–" if np.isnan(p) else "yes" if p < SIGNIFICANCE else "not shown"

    equivalent, not_worse = say(row["p_equivalence"]), say(row["p_non_inferiority"])
    return row | {"_equivalent": equivalent, "_not_worse": not_worse}


def _caption_contrasts(part: RatingsPart, margin: float | None, n_pairs: int) -> str:
    several = [f"other {name}s" for name, count in count_units(part.rows).items() if count > 1]
    others = " and ".join(several).replace("participants", "people")
    differ = CONTRASTS.caption.format(words.capitalise(part.subject), others, n_pairs)
    if margin is None:
        return f"{differ} Equivalence is not tested: no margin was chosen."
    return (
        f"{differ} Margin of equivalence and non-inferiority, fixed beforehand: {margin:g} points."
    )


def _count_different(pairs: list[_Pair]) -> int:
    return sum(pair.row["p_holm"] < SIGNIFICANCE for pair in pairs)


def _describe_contrasts(pairs: list[_Pair], part: RatingsPart, most: int = 5) -> str:
    alike = [
        f"{pair.row['first']} and {pair.row['second']}"
        for pair in pairs
        if pair.test and pair.test.equivalent
    ]
    left = len(alike) - most
    more = f" and {left} more pair{'s' * (left > 1)}" if left > 0 else ""
    same = f"shown to be equivalent: {'; '.join(alike[:most])}{more}"
    if not alike:
        tested = any(pair.test for pair in pairs)
        same = "none is shown to be equivalent" if tested else "equivalence is not tested"
    differ = _count_different(pairs)
    reach = describe_reach(count_units(part.rows), claimed=bool(alike) or differ > 0)
    told = f"{differ} of {len(pairs)} pairs of reducers differ after Holm's adjustment"
    return f"{words.capitalise(part.subject)}: {told}; {same}{reach}."


def _picture_equivalence(pairs: list[_Pair], part: RatingsPart) -> Iterator[Picture]:
    tests = {
        f"{pair.row['first']} − {pair.row['second']}": pair.test for pair in pairs if pair.test
    }
    if not tests:
        return
    scenes = find_sources(part.rows)
    caption = (
        f"Differences between reducers in {part.ratings} with 90 % intervals; shaded: the margin of "
        "equivalence. Filled: equivalence is shown."
    )
    slug = make_slug("equivalence", *part.place)
    draw = partial(
        draw_equivalence,
        tests,
        n_participants=part.rows["participant"].nunique(),
        n_recordings=len(scenes),
        n_sources=scenes.nunique(),
    )
    yield Picture(slug, caption, draw, detail=True)
