"""Which figures a report has, what they are called, and what their captions say."""

from __future__ import annotations

from typing import TYPE_CHECKING

from feel321.analysis.agreement.reliability import SMALLEST
from feel321.analysis.figures.estimates import draw_profile
from feel321.analysis.figures.scatter import CUT, count_clipped, draw_mapping, draw_scatter
from feel321.analysis.report.section import Picture, make_slug
from feel321.analysis.table.judgements import ROLES
from feel321.analysis.table.sheet import ANSWERED, tell_measure
from feel321.analysis.words import tell_name, tell_number, tell_span

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pandas import DataFrame

    from feel321.analysis.association.correlate import Association, Panel
    from feel321.analysis.figures.style import Look
    from feel321.analysis.p1401.mapping import P1401

APART = {"reference": "the hidden reference", "anchor": "anchors"}
SLUG_PART = 40
"""Characters of a name that a file's name keeps."""


def picture_scatter(
    panel: Panel, association: Association, *, looks: Mapping[str, Look]
) -> Picture:
    """Draw ratings against a metric."""
    slug = make_slug("scatter", panel.scale, panel.level, association.metric)
    caption = _caption_scatter(panel, association)
    return Picture(slug, caption, draw_scatter(panel, association, looks=looks))


def picture_mapping(
    panel: Panel, association: Association, judged: P1401, *, looks: Mapping[str, Look]
) -> Picture:
    """Draw ratings against a metric, recording by recording."""
    slug = make_slug("mapping", panel.scale, panel.level, association.metric)
    caption = (
        f"Mean {tell_name(panel.scale)} rating of each test stimulus against its {tell_name(association.metric)}, "
        f"recording by recording (level {tell_name(panel.level)}), with the mapping of ITU-T P.1401 that was fitted to "
        f"all of them. {_tell_bars(panel)} Below: the correlation with its 95 % two-way interval, and how far noise "
        "in the ratings would let it come."
    )
    figure = draw_mapping(panel.stimuli, judged, association, scale=panel.scale, looks=looks)
    return Picture(slug, caption, figure, detail=True)


def picture_profiles(
    profile: DataFrame, participants: DataFrame, *, looks: Mapping[str, Look]
) -> Iterator[Picture]:
    """Draw ratings per reducer."""
    tests = profile[profile["role"] == ROLES[0]]
    for scale, level in sorted(set(zip(tests["scale"], tests["level"], strict=True))):
        rows, chosen = (
            table[(table["scale"] == scale) & (table["level"] == level)]
            for table in (profile, participants)
        )
        figure = draw_profile(rows, chosen, looks=looks)
        yield Picture(
            make_slug("profile", scale, level), _caption_profile(scale, level, rows), figure
        )


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
    return (
        f"Thin grey bars: 95 % t intervals over the {tell_span(counts)} participants who rated it."
    )


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
