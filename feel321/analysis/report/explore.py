"""What the page's script needs to explore the scatters: every stimulus, and the marks that stand for it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from feel321.analysis import words
from feel321.analysis.figures import scatter
from feel321.analysis.page import write_script_data
from feel321.analysis.table.metrics import find_steps
from feel321.records import to_json_value

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from feel321.analysis.association.correlate import Panel
    from feel321.types import MetricInfo

DIGITS = 12


def write_points(panels: Sequence[Panel], method: str, info: Mapping[str, MetricInfo]) -> str:
    """Write the points of all scatters as JSON: per scale and metric, its r, step, marks and stimuli.

    A point is stimulus, reducer, recording, metric, mean, its interval and the number of participants; reducers and
    recordings are places in their lists. Marks are named as in the SVG, and hold places of points.
    """
    reducers = list(dict.fromkeys(str(name) for one in panels for name in one.stimuli["reducer"]))
    scenes = list(dict.fromkeys(str(name) for one in panels for name in one.stimuli["recording"]))
    found = list(_list_panels(panels, method, info, names=(reducers, scenes)))
    points = {"reducers": reducers, "recordings": scenes, "panels": found}
    return write_script_data(to_json_value(points))


def _list_panels(
    panels: Sequence[Panel],
    method: str,
    info: Mapping[str, MetricInfo],
    *,
    names: tuple[list[str], list[str]],
) -> Iterator[dict[str, Any]]:
    columns = [one.metric for one in panels[0].associations if one.method == method]
    several = len({panel.level for panel in panels}) > 1
    for row, panel in enumerate(panels):
        stimuli = panel.stimuli.reset_index(drop=True)
        steps = find_steps(stimuli, columns, info)
        level = f", {words.format_name(panel.level)}" if several else ""
        for one in (one for one in panel.associations if one.method == method):
            place = f"{row}-{columns.index(one.metric)}"
            groups = scatter.group_marks(stimuli, one.metric, place)
            yield {
                "ratings": words.format_name(panel.scale) + level,
                "metric": words.format_name(one.metric), "r": _round(one.value),
                "per": steps[one.metric].per, "step": steps[one.metric].size,
                "marks": {group.name: group.rows.index.tolist() for group in groups},
                "points": [
                    [
                        str(point["stimulus_id"]), names[0].index(str(point["reducer"])),
                        names[1].index(str(point["recording"])), _round(point[one.metric]),
                        *(_round(point[key]) for key in ("mean", "low", "high")), int(point["n_participants"]),
                    ]
                    for point in stimuli.to_dict("records")
                ],
            }  # fmt: skip


def _round(value: object) -> float | None:
    number = float(str(value))
    return float(f"{number:.{DIGITS}g}") if math.isfinite(number) else None
