"""Plan a study: the grid of designs, and whole studies as its check."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from feel321.analysis.power import plan as planning
from feel321.analysis.power import simulate
from feel321.study.power import page, setup, whole

if TYPE_CHECKING:
    from feel321.analysis.power.design import Power, PowerPlan
    from feel321.jobs import Workers
    from feel321.study.power.setup import PowerTask

    Progress = Callable[[int, int], None]

KEPT = ".studies"
"""Folder, in that of the results, of simulated studies: an interrupted call is continued, the same one costs nothing."""

CONFIDENCE = 0.95


@dataclass(frozen=True, slots=True)
class Grid:
    """Which designs are compared; empty: chosen around the study's own. whole: whole studies beside them."""

    participants: Sequence[int] = ()
    recordings: Sequence[int] = ()
    reducers: Sequence[int] = ()
    repeats: Sequence[int] = ()
    hypothesis: str = ""
    wanted: float = 0.8
    studies: int = 1000
    whole: int = 0
