"""Frames made by hand, and what is judged of them."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from feel321.analysis.tradeoff.judge import Context
from feel321.analysis.tradeoff.measure import COLUMNS, DISTURBED, HALVES, MOUNTED, RECORDED
from feel321.analysis.tradeoff.page import Tradeoff, advise_tradeoff

LOSSES = ("level_db", "spectrum_db", "motion_db", "envelope_db")
QUIET_DB = -60.0


def make_frame(reducers: Mapping[str, Mapping[str, Any]]) -> pd.DataFrame:
    """Make the frame of one recording: reducer -> what differs from a perfect one, simplest first.

    Losses in dB by name; "half": the same in the second half only; a disturbance or "pre-echo", in dB; "turned": change
    by turning the sensor, in dB; "latency_ms", "operations".
    """
    rows: list[tuple[Any, ...]] = []

    def add(reducer: str, condition: str, measure: str, value: float) -> None:
        rows.append(("recording", "made", reducer, condition, measure, value, value, value, 1))

    for name, value in {"duration_s": 2.0, "felt_level": 9.0, "eigenvalue_ratio": 0.2}.items():
        add("", RECORDED, name, value)
    for place, (reducer, own) in enumerate(reducers.items()):
        needs = {"parameters": 0, "state": 0, "operations": own.get("operations", place)}
        for name, value in {**needs, "latency_ms": own.get("latency_ms", 0.0)}.items():
            add(reducer, "", name, value)
        for condition in (RECORDED, MOUNTED, *HALVES):
            for name in LOSSES:
                half = own.get("half", {}).get(name, 0.0) if condition == HALVES[1] else 0.0
                add(reducer, condition, name, own.get(name, 0.0) + half)
        add(reducer, RECORDED, "pre_echo_db", own.get("pre-echo", QUIET_DB))
        for name in DISTURBED:
            add(reducer, name, "change_db", own.get(name, QUIET_DB))
        add(reducer, MOUNTED, "change_db", own.get("turned", QUIET_DB))
    return pd.DataFrame(rows, columns=list(COLUMNS))


def judge(reducers: Mapping[str, Mapping[str, Any]], **context: Any) -> Tradeoff:
    """Judge a frame made by hand."""
    return advise_tradeoff(make_frame(reducers), Context(**context))


def read_verdicts(result: Tradeoff, column: str) -> dict[str, Any]:
    """Read a column of the verdicts by reducer."""
    return dict(zip(result.verdicts["reducer"], result.verdicts[column], strict=True))
