"""The participants' own detection thresholds: read from the journals, for tables, warnings and sensation levels.

A threshold counts once its block is over. It is usable where it lies within the levels that were played and its 95 %
interval is at most `WIDEST_DB` wide; what is not usable is reported, and nothing is computed from it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import TYPE_CHECKING

from feel321.protocols.threshold import UNLIKELY, ThresholdEstimate, estimate_threshold, find_tail
from feel321.study.session.events import PageRead
from feel321.study.session.plan import Plan, recall_detection

if TYPE_CHECKING:
    from feel321.study.session.journal import Records

    Thresholds = Mapping[float, ThresholdEstimate]

WIDEST_DB = 12.0
"""Widest 95 % interval of a threshold that is usable: a factor of two in amplitude to either side."""

PLACES = 3
"""Decimal places in tables: the last bits of a sum may differ between processors."""


def read_thresholds(plan: Plan, records: Records) -> dict[float, ThresholdEstimate]:
    """Read the thresholds of a participant by frequency in Hz; empty without a block, or before its end."""
    is_over = any(page.key == "threshold_done" for page in records.find(PageRead))
    detection = recall_detection(plan, records) if is_over else None
    if detection is None:
        return {}
    return {
        frequency: estimate_threshold(procedure)
        for frequency, procedure in detection.list_procedures().items()
    }


def is_usable(estimate: ThresholdEstimate) -> bool:
    """Check whether anything may be computed from a threshold."""
    width = estimate.threshold_high_db - estimate.threshold_low_db
    return not math.isnan(estimate.threshold_db) and width <= WIDEST_DB and not estimate.is_beyond


def list_columns(thresholds: Thresholds) -> dict[str, float | str]:
    """List the columns of `participants.csv`: threshold, slope and their intervals by frequency, catch trials."""
    columns: dict[str, float | str] = {}
    for frequency, found in thresholds.items():
        at = f"{frequency:g}hz".replace(".", "_")
        values = {
            f"threshold_db_{at}": found.threshold_db,
            f"threshold_low_db_{at}": found.threshold_low_db,
            f"threshold_high_db_{at}": found.threshold_high_db,
            f"threshold_slope_{at}": found.slope,
            f"threshold_slope_low_{at}": found.slope_low,
            f"threshold_slope_high_{at}": found.slope_high,
        }
        columns |= {k: "" if math.isnan(v) else round(v, PLACES) for k, v in values.items()}
        columns[f"threshold_catch_correct_{at}"] = found.catch_correct
        columns[f"threshold_catch_trials_{at}"] = found.catch_trials
    return columns


def find_warnings(thresholds: Thresholds) -> Iterator[str]:
    """List what speaks against the thresholds of a participant."""
    for frequency, found in thresholds.items():
        at = f"threshold at {frequency:g} Hz"
        width = found.threshold_high_db - found.threshold_low_db
        if math.isnan(found.threshold_db) or width > WIDEST_DB:
            yield (
                f"{at}: {found.threshold_db:.1f} dB, 95 % interval {found.threshold_low_db:.1f} to "
                f"{found.threshold_high_db:.1f} dB, too wide to be used"
            )
        yield from (f"{at}: {note}" for note in found.notes if "catch trials" not in note)
    caught = sum(found.catch_correct for found in thresholds.values())
    silent = sum(found.catch_trials for found in thresholds.values())
    if find_tail(caught, silent) < UNLIKELY:
        yield (
            f"threshold: {caught} of {silent} silent catch trials correct: the participant may be using another cue "
            "than the vibration, such as sound"
        )
