"""Which figures a report has, what they are called, and what their captions say."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

from analysis.figures import CUT, count_clipped, draw_profile, draw_scatter
from analysis.style import Look, assign_looks
from analysis.table import order_reducers
from analysis.verdict import LEADING
from analysis.words import tell_name, tell_number

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from matplotlib.figure import Figure

    from analysis.association import Association
    from analysis.findings import Findings, Panel
    from analysis.table import Table


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of the report.

    Parameters
    ----------
    name : str
        File name without suffix, unique in a report.
    kind : str
        ``scatter`` or ``profile``.
    caption : str
        What it shows, in words; also its alternative text.
    figure : Figure
        The drawing.
    """

    name: str
    kind: str
    caption: str
    figure: Figure


def draw_pictures(table: Table, findings: Findings) -> tuple[Picture, ...]:
    """Draw all figures of a report.

    Parameters
    ----------
    table : Table
        Which reducers there are.
    findings : Findings
        What to draw.

    Returns
    -------
    tuple of Picture
        A scatter per scale, level and metric, then a profile per scale and level.
    """
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    scatters = [picture for panel in findings.panels for picture in _draw_scatters(panel, looks)]
    return (*scatters, *_draw_profiles(findings, looks))


def _draw_scatters(panel: Panel, looks: Mapping[str, Look]) -> Iterator[Picture]:
    for association in (result for result in panel.associations if result.method == LEADING):
        name = _name_file("scatter", panel.scale, panel.level, association.metric)
        figure = draw_scatter(panel, association, looks=looks)
        yield Picture(name, "scatter", _caption_scatter(panel, association), figure)


def _draw_profiles(findings: Findings, looks: Mapping[str, Look]) -> Iterator[Picture]:
    for panel in findings.panels:
        profile, chosen = (
            table[(table["scale"] == panel.scale) & (table["level"] == panel.level)]
            for table in (findings.profile, findings.participants)
        )
        figure = draw_profile(profile, chosen, looks=looks)
        yield Picture(_name_file("profile", panel.scale, panel.level), "profile", _caption_profile(panel), figure)


def _caption_scatter(panel: Panel, association: Association) -> str:
    metric = tell_name(association.metric)
    caption = (
        f"Mean {tell_name(panel.scale)} rating of each test stimulus against its {metric} "
        f"(level {tell_name(panel.level)}). Thin grey bars: 95 % t intervals over participants."
    )
    clipped = count_clipped(panel.stimuli[association.metric].to_numpy())
    if not clipped:
        return caption
    edge = tell_number(CUT, kind="count")
    return f"{caption} Hollow symbols at the left edge: {clipped} with a {metric} below {edge}, counted in full in r."


def _caption_profile(panel: Panel) -> str:
    return (
        f"Mean {tell_name(panel.scale)} rating per reducer (level {tell_name(panel.level)}) with 95 % t intervals over "
        "participants: other people, these recordings. Grey: each participant's mean. The hidden reference and the "
        "anchors stand below the dotted line."
    )


def _name_file(*parts: str) -> str:
    return "_".join(re.sub(r"[^A-Za-z0-9_-]+", "-", part) for part in parts)
