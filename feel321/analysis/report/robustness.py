"""Section: the primary slopes under other choices."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from feel321.analysis.figures.kinds import draw_variants
from feel321.analysis.primary.sensitivity import MOVED, RIGS, vary_primary
from feel321.analysis.report.parts import ITEM, RatingsPart, is_large, split_parts
from feel321.analysis.report.section import Found, Picture, Row, Section, make_row, make_slug
from feel321.analysis.words import SATTERTHWAITE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

MOST_CELLS = 20_000
"""Participants x stimuli beyond which the models would take many minutes."""


def compute(table: Table, choices: Choices) -> Found:  # noqa: ARG001 - every section has this form
    """Repeat the primary analysis under other choices."""
    notes: list[str] = []
    rows: list[Row] = []
    pictures: list[Picture] = []
    moved: list[Row] = []
    for part in split_parts(table):
        try:
            _check_size(part, len(table.metrics))
            varied = vary_primary(part.rows, table.metrics)
        except ValueError as error:
            notes.append(f"{part.lead}: no variants. {error}")
            continue
        caption = (
            f"Standardised slopes of {part.ratings} within recordings under other choices; 95 % Satterthwaite "
            "intervals; hollow: singular fit."
        )
        slug = make_slug("variants", *part.place)
        pictures.append(
            Picture(slug, caption, partial(draw_variants, varied), detail=bool(pictures))
        )
        rows += [row for one in varied.to_dict("records") for row in _list_variant(part, one)]
        notes += [f"{part.lead}, {note}" for note in _note_variants(varied)]
        if shifts := list(_find_rig_shifts(varied)):
            moved.append({"subject": part.subject, "shifts": shifts})
    return Found(
        {"variants": rows},
        {"rigs": moved, "turned": _find_turned(rows)} if rows else {},
        pictures,
        notes,
    )


def _check_size(part: RatingsPart, n_slopes: int) -> None:
    cells = len(part.rows.groupby(["participant", ITEM], observed=True))
    if cells > MOST_CELLS:
        why = f"They are left out for {cells} participant x stimulus cells"
        raise ValueError(f"{why}; up to {MOST_CELLS} are varied.")
    if is_large(part.rows, n_slopes):
        raise ValueError("They are left out, for these ratings are too many for one fit.")


def _list_variant(part: RatingsPart, one: Row) -> Iterator[Row]:
    keys: Row = {
        **part.keys,
        "variant": one["variant"],
        "metric": one["metric"],
        "n": len(part.rows),
    }
    ends = {
        "low": one["standardised_low"],
        "high": one["standardised_high"],
        "interval": SATTERTHWAITE,
    }
    yield make_row(
        "standardised", one["standardised"], **ends, p=one["p"], note=one["reason"], **keys
    )
    yield make_row("slope", one["estimate"], note=one["unit"], **keys)


def _find_turned(rows: list[Row]) -> list[Row]:
    """Find the slopes whose interval excludes zero in the primary model, and not so under another choice."""
    own = [row for row in rows if row["quantity"] == "standardised"]
    whole = {_place(row): _sign(row) for row in own if row["variant"] == "primary"}
    return [row for row in own if row["low"] == row["low"] and _sign(row) != whole[_place(row)]]


def _place(row: Row) -> tuple[str, str, str]:
    return row["scale"], row["level"], row["metric"]


def _sign(row: Row) -> int:
    return int(row["low"] > 0) - int(row["high"] < 0)


def _find_rig_shifts(table: DataFrame) -> Iterator[Row]:
    """Find where a slope depends on the rig: it moves by more than its standard error with another choice."""
    for name in table["metric"].unique():
        own = table[table["metric"] == name].set_index("variant")
        whole = own.loc["primary"]
        shifts = ((own["estimate"] - whole["estimate"]) / whole["se"]).filter(
            regex=rf"\b({'|'.join(RIGS)})\b"
        )
        shifts = shifts[shifts.notna()]
        if len(shifts) and abs(shifts[most := str(shifts.abs().idxmax())]) > MOVED:
            yield {"metric": name, "shift": abs(float(shifts[most])), "variant": most}


def _note_variants(table: DataFrame) -> Iterator[str]:
    own = table.drop_duplicates("variant").set_index("variant")["reason"]
    # What the primary model lacks is said in its own section.
    others = own[(own != "") & (own != own["primary"])]
    for reason, names in others.groupby(others, sort=False).groups.items():
        yield f"{'; '.join(names)}: {reason}"


SECTION = Section("robustness", "Robustness to other choices", "hinge", compute)
