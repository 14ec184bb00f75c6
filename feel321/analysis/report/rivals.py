"""Section: which of all metrics predicts best, out of fold and corrected for how many were tried."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.association.rivals import (
    BASELINES,
    FEWEST_REDUCERS,
    LEVEL,
    Ranking,
    rank_metrics,
)
from feel321.analysis.figures.estimates import draw_ranking
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    RATINGS,
    Column,
    Picture,
    Section,
    TableForm,
    make_slug,
    read_methods,
)
from feel321.analysis.table.items import format_recordings
from feel321.analysis.words import COUNT, Line

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.figure import Figure

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

KEY, TITLE = "rivals", "Which metric predicts best?"
AMPLITUDE, STRENGTH = "rms_m_s2", "level_as_played"
NAMED = 3
"""How many metrics a sentence names before it only counts."""

JOINT = "simultaneous 95 % interval, for other participants, recordings and reducers"
PICKING = "95 % bootstrap interval, over participants, recordings and reducers"
OUT_OF_FOLD = "correlation within recordings of mean ratings with {metric}, out of fold"
RANKED = TableForm(
    "All metrics, the best first: correlation with differences between stimuli of the same recording, each recording "
    "predicted from the others; 0: no prediction in the direction that it declares. Intervals and p hold for all "
    "metrics together. May be best: in the 95 % confidence set of the best metric. Chosen: share of recordings for "
    "which the others would have chosen it. In fold: correlation without holding anything out.",
    (
        RATINGS, METRIC, Column("r out of fold", "value", method=OUT_OF_FOLD, interval=JOINT),
        Column("p", "p", "p", "p", "maximum of t statistics, adjusted for all metrics"),
        Column("r / ceiling", "share", end="share", method="correlation / noise ceiling within recordings"),
        Column(
            "Over level alone", "over_baseline", end="over_baseline", interval=JOINT, ends="over_",
            method="correlation out of fold minus that of the baseline",
        ),
        Column("p", "over_p", "p", "over_p", "maximum of t statistics, adjusted for all metrics"),
        Column("May be best", "_best", NAME),
        Column("Chosen", "chosen", end="chosen", method="share of recordings for which the others choose it"),
        Column("In fold", "fitted", end="fitted", method="correlation within recordings of all stimuli"),
    ),
    path="rivals.{scale}.{level}.{metric}",
)  # fmt: skip
PICKED = TableForm(
    "What to expect of the metric picked: the out-of-fold correlation when the metric is chosen on the others, with "
    "its 95 % interval.",
    (
        RATINGS,
        Column(
            "r", "value", method="correlation of the metric that the other recordings choose, out of fold",
            interval=PICKING,
        ),
        Column("Noise ceiling", "ceiling", end="ceiling", method="noise ceiling within recordings"),
        Column("Metrics", "n_metrics", COUNT, "n_metrics"), Column("Stimuli", "n", COUNT, "n_items"),
        Column("Participants", "n_participants", COUNT, "n_participants"),
        Column("Sources of recordings", "n_sources", COUNT, "n_sources"),
    ),
    path="rivals_picked.{scale}.{level}",
)  # fmt: skip


def compute(table: Table, choices: Choices) -> Section:
    """Rank all metrics on every scale and level, where a comparison was asked for."""
    if not table.rivals:
        return Section(KEY, TITLE)
    found: list[tuple[RatingsPart, Ranking]] = []
    notes: list[str] = []
    lines: list[Line] = []
    for part in split_parts(table):
        try:
            found.append((part, _rank(part, table, choices)))
        except ValueError as error:  # it was asked for, so the answer says why there is none
            lines.append(Line(f"not ranked: {error}.", words.capitalise(part.subject), LEAD))
            continue
        lines += describe_ranking(*found[-1])
        notes += [f"{part.lead}, metrics ranked: {note}" for note in found[-1][1].notes]
    rows = [row for part, ranking in found for row in _list_rows(part, ranking)]
    return Section(
        key=KEY, title=TITLE, verdict=lines[:1] + [line for line in lines[1:] if line.lead == LEAD],
        answers=tuple(map(str, lines)) if found else (),  # no heading over nothing
        grids=(RANKED.build(rows), PICKED.build(_list_picked(found))),
        tables={"rivals": rows}, notes=notes, how=read_methods(KEY, draws=choices.draws),
        pictures=[
            Picture(
                make_slug("rivals", *part.place),
                f"How well each metric predicts {part.ratings} within recordings, out of fold: correlation with "
                "simultaneous 95 % intervals; hollow: not in the confidence set of the best metric. Dashed: "
                "noise ceiling; dotted: level alone.",
                _draw(ranking),
            )
            for part, ranking in found
        ],
    )  # fmt: skip


def _draw(ranking: Ranking) -> partial[Figure]:
    """Prepare the figure."""
    scenes = format_recordings(ranking.n_recordings, ranking.n_sources)
    size = f"{ranking.n_participants} participants, {scenes}, {ranking.n_items} stimuli"
    level = ranking.table["value"].to_dict().get(ranking.baseline, float("nan"))
    return partial(draw_ranking, ranking.table, ceiling=ranking.ceiling, level=level, size=size)


def _rank(part: RatingsPart, table: Table, choices: Choices) -> Ranking:
    rows, names = part.rows, list(table.rivals)
    # Where no metric of the set is about level alone, the level as played is.
    if not set(BASELINES) & set(names) and AMPLITUDE in rows and (rows[AMPLITUDE] > 0).all():
        rows = rows.assign(**{STRENGTH: 20 * np.log10(rows[AMPLITUDE])})
        names.append(STRENGTH)
    rng = choices.make_rng(KEY, *part.place)
    return rank_metrics(rows, names, draws=choices.draws, rng=rng, info=table.info)


def _list_rows(part: RatingsPart, ranking: Ranking) -> Iterator[dict[Any, Any]]:
    for row in ranking.to_frame().to_dict("records"):
        best = {"_best": "yes" if row["may_be_best"] else "no", "n": ranking.n_items}
        yield part.keys | row | best


def _list_picked(found: list[tuple[RatingsPart, Ranking]]) -> Iterator[dict[Any, Any]]:
    for part, one in found:
        ends = {"value": one.honest_value, "low": one.honest_low, "high": one.honest_high}
        sizes = {"n_metrics": len(one.table), "n": one.n_items, "ceiling": one.ceiling}
        sizes |= {"n_participants": one.n_participants, "n_sources": one.n_sources}
        yield part.keys | ends | sizes


LEAD = "best metric"


def describe_ranking(part: RatingsPart, ranking: Ranking) -> Iterator[Line]:
    """Say which metric predicts best, as far as that is shown, and what picking it is worth."""
    subject = words.capitalise(part.subject)
    yield Line(_describe_best(part, ranking), subject, LEAD)
    low, high = ranking.honest_low, ranking.honest_high
    told, interval = words.format_estimate(ranking.honest_value, low, high)
    text = (
        f"the metric chosen on the other recordings predicts the one left out with r = {told} (95 % "
        f"interval {interval}): what picking the best is worth."
    )
    yield Line(text, subject, "picking")


def _describe_best(part: RatingsPart, ranking: Ranking) -> str:
    table, ratings = ranking.table, part.ratings
    shown = tuple(map(str, table.index[(table["p"] < LEVEL) & (table["value"] > 0)]))
    level = f"level alone ({words.format_name(ranking.baseline)})" if ranking.baseline else ""
    found, best = _describe(ranking), words.format_name(ranking.best)
    highest = f"The highest correlation out of fold is that of {best}, {found}."
    if 0 < ranking.n_reducers < FEWEST_REDUCERS:
        few = f"with {ranking.n_reducers} reducers, where {FEWEST_REDUCERS} are needed"
        return f"Which of {len(table)} metrics predicts {ratings} for other reducers cannot be told {few}. {highest}"
    if level and not ranking.better:
        others = f"None of the {len(table) - 1} other metrics is shown to predict {ratings} better"
        return f"{others} than {level}, each by itself; what metrics add to level is in the slopes. {highest}"
    if not level and not shown:
        return f"None of the {len(table)} metrics is shown to predict {ratings}. {highest}"
    lead = f"Of {len(table)} metrics, "
    if ranking.alone:
        than = f", {level} included" if level else ""
        return (
            f"{lead}{best} predicts {ratings} better than every other{than}: out of fold {found}."
        )
    named = ranking.better if level else shown
    predict = f"{_name(named)} predict{'s' * (len(named) == 1)} {ratings}"
    return (
        f"{lead}{predict}{f' better than {level}' if level else ''}; which of them is best is unresolved "
        f"({len(ranking.candidates)} may be). {highest}"
    )


def _name(names: tuple[str, ...]) -> str:
    """Name a few metrics, and count the rest."""
    told = [words.format_name(name) for name in names[:NAMED]]
    more = len(names) - NAMED
    return f"{', '.join(told)} and {more} more" if more > 0 else words.join_words(told)


def _describe(ranking: Ranking) -> str:
    """Give the correlation of the best metric with its interval, and the noise ceiling."""
    row = ranking.to_frame().to_dict("records")[0]
    told, interval = words.format_estimate(row["value"], row["low"], row["high"])
    ceiling = ""
    if np.isfinite(ranking.ceiling):
        ceiling = f"; noise ceiling {words.format_number(ranking.ceiling)}"
    return f"r = {told} (95 % interval for all metrics together {interval}{ceiling})"
