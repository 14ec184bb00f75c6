"""Section: the primary slopes under other choices."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.figures.estimates import draw_slopes
from feel321.analysis.primary.model import fit_primary
from feel321.analysis.primary.sensitivity import MOVED, RIGS, vary_primary
from feel321.analysis.report.parts import (
    ITEM,
    RatingsPart,
    find_table_steps,
    is_large,
    join_steps,
    split_parts,
)
from feel321.analysis.report.section import (
    METRIC,
    NAME,
    RATINGS,
    Column,
    P,
    Picture,
    Section,
    TableForm,
    estimate,
    make_slug,
    read_methods,
    stack,
)
from feel321.analysis.words import Line

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.metrics import Step
    from feel321.analysis.table.reading import Table

Row = dict[Any, Any]

MOST_CELLS = 20_000
"""Participants x stimuli beyond which the models would take many minutes."""

VARIANTS = TableForm(
    "Standardised slope under other choices, with 95 % t intervals (Satterthwaite's df); p not adjusted. Only "
    "standardised slopes can be compared across units. A dash: no model; the notes say why.",
    (
        RATINGS, Column("Choice", "variant", NAME), METRIC,
        estimate("Standardised slope", "standardised", "standardised slope", ends="standardised_"), P,
    ),
    path="variant.{scale}.{level}.{variant}.{metric}",
)  # fmt: skip


def compute_robustness(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Repeat the primary analysis under other choices."""
    notes: list[str] = []
    varied: dict[str, DataFrame] = {}
    pictures: list[Picture] = []
    parts, steps = {part.lead: part for part in split_parts(table)}, find_table_steps(table)
    for part in parts.values():
        try:
            _check_size(part, len(table.metrics))
            varied[part.lead] = vary_primary(part.rows, table.metrics, leave_out=False)
            pictures.append(_picture_variants(part, steps, varied[part.lead]))
        except ValueError as error:
            notes.append(f"{part.lead}: no variants. {error}")
    return Section(
        key="robustness",
        title="Robustness to other choices",
        verdict=list(_name_rigs(parts, varied)),
        grids=(VARIANTS.build(_list_variants(parts, varied)),),
        tables={"variants": stack(({"ratings": lead}, frame) for lead, frame in varied.items())},
        pictures=pictures,
        notes=(*notes, *_note_variants(varied)),
        how=read_methods("robustness"),
    )


def _list_variants(
    parts: Mapping[str, RatingsPart], varied: Mapping[str, DataFrame]
) -> Iterator[Row]:
    for lead, frame in varied.items():
        more = {**parts[lead].keys, "n": len(parts[lead].rows)}
        yield from (more | row for row in frame.to_dict("records"))


def _check_size(part: RatingsPart, n_slopes: int) -> None:
    cells = len(part.rows.groupby(["participant", ITEM], observed=True))
    if cells > MOST_CELLS:
        why = f"They are left out for {cells} participant x stimulus cells"
        raise ValueError(f"{why}; up to {MOST_CELLS} are varied.")
    if is_large(part.rows, n_slopes):
        raise ValueError("They are left out, for these ratings are too many for one fit.")


def _picture_variants(part: RatingsPart, steps: Mapping[str, Step], table: DataFrame) -> Picture:
    caption = (
        f"Slopes of {part.ratings} within recordings: above in points per {join_steps(steps)} of the metric, below "
        "standardised, under other choices; 95 % Satterthwaite intervals."
    )
    models = {part.lead: fit_primary(part.rows, tuple(steps), explain=False)}
    draw = partial(draw_slopes, models, variants=table, steps=steps)
    return Picture(make_slug("variants", *part.place), caption, draw)


def _name_rigs(parts: Mapping[str, RatingsPart], varied: Mapping[str, DataFrame]) -> Iterator[Line]:
    """Say where a slope hinges on the rig: it moves by more than its standard error with another choice."""
    for lead, table in varied.items():
        moved = [
            f"{words.format_name(name)} by {words.format_number(abs(shift), kind='slope')} ({variant})"
            for name in table["metric"].unique()
            for shift, variant in [_find_rig_shift(table[table["metric"] == name])]
            if abs(shift) > MOVED
        ]
        if moved:
            subject = words.capitalise(parts[lead].subject)
            text = f"slopes depend on the rig. In standard errors they change: {'; '.join(moved)}."
            yield Line(text, subject=subject, lead="rigs")


def _find_rig_shift(table: DataFrame) -> tuple[float, str]:
    """Find by how many standard errors a slope moves with the choice about rigs that moves it most, and which."""
    own = table.set_index("variant")
    whole = own.loc["primary"]
    shifts = ((own["estimate"] - whole["estimate"]) / whole["se"]).filter(
        regex=rf"\b({'|'.join(RIGS)})\b"
    )
    shifts = shifts[shifts.notna()]
    if shifts.empty:
        return 0.0, ""
    most = str(shifts.abs().idxmax())
    return float(shifts[most]), most


def _note_variants(varied: Mapping[str, DataFrame]) -> Iterator[str]:
    for lead, table in varied.items():
        own = table.drop_duplicates("variant").set_index("variant")["reason"]
        # What the primary model lacks is said in its own section.
        others = own[(own != "") & (own != own["primary"])]
        for reason, names in others.groupby(others, sort=False).groups.items():
            yield f"{lead}, {'; '.join(names)}: {reason}"
