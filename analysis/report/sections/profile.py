"""Ratings per reducer: means, their intervals over participants, hidden reference and anchors beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from analysis.contrasts.profile import GROUP, participant_means, profile_reducers
from analysis.figures.style import assign_looks
from analysis.numbers import COUNT, count_number, name_path
from analysis.report.how import PROFILES
from analysis.report.pictures import picture_profiles
from analysis.report.sections.means import name_mean
from analysis.report.sections.section import INTERVAL, Cell, Grid, Section
from analysis.table.reading import ROLES, order_reducers
from analysis.table.scales import PAIR
from analysis.words import tell_name

if TYPE_CHECKING:
    from collections.abc import Hashable, Mapping

    from pandas import DataFrame

    from analysis.report.sections.choices import Choices
    from analysis.table.reading import Table

    Row = Mapping[Hashable, Any]


def compute(table: Table, choices: Choices) -> Section:  # noqa: ARG001 - every section has this form
    """Average ratings per reducer.

    Parameters
    ----------
    table : Table
        All ratings; pairs of two test stimuli are left out.
    choices : Choices
        Leave nothing to decide here.

    Returns
    -------
    Section
        Means per scale, level, role and reducer.
    """
    single = table.rows[table.rows["role"] != PAIR]
    profile, people = profile_reducers(single), participant_means(single)
    looks = assign_looks(order_reducers(table.rows["reducer"]))
    title = "Ratings per reducer"
    if profile.empty:
        return Section("reducers", title, notes=("Only pairs of two test stimuli were rated: no ratings per reducer.",))
    caption = (
        "Mean rating per reducer in points, with its 95 % t interval over participants: other people, these "
        "recordings. Roles tell hidden references and anchors from what was tested."
    )
    head = ("Ratings", "Role", "Reducer", "Mean", "Interval", "Participants", "Stimuli", "Judgements")
    return Section(
        key="reducers", title=title, grids=(Grid(caption, head, tuple(map(_lay_row, sort_profile(profile)))),),
        tables={"profiles": profile, "participants": people},
        pictures=tuple(picture_profiles(profile, people, looks=looks)), how=(PROFILES,),
    )  # fmt: skip


def sort_profile(profile: DataFrame) -> list[dict[Hashable, Any]]:
    """Put the rows of a profile into the figure's order.

    Parameters
    ----------
    profile : DataFrame
        What `profile_reducers` returns.

    Returns
    -------
    list of dict
        Per scale and level: tests, reference, anchors; reducers in the order of `REDUCERS`.
    """
    order = order_reducers(profile["reducer"])

    def place(row: dict[Hashable, Any]) -> tuple[str, str, int, int]:
        return row["scale"], row["level"], ROLES.index(row["role"]), order.index(row["reducer"])

    return sorted(profile.to_dict("records"), key=place)


def _lay_row(row: Row) -> tuple[str | Cell, ...]:
    name = name_path("profile", *(row[key] for key in GROUP))
    mean = name_mean(name, row)
    counts = (
        count_number(f"{name}.{what}", row[what], n=row["n_ratings"])
        for what in ("n_participants", "n_stimuli", "n_ratings")
    )
    place = f"{tell_name(row['scale'])}, {tell_name(row['level'])}"
    shown = Cell(mean, "rating"), Cell(mean, "rating", part=INTERVAL)
    return (place, row["role"], row["reducer"], *shown, *(Cell(count, COUNT) for count in counts))
