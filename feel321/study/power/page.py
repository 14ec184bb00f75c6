"""The power of a study: the record, its tables and its page."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from functools import partial
from typing import TYPE_CHECKING, Any

from feel321 import __version__
from feel321.analysis.report.section import Picture
from feel321.analysis.tradeoff import results
from feel321.study.power import figures, tables, words
from feel321.study.power.record import Planned, find_sizes

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from feel321.analysis.power.design import Power

CAPTION = (
    "Power against participants, a curve for each number of recordings ({own} in the study: bold). Lines: closed form, "
    "at the first step of Holm's method. Circles: simulated studies with Holm's method, 95 % Monte Carlo intervals. "
    "Dashed: limit for infinitely many participants. Thin line: target power."
)
OTHERS = "Power with other numbers of reducers and of repeated ratings, all else as in the study. Line: closed form."

MUCH = 0.9
"""Share of a planted slope: where less is left of it, a note says so."""


class StudyPower(Planned, results.PageResult):
    """The power of a study, planned from its own settings and stimuli.

    Parameters
    ----------
    plan : PowerPlan
        Power of all designs; its participants are those who rate each attribute.
    name : str
        The study.
    effects : DataFrame
        What is planted, a row per hypothesis: attribute, metric, points, per (the step of the metric), size (of the
        step), source.
    share : int
        Groups among which the attributes are divided: as many times the participants of the plan take part.
    notes : tuple of str
        What was assumed and what is unusual, one sentence each.
    """

    __slots__ = ()

    @property
    def answer(self) -> str:
        """Which design is enough, its power and interval, in one sentence; or why none is."""
        return words.describe_plan(self)

    def to_frame(self) -> DataFrame:
        """Return the power of all designs.

        Returns
        -------
        DataFrame
            The columns of `PowerPlan.table`, and people: all who take part.
        """
        return self.plan.table.assign(people=self.plan.table["participants"] * self.share)

    def to_frames(self) -> dict[str, DataFrame]:
        """Return the numbers as tables.

        Returns
        -------
        dict of str to DataFrame
            `designs`: the grid; `hypotheses`, `differences` and `fits`: of every simulated design; `planted`: the
            slopes.
        """
        frames = {"designs": self.to_frame(), "planted": self.effects}
        for name, column in (("hypotheses", "table"), ("differences",) * 2, ("fits", "counts")):
            frames[name] = self._stack(column)
        return {name: frame for name, frame in frames.items() if len(frame)}

    def _stack(self, name: str) -> DataFrame:
        import pandas as pd

        powers = self.plan.powers
        frames = [getattr(one, name).assign(**find_sizes(one.design)) for one in powers]
        stacked: DataFrame = pd.concat(frames, ignore_index=True)
        return stacked

    def summary(self) -> str:
        """Write the answer for reading.

        Returns
        -------
        str
            The answer, a line per hypothesis, and the notes.
        """
        return "\n".join([
            self.answer,
            *(card["line"] for card in words.list_cards(self)),
            *self.notes,
            *_note_ends(self),
            FREEZE,
        ])

    def _make_page(self, tables_: Mapping[str, DataFrame]) -> results.PageParts:
        content = build_content(self)
        values = {
            "result": self, "content": content, "grids": tables.tabulate(self, tables_),
            "shown": words.describe_size(self), "cards": content["cards"],
        }  # fmt: skip
        return results.PageParts("power.html", content, list(_list_pictures(self)), values)


FREEZE = (
    "Before the first rating, feel321 freeze writes down the hypotheses and the analysis, so that results can be told "
    "apart into confirmatory and exploratory ones."
)


def build_content(result: Planned) -> dict[str, Any]:
    """Build what results.json holds."""
    plan = result.plan
    return {
        "version": __version__, "study": result.name, "answer": words.describe_plan(result), "wanted": plan.wanted,
        "hypothesis": list(plan.hypothesis), "share": result.share,
        "recommended": find_sizes(plan.recommended) if plan.recommended else None,
        "designs": result.to_frame().to_dict("records"),
        "powers": [_describe_power(one) for one in plan.powers],
        "planted": result.effects.to_dict("records"), "truth": asdict(result.shown.truth),
        "seed": result.shown.seed,
        "cards": words.list_cards(result), "notes": list_notes(result),
    }  # fmt: skip


def _describe_power(one: Power) -> dict[str, Any]:
    return {
        **find_sizes(one.design), "studies": one.studies, "family": list(one.family),
        "hypotheses": one.table.to_dict("records"), "differences": one.differences.to_dict("records"),
        "fits": one.counts.to_dict("records"),
    }  # fmt: skip


def list_notes(result: Planned) -> list[str]:
    """List all that was assumed or is unusual, once each."""
    own = (note for one in result.plan.powers for note in one.notes)
    return list(
        dict.fromkeys([*result.notes, *_note_ends(result), *result.plan.notes, *own, FREEZE])
    )


def _note_ends(result: Planned) -> Iterator[str]:
    """Say which slopes the ends of the scale make much flatter."""
    for one in result.shown.design.hypotheses:
        row = result.find_row(result.shown, one)
        if abs(row["kept"]) < MUCH * abs(row["slope"]):
            left = f"{row['kept'] * row['size']:.2g} of {row['points']:.2g} points per {row['per']}"
            yield f"The ends of the scale, and people who lapse, leave {left} of {words.name_hypothesis(row)}."


def _list_pictures(result: Planned) -> Iterator[Picture]:
    own, wanted = result.plan.powers[0].design, result.plan.wanted
    table = result.to_frame()
    # Of the smallest designs that are enough, which may need hundreds of people, only the recommended one is drawn.
    table = table[(table["kind"] != "smallest") | table["recommended"].astype(bool)]
    still = (table["reducers"] == own.reducers) & (table["repeats"] == own.repeats)
    grid = table[still].drop_duplicates(["participants", "recordings"])
    grid = grid.assign(participants=grid["people"])
    caption = CAPTION.format(own=own.recordings)
    yield Picture(
        "power", caption, partial(figures.draw_power, grid, own.recordings, wanted=wanted)
    )
    same = (table["participants"] == own.participants) & (table["recordings"] == own.recordings)
    if figures.list_varied(others := table[same]):
        yield Picture("others", OTHERS, partial(figures.draw_others, others, own, wanted=wanted))
