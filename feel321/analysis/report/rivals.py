"""Section: which of all metrics predicts best, out of fold and corrected for how many were tried."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from feel321.analysis.association.rivals import BASELINES, FEWEST_REDUCERS, LEVEL, rank_metrics
from feel321.analysis.figures.kinds import draw_ranking
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.section import (
    Found,
    Picture,
    Row,
    Section,
    count_rows,
    make_row,
    make_slug,
)
from feel321.analysis.table.items import format_recordings

if TYPE_CHECKING:
    from collections.abc import Iterator

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table
    from feel321.records import Statistic

KEY = "rivals"
AMPLITUDE, STRENGTH = "rms_m_s2", "level_as_played"
JOINT = "simultaneous 95 % interval, for other participants, recordings and reducers"
PICKING = "95 % bootstrap interval, over participants, recordings and reducers"


def compute(table: Table, choices: Choices) -> Found:
    """Rank all metrics on every scale and level, where a comparison was asked for."""
    if not table.rivals:
        return Found()
    ranked: list[tuple[RatingsPart, Statistic]] = []
    told: list[Row] = []
    notes: list[str] = []
    for part in split_parts(table):
        try:
            ranking = _rank(part, table, choices)
        except ValueError as error:  # it was asked for, so the answer says why there is none
            told.append({"subject": part.subject, "why": str(error)})
            continue
        ranked.append((part, ranking))
        told.append({"subject": part.subject, "why": "", **describe_ranking(part, ranking)})
        notes += [f"{part.lead}, metrics ranked: {note}" for note in ranking.notes]
    rows = {
        "rivals": [row for part, one in ranked for row in _list_metrics(part, one)],
        "rivals_picked": [row for part, one in ranked for row in _list_picked(part, one)],
    }
    pictures = [_draw(part, one, detail=place > 0) for place, (part, one) in enumerate(ranked)]
    return Found(rows, {"parts": told}, pictures, notes)


def _draw(part: RatingsPart, one: Statistic, *, detail: bool) -> Picture:
    caption = (
        f"How well each metric predicts {part.ratings} within recordings, out of fold: correlation with simultaneous "
        "95 % intervals; hollow: not in the confidence set of the best metric. Dashed: noise ceiling; dotted: level "
        "alone."
    )
    level = one.table["value"].to_dict().get(one.baseline, np.nan)
    scenes = format_recordings(one.n_recordings, one.n_sources)
    size = f"{one.n_participants} participants, {scenes}, {one.n_items} stimuli"
    draw = partial(draw_ranking, one.table, ceiling=one.ceiling, level=level, size=size)
    return Picture(make_slug(KEY, *part.place), caption, draw, detail)


def _rank(part: RatingsPart, table: Table, choices: Choices) -> Statistic:
    rows, names = part.rows, list(table.rivals)
    # Where no metric of the set is about level alone, the level as played is.
    if not set(BASELINES) & set(names) and AMPLITUDE in rows and (rows[AMPLITUDE] > 0).all():
        rows = rows.assign(**{STRENGTH: 20 * np.log10(rows[AMPLITUDE])})
        names.append(STRENGTH)
    rng = choices.make_rng(KEY, *part.place)
    return rank_metrics(rows, names, draws=choices.draws, rng=rng, info=table.info)


def _list_metrics(part: RatingsPart, ranking: Statistic) -> Iterator[Row]:
    for row in ranking.to_frame().to_dict("records"):
        keys: Row = {**part.keys, "metric": row["metric"], "n": ranking.n_items}
        ends = {"low": row["low"], "high": row["high"], "interval": JOINT}
        yield make_row("r_out_of_fold", row["value"], **ends, p=row["p"], **keys)
        yield make_row("r_over_ceiling", row["share"], **keys)
        if ranking.baseline:
            ends = {"low": row["over_low"], "high": row["over_high"], "interval": JOINT}
            yield make_row("over_baseline", row["over_baseline"], **ends, p=row["over_p"], **keys)
        yield make_row("may_be_best", note="yes" if row["may_be_best"] else "no", **keys)
        yield make_row("chosen", row["chosen"], **keys)
        yield make_row("r_in_fold", row["fitted"], **keys)


def _list_picked(part: RatingsPart, one: Statistic) -> Iterator[Row]:
    ends = {"low": one.honest_low, "high": one.honest_high, "interval": PICKING, "n": one.n_items}
    yield make_row("r_picked", one.honest_value, **ends, **part.keys)
    sizes = {"ceiling": one.ceiling, "n_metrics": len(one.table), "n_items": one.n_items}
    sizes |= {"n_participants": one.n_participants, "n_sources": one.n_sources}
    yield from count_rows(sizes, n=one.n_items, **part.keys)


def describe_ranking(part: RatingsPart, ranking: Statistic) -> Row:
    """Decide which metric may be said to predict best: verdict, and the numbers that its sentence needs."""
    table, row = ranking.table, ranking.to_frame().to_dict("records")[0]
    shown = list(map(str, table.index[(table["p"] < LEVEL) & (table["value"] > 0)]))
    if 0 < ranking.n_reducers < FEWEST_REDUCERS:
        verdict = "few_reducers"
    elif ranking.baseline and not ranking.better:
        verdict = "not_above_level"
    elif not ranking.baseline and not shown:
        verdict = "none"
    else:
        verdict = "alone" if ranking.alone else "unresolved"
    return {
        "verdict": verdict, "ratings": part.ratings, "best": ranking.best, "baseline": ranking.baseline,
        "better": list(ranking.better) if ranking.baseline else shown, "n_metrics": len(table),
        "n_candidates": len(ranking.candidates), "n_reducers": ranking.n_reducers, "needed": FEWEST_REDUCERS,
        "r": {"value": row["value"], "low": row["low"], "high": row["high"]}, "ceiling": ranking.ceiling,
        "picked": {"value": ranking.honest_value, "low": ranking.honest_low, "high": ranking.honest_high},
    }  # fmt: skip


SECTION = Section(KEY, "Which metric predicts best?", "predict", compute)
