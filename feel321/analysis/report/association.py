"""Sections: correlations of mean ratings with metrics over all stimuli, and with further metrics, explored.

They pool all stimuli, those of different recordings too. The claim of a study is about stimuli of the same recording
and is made in `feel321.analysis.report.answer`; correlations are beside it, for comparison with the literature. What is
said of them is never stronger than the numbers.
"""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from feel321.analysis import words
from feel321.analysis.agreement import SMALLEST
from feel321.analysis.association.correlate import (
    Association,
    Difference,
    Panel,
    correlate_items,
    make_panel,
)
from feel321.analysis.figures.scatter import (
    CUT,
    count_clipped,
    draw_mapping,
    draw_scatter,
    draw_scatters,
)
from feel321.analysis.figures.style import Look, assign_looks
from feel321.analysis.primary.sensitivity import NOT_ESTIMABLE, OPEN, PREDICTS
from feel321.analysis.report import explore
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.section import (
    INTERVAL,
    MEAN,
    METRIC,
    NAME,
    RATINGS,
    TEXT,
    Column,
    PageTable,
    Picture,
    Section,
    TableForm,
    make_slug,
    read_methods,
    stack,
)
from feel321.analysis.resampling import Choices
from feel321.analysis.standard import p1401
from feel321.analysis.table.items import make_items
from feel321.analysis.table.metrics import describe_explored, order_reducers
from feel321.analysis.table.notes import SPACE, note_apart
from feel321.analysis.table.reading import Table
from feel321.analysis.table.schema import APART, CHOSEN, PAIRED, RECAST
from feel321.analysis.words import COUNT, ONE_WAY, TWO_WAY, Claim, Line
from feel321.types import MetricInfo

Row = dict[str, Any]

LEADING, RANKED = "pearson", "spearman"
DRAWN = "within"
"""The correlation that cards and scatters give: the primary model is about differences within recordings, too."""

"""The method that is shown first, and the one it is checked against."""

MAPPED = 3
"""Order of the mapping that is drawn: P.1401's monotone cubic."""

CORRELATION = "{method} correlation of mean ratings of test stimuli with {metric}"
METHOD = Column("Method", "_kind", NAME)
CEILING = Column("Noise ceiling", "ceiling", end="ceiling", method="sqrt(ICC(C,k)), k participants")
SHARE = Column("r / ceiling", "disattenuated", end="disattenuated", method="correlation / ceiling")
COUNTS = (
    Column("Stimuli", "n_items", COUNT, "n_items"), Column("Participants", "n_participants", COUNT, "n_participants"),
    Column("Recordings", "n_recordings", COUNT, "n_recordings"), Column("Sources", "n_sources", COUNT, "n_sources"),
)  # fmt: skip
ASSOCIATIONS = TableForm(
    "Correlation of mean ratings with each metric over test stimuli. Draw conclusions from the two-way interval (other "
    "people and other recordings); the interval over participants only treats these stimuli as the only ones. All "
    "intervals are 95 % intervals.",
    (
        RATINGS, METRIC, METHOD,
        Column("r", "value", method=CORRELATION, interval=TWO_WAY, head_interval="Two-way interval"),
        Column(
            "Participants only", "value", end="participants_only", method=CORRELATION, interval=ONE_WAY,
            ends="participants_", show=INTERVAL,
        ),
        CEILING, SHARE, *COUNTS, Column("Draws", "draws", COUNT, "draws", n="draws"),
        Column("", "n_missing", COUNT, "n_missing"),
    ),
    path="association.{scale}.{level}.{metric}.{method}", n="n_items",
)  # fmt: skip
DIFFERENCE = "{method} correlation with {first} minus that with {second}"
DIFFERENCES = TableForm(
    "Correlation with the first metric minus correlation with the second; where lower is better, the sign of a "
    "correlation is reversed first. If an interval covers zero, the data do not show which metric predicts better. All "
    "intervals are 95 % intervals.",
    (
        RATINGS, Column("First", "first", TEXT), Column("Second", "second", TEXT), METHOD,
        Column("Difference of r", "value", method=DIFFERENCE, interval=TWO_WAY, head_interval="Two-way interval"),
        Column(
            "Difference of Fisher’s z", "z_value", end="z", method=f"{DIFFERENCE}, as a difference of Fisher's z",
            interval=f"{TWO_WAY}, on Fisher's z", ends="z_", head_interval="Two-way interval",
        ),
        *(
            Column("", f"{one}_value", end=f"{one}_value", method=f"{{method}} correlation with {{{one}}}")
            for one in ("first", "second")
        ),
        Column("", "draws", COUNT, "draws", n="draws"), Column("", "n_missing", COUNT, "n_missing"),
        *(Column("", count.key, COUNT, count.key) for count in COUNTS),
    ),
    path="difference.{scale}.{level}.{first}.{second}.{method}", n="n_items",
)  # fmt: skip
TURNED = TableForm(
    "Dissimilarities from the original, both ways: the correlation with 100 less the dissimilarity, as above, and with "
    "the dissimilarity itself. 95 % two-way intervals.",
    (
        Column("Level", "level", TEXT), METRIC, METHOD,
        Column("r of similarity", "value", "correlation", method=CORRELATION, interval=TWO_WAY),
        Column(
            "r of dissimilarity", "turned", end="dissimilarity", method="the same with the dissimilarity itself",
            interval=TWO_WAY, ends="turned_",
        ),
    ),
    path="recast.{level}.{metric}.{method}", n="n_items",
)  # fmt: skip
EDGES = TableForm(
    "What a scatter cannot show in its place.",
    (
        Column("", "n_below_edge", COUNT, "n_below_edge"),
        Column("", "lowest", end="lowest", method="smallest {metric} of the test stimuli"),
    ),
    path="scatter.{scale}.{level}.{metric}",
)
MEANS = TableForm("Every stimulus.", (MEAN,), path="stimulus.{scale}.{level}.{stimulus_id}")
MAPPINGS = TableForm(
    "Coefficients of the mappings that are drawn.",
    (Column("", "value", method="P.1401 mapping of order {order}: points per {metric} to the power {power}"),),
    path="mapping.{scale}.{level}.{metric}.{end}",
)  # fmt: skip
UNADJUSTED = "95 % intervals are not adjusted for their number."
UNANSWERED = (
    "These ratings do not show whether the metrics predict what people feel: on no scale were single test stimuli "
    "rated by themselves or against their recording. What was rated is in the profile; the reasons are under What was "
    "left out or assumed."
)


def compute_association(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric."""
    key, title = "metrics", "Correlations of mean ratings with metrics"
    parts, panels = list(split_parts(table)), []
    for part in parts:
        rng = choices.make_rng(key, *part.place)
        panels.append(
            make_panel(part.rows, table.metrics, draws=choices.draws, rng=rng, info=table.info)
        )
    notes = (*_note_roles(table), *_note_panels(panels))
    if not panels:
        paired = PAIRED in table.rows["scale"].unique()
        verdict = (Line(UNANSWERED), Line(SPACE)) if paired else (Line(UNANSWERED),)
        # Choices between two stimuli have an answer of their own.
        answered = table.rows["scale"].isin(CHOSEN).any()
        return Section(key, title, notes=notes, verdict=() if answered else verdict)
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    pictures, coefficients = list(_picture_scatters(panels, looks)), []
    for part, panel in zip(parts, panels, strict=True):
        leading = [one for one in panel.associations if one.method == LEADING]
        mapped = partial(_map_panel, looks=looks, info=table.info, level=_name_level(panel, panels))
        for picture, rows in mapped(part, panel, leading=leading):
            pictures.append(picture)
            coefficients += rows
    associations, differences = (
        _list_rows(panels, name) for name in ("associations", "differences")
    )
    return Section(
        key=key, title=title, answers=(*sum_up_panels(panels), UNADJUSTED), panels=tuple(panels),
        points=explore.write_points(panels, DRAWN, table.info),
        grids=(
            ASSOCIATIONS.build(associations), DIFFERENCES.build(differences), _turn_round(associations),
        ),
        unseen=(*_number_stimuli(panels), *MAPPINGS.build(coefficients).numbers),
        tables={
            "associations": associations, "differences": differences,
            "stimuli": stack(({}, panel.stimuli) for panel in panels),
        },
        # All scatters come first, as their numbers do.
        pictures=sorted(pictures, key=lambda picture: picture.detail),
        notes=notes, how=read_methods(key, draws=choices.draws),
    )  # fmt: skip


def _turn_round(associations: Sequence[Row]) -> PageTable:
    """Show correlations of recast dissimilarities beside those of the dissimilarities as they were given."""
    own = (row for row in associations if row["scale"] == RECAST)
    return TURNED.build(
        row | {"turned": -row["value"], "turned_low": -row["high"], "turned_high": -row["low"]}
        for row in own
    )


def _list_rows(panels: Sequence[Panel], name: str) -> list[Row]:
    return [
        {
            "scale": panel.scale, "level": panel.level, "_ratings": f"{panel.scale}, {panel.level}",
            "_kind": words.format_method(one.method), **asdict(one),
        }
        for panel in panels
        for one in getattr(panel, name)
    ]  # fmt: skip


def _number_stimuli(panels: Sequence[Panel]) -> Iterator[Any]:
    """Build numbers of every stimulus's mean, and of what a scatter cannot show in its place."""
    edges, means = [], []
    for panel in panels:
        place = {"scale": panel.scale, "level": panel.level}
        means += [place | row for row in panel.stimuli.to_dict("records")]
        for one in panel.associations:
            if one.method == LEADING:
                values = panel.stimuli[one.metric].to_numpy()
                clipped = count_clipped(panel.stimuli, one.metric)
                lowest = float(values.min())
                row = {"metric": one.metric, "n_below_edge": clipped, "lowest": lowest}
                edges.append(place | row | {"n": len(values)})
    yield from EDGES.build(edges).numbers
    yield from MEANS.build(means).numbers


def _map_panel(
    part: RatingsPart,
    panel: Panel,
    *,
    leading: Sequence[Association],
    looks: Mapping[str, Look],
    info: Mapping[str, MetricInfo],
    level: str = "",
) -> Iterator[tuple[Picture, list[Row]]]:
    """Map every metric to the ratings; what P.1401 refuses is noted beside its table."""
    for one in leading:
        with suppress(ValueError):
            items = make_items(part.rows, [one.metric])
            higher = info[one.metric].higher if one.metric in info else None
            judged = p1401(items.ratings.T, items.metrics[0], order=MAPPED, higher=higher)
            caption = (
                f"Mean {words.format_name(panel.scale)} rating of each test stimulus against its "
                f"{words.format_name(one.metric)}, recording by recording (level {words.format_name(panel.level)}), "
                "with the mapping of ITU-T P.1401 that was fitted to all of them. "
                f"{_describe_bars([panel])} Below: the correlation with its 95 % two-way "
                "interval, and the highest correlation that the noise in the ratings allows."
            )
            draw = partial(
                draw_mapping,
                panel.stimuli,
                judged,
                one,
                scale=panel.scale,
                looks=looks,
                level=level,
            )
            slug = make_slug("mapping", panel.scale, panel.level, one.metric)
            yield Picture(slug, caption, draw, detail=True), [
                {
                    "scale": panel.scale, "level": panel.level, "metric": one.metric, "order": judged.order,
                    "power": power, "end": f"coefficient_{power}", "value": value, "n": judged.n_items,
                }
                for power, value in enumerate(judged.coefficients)
            ]  # fmt: skip


def _picture_scatters(panels: Sequence[Panel], looks: Mapping[str, Look]) -> Iterator[Picture]:
    """Show the first scale's strongest metric at its full size, then every metric on every scale."""
    first = [one for one in panels[0].associations if one.method == DRAWN]
    strongest = max(first, key=lambda one: abs(one.value) if one.value == one.value else -1.0)
    panel, one = panels[0], strongest
    place = f"0-{first.index(one)}"
    level = _name_level(panel, panels)
    name, metric = words.format_name(panel.scale), words.format_name(one.metric)
    caption = (
        f"Mean {name} rating{words.format_level(level)} of each test stimulus against its {metric}. "
        "Names stand at the reducers' means. "
        f"{_describe_bars([panel])}{_describe_clipped([panel], [one.metric])}"
    )
    slug = make_slug("scatter", panel.scale, panel.level, one.metric)
    draw = partial(draw_scatter, panel, one, looks=looks, place=place, level=level)
    yield Picture(slug, caption, draw)
    metrics = [one.metric for one in first]
    if len(panels) * len(metrics) > 1:
        caption = (
            "Mean rating of each test stimulus against each metric, a row per scale"
            f"{' and level' * (len({panel.level for panel in panels}) > 1)}: "
            f"{words.join_words([_name_panel(panel, panels) for panel in panels])}. "
            f"{_describe_bars(panels)}"
            f"{_describe_clipped(panels, metrics)}"
        )
        yield Picture(
            "scatter", caption, partial(draw_scatters, panels, metrics, DRAWN, looks=looks)
        )


def _name_level(panel: Panel, panels: Sequence[Panel]) -> str:
    """Name a panel's level where there are several."""
    return panel.level if len({panel.level for panel in panels}) > 1 else ""


def _name_panel(panel: Panel, panels: Sequence[Panel]) -> str:
    return f"{words.format_name(panel.scale)}{words.format_level(_name_level(panel, panels))}"


def _describe_clipped(panels: Sequence[Panel], metrics: Sequence[str]) -> str:
    counts = {
        metric: sum(count_clipped(panel.stimuli, metric) for panel in panels)
        for metric in metrics if metric in panels[0].stimuli
    }  # fmt: skip
    told = [
        f"{count} with {words.format_name(metric)} below {words.format_number(CUT, kind='count')}"
        for metric, count in counts.items() if count
    ]  # fmt: skip
    return (
        f" Hollow markers at the left edge: {words.join_words(told)}; r uses their true values."
        if told
        else ""
    )


def _describe_bars(panels: Sequence[Panel]) -> str:
    counts = [int(count) for panel in panels for count in panel.stimuli["n_participants"]]
    if max(counts) < SMALLEST:
        return "One participant each, so no intervals."
    who = f"{words.format_span(counts)} participants who rated it"
    return f"Thin grey bars: 95 % t intervals over the {who}."


def _note_roles(table: Table) -> Iterator[str]:
    rows = table.rows
    yield from note_apart(rows)
    left_out = rows.loc[(rows["role"] != "test") & ~rows["scale"].isin(APART), "role"]
    for role, count in left_out.value_counts().sort_index().items():
        yield f"Associations leave out {count} judgements of stimuli with role '{role}'."


def _note_panels(panels: Iterable[Panel]) -> Iterator[str]:
    for panel in panels:
        lead = f"{panel.scale}, {panel.level}"
        notes = [
            (note, f"{words.format_method(one.method)} with {one.metric}")
            for one in panel.associations
            for note in one.notes
        ]
        notes += [
            (note, f"{words.format_method(two.method)} with {two.first} less {two.second}")
            for two in panel.differences
            for note in two.notes
        ]
        for note, names in _group(notes).items():
            whose = "" if len(names) >= len(panel.associations) else f" ({'; '.join(names)})"
            yield f"{lead}{whose}: {note}"


def _group(notes: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Collect what each note is about, so that it is said once."""
    told: dict[str, list[str]] = {}
    for note, name in notes:
        told.setdefault(note, []).append(name)
    return told


# What the correlations of each scale and level show, in words.


def sum_up_panels(panels: Sequence[Panel]) -> tuple[str, ...]:
    """Say what the correlations of each scale and level show: with each metric, the ceiling, and their difference."""
    several = len({panel.level for panel in panels}) > 1
    return tuple(_sum_up(panel, several=several) for panel in panels)


def _sum_up(panel: Panel, *, several: bool) -> str:
    leading = [result for result in panel.associations if result.method == LEADING]
    ranked = {result.metric: result for result in panel.associations if result.method == RANKED}
    found = "; ".join(_describe_correlation(result, ranked[result.metric]) for result in leading)
    known = not math.isnan(leading[0].ceiling)
    ceiling = f"; the noise ceiling is {words.format_number(leading[0].ceiling)}" if known else ""
    compared = "".join(
        f" {_describe_difference(two)}" for two in panel.differences if two.method == LEADING
    )
    subject = name_subject(panel, several=several)
    return f"{subject}, over all {leading[0].n_items} stimuli pooled: {found}{ceiling}.{compared}"


def _describe_correlation(result: Association, ranked: Association) -> str:
    name = words.format_name(result.metric)
    if math.isnan(result.value):
        why = result.notes[0].removeprefix("No correlation: ").removesuffix(".")
        return f"no correlation with {name} ({why})"
    r = f"r\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}{words.format_number(result.value)} with {name}"
    if math.isnan(result.low):
        return f"{r}, without an interval"
    covers = ", which covers zero" if _covers_zero(result) else ""
    # A few outlying values may hide what the ranks of all others show.
    contradicts = _covers_zero(result) != _covers_zero(ranked) or result.value * ranked.value < 0
    ranks = f"; by ranks {words.format_number(ranked.value)}, {words.format_interval(ranked.low, ranked.high)}"
    ranks = ranks if contradicts and not math.isnan(ranked.low) else ""
    return f"{r} (95 % two-way interval {words.format_interval(result.low, result.high)}{covers}{ranks})"


def _describe_difference(two: Difference) -> str:
    names = f"{words.format_name(two.first)} and {words.format_name(two.second)}"
    if math.isnan(two.low):
        return f"The correlations with {names} cannot be compared by an interval."
    zero = "covers zero" if _covers_zero(two) else "excludes zero"
    interval = f"{words.format_interval(two.low, two.high)}, which {zero}"
    return f"The correlations with {names} differ by {words.format_number(two.value)} ({interval})."


def _covers_zero(result: Association | Difference) -> bool:
    return result.low <= 0 <= result.high


# Where correlations over all stimuli pooled, another question, disagree with the primary model.


def name_subject(panel: Panel, *, several: bool) -> str:
    """Name what a panel's lines are listed under on the page."""
    return words.capitalise(
        words.format_name(panel.scale)
        + (f" (level {words.format_name(panel.level)})" if several else "")
    )


def reconcile(panel: Panel, claims: Sequence[Claim]) -> str:
    """Say where correlations over all stimuli pooled, another question, disagree with the primary model."""
    verdicts = {
        claim.metric: claim
        for claim in claims
        if (claim.scale, claim.level) == (panel.scale, panel.level)
        and claim.verdict != NOT_ESTIMABLE
    }
    told = [
        _contrast(one)
        for one in panel.associations
        if one.method == LEADING
        and one.metric in verdicts
        and _disagrees(one, verdicts[one.metric])
    ]
    told += [
        "{} correlates more (difference in r {}, 95 % CI {})".format(
            words.format_name(stronger), *words.format_estimate(two.value, two.low, two.high)
        )
        for two in panel.differences
        if two.method == LEADING
        and (stronger := _find_stronger(two))
        and {two.first, two.second} <= set(verdicts)
        and ({two.first, two.second} - {stronger}).isdisjoint(verdicts[stronger].better_than)
    ]
    if not told:
        return ""
    return (
        f"over all stimuli pooled, {'; '.join(told)}. That is another question: it also counts differences between "
        "recordings, and takes each metric alone."
    )


def _find_stronger(two: Difference) -> str:
    """Find which of two metrics correlates more strongly; empty where that is open."""
    if math.isnan(two.low) or _covers_zero(two):
        return ""
    return two.first if abs(two.first_value) > abs(two.second_value) else two.second


def _disagrees(one: Association, claim: Claim) -> bool:
    if math.isnan(one.low):
        return False
    if _covers_zero(one):
        return claim.verdict == PREDICTS
    return claim.verdict == OPEN or (claim.direction == "higher") != (one.value > 0)


def _contrast(one: Association) -> str:
    told, interval = words.format_estimate(one.value, one.low, one.high)
    zero = ", which covers zero" if _covers_zero(one) else ""
    metric = words.format_name(one.metric)
    return f"mean ratings correlate with {metric} at r = {told} (95 % CI {interval}{zero})"


# Further metrics, explored: rotation statistics, metrics of what was delivered, rotation-invariant counterparts.

METHODS = ("pearson", "spearman", "within")
FURTHER = TableForm(
    "Exploratory: correlation of mean ratings with metrics that the analysis was not planned for. They enter neither "
    "the mixed models nor the correction for multiple tests. Two-way intervals (other people and other recordings) are "
    "95 % intervals, not adjusted for their number: one of several may exclude zero by chance.",
    (
        RATINGS, METRIC, METHOD,
        Column(
            "r", "value", method=f"{CORRELATION}, exploratory", interval=TWO_WAY, head_interval="Two-way interval"
        ),
        CEILING, SHARE, *COUNTS, Column("Draws", "draws", COUNT, "draws"),
    ),
    path="further.{scale}.{level}.{metric}.{method}", n="n_items",
)  # fmt: skip


def compute_further(table: Table, choices: Choices) -> Section:
    """Correlate mean ratings of stimuli with every metric that the analysis was not planned for."""
    key, rows, notes = "further", [], []
    for part in split_parts(table):
        items = make_items(part.rows, table.further)
        own = []
        for row, metric in enumerate(table.further):
            alone = replace(items, metrics=items.metrics[[row]])
            for method in METHODS:
                rng = choices.make_rng(key, *part.place, metric, method)
                drawn = correlate_items(alone, (metric,), method, draws=choices.draws, rng=rng)
                own.append(drawn.associate(metric))
        rows += [
            part.keys | {"_kind": words.format_method(one.method)} | asdict(one) for one in own
        ]
        told = _group(
            (note, f"{words.format_method(one.method)} with {words.format_name(one.metric)}")
            for one in own
            for note in one.notes
        )
        for note, names in told.items():
            whose = "further metrics" if len(names) == len(own) else "; ".join(names)
            notes.append(f"{part.lead}, {whose}: {note}")
    known = describe_explored(table.metrics)
    meanings = "; ".join(
        f"{words.format_name(name)}: {known[name].meaning}" for name in table.further
    )
    return Section(
        key=key,
        title="Further metrics, explored",
        grids=(FURTHER.build(rows),),
        tables={"further_associations": rows},
        notes=notes,
        how=(f"Further metrics: {meanings}.",),
    )
