"""Which figures a report has, what they are called, and what their captions say."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from analysis.agreement.reliability import SMALLEST
from analysis.figures.mapping import draw_mapping
from analysis.figures.profile import draw_profile
from analysis.figures.scatter import CUT, count_clipped, draw_scatter
from analysis.figures.style import Look, list_undrawable
from analysis.table.reading import ROLES
from analysis.table.scales import ANSWERED, tell_measure
from analysis.words import tell_name, tell_number, tell_span

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from matplotlib.figure import Figure
    from pandas import DataFrame

    from analysis.association.correlate import Association
    from analysis.findings import Panel
    from analysis.p1401.mapping import P1401
    from analysis.table.reading import Table


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
        What sort of figure, such as ``scatter``.
    caption : str
        What it shows, in words; also its alternative text.
    figure : Figure
        The drawing.
    detail : bool
        Whether the page folds it away.
    """

    name: str
    kind: str
    caption: str
    figure: Figure
    detail: bool = False


def number_pictures(pictures: Iterable[Picture]) -> Iterator[Picture]:
    """Let the figures' numbers end their names, which makes these unique on any file system.

    Parameters
    ----------
    pictures : iterable of Picture
        In the report's order.

    Yields
    ------
    Picture
        The same, named anew.
    """
    for number, picture in enumerate(pictures, start=1):
        yield replace(picture, name=f"{picture.name}_{number}")


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


def picture_scatter(panel: Panel, association: Association, *, looks: Mapping[str, Look]) -> Picture:
    """Draw ratings against a metric.

    Parameters
    ----------
    panel : Panel
        Stimuli of one scale and level.
    association : Association
        Of the metric.
    looks : Mapping of str to Look
        Look per reducer.

    Returns
    -------
    Picture
        A scatter.
    """
    slug = make_slug("scatter", panel.scale, panel.level, association.metric)
    caption = _caption_scatter(panel, association)
    return Picture(slug, "scatter", caption, draw_scatter(panel, association, looks=looks))


def picture_mapping(panel: Panel, association: Association, judged: P1401, *, looks: Mapping[str, Look]) -> Picture:
    """Draw ratings against a metric, recording by recording.

    Parameters
    ----------
    panel : Panel
        Stimuli of one scale and level.
    association : Association
        Of the metric: its correlation and the noise ceiling.
    judged : P1401
        What P.1401 says of the metric.
    looks : Mapping of str to Look
        Look per reducer.

    Returns
    -------
    Picture
        A panel per recording, folded away.
    """
    slug = make_slug("mapping", panel.scale, panel.level, association.metric)
    caption = (
        f"Mean {tell_name(panel.scale)} rating of each test stimulus against its {tell_name(association.metric)}, "
        f"recording by recording (level {tell_name(panel.level)}), with the mapping of ITU-T P.1401 that was fitted to "
        f"all of them. {_tell_bars(panel)} Below: the correlation with its 95 % two-way interval, and how far noise "
        "in the ratings would let it come."
    )
    figure = draw_mapping(panel.stimuli, judged, association, scale=panel.scale, looks=looks)
    return Picture(slug, "mapping", caption, figure, detail=True)


def picture_profiles(profile: DataFrame, participants: DataFrame, *, looks: Mapping[str, Look]) -> Iterator[Picture]:
    """Draw ratings per reducer.

    Parameters
    ----------
    profile : DataFrame
        What `profile_reducers` returns.
    participants : DataFrame
        What `participant_means` returns.
    looks : Mapping of str to Look
        Look per reducer.

    Yields
    ------
    Picture
        A profile per scale and level with test stimuli.
    """
    tests = profile[profile["role"] == ROLES[0]]
    for scale, level in sorted(set(zip(tests["scale"], tests["level"], strict=True))):
        rows, chosen = (
            table[(table["scale"] == scale) & (table["level"] == level)] for table in (profile, participants)
        )
        figure = draw_profile(rows, chosen, looks=looks)
        yield Picture(make_slug("profile", scale, level), "profile", _caption_profile(scale, level, rows), figure)


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


def make_slug(*parts: str) -> str:
    """Make names readable in a file's name; the number that follows it tells those apart that become alike.

    Parameters
    ----------
    *parts : str
        Names.

    Returns
    -------
    str
        Letters, digits, hyphens and underscores.
    """
    return "_".join(re.sub(r"[^A-Za-z0-9_-]+", "-", part)[:SLUG_PART] for part in parts)
