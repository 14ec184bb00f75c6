"""Sections about reducers: profile of mean ratings, levels compared, contrasts and equivalence."""

from __future__ import annotations

from dataclasses import asdict
from itertools import combinations
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from feel321.analysis.contrasts.equivalence import (
    GROUP,
    equivalence,
    non_inferiority,
    participant_means,
    profile_reducers,
)
from feel321.analysis.figures.estimates import draw_equivalence
from feel321.analysis.figures.style import assign_looks
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.influence import adjust
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report._old import (
    INTERVAL,
    PROFILES,
    Cell,
    Grid,
    lay_estimate,
    name_estimate,
    name_mean,
    name_tests,
    tell_estimate,
)
from feel321.analysis.report.parts import (
    ITEM,
    SIGNIFICANCE,
    count_units,
    find_repeat_sd,
    tell_p,
    tell_reach,
    thin_parts,
    thin_rows,
)
from feel321.analysis.report.pictures import picture_profiles
from feel321.analysis.report.section import Picture, Section, make_slug
from feel321.analysis.table.items import find_sources
from feel321.analysis.table.judgements import ROLES
from feel321.analysis.table.reading import order_reducers
from feel321.analysis.table.sheet import APART, PAIR
from feel321.analysis.words import COUNT, count_number, make_number, name_path, start, tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping

    from pandas import DataFrame

    from feel321.analysis.contrasts.equivalence import Equivalence
    from feel321.analysis.report.parts import Choices
    from feel321.analysis.report.parts import RatingsPart as Part
    from feel321.analysis.table.reading import Table

    ProfileRow = Mapping[Hashable, Any]
    Row = dict[Hashable, Any]

# Ratings per reducer: means, their intervals over participants, hidden reference and anchors beside them.


def compute_profile(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer."""
    single = table.rows[table.rows["role"] != PAIR]
    profile, people = profile_reducers(single), participant_means(single)
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    title = "Ratings per reducer"
    if profile.empty:
        return Section(
            "reducers",
            title,
            notes=("Only pairs of two test stimuli were rated: no ratings per reducer.",),
        )
    caption = (
        "Mean rating per reducer in points, with its 95 % t interval over participants: other people, these "
        "recordings. Roles tell hidden references and anchors from what was tested."
    )
    head = (
        "Ratings",
        "Role",
        "Reducer",
        "Mean",
        "Interval",
        "Participants",
        "Stimuli",
        "Judgements",
    )
    return Section(
        key="reducers",
        title=title,
        grids=(Grid(caption, head, tuple(map(_lay_row, sort_profile(profile)))),),
        tables={"profiles": profile, "participants": people},
        pictures=tuple(picture_profiles(profile, people, looks=looks)),
        how=(PROFILES,),
    )


def sort_profile(profile: DataFrame) -> list[dict[Hashable, Any]]:
    """Put the rows of a profile into the figure's order."""
    order = order_reducers(profile["reducer"])

    def place(row: dict[Hashable, Any]) -> tuple[str, str, int, int]:
        return row["scale"], row["level"], ROLES.index(row["role"]), order.index(row["reducer"])

    return sorted(profile.to_dict("records"), key=place)


def _lay_row(row: ProfileRow) -> tuple[str | Cell, ...]:
    name = name_path("profile", *(row[key] for key in GROUP))
    mean = name_mean(name, row)
    counts = (
        count_number(f"{name}.{what}", row[what], n=row["n_ratings"])
        for what in ("n_participants", "n_stimuli", "n_ratings")
    )
    place = f"{tell_name(row['scale'])}, {tell_name(row['level'])}"
    shown = Cell(mean, "rating"), Cell(mean, "rating", part=INTERVAL)
    return (place, row["role"], row["reducer"], *shown, *(Cell(count, COUNT) for count in counts))


# Level arms compared, for the question whether something felt good because it was strong.

KEY_LEVELS, TITLE_LEVELS = "levels", "Level arms compared"
HOW_LEVELS = (
    "Level arms: a mixed model per scale of ratings on level, each metric within recordings, and their product, with "
    "spreads between participants, participants' levels, recordings, what was reduced how (shared by the arms), and "
    "stimuli (and, where several recordings come from one source, the same between sources). The difference in rating "
    "is at the mean of the metrics; the difference in slope says whether a metric "
    "counts for less once levels are equal. Satterthwaite's degrees of freedom; p adjusted by Holm.",
)


def compute_levels(table: Table, choices: Choices) -> Section:
    """Compare the levels at which stimuli were rated."""
    rows = table.rows
    tests = rows[(rows["role"] == "test") & ~rows["scale"].isin(APART)]
    tests = tests[tests["matched"]] if "matched" in tests else tests
    if len(tests["level"].unique()) < 2:  # noqa: PLR2004 - one arm has nothing to be compared with
        return Section(KEY_LEVELS, TITLE_LEVELS)
    notes: list[str] = []
    found = list(_compare_scales(tests, table.metrics, choices=choices, notes=notes))
    if not found:
        return Section(KEY_LEVELS, TITLE_LEVELS, notes=tuple(notes))
    adjusted = adjust([row["p"] for row in found])
    found = [{**row, "p_holm": holm} for row, holm in zip(found, adjusted, strict=True)]
    caption = (
        "First level minus second: in rating (points), and in the slope on each metric (points per +0.1). 95 % "
        "intervals; p adjusted over this table."
    )
    head = ("Ratings", "First", "Second", "Of", "Difference", "Interval", "df", "p", "p (Holm)")
    return Section(
        key=KEY_LEVELS,
        title=TITLE_LEVELS,
        answers=tuple(map(_judge_levels, found)),
        grids=(Grid(caption, head, tuple(map(_lay, found)), detail=False),),
        tables={"levels": _tabulate_levels(found)},
        notes=tuple(notes),
        how=HOW_LEVELS,
    )


def _compare_scales(
    tests: DataFrame, metrics: tuple[str, ...], *, choices: Choices, notes: list[str]
) -> Iterator[Row]:
    for name, rows in tests.assign(**{ITEM: tests["stimulus_id"]}).groupby("scale", observed=True):
        scale = str(name)
        part, thinned = thin_rows(
            rows, n_slopes=len(metrics), rng=choices.make_rng(KEY_LEVELS, scale)
        )
        notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        try:
            yield from [
                {"scale": scale, "reach": count_units(part), **row}
                for row in _compare_levels(part, metrics)
            ]
        except ValueError as error:
            notes.append(f"{scale}: levels are not compared. {error}")


def _tabulate_levels(found: list[Row]) -> DataFrame:
    import pandas as pd

    return pd.DataFrame(found).drop(columns="reach")


def _compare_levels(part: DataFrame, metrics: tuple[str, ...]) -> Iterator[Row]:
    levels = sorted(part["level"].unique())
    if len(levels) == 1:
        raise ValueError(f"All were rated at one level, '{levels[0]}'.")
    codes = {level: f"c{number}" for number, level in enumerate(levels)}
    cells = _gather(part, metrics)
    used = [name for name in metrics if cells[f"{name}_w"].std() > 0]
    slopes = [f"arm:`{name}_w`" for name in used]
    people = (
        ["(1 | participant)", "(1 | participant:arm)"]
        if len(part["participant"].unique()) > 1
        else []
    )
    scenes = ["(1 | recording)"] if len(part["recording"].unique()) > 1 else []
    groups = [*people, *scenes, "(1 | base)", *_item_term(cells), *_source_terms(cells)]
    formula = " + ".join(["rating ~ 0 + arm", *slopes, *groups])
    fit = fit_mixed(formula, cells.assign(arm=cells["level"].map(codes)))
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        pair: Row = {"first": first, "second": second, "n": len(cells)}
        wanted = {"rating": {one: 1.0, two: -1.0}}
        wanted |= {name: {f"{one}:{name}_w": 0.1, f"{two}:{name}_w": -0.1} for name in used}
        for what, weights in wanted.items():
            found: Row = dict(asdict(contrast(fit, weights)).items())
            yield pair | {"of": what} | found


def _item_term(cells: DataFrame) -> list[str]:
    return [f"(1 | {ITEM})"] if len(cells[ITEM].unique()) < len(cells) else []


def _source_terms(cells: DataFrame) -> list[str]:
    """Name what recordings of one source share: as a whole, of what was reduced alike, and of that at one level."""
    recordings, sources = (len(cells[name].unique()) for name in ("recording", "source"))
    if sources == recordings:
        return []
    whole = ["source"] if sources > 1 else []
    return [f"(1 | {group})" for group in (*whole, "source:reducer", "source:reducer:level")]


def _gather(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    import pandas as pd

    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        cells = make_cells(arm, metrics).table
        means = (
            cells
            .groupby(["participant", "recording", ITEM], observed=True)
            .mean(numeric_only=True)
            .reset_index()
        )
        reducers = means[ITEM].map(arm.drop_duplicates(ITEM).set_index(ITEM)["reducer"])
        places = {
            "base": means["recording"] + "/" + reducers,
            "source": means["recording"].map(sources),
        }
        tables.append(means.assign(level=level, reducer=reducers, **places))
    return pd.concat(tables, ignore_index=True)


def _lay(row: Row) -> tuple[str | Cell, ...]:
    name, n = name_path("level", row["scale"], row["first"], row["second"], row["of"]), row["n"]
    unit = "points of rating" if row["of"] == "rating" else "points per +0.1 of the metric"
    value = name_estimate(name, row, f"mixed model, {unit}, first level minus second", n=n)
    names = (
        tell_name(row["scale"]),
        tell_name(row["first"]),
        tell_name(row["second"]),
        tell_name(row["of"]),
    )
    return (
        *names,
        *lay_estimate(value, "slope"),
        *map(Cell, name_tests(name, row, n=n), ("df", "p", "p")),
    )


def _judge_levels(row: Row) -> str:
    what = f"{tell_name(row['scale'])} ratings"
    arms = f"at {tell_name(row['first'])} than at {tell_name(row['second'])}"
    value = name_estimate("", row, "", n=row["n"])
    evidence = f"({tell_estimate(value, kind='slope')}; {tell_p(row['p_holm'])})"
    decided, more = row["p_holm"] < SIGNIFICANCE, row["estimate"] > 0
    if row["of"] == "rating":
        if not decided:
            between = f"between {tell_name(row['first'])} and {tell_name(row['second'])}"
            return f"Whether {what} differ {between} is undecided {evidence}."
        return f"{start(what)} are {'higher' if more else 'lower'} {arms} {evidence}{tell_reach(row['reach'])}."
    metric = tell_name(row["of"])
    if not decided:
        return f"Whether {metric} counts otherwise for {what} {arms} is undecided (difference of slopes {evidence[1:]}."
    slope = f"the slope on {metric} is {'larger' if more else 'smaller'}"
    return f"For {what} {slope} {arms} {evidence}{tell_reach(row['reach'])}."


# Reducers against each other: differences, equivalence, non-inferiority of the simpler one.

KEY_CONTRASTS, TITLE_CONTRASTS = "contrasts", "Reducers against each other"
REDUCER = "reducer"
HOW_CONTRASTS = (
    "Reducers compared: a mixed model per scale and level of ratings on reducer, with spreads between participants, "
    "recordings, stimuli, participants' recordings and participants' reducers (and, where several recordings come from "
    "one source, between sources and sources' reducers); differences with Satterthwaite's "
    "degrees of freedom, p adjusted by Holm. Equivalence by two one-sided tests (Schuirmann 1987, doi "
    "10.1007/BF01068419): shown where the 90 % interval lies within the margin. Non-inferiority: the reducer named "
    "first, which is the simpler by the order of feel321's list, is not worse than the other by the margin or more "
    "(5 %, one-sided). Neither is adjusted for the number of pairs; no difference found is no proof of equivalence.",
)


class _Margin(NamedTuple):
    """The difference that does not matter, and where it comes from."""

    points: float
    source: str
    n: int


class _Pair(NamedTuple):
    """Two reducers and what tells them apart."""

    row: Row
    test: Equivalence | None


def compute_contrasts(table: Table, choices: Choices) -> Section:
    """Compare every two reducers on every scale and level."""
    answers, notes, grids, numbers = [], [], [], []
    tables: dict[str, DataFrame] = {}
    pictures: list[Picture] = []
    # A person's reducers are so many effects.
    for part in thin_parts(table, choices, n_slopes=table.rows[REDUCER].nunique(), matched=False):
        notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        margin = _find_margin(part, choices)
        try:
            pairs = _compare_contrasts(part.rows, margin)
        except ValueError as error:
            notes.append(f"{part.lead}: reducers are not compared. {error}")
            continue
        rows = [_lay_pair(pair, part) for pair in pairs]
        grids.append(Grid(_caption(part, margin, pairs), HEAD, tuple(rows)))
        numbers.append(
            make_number(name_path("margin", *part.place), margin.points, margin.source, n=margin.n)
        )
        notes += [] if margin.points > 0 else [f"{part.lead}: no equivalence. {margin.source}"]
        answers.append(_judge_contrasts(pairs, part))
        differ = count_number(
            name_path("contrasts", *part.place, "n_differ"), _count_different(pairs), n=len(pairs)
        )
        numbers += [
            differ,
            count_number(name_path("contrasts", *part.place, "n_pairs"), len(pairs), n=len(pairs)),
        ]
        tables[part.lead] = _tabulate_contrasts(pairs, part)
        pictures += _draw(pairs, part)
    return Section(
        key=KEY_CONTRASTS,
        title=TITLE_CONTRASTS,
        answers=tuple(answers),
        grids=tuple(grids),
        unseen=tuple(numbers),
        tables=_stack(tables),
        pictures=tuple(pictures),
        notes=tuple(notes),
        how=HOW_CONTRASTS if grids else (),
    )


HEAD = (
    "First", "Second", "Difference", "Interval", "df", "p", "p (Holm)", "Equivalence p", "Equivalent",
    "Non-inferiority p", "First not worse",
)  # fmt: skip


def _find_margin(part: Part, choices: Choices) -> _Margin:
    if choices.margin is not None:
        return _Margin(choices.margin, "margin fixed beforehand", len(part.rows))
    sd, n = find_repeat_sd(part.rows)
    if not n:
        return _Margin(
            float("nan"),
            "Nobody rated a stimulus twice, so there is no margin: fix `margin` (points).",
            n,
        )
    if not sd > 0:
        return _Margin(
            float("nan"), "All repeats are alike, so there is no margin: fix `margin` (points).", n
        )
    return _Margin(sd / 2, "half the standard deviation with which people repeat their ratings", n)


def _compare_contrasts(rows: DataFrame, margin: _Margin) -> list[_Pair]:
    names = order_reducers(rows[REDUCER])
    if len(names) == 1:
        raise ValueError(f"Only one was rated, '{names[0]}'.")
    codes = {name: f"c{number}" for number, name in enumerate(names)}
    cells = (
        rows
        .groupby(["participant", "recording", REDUCER, ITEM], observed=True)["rating"]
        .mean()
        .reset_index()
    )
    cells["source"] = cells["recording"].map(find_sources(rows))
    fit = fit_mixed(_plan(cells), cells.assign(which=cells[REDUCER].map(codes)))
    found: list[Row] = []
    for first, second in combinations(names, 2):
        weights = {f"which{codes[first]}": 1, f"which{codes[second]}": -1}
        estimate: Row = dict(asdict(contrast(fit, weights)).items())
        found.append({"first": first, "second": second} | estimate)
    adjusted = adjust([row["p"] for row in found])
    rows_of = [
        {**row, "p_holm": holm, "n": len(cells)} for row, holm in zip(found, adjusted, strict=True)
    ]
    return [_test(row, margin) for row in rows_of]


def _plan(cells: DataFrame) -> str:
    """Write the model; a spread that has one row per level is in the residual already."""
    groups = {
        "participant": ["participant"], "recording": ["recording"], ITEM: [ITEM],
        "participant:recording": ["participant", "recording"], "participant:which": ["participant", REDUCER],
        "source": ["source"], "source:which": ["source", REDUCER],
    }  # fmt: skip
    sizes = {name: len(cells.drop_duplicates(columns)) for name, columns in groups.items()}
    kept = [name for name, size in sizes.items() if 1 < size < len(cells)]
    if sizes["recording"] == 1:
        kept = [name for name in kept if name not in {ITEM, "participant:recording"}]
    if sizes["source"] in {1, sizes["recording"]}:
        kept = [name for name in kept if not name.startswith("source")]
    if sizes["participant"] == 1:
        kept = [name for name in kept if not name.startswith("participant")]
    if not kept:
        raise ValueError(
            "One participant and one recording leave nothing to judge a difference by."
        )
    return " + ".join(["rating ~ 0 + which", *(f"(1 | {name})" for name in kept)])


def _test(row: Row, margin: _Margin) -> _Pair:
    if not (margin.points > 0 and 0 < row["se"] < np.inf):
        return _Pair(
            row | {"p_equivalence": np.nan, "p_non_inferiority": np.nan, "margin": margin.points},
            None,
        )
    numbers = row["estimate"], row["se"], row["df"]
    test = equivalence(*numbers, low=-margin.points, high=margin.points)
    worse = non_inferiority(*numbers, margin=-margin.points)
    return _Pair(
        row | {"p_equivalence": test.p, "p_non_inferiority": worse.p, "margin": margin.points}, test
    )


def _lay_pair(pair: _Pair, part: Part) -> tuple[str | Cell, ...]:
    row = pair.row
    name, n = name_path("contrast", *part.place, row["first"], row["second"]), row["n"]
    value = name_estimate(name, row, "mixed model, points of rating, first minus second", n=n)
    df, p, holm = name_tests(name, row, n=n)
    return (
        row["first"], row["second"], *lay_estimate(value, "rating"), Cell(df, "df"), Cell(p, "p"), Cell(holm, "p"),
        *_lay_test(name, row, "equivalence"), *_lay_test(name, row, "non_inferiority"),
    )  # fmt: skip


def _lay_test(name: str, row: Row, test: str) -> tuple[Cell, str]:
    p = row[f"p_{test}"]
    said = "–" if np.isnan(p) else "yes" if p < SIGNIFICANCE else "not shown"
    return Cell(make_number(f"{name}.p_{test}", p, test.replace("_", "-"), n=row["n"]), "p"), said


def _caption(part: Part, margin: _Margin, pairs: list[_Pair]) -> str:
    differ = (
        f"{start(part.subject)}: difference of the first reducer from the second in points, from the mixed model, with "
        f"95 % intervals for {_tell_others(part)}; p adjusted over {len(pairs)} pairs."
    )
    if not margin.points > 0:
        return f"{differ} {margin.source}"
    return f"{differ} Margin of equivalence and non-inferiority: {margin.points:.1f} points ({margin.source})."


def _tell_others(part: Part) -> str:
    """Say for whom and what else intervals hold."""
    several = [f"other {name}s" for name, count in count_units(part.rows).items() if count > 1]
    return " and ".join(several).replace("participants", "people")


def _count_different(pairs: list[_Pair]) -> int:
    return sum(pair.row["p_holm"] < SIGNIFICANCE for pair in pairs)


def _judge_contrasts(pairs: list[_Pair], part: Part) -> str:
    alike = [
        f"{pair.row['first']} and {pair.row['second']}"
        for pair in pairs
        if pair.test and pair.test.equivalent
    ]
    told = f"{_count_different(pairs)} of {len(pairs)} pairs of reducers differ after Holm's adjustment"
    tested = (
        "none is shown to be equivalent"
        if any(pair.test for pair in pairs)
        else "equivalence is not tested"
    )
    same = f"shown to be equivalent: {_list(alike)}" if alike else tested
    reach = tell_reach(count_units(part.rows), claimed=bool(alike) or _count_different(pairs) > 0)
    return f"{start(part.subject)}: {told}; {same}{reach}."


def _list(names: list[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more pairs" if len(names) > most else ""
    return "; ".join(names[:most]) + more


def _tabulate_contrasts(pairs: list[_Pair], part: Part) -> DataFrame:
    import pandas as pd

    return pd.DataFrame([{"scale": part.scale, "level": part.level, **pair.row} for pair in pairs])


def _stack(tables: dict[str, DataFrame]) -> dict[str, DataFrame]:
    import pandas as pd

    return {"contrasts": pd.concat(tables.values(), ignore_index=True)} if tables else {}


def _draw(pairs: list[_Pair], part: Part) -> Iterator[Picture]:
    tests = {
        f"{pair.row['first']} − {pair.row['second']}": pair.test for pair in pairs if pair.test
    }
    if not tests:
        return
    people, scenes = len(part.rows["participant"].unique()), find_sources(part.rows)
    caption = (
        f"Differences between reducers in {part.ratings} with 90 % intervals; shaded: the margin of "
        "equivalence. Filled: equivalence is shown."
    )
    figure = draw_equivalence(
        tests, n_participants=people, n_recordings=len(scenes), n_sources=scenes.nunique()
    )
    yield Picture(make_slug("equivalence", *part.place), caption, figure, detail=True)
