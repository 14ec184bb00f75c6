"""Mean opinion over the bit rate of coded stimuli, with the mapping of ITU-T P.1401."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from feel321.analysis import words
from feel321.analysis.contrasts.compare import profile_reducers
from feel321.analysis.figures.rate import draw_rates
from feel321.analysis.report import section as pages
from feel321.analysis.report.parts import RatingsPart, split_parts
from feel321.analysis.report.standard import INDEPENDENT
from feel321.analysis.standard import FEW_ITEMS, p1401
from feel321.analysis.table.items import make_items
from feel321.analysis.table.schema import BIT_RATE

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.reading import Table

KEY, TITLE = "rates", "Ratings over the bit rate"
LOG_RATE = "log2_bit_rate"
FEWEST = 3
"""Bit rates; a line through two says nothing."""

RATES = pages.TableForm(
    "Mean rating at each bit rate, in points, with its 95 % t interval over participants (other people, these "
    "recordings), and the mapping of P.1401. A dash: not coded.",
    (
        pages.RATINGS, pages.Column("kbit/s", BIT_RATE, end=BIT_RATE, method="declared bit rate, kbit/s"),
        pages.Column("Reducer", "reducer", pages.NAME), pages.MEAN,
        pages.Column("Mapping", "mapped", "rating", "mapped", "P.1401 mapping of log2 of the bit rate, fitted to all"),
        pages.Column("Participants", "n_participants", words.COUNT, "n_participants"),
        pages.Column("Stimuli", "n_stimuli", words.COUNT, "n_stimuli"),
    ),
    path="rates.{scale}.{level}.{role}.{reducer}", n="n_ratings", detail=False,
)  # fmt: skip
MAPPINGS = pages.TableForm(
    "ITU-T P.1401 with log2 of the bit rate as metric, each recording predicted by a mapping fitted without its "
    "source. 95 % intervals as the standard has them, stimuli treated as independent.",
    (
        pages.RATINGS, pages.Column("Order", "order", words.COUNT, "order"),
        pages.Column("PLCC", "plcc", "correlation", "plcc", "P.1401 plcc, held out", INDEPENDENT, "plcc_"),
        pages.Column("rmse", "rmse", "rating", "rmse", "P.1401 rmse, held out", INDEPENDENT, "rmse_"),
        pages.Column("Outlier ratio", "outlier_ratio", end="outlier_ratio", method="P.1401 outlier ratio, held out"),
        pages.Column("Stimuli", "n_items", words.COUNT, "n_items"),
    ),
    path="rate_mapping.{scale}.{level}", n="n_items", detail=False,
)  # fmt: skip


def compute(table: Table, choices: Choices) -> pages.Section:  # noqa: ARG001 - every section has this form
    """Relate ratings to the bit rates that the manifest holds, if it holds any."""
    if BIT_RATE not in table.rows:
        return pages.Section(key=KEY, title=TITLE)
    found: list[tuple[RatingsPart, list[dict[str, Any]], dict[str, Any]]] = []
    notes: list[str] = []
    for part in split_parts(table, matched=False):
        try:
            found.append((part, *_relate(part, table)))
        except ValueError as error:
            notes.append(f"{part.lead}, bit rates: left out. {error}")
    rows = [row for _, own, _ in found for row in own]
    mappings = [mapping for _, _, mapping in found]
    lines = [
        words.Line(_sum_up(rows, mapping), words.capitalise(part.subject), "bit rate")
        for part, rows, mapping in found
    ]
    return pages.Section(
        key=KEY,
        title=TITLE,
        answers=[*map(str, lines)],
        verdict=lines,
        grids=(RATES.build(rows), MAPPINGS.build(mappings)),
        tables={"rates": rows, "rate_mapping": mappings},
        pictures=[_picture(*one) for one in found],
        notes=notes,
        how=pages.read_methods(KEY),
    )


def _relate(part: RatingsPart, table: Table) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Average the ratings of one scale and level at each bit rate, and map the rate to them."""
    coded = part.rows[part.rows[BIT_RATE].notna()]
    rates = coded.groupby("reducer", observed=True)[BIT_RATE].unique()
    if several := [name for name, own in rates.items() if len(own) > 1]:
        raise ValueError(
            f"a reducer must have one bit rate, got several for {several[0]}; use one reducer name per bit rate"
        )
    known = {str(name): float(own[0]) for name, own in rates.items()}
    if len(set(known.values())) < FEWEST:
        raise ValueError(
            f"there must be {FEWEST} bit rates or more, got {len(set(known.values()))}"
        )
    items = make_items(coded.assign(**{LOG_RATE: np.log2(coded[BIT_RATE])}), [LOG_RATE])
    order = 3 if len(items.names) >= FEW_ITEMS else 1
    judge = partial(p1401, items.ratings.T, items.metrics[0], order=order, higher="better")
    curve = np.polynomial.Polynomial(judge().coefficients)
    held = judge(groups=items.of_source[items.recordings])
    names = ("plcc", "plcc_low", "plcc_high", "rmse", "rmse_low", "rmse_high", "outlier_ratio")
    mapping = {
        **part.keys, "order": order, **{name: getattr(held, name) for name in names}, "n_items": held.n_items,
        "coefficients": " ".join(f"{value:.6g}" for value in curve.coef),
    }  # fmt: skip
    rows = [
        {
            **part.keys, **row, BIT_RATE: known.get(row["reducer"], np.nan),
            "mapped": float(curve(np.log2(known[row["reducer"]]))) if row["reducer"] in known else np.nan,
        }
        for row in _profile(part, table).to_dict("records")
    ]  # fmt: skip
    return sorted(rows, key=lambda row: (np.isnan(row[BIT_RATE]), row[BIT_RATE])), mapping


def _profile(part: RatingsPart, table: Table) -> DataFrame:
    """Average the ratings of what was tested, and of the hidden reference, which is not coded."""
    rows = table.rows
    here = (rows["scale"] == part.scale) & (rows["level"] == part.level)
    return profile_reducers(rows[here & rows["role"].isin(["test", "reference"])])


def _sum_up(rows: list[dict[str, Any]], mapping: dict[str, Any]) -> str:
    coded = [row for row in rows if not np.isnan(row[BIT_RATE])]

    def write(row: dict[str, Any]) -> str:
        mean, interval = words.format_estimate(row["mean"], row["low"], row["high"], kind="rating")
        return f"{mean} (95 % CI {interval})"

    first, last = coded[0], coded[-1]
    plain = [f"{write(row)} not coded ({row['reducer']})" for row in rows if row not in coded]
    plcc, reach = words.format_estimate(mapping["plcc"], mapping["plcc_low"], mapping["plcc_high"])
    return (
        f"mean rating {write(first)} at {first[BIT_RATE]:g} kbit/s, "
        f"{write(last)} at {last[BIT_RATE]:g} kbit/s{''.join(f', {one}' for one in plain)}. The bit rate alone, mapped "
        f"by P.1401, predicts mean ratings of stimuli from held-out recordings with a correlation of {plcc} ({reach}) "
        f"and an error of {words.format_number(mapping['rmse'], kind='rating')} points."
    )


def _picture(
    part: RatingsPart, rows: list[dict[str, Any]], mapping: dict[str, Any]
) -> pages.Picture:
    caption = (
        f"{words.capitalise(part.subject)}: mean rating at each bit rate, bars: 95 % t intervals over participants; "
        "line: P.1401's mapping of log2 of the bit rate; band: not coded."
    )
    coefficients = [float(value) for value in mapping["coefficients"].split()]
    draw = partial(draw_rates, rows, coefficients, scale=part.scale)
    return pages.Picture(f"{KEY}_{pages.make_slug(part.scale, part.level)}", caption, draw)
