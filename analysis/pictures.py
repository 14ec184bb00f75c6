"""Which figures a report has, what they are called, and what their captions say."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from itertools import chain
from typing import TYPE_CHECKING

from analysis.figures.profile import draw_profile
from analysis.figures.scatter import CUT, count_clipped, draw_scatter
from analysis.reliability import SMALLEST
from analysis.scales import ANSWERED, tell_measure
from analysis.figures.style import Look, assign_looks, list_undrawable
from analysis.table import ROLES, order_reducers
from analysis.verdict import LEADING
from analysis.words import tell_name, tell_number, tell_span

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from matplotlib.figure import Figure
    from pandas import DataFrame

    from analysis.association import Association
    from analysis.findings import Findings, Panel
    from analysis.table import Table


APART = {"reference": "the hidden reference", "anchor": "anchors"}
SLUG_PART = 40
"""Characters of a name that a file's name keeps."""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """A figure of the report.

    Parameters
    ----------
    name : str
        File name without suffix; ends in the figure's number, which makes it unique on any file system.
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
        A scatter per association by the leading method, then a profile per scale and level with test stimuli.
    """
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    drawn = chain(_draw_scatters(findings, looks), _draw_profiles(findings, looks))
    return tuple(replace(picture, name=f"{picture.name}_{number}") for number, picture in enumerate(drawn, start=1))


def note_undrawable(table: Table) -> tuple[str, ...]:
    """Say which characters of names the figures cannot show.

    Parameters
    ----------
    table : Table
        Its scales, levels and reducers are written in figures.

    Returns
    -------
    tuple of str
        One sentence, or none.
    """
    letters = list_undrawable(name for column in ("scale", "level", "reducer") for name in table.rows[column].unique())
    if not letters:
        return ()
    return (f"The figures' font has no {' '.join(letters)}: boxes stand for them; captions and tables show them.",)


def _draw_scatters(findings: Findings, looks: Mapping[str, Look]) -> Iterator[Picture]:
    leading = [(panel, found) for panel in findings.panels for found in panel.associations if found.method == LEADING]
    for panel, association in leading:
        slug = _make_slug("scatter", panel.scale, panel.level, association.metric)
        figure = draw_scatter(panel, association, looks=looks)
        yield Picture(slug, "scatter", _caption_scatter(panel, association), figure)


def _draw_profiles(findings: Findings, looks: Mapping[str, Look]) -> Iterator[Picture]:
    tests = findings.profile[findings.profile["role"] == ROLES[0]]
    for scale, level in sorted(set(zip(tests["scale"], tests["level"], strict=True))):
        profile, chosen = (
            table[(table["scale"] == scale) & (table["level"] == level)]
            for table in (findings.profile, findings.participants)
        )
        figure = draw_profile(profile, chosen, looks=looks)
        yield Picture(_make_slug("profile", scale, level), "profile", _caption_profile(scale, level, profile), figure)


def _caption_scatter(panel: Panel, association: Association) -> str:
    metric = tell_name(association.metric)
    caption = (
        f"Mean {tell_name(panel.scale)} rating of each test stimulus against its {metric} "
        f"(level {tell_name(panel.level)}). {_tell_bars(panel)}"
    )
    clipped = count_clipped(panel.stimuli[association.metric].to_numpy())
    if not clipped:
        return caption
    edge = tell_number(CUT, kind="count")
    return f"{caption} Hollow symbols at the left edge: {clipped} with a {metric} below {edge}, counted in full in r."


def _tell_bars(panel: Panel) -> str:
    counts = panel.stimuli["n_participants"]
    if counts.max() < SMALLEST:
        return "One participant each, so no intervals."
    return f"Thin grey bars: 95 % t intervals over the {tell_span(counts)} participants who rated it."


def _caption_profile(scale: str, level: str, profile: DataFrame) -> str:
    caption = f"Mean {tell_measure(scale)} per reducer (level {tell_name(level)})"
    if profile["n_participants"].max() < SMALLEST:
        caption += "; one participant each, so no intervals."
    else:
        caption += " with 95 % t intervals over participants: other people, these recordings."
    caption += " Grey: each participant's mean."
    if scale == ANSWERED:
        caption += " Guessing gives 50."
    # A manifest may have any of these roles, or none.
    apart = [name for role, name in APART.items() if (profile["role"] == role).any()]
    if apart:
        caption += f" Below the dotted line: {' and '.join(apart)}."
    return caption


def _make_slug(*parts: str) -> str:
    """Make names readable in a file's name; the number that follows it tells those apart that become alike."""
    return "_".join(re.sub(r"[^A-Za-z0-9_-]+", "-", part)[:SLUG_PART] for part in parts)
