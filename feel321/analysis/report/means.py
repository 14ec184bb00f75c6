"""Sections on mean ratings: of stimuli, correlated with metrics; of reducers, compared with each other; of levels.

Correlations pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same
recording and is made in `feel321.analysis.report.primary`; correlations are beside it, to compare with the literature.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
from pandas import DataFrame

from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association import correlate_items, make_panel
from feel321.analysis.contrasts import compare
from feel321.analysis.figures import assign_looks, find_cut
from feel321.analysis.mixed.model import contrast, fit_mixed
from feel321.analysis.primary.model import FEW, adjust_holm
from feel321.analysis.primary.plan import make_cells
from feel321.analysis.report import section as parts
from feel321.analysis.report.section import Found, Row, read_ends
from feel321.analysis.table.columns import Step, order_reducers
from feel321.analysis.table.items import (
    Part,
    Table,
    find_sources,
    make_items,
    select_tests,
    split_arms,
    split_tests,
)
from feel321.analysis.table.reading import SPACE, note_apart
from feel321.analysis.table.schema import ANSWERED, APART, CHOSEN, PAIR, PAIRED, ROLES
from feel321.analysis.words import format_method, format_span

if TYPE_CHECKING:
    from feel321.analysis.resampling import Choices
    from feel321.records import Statistic

REDUCER, TEST = "reducer", ROLES[0]

# Stimuli: correlations of their mean ratings with metrics.

# The method that the words give, its counterpart by ranks, and the one that scatters and cards give
LEADING, RANKED, DRAWN = "pearson", "spearman", "within"


def compute_correlations(table: Table, choices: Choices) -> Found:
    """Correlate mean ratings of stimuli with every metric, those that the analysis was not planned for too."""
    found = Found(key="metrics", notes=list(note_apart(table.rows)))
    left_out = (table.rows["role"] != "test") & ~table.rows["scale"].isin(APART)
    for role, count in table.rows.loc[left_out, "role"].value_counts().sort_index().items():
        found.notes.append(f"Associations leave out {count} judgements of stimuli with role '{role}'.")  # fmt: skip
    panels: list[Statistic] = []
    told, draws = list[Row](), choices.draws
    for part in split_tests(table):
        rng = choices.make_rng("metrics", *part.place)
        panel = make_panel(part.rows, table.metrics, draws=draws, rng=rng, info=table.info)
        panels.append(panel)
        told.append(_describe_panel(part, panel))
        explored = []
        for metric in table.further:
            items = make_items(part.rows, [metric])
            for method in (LEADING, RANKED, DRAWN):
                rng = choices.make_rng("further", *part.place, metric, method)
                (one,) = correlate_items(items, (metric,), method, draws=draws, rng=rng)
                explored.append(one.associate(metric))
        found.add("associations", _write_rows(panel.associations), **part.keys)
        found.add("differences", _write_rows(panel.differences), **part.keys)
        found.add("stimuli", panel.stimuli, **part.keys)
        found.add("further_associations", _write_rows(explored), **part.keys)
        both = (*panel.associations, *panel.differences)
        found.notes += _gather_notes(both, part.lead, most=len(panel.associations))
        found.notes += _gather_notes(explored, f"{part.lead}, further metrics", most=len(explored))
    ranges: dict[str, list[float]] = {}
    for row in (row for panel in told for row in panel["found"]):
        if np.isfinite(row["r"]["value"]):
            ranges.setdefault(row["metric"], []).append(row["r"]["value"])
    scales = table.rows["scale"]
    # Choices between two stimuli have an answer of their own.
    alone = not panels and not scales.isin(CHOSEN).any()
    found.facts = {
        "panels": told, "alone": alone, "map": SPACE if alone and (scales == PAIRED).any() else "",
        "ranges": [{"metric": name, "low": min(r), "high": max(r)} for name, r in ranges.items()],
    }  # fmt: skip
    drawn = list(zip(panels, (one["subject"].lower() for one in told), strict=True))
    for slug, shown in parts.split_front("scatter", drawn):
        _draw(found, shown, table, slug=slug)
    return found


def _write_rows(every: Iterable[Statistic]) -> list[Row]:
    return [{**one, "method": format_method(one.method)} for one in every]


def _describe_panel(part: Part, panel: Statistic) -> Row:
    """Gather what the template says of the correlations of one scale and level."""
    leading = [one for one in panel.associations if one.method == LEADING]
    return {
        **part.keys, "subject": part.subject, "ceiling": leading[0].ceiling, "n_items": leading[0].n_items,
        "found": [
            {"metric": one.metric, "r": read_ends(one), "covers": one.low <= 0 <= one.high,
             "why": "".join(one.notes[:1]).removeprefix("No correlation: ").removesuffix(".")}
            for one in leading
        ],
    }  # fmt: skip


def _draw(found: Found, shown: Sequence[tuple[Statistic, str]], table: Table, *, slug: str) -> None:
    panels = [panel for panel, _ in shown]
    counts = [int(count) for panel in panels for count in panel.stimuli["n_participants"]]
    edges = {name: find_cut(name) for name in table.metrics}
    stimuli = pd.concat([panel.stimuli for panel in panels])
    cut = [(int((stimuli[name] < edge).sum()), name) for name, edge in edges.items()]
    says = {
        "subjects": [name for _, name in shown], "cut": [pair for pair in cut if pair[0]],
        "method": format_method(DRAWN), "people": format_span(counts) if max(counts) >= SMALLEST else "",
    }  # fmt: skip
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    options: Row = {"method": DRAWN, "looks": looks, "detail": slug != "scatter"}
    found.draw("scatter", slug, panels, list(table.metrics), says=says, **options)


def _gather_notes(found: Iterable[Any], lead: str, *, most: int) -> Iterator[str]:
    """Say each note once, with what it is about unless that is all of them."""
    told: dict[str, list[str]] = {}
    for one in found:
        of = one.metric if hasattr(one, "metric") else f"{one.first} less {one.second}"
        for note in one.notes:
            told.setdefault(note, []).append(f"{format_method(one.method)} with {of}")
    for note, names in told.items():
        which = "" if len(names) >= most else f" ({'; '.join(names)})"
        yield f"{lead}{which}: {note}"


# Ratings per reducer: means, their intervals over participants, hidden reference and anchors beside them.

WAYS = {
    PAIRED: ("least like the reference", "most like it"), ANSWERED: ("told apart most", "least"),
}  # fmt: skip


def compute_profile(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer."""
    found, single = Found(key="reducers"), table.rows[table.rows["role"] != PAIR]
    profile, people = compare.profile_reducers(single), compare.participant_means(single)
    if profile.empty:
        found.notes.append("Only pairs of two test stimuli were rated: no ratings per reducer.")
        return found
    ranks: Row = {"role": ROLES, REDUCER: order_reducers(profile[REDUCER])}
    ranks |= {"scale": list(single["scale"].unique()), "level": sorted(single["level"].unique())}
    keys = ["scale", "level", "role", REDUCER]
    listed = profile.sort_values(
        keys, key=lambda own: own.map(ranks[own.name].index), kind="stable"
    )
    found.add("profiles", listed)
    found.add("participants", people, n=1)
    drawn = []
    for part in split_arms(table.rows[table.rows["role"] == TEST]):
        own, whose = (
            frame[(frame["scale"] == part.scale) & (frame["level"] == part.level)]
            for frame in (profile, people)
        )
        drawn.append((part.subject, own, whose))
        found.tell(subject=part.subject, **describe_extremes(own))
    for slug, shown in parts.split_front("profile", drawn):
        roles = {role for _, rows, _ in shown for role in rows["role"]}
        apart = {"reference": "the hidden reference", "anchor": "anchors"}
        says = {
            "subjects": [subject for subject, _, _ in shown], "roles": [apart[role] for role in apart if role in roles],
            "alone": max(rows["n_participants"].max() for _, rows, _ in shown) < SMALLEST,
            "guessed": any((rows["scale"] == ANSWERED).any() for _, rows, _ in shown),
        }  # fmt: skip
        looks = assign_looks(order_reducers(table.rows[REDUCER]))
        found.draw("profile", slug, shown, looks, says=says, detail=slug != "profile")
    return found


def describe_extremes(profile: DataFrame) -> Row:
    """Find which reducers are at either end; clear: whether their intervals are apart."""
    tests = profile[profile["role"] == TEST]
    means = tests["mean"]
    if means.min() == means.max():
        return {"high": [], "low": [], "clear": False}
    high, low = (tests[means == end] for end in (means.max(), means.min()))
    known = not tests[["low", "high"]].isna().any(axis=None)
    return {
        "high": list(high[REDUCER]), "low": list(low[REDUCER]), "top": means.max(), "bottom": means.min(),
        "ways": WAYS.get(profile["scale"].iloc[0], ("highest", "lowest")),
        "clear": bool(known and high["low"].min() > low["high"].max()),
    }  # fmt: skip


# Reducers against each other: differences, equivalence, non-inferiority of the simpler one.


def compute_contrasts(table: Table, choices: Choices) -> Found:
    """Compare every two reducers on every scale and level."""
    found, margin = Found(key="contrasts"), choices.margin
    # A person's reducers are so many effects.
    n_slopes = table.rows[REDUCER].nunique()
    for part in parts.thin_parts(table, choices, n_slopes=n_slopes, matched=False):
        found.notes += [f"Reducers compared: {part.thinned}"] if part.thinned else []
        lead = f"{part.lead}: reducers are not compared."
        compared = found.attempt(lead, compare_all, part.rows, margin)
        if compared is None:
            continue
        pairs, joint = compared
        found.add("contrasts", pairs, **part.keys)
        frame = pd.DataFrame(pairs)
        differ = int((frame["p_holm"] < parts.SIGNIFICANCE).sum())
        sizes: Row = {"differ": differ, "n_pairs": len(pairs)}
        people = part.rows["participant"].nunique()
        found.add("reducers_together", [joint | sizes], n=people, **part.keys)
        same = frame.loc[frame["equivalent"], ["first", "second"]].to_numpy().tolist()
        hint = describe_hint(part.rows) if differ or same else []
        found.tell(subject=part.subject, same=same, margin=margin, hint=hint, **sizes)
    return found


def compare_all(rows: DataFrame, margin: float | None) -> tuple[list[Row], Row]:
    """Compare every two reducers of one scale and level, and all at once."""
    names = order_reducers(rows[REDUCER])
    if len(names) == 1:
        raise ValueError(f"Only one was rated, '{names[0]}'.")
    fit, terms, n = compare.fit_reducers(rows, names)
    pairs: list[Row] = []
    for one, two in combinations(names, 2):
        found: Row = {"first": one, "second": two, "n": n, "equivalent": False}
        found |= dict(contrast(fit, {terms[one]: 1, terms[two]: -1}))
        numbers = found["estimate"], found["se"], found["df"]
        low90, high90 = compare.find_interval90(*numbers)
        found |= {"low90": low90, "high90": high90, "p_equivalence": np.nan}
        if margin is not None and 0 < found["se"] < np.inf:
            test = compare.equivalence(*numbers, low=-margin, high=margin)
            worse = test.p_low  # Higher is better: not worse than the second by the margin.
            found |= {
                "p_equivalence": test.p, "equivalent": bool(test.equivalent), "p_not_worse": worse, "limit": low90,
                "told_equivalent": "yes" if test.equivalent else "not shown",
                "told_not_worse": "yes" if worse < parts.SIGNIFICANCE else "not shown",
            }  # fmt: skip
        pairs.append(found)
    for pair, holm in zip(pairs, adjust_holm([pair["p"] for pair in pairs]), strict=True):
        pair["p_holm"] = holm
    return pairs, dict(compare.compare_terms(fit, list(terms.values())))


def describe_hint(rows: DataFrame) -> list[str]:
    """List the units (participants, and recordings or their sources) so few of which make a finding a hint."""
    sources = find_sources(rows)
    scene = "recording" if sources.is_unique else "source"
    units = {"participant": rows["participant"].nunique(), scene: sources.nunique()}
    return parts.list_few(units, FEW)


# Level arms compared, for the question whether something felt good because it was strong.


def compute_levels(table: Table, choices: Choices) -> Found:
    """Compare the levels at which stimuli were rated."""
    found, tests = Found(key="levels"), select_tests(table)
    listed: list[Row] = []
    if len(tests["level"].unique()) <= 1:
        return found
    steps = parts.find_table_steps(table)
    for scale, rows in tests.groupby("scale", observed=True, sort=False):
        rng = choices.make_rng("levels", str(scale))
        part, thinned = parts.thin_rows(rows, n_slopes=len(steps), rng=rng)
        found.notes += [f"{scale}, levels compared: {thinned}"] if thinned else []
        lead = f"{scale}: levels are not compared."
        own: Row = {"scale": scale, "hint": describe_hint(part)}
        listed += [own | row for row in found.attempt(lead, _compare_levels, part, steps) or ()]
    for row, holm in zip(listed, adjust_holm([row["p"] for row in listed]), strict=True):
        row |= {"p_holm": holm, "decided": holm < parts.SIGNIFICANCE}
    found.add("levels", listed)
    found.facts["found"] = listed
    return found


def _compare_levels(part: DataFrame, steps: Mapping[str, Step]) -> list[Row]:
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
    fit, found = fit_mixed(formula, cells.assign(arm=cells["level"].map(codes))), []
    for first, second in combinations(levels, 2):
        one, two = f"arm{codes[first]}", f"arm{codes[second]}"
        wanted = {"rating": (one, two, 1.0, "points of rating")}
        for name in used:
            unit = f"points per {steps[name].per} of the metric"
            wanted[name] = f"{one}:{name}_w", f"{two}:{name}_w", steps[name].size, unit
        for what, (higher, lower, size, unit) in wanted.items():
            pair = {"first_level": first, "second_level": second, "n": len(cells)}
            difference = contrast(fit, {higher: size, lower: -size})
            found.append(pair | {"of": what, "unit": unit} | dict(difference))
    return found


def _gather_arms(part: DataFrame, metrics: tuple[str, ...]) -> DataFrame:
    """Average repeats, and centre each metric within recording and level."""
    tables, sources = [], find_sources(part)
    for level, arm in part.groupby("level", observed=True):
        keys = ["participant", "recording", "item"]
        cells = make_cells(arm, metrics).table.groupby(keys, observed=True)
        means = cells.mean(numeric_only=True).reset_index()
        means = means.astype(dict.fromkeys(keys, object))
        reducers = means["item"].map(arm.drop_duplicates("item").set_index("item")[REDUCER])
        base, source = means["recording"] + "/" + reducers, means["recording"].map(sources)
        tables.append(means.assign(level=level, reducer=reducers, base=base, source=source))
    return pd.concat(tables, ignore_index=True)
