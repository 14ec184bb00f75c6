"""A paper that a study replicates: where the study differs from the paper's, and the paper as the report takes it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from feel321.doors import name_of
from feel321.protocols.balance import count_rows
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import SURFACE
from feel321.stimuli.sets.recipe import ORIGINAL
from feel321.study.settings.read import list_items, make_design

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication.claims import Paper
    from feel321.stimuli.sets.build import Facts
    from feel321.study.actuator.rig import Rig
    from feel321.study.findings import Problems
    from feel321.study.settings.paper import PaperTable
    from feel321.study.settings.schema import Settings

WINDOW_MS = 35.0
"""Window of dft321_windowed."""

FROM_PAPER = "the paper's study"


def compare_with_paper(
    settings: Settings, recordings: Sequence[Facts], rig: Rig | None, *, found: Problems
) -> Problems:
    """Add to what was found where a study differs from the paper's, and note what of the paper is not known."""
    if (paper := settings.paper) is None:
        return found
    told = [
        *_compare_people(settings, paper), *_compare_names(settings, paper),
        *_compare_signals(settings, paper, recordings), *_compare_plain(settings, paper),
        *_compare_rig(settings, paper, rig),
    ]  # fmt: skip
    conditions = [(name, one) for name, one in paper.conditions if one is not None]
    unknown = [name for name, one in conditions if one.source == "unknown"]
    notes = (f"not known of {FROM_PAPER}: {', '.join(unknown)}",) if unknown else ()
    lead = f"study.toml, paper ({paper.seen}): "
    return replace(
        found,
        warnings=(*found.warnings, *(lead + line for line in told)),
        notes=(*found.notes, *(lead + line for line in notes)),
    )


def _compare_people(settings: Settings, paper: PaperTable) -> Iterator[str]:
    """Find orders that so many participants as the paper's leave uneven."""
    known = paper.conditions.participants
    if known is None or known.value is None or settings.session.order != "williams":
        return
    items = list_items(settings)
    sizes = {"recordings": len(settings.recordings)}
    for task in make_design(settings).tasks:
        sizes[f"comparisons in {task.protocol}"] = len(
            PROTOCOLS[task.protocol].compare(items, task)
        )
    for what, size in sizes.items():
        cycle = count_rows(size) if size > 1 else 1
        if left := known.value % cycle:
            fewer, more = known.value - left, known.value - left + cycle
            even = f"{fewer} or {more}" if fewer else f"{more}"
            yield (
                f"{known.value} participants as in the paper leave orders of {size} {what} unbalanced: they repeat "
                f"after {cycle} participants; {even} would balance them"
            )


def _compare_names(settings: Settings, paper: PaperTable) -> Iterator[str]:
    """Compare reducers, levels and protocols."""
    conditions, stimuli = paper.conditions, settings.stimuli
    here = {
        "reducers": tuple(name_of(name) for name in stimuli.reducers),
        "levels": stimuli.levels,
        "protocols": settings.session.protocols,
    }
    for what, own in here.items():
        known = getattr(conditions, what)
        if known is None or known.value is None:
            continue
        if lacking := [name for name in known.value if name not in own]:
            yield f"{what} of {FROM_PAPER} that are missing here: {', '.join(lacking)}"
        if added := [name for name in own if name not in known.value]:
            yield f"{what} here that {FROM_PAPER} did not have: {', '.join(added)}"


def _compare_signals(
    settings: Settings, paper: PaperTable, recordings: Sequence[Facts]
) -> Iterator[str]:
    """Compare rates, bands and windows."""
    rates = {one.name: one.rate_hz for one in recordings}
    if (band := paper.conditions.band_hz) and band.value:
        yield from _compare_band(settings, band.value, rates)
    if (
        (rate := paper.conditions.rate_hz)
        and rate.value
        and (own := sorted(set(rates.values()) - {rate.value}))
    ):
        yield f"recordings are sampled at {', '.join(f'{one:g}' for one in own)} Hz, the paper's at {rate.value:g} Hz"
    window = paper.conditions.window_ms
    if window and window.value not in {None, WINDOW_MS}:
        yield f"dft321_windowed uses windows of {WINDOW_MS:g} ms, the paper {window.value:g} ms"


def _compare_band(
    settings: Settings, band: tuple[float, float], rates: Mapping[str, float]
) -> Iterator[str]:
    """Find what rates and conditioning leave of the paper's band."""
    (low, high), steps = band, settings.stimuli.conditioning
    for name, rate_hz in rates.items():
        if rate_hz < 2 * high:
            yield (
                f"recording {name!r} at {rate_hz:g} Hz holds nothing above {rate_hz / 2:g} Hz; the paper's band ends "
                f"at {high:g} Hz: sample at {2 * high:g} Hz or more"
            )
    if settings.rig.rate_hz < 2 * high:
        yield f"rig.rate_hz is {settings.rig.rate_hz:g}, too low for the paper's band up to {high:g} Hz"
    if steps.low_pass_hz is not None and steps.low_pass_hz < high:
        yield f"stimuli.conditioning.low_pass_hz is {steps.low_pass_hz:g}, the paper's band ends at {high:g} Hz"
    if steps.high_pass_hz is not None and steps.high_pass_hz > low:
        yield f"stimuli.conditioning.high_pass_hz is {steps.high_pass_hz:g}, the paper's band begins at {low:g} Hz"


def _compare_plain(settings: Settings, paper: PaperTable) -> Iterator[str]:
    """Compare what is one value on both sides."""
    touched = any(task.surface or task.reference == SURFACE for task in make_design(settings).tasks)
    here: dict[str, object] = {
        "recordings": len(settings.recordings), "order": settings.session.order,
        "gain": settings.stimuli.gain, "repeats": settings.session.repeats,
        "anchors": settings.stimuli.anchors, "surface": touched,
    }  # fmt: skip
    for name, own in here.items():
        known = getattr(paper.conditions, name)
        if known is not None and known.value is not None and known.value != own:
            told = {True: "yes", False: "no"}
            values = [
                told.get(one, one) if isinstance(one, bool) else one for one in (own, known.value)
            ]
            yield f"{name} is {values[0]} here, {values[1]} in {FROM_PAPER}"


def _compare_rig(settings: Settings, paper: PaperTable, rig: Rig | None) -> Iterator[str]:
    """Compare how many channels the rig plays with what the paper's reference wants."""
    known = paper.conditions.channels
    if known is None or known.value is None:
        return
    if known.value > 1 and name_of(settings.stimuli.reference) != ORIGINAL:
        yield (
            f"{FROM_PAPER} played {known.value} channels, here stimuli.reference is "
            f"{name_of(settings.stimuli.reference)!r}, which is one; use reference = {ORIGINAL!r}"
        )
    if rig is None:
        if known.value > 1:
            yield f"{FROM_PAPER} used {known.value} actuators, one per axis; there is no rig.toml yet"
    elif (count := len(rig.actuators)) < known.value:
        yield f"{FROM_PAPER} used {known.value} actuators, the rig has {count}"


def make_paper(settings: Settings, mountings: DataFrame | None = None) -> Paper | None:
    """Make the paper that the report answers; mountings: metrics over orientations of the sensor."""
    import pandas as pd

    from feel321.analysis.replication.claims import Paper, PaperClaim

    if (paper := settings.paper) is None:
        return None
    claims = []
    for table in paper.claims:
        number = table.paper.model_dump() if table.paper else {}
        ends = [number.get(key) for key in ("value", "low", "high")]
        value, low, high = (math.nan if one is None else float(one) for one in ends)
        claims.append(PaperClaim(paper=(value, low, high), **table.model_dump(exclude={"paper"})))
    published = [
        {**one.model_dump(exclude={"numbers"}), "reducer": reducer, "paper": value}
        for one in paper.published
        for reducer, value in one.numbers.items()
    ]
    return Paper(
        paper.citation, paper.doi, paper.seen, tuple(claims),
        pd.DataFrame(published) if published else None, mountings,
    )  # fmt: skip
