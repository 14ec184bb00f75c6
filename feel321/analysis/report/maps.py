"""Section: maps of dissimilarities for each interaction and surface, of each person, and what their axes mean."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial
from statistics import median
from typing import TYPE_CHECKING, Any

from feel321.analysis import maps, words
from feel321.analysis.figures.scatter import draw_space
from feel321.analysis.primary.model import adjust_holm
from feel321.analysis.report import section as page
from feel321.analysis.report.parts import SIGNIFICANCE
from feel321.analysis.table.schema import LABELS, PAIRED

if TYPE_CHECKING:
    from pandas import DataFrame

    from feel321.analysis.resampling import Choices
    from feel321.analysis.table.items import Table

Row = dict[str, Any]

KEY, TITLE = "maps", "The space of what was felt, by interaction and surface"
DRAWS = 100
"""Maps drawn anew for each group; each takes a fit."""

LEVEL = page.Column("Level", "level", page.TEXT)
GROUPS = page.TableForm(
    "Maps of groups of recordings: stress, and how well the maps of single participants agree with the group's "
    "(Procrustes' correlation, median over participants and smallest).",
    (
        LEVEL, page.Column("Of", "kind", page.NAME), page.Column("Group", "group", page.NAME),
        page.Column("Stress", "stress", end="stress", method="Kruskal's stress-1, two dimensions"),
        page.Column("Median r", "median", end="median", method="Procrustes correlation with the group's map, median"),
        page.Column("Smallest r", "least", end="least", method="Procrustes correlation with the group's map, least"),
        page.Column("Participants", "n", words.COUNT, "n_participants"),
        page.Column("Recordings", "n_recordings", words.COUNT, "n_recordings"),
    ),
    path="maps.{level}.{kind}.{group}",
)  # fmt: skip
AGREEMENT = page.TableForm(
    "Agreement of maps with that of all recordings and with each other, after shifting, turning and scaling; p: "
    "whether their stimuli correspond better than by chance.",
    (
        LEVEL, page.Column("Of", "kind", page.NAME), page.Column("Map", "first", page.NAME),
        page.Column("With", "second", page.NAME),
        page.Column("Correlation", "correlation", method="Procrustes correlation of two maps"),
        page.Column("p", "p", "p", "p", "permutation test, {permutations} pairings"),
    ),
    path="maps_agree.{level}.{kind}.{first}.{second}",
)  # fmt: skip
ATTRIBUTES = page.TableForm(
    "Directions of attributes in the maps, within recordings: share of an attribute's variance that the axes "
    "explain, its direction, and the smallest p that permutations of so few stimuli allow.",
    (
        LEVEL, page.Column("Attribute", "property", page.TEXT),
        page.Column("R²", "r2", method="R² of a regression on the axes of the maps, within recordings"),
        page.Column("Axis 1", "axis_1", end="axis_1", method="direction of the attribute, unit vector"),
        page.Column("Axis 2", "axis_2", end="axis_2", method="direction of the attribute, unit vector"),
        page.Column("p", "p", "p", "p", "permutation of stimuli, {permutations} orders"),
        page.Column("p (Holm)", "p_holm", "p", "p_holm", "the same, Holm's adjustment"),
        page.Column("Least p", "p_least", "p", "p_least", "share of permutations that leave the attribute as it is"),
        page.Column("Points", "n", words.COUNT, "n"),
    ),
    path="maps_attribute.{level}.{property}",
)  # fmt: skip
AXES = page.TableForm(
    "Both axes of the maps on several attributes at once, in standard deviations within recordings. No test: points of "
    "one reducer are not independent.",
    (
        LEVEL, page.Column("Axis", "axis", words.COUNT, "axis"), page.Column("Attribute", "property", page.TEXT),
        page.Column("Weight", "weight", end="weight", method="standardised multiple regression of an axis"),
        page.Column("R² of the axis", "r2", end="r2", method="R² of the multiple regression"),
    ),
    path="maps_axis.{level}.{_axis}.{property}",
)  # fmt: skip


def compute_maps(table: Table, choices: Choices) -> page.Section:
    """Map dissimilarities per interaction and surface, beside the map of all recordings."""
    rows = table.rows[table.rows["scale"] == PAIRED]
    notes: list[str] = []
    answers: list[str] = []
    found: dict[str, list[Row]] = {
        name: [] for name in ("maps", "groups", "agreement", "people", "attributes", "axes")
    }
    pictures: list[page.Picture] = []
    for level in sorted(rows["level"].unique()):
        own = rows[rows["level"] == level]
        try:
            told = _map_level(table, own, str(level), choices=choices, found=found)
        except ValueError as error:
            notes.append(f"{PAIRED}, {level}: no maps of groups. {error}")
            continue
        pictures += told.pictures
        answers += told.answers
        notes += [f"{PAIRED}, {level}: {note}" for note in told.notes]
    return page.Section(
        KEY, TITLE, answers=answers, notes=notes, pictures=pictures,
        grids=(
            GROUPS.build(found["groups"]), AGREEMENT.build(found["agreement"]),
            ATTRIBUTES.build(found["attributes"]), AXES.build(found["axes"]),
        ),
        tables={name if name == "maps" else f"maps_{name}": rows for name, rows in found.items()},
        how=page.read_methods(KEY),
    )  # fmt: skip


def _map_level(
    table: Table, rows: DataFrame, level: str, *, choices: Choices, found: dict[str, list[Row]]
) -> page.Section:
    """Map the groups of one level and add the rows of its tables; returns its sentences, notes and figures."""
    rng = choices.make_rng(KEY, level)
    groups = maps.map_groups(rows, draws=min(DRAWS, max(choices.draws, 3)), rng=rng)
    for group in groups:
        own = list(maps.map_people(group))
        found["people"] += [{"level": level, **row} for row in own]
        found["groups"].append({"level": level, **_sum_up_group(group, own)})
        found["maps"] += [{"level": level, **row} for row in _list_places(group)]
    agreement = maps.compare_groups(groups, permuted=choices.draws, rng=rng)
    found["agreement"] += [{"level": level, **row} for row in agreement]
    answers, notes = list(_describe_agreement(agreement)), list(_note_labels(rows))
    try:
        points = maps.gather_points(rows, table.stimuli, groups[0], rng=rng)
        attributes = maps.regress_points(points, draws=min(choices.draws, 1000), rng=rng)
        _adjust(attributes, table.metrics)
        found["attributes"] += [{"level": level, **row} for row in attributes]
        axes = maps.regress_axes(points, [*table.metrics, maps.DIRECTIONS])
        found["axes"] += [{"level": level, "_axis": str(row["axis"]), **row} for row in axes]
        answers += _describe_attributes(attributes)
        notes += _note_points(points, attributes)
    except ValueError as error:
        notes.append(f"axes are not compared with attributes. {error}")
    return page.Section(
        KEY, TITLE, answers=answers, notes=notes, pictures=list(_draw(groups, level))
    )


def _adjust(rows: Sequence[Row], planned: Sequence[str]) -> None:
    """Adjust p by Holm over the metrics that were planned, and over the others; of those that could be small at all."""
    for is_planned in (True, False):
        own = [row for row in rows if (row["property"] in planned) == is_planned]
        tested = [row for row in own if row["p_least"] < SIGNIFICANCE]
        for row in own:
            row["p_holm"] = float("nan")
        for row, p in zip(tested, adjust_holm([row["p"] for row in tested]), strict=True):
            row["p_holm"] = p


def _sum_up_group(group: maps.GroupMap, people: Sequence[Row]) -> Row:
    agreement = list({row["participant"]: row["correlation"] for row in people}.values())
    return {
        "kind": group.kind, "group": group.name, "stress": group.space.stress, "n": len(group.matrices),
        "median": median(agreement) if agreement else float("nan"), "least": min(agreement, default=float("nan")),
        "n_recordings": group.n_recordings,
    }  # fmt: skip


def _list_places(group: maps.GroupMap) -> Iterator[Row]:
    for number, (name, (x, y)) in enumerate(zip(group.names, group.space.positions, strict=True)):
        row = {"kind": group.kind, "group": group.name, "reducer": name, "x": x, "y": y}
        if group.ellipses:
            one, two = group.ellipses.half_axes[number]
            angle = group.ellipses.angle[number]
            row |= {"half_axis_1": one, "half_axis_2": two, "angle": angle}
        yield row


def _draw(groups: Sequence[maps.GroupMap], level: str) -> Iterator[page.Picture]:
    for group in groups:
        if group.ellipses:
            caption = (
                f"Map of the dissimilarities of {group.kind} {group.name} at level {words.format_name(level)}, turned "
                "onto the map of all recordings, with 95 % bootstrap ellipses over participants."
            )
            slug = page.make_slug(KEY, level, group.kind, group.name)
            yield page.Picture(
                slug, caption, partial(draw_space, group.ellipses, group.names), detail=True
            )


def _describe_agreement(rows: Sequence[Row]) -> Iterator[str]:
    """Say how well the maps of interactions, and those of samples, agree with each other."""
    for kind in LABELS:
        own = [row for row in rows if row["kind"] == kind and row["second"] != maps.ALL]
        if own:
            least = min(own, key=lambda row: row["correlation"])
            r, p = (
                words.format_number(least["correlation"]),
                words.format_number(least["p"], kind="p"),
            )
            pairs = (
                "the two maps" if len(own) == 1 else f"the least alike of {len(own)} pairs of maps"
            )
            yield (
                f"By {kind}, {pairs} ({least['first']} and {least['second']}) agree at Procrustes r = {r} (permutation "
                f"p {p if p.startswith('<') else f'= {p}'})."
            )


def _describe_attributes(rows: Sequence[Row]) -> Iterator[str]:
    clear = [row for row in rows if row["p_holm"] < SIGNIFICANCE]
    if clear:
        listed = [
            f"{words.format_name(row['property'])} (R² = {words.format_number(row['r2'])})"
            for row in clear
        ]
        yield f"Within recordings, the axes of the maps are associated with {words.join_words(listed)}."
    elif rows:
        best = max(rows, key=lambda row: row["r2"])
        yield (
            f"Within recordings, no association of the axes with any of {len(rows)} attributes was shown; the "
            f"best explained is {words.format_name(best['property'])} (R² = {words.format_number(best['r2'])})."
        )


def _note_labels(rows: DataFrame) -> Iterator[str]:
    if not any(name in rows and len(rows[name].unique()) > 1 for name in LABELS):
        yield (
            "maps are of all recordings together; name `interaction` and `sample` in [[recordings]], or in columns of "
            "the manifest, for maps of each."
        )


def _note_points(points: maps.Points, rows: Sequence[Row]) -> Iterator[str]:
    """Say on how little a regression of axes on attributes rests."""
    n = len(points.stimuli)
    if mute := [
        words.format_name(row["property"]) for row in rows if row["p_least"] >= SIGNIFICANCE
    ]:
        yield f"permutations of {n} stimuli cannot show an association of the axes with {words.join_words(mute, 'or')}."
    if points.size < maps.ENOUGH * len(rows):
        yield (
            f"{len(rows)} attributes are compared with {points.size} points ({n} stimuli in {len(points.places)} "
            f"recordings); {maps.ENOUGH} for each are recommended: R² is descriptive only."
        )
