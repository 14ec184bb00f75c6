"""The chart as data: everything measured, as one frozen record that survives JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

from analysis.tradeoff.chart.records import (
    Accuracy,
    Cost,
    Dominance,
    Growth,
    Machine,
    Memory,
    Point,
    Precision,
    Rated,
    RealTime,
    Resources,
    Scene,
    Stability,
)

if TYPE_CHECKING:
    from collections.abc import Mapping

TABLES: Mapping[str, type] = MappingProxyType({
    "scenes": Scene,
    "points": Point,
    "dominated": Dominance,
    "accuracies": Accuracy,
    "costs": Cost,
    "growth": Growth,
    "memory": Memory,
    "precision": Precision,
    "rated": Rated,
    "realtime": RealTime,
    "resources": Resources,
    "stability": Stability,
})
"""Name of a table -> its record; also the names of the CSV files."""


@dataclass(frozen=True, slots=True)
class Chart:
    """Speed against accuracy, measured in one run.

    Parameters
    ----------
    machine : Machine
        On what.
    scenes : tuple of Scene
        Recordings.
    points : tuple of Point
        Reducers as they are, in the plane of speed and accuracy.
    dominated : tuple of Dominance
        Who is beaten in every respect.
    accuracies : tuple of Accuracy
        All methods and scenes.
    costs : tuple of Cost
        All times.
    growth : tuple of Growth
        Of time with length.
    memory : tuple of Memory
        By length.
    precision : tuple of Precision
        What 32-bit input changes.
    rated : tuple of Rated
        Mean ratings; empty where nobody has rated.
    realtime : tuple of RealTime
        Of the reducers that stream.
    resources : tuple of Resources
        Of all reducers.
    stability : tuple of Stability
        All reducers and scenes.
    seed : int
        Of the orientations, signals and bootstrap.
    effort : str
        Name of the effort: quick or full.
    simulated : bool
        Whether ratings come from simulated participants.
    notes : tuple of str
        What was left out or assumed.
    """

    machine: Machine
    scenes: tuple[Scene, ...]
    points: tuple[Point, ...]
    dominated: tuple[Dominance, ...]
    accuracies: tuple[Accuracy, ...]
    costs: tuple[Cost, ...]
    growth: tuple[Growth, ...]
    memory: tuple[Memory, ...]
    precision: tuple[Precision, ...]
    rated: tuple[Rated, ...]
    realtime: tuple[RealTime, ...]
    resources: tuple[Resources, ...]
    stability: tuple[Stability, ...]
    seed: int
    effort: str
    simulated: bool
    notes: tuple[str, ...]

    def to_json(self, **beside: Any) -> str:  # noqa: ANN401 - whatever JSON holds
        """Write as JSON text.

        Parameters
        ----------
        **beside : object
            Other entries, such as the files that belong to it.

        Returns
        -------
        str
            UTF-8 JSON; what is not defined is null.
        """
        return json.dumps({**asdict(self), **beside}, indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def read_json(text: str) -> Chart:
    """Read a chart that was written as JSON.

    Parameters
    ----------
    text : str
        What `Chart.to_json` gave.

    Returns
    -------
    Chart
        The same chart.

    Raises
    ------
    ValueError
        If it is no chart.
    """
    try:
        content = json.loads(text)
        own = {field.name: content[field.name] for field in fields(Chart)}
        tables = {name: tuple(record(**row) for row in own[name]) for name, record in TABLES.items()}
        return Chart(**{**own, **tables, "machine": Machine(**own["machine"]), "notes": tuple(own["notes"])})
    except (KeyError, TypeError, AttributeError) as error:
        raise ValueError(f"chart: got JSON that is no chart ({error!r}); run feel321 chart again") from error
