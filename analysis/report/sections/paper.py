"""The paper's own spectral match beside the bounded one: by ranks, and raw with what a single stimulus does to it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.association.correlate import correlate
from analysis.numbers import TWO_WAY, make_interval, make_number, name_path
from analysis.primary.influence import find_candidates
from analysis.primary.model import fit_primary
from analysis.report.sections.effects import lay_estimate, name_estimate
from analysis.report.sections.section import Cell, Grid
from analysis.table.schema import STAND_INS
from analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Iterator, Mapping

    from pandas import DataFrame

    from analysis.numbers import Number
    from analysis.primary.model import Primary
    from analysis.report.sections.choices import Choices
    from analysis.report.sections.parts import Part
    from analysis.table.reading import Table

BOUNDED, RANKS = "spectral_match_bounded", "within_spearman"
RAW = STAND_INS[BOUNDED]


def lay_paper(table: Table, fits: Mapping[str, tuple[Part, Primary]], choices: Choices) -> Iterator[Grid]:
    """Lay out the paper's metric, where the primary analysis is about the bounded one and the manifest has both.

    Parameters
    ----------
    table : Table
        Ratings and metrics.
    fits : mapping
        Part's lead -> part and model.
    choices : Choices
        Draws and seed.

    Yields
    ------
    Grid
        One, or none.
    """
    if BOUNDED not in table.metrics or RAW not in table.further:
        return
    metrics = [RAW if name == BOUNDED else name for name in table.metrics]
    rows = [_lay(part, metrics, choices) for part, model in fits.values() if model.slopes["estimable"].any()]
    if rows:
        caption = (
            "Spectral match as in the paper (eq. 1), in place of the bounded one. It has no lower bound, so that a few "
            "stimuli may decide its slope: Spearman's correlation within recordings with the two-way interval; the "
            "slope, in points per +0.1, and the same without the stimulus that moves it most; 95 % intervals."
        )
        head = ("Ratings", "By ranks", "Interval", "Raw slope", "Interval", "Without", "Raw slope", "Interval")
        yield Grid(caption, head, tuple(rows))


def _lay(part: Part, metrics: list[str], choices: Choices) -> tuple[str | Cell, ...]:
    name = name_path("paper", *part.place, RAW)
    rng = choices.make_rng("paper", *part.place)
    ranks = correlate(part.rows, RAW, method=RANKS, draws=choices.draws, rng=rng)
    how = "Spearman's correlation within recordings of mean ratings with eq. 1"
    value = make_number(f"{name}.ranks", ranks.value, how, n=ranks.n_items)
    value = make_interval(value, ranks.low, ranks.high, uncertainty=TWO_WAY)
    item = find_candidates(part.rows, metrics, count=1)[0]
    rest = part.rows[part.rows["item"] != item]
    whole, left = _fit(f"{name}.raw", part.rows, metrics), _fit(f"{name}.raw_without", rest, metrics)
    words = tell_name(part.lead)
    slopes = *lay_estimate(whole, "slope"), item, *lay_estimate(left, "slope")
    return (words, *lay_estimate(value, "correlation"), *slopes)


def _fit(name: str, rows: DataFrame, metrics: list[str]) -> Number:
    model = fit_primary(rows, metrics, explain=False)
    row: dict[Hashable, Any] = model.slopes.loc[RAW].to_dict()
    return name_estimate(name, row, "mixed model, points of rating per +0.1 of eq. 1", n=model.n_rows, prefix="tenth")
