"""A paper that a study replicates: where the study differs from the paper's, and the paper as the report takes it."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from feel321.doors import name_of
from feel321.protocols.compare import count_rows
from feel321.protocols.tasks import PROTOCOLS
from feel321.protocols.trial import SURFACE
from feel321.stimuli.sets.recipe import ORIGINAL
from feel321.study.findings import Problems
from feel321.study.settings.read import list_items, make_design

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.replication.claims import Paper
    from feel321.stimuli.sets.build import Facts
    from feel321.study.actuator.rig import Rig
    from feel321.study.settings.schema import Settings

    Known = Mapping[str, Any]

WINDOW_MS = 35.0
"""Window of dft321_windowed."""

FROM_PAPER = "the paper's study"


def compare_with_paper(
    settings: Settings, recordings: Sequence[Facts], rig: Rig | None
) -> Problems:
    """Find where a study differs from the paper's, and note what of the paper is not known."""
    if (paper := settings.paper) is None:
        return Problems()
    conditions = {name: one for name, one in paper.conditions if one is not None}
    known = {name: one.value for name, one in conditions.items() if one.value is not None}
    told = [
        *_compare_people(settings, known), *_compare_names(settings, known),
        *_compare_signals(settings, known, {one.name: one.rate_hz for one in recordings}),
        *_compare_plain(settings, known), *_compare_rig(settings, known, rig),
    ]  # fmt: skip
    unknown = [name for name, one in conditions.items() if one.source == "unknown"]
    missing = [f"not known of {FROM_PAPER}: {', '.join(unknown)}"] if unknown else []
    lead = f"study.toml, paper ({paper.seen}): "
    warnings, notes = (tuple(lead + line for line in lines) for lines in (told, missing))
    return Problems(warnings=warnings, notes=notes)


def _compare_people(settings: Settings, known: Known) -> Iterator[str]:
    """Find orders that so many participants as the paper's leave uneven."""
    if "participants" not in known or settings.session.order != "williams":
        return
    people, items = known["participants"], list_items(settings)
    sizes = {"recordings": len(settings.recordings)}
    for task in make_design(settings).tasks:
        compared = PROTOCOLS[task.protocol].compare(items, task)
        sizes[f"comparisons in {task.protocol}"] = len(compared)
    for what, size in sizes.items():
        cycle = count_rows(size) if size > 1 else 1
        if left := people % cycle:
            fewer, more = people - left, people - left + cycle
            even = f"{fewer} or {more}" if fewer else f"{more}"
            yield (
                f"{people} participants as in the paper leave orders of {size} {what} unbalanced: they repeat "
                f"after {cycle} participants; {even} would balance them"
            )


def _compare_names(settings: Settings, known: Known) -> Iterator[str]:
    """Compare reducers, levels and protocols."""
    here = {
        "reducers": tuple(name_of(name) for name in settings.stimuli.reducers),
        "levels": settings.stimuli.levels,
        "protocols": settings.session.protocols,
    }
    for what, own in here.items():
        theirs = known.get(what, own)
        if lacking := [name for name in theirs if name not in own]:
            yield f"{what} of {FROM_PAPER} that are missing here: {', '.join(lacking)}"
        if added := [name for name in own if name not in theirs]:
            yield f"{what} here that {FROM_PAPER} did not have: {', '.join(added)}"


def _compare_signals(settings: Settings, known: Known, rates: Mapping[str, float]) -> Iterator[str]:
    """Compare rates, bands and windows."""
    if "band_hz" in known:
        yield from _compare_band(settings, known["band_hz"], rates)
    if "rate_hz" in known and (own := sorted({*rates.values()} - {known["rate_hz"]})):
        listed = ", ".join(f"{one:g}" for one in own)
        yield f"recordings are sampled at {listed} Hz, the paper's at {known['rate_hz']:g} Hz"
    if known.get("window_ms", WINDOW_MS) != WINDOW_MS:
        yield f"dft321_windowed uses windows of {WINDOW_MS:g} ms, the paper {known['window_ms']:g} ms"


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


def _compare_plain(settings: Settings, known: Known) -> Iterator[str]:
    """Compare what is one value on both sides."""
    touched = any(task.surface or task.reference == SURFACE for task in make_design(settings).tasks)
    here: dict[str, object] = {
        "recordings": len(settings.recordings), "order": settings.session.order,
        "gain": settings.stimuli.gain, "repeats": settings.session.repeats,
        "anchors": settings.stimuli.anchors, "surface": touched,
    }  # fmt: skip
    told = {True: "yes", False: "no"}
    for name, own in here.items():
        theirs = known.get(name, own)
        if theirs != own:
            mine, other = (told[one] if isinstance(one, bool) else one for one in (own, theirs))
            yield f"{name} is {mine} here, {other} in {FROM_PAPER}"


def _compare_rig(settings: Settings, known: Known, rig: Rig | None) -> Iterator[str]:
    """Compare how many channels the rig plays with what the paper's reference wants."""
    channels, reference = known.get("channels", 1), name_of(settings.stimuli.reference)
    if channels > 1 and reference != ORIGINAL:
        yield (
            f"{FROM_PAPER} played {channels} channels, here stimuli.reference is {reference!r}, which is one; use "
            f"reference = {ORIGINAL!r}"
        )
    if rig is None:
        if channels > 1:
            yield f"{FROM_PAPER} used {channels} actuators, one per axis; there is no rig.toml yet"
    elif (count := len(rig.actuators)) < channels:
        yield f"{FROM_PAPER} used {channels} actuators, the rig has {count}"


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
